//! An earlier report that trees are held to: what is compared are numbers per query, so geometry and recording may have changed since.

use super::limit::Metric;
use crate::traverse::Traversal;
use serde_json::Value;
use std::path::Path;
use thiserror::Error;

/// What `bvh-compare --format json` wrote.
#[derive(Clone, Debug)]
pub struct Baseline {
    report: Value,
}

/// Why a file is no such report.
#[derive(Debug, Error)]
pub enum BaselineError {
    #[error("not a report of bvh-compare --format json: {0}")]
    Json(#[from] serde_json::Error),
    #[error("not a report of bvh-compare --format json: it has no trees")]
    NoTrees,
}

impl Baseline {
    /// Reads a report.
    ///
    /// # Errors
    /// When it is no JSON, or has no trees.
    pub fn parse(json: &str) -> Result<Baseline, BaselineError> {
        let baseline = Baseline { report: serde_json::from_str(json)? };
        match baseline.trees(0) {
            Some(trees) if !trees.is_empty() => Ok(baseline),
            _ => Err(BaselineError::NoTrees),
        }
    }

    /// The trees over a recording: over the one at that place, where the report has several.
    fn trees(&self, recording: usize) -> Option<&Vec<Value>> {
        let report = match self.report.get("recordings") {
            Some(recordings) => recordings.get(recording)?,
            None => &self.report,
        };
        report.get("trees")?.as_array()
    }

    /// What a tree had per query: the one whose file had that name, else, of as many trees, the one at that place.
    pub(super) fn value(
        &self,
        recording: usize,
        (path, place, count): (&str, usize, usize),
        traversal: Traversal,
        metric: Metric,
    ) -> Option<f64> {
        let trees = self.trees(recording)?;
        let name = |path: &str| Path::new(path).file_name().map(|name| name.to_owned());
        let has_name = |tree: &&Value| tree["path"].as_str().map(name) == Some(name(path));
        let alike = || trees.get(place).filter(|_| trees.len() == count);
        let tree = trees.iter().find(has_name).or_else(alike)?;
        let run = &tree["traversals"][traversal.key()];
        let per_query = |sum: &Value| Some(sum.as_f64()? / run["queries"].as_f64()?.max(1.0));
        match metric {
            Metric::Cost => run["cost"].as_f64(),
            Metric::Nanoseconds => tree["time"]["embree"]["ns"].as_f64(),
            Metric::Visits => per_query(&run["node_visits"]),
            Metric::Gamma => per_query(&run["gamma"]),
            Metric::Sah => tree["sah_cost"].as_f64(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tree_is_found_by_its_name_or_its_place() {
        let tree = |path: &str, cost: f64| {
            format!(
                r#"{{"path": "{path}", "traversals": {{"odf": {{"queries": 2, "cost": {cost}, "node_visits": 6}}}}}}"#
            )
        };
        let json = format!(r#"{{"trees": [{}, {}]}}"#, tree("old/a.bvh", 10.0), tree("old/b.bvh", 20.0));
        let baseline = Baseline::parse(&json).expect("a report");
        let value = |path: &str, place: usize, count: usize, metric| {
            baseline.value(0, (path, place, count), Traversal::Odf, metric)
        };
        assert_eq!(value("new/b.bvh", 0, 3, Metric::Cost), Some(20.0));
        assert_eq!(value("new/c.bvh", 0, 2, Metric::Cost), Some(10.0));
        assert_eq!(value("new/c.bvh", 0, 3, Metric::Cost), None);
        assert_eq!(value("a.bvh", 0, 2, Metric::Visits), Some(3.0));
        assert_eq!(value("a.bvh", 0, 2, Metric::Sah), None);
        for wrong in ["", "[]", "{}", r#"{"trees": []}"#, r#"{"recordings": []}"#] {
            let error = Baseline::parse(wrong).expect_err(wrong).to_string();
            assert!(error.starts_with("not a report") && !error.contains('\n'), "{error}");
        }
    }
}
