//! The powerplant figure (section 5.4) on any scene: T_R over the exponent α of the count.
//!
//! Bounce queries train the trees, with a floor of 10 rays, and T_R is counted on the same queries, as was published; and again on
//! the queries of other pixels. The powerplant itself is not at hand: any recorded scene is a stand-in.

use super::measure::{area_tree, ray_tree};
use super::published::{ALPHAS, POWERPLANT_AREA, POWERPLANT_FLOOR, POWERPLANT_RAYS};
use super::trace::{Trace, part, prepared, t_r};
use super::{ExperimentError, Settings};
use crate::builder::{self, Config};
use crate::probability::rays::{Count, RaySet};
use crate::progress::Progress;
use crate::report::plot::{BLUE, Chart, Color, Figure, Mark, ORANGE, SKY, Series, Stroke, VERMILLION};
use std::io::{self, Write};

/// One tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    pub alpha: f64,
    /// From rays; else from area.
    pub rays: bool,
    /// |L|-1; else |L|.
    pub minus_one: bool,
    /// T_R per query, on the queries that the tree was built from.
    pub training: f64,
    /// T_R per query, on the queries of other pixels.
    pub held_out: f64,
}

/// Builds and counts every tree.
///
/// # Errors
/// See [`ExperimentError`].
pub fn run(trace: &Trace, settings: &Settings) -> Result<Vec<Row>, ExperimentError> {
    let (training, held_out) = part(&trace.bounces(), 0.5, settings.seed)?;
    let set = RaySet::of_records(training.iter().map(|query| &query.record));
    let alphas = ALPHAS.iter().step_by(if settings.quick { 5 } else { 1 });
    let progress = Progress::new("alpha", 4 * alphas.len() as u64);
    let mut rows = Vec::new();
    for &alpha in alphas {
        for minus_one in [false, true] {
            let count = if minus_one { builder::Count::MinusOne } else { builder::Count::All };
            let config = Config { alpha, count, ..Config::default() };
            for rays in [false, true] {
                let tree = if rays {
                    let measure = Count { floor: POWERPLANT_FLOOR, area: 0.0 };
                    ray_tree(&trace.triangles, &set, measure, &config)?
                } else {
                    area_tree(&trace.triangles, &config)?
                };
                let prepared = prepared(&tree, trace);
                let per_query = |queries: &[_]| t_r(&prepared, queries) as f64 / queries.len() as f64;
                let (training, held_out) = (per_query(&training), per_query(&held_out));
                rows.push(Row { alpha, rays, minus_one, training, held_out });
                progress.advance(1);
            }
        }
    }
    Ok(rows)
}

/// `alpha,probability,count,t_r_training,t_r_held_out`, T_R per query.
///
/// # Errors
/// What `out` says.
pub fn write_csv(rows: &[Row], out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "alpha,probability,count,t_r_training,t_r_held_out")?;
    for row in rows {
        let probability = if row.rays { "rays" } else { "area" };
        let count = if row.minus_one { "n-1" } else { "n" };
        writeln!(out, "{},{probability},{count},{:.4},{:.4}", row.alpha, row.training, row.held_out)?;
    }
    Ok(())
}

/// Two panels, all curves relative to SAH at α = 1.
pub fn figure(rows: &[Row], scene: &str) -> Figure {
    let panel = |title: &str, value: fn(&Row) -> f64| {
        let sah = rows.iter().find(|row| row.alpha == 1.0 && !row.rays && row.minus_one).map_or(1.0, value);
        let mut series = Vec::new();
        let kinds: [(bool, bool, &str, Color); 4] = [
            (false, false, "P_U · |L|^α", BLUE),
            (false, true, "P_U · (|L|-1)^α", SKY),
            (true, false, "P_R · |L|^α", VERMILLION),
            (true, true, "P_R · (|L|-1)^α", ORANGE),
        ];
        for (rays, minus_one, label, color) in kinds {
            let of = rows.iter().filter(|row| row.rays == rays && row.minus_one == minus_one);
            let points = of.map(|row| (row.alpha, value(row) / sah)).collect();
            series.push(Series::line(label, color, Stroke::Solid, Mark::Disk, points));
        }
        for (values, label, color) in [
            (POWERPLANT_AREA, "P_U · |L|^α, published (powerplant)", BLUE),
            (POWERPLANT_RAYS, "P_R · |L|^α, published (powerplant)", VERMILLION),
        ] {
            let points = ALPHAS.into_iter().zip(values.map(|value| value / POWERPLANT_AREA[10])).collect();
            series.push(Series::line(label, color, Stroke::Dashed, Mark::Ring, points));
        }
        Chart::new(title, "exponent α", "T_R relative to SAH with α = 1", series).with_x(0.69, 1.01)
    };
    let panels = vec![
        panel("on the training queries, as published", |row| row.training),
        panel("on queries of other pixels", |row| row.held_out),
    ];
    let mut figure = Figure::new(&format!("T_R by the exponent of the count: {scene}"), 2, panels);
    figure.note = format!(
        "Bounce queries. Published: the powerplant of Feltman 2011, section 5.4; {scene} is a stand-in for it."
    );
    figure
}
