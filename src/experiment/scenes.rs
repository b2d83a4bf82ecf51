//! Every recorded scene × every builder: tests per query of trees built from the queries of 10% of the pixels, counted on
//! the others. The table of the README.

use super::measure::{area_tree, optimize_by_area, optimize_by_rays, ray_tree};
use super::trace::{Query, Trace, part, prepared};
use super::{ExperimentError, Settings};
use crate::builder::{Config, Splits};
use crate::geometry::Ray;
use crate::optimize::{self, measure::Estimate};
use crate::probability::blend::Blend;
use crate::probability::rays::{Count, RaySet};
use crate::report::plot::{Chart, Figure, Mark, PALETTE, Series, Stroke};
use crate::traverse::{Counts, Prepared, PreparedRay, Scratch, Traversal};
use crate::tree::{Tree, TreeView};
use rayon::prelude::*;
use std::io::{self, Write};

/// Share of the pixels whose queries the trees are built from.
pub const TRAINING: f64 = 0.1;

/// The weight of the blend: what a prototype found to be about the best.
const WEIGHT: f64 = 0.95;

/// The trees, in the order of the columns. Optimised ones are the sweep's, after the default optimisers: on area, the
/// control, or on the training queries.
pub const BUILDERS: [&str; 8] = [
    "recorded",
    "SAH binned",
    "SAH sweep",
    "SAH sweep, optimised on area",
    "RDH binned",
    "RDH sweep",
    "blend 0.95 sweep",
    "RDH sweep, optimised on rays",
];

/// One tree of one scene, on held-out queries.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    pub scene: String,
    pub builder: &'static str,
    pub triangles: usize,
    pub training: usize,
    pub held_out: usize,
    /// Per query, ODF.
    pub box_tests: f64,
    pub primitive_tests: f64,
    pub seconds: f64,
}

impl Row {
    /// Box and primitive tests per query.
    pub fn tests(&self) -> f64 {
        self.box_tests + self.primitive_tests
    }
}

/// Runs every builder on one scene; `recorded` is the tree of the file.
///
/// # Errors
/// See [`ExperimentError`].
pub fn run(
    scene: &str,
    recorded: TreeView,
    trace: &Trace,
    settings: &Settings,
) -> Result<Vec<Row>, ExperimentError> {
    let (training, held_out) = part(&trace.queries, TRAINING, settings.seed)?;
    let segments: Vec<Ray> = training.iter().map(|query| query.record.effective_segment()).collect();
    let set = RaySet::of_rays(segments.iter().copied());
    let binned = Config::default();
    let sweep = Config { splits: Splits::Sweep, ..binned };
    let triangles = &trace.triangles;
    let build = |builder: &str| -> Result<Option<Tree>, ExperimentError> {
        Ok(match builder {
            "SAH binned" => Some(area_tree(triangles, &binned)?),
            "SAH sweep" => Some(area_tree(triangles, &sweep)?),
            "SAH sweep, optimised on area" => {
                let mut tree = area_tree(triangles, &sweep)?;
                optimize_by_area(&mut tree, triangles)?;
                Some(tree)
            }
            "RDH sweep, optimised on rays" => {
                let mut tree = ray_tree(triangles, &set, Count::default(), &sweep)?;
                optimize_by_rays(
                    &mut tree,
                    triangles,
                    &segments,
                    Estimate::default(),
                    &optimize::Config::default(),
                )?;
                Some(tree)
            }
            "RDH binned" => Some(ray_tree(triangles, &set, Count::default(), &binned)?),
            "RDH sweep" => Some(ray_tree(triangles, &set, Count::default(), &sweep)?),
            "blend 0.95 sweep" => Some(ray_tree(triangles, &set, Blend::new(WEIGHT)?, &sweep)?),
            _ => None,
        })
    };
    let chosen = BUILDERS.into_iter().filter(|builder| !settings.quick || !builder.contains("sweep"));
    let mut rows = Vec::new();
    for builder in chosen {
        let start = std::time::Instant::now();
        let tree = build(builder)?;
        let seconds = if tree.is_some() { start.elapsed().as_secs_f64() } else { 0.0 };
        let prepared = match &tree {
            Some(tree) => prepared(tree, trace),
            None => Prepared::new(recorded, triangles, &trace.geometries),
        };
        let counts = count(&prepared, &held_out);
        let per_query = |tests: u64| tests as f64 / held_out.len() as f64;
        rows.push(Row {
            scene: scene.to_owned(),
            builder,
            triangles: triangles.len(),
            training: training.len(),
            held_out: held_out.len(),
            box_tests: per_query(counts.box_tests),
            primitive_tests: per_query(counts.primitive_tests),
            seconds,
        });
    }
    Ok(rows)
}

/// Tests of an ODF traversal, closest hits and occlusions as they were asked.
fn count(tree: &Prepared, queries: &[Query]) -> Counts {
    let count = |queries: &[Query]| {
        let (mut counts, mut scratch) = (Counts::default(), Scratch::default());
        for query in queries {
            let ray = PreparedRay::new(&query.record.ray_among_triangles());
            let candidates = query.candidates();
            if query.record.is_occlusion() {
                tree.occluder(Traversal::Odf, &ray, &candidates, &mut counts, &mut scratch);
            } else {
                tree.closest_hit(Traversal::Odf, &ray, &candidates, &mut counts, &mut scratch);
            }
        }
        counts
    };
    let add = |mut a: Counts, b: Counts| {
        a += b;
        a
    };
    queries.par_chunks(4096).map(count).reduce(Counts::default, add)
}

/// `scene,builder,triangles,training_queries,held_out_queries,box_tests,primitive_tests,tests,relative,seconds`; relative to
/// the binned SAH tree.
///
/// # Errors
/// What `out` says.
pub fn write_csv(rows: &[Row], out: &mut dyn Write) -> io::Result<()> {
    writeln!(
        out,
        "scene,builder,triangles,training_queries,held_out_queries,box_tests,primitive_tests,tests,relative,seconds"
    )?;
    for row in rows {
        let Row { scene, builder, triangles, training, held_out, box_tests, primitive_tests, seconds } = row;
        // A name is a file's: quoted, so that a comma in it does not shift the columns.
        writeln!(
            out,
            "\"{}\",\"{builder}\",{triangles},{training},{held_out},{box_tests:.3},{primitive_tests:.3},{:.3},{:.4},{seconds:.3}",
            scene.replace('"', "\"\""),
            row.tests(),
            relative(rows, row),
        )?;
    }
    Ok(())
}

/// Tests relative to the same scene's binned SAH tree.
fn relative(rows: &[Row], row: &Row) -> f64 {
    let sah = rows.iter().find(|other| other.scene == row.scene && other.builder == "SAH binned");
    sah.map_or(f64::NAN, |sah| row.tests() / sah.tests())
}

/// The table in Markdown: tests per held-out query, and in brackets relative to SAH binned.
pub fn markdown(rows: &[Row]) -> String {
    let builders: Vec<&str> =
        BUILDERS.into_iter().filter(|b| rows.iter().any(|row| row.builder == *b)).collect();
    let mut text = format!("| scene | {} |\n|---|{}\n", builders.join(" | "), "---:|".repeat(builders.len()));
    for scene in rows.chunk_by(|a, b| a.scene == b.scene) {
        text += &format!("| {} |", scene[0].scene);
        for row in scene {
            text += &format!(" {:.1} ({:.2}) |", row.tests(), relative(rows, row));
        }
        text.push('\n');
    }
    text
}

/// Tests relative to SAH binned, scene by scene.
pub fn figure(rows: &[Row]) -> Figure {
    let scenes: Vec<&str> =
        rows.chunk_by(|a, b| a.scene == b.scene).map(|rows| rows[0].scene.as_str()).collect();
    let mut series = Vec::new();
    // The control stands beside the sweep in its colour.
    let [blue, vermillion, green, purple, orange, sky, black] = PALETTE;
    let colors = [black, blue, green, green, vermillion, orange, sky, purple];
    for (builder, color) in BUILDERS.into_iter().zip(colors) {
        let of = rows.iter().filter(|row| row.builder == builder);
        let place = |row: &Row| scenes.iter().position(|scene| *scene == row.scene).unwrap_or(0) as f64;
        let points: Vec<_> = of.map(|row| (place(row), relative(rows, row))).collect();
        let mark = match builder {
            "SAH sweep, optimised on area" => Mark::Cross,
            _ if builder.starts_with("SAH") || builder == "recorded" => Mark::Ring,
            _ => Mark::Disk,
        };
        if !points.is_empty() {
            series.push(Series::line(builder, color, Stroke::None, mark, points));
        }
    }
    let last = scenes.len() as f64 - 0.5;
    let mut chart =
        Chart::new("", "", "tests per held-out query, relative to SAH binned", series).with_x(-0.5, last);
    chart.x.names = scenes.iter().map(|scene| (*scene).to_owned()).collect();
    let mut figure = Figure::new("Trees from rays on queries that they have not seen", 1, vec![chart]);
    figure.chart_size = ((120 * scenes.len() as u32).clamp(760, 2400), 400);
    figure.note =
        "Box and primitive tests, ODF. Trained on the queries of 10% of the pixels, counted on the rest."
            .into();
    figure
}
