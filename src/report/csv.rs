//! A comparison as CSV: a row per recording, tree, traversal and group of queries, with the tree's own numbers repeated.

use super::time::Nanoseconds;
use super::{gamma_quantile, groups, mean};
use crate::compare::kernels::Recorded;
use crate::compare::timing::{Seconds, Time, Timing};
use crate::compare::{Comparison, RecordingResult, kind_name};
use crate::traverse::Decisions;
use std::fmt::Write;

const COLUMNS: &str = "path,nodes,leaves,depth,max_children,sah_cost,t_r,tree_gamma,traversal,group,name,queries,box_tests,\
                       node_visits,primitive_tests,mismatches,borderline,unchecked,moving,seconds,gamma,box_tests_mean,box_tests_median,\
                       box_tests_p99,node_visits_mean,node_visits_median,node_visits_p99,primitive_tests_mean,\
                       primitive_tests_median,primitive_tests_p99,gamma_median,gamma_p99,epo,leaf_count_variability,\
                       early_hits,early_misses,by_rays,few,octets,cost,cost_ratio,leaf_visits,block_tests,rays";

/// Columns that follow where times were measured.
const TIMES: &str = ",ns,ns_least,ns_greatest";

/// The whole comparison, a header line first. Where times were measured, also a row per group under Embree's kernels, on each tree and on Embree's own.
pub fn render(comparison: &Comparison) -> String {
    let costs = &comparison.settings.costs;
    let is_timed = comparison.recordings.iter().any(|recording| recording.timing.is_some());
    let mut text = format!("{COLUMNS}{}\n", if is_timed { TIMES } else { "" });
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
                let _ = write!(text, ",{cost},{ratio},{leaves},{blocks},{rays}");
                if is_timed {
                    let time = recording.timing.as_ref().and_then(|timing| {
                        let run = result.runs.iter().position(|other| std::ptr::eq(other, run))?;
                        let time = &timing.trees[number][run];
                        let mut times = timed_groups(timing, time).into_iter();
                        times.find(|(by, name, ..)| (*by, name.as_str()) == (group.by, group.name.as_str()))
                    });
                    text += &time.map_or(",,,".to_owned(), |(_, _, queries, seconds)| ns(&seconds, queries));
                }
                text.push('\n');
            }
        }
    }
    comparison.recordings.iter().for_each(|recording| text += &embrees(comparison, recording));
    text
}

/// Times in nanoseconds per query, each behind a comma.
fn ns(seconds: &Seconds, queries: u64) -> String {
    let Nanoseconds { median, least, greatest } = Nanoseconds::of(seconds, queries);
    format!(",{median},{least},{greatest}")
}

/// Groups that were timed, as [`groups`] names them: their queries and what these took.
fn timed_groups(timing: &Timing, time: &Time) -> Vec<(&'static str, String, u64, Seconds)> {
    let mut groups = vec![("total", "all".to_owned(), timing.queries, time.total)];
    let kinds = timing.by_kind.iter().filter_map(|(kind, &queries)| {
        Some(("kind", kind_name(*kind).to_owned(), queries, *time.by_kind.get(kind)?))
    });
    let purposes = timing.by_purpose.iter().filter_map(|(purpose, &queries)| {
        Some(("purpose", purpose.name().to_owned(), queries, *time.by_purpose.get(purpose)?))
    });
    groups.extend(kinds.chain(purposes));
    groups
}

/// Rows of Embree's kernels: their traversal is `embree`, and what has nothing to do with time is empty.
fn embrees(comparison: &Comparison, recording: &RecordingResult) -> String {
    let mut text = String::new();
    let Some(timing) = &recording.timing else { return text };
    let (Some(times), Some(Ok(kernels))) = (&timing.kernels, &comparison.kernels) else { return text };
    let unlike = kernels.unlike(&Recorded::of(&comparison.trees, recording)).join("; ");
    let unlike = if unlike.is_empty() { unlike } else { format!("; not what was recorded: {unlike}") };
    let own = kernels.own.iter().map(|quality| {
        format!("Embree's own: {}, {quality}, {}{unlike}", kernels.name(), kernels.scene_name())
    });
    let paths = comparison.trees.iter().map(|tree| tree.path.clone()).chain(own);
    // Between the path and the traversal, and between the queries and the recording.
    let blank = |count: usize| ",".repeat(count + 1);
    let between = blank(COLUMNS.split(',').count() - 13);
    for (path, time) in paths.zip(times.trees.iter().chain(&times.own)) {
        let Some(time) = time else { continue };
        for (by, name, queries, seconds) in timed_groups(timing, time) {
            let (path, rays) = (quoted(&path), quoted(&recording.path));
            let times = ns(&seconds, queries);
            // Writing to a String cannot fail.
            let _ = writeln!(text, "{path}{}embree,{by},{name},{queries}{between}{rays}{times}", blank(7));
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
