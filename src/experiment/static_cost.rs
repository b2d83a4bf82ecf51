//! Static cost estimation (section 4): how well P(b) · f(n) predicts T(b), the cost of the subtree b with n primitives, for
//! f(n) = n, n-1, log n, ∛(n-1), with P and T from area (U) and from rays (R).

use super::measure::area_tree;
use super::trace::{Trace, prepared};
use super::{ExperimentError, levels};
use crate::builder::Config;
use crate::report::plot::{Chart, Figure, Mark, PALETTE, Series, Stroke, ramp};
use crate::traverse::{Link, Overlapped, PreparedRay, Scratch};
use std::io::{self, Write};

/// A predictor's name, and its function of n for n ≥ 2.
type Predictor = (&'static str, fn(f64) -> f64);

const PREDICTORS: [Predictor; 4] =
    [("n", |n| n), ("n - 1", |n| n - 1.0), ("log n", f64::ln), ("∛(n - 1)", |n| (n - 1.0).cbrt())];

/// One inner node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    pub node: u32,
    /// 0 for the root.
    pub parent: u32,
    pub level: u32,
    pub primitives: u64,
    /// Area relative to the root's, and its sum over the inner nodes from here down.
    pub p_u: f64,
    pub t_u: f64,
    /// Queries that overlap the box, and their sum.
    pub p_r: f64,
    pub t_r: f64,
}

struct PerNode(Vec<u64>);

impl Overlapped for PerNode {
    fn inner(&mut self, node: &Link) {
        self.0[node.node as usize] += 1;
    }

    fn leaf(&mut self, _leaf: &Link) {}
}

/// Every inner node of the scene's SAH tree.
///
/// # Errors
/// See [`ExperimentError`].
pub fn run(trace: &Trace) -> Result<Vec<Row>, ExperimentError> {
    let tree = area_tree(&trace.triangles, &Config::default())?;
    let prepared = prepared(&tree, trace);
    let (mut rays, mut scratch) = (PerNode(vec![0; tree.nodes.len()]), Scratch::default());
    for query in &trace.queries {
        let segment = PreparedRay::new(&query.record.effective_segment());
        prepared.overlap(&segment, segment.tfar, &mut rays, &mut scratch);
    }
    let root_area = f64::from(tree.nodes[0].bounds().area()).max(f64::MIN_POSITIVE);
    let mut rows: Vec<Row> = levels(tree.view())
        .into_iter()
        .zip(&tree.nodes)
        .enumerate()
        .map(|(index, (level, node))| {
            let inner = if node.is_leaf() { 0.0 } else { 1.0 };
            let p_u = inner * f64::from(node.bounds().area()) / root_area;
            let p_r = rays.0[index] as f64;
            let primitives = if node.is_leaf() { node.len() as u64 } else { 0 };
            Row { node: index as u32, parent: 0, level, primitives, p_u, t_u: p_u, p_r, t_r: p_r }
        })
        .collect();
    // Children stand behind their parents: from the back, they are complete when they are added.
    for index in (0..tree.nodes.len()).rev().filter(|&index| !tree.nodes[index].is_leaf()) {
        for child in tree.nodes[index].range() {
            rows[child].parent = index as u32;
            let below = rows[child];
            rows[index].primitives += below.primitives;
            rows[index].t_u += below.t_u;
            rows[index].t_r += below.t_r;
        }
    }
    rows.retain(|row| !tree.nodes[row.node as usize].is_leaf());
    Ok(rows)
}

/// `node,parent,level,primitives,p_u,t_u,p_r,t_r`.
///
/// # Errors
/// What `out` says.
pub fn write_csv(rows: &[Row], out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "node,parent,level,primitives,p_u,t_u,p_r,t_r")?;
    for Row { node, parent, level, primitives, p_u, t_u, p_r, t_r } in rows {
        writeln!(out, "{node},{parent},{level},{primitives},{p_u:e},{t_u:e},{p_r},{t_r}")?;
    }
    Ok(())
}

/// P and T of a row, from area or from rays.
fn values(row: &Row, rays: bool) -> (f64, f64) {
    if rays { (row.p_r, row.t_r) } else { (row.p_u, row.t_u) }
}

/// Points of a scatter; more could not be told apart.
const MOST_POINTS: usize = 6000;

/// T over P · f(n), each of the eight ways.
pub fn scatter(rows: &[Row], scene: &str) -> Figure {
    let deepest = rows.iter().map(|row| row.level).max().unwrap_or(1);
    let step = rows.len().div_ceil(MOST_POINTS).max(1);
    let mut charts = Vec::new();
    for (rays, letter) in [(false, "U"), (true, "R")] {
        for (name, f) in PREDICTORS {
            let point = |row: &Row| {
                let (p, t) = values(row, rays);
                let color = ramp(f64::from(row.level) / f64::from(deepest));
                ((p * f(row.primitives as f64)).log10(), t.log10(), color)
            };
            // A stride samples all levels; the many nodes at the bottom hide the few at the top, so these are drawn last.
            let large = rows.iter().filter(|row| row.primitives > 256);
            let mut points: Vec<_> = rows.iter().step_by(step).chain(large).map(point).collect();
            points.retain(|p| p.0.is_finite() && p.1.is_finite());
            points.reverse();
            let title = format!("P_{letter} · f(n), f(n) = {name}");
            let (x, y) = (format!("P_{letter} · f(n)"), format!("T_{letter}"));
            charts.push(Chart::new(&title, &x, &y, vec![Series::Scatter { points }]).logarithmic());
        }
    }
    let mut figure = Figure::new(&format!("Static predictors of the cost of a subtree: {scene}"), 4, charts);
    figure.chart_size = (320, 290);
    figure.scale = Some(("level in the tree".into(), 1.0, f64::from(deepest)));
    figure.note = "Inner nodes of the SAH tree. U: area relative to the root's; R: queries whose effective segment overlaps the box.".into();
    figure
}

/// Least / greatest of T / (P · f) over both children, for every node with two inner children that have a T.
fn sibling_ratios(rows: &[Row], rays: bool, f: fn(f64) -> f64) -> Vec<f64> {
    let quotient = |row: &Row| {
        let (p, t) = values(row, rays);
        t / (p * f(row.primitives as f64))
    };
    // Siblings are adjacent nodes.
    let pairs =
        rows.windows(2).filter(|pair| pair[0].node + 1 == pair[1].node && pair[0].parent == pair[1].parent);
    let mut ratios: Vec<f64> = pairs
        .map(|pair| (quotient(&pair[0]), quotient(&pair[1])))
        .filter(|(a, b)| a.is_finite() && b.is_finite() && a.max(*b) > 0.0)
        .map(|(a, b)| a.min(b) / a.max(b))
        .collect();
    ratios.sort_by(f64::total_cmp);
    ratios
}

/// How alike T / (P · f) is for siblings: 1 for all of them would be a perfect predictor of which one costs more.
pub fn siblings(rows: &[Row], scene: &str) -> Figure {
    let panel = |rays: bool, title: &str| {
        let mut series = Vec::new();
        for ((name, f), color) in PREDICTORS.into_iter().zip(PALETTE) {
            let ratios = sibling_ratios(rows, rays, f);
            let last = ratios.len().saturating_sub(1);
            let at = |step: usize| ratios.get(step * last / 100).map(|&ratio| (ratio, step as f64));
            let points = (0..=100).filter_map(at).collect();
            series.push(Series::line(&format!("f(n) = {name}"), color, Stroke::Solid, Mark::None, points));
        }
        Chart::new(
            title,
            "least / greatest T / (P · f) of two siblings",
            "share of sibling pairs below (%)",
            series,
        )
        .with_x(0.0, 1.0)
        .with_y(0.0, 100.0)
    };
    let charts = vec![panel(false, "P and T from area (U)"), panel(true, "P and T from rays (R)")];
    let mut figure = Figure::new(&format!("How well predictors rank siblings: {scene}"), 2, charts);
    figure.note =
        "Cumulative; the further to the right a curve is, the better the predictor. Pairs of inner nodes."
            .into();
    figure
}
