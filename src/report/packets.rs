//! How packets decided, as rows that every report shows: each tree under each traversal, in all and by purpose.

use super::{groups, mean};
use crate::compare::{Comparison, RecordingResult};
use crate::traverse::Decisions;

/// Columns of a table of [`Row`]s, the tree first.
pub(crate) const HEADER: [&str; 9] =
    ["Tree", "Order", "Queries", "decisions", "early hit", "early miss", "rays", "few", "octets"];

/// What packets of one group of queries decided over one tree.
pub(crate) struct Row {
    /// Index of the tree in the comparison.
    pub tree: usize,
    pub order: &'static str,
    pub queries: String,
    /// Boxes for which it was decided whether a packet enters them, per query.
    pub decisions: f64,
    /// Of those: by an early hit, by an early miss, by the tests of all rays when neither could tell, and when they were few.
    pub shares: [f64; 4],
    /// Tests of eight rays against a box, per query.
    pub octets: f64,
}

pub(crate) fn title(comparison: &Comparison, size: usize) -> String {
    let sorted =
        comparison.settings.sort.map(|sort| format!(", sorted by {}", sort.key())).unwrap_or_default();
    format!("Packets of {size} queries{sorted}: how it was decided whether one enters a box, per query")
}

/// The total and every purpose, where there are several.
pub(crate) fn rows(comparison: &Comparison, recording: &RecordingResult) -> Vec<Row> {
    let mut rows = Vec::new();
    for (index, traversal) in comparison.settings.traversals.iter().enumerate() {
        for (tree, result) in recording.trees.iter().enumerate() {
            let all = groups(&result.runs[index].outcome.tallies);
            let purposes = all.iter().filter(|group| group.by == "purpose");
            let shown = if purposes.clone().count() > 1 { usize::MAX } else { 0 };
            for group in all[..1].iter().chain(purposes.take(shown)) {
                let Decisions { early_hits, early_misses, by_rays, few, octets } = group.tally.packets;
                let total = group.tally.packets.total();
                rows.push(Row {
                    tree,
                    order: traversal.name(),
                    queries: group.name.clone(),
                    decisions: mean(total, group.tally.queries),
                    shares: [early_hits, early_misses, by_rays, few].map(|part| mean(part, total)),
                    octets: mean(octets, group.tally.queries),
                });
            }
        }
    }
    rows
}
