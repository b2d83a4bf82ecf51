//! NumPy's `.npy`: one structured array of records, byte for byte those of a raw `.rays`, so that `np.load(path, mmap_mode="r")` views it in place.
//!
//! The field names are those of the reader in `docs/formats.md`. Chunks, rejects and what a header says have no place in an array and are lost; arrays
//! of other dtypes are refused. Format: NumPy enhancement proposal 1 (numpy.lib.format), versions 1.0 to 3.0.

use super::queries::Pieces;
use super::{ConvertError, Losses, Sink, Source};
use crate::format::rays::{Chunk, ChunkInfo, Header, Record, flag, kind};
use crate::format::{ALIGNMENT, FormatError, Problem, excerpt};
use std::borrow::Cow;
use std::io::Write;
use std::mem::offset_of;
use std::ops::Range;

/// The first bytes of a file.
pub const MAGIC: &[u8] = b"\x93NUMPY";

/// The dtype of a record, as NumPy prints it.
pub const RECORD: &str = "[('origin', '<f4', (3,)), ('tnear', '<f4'), ('direction', '<f4', (3,)), ('tfar', '<f4'), ('time', '<f4'), \
     ('mask', '<u4'), ('t', '<f4'), ('triangle', '<u4'), ('uv', '<f4', (2,)), ('path', '<u4'), ('kind', '|u1'), ('depth', '|u1'), \
     ('flags', '|u1'), ('purpose', '|u1')]";

/// Bytes before the text of a header of version 1.0, and of the later ones.
const SHORT: usize = 10;
const LONG: usize = 12;

/// The header of an array, padded so that the elements are aligned.
///
/// `dtype` and `shape` as NumPy prints them, a shape as a tuple such as `(1000,)`. The text has room for its length in two bytes for every dtype that we write.
pub fn header(dtype: &str, shape: &str) -> Vec<u8> {
    let text = format!("{{'descr': {dtype}, 'fortran_order': False, 'shape': {shape}, }}");
    // A line break ends it.
    let whole = (SHORT + text.len() + 1).next_multiple_of(ALIGNMENT as usize);
    let mut bytes = Vec::with_capacity(whole);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&[1, 0]);
    bytes.extend_from_slice(&((whole - SHORT) as u16).to_le_bytes());
    bytes.extend_from_slice(text.as_bytes());
    bytes.resize(whole - 1, b' ');
    bytes.push(b'\n');
    bytes
}

/// Where the elements start and how many there are, of an array of the dtype [`RECORD`].
fn read_header(bytes: &[u8]) -> Result<(usize, u64), FormatError> {
    let truncated = |needed: usize| {
        let (needed, available) = (Some(needed as u64), bytes.len() as u64);
        FormatError::new(0, Problem::Truncated { what: "header of an .npy", needed, available })
    };
    if !bytes.starts_with(MAGIC) {
        let found = bytes[..bytes.len().min(MAGIC.len())].escape_ascii();
        return Err(FormatError::field(0, "magic", format!("\"{found}\""), "\"\\x93NUMPY\", of an .npy"));
    }
    let at = |place: usize| bytes.get(place).copied().map(usize::from).ok_or_else(|| truncated(LONG));
    let (start, length) = match at(MAGIC.len())? {
        1 => (SHORT, at(8)? | at(9)? << 8),
        2 | 3 => (LONG, at(8)? | at(9)? << 8 | at(10)? << 16 | at(11)? << 24),
        version => return Err(FormatError::field(6, "version of the .npy", version, "1, 2 or 3")),
    };
    let end = start.checked_add(length).filter(|&end| end <= bytes.len());
    let end = end.ok_or_else(|| truncated(start.saturating_add(length)))?;
    let wrong = |name: &str, found: &str, expected: &str| {
        FormatError::field(start as u64, format!("{name} of the .npy"), excerpt(found, 160), expected)
    };
    let text = String::from_utf8_lossy(&bytes[start..end]);
    let packed: String = text.chars().filter(|c| !c.is_whitespace()).collect();
    let value = |key: &str| packed.split_once(key).map(|(_, value)| value);
    // Of an array with one field per column, as an array of floats or a table of other columns would have.
    let dtype: String = RECORD.chars().filter(|c| !c.is_whitespace()).collect();
    if value("'descr':").is_none_or(|value| !value.starts_with(&dtype)) {
        return Err(wrong("dtype", text.trim(), &format!("records of the dtype {RECORD}")));
    }
    if value("'fortran_order':").is_none_or(|value| !value.starts_with("False")) {
        return Err(wrong("fortran_order", text.trim(), "False"));
    }
    let shape = value("'shape':(").and_then(|value| value.split_once(')')).map_or("", |(shape, _)| shape);
    let count = shape.strip_suffix(',').and_then(|count| count.parse::<u64>().ok());
    let count =
        count.ok_or_else(|| wrong("shape", &format!("({shape})"), "one dimension, such as (1000,)"))?;
    let available = (bytes.len() - end) as u64;
    let needed = count.checked_mul(size_of::<Record>() as u64);
    if needed != Some(available) {
        let expected = format!("{count} records of {} bytes, as the shape says", size_of::<Record>());
        return Err(FormatError::field(
            end as u64,
            "data of the .npy",
            format!("{available} bytes"),
            expected,
        ));
    }
    Ok((end, count))
}

/// Reads an array of records: in pieces of a chunk's size, of one thread, in the order of the array.
pub struct NpySource<'a> {
    bytes: &'a [u8],
    /// Where the records start.
    start: usize,
    pieces: Pieces,
    losses: Losses,
}

impl<'a> NpySource<'a> {
    /// Checks the header and the size; the records are checked as they are read.
    ///
    /// # Errors
    /// When the file is cut off, or its array is not one of records.
    pub fn parse(bytes: &'a [u8]) -> Result<NpySource<'a>, FormatError> {
        let (start, count) = read_header(bytes)?;
        Ok(NpySource { bytes, start, pieces: Pieces::of(count), losses: Losses::default() })
    }
}

impl Source for NpySource<'_> {
    fn header(&self) -> Header {
        Header { producer: "NumPy, converted".into(), ..Header::default() }
    }

    fn count(&self) -> u64 {
        self.pieces.count
    }

    fn next(&mut self) -> Result<Option<Chunk<'_>>, ConvertError> {
        let Some(Range { start: first, end }) = self.pieces.next() else { return Ok(None) };
        let size = size_of::<Record>() as u64;
        // In range: the size has been compared with the length of these bytes.
        let offset = self.start + (first * size) as usize;
        let mut records: Vec<Record> =
            bytemuck::pod_collect_to_vec(&self.bytes[offset..offset + ((end - first) * size) as usize]);
        for (place, record) in records.iter_mut().enumerate() {
            if record.kind > kind::OCCLUSION {
                let at = offset + place * size as usize + offset_of!(Record, kind);
                let name = format!("kind of record {}", first + place as u64);
                return Err(FormatError::field(at as u64, name, record.kind, "0 or 1").into());
            }
            if record.flags & flag::HAS_REJECTS != 0 {
                record.flags &= !flag::HAS_REJECTS;
                self.losses.lose(LOST_REJECTS, 1);
            }
        }
        let info = ChunkInfo { sequence: first, ..ChunkInfo::default() };
        Ok(Some(Chunk { info, records: Cow::Owned(records), rejects: Cow::Borrowed(&[]) }))
    }

    fn losses(&self) -> Losses {
        self.losses.clone()
    }
}

const LOST_REJECTS: &str = "flag of a query that says that it had rejects, which the array does not hold";

/// Writes an array of records.
pub struct NpySink<W: Write> {
    out: W,
    losses: Losses,
}

impl<W: Write> NpySink<W> {
    /// Writes the header of an array of `count` records: exactly so many must follow. `queries` is what their file says of them.
    ///
    /// # Errors
    /// When `out` cannot be written.
    pub fn new(mut out: W, queries: &Header, count: u64) -> Result<NpySink<W>, ConvertError> {
        out.write_all(&header(RECORD, &format!("({count},)")))?;
        let mut losses = Losses::default();
        losses.lose_header(queries);
        Ok(NpySink { out, losses })
    }
}

impl<W: Write> Sink for NpySink<W> {
    fn write(&mut self, chunk: &Chunk) -> Result<(), ConvertError> {
        self.losses.lose_chunk(chunk);
        self.out.write_all(bytemuck::cast_slice(&chunk.records))?;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Losses, ConvertError> {
        self.out.flush()?;
        Ok(self.losses)
    }
}
