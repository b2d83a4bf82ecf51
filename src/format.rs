//! The two file formats, each read and written in one place. `../docs/formats.md` is their public specification.
//!
//! Parsers borrow `&[u8]` and never open a file ([`crate::files`] does, for the binaries). Everything is checked
//! before it is followed; an error names the byte offset, what was found and what was expected.

pub mod bvh;
mod error;
pub mod rays;

pub use error::{FormatError, Problem, excerpt};

use nom::{IResult, Parser};

#[cfg(target_endian = "big")]
compile_error!(
    "both formats are little-endian and viewed in place: a big-endian machine needs a copying reader"
);

/// Sections and chunks start on multiples of this.
pub const ALIGNMENT: u64 = 64;
/// The first 8 bytes of a `.rays` file.
pub const RAYS_MAGIC: [u8; 8] = *b"\x89RAYS\r\n\x1a";
/// The first 8 bytes of a `.bvh` file.
pub const BVH_MAGIC: [u8; 8] = *b"\x89BVH\r\n\x1a\n";
/// The version of both formats that this library reads and writes; another major is refused, another minor is not.
pub const MAJOR: u16 = 1;
pub const MINOR: u16 = 0;

/// The two kinds of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    Rays,
    Bvh,
}

impl FileKind {
    /// What the first bytes say that a file is.
    pub fn of(bytes: &[u8]) -> Option<FileKind> {
        if bytes.starts_with(&RAYS_MAGIC) {
            Some(FileKind::Rays)
        } else if bytes.starts_with(&BVH_MAGIC) {
            Some(FileKind::Bvh)
        } else {
            None
        }
    }

    /// The usual ending of such a file's name.
    pub fn name(self) -> &'static str {
        match self {
            FileKind::Rays => ".rays",
            FileKind::Bvh => ".bvh",
        }
    }
}

/// The next multiple of [`ALIGNMENT`], or `None` beyond `u64`.
fn align(offset: u64) -> Option<u64> {
    offset.checked_next_multiple_of(ALIGNMENT)
}

/// XXH3-64 with seed 0, the checksum of both formats.
pub fn checksum(bytes: &[u8]) -> u64 {
    twox_hash::XxHash3_64::oneshot(bytes)
}

/// Runs a nom parser over the fixed-size structure at `offset`; `what` names it when the file ends inside.
fn parse_at<'a, O, P>(
    bytes: &'a [u8],
    offset: u64,
    what: &'static str,
    mut parser: P,
) -> Result<O, FormatError>
where
    P: Parser<&'a [u8], Output = O, Error = nom::error::Error<&'a [u8]>>,
{
    let start = usize::try_from(offset).ok().filter(|&start| start <= bytes.len());
    let rest = start.map_or(&[][..], |start| &bytes[start..]);
    let parsed: IResult<&[u8], O> = parser.parse(rest);
    match parsed {
        Ok((_, output)) => Ok(output),
        Err(_) => Err(FormatError::new(
            offset,
            Problem::Truncated { what, needed: None, available: rest.len() as u64 },
        )),
    }
}

/// Checks magic and version, which both headers start with, and the header's size.
fn check_start(bytes: &[u8], expected: FileKind, header_bytes: u32) -> Result<(), FormatError> {
    use nom::number::complete::{le_u16, le_u32};

    let magic = match expected {
        FileKind::Rays => RAYS_MAGIC,
        FileKind::Bvh => BVH_MAGIC,
    };
    if bytes.is_empty() {
        return Err(FormatError::new(0, Problem::Empty { expected }));
    }
    if !bytes.starts_with(&magic) {
        let problem = match FileKind::of(bytes) {
            Some(found) => Problem::OtherKind { found, expected },
            None if magic.starts_with(bytes) => Problem::Truncated {
                what: "header",
                needed: Some(header_bytes.into()),
                available: bytes.len() as u64,
            },
            None => Problem::Magic { found: bytes[..bytes.len().min(8)].to_vec(), expected },
        };
        return Err(FormatError::new(0, problem));
    }
    if bytes.len() < header_bytes as usize {
        let (needed, available) = (Some(header_bytes.into()), bytes.len() as u64);
        return Err(FormatError::new(0, Problem::Truncated { what: "header", needed, available }));
    }
    let (major, _minor, declared) = parse_at(bytes, 8, "header", (le_u16, le_u16, le_u32))?;
    if major != MAJOR {
        return Err(FormatError::new(8, Problem::Version { found: major, supported: MAJOR }));
    }
    if declared != header_bytes {
        return Err(FormatError::field(12, "header bytes", declared, header_bytes));
    }
    Ok(())
}

/// The text of a zero-padded field. It only describes, so bytes that are not UTF-8 are replaced, not refused.
fn padded_text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}

/// `text` as a zero-padded field of `N` bytes, cut at a character's border where it is too long.
fn pad_text<const N: usize>(text: &str) -> [u8; N] {
    let mut end = text.len().min(N);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    let mut field = [0; N];
    field[..end].copy_from_slice(&text.as_bytes()[..end]);
    field
}
