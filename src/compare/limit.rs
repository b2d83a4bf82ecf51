//! The number that a tree is held to: what a comparison is asked for in continuous integration, and by which measure.

use super::{Comparison, RecordingResult, TreeFacts, relative};
use std::str::FromStr;

/// By what trees are measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Metric {
    /// What a query is expected to take ([`crate::cost`]).
    #[default]
    Cost,
    /// What one took, by the clock: of Embree's kernels where they were asked on every tree, else of ours.
    Nanoseconds,
    /// Node visits.
    Visits,
    /// Γ: box and primitive tests.
    Gamma,
    /// The SAH cost, which no query has a say in.
    Sah,
}

impl Metric {
    pub const ALL: [Metric; 5] =
        [Metric::Cost, Metric::Nanoseconds, Metric::Visits, Metric::Gamma, Metric::Sah];

    /// The name in options and messages.
    pub fn key(self) -> &'static str {
        match self {
            Metric::Cost => "cost",
            Metric::Nanoseconds => "ns",
            Metric::Visits => "visits",
            Metric::Gamma => "gamma",
            Metric::Sah => "sah",
        }
    }
}

impl FromStr for Metric {
    type Err = String;

    fn from_str(text: &str) -> Result<Metric, String> {
        let known = Metric::ALL.into_iter().find(|metric| metric.key() == text);
        known.ok_or_else(|| format!("expected one of {}", Metric::ALL.map(Metric::key).join(", ")))
    }
}

/// What a number of an earlier report may be off by, relatively, because it is read from decimals.
const READING: f64 = 1e-12;

impl Comparison {
    /// What a query of the first traversal costs in each tree, by `metric`; `None` where that was not measured.
    fn measured(&self, recording: &RecordingResult, metric: Metric) -> Vec<Option<f64>> {
        let each = |(number, (facts, tree)): (usize, (&TreeFacts, &super::TreeResult))| {
            let total = &tree.runs[0].outcome.tallies.total;
            let mean = |sum: f64| sum / total.queries as f64;
            match metric {
                Metric::Cost => self.cost(number, total),
                Metric::Nanoseconds => {
                    let timing = recording.timing.as_ref()?;
                    let kernels =
                        timing.kernels.as_ref().filter(|kernels| kernels.trees.iter().all(Option::is_some));
                    let ours = &timing.trees[number][0];
                    let time = kernels.and_then(|kernels| kernels.trees[number].as_ref()).unwrap_or(ours);
                    Some(time.total.median * 1e9 / timing.queries.max(1) as f64)
                }
                Metric::Visits => Some(mean(total.counts.node_visits as f64)),
                Metric::Gamma => Some(mean(self.settings.costs.gamma(&total.counts))),
                Metric::Sah => Some(facts.sah_cost),
            }
        };
        self.trees.iter().zip(&recording.trees).enumerate().map(each).collect()
    }

    /// What each tree had per query in the baseline, by `metric` under the first traversal; `None` without one, or where that has no such tree.
    pub fn at_baseline(&self, recording: usize, metric: Metric) -> Vec<Option<f64>> {
        let count = self.trees.len();
        let each = |(place, tree): (usize, &TreeFacts)| {
            let baseline = self.settings.baseline.as_ref()?;
            baseline.value(recording, (&tree.path, place, count), self.settings.traversals[0], metric)
        };
        self.trees.iter().enumerate().map(each).collect()
    }

    /// Trees that exceed `limit` times the first one, or with a baseline what they were there, by `metric` under the first traversal, a line
    /// each; one line where that was not measured.
    pub fn above(&self, metric: Metric, limit: f64) -> Vec<String> {
        let mut lines = Vec::new();
        let (first, traversal) = (&self.trees[0], self.settings.traversals[0].name());
        for (number, recording) in self.recordings.iter().enumerate() {
            let values = self.measured(recording, metric);
            let (bases, whose) = match self.settings.baseline {
                Some(_) => (self.at_baseline(number, metric), "the baseline"),
                None => (vec![values[0]; values.len()], first.path.as_str()),
            };
            for ((tree, value), base) in self.trees.iter().zip(&values).zip(bases) {
                let (key, over) = (metric.key(), self.over(recording));
                let (Some(value), Some(base)) = (value, base) else {
                    let why = if value.is_some() { "is not in the baseline" } else { "was not measured" };
                    lines.push(format!("{}: {key}{over} {why}, so no limit holds", tree.path));
                    continue;
                };
                let ratio = relative(*value, base);
                if ratio > limit * (1.0 + READING) {
                    lines.push(format!(
                        "{}: {key} under {traversal}{over} is {ratio:.4} of {whose}'s, above {limit}",
                        tree.path
                    ));
                }
            }
        }
        lines
    }
}
