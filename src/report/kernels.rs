//! Embree's kernels on each tree, as a table for people: time relative to Embree's own trees, and
//! what the answers are worth.

use super::{grouped, tree_names};
use crate::compare::kernels::{Answers, Kernels, Recorded};
use crate::compare::timing::{KernelTimes, Time, Timing};
use crate::compare::{Comparison, RecordingResult, relative};
use crate::format::rays::kind::OCCLUSION;

/// What every cell shows of a tree that is not planted.
const NOTHING: &str = "—";

/// A table whose first column is text, and what there is to say below it.
pub(crate) struct Shown {
    pub header: Vec<&'static str>,
    pub rows: Vec<Vec<String>>,
    pub notes: Vec<String>,
}

/// `None` where Embree was not asked.
pub(crate) fn shown(comparison: &Comparison, recording: &RecordingResult) -> Option<Shown> {
    let kernels = match comparison.kernels.as_ref()? {
        Ok(kernels) => kernels,
        Err(why) => {
            let notes = vec![format!("Embree has no scene of these triangles: {why}.")];
            return Some(Shown { header: Vec::new(), rows: Vec::new(), notes });
        }
    };
    let answers = recording.kernels.as_ref();
    let times = recording.timing.as_ref().and_then(|timing| Some((timing, timing.kernels.as_ref()?)));
    let mut header = vec!["Tree"];
    if let Some((timing, times)) = times {
        header.push("/ medium");
        header.extend((times.own.len() > 1).then_some("/ best"));
        header.extend(kinds(timing));
    }
    if answers.is_some() {
        header.extend(["wrong", "borderline", "flipped", "apart"]);
    }
    let row = |name: String, time: Option<&Time>, answers: Option<&Answers>| {
        let mut cells = vec![name];
        if let Some((timing, times)) = times {
            cells.extend(ratios(timing, times, time));
        }
        if header.len() > cells.len() {
            cells.extend(judged(answers));
        }
        cells
    };
    let mut rows = Vec::new();
    for (tree, name) in tree_names(comparison).into_iter().enumerate() {
        let time = times.and_then(|(_, times)| times.trees[tree].as_ref());
        rows.push(row(name, time, answers.and_then(|answers| answers.trees[tree].as_ref())));
    }
    for (number, quality) in kernels.own.iter().enumerate() {
        let time = times.and_then(|(_, times)| times.own[number].as_ref());
        // Only those of the scene in which trees are planted are asked for.
        let answers = answers.filter(|_| number == 0).map(|answers| &answers.own);
        rows.push(row(format!("Embree {quality}"), time, answers));
    }
    let notes = notes(comparison, recording, kernels);
    Some(Shown { header, rows, notes })
}

/// Columns of the kinds of queries.
fn kinds(timing: &Timing) -> impl Iterator<Item = &'static str> {
    timing.by_kind.keys().map(|&kind| if kind == OCCLUSION { "occlusion" } else { "closest" })
}

/// Time relative to Embree's own trees: of medium quality, the better, and that of each kind of query
/// to medium quality.
fn ratios(timing: &Timing, times: &KernelTimes, time: Option<&Time>) -> Vec<String> {
    let medium = times.own.first().and_then(Option::as_ref);
    let shown = |ratio: Option<f64>| ratio.map_or(NOTHING.to_owned(), |ratio| format!("{ratio:.3}"));
    let to = |median: Option<f64>| Some(relative(time?.total.median, median?));
    let mut cells = vec![shown(to(medium.map(|medium| medium.total.median)))];
    if times.own.len() > 1 {
        cells.push(shown(to(times.best(|time| Some(time.total)))));
    }
    for kind in timing.by_kind.keys() {
        let median = |time: Option<&Time>| Some(time?.by_kind.get(kind)?.median);
        let ratio = median(time).zip(median(medium)).map(|(median, own)| relative(median, own));
        cells.push(shown(ratio));
    }
    cells
}

fn judged(answers: Option<&Answers>) -> [String; 4] {
    let Some(Answers { mismatches, borderline, singly, in_packets, .. }) = answers else {
        return std::array::from_fn(|_| NOTHING.to_owned());
    };
    let flipped = singly.flipped + in_packets.flipped;
    let apart = singly.apart + in_packets.apart;
    [*mismatches, *borderline, flipped, apart].map(grouped)
}

fn notes(comparison: &Comparison, recording: &RecordingResult, kernels: &Kernels) -> Vec<String> {
    let mut notes: Vec<String> = comparison
        .trees
        .iter()
        .zip(&kernels.trees)
        .filter_map(|(tree, planted)| {
            Some(format!("{}: not planted: {}.", tree.path, planted.as_ref().err()?))
        })
        .collect();
    let mut own = format!(
        "Embree's own: {}, {}, on the trees that it builds, and each of these planted in the scene of medium quality.",
        kernels.name(),
        kernels.scene_name()
    );
    let unlike = kernels.unlike(&Recorded::of(&comparison.trees, recording));
    if !unlike.is_empty() {
        own += &format!(" Not what was recorded: {}.", unlike.join("; "));
    }
    notes.push(own);
    let Some(answers) = recording.kernels.as_ref().map(|answers| &answers.own) else { return notes };
    notes.push(format!(
        "Answers to {} queries; flipped and apart: those, singly and in packets, that are not Embree's on its own tree (a hit for a \
         miss, or t beyond 1e-4).",
        grouped(answers.queries)
    ));
    notes.extend((answers.unjudged > 0).then(|| {
        format!(
            "Not judged: {} of them, in which a filter of the program's had a say, or that hit what \
             moves or is no triangle.",
            grouped(answers.unjudged)
        )
    }));
    notes
}
