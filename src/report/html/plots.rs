//! The charts of one recording: costs of groups of queries, how costs are distributed, and where in the tree they fall.

use super::super::{Group, groups, mean, stem};
use super::chart::{self, Bar, Line, short};
use crate::compare::{Comparison, RecordingResult};
use crate::replay::tally::{GAMMA_UNITS, Tally};
use maud::{Markup, html};

/// Depths of queries beyond this have no bars.
const DEPTHS_SHOWN: usize = 8;

/// What a query of every group costs, a bar per tree, in two parts: visits of nodes, and leaves. Of packets, which have no cost, Γ: box tests and
/// primitive tests.
pub fn group_bars(
    comparison: &Comparison,
    recording: &RecordingResult,
    names: &[String],
    run: usize,
) -> Markup {
    let costs = &comparison.settings.costs;
    let tallies: Vec<Vec<Group>> =
        recording.trees.iter().map(|tree| groups(&tree.runs[run].outcome.tallies)).collect();
    let is_cost = comparison.settings.packet.is_none();
    let measure = if is_cost { "Cost, ns" } else { "Γ" };
    let bar = |series: usize, tally: &Tally, first: &Tally| {
        let queries = tally.queries.max(1) as f64;
        let tests = [
            costs.c_i * tally.counts.box_tests as f64 / queries,
            costs.c_p * tally.counts.primitive_tests as f64 / queries,
        ];
        let parts = if is_cost { comparison.cost_parts(series, tally).unwrap_or_default() } else { tests };
        let sum = parts[0] + parts[1];
        let ratio = match is_cost {
            true => comparison.cost_ratio(series, tally, first),
            false => comparison.gamma_ratio(series, tally, first),
        };
        let (factor, share) = match ratio.filter(|_| series > 0) {
            Some(ratio) => (format!(" (×{ratio:.2})"), format!(", {ratio:.3} of {}", names[0])),
            None => Default::default(),
        };
        Bar {
            series,
            parts,
            value: format!("{}{factor}", short(sum)),
            tooltip: format!(
                "{}: {measure} {} per query{share}; visits {}, boxes {}, primitives {}",
                names[series],
                short(sum),
                short(mean(tally.counts.node_visits, tally.queries)),
                short(mean(tally.counts.box_tests, tally.queries)),
                short(mean(tally.counts.primitive_tests, tally.queries))
            ),
        }
    };
    let mut depths = 0;
    let mut rows = Vec::new();
    for (index, first) in tallies[0].iter().enumerate() {
        depths += usize::from(first.by == "depth");
        if first.by == "depth" && depths > DEPTHS_SHOWN {
            continue;
        }
        let bars = tallies.iter().enumerate().filter_map(|(series, groups)| {
            groups.get(index).map(|group| bar(series, group.tally, first.tally))
        });
        rows.push((first.title(), bars.collect()));
    }
    let traversal = comparison.settings.traversals[run].name();
    figure(
        &format!("{measure} per query, {traversal}"),
        if is_cost {
            "solid: visits of nodes, light: leaves; × relative to the first tree"
        } else {
            "solid: box tests, light: primitive tests; × relative to the first tree"
        },
        chart::bars(&format!("{measure} per query by group under {traversal}"), &rows),
    )
}

/// Parts of a power of two in a histogram.
const BINS: f64 = 4.0;

/// How many queries cost how much.
pub fn histogram(
    comparison: &Comparison,
    recording: &RecordingResult,
    names: &[String],
    run: usize,
) -> Markup {
    let traversal = comparison.settings.traversals[run].name();
    let lines: Vec<Line> = recording
        .trees
        .iter()
        .enumerate()
        .map(|(series, tree)| {
            let bins = bins(&tree.runs[run].outcome.tallies.total);
            Line { series, points: steps(&bins, &names[series]), steps: true }
        })
        .collect();
    let ticks: Vec<(f64, String)> =
        (0..34).step_by(2).map(|power| (f64::from(power) * BINS, short(2f64.powi(power)))).collect();
    figure(
        &format!("Distribution of Γ, {traversal}"),
        "queries by what they cost, logarithmic; further left is better",
        chart::lines(
            &format!("Distribution of Γ per query under {traversal}"),
            "Γ of a query",
            "% of queries",
            &ticks,
            &lines,
        ),
    )
}

/// Percent of the queries by quarter of a power of two of their Γ; the first bin takes what is below 1, too.
fn bins(tally: &Tally) -> Vec<f64> {
    let mut bins: Vec<f64> = Vec::new();
    for (value, count) in tally.gamma.entries() {
        let gamma = value as f64 / GAMMA_UNITS;
        let bin = (gamma.max(1.0).log2() * BINS) as usize;
        if bin >= bins.len() {
            bins.resize(bin + 1, 0.0);
        }
        bins[bin] += 100.0 * count as f64 / tally.queries.max(1) as f64;
    }
    bins
}

/// The outline of a histogram, from its first bin that is not empty.
fn steps(bins: &[f64], name: &str) -> Vec<(f64, f64, String)> {
    let first = bins.iter().position(|bin| *bin > 0.0).unwrap_or(0);
    let edge = |bin: usize| 2f64.powf(bin as f64 / BINS);
    let tooltip = |bin: usize, share: f64| {
        format!("{name}: {share:.2}% of the queries cost {} to {}", short(edge(bin)), short(edge(bin + 1)))
    };
    let inner = bins.iter().enumerate().skip(first);
    let mut points: Vec<_> = inner.map(|(bin, share)| (bin as f64, *share, tooltip(bin, *share))).collect();
    // Down to the axis on both sides.
    points.insert(0, (first as f64, 0.0, String::new()));
    points.push((bins.len() as f64, 0.0, String::new()));
    points
}

/// Box tests and primitive tests by level of the tree; `None` when they were not counted.
pub fn levels(
    comparison: &Comparison,
    recording: &RecordingResult,
    names: &[String],
    run: usize,
) -> Option<Markup> {
    let traversal = comparison.settings.traversals[run].name();
    let chart = |what: &str, pick: fn(&crate::traverse::Counts) -> u64| -> Option<Markup> {
        let mut lines = Vec::new();
        for (series, tree) in recording.trees.iter().enumerate() {
            let outcome = &tree.runs[run].outcome;
            let queries = outcome.tallies.total.queries;
            let levels = &outcome.profile.as_ref()?.levels;
            let point = |(level, counts): (usize, &crate::traverse::Counts)| {
                let tests = mean(pick(counts), queries);
                let tooltip =
                    format!("{}: {} {what} per query at level {level}", names[series], short(tests));
                (level as f64, tests, tooltip)
            };
            lines.push(Line { series, points: levels.iter().enumerate().map(point).collect(), steps: false });
        }
        let ticks: Vec<(f64, String)> =
            (0..512).step_by(10).map(|level| (f64::from(level), level.to_string())).collect();
        Some(figure(
            &format!("{what} by level, {traversal}"),
            "level 0 is the root",
            chart::lines(
                &format!("{what} by level under {traversal}"),
                "level of the tree",
                "per query",
                &ticks,
                &lines,
            ),
        ))
    };
    let boxes = chart("Box tests", |counts| counts.box_tests)?;
    let primitives = chart("Primitive tests", |counts| counts.primitive_tests)?;
    Some(html! { (boxes) (primitives) })
}

/// A chart under its title.
pub fn figure(title: &str, note: &str, chart: Markup) -> Markup {
    html! { figure { figcaption { strong { (title) } ": " (note) } (chart) } }
}

/// What a recording is called in the page.
pub fn recording_name(recording: &RecordingResult) -> &str {
    stem(&recording.path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_hold_all_queries() {
        let mut tally = Tally { queries: 8, ..Tally::default() };
        // Γ of 0, 0.5, 1, 2, 2.5, 4, 1000, 1000.
        for units in [0, 8, 16, 32, 40, 64, 16_000, 16_000] {
            tally.gamma.add(units);
        }
        let bins = bins(&tally);
        assert!((bins.iter().sum::<f64>() - 100.0).abs() < 1e-9);
        assert_eq!((bins[0], bins[4], bins[5], bins[8]), (37.5, 12.5, 12.5, 12.5));
        assert_eq!((bins.len(), bins[39]), (40, 25.0), "2^9.75 = 861, 2^10 = 1024");
        let points = steps(&bins, "tree");
        assert_eq!((points[0].1, points[points.len() - 1].1), (0.0, 0.0));
        assert!(points[1].2.starts_with("tree: 37.50% of the queries cost 1 to 1.19"), "{}", points[1].2);
    }
}
