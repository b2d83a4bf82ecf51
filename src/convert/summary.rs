//! What was converted, for people and as JSON.

use super::Losses;
use super::replayed::Found;
use crate::inspect::text::{bytes, grouped};
use serde::Serialize;
use std::fmt::{self, Formatter};

/// What was done.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    pub input: String,
    pub from: &'static str,
    pub output: String,
    pub to: &'static str,
    /// What was converted: queries, nodes, boxes, …
    pub unit: &'static str,
    /// How many are in the output.
    pub count: u64,
    /// Of the output.
    pub bytes: u64,
    #[serde(flatten)]
    pub losses: Losses,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub triangles: Option<Found>,
    /// What may be wrong with the output, a line each.
    pub warnings: Vec<String>,
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        let Summary { input, from, output, to, unit, .. } = self;
        writeln!(
            f,
            "{input} ({from}) -> {output} ({to}): {} {unit}, {}",
            grouped(self.count),
            bytes(self.bytes)
        )?;
        if let Some(Found { found, not_found, met_before }) = self.triangles {
            writeln!(
                f,
                "  triangles of hits: {} found, {} not where the recording says",
                grouped(found),
                grouped(not_found)
            )?;
            if met_before > 0 {
                writeln!(
                    f,
                    "  {} hits lie behind another triangle that the same ray meets",
                    grouped(met_before)
                )?;
            }
        }
        self.warnings.iter().try_for_each(|warning| writeln!(f, "  {warning}"))?;
        write!(f, "{}", self.losses)
    }
}
