//! Heuristics against the exact optimum: random scenes of so few triangles that the best of all trees can be found, for the rays and for area.
//!
//! Triangles and rays are random; every tree has one triangle a leaf and is counted on the rays that it was made from (T_R) and by area
//! (T_U), so that what is left above the optimum is what its builder and optimisers missed, and nothing else.

use super::measure::{area_tree, end_at_hits};
use super::shape::Frustum;
use super::{ExperimentError, Settings};
use crate::builder::exhaustive::{self, optimum};
use crate::builder::{Config, Splits};
use crate::geometry::padded::PaddedAabb;
use crate::geometry::{Aabb, DVec3, Ray, Triangle};
use crate::optimize::measure::{AreaMeasure, Estimate, Measure, RayMeasure};
use crate::optimize::{Stage, annealing, insertion, reinsertion, rotations, treelets};
use crate::progress::Progress;
use crate::random::Random;
use crate::recipe::{Heuristic, Recipe, auto};
use crate::report::plot::{BLUE, Chart, Figure, GREEN, Mark, Series, Stroke, VERMILLION};
use crate::training::queries::Query;
use crate::traverse::Prepared;
use crate::tree::Tree;
use rayon::prelude::*;
use std::io::{self, Write};
use std::time::Duration;

/// Rays of one scene.
pub const RAYS: usize = 1000;

/// Most triangles of a scene.
pub const MAX_TRIANGLES: usize = exhaustive::MAX_PRIMITIVES;

/// Auto judges by the queries of this share of the pixels of a recording; here, by every fourth ray.
const JUDGES: usize = 4;

/// One tree of one scene, and the least that any tree has.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    pub scene: u64,
    pub tree: &'static str,
    /// Σ over inner nodes of the rays that overlap them.
    pub t_r: f64,
    pub least_t_r: f64,
    /// Σ over inner nodes of area relative to the root's.
    pub t_u: f64,
    pub least_t_u: f64,
}

/// What a tree is measured by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum By {
    Rays,
    Area,
}

impl Row {
    /// By how much the tree is above the optimum, in percent.
    fn excess(&self, by: By) -> f64 {
        let (cost, least) = match by {
            By::Rays => (self.t_r, self.least_t_r),
            By::Area => (self.t_u, self.least_t_u),
        };
        if least > 0.0 { 100.0 * (cost / least - 1.0) } else { 0.0 }
    }
}

/// A scene: triangles, and rays that end at their closest hits.
struct Setup {
    triangles: Vec<Triangle>,
    rays: Vec<Ray>,
    segments: Vec<Ray>,
}

impl Setup {
    /// Each triangle's corners are uniform in a cube whose edge is uniform in 0.05..0.5 and whose centre is uniform in the unit cube. Rays go
    /// from a disk to a disk: the first has a radius uniform in 0..1 and a centre two units away from that of the unit cube in a direction uniform in a cube;
    /// the second has a radius uniform in 0..0.5 and a centre uniform in the unit cube.
    fn new(count: usize, random: &mut Random) -> Result<Setup, ExperimentError> {
        let mut vector = || DVec3::from_array([0; 3].map(|_| random.uniform()));
        let mut triangle = || {
            let (at, size) = (vector(), 0.05 + 0.45 * vector().x);
            let corner = |_| (at + size * (vector() - 0.5)).as_vec3();
            Triangle([0; 3].map(corner))
        };
        let triangles: Vec<Triangle> = (0..count).map(|_| triangle()).collect();
        let away = (2.0 * vector() - 1.0).normalize_or(DVec3::X);
        let frustum = Frustum {
            from: DVec3::splat(0.5) + 2.0 * away,
            from_radius: random.uniform(),
            to: DVec3::from_array([0; 3].map(|_| random.uniform())),
            to_radius: 0.5 * random.uniform(),
        };
        let rays = frustum.rays(RAYS, random);
        let segments = end_at_hits(&area_tree(&triangles, &Config::default())?, &triangles, &rays);
        Ok(Setup { triangles, rays, segments })
    }

    fn bounds(&self) -> PaddedAabb {
        self.triangles.iter().fold(Aabb::EMPTY, |sum, triangle| sum.union(&triangle.bounds())).into()
    }

    fn t_r(&self, tree: &Tree) -> f64 {
        let overlaps = Prepared::new(tree.view(), &self.triangles, &[]).overlaps(&self.segments);
        let inner = tree.nodes.iter().zip(&overlaps).filter(|(node, _)| !node.is_leaf());
        inner.map(|(_, &rays)| rays as f64).sum()
    }

    fn t_u(&self, tree: &Tree) -> f64 {
        let area = AreaMeasure::new(&self.bounds());
        let inner = tree.nodes.iter().filter(|node| !node.is_leaf());
        inner.map(|node| area.of(&node.bounds().into())).sum()
    }

    /// The best of all trees.
    fn best(&self, probability: impl FnMut(&PaddedAabb) -> f64) -> Result<Tree, ExperimentError> {
        let leaves: Vec<_> = self.triangles.iter().zip(0..).map(|(t, index)| (t.bounds(), index)).collect();
        Ok(optimum(&leaves, probability)?.tree)
    }

    /// The tree that `--heuristic auto` chooses, with or without the exact step.
    fn auto(&self, exact: bool) -> Result<Tree, ExperimentError> {
        let queries = self.rays.iter().zip(&self.segments).enumerate();
        let query = |(number, (&ray, &segment))| Query {
            ray,
            segment,
            is_occlusion: false,
            mask: u32::MAX,
            rejects: Box::default(),
            judges: number % JUDGES == 0,
        };
        let queries: Vec<Query> = queries.map(query).collect();
        let scene = auto::Scene { triangles: &self.triangles, geometries: &[] };
        // Far more than it takes: the result must not depend on time.
        let budget = Duration::from_secs(3600);
        let config = auto::Config { budget, c_i: 1.0, c_p: 1.0, max_leaf: 1, cuts: true };
        Ok(auto::choose_with(scene, &queries, &config, exact)?.made.tree)
    }
}

/// Greedy builders, and optimisers after the best of them.
fn recipes() -> Vec<(&'static str, Recipe)> {
    let blend = |weight| Heuristic::Blend { weight };
    let (sah, rdh, rays) = (Heuristic::Sah, Heuristic::Rdh { floor: 0.0 }, blend(1.0));
    let binned = Config::default().splits;
    let rotations = Stage::Rotations(rotations::Config::default());
    let annealing = Stage::Annealing(annealing::Config::default());
    let insertion = Stage::Insertion(insertion::Config::default());
    let reinsertion = Stage::Reinsertion(reinsertion::Config::default());
    let treelets = Stage::Treelets(treelets::Config::default());
    let recipes = [
        ("SAH binned", sah, binned, None),
        ("SAH sweep", sah, Splits::Sweep, None),
        ("SAH sweep + rotations", sah, Splits::Sweep, Some(rotations)),
        ("SAH sweep + annealing", sah, Splits::Sweep, Some(annealing)),
        ("SAH sweep + insertion", sah, Splits::Sweep, Some(insertion)),
        ("SAH sweep + reinsertion", sah, Splits::Sweep, Some(reinsertion)),
        ("SAH sweep + treelets", sah, Splits::Sweep, Some(treelets)),
        ("RDH binned", rdh, binned, None),
        ("RDH sweep", rdh, Splits::Sweep, None),
        ("blend 0.95 binned", blend(0.95), binned, None),
        ("blend 0.95 sweep", blend(0.95), Splits::Sweep, None),
        ("rays sweep + rotations", rays, Splits::Sweep, Some(rotations)),
        ("rays sweep + annealing", rays, Splits::Sweep, Some(annealing)),
        ("rays sweep + insertion", rays, Splits::Sweep, Some(insertion)),
        ("rays sweep + reinsertion", rays, Splits::Sweep, Some(reinsertion)),
        ("rays sweep + treelets", rays, Splits::Sweep, Some(treelets)),
    ];
    let recipe = |(name, heuristic, splits, stage): (&'static str, _, _, Option<Stage>)| {
        let builder = Config { splits, ..Config::default() };
        (name, Recipe { heuristic, builder, stages: stage.into_iter().collect(), budget: None })
    };
    recipes.into_iter().map(recipe).collect()
}

/// Runs `settings.trials` scenes of `triangles` triangles, 2 to [`MAX_TRIANGLES`]: a row for each tree of each scene.
///
/// # Errors
/// See [`ExperimentError`].
pub fn run(settings: &Settings, triangles: usize) -> Result<Vec<Row>, ExperimentError> {
    let recipes = recipes();
    let progress = Progress::new("optimum", settings.trials);
    let rows: Result<Vec<Vec<Row>>, ExperimentError> = (0..settings.trials)
        .into_par_iter()
        .map(|scene| {
            let rows = run_scene(scene, settings.seed, triangles, &recipes);
            progress.advance(1);
            rows
        })
        .collect();
    Ok(rows?.concat())
}

fn run_scene(
    scene: u64,
    seed: u64,
    triangles: usize,
    recipes: &[(&'static str, Recipe)],
) -> Result<Vec<Row>, ExperimentError> {
    let setup = Setup::new(triangles, &mut Random::stream(seed, &[scene]))?;
    let bounds = setup.bounds();
    let rays = RayMeasure::new(&setup.segments, Estimate::Blend { weight: 1.0 }, &bounds);
    let (area, all) = (AreaMeasure::new(&bounds), rays.whole());
    let best_for_rays = setup.best(|bounds| rays.values(&all, &[*bounds])[0])?;
    let best_for_area = setup.best(|bounds| area.of(bounds))?;
    let (least_t_r, least_t_u) = (setup.t_r(&best_for_rays), setup.t_u(&best_for_area));
    let mut trees = Vec::new();
    for (name, recipe) in recipes {
        trees.push((*name, recipe.make(&setup.triangles, &setup.segments, &Progress::hidden())?.tree));
    }
    trees.push(("auto without the exact step", setup.auto(false)?));
    trees.push(("auto", setup.auto(triangles <= auto::EXHAUSTIVE)?));
    trees.push(("the optimum for area", best_for_area));
    trees.push(("the optimum for the rays", best_for_rays));
    let row = |(name, tree): (&'static str, Tree)| {
        let (t_r, t_u) = (setup.t_r(&tree), setup.t_u(&tree));
        Row { scene, tree: name, t_r, least_t_r, t_u, least_t_u }
    };
    Ok(trees.into_iter().map(row).collect())
}

/// `scene,tree,t_r,least_t_r,t_u,least_t_u`.
///
/// # Errors
/// What `out` says.
pub fn write_csv(rows: &[Row], out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "scene,tree,t_r,least_t_r,t_u,least_t_u")?;
    for Row { scene, tree, t_r, least_t_r, t_u, least_t_u } in rows {
        writeln!(out, "{scene},{tree},{t_r},{least_t_r},{t_u},{least_t_u}")?;
    }
    Ok(())
}

/// Excess of one kind of tree over all scenes, in percent.
struct Excess {
    mean: f64,
    median: f64,
    /// No more in 95 of 100 scenes.
    most_are_below: f64,
    worst: f64,
}

/// The kinds of trees, in the order of the rows.
fn trees(rows: &[Row]) -> Vec<&'static str> {
    rows.iter().take_while(|row| row.scene == rows[0].scene).map(|row| row.tree).collect()
}

fn excess(rows: &[Row], tree: &str, by: By) -> Excess {
    let of = rows.iter().filter(|row| row.tree == tree);
    let mut values: Vec<f64> = of.map(|row| row.excess(by)).collect();
    values.sort_by(f64::total_cmp);
    let last = values.len() - 1;
    Excess {
        mean: values.iter().sum::<f64>() / values.len() as f64,
        median: 0.5 * (values[last / 2] + values[values.len() / 2]),
        most_are_below: values[last * 95 / 100],
        worst: values[last],
    }
}

/// A table in Markdown: excess over the optimum in percent, for the rays and for area.
pub fn markdown(rows: &[Row]) -> String {
    let mut text = String::from(
        "| excess over the optimum (%) | T_R mean | median | 95% of scenes | worst | T_U mean | median | 95% of scenes | worst |\n\
         |---|---:|---:|---:|---:|---:|---:|---:|---:|\n",
    );
    for tree in trees(rows) {
        text += &format!("| {tree} |");
        for by in [By::Rays, By::Area] {
            let Excess { mean, median, most_are_below, worst } = excess(rows, tree, by);
            for value in [mean, median, most_are_below, worst] {
                // No minus sign before a zero.
                text += &format!(" {:.2} |", (100.0 * value).round() / 100.0 + 0.0);
            }
        }
        text.push('\n');
    }
    text
}

/// For the rays and for area, a line for each kind of tree: median, mean, and where 95% of the scenes end.
pub fn figure(rows: &[Row], triangles: usize) -> Figure {
    let trees = trees(rows);
    let place = |index: usize| (trees.len() - 1 - index) as f64;
    let panel = |by: By, title: &str, label: &str| {
        let excesses: Vec<Excess> = trees.iter().map(|tree| excess(rows, tree, by)).collect();
        let points = |value: fn(&Excess) -> f64| -> Vec<(f64, f64)> {
            excesses.iter().enumerate().map(|(index, excess)| (value(excess), place(index))).collect()
        };
        let mut series: Vec<Series> = points(|excess| excess.most_are_below)
            .into_iter()
            .map(|(x, y)| Series::line("", BLUE, Stroke::Solid, Mark::None, vec![(0.0, y), (x, y)]))
            .collect();
        series.push(Series::line("mean", VERMILLION, Stroke::None, Mark::Disk, points(|e| e.mean)));
        series.push(Series::line("median", GREEN, Stroke::None, Mark::Cross, points(|e| e.median)));
        let label_95 = "95% of the scenes are below";
        series.push(Series::line(label_95, BLUE, Stroke::None, Mark::Ring, points(|e| e.most_are_below)));
        let mut chart = Chart::new(title, label, "", series).with_y(-0.5, trees.len() as f64 - 0.5);
        chart.y.names = trees.iter().rev().map(|tree| (*tree).to_owned()).collect();
        chart
    };
    let charts = vec![
        panel(By::Rays, "rays", "T_R over the least of all trees (%)"),
        panel(By::Area, "area", "T_U over the least of all trees (%)"),
    ];
    let mut figure = Figure::new("What heuristics leave of the exact optimum", 2, charts);
    figure.chart_size = (560, 500);
    let scenes = rows.len() / trees.len().max(1);
    figure.note = format!(
        "{scenes} random scenes of {triangles} triangles, one a leaf, {RAYS} rays each; trees are counted on the rays they were made from."
    );
    figure
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn excess_is_that_of_the_right_tree_and_nothing_is_below_the_optimum() {
        let settings = Settings { quick: true, seed: 3, trials: 12 };
        let rows = run(&settings, 8).unwrap();
        assert_eq!(rows.len() % 12, 0);
        for row in &rows {
            // Sums of single-precision areas may differ in the last place.
            assert!(row.t_r >= row.least_t_r && row.t_u > row.least_t_u * (1.0 - 1e-6), "{row:?}");
        }
        let last = excess(&rows, "the optimum for the rays", By::Rays);
        assert_eq!((last.mean, last.worst), (0.0, 0.0));
        assert!(excess(&rows, "the optimum for area", By::Area).worst.abs() < 1e-3);
        let mean = |tree: &str| excess(&rows, tree, By::Rays).mean;
        assert!(mean("SAH binned") > mean("rays sweep + reinsertion"));
        assert!(mean("auto") <= 2.0, "{}", mean("auto"));
        assert_eq!(run(&settings, 8).unwrap(), rows);
    }
}
