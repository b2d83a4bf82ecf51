//! Measured times as rows that every report shows: trees under each traversal, and Embree.

use super::tree_names;
use crate::compare::fit::Estimate;
use crate::compare::timing::{Seconds, Time, Timing, Way};
use crate::compare::{Comparison, RecordingResult};

/// One contender's times, in nanoseconds per query.
pub(crate) struct TimeRow {
    pub name: String,
    pub order: String,
    pub median: f64,
    pub least: f64,
    pub greatest: f64,
    /// Relative to the first tree under the same traversal, its queries one by one; Embree to the first of all.
    pub ratio: f64,
    /// As [`purposes`], in the same order.
    pub by_purpose: Vec<f64>,
}

/// Purposes that were timed, by name.
pub(crate) fn purposes(timing: &Timing) -> Vec<&'static str> {
    timing.by_purpose.keys().map(|purpose| purpose.name()).collect()
}

/// A row per traversal, tree and way of asking, then Embree's; none when nothing was timed.
pub(crate) fn rows(comparison: &Comparison, recording: &RecordingResult) -> Vec<TimeRow> {
    let Some(timing) = &recording.timing else { return Vec::new() };
    let names = tree_names(comparison);
    let mut rows = Vec::new();
    for (run, traversal) in comparison.settings.traversals.iter().enumerate() {
        let first = &timing.trees[0][run];
        for ((tree, by_way), name) in timing.trees.iter().zip(&timing.by_way).zip(&names) {
            rows.push(row(timing, name.clone(), traversal.name().to_owned(), &tree[run], first));
            for (way, time) in timing.ways.iter().zip(&by_way[run]) {
                let order = format!("{}, {}", traversal.name(), way_name(way));
                rows.push(row(timing, name.clone(), order, time, first));
            }
        }
    }
    if let Some(embree) = &timing.embree {
        rows.push(row(timing, "Embree".to_owned(), "its own".to_owned(), &embree.time, &timing.trees[0][0]));
    }
    rows
}

fn row(timing: &Timing, name: String, order: String, time: &Time, first: &Time) -> TimeRow {
    let per_query = |seconds: f64, queries: u64| seconds * 1e9 / queries.max(1) as f64;
    let Seconds { median, least, greatest } = time.total;
    let [median, least, greatest] =
        [median, least, greatest].map(|seconds| per_query(seconds, timing.queries));
    let of_purpose = |(purpose, queries): (&_, &u64)| {
        per_query(time.by_purpose.get(purpose).map_or(0.0, |seconds| seconds.median), *queries)
    };
    TimeRow {
        name,
        order,
        median,
        least,
        greatest,
        ratio: crate::compare::relative(time.total.median, first.total.median),
        by_purpose: timing.by_purpose.iter().map(of_purpose).collect(),
    }
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
    let embree = match &timing.embree {
        Some(embree) if embree.differing > 0 => format!(
            " Embree, without the recording's filters and masks, answers {} queries otherwise.",
            embree.differing
        ),
        _ => String::new(),
    };
    let sort = timing.sort.map_or(String::new(), |sort| {
        format!(" Sorting took {:.1} ns per query.", sort.median * 1e9 / timing.queries.max(1) as f64)
    });
    format!(
        "Processor time of {processor}, {} queries without counting, all contenders in turn; median, least and greatest of \
         {} rounds after one that warms up.{sort}{embree}",
        super::grouped(timing.queries),
        timing.rounds
    )
}

/// The names of measures for people.
pub(crate) fn measure_name(key: &str) -> &str {
    match key {
        "sah_cost" => "SAH",
        "epo" => "EPO",
        "leaf_count_variability" => "LCV",
        "t_r" => "T_R",
        "gamma_r" => "Γ_R",
        "gamma" => "Γ",
        other => other,
    }
}

/// A fitted cost in nanoseconds with its standard error; a dash where it could not be told.
pub(crate) fn estimate(estimate: Option<Estimate>) -> String {
    let text = |Estimate { value, error }| format!("{:.2} ± {:.2}", value * 1e9, error * 1e9);
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
