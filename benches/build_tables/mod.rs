//! What a tree costs, and the table that has a line for every scene.

use embree_trace::format::rays::Rays;
use embree_trace::geometry::Triangle;
use embree_trace::progress::Progress;
use embree_trace::replay::check::Judge;
use embree_trace::replay::query::Choice;
use embree_trace::replay::select::Filter;
use embree_trace::replay::tally::Costs;
use embree_trace::replay::{Options, replay};
use embree_trace::traverse::{Masks, OcclusionOrder, Prepared, Traversal};
use embree_trace::tree::Tree;
use embree_trace::tree::statistics::sah_cost;

/// Queries that trees are judged by.
const QUERIES: u64 = 200_000;

/// What a node visit of two boxes costs is 1.2.
const COSTS: Costs = Costs { c_i: 0.6, c_p: 1.0 };

/// What a tree costs, by area and by recorded queries.
#[derive(Clone, Copy)]
pub struct Found {
    pub sah: f64,
    /// Per query, depth first; NaN without a recording.
    pub odf: f64,
    /// Answers that are not the recorded ones.
    pub wrong: u64,
}

impl Found {
    pub fn of(tree: &Tree, triangles: &[Triangle], rays: Option<&Rays>) -> Found {
        let sah = sah_cost(tree.view(), COSTS.c_i, COSTS.c_p);
        let Some(rays) = rays else { return Found { sah, odf: f64::NAN, wrong: 0 } };
        let prepared = Prepared::new(tree.view(), triangles, &[]);
        let judge = Judge { tree: tree.view(), triangles, masks: Masks::new(&[]), flattened: false };
        let options = Options {
            traversal: Traversal::Odf,
            occlusion_order: OcclusionOrder::Nearest,
            choice: Choice { scene: 0, filter: Filter::default(), held_out: None, sample: Some(QUERIES) },
            overlap: false,
            costs: COSTS,
            sort: None,
            packet: None,
            profile: None,
            image: None,
        };
        let outcome =
            replay(&prepared, &judge, rays, &options, &Progress::hidden()).expect("a whole recording");
        let total = &outcome.tallies.total;
        Found { sah, odf: COSTS.gamma(&total.counts) / total.queries as f64, wrong: total.mismatches }
    }
}

/// A scene: our best tree from area, Embree's, and those of all crates.
pub struct Line {
    pub scene: String,
    pub triangles: usize,
    pub ours: Found,
    pub high: Option<Found>,
    pub crates: Vec<(&'static str, Found)>,
    /// Our time over Embree's, for each number of threads.
    pub times_high: [f64; 2],
}

/// Prints a line for each scene, and one for the scene where we do worst, by each measure.
pub fn print_lines(lines: &[Line]) {
    let by_cost = |name: &str| format!("{:>9}{:>9}{:>9} {:<18}", name, "high", "best", "of all crates");
    println!(
        "\n{:<20}{:>10}{}{}{:>8}{:>8}{:>14}",
        "",
        "triangles",
        by_cost("SAH ours"),
        by_cost("ODF ours"),
        "time/high",
        "2 threads",
        "wrong/theirs"
    );
    let mut worst = [0.0f64; 4];
    for line in lines {
        let columns = [|found: &Found| found.sah, |found: &Found| found.odf].map(|cost| {
            let best = line.crates.iter().min_by(|a, b| cost(&a.1).total_cmp(&cost(&b.1)));
            let (name, best) = best.map_or(("", f64::NAN), |(name, found)| (*name, cost(found)));
            let high = line.high.as_ref().map_or(f64::NAN, cost);
            let ours = cost(&line.ours);
            (format!("{ours:>9.3}{high:>9.3}{best:>9.3} {name:<18}"), ours / best.min(high))
        });
        let [one, two] = line.times_high;
        for (worst, ratio) in worst.iter_mut().zip([columns[0].1, columns[1].1, one, two]) {
            *worst = worst.max(ratio);
        }
        let theirs = line.crates.iter().map(|(_, found)| found).chain(&line.high);
        let wrong: u64 = theirs.map(|found| found.wrong).sum();
        println!(
            "{:<20}{:>10}{}{}{one:>8.2}{two:>8.2}{:>14}",
            line.scene,
            line.triangles,
            columns[0].0,
            columns[1].0,
            format!("{}/{wrong}", line.ours.wrong)
        );
    }
    let [sah, odf, one, two] = worst;
    println!(
        "worst over the better of high and the best crate: SAH cost {sah:.3}, ODF cost {odf:.3}; worst time over high: {one:.2} on one thread, {two:.2} on two"
    );
}
