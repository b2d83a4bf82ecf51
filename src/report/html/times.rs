//! Measured times in a page, what was fitted to them, and how measures rank the trees.

use super::super::time;
use super::tables::{ratio, table};
use crate::compare::timing::Timing;
use crate::compare::{Comparison, RecordingResult, explained};
use maud::{Markup, html};

pub fn section(comparison: &Comparison, recording: &RecordingResult, timing: &Timing) -> Markup {
    let purposes = time::purposes(timing);
    let header = [&["Order", "Tree", "ns", "least", "greatest", "ratio"][..], &purposes].concat();
    let rows = html! {
        tbody {
            @for row in time::rows(comparison, recording) {
                tr {
                    th scope="row" { (row.order) }
                    th scope="row" { (row.name) }
                    @for ns in [row.median, row.least, row.greatest] { td { (format!("{ns:.1}")) } }
                    td { (ratio(row.ratio)) }
                    @for ns in row.by_purpose { td { (format!("{ns:.1}")) } }
                }
            }
        }
    };
    html! {
        (table("Nanoseconds per query", &header, 2, rows))
        p.soft { (time::method(timing)) }
        (fits(comparison, recording))
        (rankings(comparison, recording))
    }
}

fn fits(comparison: &Comparison, recording: &RecordingResult) -> Markup {
    let fitted = explained::fitted(comparison, recording);
    let header = ["Order", "trees", "groups", "query", "visit", "box", "primitive", "c_P / c_I", "R²"];
    let rows = html! {
        tbody {
            @for found in &fitted {
                tr {
                    th scope="row" { (found.traversal.name()) }
                    td.text { (found.trees) " " (found.form) }
                    @if let Some(fit) = &found.fit {
                        td { (fit.observations) }
                        @for estimate in [fit.query, fit.node_visit, fit.box_test, fit.primitive_test] { td { (time::estimate(estimate)) } }
                        td { @if let Some(ratio) = fit.ratio() { (format!("{ratio:.2}")) } @else { "–" } }
                        td { (format!("{:.4}", fit.r_squared)) }
                    } @else {
                        td colspan="7" { "too few groups of queries, or all alike" }
                    }
                }
            }
        }
    };
    html! {
        @if !fitted.is_empty() {
            (table("Costs fitted to the times by least squares, nanoseconds ± standard error", &header, 2, rows))
            p.soft { "In a binary tree each visit is two box tests, so the two cannot be told apart: the visit has both, and c_I is half of it." }
        }
    }
}

fn rankings(comparison: &Comparison, recording: &RecordingResult) -> Markup {
    let rankings = explained::rankings(comparison, recording);
    let Some(first) = rankings.first() else { return html! {} };
    let names = first.measures.iter().map(|(key, _)| time::measure_name(key));
    let header: Vec<&str> = std::iter::once("Order").chain(names).collect();
    let rows = html! {
        tbody {
            @for ranking in &rankings {
                tr {
                    th scope="row" { (ranking.traversal.name()) }
                    @for (_, tau) in &ranking.measures { td { @if let Some(tau) = tau { (format!("{tau:.2}")) } @else { "–" } } }
                }
            }
        }
    };
    html! {
        (table("How measures rank the trees by their time: Kendall's τ, 1 alike, −1 in reverse", &header, 1, rows))
    }
}
