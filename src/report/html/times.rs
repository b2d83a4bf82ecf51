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
    html! {
        @if !rows.is_empty() { (cells("Embree's kernels on each tree", &header, 1, &rows)) }
        @for note in &notes { p.soft { (note) } }
    }
}

fn fits(comparison: &Comparison, recording: &RecordingResult) -> Markup {
    let fits = time::fits(comparison, recording);
    html! {
        @if !fits.is_empty() {
            (cells("Costs fitted to the times, nanoseconds ± standard error", &time::FIT_HEADER, time::FIT_NAMES, &fits))
            p.soft { (time::FIT_WORDS) }
        }
    }
}

fn rankings(comparison: &Comparison, recording: &RecordingResult) -> Markup {
    match time::rankings(comparison, recording) {
        Some(ranked) if ranked.rows.is_empty() => html! { p.soft { (explained::TOO_FEW) "." } },
        Some(time::Ranked { header, rows }) => cells(time::RANKED, &header, 1, &rows),
        None => html! {},
    }
}

/// A table of cells, the first ones of a row its names.
fn cells(title: &str, header: &[&str], names: usize, rows: &[Vec<String>]) -> Markup {
    let body = html! {
        tbody {
            @for row in rows {
                tr {
                    @for (column, cell) in row.iter().enumerate() {
                        @if column < names { th scope="row" { (cell) } } @else { td { (cell) } }
                    }
                }
            }
        }
    };
    table(title, header, names, body)
}
