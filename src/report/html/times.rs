//! Measured times in a page, what was fitted to them, and how measures rank the trees.

use super::super::time::Nanoseconds;
use super::super::{kernels, time};
use super::tables::{ratio, table};
use crate::compare::timing::Timing;
use crate::compare::{Comparison, RecordingResult, explained};
use maud::{Markup, html};

/// Columns of a time.
const PARTS: [fn(Nanoseconds) -> f64; 3] = [|ns| ns.median, |ns| ns.least, |ns| ns.greatest];

pub fn section(comparison: &Comparison, recording: &RecordingResult, timing: &Timing) -> Markup {
    let groups = time::groups(timing);
    let header = [&["Order", "Tree", "ns", "least", "greatest", "ratio"][..], &groups].concat();
    let rows = html! {
        tbody {
            @for row in time::rows(comparison, recording) {
                tr {
                    th scope="row" { (row.order) }
                    th scope="row" { (row.name) }
                    @for part in PARTS { td { (time::shown(row.total.map(part))) } }
                    td { @if let Some(value) = row.ratio { (ratio(value)) } @else { "—" } }
                    @for ns in row.by_group { td { (time::shown(ns)) } }
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

/// Embree's kernels on each tree.
pub fn embrees(comparison: &Comparison, recording: &RecordingResult) -> Markup {
    let Some(kernels::Shown { header, rows, notes }) = kernels::shown(comparison, recording) else {
        return html! {};
    };
    let body = html! {
        tbody {
            @for row in &rows {
                tr {
                    @for (column, cell) in row.iter().enumerate() {
                        @if column == 0 { th scope="row" { (cell) } } @else { td { (cell) } }
                    }
                }
            }
        }
    };
    html! {
        @if !rows.is_empty() { (table("Embree's kernels on each tree", &header, 1, body)) }
        @for note in &notes { p.soft { (note) } }
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
