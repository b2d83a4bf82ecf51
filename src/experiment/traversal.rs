//! RayOrder against ODF (section 2.1): visits of every inner node by both traversals of the same closest-hit queries.

use super::measure::area_tree;
use super::trace::{Trace, prepared};
use super::{ExperimentError, levels};
use crate::builder::Config;
use crate::report::plot::{BLACK, BLUE, Chart, Figure, Mark, Series, Stroke, ramp};
use crate::traverse::{Link, Observer, PreparedRay, Scratch, Traversal};
use std::io::{self, Write};

/// Visits of one inner node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    pub node: u32,
    /// The root has 1.
    pub level: u32,
    pub ray_order: u64,
    pub odf: u64,
}

struct Visits(Vec<u64>);

impl Observer for Visits {
    fn inner(&mut self, node: &Link) {
        self.0[node.node as usize] += 1;
    }
}

/// Counts on the SAH tree of the scene. Nodes that neither visits are left out.
///
/// # Errors
/// See [`ExperimentError`].
pub fn run(trace: &Trace) -> Result<Vec<Row>, ExperimentError> {
    let queries: Vec<_> = trace.queries.iter().filter(|query| !query.record.is_occlusion()).collect();
    if queries.is_empty() {
        return Err(ExperimentError::TooFew { found: 0, least: 1 });
    }
    let tree = area_tree(&trace.triangles, &Config::default())?;
    let prepared = prepared(&tree, trace);
    let count = |traversal| {
        let mut visits = Visits(vec![0; tree.nodes.len()]);
        let mut scratch = Scratch::default();
        for query in &queries {
            let ray = PreparedRay::new(&query.record.ray());
            prepared.closest_hit(traversal, &ray, &query.candidates(), &mut visits, &mut scratch);
        }
        visits.0
    };
    let (ray_order, odf) = rayon::join(|| count(Traversal::RayOrder), || count(Traversal::Odf));
    let rows = levels(tree.view()).into_iter().zip(ray_order).zip(odf).enumerate();
    let row = |(node, ((level, ray_order), odf))| Row { node: node as u32, level, ray_order, odf };
    Ok(rows.map(row).filter(|row| row.ray_order + row.odf > 0).collect())
}

/// `node,level,ray_order,odf`.
///
/// # Errors
/// What `out` says.
pub fn write_csv(rows: &[Row], out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "node,level,ray_order,odf")?;
    for Row { node, level, ray_order, odf } in rows {
        writeln!(out, "{node},{level},{ray_order},{odf}")?;
    }
    Ok(())
}

/// Borders of the histogram: visits that ODF makes more than RayOrder.
const BORDERS: [(u64, &str); 8] =
    [(0, "0"), (1, "1"), (2, "2-3"), (4, "4-7"), (8, "8-15"), (16, "16-63"), (64, "64-255"), (256, "≥ 256")];

/// A scatter of both counts, and a histogram of their difference.
pub fn figure(rows: &[Row], scene: &str) -> Figure {
    let deepest = rows.iter().map(|row| row.level).max().unwrap_or(1);
    let log = |visits: u64| (visits as f64).log10();
    let both = rows.iter().filter(|row| row.ray_order > 0 && row.odf > 0);
    let points =
        both.map(|r| (log(r.ray_order), log(r.odf), ramp(f64::from(r.level) / f64::from(deepest)))).collect();
    let most = log(rows.iter().map(|row| row.odf.max(row.ray_order)).max().unwrap_or(1)).ceil();
    let diagonal = Series::line("equal", BLACK, Stroke::Dashed, Mark::None, vec![(0.0, 0.0), (most, most)]);
    let scatter = Chart::new(
        "visits of each inner node",
        "visits by RayOrder",
        "visits by ODF",
        vec![Series::Scatter { points }, diagonal],
    )
    .with_x(-0.1, most)
    .with_y(-0.1, most)
    .logarithmic();

    // RayOrder visits exactly the nodes that the effective segment overlaps, so ODF can only visit more.
    let bars = BORDERS.iter().enumerate().map(|(index, (from, _))| {
        let to = BORDERS.get(index + 1).map_or(u64::MAX, |next| next.0);
        let nodes = rows.iter().filter(|r| (*from..to).contains(&r.odf.saturating_sub(r.ray_order))).count();
        (index as f64 - 0.4, index as f64 + 0.4, 100.0 * nodes as f64 / rows.len().max(1) as f64)
    });
    let bars = Series::Bars { label: String::new(), color: BLUE, bars: bars.collect() };
    let mut histogram = Chart::new(
        "difference by node",
        "visits by ODF that RayOrder does not make",
        "share of visited inner nodes (%)",
        vec![bars],
    )
    .with_x(-0.6, 7.6);
    histogram.y.low = 0.0;
    histogram.x.names = BORDERS.iter().map(|border| border.1.to_owned()).collect();
    let mut figure = Figure::new(&format!("RayOrder against ODF: {scene}"), 2, vec![scatter, histogram]);
    let total = |count: fn(&Row) -> u64| rows.iter().map(count).sum::<u64>();
    let only = |count: fn(&Row) -> bool| rows.iter().filter(|row| count(row)).count();
    figure.note = format!(
        "ODF makes {:.1}% more visits; of {} nodes, {} are visited by ODF only and {} by RayOrder only. SAH tree, closest-hit queries.",
        100.0 * (total(|r| r.odf) as f64 / total(|r| r.ray_order).max(1) as f64 - 1.0),
        rows.len(),
        only(|r| r.ray_order == 0),
        only(|r| r.odf == 0),
    );
    figure.scale = Some(("level in the tree".into(), 1.0, f64::from(deepest)));
    figure
}
