//! The tables of a page. Each scrolls by itself where the screen is narrow, and can be reached with the keyboard.

use super::super::{Group, gamma_quantile, grouped, groups, mean, packets, tree_names};
use super::chart::short;
use crate::compare::{Comparison, RecordingResult};
use crate::traverse::Counts;
use maud::{Markup, html};

/// What the columns' abbreviations mean, as tooltips.
fn meaning(column: &str) -> Option<&'static str> {
    Some(match column {
        "boxes" => "Box tests per query: one ray against one child box, the root's included",
        "visits" => "Node visits per query: inner nodes whose children were tested",
        "primitives" => "Primitive tests per query: one ray against one triangle",
        "Γ" => "c_I · box tests + c_P · primitive tests, per query",
        "median Γ" | "p99 Γ" => "Half, or 99%, of the queries cost no more; to within 1/16",
        "ratio" => "Relative to the first tree",
        "cost" => {
            "Nanoseconds that a query is expected to take: visits, leaf visits and blocks of four triangles"
        }
        "leaves" => "Leaf visits per query",
        "blocks" => "Blocks of up to four triangles that were tested together, per query",
        "µs" => "Per query on one thread, with counting",
        "wrong" => "Answers that are not the recorded one, and cannot be right",
        "borderline" => "Queries that graze an edge or a plane, so that two answers are right",
        "/ medium" => "Time relative to Embree's own tree of medium quality",
        "/ best" => "Time relative to the better of Embree's own trees",
        "flipped" => "A hit on this tree and a miss on Embree's own, or the reverse, singly and in packets",
        "apart" => {
            "Closest hits whose t is not within 1e-4 of that on Embree's own tree, singly and in packets"
        }
        "decisions" => "Boxes for which it was decided whether a packet enters them, per query",
        "early hit" => "The first and the last eight active rays enter: all are taken to",
        "early miss" => "No ray can enter, by interval arithmetic",
        "rays" => "All active rays were tested, as neither could tell",
        "few" => "All active rays were tested at once, as they were few",
        "octets" => "Tests of eight rays against a box, per query",
        "lines" => {
            "Distinct cache lines of 64 bytes read per query: nodes of 32 bytes, triangles of 36 in leaf order"
        }
        "SAH" => "SAH cost: Σ area/root area · (c_I · children, or c_P · primitives)",
        "EPO" => "End-point overlap: cost of nodes that hold surface of other nodes, by its area",
        "LCV" => {
            "Leaf count variability: standard deviation of the leaves that a query's effective segment overlaps"
        }
        "T_R" => "Inner nodes that effective segments overlap, over all queries",
        "Γ_R" => "Γ of strict front-to-back order over all effective segments",
        _ => return None,
    })
}

/// A table in a region of its own; columns up to `text` are text.
pub fn table(caption: &str, header: &[&str], text: usize, body: Markup) -> Markup {
    html! {
        div.scroll role="region" aria-label=(caption) tabindex="0" {
            table {
                caption { (caption) }
                thead {
                    tr {
                        @for (index, column) in header.iter().enumerate() {
                            th.text[index < text] scope="col" {
                                @if let Some(meaning) = meaning(column) { abbr title=(meaning) { (column) } } @else { (column) }
                            }
                        }
                    }
                }
                (body)
            }
        }
    }
}

/// A ratio as [`ratio`] shows it, or a dash where there is none.
pub fn ratio_if(value: Option<f64>) -> Markup {
    html! { @if let Some(value) = value { (ratio(value)) } @else { "–" } }
}

/// A number, or a dash where there is none.
fn number_if(value: Option<f64>) -> Markup {
    html! { @if let Some(value) = value { (format!("{value:.2}")) } @else { "–" } }
}

/// A ratio with a mark that does without colour.
pub fn ratio(value: f64) -> Markup {
    html! {
        @if value < 0.9995 { span.better { "▼ " (format!("{value:.3}")) } }
        @else if value > 1.0005 { span.worse { "▲ " (format!("{value:.3}")) } }
        @else { (format!("{value:.3}")) }
    }
}

fn wrong(count: u64) -> Markup {
    html! { @if count > 0 { span.wrong { (grouped(count)) } } @else { "0" } }
}

/// One row per tree: what it is without any ray.
pub fn trees(comparison: &Comparison) -> Markup {
    let header = [
        "Tree",
        "triangles",
        "nodes",
        "leaves",
        "depth",
        "width",
        "largest leaf",
        "SAH",
        "EPO",
        "occlusion order",
    ];
    let body = html! {
        tbody {
            @for (tree, name) in comparison.trees.iter().zip(tree_names(comparison)) {
                @let statistics = &tree.statistics;
                tr {
                    th scope="row" { (name) }
                    @for count in [tree.triangles, statistics.nodes, statistics.leaves, statistics.depth] {
                        td { (grouped(count as u64)) }
                    }
                    td { (statistics.max_children) }
                    td { (statistics.max_leaf) }
                    td { (format!("{:.2}", tree.sah_cost)) }
                    td { (format!("{:.3}", tree.epo)) }
                    td { (tree.occlusion_order.key()) }
                }
            }
        }
    };
    table("The trees, without any ray", &header, 1, body)
}

/// What each tree costs over one recording, by traversal.
pub fn summary(comparison: &Comparison, recording: &RecordingResult) -> Markup {
    let costs = &comparison.settings.costs;
    let names = tree_names(comparison);
    let lines = recording.trees[0].runs[0].outcome.profile.is_some();
    let mut header =
        vec!["Order", "Tree", "cost", "ratio", "visits", "leaves", "blocks", "boxes", "primitives"];
    header.extend(["Γ", "median Γ", "p99 Γ", "ratio", "µs"]);
    header.extend(lines.then_some("lines"));
    header.extend(["wrong", "borderline"]);
    let body = html! {
        @for (index, traversal) in comparison.settings.traversals.iter().enumerate() {
            tbody {
                @for ((tree, name), number) in recording.trees.iter().zip(&names).zip(0..) {
                    @let outcome = &tree.runs[index].outcome;
                    @let total = &outcome.tallies.total;
                    @let first = &recording.trees[0].runs[index].outcome.tallies.total;
                    tr {
                        @if number == 0 { th scope="rowgroup" rowspan=(names.len()) { (traversal.name()) } }
                        th scope="row" { (name) }
                        td { (number_if(comparison.cost(number, total))) }
                        td { (ratio_if(comparison.cost_ratio(number, total, first))) }
                        @let Counts { box_tests, node_visits, primitive_tests, leaf_visits, block_tests } = total.counts;
                        @for sum in [node_visits, leaf_visits, block_tests, box_tests, primitive_tests] {
                            td { (format!("{:.2}", mean(sum, total.queries))) }
                        }
                        td { (format!("{:.2}", costs.gamma(&total.counts) / total.queries as f64)) }
                        td { (format!("{:.1}", gamma_quantile(total, 0.5))) }
                        td { (format!("{:.1}", gamma_quantile(total, 0.99))) }
                        td { (ratio_if(comparison.gamma_ratio(number, total, first))) }
                        td { (format!("{:.2}", total.seconds * 1e6 / total.queries as f64)) }
                        @if let Some(profile) = &outcome.profile { td { (format!("{:.1}", mean(profile.cache_lines, total.queries))) } }
                        td { (wrong(total.mismatches)) }
                        td { (grouped(total.borderline)) }
                    }
                }
            }
        }
    };
    table("Cost per query", &header, 2, body)
}

/// By which rule packets decided, where there are any.
pub fn packets(comparison: &Comparison, recording: &RecordingResult) -> Markup {
    let Some(size) = comparison.settings.packet else { return html! {} };
    let names = tree_names(comparison);
    let body = html! {
        tbody {
            @for row in packets::rows(comparison, recording) {
                tr {
                    th scope="row" { (names[row.tree]) }
                    th scope="row" { (row.order) }
                    th scope="row" { (row.queries) }
                    td { (format!("{:.2}", row.decisions)) }
                    @for share in row.shares { td { (format!("{:.1}%", 100.0 * share)) } }
                    td { (format!("{:.2}", row.octets)) }
                }
            }
        }
    };
    table(&packets::title(comparison, size), &packets::HEADER, 3, body)
}

/// What the trees have to do for the recording's effective segments, whatever the order.
pub fn segments(comparison: &Comparison, recording: &RecordingResult) -> Markup {
    let costs = &comparison.settings.costs;
    let body = html! {
        tbody {
            @for ((tree, name), number) in recording.trees.iter().zip(tree_names(comparison)).zip(0..) {
                @let gamma = tree.gamma(costs);
                tr {
                    th scope="row" { (name) }
                    td { (grouped(tree.t_r())) }
                    td { (short(gamma)) }
                    td { (ratio_if(comparison.gamma_r_ratio(recording, number))) }
                    td { (format!("{:.2}", tree.leaf_count_variability())) }
                }
            }
        }
    };
    table("What effective segments overlap", &["Tree", "T_R", "Γ_R", "ratio", "LCV"], 1, body)
}

/// Every group of queries under one traversal, the total left out.
pub fn breakdown(comparison: &Comparison, recording: &RecordingResult, run: usize) -> Markup {
    let costs = &comparison.settings.costs;
    let names = tree_names(comparison);
    let tallies: Vec<Vec<Group>> =
        recording.trees.iter().map(|tree| groups(&tree.runs[run].outcome.tallies)).collect();
    let header = [
        "Queries",
        "Tree",
        "count",
        "cost",
        "ratio",
        "boxes",
        "visits",
        "primitives",
        "Γ",
        "median Γ",
        "p99 Γ",
        "wrong",
    ];
    let body = html! {
        // Every tree sees the same queries, so all have the same groups.
        @for (index, first) in tallies[0].iter().enumerate().skip(1) {
            tbody {
                @for ((groups, name), number) in tallies.iter().zip(&names).zip(0..) {
                    @let tally = groups[index].tally;
                    @let queries = tally.queries;
                    tr {
                        @if number == 0 { th scope="rowgroup" rowspan=(names.len()) { (first.title()) } }
                        th scope="row" { (name) }
                        td { @if number == 0 { (grouped(queries)) } }
                        td { (number_if(comparison.cost(number, tally))) }
                        td { (ratio_if(comparison.cost_ratio(number, tally, first.tally))) }
                        @for sum in [tally.counts.box_tests, tally.counts.node_visits, tally.counts.primitive_tests] {
                            td { (format!("{:.2}", mean(sum, queries))) }
                        }
                        td { (format!("{:.2}", costs.gamma(&tally.counts) / queries.max(1) as f64)) }
                        td { (format!("{:.1}", gamma_quantile(tally, 0.5))) }
                        td { (format!("{:.1}", gamma_quantile(tally, 0.99))) }
                        td { (wrong(tally.mismatches)) }
                    }
                }
            }
        }
    };
    let caption = format!("By kind, depth and purpose, {}", comparison.settings.traversals[run].name());
    table(&caption, &header, 2, body)
}
