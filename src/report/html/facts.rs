//! What was compared: files, settings, and where and when; and the words that the page uses.

use super::super::circumstances::Circumstances;
use super::super::{grouped, tree_names, version};
use super::tables::table;
use crate::compare::Comparison;
use maud::{Markup, html};

/// Files, settings and circumstances.
pub fn section(comparison: &Comparison, circumstances: &Circumstances) -> Markup {
    html! {
        (files(comparison))
        @for (tree, name) in comparison.trees.iter().zip(tree_names(comparison)) {
            @if let Some(meta) = &tree.meta {
                details { summary { "How " (name) " was built" } pre { (pretty(meta)) } }
            }
        }
        h3 { "Settings" }
        (settings(comparison))
        h3 { "Circumstances" }
        dl.facts {
            dt { "Command" } dd { code { (circumstances.command) } }
            dt { "When" } dd { (circumstances.when) }
            dt { "Machine" } dd { (circumstances.machine) }
            dt { "Program" } dd { (circumstances.program) }
        }
    }
}

fn files(comparison: &Comparison) -> Markup {
    let body = html! {
        tbody {
            @for (tree, name) in comparison.trees.iter().zip(tree_names(comparison)) {
                tr {
                    th scope="row" { (name) }
                    td.text { code { (tree.path) } }
                    td.text { (tree.producer) }
                    td { code { (format!("{:016x}", tree.fingerprint)) } }
                    td { (grouped(tree.triangles as u64)) " triangles" }
                }
            }
        }
        tbody {
            @for recording in &comparison.recordings {
                tr {
                    th scope="row" { "recording" }
                    td.text { code { (recording.path) } }
                    td.text {
                        (recording.producer)
                        @if recording.embree_version > 0 { ", Embree " (version(recording.embree_version)) }
                    }
                    td { @if recording.fingerprint == 0 { "unknown" } @else { code { (format!("{:016x}", recording.fingerprint)) } } }
                    td {
                        (grouped(recording.queries)) " queries"
                        @if recording.scene > 0 { ", of which those of scene " (recording.scene) }
                    }
                }
            }
        }
    };
    table("Files", &["", "path", "written by", "scene", "holds"], 3, body)
}

/// JSON on several lines; what is not JSON as it stands.
fn pretty(meta: &str) -> String {
    let value = serde_json::from_str::<serde_json::Value>(meta);
    value.and_then(|value| serde_json::to_string_pretty(&value)).unwrap_or_else(|_| meta.to_owned())
}

fn settings(comparison: &Comparison) -> Markup {
    let settings = &comparison.settings;
    let choice = &settings.choice;
    let filter = choice.filter.to_string();
    let order = settings.occlusion_order.map_or("as each tree says, else nearest first", |order| order.key());
    html! {
        dl.facts {
            dt { "Queries" }
            dd {
                @if filter.is_empty() { "all" } @else { "those with " code { (filter) } }
                @if let Some(portion) = choice.held_out {
                    ", but for the " (portion.share * 100.0) "% that trees were trained with (seed " (portion.seed) ")"
                }
                @if let Some(sample) = choice.sample { ", a sample of " (grouped(sample)) " per recording" }
            }
            dt { "Costs" } dd { "c_I = " (settings.costs.c_i) " per box test, c_P = " (settings.costs.c_p) " per primitive test" }
            dt { "Occlusion order" } dd { (order) }
        }
    }
}

/// The words of the page, for readers who meet them first here.
pub fn words() -> Markup {
    let words = [
        (
            "Query",
            "A ray, its interval and a question: the closest hit, or whether anything is hit (occlusion).",
        ),
        (
            "Effective segment",
            "Of a closest-hit query the ray up to its hit, of an occlusion query its whole interval.",
        ),
        ("ODF", "Ordered depth first: the nearer child first, and what lies behind the best hit is dropped."),
        (
            "RayOrder",
            "Strictly front to back, with a priority queue: no node is opened that begins behind the answer.",
        ),
        (
            "Cost",
            "What a query is expected to take on a machine that tests the children of a node together and triangles in blocks of four: \
             nanoseconds of visits, leaf visits and blocks, the number that trees of any width compare by.",
        ),
        ("Γ", "c_I · box tests + c_P · primitive tests: what a query costs, in units of a test."),
        ("T_R", "Inner nodes that effective segments overlap, summed over queries: what no order can avoid."),
        (
            "SAH cost",
            "What a random long ray is expected to cost that stops nowhere (Goldsmith and Salmon 1987).",
        ),
        (
            "EPO",
            "End-point overlap (Aila, Karras and Laine 2013): the cost of nodes by the surface in them that belongs to others.",
        ),
        (
            "LCV",
            "Leaf count variability: the standard deviation of the number of leaves that an effective segment overlaps.",
        ),
    ];
    html! { dl.words { @for (word, meaning) in words { dt { (word) } dd { (meaning) } } } }
}
