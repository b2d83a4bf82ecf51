//! Parquet: a table with a row per query, for pandas, Polars, DuckDB and Spark.
//!
//! Columns of plain types (`COLUMNS`), zstd, a row group per chunk. Rejects are a list in the row of their query; the thread and the
//! number within it stand in every row, and what the header of a `.rays` says in the file's metadata, so that the way back gives the same
//! recording. Tables that other programs wrote are read, too, whatever their row groups: a column may then be optional, of wider
//! numbers, and the last four may be missing.

mod footer;
mod guard;
mod pages;
mod read;
mod thrift;
mod write;

pub use read::ParquetSource;
pub use write::ParquetSink;

use super::ConvertError;
use crate::format::excerpt;
use crate::format::rays::Record;
use std::mem::offset_of;

/// The first and the last bytes of a file.
pub const MAGIC: &[u8] = b"PAR1";

/// Names of what the metadata of a file holds: the header of a `.rays`.
mod key {
    pub const FINGERPRINT: &str = "embree_trace.scene_fingerprint";
    pub const EMBREE: &str = "embree_trace.embree_version";
    pub const DETERMINISTIC: &str = "embree_trace.deterministic";
    pub const PRODUCER: &str = "embree_trace.producer";
}

/// What is wrong with a table. Names of columns, and what the crate `parquet` says, may have anything from the file in them.
fn wrong(what: impl ToString) -> ConvertError {
    ConvertError::Table(excerpt(&what.to_string(), 1000))
}

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Content {
    /// A `f32` of the record, at this offset.
    Float(usize),
    /// A `u32` of the record.
    Word(usize),
    /// A byte of the record.
    Byte(usize),
    /// The chunk's scene.
    Scene,
    /// The chunk's thread.
    Thread,
    /// The number of the query within the thread.
    Sequence,
    /// Triangles that the program's filter refused, as a list.
    Rejects,
}

const F: usize = size_of::<f32>();
const ORIGIN: usize = offset_of!(Record, origin);
const DIRECTION: usize = offset_of!(Record, direction);

/// Every column, in the order of the file.
const COLUMNS: [(&str, Content); 22] = [
    ("origin_x", Content::Float(ORIGIN)),
    ("origin_y", Content::Float(ORIGIN + F)),
    ("origin_z", Content::Float(ORIGIN + 2 * F)),
    ("tnear", Content::Float(offset_of!(Record, tnear))),
    ("direction_x", Content::Float(DIRECTION)),
    ("direction_y", Content::Float(DIRECTION + F)),
    ("direction_z", Content::Float(DIRECTION + 2 * F)),
    ("tfar", Content::Float(offset_of!(Record, tfar))),
    ("time", Content::Float(offset_of!(Record, time))),
    ("mask", Content::Word(offset_of!(Record, mask))),
    ("t", Content::Float(offset_of!(Record, t))),
    ("triangle", Content::Word(offset_of!(Record, triangle))),
    ("u", Content::Float(offset_of!(Record, u))),
    ("v", Content::Float(offset_of!(Record, v))),
    ("path", Content::Word(offset_of!(Record, path))),
    ("kind", Content::Byte(offset_of!(Record, kind))),
    ("depth", Content::Byte(offset_of!(Record, depth))),
    ("flags", Content::Byte(offset_of!(Record, flags))),
    ("purpose", Content::Byte(offset_of!(Record, purpose))),
    ("scene", Content::Scene),
    ("thread", Content::Thread),
    ("sequence", Content::Sequence),
];

/// The column behind them.
const REJECTS: (&str, Content) = ("rejects", Content::Rejects);

impl Content {
    /// Whether a table without the column can be read.
    fn may_be_missing(self) -> bool {
        matches!(self, Content::Scene | Content::Thread | Content::Sequence | Content::Rejects)
    }

    /// The column's type, as the schema says it.
    fn declared(self, name: &str) -> String {
        match self {
            Content::Float(_) => format!("REQUIRED FLOAT {name};"),
            Content::Word(_) | Content::Thread => format!("REQUIRED INT32 {name} (INTEGER(32,false));"),
            Content::Byte(_) => format!("REQUIRED INT32 {name} (INTEGER(8,false));"),
            Content::Scene => format!("REQUIRED INT32 {name} (INTEGER(16,false));"),
            Content::Sequence => format!("REQUIRED INT64 {name} (INTEGER(64,false));"),
            Content::Rejects => {
                let element = "REQUIRED INT32 element (INTEGER(32,false));";
                format!("REQUIRED GROUP {name} (LIST) {{ REPEATED GROUP list {{ {element} }} }}")
            }
        }
    }
}
