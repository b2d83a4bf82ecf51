//! What a comparison has against the answers of its trees: wrong ones, too many that are borderline, and broken identities.

use super::kernels::Answers;
use super::{Comparison, RecordingResult, Run, kind_name};
use crate::format::rays::{NO_DEPTH, NO_PATH, NO_TRIANGLE, Purpose, Record};
use crate::replay::Mismatch;
use crate::replay::pixels::ImageSize;
use std::fmt::Write;

/// How many answers of a tree, over one recording under one traversal, are not as recorded before that is a failure: some recordings cannot be perfect.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Allowed {
    pub wrong: u64,
    /// `None`: any number, since both answers are right.
    pub borderline: Option<u64>,
}

impl Comparison {
    /// Wrong and borderline answers beyond what is allowed, and broken identities, a line each; none when all is well.
    pub fn failures(&self) -> Vec<String> {
        let mut lines = Vec::new();
        for (recording, tree, results) in self.results() {
            for Run { traversal, outcome } in &results.runs {
                let who = format!("{}: {}{}", tree.path, traversal.name(), self.over(recording));
                let total = &outcome.tallies.total;
                let first = outcome.mismatch.as_ref();
                let image = recording.image;
                lines.extend(self.beyond(&who, total.borderline, total.mismatches, first, image));
                if let Some(query) = outcome.violation {
                    lines.push(format!(
                        "{who}: box tests of query {query} are not those of T_R; please report this"
                    ));
                }
            }
        }
        for recording in &self.recordings {
            let answers = recording.kernels.iter().flat_map(|kernels| &kernels.trees);
            for (tree, answers) in self.trees.iter().zip(answers) {
                let Some(Answers { mismatches, borderline, mismatch, .. }) = answers else { continue };
                let who = format!("{}: Embree's kernels{}", tree.path, self.over(recording));
                lines.extend(self.beyond(&who, *borderline, *mismatches, mismatch.as_ref(), recording.image));
            }
        }
        lines
    }

    /// What of the answers of `who` is beyond what is allowed.
    fn beyond(
        &self,
        who: &str,
        borderline: u64,
        wrong: u64,
        first: Option<&Mismatch>,
        image: Option<ImageSize>,
    ) -> Vec<String> {
        let Allowed { wrong: most_wrong, borderline: most_borderline } = self.settings.allowed;
        let mut lines = Vec::new();
        if let Some(most) = most_borderline.filter(|&most| borderline > most) {
            lines.push(format!("{who}: {borderline} borderline answers, and {most} are allowed"));
        }
        if let Some(first) = first.filter(|_| wrong > most_wrong) {
            lines.push(format!("{who}: {wrong} wrong answers, first {}", describe(first, image)));
        }
        lines
    }

    /// Which recording, where there are several.
    pub(super) fn over(&self, recording: &RecordingResult) -> String {
        if self.recordings.len() > 1 { format!(" over {}", recording.path) } else { String::new() }
    }
}

/// The query, what was recorded and what was found, in one line.
fn describe(mismatch: &Mismatch, image: Option<ImageSize>) -> String {
    let Mismatch { query, record, found } = mismatch;
    let mut text =
        format!("query {query} ({}, {}", kind_name(record.kind), Purpose::from_byte(record.purpose).name());
    // Writing to a String cannot fail.
    let _ = match image.and_then(|image| image.pixel(record.path)) {
        _ if record.path == NO_PATH => Ok(()),
        Some((x, y)) => write!(text, ", pixel {x},{y}"),
        None => write!(text, ", path {}", record.path),
    };
    if record.depth != NO_DEPTH {
        let _ = write!(text, ", depth {}", record.depth);
    }
    let recorded = recorded_answer(record);
    let found = match (found, record.is_occlusion()) {
        (None, true) => "not occluded".to_owned(),
        (None, false) => "a miss".to_owned(),
        // Embree does not say by what.
        (Some(hit), true) if hit.triangle == NO_TRIANGLE => "occluded".to_owned(),
        (Some(hit), true) => format!("occluded by triangle {} at t {}", hit.triangle, hit.t),
        (Some(hit), false) => format!("triangle {} at t {}", hit.triangle, hit.t),
    };
    let _ = write!(text, "): recorded {recorded}, found {found}");
    text
}

fn recorded_answer(record: &Record) -> String {
    match (record.is_occlusion(), record.is_hit()) {
        (true, true) => "occluded".to_owned(),
        (true, false) => "not occluded".to_owned(),
        (false, true) => format!("triangle {} at t {}", record.triangle, record.t),
        (false, false) => "a miss".to_owned(),
    }
}
