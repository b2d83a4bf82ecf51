//! Results for people and scripts: a comparison as tables, JSON, CSV, heat maps and a page; plots that could go in a paper.

pub mod circumstances;
pub mod costs;
pub mod csv;
pub mod heatmap;
pub mod html;
pub mod json;
mod json_kernels;
mod json_time;
mod kernels;
mod packets;
pub mod plot;
pub mod table;
mod time;

pub(crate) use crate::compare::kernels::version;
use crate::compare::{Comparison, RecordingResult, depth_name, kind_name};
use crate::replay::tally::{GAMMA_UNITS, Tallies, Tally};

/// One way of grouping queries, and one of its groups.
pub(crate) struct Group<'a> {
    /// "total", "kind", "depth" or "purpose".
    pub by: &'static str,
    pub name: String,
    pub tally: &'a Tally,
}

impl Group<'_> {
    /// For people.
    pub fn title(&self) -> String {
        match self.by {
            "depth" => format!("depth {}", self.name),
            _ => self.name.replace('_', " "),
        }
    }
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

/// How many answers triangles cannot judge, and why; `None` when they can judge all.
pub(crate) fn unjudged(recording: &RecordingResult) -> Option<String> {
    let runs = || recording.trees.iter().flat_map(|tree| &tree.runs).map(|run| &run.outcome.tallies.total);
    let most = |count: fn(&Tally) -> u64| runs().map(count).max().unwrap_or(0);
    let reasons = [
        (most(|tally| tally.moving), "met what moves"),
        (most(|tally| tally.unchecked), "met what is not a triangle, or were ended by the program"),
    ];
    let said: Vec<String> = reasons
        .iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, reason)| format!("{} that {reason}", grouped(*count)))
        .collect();
    (!said.is_empty()).then(|| said.join(", "))
}

/// `sum` per query; 0 without queries.
pub(crate) fn mean(sum: u64, queries: u64) -> f64 {
    if queries == 0 { 0.0 } else { sum as f64 / queries as f64 }
}

/// A quantile of Γ per query.
pub(crate) fn gamma_quantile(tally: &Tally, fraction: f64) -> f64 {
    tally.gamma.quantile(fraction) as f64 / GAMMA_UNITS
}

/// The name of a file without its folder and the ending of trees.
pub(crate) fn stem(path: &str) -> &str {
    let file = path.rsplit('/').next().unwrap_or(path);
    file.strip_suffix(".bvh").unwrap_or(file)
}

/// What each tree is called: the stem of its file, numbered where several have the same.
pub(crate) fn tree_names(comparison: &Comparison) -> Vec<String> {
    let stems: Vec<&str> = comparison.trees.iter().map(|tree| stem(&tree.path)).collect();
    let name = |(index, name): (usize, &&str)| {
        let unique = stems.iter().filter(|other| *other == name).count() == 1;
        if unique { (*name).to_owned() } else { format!("{}: {name}", index + 1) }
    };
    stems.iter().enumerate().map(name).collect()
}

/// 1234567 as 1,234,567.
pub(crate) fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_grouped_by_thousands() {
        for (number, text) in [(0, "0"), (999, "999"), (1000, "1,000"), (1234567, "1,234,567")] {
            assert_eq!(grouped(number), text);
        }
    }

    #[test]
    fn stems_are_what_is_between_folder_and_ending() {
        assert_eq!([stem("a/b.c.bvh"), stem("x"), stem("/d.bvh/e.rays")], ["b.c", "x", "e.rays"]);
    }
}
