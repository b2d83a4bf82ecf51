//! What Embree's kernels add to the JSON of a recording: `embree`, and `time.embree` of each tree.

use super::json_time::TimeJson;
use super::time::Nanoseconds;
use crate::compare::kernels::{Answers, Differences, Planting, Recorded};
use crate::compare::timing::{KernelTimes, Seconds, Time, Timing};
use crate::compare::{Comparison, RecordingResult, kind_name, relative};
use serde::Serialize;
use std::collections::BTreeMap;

/// `embree`: what was asked, and Embree on the trees that it built itself.
#[derive(Serialize)]
pub(super) struct EmbreeJson {
    version: u32,
    isa: String,
    structure: String,
    robust: bool,
    /// Whether the scene has the triangles of instances in their place.
    flattened: bool,
    /// Whether it has the program's filters: never.
    filters: bool,
    /// What files say of the Embree that was recorded.
    recorded: RecordedJson,
    /// In what that is another one, a phrase each.
    unlike_recorded: Vec<String>,
    /// Of the tree that the times are of.
    quality: &'static str,
    /// Queries that it answers otherwise than recorded, hit or miss.
    #[serde(skip_serializing_if = "Option::is_none")]
    differing: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    answers: Option<AnswersJson>,
    #[serde(flatten)]
    time: Option<TimeJson>,
    /// The same of its tree of high quality.
    #[serde(skip_serializing_if = "Option::is_none")]
    high: Option<TimeJson>,
}

#[derive(Serialize)]
struct RecordedJson {
    version: Option<u32>,
    isa: Option<String>,
    filters: bool,
}

impl EmbreeJson {
    /// `None` when Embree was not asked, or has no such scene.
    pub fn of(comparison: &Comparison, recording: &RecordingResult) -> Option<EmbreeJson> {
        let kernels = comparison.kernels.as_ref()?.as_ref().ok()?;
        let answers = recording.kernels.as_ref().map(|answers| &answers.own);
        let recorded = Recorded::of(&comparison.trees, recording);
        let times = recording.timing.as_ref().and_then(|timing| timing.kernels.as_ref());
        let time = |number: usize| times?.own.get(number)?.as_ref().map(TimeJson::of);
        Some(EmbreeJson {
            version: kernels.version,
            isa: kernels.isa.clone(),
            structure: kernels.structure.clone(),
            robust: kernels.robust,
            flattened: kernels.is_flattened,
            filters: false,
            unlike_recorded: kernels.unlike(&recorded),
            recorded: RecordedJson {
                version: recorded.version,
                isa: recorded.isa,
                filters: recorded.has_filters,
            },
            quality: kernels.own[0],
            differing: answers.map(|answers| answers.differing),
            answers: answers.map(AnswersJson::of),
            time: time(0),
            high: time(1),
        })
    }
}

/// `time` of a tree.
#[derive(Serialize)]
pub(super) struct TreeTimeJson {
    embree: OnTree,
}

#[derive(Serialize)]
struct OnTree {
    planted: bool,
    /// Why not.
    #[serde(skip_serializing_if = "Option::is_none")]
    why: Option<String>,
    #[serde(flatten)]
    size: Option<Size>,
    #[serde(flatten)]
    time: Option<Times>,
    #[serde(skip_serializing_if = "Option::is_none")]
    answers: Option<AnswersJson>,
}

/// In Embree's memory.
#[derive(Serialize)]
struct Size {
    nodes: usize,
    blocks: usize,
    bytes: usize,
}

#[derive(Serialize)]
struct Times {
    #[serde(flatten)]
    total: Group,
    by_kind: BTreeMap<&'static str, Group>,
    by_purpose: BTreeMap<&'static str, Group>,
}

/// Nanoseconds per query, and medians relative to those of others.
#[derive(Serialize)]
struct Group {
    /// The median of the rounds.
    ns: f64,
    least: f64,
    greatest: f64,
    /// (greatest - least) / ns.
    spread: f64,
    /// To the first tree; null where that is not planted.
    ratio: Option<f64>,
    /// To Embree's own tree of medium quality.
    ratio_to_own: Option<f64>,
    /// To the better of Embree's own trees for these queries.
    ratio_to_best: Option<f64>,
}

#[derive(Serialize)]
struct AnswersJson {
    queries: u64,
    mismatches: u64,
    borderline: u64,
    unjudged: u64,
    #[serde(flatten)]
    singly: DifferencesJson,
    packets: DifferencesJson,
}

/// Against the answers on Embree's own tree.
#[derive(Serialize)]
struct DifferencesJson {
    flipped: u64,
    apart: u64,
}

impl TreeTimeJson {
    /// Of tree number `tree`; `None` when Embree was not asked.
    pub fn of(comparison: &Comparison, recording: &RecordingResult, tree: usize) -> Option<TreeTimeJson> {
        let kernels = comparison.kernels.as_ref()?.as_ref().ok()?;
        let planted = &kernels.trees[tree];
        let size = |&Planting { nodes, blocks, bytes }: &Planting| Size { nodes, blocks, bytes };
        let answers = recording.kernels.as_ref().and_then(|answers| answers.trees[tree].as_ref());
        let times = recording.timing.as_ref().and_then(|timing| {
            let times = timing.kernels.as_ref()?;
            Some(Times::of(timing, times, times.trees[tree].as_ref()?))
        });
        Some(TreeTimeJson {
            embree: OnTree {
                planted: planted.is_ok(),
                why: planted.as_ref().err().cloned(),
                size: planted.as_ref().ok().map(size),
                time: times,
                answers: answers.map(AnswersJson::of),
            },
        })
    }
}

impl Times {
    fn of(timing: &Timing, times: &KernelTimes, time: &Time) -> Times {
        let total = Group::of(timing.queries, times, time.total, |time| Some(time.total));
        let by_kind = timing.by_kind.iter().filter_map(|(kind, &queries)| {
            let seconds = *time.by_kind.get(kind)?;
            let group = Group::of(queries, times, seconds, |time| time.by_kind.get(kind).copied());
            Some((kind_name(*kind), group))
        });
        let by_purpose = timing.by_purpose.iter().filter_map(|(purpose, &queries)| {
            let seconds = *time.by_purpose.get(purpose)?;
            let group = Group::of(queries, times, seconds, |time| time.by_purpose.get(purpose).copied());
            Some((purpose.name(), group))
        });
        Times { total, by_kind: by_kind.collect(), by_purpose: by_purpose.collect() }
    }
}

impl Group {
    /// What `queries` took, beside the same `part` of others' times.
    fn of(
        queries: u64,
        times: &KernelTimes,
        seconds: Seconds,
        part: impl Fn(&Time) -> Option<Seconds>,
    ) -> Group {
        let ns = Nanoseconds::of(&seconds, queries);
        let to = |others: &[Option<Time>]| {
            let other = part(others.first()?.as_ref()?)?;
            Some(relative(seconds.median, other.median))
        };
        Group {
            ns: ns.median,
            least: ns.least,
            greatest: ns.greatest,
            spread: ns.spread(),
            ratio: to(&times.trees),
            ratio_to_own: to(&times.own),
            ratio_to_best: times.best(part).map(|best| relative(seconds.median, best)),
        }
    }
}

impl AnswersJson {
    fn of(answers: &Answers) -> AnswersJson {
        let &Answers { queries, mismatches, borderline, unjudged, singly, in_packets, .. } = answers;
        let differences = |Differences { flipped, apart }| DifferencesJson { flipped, apart };
        AnswersJson {
            queries,
            mismatches,
            borderline,
            unjudged,
            singly: differences(singly),
            packets: differences(in_packets),
        }
    }
}
