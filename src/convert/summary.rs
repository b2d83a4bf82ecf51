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
    /// In the output.
    pub queries: u64,
    /// Of the output.
    pub bytes: u64,
    #[serde(flatten)]
    pub losses: Losses,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub triangles: Option<Found>,
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        let Summary { input, from, output, to, .. } = self;
        writeln!(
            f,
            "{input} ({from}) -> {output} ({to}): {} queries, {}",
            grouped(self.queries),
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
        write!(f, "{}", self.losses)
    }
}
