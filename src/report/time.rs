//! Measured times as rows that every report shows: trees under each of our traversals and under Embree's kernels.

use super::costs::estimates;
use super::{tree_names, version};
use crate::compare::explained::{self, Fitted, Ranking, Ranks};
use crate::compare::fit::Estimate;
use crate::compare::timing::{Seconds, Time, Timing, Way};
use crate::compare::{Comparison, RecordingResult, relative};
use crate::format::rays::kind::OCCLUSION;

/// One contender's times, in nanoseconds per query; `None` where it could not be asked.
pub(crate) struct TimeRow {
    pub name: String,
    pub order: String,
    pub total: Option<Nanoseconds>,
    /// Relative to the first tree under the same traversal, its queries one by one; under Embree's kernels, to the first tree there,
    /// or to Embree's own where that is not planted.
    pub ratio: Option<f64>,
    /// As [`groups`], in the same order.
    pub by_group: Vec<Option<f64>>,
}

/// Per query, over the rounds.
#[derive(Clone, Copy)]
pub(crate) struct Nanoseconds {
    pub median: f64,
    pub least: f64,
    pub greatest: f64,
}

impl Nanoseconds {
    pub fn of(seconds: &Seconds, queries: u64) -> Nanoseconds {
        let Seconds { median, least, greatest } = *seconds;
        let [median, least, greatest] =
            [median, least, greatest].map(|seconds| seconds * 1e9 / queries.max(1) as f64);
        Nanoseconds { median, least, greatest }
    }

    /// Between the greatest and the least, relative to the median.
    pub fn spread(&self) -> f64 {
        if self.median > 0.0 { (self.greatest - self.least) / self.median } else { 0.0 }
    }
}

/// Kinds and purposes that were timed, by name.
pub(crate) fn groups(timing: &Timing) -> Vec<&'static str> {
    let kinds = timing.by_kind.keys().map(|&kind| if kind == OCCLUSION { "occlusion" } else { "closest" });
    kinds.chain(timing.by_purpose.keys().map(|purpose| purpose.name())).collect()
}

/// A row per traversal, tree and way of asking, then for Embree's kernels on each tree and on their own; none when nothing was timed.
pub(crate) fn rows(comparison: &Comparison, recording: &RecordingResult) -> Vec<TimeRow> {
    let Some(timing) = &recording.timing else { return Vec::new() };
    let names = tree_names(comparison);
    let mut rows = Vec::new();
    for (run, traversal) in comparison.settings.traversals.iter().enumerate() {
        let first = Some(&timing.trees[0][run]);
        for ((tree, by_way), name) in timing.trees.iter().zip(&timing.by_way).zip(&names) {
            rows.push(row(timing, name.clone(), traversal.name().to_owned(), Some(&tree[run]), first));
            for (way, time) in timing.ways.iter().zip(&by_way[run]) {
                let order = format!("{}, {}", traversal.name(), way_name(way));
                rows.push(row(timing, name.clone(), order, Some(time), first));
            }
        }
    }
    if let (Some(times), Some(Ok(kernels))) = (&timing.kernels, &comparison.kernels) {
        let base = times.base();
        for (time, name) in times.trees.iter().zip(names) {
            rows.push(row(timing, name, "Embree".to_owned(), time.as_ref(), base));
        }
        let library = format!("{} {}", version(kernels.version), kernels.isa).trim_end().to_owned();
        let flattened = if kernels.is_flattened { ", flattened" } else { "" };
        for (time, quality) in times.own.iter().zip(&kernels.own) {
            // What it is stands in the wider column, and in full below the table of its kernels.
            let order = format!("{library} {quality}{flattened}");
            rows.push(row(timing, "Embree".to_owned(), order, time.as_ref(), base));
        }
    }
    rows
}

fn row(timing: &Timing, name: String, order: String, time: Option<&Time>, first: Option<&Time>) -> TimeRow {
    let total = |time: &Time| Nanoseconds::of(&time.total, timing.queries);
    let ratio = |time: &Time| Some(relative(time.total.median, first?.total.median));
    let of_kind = |(kind, queries): (&u8, &u64)| {
        let seconds = time?.by_kind.get(kind)?;
        Some(Nanoseconds::of(seconds, *queries).median)
    };
    let of_purpose = |(purpose, queries): (&_, &u64)| {
        let seconds = time?.by_purpose.get(purpose)?;
        Some(Nanoseconds::of(seconds, *queries).median)
    };
    let kinds = timing.by_kind.iter().map(of_kind);
    TimeRow {
        name,
        order,
        total: time.map(total),
        ratio: time.and_then(ratio),
        by_group: kinds.chain(timing.by_purpose.iter().map(of_purpose)).collect(),
    }
}

/// A number of nanoseconds for people.
pub(crate) fn shown(ns: Option<f64>) -> String {
    ns.map_or("—".to_owned(), |ns| format!("{ns:.1}"))
}

/// A way of asking, for people.
fn way_name(way: &Way) -> String {
    let packets = way.packet.map(|size| format!("packets of {size}"));
    packets.into_iter().chain(way.sorted.then(|| "sorted".to_owned())).collect::<Vec<_>>().join(", ")
}

/// The key of a way of asking in JSON.
pub(crate) fn way_key(way: &Way) -> &'static str {
    match (way.packet.is_some(), way.sorted) {
        (true, true) => "packets_sorted",
        (true, false) => "packets",
        (false, _) => "sorted",
    }
}

/// How it was measured, in a sentence.
pub(crate) fn method(timing: &Timing) -> String {
    let processor = match timing.processor {
        Some(number) => format!("one thread on processor {number}"),
        None => "one thread that could not be pinned".to_owned(),
    };
    let sort = timing.sort.map_or(String::new(), |sort| {
        format!(" Sorting took {:.1} ns per query.", sort.median * 1e9 / timing.queries.max(1) as f64)
    });
    format!(
        "Processor time of {processor}, {} queries without counting, all contenders in turn; medians of {} rounds after one that \
         warms up.{sort}",
        super::grouped(timing.queries),
        timing.rounds
    )
}

/// The names of measures for people.
fn measure_name(key: &'static str) -> &'static str {
    match key {
        "cost_with_misses" => "+ misses",
        "sah_cost" => "SAH",
        "epo" => "EPO",
        "leaf_count_variability" => "LCV",
        "t_r" => "T_R",
        "gamma_r" => "Γ_R",
        "gamma" => "Γ",
        other => other,
    }
}

/// Columns of [`fits`].
pub(crate) const FIT_HEADER: [&str; 10] =
    ["By", "width", "queries", "trees", "query", "visit", "leaf", "block", "miss", "R²"];

/// Of those columns, how many are text.
pub(crate) const FIT_NAMES: usize = 3;

/// What was fitted to the times of a recording, a row for each follower, width and kind; none when that was not asked for.
pub(crate) fn fits(comparison: &Comparison, recording: &RecordingResult) -> Vec<Vec<String>> {
    fit_rows(&explained::fitted(&explained::measured(comparison, recording)))
}

/// Fits as rows.
pub(crate) fn fit_rows(fits: &[Fitted]) -> Vec<Vec<String>> {
    let row = |Fitted { follower, width, is_occlusion, trees, fit }: &Fitted| {
        let kind = if *is_occlusion { "occlusion" } else { "closest" };
        let width = width.map_or("all".to_owned(), |width| width.to_string());
        let mut cells = vec![follower.name().to_owned(), width, kind.to_owned(), trees.to_string()];
        let Some(fit) = fit else {
            cells.resize(FIT_HEADER.len(), "–".to_owned());
            return cells;
        };
        cells.extend(estimates(fit).map(|(_, it)| estimate(it)));
        cells.push(format!("{:.2}", fit.r_squared));
        cells
    };
    fits.iter().map(row).collect()
}

/// What the fits mean, in a sentence.
pub(crate) const FIT_WORDS: &str = "Time = query + visit · node visits + leaf · leaf visits + block · blocks of four + miss · misses of a simulated \
     cache of 1 MB; R²: the share of the differences between trees, for the same queries, that this explains.";

/// How measures rank the trees, a row for each follower, below a header; none when that was not asked for.
pub(crate) fn rankings(comparison: &Comparison, recording: &RecordingResult) -> Option<Ranked> {
    let rankings = explained::rankings(comparison, recording);
    if rankings.is_empty() {
        return None;
    }
    let mut ranked = Ranked { header: vec!["By", "trees", "pairs"], rows: Vec::new() };
    for Ranking { follower, trees, ranks } in rankings {
        let Some(Ranks { pairs, measures }) = ranks else { continue };
        if ranked.rows.is_empty() {
            ranked.header.extend(measures.iter().map(|(key, _)| measure_name(key)));
        }
        let tau = |(_, tau): &(_, Option<f64>)| tau.map_or("–".to_owned(), |tau| format!("{tau:.2}"));
        let mut cells = vec![follower.name().to_owned(), trees.to_string(), pairs.to_string()];
        cells.extend(measures.iter().map(tau));
        ranked.rows.push(cells);
    }
    Some(ranked)
}

/// A table of ranks; without rows there are too few trees for it.
pub(crate) struct Ranked {
    pub header: Vec<&'static str>,
    pub rows: Vec<Vec<String>>,
}

/// The title of a table of ranks.
pub(crate) const RANKED: &str =
    "How measures rank the trees by time, Kendall's τ over pairs that differ by more than 2%";

/// A fitted cost in nanoseconds with its standard error; a dash where it could not be told.
fn estimate(estimate: Option<Estimate>) -> String {
    let text = |Estimate { value, error }| format!("{value:.1} ± {error:.1}");
    estimate.map_or("–".to_owned(), text)
}

/// Text in lines that fit a terminal.
pub(crate) fn wrapped(text: &str) -> String {
    const WIDTH: usize = 100;
    let mut lines = String::new();
    let mut used = 0;
    for word in text.split(' ') {
        let length = word.chars().count();
        if used > 0 {
            let full = used + 1 + length > WIDTH;
            lines.push(if full { '\n' } else { ' ' });
            used = if full { 0 } else { used + 1 };
        }
        lines.push_str(word);
        used += length;
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_full_but_not_too_long() {
        let text = "word ".repeat(60);
        let lines = wrapped(text.trim_end());
        assert_eq!(lines.lines().count(), 3);
        assert!(lines.lines().all(|line| line.len() <= 100 && line.split(' ').all(|word| word == "word")));
    }
}
