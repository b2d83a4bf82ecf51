//! What a conversion could not keep, counted by what it is.

use crate::format::rays::{Chunk, Header};
use crate::inspect::text::grouped;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::{self, Formatter};

/// Counts of what has no place in the format that is written; empty when the way back gives the same file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Losses {
    /// Whole queries (or nodes) that are not in the output, by reason.
    pub left_out: BTreeMap<&'static str, u64>,
    /// Values of those that are in it, by name: how many of them could not be kept.
    pub lost: BTreeMap<&'static str, u64>,
}

impl Losses {
    /// `count` more queries are not in the output.
    pub fn leave_out(&mut self, reason: &'static str, count: u64) {
        add(&mut self.left_out, reason, count);
    }

    /// `count` more values are not in the output.
    pub fn lose(&mut self, name: &'static str, count: u64) {
        add(&mut self.lost, name, count);
    }

    /// Loses what a header says of all queries.
    pub fn lose_header(&mut self, header: &Header) {
        self.lose("scene fingerprint", u64::from(header.fingerprint != 0));
        self.lose("Embree's version", u64::from(header.embree_version != 0));
        self.lose("note that the order does not depend on threads", u64::from(header.deterministic));
    }

    /// Loses what a chunk says beside its records.
    pub fn lose_chunk(&mut self, chunk: &Chunk) {
        self.lose("reject", chunk.rejects.len() as u64);
        self.lose("scene number of a chunk", u64::from(chunk.info.scene != 0));
        self.lose("thread of a chunk", u64::from(chunk.info.thread != 0));
    }

    /// Together with those of another step.
    pub fn and(mut self, other: Losses) -> Losses {
        other.left_out.into_iter().for_each(|(reason, count)| self.leave_out(reason, count));
        other.lost.into_iter().for_each(|(name, count)| self.lose(name, count));
        self
    }

    /// Queries that are not in the output.
    pub fn left_out_count(&self) -> u64 {
        self.left_out.values().sum()
    }
}

fn add(counts: &mut BTreeMap<&'static str, u64>, name: &'static str, count: u64) {
    if count > 0 {
        *counts.entry(name).or_default() += count;
    }
}

/// A line each; nothing when nothing was lost.
impl fmt::Display for Losses {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        for (verb, counts) in [("left out", &self.left_out), ("lost", &self.lost)] {
            for (name, &count) in counts {
                writeln!(f, "  {verb:<9} {:>13}  {name}", grouped(count))?;
            }
        }
        Ok(())
    }
}
