//! What `--time` and `--fit` add to the JSON of a recording.

use crate::compare::explained::{Fitted, Ranking, fitted, rankings};
use crate::compare::fit::Estimate;
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
struct FitJson {
    traversal: &'static str,
    form: &'static str,
    trees: usize,
    groups: Option<usize>,
    query: Option<EstimateJson>,
    node_visit: Option<EstimateJson>,
    box_test: Option<EstimateJson>,
    primitive_test: Option<EstimateJson>,
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
    traversal: &'static str,
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
            fit: fitted(comparison, recording).iter().map(FitJson::of).collect(),
            ranking: rankings(comparison, recording).into_iter().map(RankingJson::of).collect(),
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
    fn of(Fitted { traversal, form, trees, fit }: &Fitted) -> FitJson {
        let estimate = |estimate: Option<Estimate>| {
            estimate.map(|e| EstimateJson { ns: e.value * 1e9, standard_error: e.error * 1e9 })
        };
        FitJson {
            traversal: traversal.key(),
            form,
            trees: *trees,
            groups: fit.map(|fit| fit.observations),
            query: fit.and_then(|fit| estimate(fit.query)),
            node_visit: fit.and_then(|fit| estimate(fit.node_visit)),
            box_test: fit.and_then(|fit| estimate(fit.box_test)),
            primitive_test: fit.and_then(|fit| estimate(fit.primitive_test)),
            r_squared: fit.map(|fit| fit.r_squared),
        }
    }
}

impl RankingJson {
    fn of(Ranking { traversal, measures }: Ranking) -> RankingJson {
        RankingJson { traversal: traversal.key(), measures: measures.into_iter().collect() }
    }
}
