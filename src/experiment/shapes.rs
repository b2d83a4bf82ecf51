//! Figure 1: trees built with full ray information against SAH trees, on four shapes, over the focus of the rays.

use super::measure::{area_tree, cost, end_at_hits, ray_tree};
use super::shape::{RAYS, Setup, Shape};
use super::{ExperimentError, Row, Settings, foci, published, summary};
use crate::builder::Config;
use crate::probability::rays::{Count, RaySet};
use crate::progress::Progress;
use crate::random::Random;
use crate::report::plot::{BLUE, Chart, Figure, Mark, Series, Stroke, VERMILLION};
use rayon::prelude::*;

/// Runs every shape, focus and trial; a row for each tree. Weight 0 is SAH, 1 full ray information.
///
/// # Errors
/// See [`ExperimentError`].
pub fn run(settings: &Settings) -> Result<Vec<Row>, ExperimentError> {
    let foci = foci(settings);
    let jobs: Vec<(Shape, f64, u64)> = Shape::ALL
        .into_iter()
        .flat_map(|shape| {
            foci.iter().flat_map(move |&focus| (0..settings.trials).map(move |t| (shape, focus, t)))
        })
        .collect();
    let progress = Progress::new("shapes", jobs.len() as u64);
    let rows: Result<Vec<[Row; 2]>, _> = jobs
        .into_par_iter()
        .map(|(shape, focus, trial)| {
            let rows = run_trial(shape, focus, trial, settings.seed);
            progress.advance(1);
            rows
        })
        .collect();
    Ok(rows?.concat())
}

/// Geometry and rays of one trial: what `--save` writes.
pub fn setup(shape: Shape, focus: f64, trial: u64, seed: u64) -> (Setup, Vec<crate::geometry::Ray>) {
    // A trial has the same geometry at every focus, and the same rays but for their targets: curves are smooth, and what
    // differs along them is the focus.
    let mut random = Random::stream(seed, &[shape as u64, trial]);
    let setup = Setup::new(shape, focus, &mut random);
    let rays = setup.frustum.rays(RAYS, &mut random);
    (setup, rays)
}

fn run_trial(shape: Shape, focus: f64, trial: u64, seed: u64) -> Result<[Row; 2], ExperimentError> {
    let (Setup { triangles, .. }, rays) = setup(shape, focus, trial, seed);
    let config = Config::default();
    let area = area_tree(&triangles, &config)?;
    let segments = end_at_hits(&area, &triangles, &rays);
    let set = RaySet::of_rays(segments.iter().copied());
    let full = ray_tree(&triangles, &set, Count::PLAIN, &config)?;
    let row = |weight, tree| {
        let cost = cost(tree, &triangles, &rays, &segments)?;
        Ok::<_, ExperimentError>(Row { experiment: shape.name(), focus, trial, weight, cost })
    };
    Ok([row(0.0, &area)?, row(1.0, &full)?])
}

/// Four panels: ours with a band of one standard error, and what is published.
pub fn figure(rows: &[Row]) -> Figure {
    let panels = Shape::ALL.map(|shape| {
        let published = published::shapes(shape);
        let mut series = Vec::new();
        for (weight, label, color, published) in
            [(0.0, "SAH", BLUE, published.area), (1.0, "full ray information", VERMILLION, published.rays)]
        {
            let of = |row: &&Row| row.experiment == shape.name() && row.weight == weight;
            let ours =
                summary(rows.iter().filter(of).map(|row| (row.focus, row.cost.box_tests as f64 / 1e4)));
            let band = ours.iter().map(|p| (p.x, p.mean - p.error, p.mean + p.error)).collect();
            let line = ours.iter().map(|p| (p.x, p.mean)).collect();
            series.push(Series::band(color, band));
            series.push(Series::line(label, color, Stroke::Solid, Mark::None, line));
            let points = published::FOCI.into_iter().zip(published).collect();
            let label = format!("{label}, published");
            series.push(Series::line(&label, color, Stroke::Dashed, Mark::Ring, points));
        }
        let (low, high) = match shape {
            Shape::Tube => (0.0, 16.0),
            _ => (2.0, 12.0),
        };
        Chart::new(shape.name(), "focus", "BVH cost (10⁴ box tests, 3000 rays)", series)
            .with_x(0.0, 1.0)
            .with_y(low, high)
    });
    let mut figure = Figure::new("BVH cost by the focus of the rays", 2, panels.into());
    figure.note =
        "Mean over trials with a band of one standard error. Published: Feltman 2011, figure 1.".into();
    figure
}
