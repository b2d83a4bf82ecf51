//! Every recorded scene × every builder: what trees built from the queries of 10% of the pixels
//! cost a query of the others, and the tests that explain it.

use super::measure::{area_tree, optimize_by_area, optimize_by_rays, ray_tree};
use super::trace::{Query, Trace, part};
use super::{ExperimentError, Settings};
use crate::builder::{Config, Splits};
use crate::compare::relative;
use crate::cost::{ByKind, Costs, Counted, width_class};
use crate::geometry::Ray;
use crate::optimize::{self, measure::Estimate};
use crate::probability::blend::Blend;
use crate::probability::rays::{Count, RaySet};
use crate::report::plot::{Chart, Figure, Mark, PALETTE, Series, Stroke};
use crate::traverse::{Prepared, PreparedRay, Scratch, Traversal};
use crate::tree::statistics::Statistics;
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
    /// Nanoseconds that a query is expected to take ([`crate::cost`]), ODF.
    pub cost: f64,
    /// Counts per query.
    pub node_visits: f64,
    pub leaf_visits: f64,
    pub block_tests: f64,
    pub box_tests: f64,
    pub primitive_tests: f64,
    /// Width of the tree as costs know it: 2, 4 or 8. Tests of trees of different widths do not
    /// compare.
    pub width_class: usize,
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
        let view = tree.as_ref().map_or(recorded, Tree::view);
        let width = Statistics::of(view).max_children;
        let by_kind = count(&Prepared::new(view, triangles, &trace.geometries), &held_out);
        let mut counts = by_kind.closest_hit.counts;
        counts += by_kind.occlusion.counts;
        let per_query = |count: u64| count as f64 / held_out.len() as f64;
        rows.push(Row {
            scene: scene.to_owned(),
            builder,
            triangles: triangles.len(),
            training: training.len(),
            held_out: held_out.len(),
            cost: Costs::default().per_query(width, &by_kind).all.unwrap_or_default(),
            node_visits: per_query(counts.node_visits),
            leaf_visits: per_query(counts.leaf_visits),
            block_tests: per_query(counts.block_tests),
            box_tests: per_query(counts.box_tests),
            primitive_tests: per_query(counts.primitive_tests),
            width_class: width_class(width),
            seconds,
        });
    }
    Ok(rows)
}

/// Counts of an ODF traversal, closest hits and occlusions as they were asked.
fn count(tree: &Prepared, queries: &[Query]) -> ByKind {
    let count = |queries: &[Query]| {
        let (mut by_kind, mut scratch) = (ByKind::default(), Scratch::default());
        for query in queries {
            let ray = PreparedRay::new(&query.record.ray_among_triangles());
            let candidates = query.candidates();
            let occlusion = query.record.is_occlusion();
            let Counted { queries, counts, .. } = by_kind.of(occlusion);
            *queries += 1;
            if occlusion {
                tree.occluder(Traversal::Odf, &ray, &candidates, counts, &mut scratch);
            } else {
                tree.closest_hit(Traversal::Odf, &ray, &candidates, counts, &mut scratch);
            }
        }
        by_kind
    };
    let add = |mut a: ByKind, b: ByKind| {
        a += b;
        a
    };
    queries.par_chunks(4096).map(count).reduce(ByKind::default, add)
}

/// `scene,builder,cost,cost_ratio,node_visits,leaf_visits,block_tests,box_tests,primitive_tests,tests,tests_ratio,triangles,training_queries,
/// held_out_queries,seconds`: nanoseconds and counts per query; ratios to the same scene's binned
/// SAH tree, that of tests empty where the widths differ.
///
/// # Errors
/// What `out` says.
pub fn write_csv(rows: &[Row], out: &mut dyn Write) -> io::Result<()> {
    writeln!(
        out,
        "scene,builder,cost,cost_ratio,node_visits,leaf_visits,block_tests,box_tests,primitive_tests,tests,tests_ratio,\
         triangles,training_queries,held_out_queries,seconds"
    )?;
    for row in rows {
        let Row { scene, builder, cost, triangles, training, held_out, seconds, .. } = row;
        let counts = [row.node_visits, row.leaf_visits, row.block_tests, row.box_tests, row.primitive_tests];
        let counts = counts.map(|count| format!("{count:.3}")).join(",");
        let ratio = |ratio: Option<f64>| ratio.map_or(String::new(), |ratio| format!("{ratio:.4}"));
        // A name is a file's: quoted, so that a comma in it does not shift the columns.
        writeln!(
            out,
            "\"{}\",\"{builder}\",{cost:.3},{},{counts},{:.3},{},{triangles},{training},{held_out},{seconds:.3}",
            scene.replace('"', "\"\""),
            ratio(cost_ratio(rows, row)),
            row.tests(),
            ratio(tests_ratio(rows, row)),
        )?;
    }
    Ok(())
}

/// The same scene's binned SAH tree: what ratios are to.
fn first<'a>(rows: &'a [Row], row: &Row) -> Option<&'a Row> {
    rows.iter().find(|other| other.scene == row.scene && other.builder == "SAH binned")
}

/// Cost relative to that of [`first`].
fn cost_ratio(rows: &[Row], row: &Row) -> Option<f64> {
    Some(relative(row.cost, first(rows, row)?.cost))
}

/// Tests relative to those of [`first`]; `None` where the tree has another width.
fn tests_ratio(rows: &[Row], row: &Row) -> Option<f64> {
    let first = first(rows, row).filter(|first| first.width_class == row.width_class)?;
    Some(relative(row.tests(), first.tests()))
}

/// Two tables in Markdown: what a held-out query costs, and its tests; in brackets relative to SAH
/// binned.
pub fn markdown(rows: &[Row]) -> String {
    let builders: Vec<&str> =
        BUILDERS.into_iter().filter(|b| rows.iter().any(|row| row.builder == *b)).collect();
    let table = |title: &str, value: fn(&Row) -> f64, ratio: fn(&[Row], &Row) -> Option<f64>| {
        let columns = "---:|".repeat(builders.len());
        let mut text = format!("{title}\n\n| scene | {} |\n|---|{columns}\n", builders.join(" | "));
        for scene in rows.chunk_by(|a, b| a.scene == b.scene) {
            text += &format!("| {} |", scene[0].scene);
            for row in scene {
                let ratio = ratio(rows, row).map_or("–".to_owned(), |ratio| format!("{ratio:.2}"));
                text += &format!(" {:.1} ({ratio}) |", value(row));
            }
            text.push('\n');
        }
        text
    };
    let mut text = table("Cost of a held-out query, ns (relative to SAH binned)", |row| row.cost, cost_ratio);
    text += &table(
        "\nBox and primitive tests of a held-out query (relative to SAH binned)",
        Row::tests,
        tests_ratio,
    );
    if rows.iter().any(|row| tests_ratio(rows, row).is_none()) {
        text += "\n–: a machine tests the boxes of a node together, so tests do not compare trees of different widths.\n";
    }
    text
}

/// Cost relative to SAH binned, scene by scene, and below it tests of trees as wide.
pub fn figure(rows: &[Row]) -> Figure {
    let scenes: Vec<&str> =
        rows.chunk_by(|a, b| a.scene == b.scene).map(|rows| rows[0].scene.as_str()).collect();
    let chart = |label: &str, ratio: fn(&[Row], &Row) -> Option<f64>| {
        let mut series = Vec::new();
        // The control stands beside the sweep in its colour.
        let [blue, vermillion, green, purple, orange, sky, black] = PALETTE;
        let colors = [black, blue, green, green, vermillion, orange, sky, purple];
        for (builder, color) in BUILDERS.into_iter().zip(colors) {
            let of = rows.iter().filter(|row| row.builder == builder);
            let place = |row: &Row| scenes.iter().position(|scene| *scene == row.scene).unwrap_or(0) as f64;
            let points: Vec<_> = of.filter_map(|row| Some((place(row), ratio(rows, row)?))).collect();
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
        let mut chart = Chart::new("", "", label, series).with_x(-0.5, last);
        chart.x.names = scenes.iter().map(|scene| (*scene).to_owned()).collect();
        chart
    };
    let charts = vec![
        chart("cost of a held-out query, relative to SAH binned", cost_ratio),
        chart("its tests, relative to SAH binned (trees of its width)", tests_ratio),
    ];
    let mut figure = Figure::new("Trees from rays on queries that they have not seen", 1, charts);
    figure.chart_size = ((120 * scenes.len() as u32).clamp(760, 2400), 400);
    figure.note = "Cost: ns of visits, leaves and blocks of triangles, ODF. Trained on the queries of 10% of the pixels, \
                   counted on the rest."
        .into();
    figure
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cost_comes_first_and_tests_compare_trees_of_one_width() {
        let row = |builder, cost, tests, width_class| Row {
            scene: "a, b".to_owned(),
            builder,
            triangles: 9,
            training: 10,
            held_out: 90,
            cost,
            node_visits: 1.0,
            leaf_visits: 2.0,
            block_tests: 3.0,
            box_tests: tests,
            primitive_tests: 4.0,
            width_class,
            seconds: 0.5,
        };
        let rows = [
            row("recorded", 50.0, 96.0, 8),
            row("SAH binned", 100.0, 36.0, 2),
            row("RDH binned", 80.0, 26.0, 2),
        ];
        let text = markdown(&rows);
        assert!(text.contains("| a, b | 50.0 (0.50) | 100.0 (1.00) | 80.0 (0.80) |"), "{text}");
        assert!(text.contains("| a, b | 100.0 (–) | 40.0 (1.00) | 30.0 (0.75) |"), "{text}");
        assert!(text.ends_with("trees of different widths.\n"), "{text}");
        let mut csv = Vec::new();
        write_csv(&rows, &mut csv).expect("memory");
        let csv = String::from_utf8(csv).expect("text");
        let lines: Vec<&str> = csv.lines().collect();
        assert!(lines[0].starts_with("scene,builder,cost,cost_ratio,"), "{csv}");
        assert_eq!(
            lines[1],
            "\"a, b\",\"recorded\",50.000,0.5000,1.000,2.000,3.000,96.000,4.000,100.000,,9,10,90,0.500"
        );
        assert!(lines[3].contains(",80.000,0.8000,") && lines[3].contains(",30.000,0.7500,"), "{csv}");
    }
}
