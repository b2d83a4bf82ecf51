//! Figure 1: trees built with full ray information against SAH trees, on four shapes, over the focus of the rays; and, beyond
//! the paper, what optimisers make of such trees.

use super::measure::{area_tree, cost, end_at_hits, optimize_by_rays, ray_tree};
use super::shape::{RAYS, Setup, Shape};
use super::{ExperimentError, Point, Row, Settings, foci, published, summary};
use crate::builder::{Config, Splits};
use crate::optimize::measure::Estimate;
use crate::optimize::{self, Stage, annealing, insertion, reinsertion};
use crate::probability::rays::{Count, RaySet};
use crate::progress::Progress;
use crate::random::Random;
use crate::report::plot::{BLUE, Chart, Figure, GREEN, Mark, Series, Stroke, VERMILLION};
use crate::tree::Tree;
use rayon::prelude::*;

/// Runs every shape, focus and trial; a row for each tree. Weight 0 is SAH, 1 full ray information. With `optimize` there is
/// a third tree, called [`Shape::optimized_name`]: the better one of that and a full sweep from all rays, optimised on the same counts.
///
/// # Errors
/// See [`ExperimentError`].
pub fn run(settings: &Settings, optimize: bool) -> Result<Vec<Row>, ExperimentError> {
    let foci = foci(settings);
    let jobs: Vec<(Shape, f64, u64)> = Shape::ALL
        .into_iter()
        .flat_map(|shape| {
            foci.iter().flat_map(move |&focus| (0..settings.trials).map(move |t| (shape, focus, t)))
        })
        .collect();
    let progress = Progress::new("shapes", jobs.len() as u64);
    let rows: Result<Vec<Vec<Row>>, _> = jobs
        .into_par_iter()
        .map(|(shape, focus, trial)| {
            let rows = run_trial(shape, focus, trial, settings.seed, optimize);
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

fn run_trial(
    shape: Shape,
    focus: f64,
    trial: u64,
    seed: u64,
    optimize: bool,
) -> Result<Vec<Row>, ExperimentError> {
    let (Setup { triangles, .. }, rays) = setup(shape, focus, trial, seed);
    let config = Config::default();
    let area = area_tree(&triangles, &config)?;
    let segments = end_at_hits(&area, &triangles, &rays);
    let set = RaySet::of_rays(segments.iter().copied());
    let full = ray_tree(&triangles, &set, Count::PLAIN, &config)?;
    let row = |experiment, weight, tree: &Tree| {
        let cost = cost(tree, &triangles, &rays, &segments)?;
        Ok::<_, ExperimentError>(Row { experiment, focus, trial, weight, cost })
    };
    let mut rows = vec![row(shape.name(), 0.0, &area)?, row(shape.name(), 1.0, &full)?];
    if optimize {
        let sweep = Config { splits: Splits::Sweep, ..config };
        let swept = ray_tree(&triangles, &set, Count::PLAIN, &sweep)?;
        let better = cost(&swept, &triangles, &rays, &segments)?.t_r < rows[1].cost.t_r;
        let mut tree = if better { swept } else { full };
        // The rays that count are those that are given: there is nothing to shrink towards.
        optimize_by_rays(&mut tree, &triangles, &segments, Estimate::Blend { weight: 1.0 }, &thorough())?;
        rows.push(row(shape.optimized_name(), 1.0, &tree)?);
    }
    Ok(rows)
}

/// Optimisers that go on for as long as it pays: these trees are small.
fn thorough() -> optimize::Config {
    let annealing = annealing::Config { iterations: 200, ..Default::default() };
    let reinsertion = reinsertion::Config { batches: 50, least_gain: 1e-5, ..Default::default() };
    let insertion = insertion::Config { least_gain: 1e-5, ..Default::default() };
    optimize::Config {
        stages: vec![
            Stage::Reinsertion(reinsertion),
            Stage::Annealing(annealing),
            Stage::Reinsertion(reinsertion),
            Stage::Insertion(insertion),
        ],
        deadline: None,
    }
}

/// One curve of the figure: the mean cost over trials by focus, in 10⁴ box tests.
fn curve(rows: &[Row], experiment: &str, weight: f64) -> Vec<Point> {
    let of = rows.iter().filter(|row| row.experiment == experiment && row.weight == weight);
    summary(of.map(|row| (row.focus, row.cost.box_tests as f64 / 1e4)))
}

/// A table in Markdown: means in 10⁴ box tests with standard errors, and the ratios that are published.
pub fn markdown(rows: &[Row]) -> String {
    let mut text = String::from(
        "| | focus | SAH | full ray information | ratio | re-run | published | optimised | against published |\n\
         |---|---:|---:|---:|---:|---:|---:|---:|---:|\n",
    );
    for shape in Shape::ALL {
        let (published, again) = (published::shapes(shape), published::shapes_again(shape));
        let [area, rays] = [0.0, 1.0].map(|weight| curve(rows, shape.name(), weight));
        let optimized = curve(rows, shape.optimized_name(), 1.0);
        for (index, focus) in published::FOCI.into_iter().enumerate() {
            let at = |curve: &[Point]| curve.iter().find(|point| point.x == focus).copied();
            let (Some(area), Some(rays)) = (at(&area), at(&rays)) else { continue };
            let number = |point: Point| format!("{:.2} ± {:.2}", point.mean, point.error);
            let best = at(&optimized).map_or_else(
                || " | |".to_owned(),
                |best| {
                    let change = 100.0 * (best.mean / published.rays[index] - 1.0);
                    format!(" {} | {change:+.0}% |", number(best))
                },
            );
            text += &format!(
                "| {} | {focus} | {} | {} | {:.3} | {:.3} | {:.3} |{best}\n",
                shape.name(),
                number(area),
                number(rays),
                rays.mean / area.mean,
                again.rays[index] / again.area[index],
                published.rays[index] / published.area[index],
            );
        }
    }
    text
}

/// Four panels: ours with a band of one standard error, and what is published.
pub fn figure(rows: &[Row]) -> Figure {
    let panels = Shape::ALL.map(|shape| {
        let published = published::shapes(shape);
        let mut series = Vec::new();
        for (weight, label, color, published) in
            [(0.0, "SAH", BLUE, published.area), (1.0, "full ray information", VERMILLION, published.rays)]
        {
            let ours = curve(rows, shape.name(), weight);
            let band = ours.iter().map(|p| (p.x, p.mean - p.error, p.mean + p.error)).collect();
            let line = ours.iter().map(|p| (p.x, p.mean)).collect();
            series.push(Series::band(color, band));
            series.push(Series::line(label, color, Stroke::Solid, Mark::None, line));
            let points = published::FOCI.into_iter().zip(published).collect();
            let label = format!("{label}, published");
            series.push(Series::line(&label, color, Stroke::Dashed, Mark::Ring, points));
        }
        let optimized = curve(rows, shape.optimized_name(), 1.0);
        if !optimized.is_empty() {
            let band = optimized.iter().map(|p| (p.x, p.mean - p.error, p.mean + p.error)).collect();
            let line = optimized.iter().map(|p| (p.x, p.mean)).collect();
            series.push(Series::band(GREEN, band));
            series.push(Series::line(
                "full ray information, optimised",
                GREEN,
                Stroke::Solid,
                Mark::None,
                line,
            ));
        }
        let (low, high) = match shape {
            Shape::Tube => (0.0, 16.0),
            _ => (0.0, 12.0),
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
