//! What reports of `bvh-compare --fit --format json` say was observed, written and read, so that costs are fitted to several scenes at once.

use super::explained::Measured;
use super::fit::Sample;
use super::timing::{Follower, Observation};
use super::{depth_name, kernels};
use crate::cost::{Counted, width_class};
use crate::format::rays::kind;
use crate::traverse::Counts;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use thiserror::Error;

/// What one report observed.
#[derive(Clone, Debug)]
pub struct Observed {
    /// Of each recording.
    pub recordings: Vec<Vec<Measured>>,
    /// Which of Embree's kernels, where they were asked.
    pub kernels: Option<String>,
}

/// Why a file says nothing to fit.
#[derive(Debug, Error)]
pub enum ObservedError {
    #[error("not a report of bvh-compare --fit --format json: {0}")]
    Json(#[from] serde_json::Error),
    #[error("no observations: the report was made without --fit")]
    Nothing,
    #[error("observations[{place}] is of tree {tree}, and there are {trees}")]
    Tree { place: usize, tree: usize, trees: usize },
}

#[derive(Deserialize)]
struct Whole {
    #[serde(default)]
    recordings: Vec<Report>,
}

#[derive(Deserialize)]
struct Report {
    #[serde(default)]
    trees: Vec<Tree>,
    #[serde(default)]
    observations: Vec<Row>,
    embree: Option<Embree>,
}

#[derive(Deserialize)]
struct Tree {
    max_children: usize,
}

#[derive(Deserialize)]
struct Embree {
    version: u32,
    isa: String,
    structure: String,
    robust: bool,
}

#[derive(Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Kind {
    ClosestHit,
    Occlusion,
}

/// A group of queries under one tree, as a report has it.
#[derive(Serialize, Deserialize)]
pub struct Row {
    follower: Follower,
    /// Place in `trees`.
    tree: usize,
    /// Of the recording.
    part: usize,
    kind: Kind,
    depth: String,
    purpose: String,
    queries: u64,
    node_visits: u64,
    leaf_visits: u64,
    block_tests: u64,
    /// Of the simulated cache.
    misses: u64,
    seconds: f64,
}

impl Row {
    pub fn of(observation: &Observation) -> Row {
        let &Observation { follower, tree, part, cell: (kind, depth, purpose), counted, seconds } =
            observation;
        Row {
            follower,
            tree,
            part,
            kind: if kind == kind::OCCLUSION { Kind::Occlusion } else { Kind::ClosestHit },
            depth: depth_name(depth),
            purpose: purpose.name().to_owned(),
            queries: counted.queries,
            node_visits: counted.counts.node_visits,
            leaf_visits: counted.counts.leaf_visits,
            block_tests: counted.counts.block_tests,
            misses: counted.misses,
            seconds,
        }
    }
}

impl Observed {
    /// Reads a report.
    ///
    /// # Errors
    /// When it is no such report, or has no observations.
    pub fn parse(json: &str) -> Result<Observed, ObservedError> {
        let whole: Whole = serde_json::from_str(json)?;
        let reports =
            if whole.recordings.is_empty() { vec![serde_json::from_str(json)?] } else { whole.recordings };
        let recordings = reports.iter().map(Report::measured).collect::<Result<Vec<_>, _>>()?;
        if recordings.iter().all(Vec::is_empty) {
            return Err(ObservedError::Nothing);
        }
        let embree = reports.iter().find_map(|report| report.embree.as_ref());
        let kernels = embree.map(|it| kernels::name(it.version, &it.isa, &it.structure, it.robust));
        Ok(Observed { recordings, kernels })
    }
}

impl Report {
    fn measured(&self) -> Result<Vec<Measured>, ObservedError> {
        let mut groups = BTreeMap::new();
        let mut all = Vec::with_capacity(self.observations.len());
        for (place, row) in self.observations.iter().enumerate() {
            let (tree, trees) = (row.tree, self.trees.len());
            let facts = self.trees.get(tree).ok_or(ObservedError::Tree { place, tree, trees })?;
            let is_occlusion = row.kind == Kind::Occlusion;
            let next = groups.len();
            let key = (row.part, is_occlusion, row.depth.as_str(), row.purpose.as_str());
            let group = *groups.entry(key).or_insert(next);
            let &Row { queries, node_visits, leaf_visits, block_tests, misses, seconds, .. } = row;
            let counts = Counts { node_visits, leaf_visits, block_tests, ..Counts::default() };
            all.push(Measured {
                follower: row.follower,
                width: width_class(facts.max_children),
                is_occlusion,
                tree,
                sample: Sample { group, counted: Counted { queries, counts, misses }, seconds },
            });
        }
        Ok(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_report_or_observed_nothing_is_refused_in_one_line() {
        let row = r#"{"follower": "ours", "tree": 1, "part": 0, "kind": "occlusion", "depth": "0", "purpose": "ao", "queries": 1,
            "node_visits": 2, "leaf_visits": 3, "block_tests": 4, "misses": 5, "seconds": 6}"#;
        for (json, message) in [
            ("", "not a report"),
            ("[]", "not a report"),
            (r#"{"trees": [], "observations": [{}]}"#, "not a report"),
            (r#"{"trees": [{"max_children": 8}]}"#, "no observations"),
            (
                &format!(r#"{{"trees": [{{"max_children": 8}}], "observations": [{row}]}}"#),
                "observations[0] is of tree 1",
            ),
        ] {
            let error = Observed::parse(json).expect_err(json).to_string();
            assert!(error.starts_with(message) && !error.contains('\n'), "{error}, expected {message}");
        }
        let two = r#"[{"max_children": 8}, {"max_children": 3}]"#;
        let observed = Observed::parse(&format!(r#"{{"trees": {two}, "observations": [{row}]}}"#)).unwrap();
        let [measured] = observed.recordings[0][..] else { panic!("{observed:?}") };
        assert_eq!((measured.width, measured.is_occlusion, measured.tree), (4, true, 1));
        assert_eq!((measured.sample.counted.misses, measured.sample.seconds), (5, 6.0));
    }
}
