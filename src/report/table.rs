//! A comparison for people: a summary, the trees, and where the queries' costs come from, each within 100 columns.

use super::{groups, mean};
use crate::compare::{Comparison, relative};
use comfy_table::presets::UTF8_BORDERS_ONLY;
use comfy_table::{Cell, CellAlignment, ContentArrangement, Table};

/// Columns of a terminal that everything fits in.
const WIDTH: u16 = 100;

/// The whole comparison.
pub fn render(comparison: &Comparison) -> String {
    let names = names(comparison);
    let mut text = format!("Cost per query\n{}\n", summary(comparison, &names));
    text += &format!("\nTrees\n{}\n", trees(comparison, &names));
    for (index, traversal) in comparison.settings.traversals.iter().enumerate() {
        text += &format!(
            "\nBy kind, depth and purpose: {}\n{}\n",
            traversal.name(),
            breakdown(comparison, &names, index)
        );
    }
    let costs = &comparison.settings.costs;
    text += &format!(
        "\nΓ = {} · box tests + {} · primitive tests. ratio: to the first tree's. µs: on one thread, counting\n\
         included. T_R: inner nodes that effective segments overlap. Γ_R: Γ strictly front to back over those.\n",
        costs.c_i, costs.c_p
    );
    text
}

/// What each tree is called: the end of its path, as short as tells the trees apart at a glance.
fn names(comparison: &Comparison) -> Vec<String> {
    const LONGEST: usize = 16;
    let paths = || comparison.trees.iter().map(|tree| tree.path.as_str());
    let stem = |path: &str| {
        let file = path.rsplit('/').next().unwrap_or(path);
        file.strip_suffix(".bvh").unwrap_or(file).to_owned()
    };
    let stems: Vec<String> = paths().map(stem).collect();
    stems
        .iter()
        .enumerate()
        .map(|(index, name)| {
            let unique = stems.iter().filter(|other| *other == name).count() == 1;
            let name = if unique { name.clone() } else { format!("{}: {name}", index + 1) };
            if name.chars().count() <= LONGEST {
                return name;
            }
            let tail: Vec<char> = name.chars().rev().take(LONGEST - 1).collect();
            std::iter::once('…').chain(tail.into_iter().rev()).collect()
        })
        .collect()
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

fn summary(comparison: &Comparison, names: &[String]) -> Table {
    let costs = &comparison.settings.costs;
    let mut rows = Vec::new();
    for (tree, name) in comparison.trees.iter().zip(names) {
        for (run, first) in tree.runs.iter().zip(&comparison.trees[0].runs) {
            let total = &run.outcome.tallies.total;
            let per_query = |sum: u64| format!("{:.2}", mean(sum, total.queries));
            rows.push(vec![
                name.clone(),
                run.traversal.name().to_owned(),
                per_query(total.counts.box_tests),
                per_query(total.counts.node_visits),
                per_query(total.counts.primitive_tests),
                format!("{:.2}", costs.gamma(total) / total.queries as f64),
                format!("{:.3}", comparison.ratio(total, &first.outcome.tallies.total)),
                format!("{:.2}", total.seconds * 1e6 / total.queries as f64),
                total.mismatches.to_string(),
                total.borderline.to_string(),
            ]);
        }
    }
    let header = ["Tree", "Order", "boxes", "visits", "prims", "Γ", "ratio", "µs", "wrong", "borderline"];
    table(&header, 2, rows)
}

fn trees(comparison: &Comparison, names: &[String]) -> Table {
    let costs = &comparison.settings.costs;
    let first_gamma = comparison.trees[0].gamma(costs);
    let row = |(tree, name): (&crate::compare::TreeResult, &String)| {
        let statistics = &tree.statistics;
        let gamma = tree.gamma(costs);
        vec![
            name.clone(),
            grouped(statistics.nodes as u64),
            grouped(statistics.leaves as u64),
            statistics.depth.to_string(),
            statistics.max_children.to_string(),
            format!("{:.2}", tree.sah_cost),
            grouped(tree.t_r()),
            format!("{gamma:.4e}"),
            format!("{:.3}", relative(gamma, first_gamma)),
        ]
    };
    let rows = comparison.trees.iter().zip(names).map(row).collect();
    table(&["Tree", "nodes", "leaves", "depth", "width", "SAH", "T_R", "Γ_R", "ratio"], 1, rows)
}

/// Depths beyond this stand in JSON and CSV only.
const DEPTHS_SHOWN: usize = 8;

fn breakdown(comparison: &Comparison, names: &[String], run: usize) -> Table {
    let costs = &comparison.settings.costs;
    let tallies: Vec<_> =
        comparison.trees.iter().map(|tree| groups(&tree.runs[run].outcome.tallies)).collect();
    let mut rows = Vec::new();
    let mut depths = 0;
    // Every tree sees the same queries, so all have the same groups.
    for index in 1..tallies[0].len() {
        let first = &tallies[0][index];
        depths += (first.by == "depth") as usize;
        if first.by == "depth" && depths > DEPTHS_SHOWN {
            continue;
        }
        for (groups, name) in tallies.iter().zip(names) {
            let Some(group) = groups.get(index) else { continue };
            let tally = group.tally;
            let title = match group.by {
                "depth" => format!("depth {}", group.name),
                _ => group.name.replace('_', " "),
            };
            let is_first = std::ptr::eq(groups, &tallies[0]);
            rows.push(vec![
                if is_first { title } else { String::new() },
                name.clone(),
                if is_first { grouped(tally.queries) } else { String::new() },
                format!("{:.1}", mean(tally.counts.box_tests, tally.queries)),
                tally.box_tests.quantile(0.5).to_string(),
                tally.box_tests.quantile(0.99).to_string(),
                format!("{:.1}", mean(tally.counts.node_visits, tally.queries)),
                format!("{:.2}", mean(tally.counts.primitive_tests, tally.queries)),
                format!("{:.2}", costs.gamma(tally) / tally.queries.max(1) as f64),
                format!("{:.3}", comparison.ratio(tally, first.tally)),
            ]);
        }
    }
    let header = ["Queries", "Tree", "count", "boxes", "median", "p99", "visits", "prims", "Γ", "ratio"];
    table(&header, 2, rows)
}

/// 1234567 as 1,234,567.
fn grouped(number: u64) -> String {
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
}
