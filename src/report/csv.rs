//! A comparison as CSV: a row per recording, tree, traversal and group of queries, with the tree's own numbers repeated.

use super::{gamma_quantile, groups, mean};
use crate::compare::Comparison;
use crate::traverse::Decisions;
use std::fmt::Write;

const COLUMNS: &str = "path,nodes,leaves,depth,max_children,sah_cost,t_r,tree_gamma,traversal,group,name,queries,box_tests,\
                       node_visits,primitive_tests,mismatches,borderline,unchecked,moving,seconds,gamma,box_tests_mean,box_tests_median,\
                       box_tests_p99,node_visits_mean,node_visits_median,node_visits_p99,primitive_tests_mean,\
                       primitive_tests_median,primitive_tests_p99,gamma_median,gamma_p99,epo,leaf_count_variability,\
                       early_hits,early_misses,by_rays,few,octets,cost,cost_ratio,leaf_visits,block_tests,rays";

/// The whole comparison, a header line first.
pub fn render(comparison: &Comparison) -> String {
    let costs = &comparison.settings.costs;
    let mut text = format!("{COLUMNS}\n");
    for (place, (recording, tree, result)) in comparison.results().enumerate() {
        let number = place % comparison.trees.len();
        let firsts = &recording.trees[0].runs;
        let s = &tree.statistics;
        let own = format!(
            "{},{},{},{},{},{},{},{}",
            quoted(&tree.path),
            s.nodes,
            s.leaves,
            s.depth,
            s.max_children,
            tree.sah_cost,
            result.t_r(),
            result.gamma(costs)
        );
        let rays = quoted(&recording.path);
        for (run, first) in result.runs.iter().zip(firsts) {
            // Every tree sees the same queries, so all have the same groups.
            let alike = groups(&first.outcome.tallies);
            for (group, first) in groups(&run.outcome.tallies).into_iter().zip(alike) {
                let tally = group.tally;
                let counts = &tally.counts;
                // Writing to a String cannot fail.
                let _ = write!(
                    text,
                    "{own},{},{},{},{},{},{},{},{},{},{},{},{},{}",
                    run.traversal.key(),
                    group.by,
                    group.name,
                    tally.queries,
                    counts.box_tests,
                    counts.node_visits,
                    counts.primitive_tests,
                    tally.mismatches,
                    tally.borderline,
                    tally.unchecked,
                    tally.moving,
                    tally.seconds,
                    costs.gamma(counts),
                );
                for (sum, histogram) in [
                    (counts.box_tests, &tally.box_tests),
                    (counts.node_visits, &tally.node_visits),
                    (counts.primitive_tests, &tally.primitive_tests),
                ] {
                    let (median, p99) = (histogram.quantile(0.5), histogram.quantile(0.99));
                    let _ = write!(text, ",{},{median},{p99}", mean(sum, tally.queries));
                }
                let (median, p99) = (gamma_quantile(tally, 0.5), gamma_quantile(tally, 0.99));
                let (epo, variability) = (tree.epo, result.leaf_count_variability());
                let Decisions { early_hits, early_misses, by_rays, few, octets } = tally.packets;
                let _ = write!(text, ",{median},{p99},{epo},{variability}");
                let _ = write!(text, ",{early_hits},{early_misses},{by_rays},{few},{octets}");
                let cost = comparison.cost(number, tally);
                let ratio = comparison.cost_ratio(number, tally, first.tally);
                let [cost, ratio] =
                    [cost, ratio].map(|value| value.map_or(String::new(), |it| it.to_string()));
                let (leaves, blocks) = (counts.leaf_visits, counts.block_tests);
                let _ = writeln!(text, ",{cost},{ratio},{leaves},{blocks},{rays}");
            }
        }
    }
    text
}

/// A field that may hold commas, quotes or line breaks.
fn quoted(field: &str) -> String {
    if field.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", field.replace('"', "\"\""))
    } else {
        field.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn awkward_paths_stay_one_field() {
        assert_eq!(quoted("a/b.bvh"), "a/b.bvh");
        assert_eq!(quoted("a,\"b\".bvh"), "\"a,\"\"b\"\".bvh\"");
    }
}
