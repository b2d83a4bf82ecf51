//! How few rays are enough: trees from the queries of 16 × 16 to 256 × 256 pixels, counted on all queries. Each is built
//! from plain counts, from counts shrunk towards area, which matters where few rays are left at a node, and from a blend of both.

use super::measure::{area_tree, ray_tree};
use super::trace::{Trace, prepared, t_r};
use super::{ExperimentError, Settings, summary};
use crate::builder::{BuildError, Config};
use crate::probability::blend::Blend;
use crate::probability::rays::{Count, Measure, RaySet};
use crate::probability::shrunk::Shrunk;
use crate::progress::Progress;
use crate::random::Random;
use crate::report::plot::{
    BLACK, BLUE, Chart, Figure, GREEN, Mark, ORANGE, PURPLE, Series, Stroke, VERMILLION,
};
use crate::tree::Tree;
use std::collections::HashSet;
use std::io::{self, Write};

/// Edges of the sampled images, in pixels.
pub const EDGES: [u64; 5] = [16, 32, 64, 128, 256];

/// Plain counts, counts shrunk towards area, and a blend with area.
pub const ESTIMATES: [&str; 3] = ["counts", "shrunk", "blend"];

/// Rays that area is worth to the shrunk counts.
const STRENGTH: f64 = 1.0;

/// Weight of the rays in the blend.
const WEIGHT: f64 = 0.5;

/// One tree, counted on all queries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// What is made of the counts, of [`ESTIMATES`]; `area` for the tree from area.
    pub estimate: &'static str,
    /// Edge of the image; 0 for the tree from area.
    pub edge: u64,
    pub trial: u64,
    /// Queries that the tree was built from.
    pub training: u64,
    /// Per query.
    pub t_r: f64,
    /// Divided by that of the tree from all queries, by plain counts.
    pub relative: f64,
}

/// Pixels are drawn at random from those of the trace, as many as the smaller image has.
///
/// # Errors
/// See [`ExperimentError`]; also when the trace has fewer pixels than the smallest image.
pub fn run(trace: &Trace, settings: &Settings) -> Result<Vec<Row>, ExperimentError> {
    let groups = trace.groups();
    if (groups.len() as u64) < EDGES[0] * EDGES[0] {
        return Err(ExperimentError::TooFew { found: groups.len(), least: (EDGES[0] * EDGES[0]) as usize });
    }
    let count = |tree: &Tree| t_r(&prepared(tree, trace), &trace.queries) as f64 / trace.queries.len() as f64;
    let from = |set: &RaySet, estimate: &str| -> Result<f64, ExperimentError> {
        let tree = match estimate {
            "shrunk" => built(trace, set, Shrunk::new(STRENGTH)?)?,
            "blend" => built(trace, set, Blend::new(WEIGHT)?)?,
            _ => built(trace, set, Count::default())?,
        };
        Ok(count(&tree))
    };
    let all = from(&RaySet::of_records(trace.queries.iter().map(|query| &query.record)), ESTIMATES[0])?;
    let area = count(&area_tree(&trace.triangles, &Config::default())?);
    let mut rows =
        vec![Row { estimate: "area", edge: 0, trial: 0, training: 0, t_r: area, relative: area / all }];
    let edges = EDGES.iter().step_by(if settings.quick { 2 } else { 1 });
    let progress = Progress::new("sampling", edges.len() as u64 * settings.trials);
    for &edge in edges {
        let pixels = (edge * edge) as usize;
        if pixels > groups.len() {
            break;
        }
        for trial in 0..settings.trials {
            let chosen = draw(&groups, pixels, &mut Random::stream(settings.seed, &[edge, trial]));
            let queries = trace.queries.iter().filter(|query| chosen.contains(&query.group));
            let training = queries.clone().count() as u64;
            let set = RaySet::of_records(queries.map(|query| &query.record));
            for estimate in ESTIMATES {
                let t_r = from(&set, estimate)?;
                rows.push(Row { estimate, edge, trial, training, t_r, relative: t_r / all });
            }
            progress.advance(1);
        }
    }
    Ok(rows)
}

fn built(trace: &Trace, set: &RaySet, measure: impl Measure) -> Result<Tree, BuildError> {
    ray_tree(&trace.triangles, set, measure, &Config::default())
}

/// `count` of `groups`, without repetition.
fn draw(groups: &[u64], count: usize, random: &mut Random) -> HashSet<u64> {
    let mut groups = groups.to_vec();
    for index in 0..count.min(groups.len()) {
        let other = index + random.below((groups.len() - index) as u64) as usize;
        groups.swap(index, other);
    }
    groups.truncate(count);
    groups.into_iter().collect()
}

/// `estimate,edge,trial,training_queries,t_r,relative`; edge 0 is the tree from area.
///
/// # Errors
/// What `out` says.
pub fn write_csv(rows: &[Row], out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "estimate,edge,trial,training_queries,t_r,relative")?;
    for Row { estimate, edge, trial, training, t_r, relative } in rows {
        writeln!(out, "{estimate},{edge},{trial},{training},{t_r:.4},{relative:.5}")?;
    }
    Ok(())
}

/// T_R over the size of the image, relative to the tree from all queries.
pub fn figure(rows: &[Row], scene: &str) -> Figure {
    let place = |edge: u64| EDGES.iter().position(|&e| e == edge).unwrap_or(0) as f64;
    let across = |y: f64| vec![(-0.3, y), (4.3, y)];
    let mut series = Vec::new();
    for (estimate, label, color) in [
        ("counts", "from counts", VERMILLION),
        ("shrunk", "from counts shrunk towards area", PURPLE),
        ("blend", "from half counts, half area", ORANGE),
    ] {
        let of = rows.iter().filter(|row| row.estimate == estimate);
        let ours = summary(of.map(|row| (place(row.edge), row.relative)));
        let band = ours.iter().map(|p| (p.x, p.mean - p.error, p.mean + p.error)).collect();
        let line = ours.iter().map(|p| (p.x, p.mean)).collect();
        series.push(Series::band(color, band));
        series.push(Series::line(label, color, Stroke::Solid, Mark::Disk, line));
    }
    series.extend([
        Series::line("from all queries", BLACK, Stroke::Dotted, Mark::None, across(1.0)),
        Series::line("16×16, published (SRDH 2012)", GREEN, Stroke::Dashed, Mark::Ring, vec![(0.0, 1.06)]),
    ]);
    if let Some(area) = rows.iter().find(|row| row.edge == 0) {
        series.push(Series::line("from area (SAH)", BLUE, Stroke::Solid, Mark::None, across(area.relative)));
    }
    let mut chart =
        Chart::new("", "pixels of the sampled image", "T_R relative to the tree from all queries", series)
            .with_x(-0.3, 4.3);
    chart.x.names = EDGES.iter().map(|edge| format!("{edge}×{edge}")).collect();
    let mut figure = Figure::new(&format!("How few rays are enough: {scene}"), 1, vec![chart]);
    figure.chart_size = (640, 380);
    figure.note =
        "Counted on all queries. Published: Feltman, Lee, Fatahalian 2012, at most 6% above for shadow rays."
            .into();
    figure
}
