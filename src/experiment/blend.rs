//! Blending (section 5.3): P = w · ray share + (1 - w) · area share, on the sphere, over focus and weight.

use super::measure::{area_tree, cost, end_at_hits, ray_tree};
use super::shape::{Setup, Shape};
use super::{ExperimentError, Row, Settings, foci, published, shapes, summary};
use crate::builder::Config;
use crate::probability::blend::Blend;
use crate::probability::rays::RaySet;
use crate::progress::Progress;
use crate::report::plot::{BLUE, Chart, Color, Figure, GREEN, Mark, Series, Stroke, VERMILLION, ramp};
use rayon::prelude::*;

/// Runs every focus and trial of the sphere with every weight.
///
/// # Errors
/// See [`ExperimentError`].
pub fn run(settings: &Settings) -> Result<Vec<Row>, ExperimentError> {
    let foci = foci(settings);
    let jobs: Vec<(f64, u64)> =
        foci.iter().flat_map(|&focus| (0..settings.trials).map(move |trial| (focus, trial))).collect();
    let progress = Progress::new("blend", jobs.len() as u64);
    let rows: Result<Vec<Vec<Row>>, _> = jobs
        .into_par_iter()
        .map(|(focus, trial)| {
            let rows = run_trial(focus, trial, settings.seed);
            progress.advance(1);
            rows
        })
        .collect();
    Ok(rows?.concat())
}

fn run_trial(focus: f64, trial: u64, seed: u64) -> Result<Vec<Row>, ExperimentError> {
    let (Setup { triangles, .. }, rays) = shapes::setup(Shape::Sphere, focus, trial, seed);
    let config = Config::default();
    let area = area_tree(&triangles, &config)?;
    let segments = end_at_hits(&area, &triangles, &rays);
    let set = RaySet::of_rays(segments.iter().copied());
    let row = |weight| {
        let tree = ray_tree(&triangles, &set, Blend::new(weight)?, &config)?;
        let cost = cost(&tree, &triangles, &rays, &segments)?;
        Ok(Row { experiment: "blend", focus, trial, weight, cost })
    };
    published::WEIGHTS.into_iter().map(row).collect()
}

/// Two panels: cost over focus by weight, and over weight by focus with what is published.
pub fn figure(rows: &[Row]) -> Figure {
    let cost = |row: &Row| row.cost.box_tests as f64 / 1e4;
    let by_weight = published::WEIGHTS.map(|weight| {
        let ours = summary(rows.iter().filter(|row| row.weight == weight).map(|row| (row.focus, cost(row))));
        let line = ours.iter().map(|p| (p.x, p.mean)).collect();
        Series::line(&format!("w = {weight}"), ramp(0.08 + 0.8 * weight), Stroke::Solid, Mark::None, line)
    });
    let mut by_focus = Vec::new();
    for ((focus, again), color) in
        published::BLEND_AGAIN.into_iter().zip([BLUE, GREEN, VERMILLION] as [Color; 3])
    {
        let ours = summary(rows.iter().filter(|row| row.focus == focus).map(|row| (row.weight, cost(row))));
        let band = ours.iter().map(|p| (p.x, p.mean - p.error, p.mean + p.error)).collect();
        let line = ours.iter().map(|p| (p.x, p.mean)).collect();
        by_focus.push(Series::band(color, band));
        by_focus.push(Series::line(&format!("focus {focus}"), color, Stroke::Solid, Mark::Disk, line));
        if focus == 0.0 {
            let points = published::WEIGHTS.into_iter().zip(published::BLEND).collect();
            by_focus.push(Series::line("focus 0, published", color, Stroke::Dashed, Mark::Ring, points));
        }
        let points = published::WEIGHTS.into_iter().zip(again).collect();
        by_focus.push(Series::line(
            &format!("focus {focus}, re-run"),
            color,
            Stroke::Dotted,
            Mark::Cross,
            points,
        ));
    }
    let y = "BVH cost (10⁴ box tests, 3000 rays)";
    let panels = vec![
        Chart::new("by focus", "focus", y, by_weight.into()).with_x(0.0, 1.0).with_y(2.0, 10.0),
        Chart::new("by weight", "weight w of the rays", y, by_focus).with_x(0.0, 1.0).with_y(2.0, 10.0),
    ];
    let mut figure = Figure::new("Rays and area blended, sphere", 2, panels);
    figure.note = "Mean over trials; bands are one standard error. Published: Feltman 2011, section 5.3; re-run: an independent program.".into();
    figure
}
