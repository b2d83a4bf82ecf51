//! The experiment's rows as CSV, as a table and as a figure.

use super::{KEYS, LIMIT, Method, Row};
use crate::report::plot::{Chart, Color, Figure, Mark, PALETTE, Series, Stroke};
use std::io::{self, Write};

/// `frame,method,update_seconds,rebuilt,rotations,sah_cost,queries,box_tests,primitive_tests,t_r,seconds_per_query,mismatches`.
///
/// # Errors
/// What `out` says.
pub fn write_csv(rows: &[Row], out: &mut dyn Write) -> io::Result<()> {
    writeln!(
        out,
        "frame,method,update_seconds,rebuilt,rotations,sah_cost,queries,box_tests,primitive_tests,t_r,seconds_per_query,mismatches"
    )?;
    for row in rows {
        writeln!(
            out,
            "{},{},{:.6},{},{},{:.4},{},{:.4},{:.4},{:.4},{:.4e},{}",
            row.frame,
            row.method.name(),
            row.update_seconds,
            row.rebuilt,
            row.rotations,
            row.sah_cost,
            row.queries,
            row.box_tests,
            row.primitive_tests,
            row.t_r,
            row.seconds_per_query,
            row.mismatches,
        )?;
    }
    Ok(())
}

/// What a method comes to over all frames.
struct Total {
    method: Method,
    update: f64,
    per_query: f64,
    /// Tests relative to the rebuilt tree: mean, and of the last frame.
    relative: [f64; 2],
    sah: f64,
    rebuilds: usize,
    mismatches: u64,
}

fn totals(rows: &[Row]) -> Vec<Total> {
    let of = |method: Method| rows.iter().filter(move |row| row.method == method);
    let rebuilt: Vec<&Row> = of(Method::ALL[0]).collect();
    let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let total = |method: Method| {
        let ratios: Vec<f64> =
            of(method).zip(&rebuilt).map(|(row, rebuilt)| row.tests() / rebuilt.tests()).collect();
        let sah = of(method).zip(&rebuilt).map(|(row, rebuilt)| row.sah_cost / rebuilt.sah_cost).last();
        Total {
            method,
            update: mean(of(method).map(|row| row.update_seconds).collect()),
            per_query: mean(of(method).map(|row| row.seconds_per_query).collect()),
            relative: [mean(ratios.clone()), ratios.last().copied().unwrap_or(f64::NAN)],
            sah: sah.unwrap_or(f64::NAN),
            rebuilds: of(method).filter(|row| row.rebuilt).count(),
            mismatches: of(method).map(|row| row.mismatches).sum(),
        }
    };
    Method::ALL.map(total).into()
}

/// Relative differences of two times below this are noise.
const NOISE: f64 = 0.03;

/// Millions of queries per frame from which on rebuilding every frame is faster; `None` when it never is, or always, or nobody can tell.
fn crossover(total: &Total, rebuilt: &Total) -> Option<f64> {
    let slower = total.per_query - rebuilt.per_query;
    let queries = (rebuilt.update - total.update) / slower;
    (slower > NOISE * rebuilt.per_query && queries > 0.0).then_some(1e-6 * queries)
}

/// The table in Markdown.
pub fn markdown(rows: &[Row]) -> String {
    let totals = totals(rows);
    let mut text = String::from(
        "| method | update, ms | tests, mean | tests, last frame | SAH, last frame | ns per query | rebuilds | rebuilding is faster above | wrong |\n|---|---:|---:|---:|---:|---:|---:|---:|---:|\n",
    );
    for total in &totals {
        let above = match crossover(total, &totals[0]) {
            Some(millions) => format!("{millions:.2} M queries a frame"),
            None => "–".into(),
        };
        text += &format!(
            "| {} | {:.2} | {:.3} | {:.3} | {:.3} | {:.0} | {} | {above} | {} |\n",
            total.method.name(),
            1e3 * total.update,
            total.relative[0],
            total.relative[1],
            total.sah,
            1e9 * total.per_query,
            total.rebuilds,
            total.mismatches,
        );
    }
    text
}

/// Tests per query and update time by frame, and total time per frame over the number of queries.
pub fn figure(rows: &[Row], name: &str) -> Figure {
    let of = |method: Method| rows.iter().filter(move |row| row.method == method);
    let lines = |value: &dyn Fn(&Row) -> f64| -> Vec<Series> {
        let line = |(place, method): (usize, Method)| {
            let points = of(method).map(|row| (row.frame as f64, value(row))).collect();
            let (color, stroke) = look(place);
            Series::line(method.name(), color, stroke, Mark::None, points)
        };
        Method::ALL.into_iter().enumerate().map(line).collect()
    };
    let tests =
        Chart::new("queries of each frame", "frame", "box and primitive tests per query", lines(&Row::tests));
    let mut updates = Chart::new(
        "update",
        "frame",
        "milliseconds",
        lines(&|row: &Row| (1e3 * row.update_seconds).max(1e-3).log10()),
    );
    updates.y.logarithmic = true;
    let totals = totals(rows);
    let lines = totals.iter().enumerate().map(|(place, total)| {
        let points = (0..=60).map(|step| {
            let exponent = 3.0 + f64::from(step) / 10.0;
            (exponent, (1e3 * (total.update + total.per_query * 10f64.powf(exponent))).log10())
        });
        let (color, stroke) = look(place);
        Series::line(total.method.name(), color, stroke, Mark::None, points.collect())
    });
    let whole = Chart::new(
        "update and queries, one thread",
        "queries per frame",
        "milliseconds per frame",
        lines.collect(),
    )
    .logarithmic();
    let mut figure =
        Figure::new(&format!("Trees for a moving scene: {name}"), 3, vec![tests, updates, whole]);
    figure.note = format!(
        "ODF, queries of pixels that no tree was made from; rays and limits ({LIMIT}) are of the frame before, trees for all frames are made from {KEYS} of them."
    );
    figure
}

/// Colour and stroke of the method at a place of [`Method::ALL`].
fn look(place: usize) -> (Color, Stroke) {
    let stroke = if place < PALETTE.len() { Stroke::Solid } else { Stroke::Dashed };
    (PALETTE[place % PALETTE.len()], stroke)
}
