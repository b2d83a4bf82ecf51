//! Results for people and scripts: a comparison as tables, JSON, CSV and heat maps; plots that could go in a paper.

pub mod csv;
pub mod heatmap;
pub mod json;
pub mod plot;
pub mod table;

use crate::compare::{depth_name, kind_name};
use crate::replay::tally::{Tallies, Tally};

/// One way of grouping queries, and one of its groups.
pub(crate) struct Group<'a> {
    /// "total", "kind", "depth" or "purpose".
    pub by: &'static str,
    pub name: String,
    pub tally: &'a Tally,
}

/// Every group of a replay: the total first, then by kind, depth and purpose, each in its own order.
pub(crate) fn groups(tallies: &Tallies) -> Vec<Group<'_>> {
    let mut groups = vec![Group { by: "total", name: "all".to_owned(), tally: &tallies.total }];
    let mut add = |by, name: String, tally| groups.push(Group { by, name, tally });
    tallies.by_kind.iter().for_each(|(kind, tally)| add("kind", kind_name(*kind).to_owned(), tally));
    tallies.by_depth.iter().for_each(|(depth, tally)| add("depth", depth_name(*depth), tally));
    tallies.by_purpose.iter().for_each(|(purpose, tally)| add("purpose", purpose.name().to_owned(), tally));
    groups
}

/// `sum` per query; 0 without queries.
pub(crate) fn mean(sum: u64, queries: u64) -> f64 {
    if queries == 0 { 0.0 } else { sum as f64 / queries as f64 }
}
