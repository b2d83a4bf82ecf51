//! How few rays are enough: trees from the queries of 16 × 16 to 256 × 256 pixels, counted on all queries.

use super::measure::{area_tree, ray_tree};
use super::trace::{Query, Trace, prepared, t_r};
use super::{ExperimentError, Settings, summary};
use crate::builder::Config;
use crate::probability::rays::{Count, RaySet};
use crate::progress::Progress;
use crate::random::Random;
use crate::report::plot::{BLACK, BLUE, Chart, Figure, GREEN, Mark, Series, Stroke, VERMILLION};
use crate::tree::Tree;
use std::collections::HashSet;
use std::io::{self, Write};

/// Edges of the sampled images, in pixels.
pub const EDGES: [u64; 5] = [16, 32, 64, 128, 256];

/// One tree, counted on all queries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Edge of the image; 0 for the tree from area.
    pub edge: u64,
    pub trial: u64,
    /// Queries that the tree was built from.
    pub training: u64,
    /// Per query.
    pub t_r: f64,
    /// Divided by that of the tree from all queries.
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
    let config = Config::default();
    let count = |tree: &Tree| t_r(&prepared(tree, trace), &trace.queries) as f64 / trace.queries.len() as f64;
    let from = |queries: &mut dyn Iterator<Item = &Query>| {
        let set = RaySet::of_records(queries.map(|query| &query.record));
        let tree = ray_tree(&trace.triangles, &set, Count::default(), &config)?;
        Ok::<_, ExperimentError>(count(&tree))
    };
    let all = from(&mut trace.queries.iter())?;
    let area = count(&area_tree(&trace.triangles, &config)?);
    let mut rows = vec![Row { edge: 0, trial: 0, training: 0, t_r: area, relative: area / all }];
    let edges = EDGES.iter().step_by(if settings.quick { 2 } else { 1 });
    let progress = Progress::new("sampling", edges.len() as u64 * settings.trials);
    for &edge in edges {
        let pixels = (edge * edge) as usize;
        if pixels > groups.len() {
            break;
        }
        for trial in 0..settings.trials {
            let chosen = draw(&groups, pixels, &mut Random::stream(settings.seed, &[edge, trial]));
            let mut queries = trace.queries.iter().filter(|query| chosen.contains(&query.group));
            let training = queries.clone().count() as u64;
            let t_r = from(&mut queries)?;
            rows.push(Row { edge, trial, training, t_r, relative: t_r / all });
            progress.advance(1);
        }
    }
    Ok(rows)
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

/// `edge,trial,training_queries,t_r,relative`; edge 0 is the tree from area.
///
/// # Errors
/// What `out` says.
pub fn write_csv(rows: &[Row], out: &mut impl Write) -> io::Result<()> {
    writeln!(out, "edge,trial,training_queries,t_r,relative")?;
    for Row { edge, trial, training, t_r, relative } in rows {
        writeln!(out, "{edge},{trial},{training},{t_r:.4},{relative:.5}")?;
    }
    Ok(())
}

/// T_R over the size of the image, relative to the tree from all queries.
pub fn figure(rows: &[Row], scene: &str) -> Figure {
    let place = |edge: u64| EDGES.iter().position(|&e| e == edge).unwrap_or(0) as f64;
    let ours = summary(rows.iter().filter(|row| row.edge > 0).map(|row| (place(row.edge), row.relative)));
    let band = ours.iter().map(|p| (p.x, p.mean - p.error, p.mean + p.error)).collect();
    let line = ours.iter().map(|p| (p.x, p.mean)).collect();
    let across = |y: f64| vec![(-0.3, y), (4.3, y)];
    let mut series = vec![
        Series::band(VERMILLION, band),
        Series::line("from the queries of the image", VERMILLION, Stroke::Solid, Mark::Disk, line),
        Series::line("from all queries", BLACK, Stroke::Dotted, Mark::None, across(1.0)),
        Series::line("16×16, published (SRDH 2012)", GREEN, Stroke::Dashed, Mark::Ring, vec![(0.0, 1.06)]),
    ];
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
