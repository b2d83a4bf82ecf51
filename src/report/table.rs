//! A comparison for people: a summary, the trees, and where the queries' costs come from, each within 100 columns.

use super::{grouped, groups, kernels, mean, packets, time, tree_names, unjudged};
use crate::compare::explained::Fitted;
use crate::compare::limit::Metric;
use crate::compare::{Comparison, RecordingResult, explained, relative};
use crate::traverse::Counts;
use comfy_table::presets::UTF8_BORDERS_ONLY;
use comfy_table::{Cell, CellAlignment, ContentArrangement, Table};

/// Columns of a terminal that everything fits in.
const WIDTH: u16 = 100;

/// The whole comparison: a block per recording. `details`: also tests by level of the tree, where they were counted.
pub fn render(comparison: &Comparison, details: bool) -> String {
    let names = names(comparison);
    let several = comparison.recordings.len() > 1;
    let mut text = String::new();
    for recording in &comparison.recordings {
        if several {
            text += &format!("Recording {}\n\n", recording.path);
        }
        text += &block(comparison, recording, &names, details);
        if several {
            text.push('\n');
        }
    }
    let costs = &comparison.settings.costs;
    text += &format!(
        "\ncost: ns that a query is expected to take, from visits, leaf visits and blocks of four triangles.\n\
         ratio: relative to the first tree's. Γ = {} · box tests + {} · primitive tests. T_R: inner nodes\n\
         that effective segments overlap. Γ_R: Γ of strict front-to-back order over those segments. EPO:\n\
         end-point overlap. LCV: leaf count variability. µs: on one thread, with counting.\n",
        costs.c_i, costs.c_p
    );
    if comparison.mixes_widths() {
        text += "–: a machine tests the boxes of a node together, so Γ does not compare trees of different widths;\n\
                 bvh-build --binary makes them alike.\n";
    }
    text
}

fn block(comparison: &Comparison, recording: &RecordingResult, names: &[String], details: bool) -> String {
    let mut text = format!("Cost per query\n{}\n", summary(comparison, recording, names));
    if let Some(baseline) = against_baseline(comparison, recording, names) {
        text += &format!("\nAgainst the baseline\n{baseline}\n");
    }
    text += &format!("\nCounts per query\n{}\n", counts(comparison, recording, names));
    if let Some(unjudged) = unjudged(recording) {
        text += &format!("not judged: {unjudged}\n");
    }
    text += &format!("\nTrees\n{}\n", trees(comparison, recording, names));
    if let Some(size) = comparison.settings.packet {
        text +=
            &format!("\n{}\n{}\n", packets::title(comparison, size), packets(comparison, recording, names));
    }
    text += &times(comparison, recording);
    if let Some(why) = &comparison.left_out {
        text += &format!("\n{}\n", time::wrapped(why));
    }
    text += &embrees(comparison, recording);
    for (index, traversal) in comparison.settings.traversals.iter().enumerate() {
        if let Some(levels) = levels(recording, names, index).filter(|_| details) {
            text += &format!("\nBy level of the tree, per query: {}\n{levels}\n", traversal.name());
        }
        text += &format!(
            "\nBy kind, depth and purpose: {}\n{}\n",
            traversal.name(),
            breakdown(comparison, recording, names, index)
        );
    }
    text
}

/// By which rule packets decided.
fn packets(comparison: &Comparison, recording: &RecordingResult, names: &[String]) -> Table {
    let row = |row: packets::Row| {
        let mut cells = vec![names[row.tree].clone(), row.order.to_owned(), row.queries];
        cells.push(format!("{:.2}", row.decisions));
        cells.extend(row.shares.map(|share| format!("{:.1}%", 100.0 * share)));
        cells.push(format!("{:.2}", row.octets));
        cells
    };
    let rows = packets::rows(comparison, recording).into_iter().map(row).collect();
    table(&packets::HEADER, 3, rows)
}

/// Measured times, and what was fitted to them; empty when nothing was timed.
fn times(comparison: &Comparison, recording: &RecordingResult) -> String {
    let Some(timing) = &recording.timing else { return String::new() };
    let groups = time::groups(timing);
    let header = [&["Tree", "Order", "ns", "ratio"][..], &groups].concat();
    let row = |row: time::TimeRow| {
        let mut cells = vec![shortened(row.name), row.order];
        cells.push(time::shown(row.total.map(|total| total.median)));
        cells.push(row.ratio.map_or("—".to_owned(), |ratio| format!("{ratio:.3}")));
        cells.extend(row.by_group.into_iter().map(time::shown));
        cells
    };
    let timed = time::rows(comparison, recording);
    let spreads = timed.iter().filter_map(|row| Some(row.total?.spread()));
    let method =
        format!("{} At most {:.1}% apart.", time::method(timing), 100.0 * spreads.fold(0.0, f64::max));
    let rows = timed.into_iter().map(row).collect();
    let mut text = format!("\nTime per query, ns\n{}\n{}\n", table(&header, 2, rows), time::wrapped(&method));
    let fits = time::fits(comparison, recording);
    if !fits.is_empty() {
        text += &format!("\n{}", fit_table(fits));
    }
    match time::rankings(comparison, recording) {
        Some(ranked) if ranked.rows.is_empty() => text += &format!("\n{}\n", explained::TOO_FEW),
        Some(time::Ranked { header, rows }) => {
            text += &format!("\n{}\n{}\n", time::RANKED, table(&header, 1, rows));
        }
        None => {}
    }
    text
}

/// Fitted costs, and what they mean.
pub fn fitted(fits: &[Fitted]) -> String {
    fit_table(time::fit_rows(fits))
}

fn fit_table(rows: Vec<Vec<String>>) -> String {
    let table = table(&time::FIT_HEADER, time::FIT_NAMES, rows);
    format!("Fitted costs, ns ± standard error\n{table}\n{}\n", time::wrapped(time::FIT_WORDS))
}

/// Embree's kernels on each tree; empty when they were not asked.
fn embrees(comparison: &Comparison, recording: &RecordingResult) -> String {
    let Some(kernels::Shown { header, mut rows, notes }) = kernels::shown(comparison, recording) else {
        return String::new();
    };
    rows.iter_mut().for_each(|row| row[0] = shortened(std::mem::take(&mut row[0])));
    let mut text = "\nEmbree's kernels on each tree\n".to_owned();
    if !rows.is_empty() {
        text += &format!("{}\n", table(&header, 1, rows));
    }
    notes.iter().for_each(|note| text += &format!("{}\n", time::wrapped(note)));
    text
}

/// What each tree is called: the end of its name where that is long.
fn names(comparison: &Comparison) -> Vec<String> {
    tree_names(comparison).into_iter().map(shortened).collect()
}

fn shortened(name: String) -> String {
    const LONGEST: usize = 16;
    if name.chars().count() <= LONGEST {
        return name;
    }
    let tail: Vec<char> = name.chars().rev().take(LONGEST - 1).collect();
    std::iter::once('…').chain(tail.into_iter().rev()).collect()
}

/// A table whose columns are right-aligned from the `text`-th on.
fn table(header: &[&str], text: usize, rows: Vec<Vec<String>>) -> Table {
    let mut table = Table::new();
    table.load_style(UTF8_BORDERS_ONLY).set_content_arrangement(ContentArrangement::Dynamic).set_width(WIDTH);
    let row = |cells: Vec<String>| {
        cells.into_iter().enumerate().map(move |(column, cell)| {
            let alignment = if column < text { CellAlignment::Left } else { CellAlignment::Right };
            Cell::new(cell).set_alignment(alignment)
        })
    };
    table.set_header(row(header.iter().map(|title| title.to_string()).collect()));
    for cells in rows {
        table.add_row(row(cells));
    }
    table
}

/// A number, or a dash where there is none.
fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("–".to_owned(), |value| format!("{value:.digits$}"))
}

fn summary(comparison: &Comparison, recording: &RecordingResult, names: &[String]) -> Table {
    let mut rows = Vec::new();
    for (place, (tree, name)) in recording.trees.iter().zip(names).enumerate() {
        for (run, first) in tree.runs.iter().zip(&recording.trees[0].runs) {
            let (total, first) = (&run.outcome.tallies.total, &first.outcome.tallies.total);
            rows.push(vec![
                name.clone(),
                run.traversal.name().to_owned(),
                number(comparison.cost(place, total), 2),
                number(comparison.cost_ratio(place, total, first), 3),
                total.mismatches.to_string(),
                total.borderline.to_string(),
            ]);
        }
    }
    table(&["Tree", "Order", "cost", "ratio", "wrong", "borderline"], 2, rows)
}

/// What each tree costs under the first traversal, and what it did in an earlier report.
fn against_baseline(comparison: &Comparison, recording: &RecordingResult, names: &[String]) -> Option<Table> {
    comparison.settings.baseline.as_ref()?;
    let place = comparison.recordings.iter().position(|other| std::ptr::eq(other, recording))?;
    let then = comparison.at_baseline(place, Metric::Cost);
    let mut rows = Vec::new();
    for (tree, (name, then)) in names.iter().zip(then).enumerate() {
        let now = comparison.cost(tree, &recording.trees[tree].runs[0].outcome.tallies.total);
        let ratio = then.zip(now).map(|(then, now)| relative(now, then));
        rows.push(vec![name.clone(), number(then, 2), number(now, 2), number(ratio, 3)]);
    }
    Some(table(&["Tree", "cost then", "now", "ratio"], 1, rows))
}

/// What explains the cost: what was visited and tested.
fn counts(comparison: &Comparison, recording: &RecordingResult, names: &[String]) -> Table {
    let costs = &comparison.settings.costs;
    let mut rows = Vec::new();
    for (place, (tree, name)) in recording.trees.iter().zip(names).enumerate() {
        for (run, first) in tree.runs.iter().zip(&recording.trees[0].runs) {
            let (total, first) = (&run.outcome.tallies.total, &first.outcome.tallies.total);
            let Counts { box_tests, node_visits, primitive_tests, leaf_visits, block_tests } = total.counts;
            let mut cells = vec![name.clone(), run.traversal.name().to_owned()];
            let counts = [node_visits, leaf_visits, block_tests, box_tests, primitive_tests];
            cells.extend(counts.map(|sum| format!("{:.2}", mean(sum, total.queries))));
            cells.push(format!("{:.2}", costs.gamma(&total.counts) / total.queries as f64));
            cells.push(number(comparison.gamma_ratio(place, total, first), 3));
            cells.push(format!("{:.2}", total.seconds * 1e6 / total.queries as f64));
            rows.push(cells);
        }
    }
    let header = ["Tree", "Order", "visits", "leaves", "blocks", "boxes", "prims", "Γ", "ratio", "µs"];
    table(&header, 2, rows)
}

fn trees(comparison: &Comparison, recording: &RecordingResult, names: &[String]) -> Table {
    let costs = &comparison.settings.costs;
    let mut rows = Vec::new();
    for (place, ((facts, tree), name)) in comparison.trees.iter().zip(&recording.trees).zip(names).enumerate()
    {
        let statistics = &facts.statistics;
        let gamma = tree.gamma(costs);
        rows.push(vec![
            name.clone(),
            grouped(statistics.nodes as u64),
            grouped(statistics.leaves as u64),
            statistics.depth.to_string(),
            statistics.max_children.to_string(),
            format!("{:.2}", facts.sah_cost),
            format!("{:.3}", facts.epo),
            format!("{:.2}", tree.leaf_count_variability()),
            format!("{:.3e}", tree.t_r() as f64),
            format!("{gamma:.3e}"),
            number(comparison.gamma_r_ratio(recording, place), 3),
        ]);
    }
    let header = ["Tree", "nodes", "leaves", "depth", "width", "SAH", "EPO", "LCV", "T_R", "Γ_R", "ratio"];
    table(&header, 1, rows)
}

/// Levels of the tree in a row: the last one stands for all below.
const LEVELS_SHOWN: usize = 16;

/// Tests by level, where they were counted; the cache lines in the last row.
fn levels(recording: &RecordingResult, names: &[String], run: usize) -> Option<Table> {
    let mut rows = Vec::new();
    for (tree, name) in recording.trees.iter().zip(names) {
        let outcome = &tree.runs[run].outcome;
        let queries = outcome.tallies.total.queries;
        let profile = outcome.profile.as_ref()?;
        let deepest = profile.levels.len() - 1;
        for level in 0..=deepest.min(LEVELS_SHOWN - 1) {
            let last = level + 1 == LEVELS_SHOWN && level < deepest;
            let range = if last { level..=deepest } else { level..=level };
            let counts = profile.levels[range].iter().fold(Counts::default(), |mut sum, counts| {
                sum += *counts;
                sum
            });
            rows.push(vec![
                if level == 0 { name.clone() } else { String::new() },
                format!("{level}{}", if last { " and below" } else { "" }),
                format!("{:.3}", mean(counts.box_tests, queries)),
                format!("{:.3}", mean(counts.node_visits, queries)),
                format!("{:.3}", mean(counts.primitive_tests, queries)),
            ]);
        }
        let lines = format!("{:.2}", mean(profile.cache_lines, queries));
        rows.push(vec![String::new(), "cache lines".to_owned(), lines, String::new(), String::new()]);
    }
    Some(table(&["Tree", "level", "boxes", "visits", "prims"], 2, rows))
}

/// Depths beyond this stand in JSON and CSV only.
const DEPTHS_SHOWN: usize = 8;

fn breakdown(comparison: &Comparison, recording: &RecordingResult, names: &[String], run: usize) -> Table {
    let tallies: Vec<_> =
        recording.trees.iter().map(|tree| groups(&tree.runs[run].outcome.tallies)).collect();
    let mut rows = Vec::new();
    let mut depths = 0;
    // Every tree sees the same queries, so all have the same groups.
    for index in 1..tallies[0].len() {
        let first = &tallies[0][index];
        depths += (first.by == "depth") as usize;
        if first.by == "depth" && depths > DEPTHS_SHOWN {
            continue;
        }
        for (place, (groups, name)) in tallies.iter().zip(names).enumerate() {
            let Some(group) = groups.get(index) else { continue };
            let tally = group.tally;
            let is_first = std::ptr::eq(groups, &tallies[0]);
            rows.push(vec![
                if is_first { group.title() } else { String::new() },
                name.clone(),
                if is_first { grouped(tally.queries) } else { String::new() },
                number(comparison.cost(place, tally), 2),
                number(comparison.cost_ratio(place, tally, first.tally), 3),
                format!("{:.1}", mean(tally.counts.box_tests, tally.queries)),
                tally.box_tests.quantile(0.5).to_string(),
                tally.box_tests.quantile(0.99).to_string(),
                format!("{:.1}", mean(tally.counts.node_visits, tally.queries)),
                format!("{:.2}", mean(tally.counts.primitive_tests, tally.queries)),
            ]);
        }
    }
    let header = ["Queries", "Tree", "count", "cost", "ratio", "boxes", "median", "p99", "visits", "prims"];
    table(&header, 2, rows)
}
