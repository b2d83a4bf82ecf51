//! What `--time` and `--fit` add to the JSON of a recording.

use super::costs::{estimates, kind_key};
use crate::compare::explained::{Fitted, Ranking, Ranks, fitted, measured, rankings};
use crate::compare::fit::Estimate;
use crate::compare::reports::Row;
use crate::compare::timing::{Seconds, Time};
use crate::compare::{Comparison, RecordingResult, kind_name};
use serde::Serialize;
use std::collections::BTreeMap;

/// Keys beside `trees`.
#[derive(Serialize)]
pub(super) struct Timed {
    timing: Method,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    fit: Vec<FitJson>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    ranking: Vec<RankingJson>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    observations: Vec<Row>,
}

#[derive(Serialize)]
struct Method {
    queries: u64,
    rounds: u32,
    processor: Option<usize>,
    /// To sort all queries, where they were.
    #[serde(skip_serializing_if = "Option::is_none")]
    sort_seconds: Option<f64>,
}

/// Seconds of processor time for all timed queries.
#[derive(Serialize)]
pub(super) struct TimeJson {
    #[serde(flatten)]
    total: SecondsJson,
    by_kind: BTreeMap<&'static str, SecondsJson>,
    by_purpose: BTreeMap<&'static str, SecondsJson>,
}

#[derive(Serialize)]
struct SecondsJson {
    /// The median of the rounds.
    seconds: f64,
    least: f64,
    greatest: f64,
}

/// Costs in nanoseconds.
#[derive(Serialize)]
pub(super) struct FitJson {
    follower: &'static str,
    /// Null of all widths together.
    width: Option<usize>,
    kind: &'static str,
    trees: usize,
    groups: Option<usize>,
    #[serde(flatten)]
    costs: BTreeMap<&'static str, Option<EstimateJson>>,
    /// Whether leaves and blocks could not be told apart: then they have the ratio of the default.
    leaf_and_block_together: bool,
    r_squared: Option<f64>,
}

#[derive(Serialize)]
struct EstimateJson {
    ns: f64,
    standard_error: f64,
}

/// Kendall's τ_b with the time, by measure.
#[derive(Serialize)]
struct RankingJson {
    follower: &'static str,
    trees: usize,
    /// Whose times are far enough apart.
    pairs: usize,
    #[serde(flatten)]
    measures: BTreeMap<&'static str, Option<f64>>,
}

impl Timed {
    /// `None` when nothing was timed.
    pub fn of(comparison: &Comparison, recording: &RecordingResult) -> Option<Timed> {
        let timing = recording.timing.as_ref()?;
        Some(Timed {
            timing: Method {
                queries: timing.queries,
                rounds: timing.rounds,
                processor: timing.processor,
                sort_seconds: timing.sort.map(|sort| sort.median),
            },
            fit: fitted(&measured(comparison, recording)).iter().map(FitJson::of).collect(),
            ranking: rankings(comparison, recording).into_iter().filter_map(RankingJson::of).collect(),
            observations: timing.observations.iter().map(Row::of).collect(),
        })
    }
}

impl TimeJson {
    pub fn of(time: &Time) -> TimeJson {
        let kinds = time.by_kind.iter().map(|(kind, seconds)| (kind_name(*kind), SecondsJson::of(seconds)));
        let purposes =
            time.by_purpose.iter().map(|(purpose, seconds)| (purpose.name(), SecondsJson::of(seconds)));
        TimeJson {
            total: SecondsJson::of(&time.total),
            by_kind: kinds.collect(),
            by_purpose: purposes.collect(),
        }
    }
}

impl SecondsJson {
    fn of(&Seconds { median, least, greatest }: &Seconds) -> SecondsJson {
        SecondsJson { seconds: median, least, greatest }
    }
}

impl FitJson {
    pub fn of(Fitted { follower, width, is_occlusion, trees, fit }: &Fitted) -> FitJson {
        let json = |Estimate { value, error }: Estimate| EstimateJson { ns: value, standard_error: error };
        let costs = fit.iter().flat_map(|fit| estimates(fit).map(|(name, it)| (name, it.map(json))));
        FitJson {
            follower: follower.key(),
            width: *width,
            kind: kind_key(*is_occlusion),
            trees: *trees,
            groups: fit.map(|fit| fit.samples),
            costs: costs.collect(),
            leaf_and_block_together: fit.is_some_and(|fit| fit.is_joined),
            r_squared: fit.map(|fit| fit.r_squared),
        }
    }
}

impl RankingJson {
    /// `None` where nothing is said of ranks.
    fn of(Ranking { follower, trees, ranks }: Ranking) -> Option<RankingJson> {
        let Ranks { pairs, measures } = ranks?;
        let measures = measures.into_iter().collect();
        Some(RankingJson { follower: follower.key(), trees, pairs, measures })
    }
}
