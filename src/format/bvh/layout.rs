//! The header and the section table of a `.bvh`, read with nom and written with byteorder: nothing else knows their offsets.

use crate::format::{
    ALIGNMENT, BVH_MAGIC, FileKind, FormatError, MAJOR, MINOR, Problem, check_start, checksum, pad_text,
    padded_text, parse_at,
};
use crate::geometry::{Aabb, Vec3};
use byteorder::{ByteOrder, LittleEndian};
use nom::Parser;
use nom::bytes::complete::take;
use nom::number::complete::{le_f32, le_u32, le_u64};

pub(super) const HEADER_BYTES: u64 = 128;
const SECTION_BYTES: u64 = 32;

/// What the header says of the whole file.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// XXH3-64 of the triangles: what ties a `.rays` to its scene.
    pub fingerprint: u64,
    /// The root's box.
    pub bounds: Aabb,
    /// At least the largest number of children of a node: 2, 4 or 8.
    pub max_children: u32,
    /// Largest number of primitives in a leaf.
    pub max_leaf: u32,
    /// Levels; a lone root has depth 1.
    pub depth: u32,
    /// Bits of [`super::flag`]; others are kept as they are.
    pub flags: u32,
    /// Who built the tree; cut to 48 bytes when written.
    pub producer: String,
}

/// An entry of the section table, checked against the file's size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Section {
    pub tag: [u8; 4],
    pub element_bytes: u32,
    pub offset: u64,
    pub count: u64,
    pub checksum: u64,
}

impl Section {
    /// Bytes of all elements. Saturates where they exceed `u64`, before the table is checked.
    pub fn bytes(&self) -> u64 {
        self.count.saturating_mul(self.element_bytes.into())
    }
}

impl Header {
    /// Reads the header and the section table, and checks the table.
    pub(super) fn read(bytes: &[u8]) -> Result<(Header, Vec<Section>), FormatError> {
        check_start(bytes, FileKind::Bvh, HEADER_BYTES as u32)?;
        let point = || (le_f32, le_f32, le_f32).map(|(x, y, z)| Vec3::new(x, y, z));
        let fields = (le_u64, point(), point(), (le_u32, le_u32, le_u32, le_u32), take(48usize));
        let tail = (le_u32, le_u32, le_u64);
        let ((fingerprint, lower, upper, counts, producer), (sections, _, table_checksum)) =
            parse_at(bytes, 16, "header", (fields, tail))?;
        let (max_children, max_leaf, depth, flags) = counts;
        let header = Header {
            fingerprint,
            bounds: Aabb { lower, upper },
            max_children,
            max_leaf,
            depth,
            flags,
            producer: padded_text(producer),
        };
        Ok((header, read_table(bytes, sections, table_checksum)?))
    }

    pub(super) fn bytes(&self, table: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0; HEADER_BYTES as usize];
        bytes[..8].copy_from_slice(&BVH_MAGIC);
        LittleEndian::write_u16(&mut bytes[8..], MAJOR);
        LittleEndian::write_u16(&mut bytes[10..], MINOR);
        LittleEndian::write_u32(&mut bytes[12..], HEADER_BYTES as u32);
        LittleEndian::write_u64(&mut bytes[16..], self.fingerprint);
        LittleEndian::write_f32_into(&self.bounds.lower.to_array(), &mut bytes[24..36]);
        LittleEndian::write_f32_into(&self.bounds.upper.to_array(), &mut bytes[36..48]);
        LittleEndian::write_u32(&mut bytes[48..], self.max_children);
        LittleEndian::write_u32(&mut bytes[52..], self.max_leaf);
        LittleEndian::write_u32(&mut bytes[56..], self.depth);
        LittleEndian::write_u32(&mut bytes[60..], self.flags);
        bytes[64..112].copy_from_slice(&pad_text::<48>(&self.producer));
        LittleEndian::write_u32(&mut bytes[112..], (table.len() as u64 / SECTION_BYTES) as u32);
        LittleEndian::write_u64(&mut bytes[120..], checksum(table));
        bytes
    }
}

fn read_table(bytes: &[u8], sections: u32, expected: u64) -> Result<Vec<Section>, FormatError> {
    let table_bytes = u64::from(sections) * SECTION_BYTES;
    let available = bytes.len() as u64 - HEADER_BYTES;
    if table_bytes > available {
        let needed = Some(table_bytes);
        return Err(FormatError::new(
            HEADER_BYTES,
            Problem::Truncated { what: "section table", needed, available },
        ));
    }
    let table_end = HEADER_BYTES + table_bytes;
    let found = checksum(&bytes[HEADER_BYTES as usize..table_end as usize]);
    if found != expected {
        let what = "section table".to_string();
        return Err(FormatError::new(HEADER_BYTES, Problem::Checksum { what, found, expected }));
    }
    let mut table = Vec::with_capacity(sections as usize);
    for number in 0..u64::from(sections) {
        let at = HEADER_BYTES + number * SECTION_BYTES;
        let fields = (take(4usize), le_u32, le_u64, le_u64, le_u64);
        let (tag, element_bytes, offset, count, checksum) = parse_at(bytes, at, "section table", fields)?;
        let tag = [tag[0], tag[1], tag[2], tag[3]];
        let section = Section { tag, element_bytes, offset, count, checksum };
        section.check(at, table_end, bytes)?;
        table.push(section);
    }
    check_overlaps(&table)?;
    Ok(table)
}

/// The tag as an error or a table shows it.
pub(super) fn tag_text(tag: [u8; 4]) -> String {
    tag.escape_ascii().to_string()
}

impl Section {
    /// Whether the section lies in the file, behind the table whose entry is at `at`, and its bytes are those written.
    fn check(&self, at: u64, table_end: u64, bytes: &[u8]) -> Result<(), FormatError> {
        let length = bytes.len() as u64;
        let name = |what: &str| format!("{what} of section {}", tag_text(self.tag));
        if !self.offset.is_multiple_of(ALIGNMENT) || self.offset < table_end {
            let expected = format!("a multiple of {ALIGNMENT} not before {table_end}");
            return Err(FormatError::field(at + 8, name("offset"), self.offset, expected));
        }
        let whole = self.count.checked_mul(self.element_bytes.into());
        let end = whole.and_then(|bytes| self.offset.checked_add(bytes)).filter(|&end| end <= length);
        let Some(end) = end else {
            let expected =
                format!("elements that end within the file's {length} bytes; it is cut off or damaged");
            let found = format!("{} of {} bytes from byte {}", self.count, self.element_bytes, self.offset);
            return Err(FormatError::field(at + 16, name("count"), found, expected));
        };
        let found = checksum(&bytes[self.offset as usize..end as usize]);
        if found != self.checksum {
            let (what, expected) = (name("content"), self.checksum);
            return Err(FormatError::new(self.offset, Problem::Checksum { what, found, expected }));
        }
        Ok(())
    }

    pub(super) fn table_entry(&self) -> [u8; SECTION_BYTES as usize] {
        let mut bytes = [0; SECTION_BYTES as usize];
        bytes[..4].copy_from_slice(&self.tag);
        LittleEndian::write_u32(&mut bytes[4..], self.element_bytes);
        LittleEndian::write_u64(&mut bytes[8..], self.offset);
        LittleEndian::write_u64(&mut bytes[16..], self.count);
        LittleEndian::write_u64(&mut bytes[24..], self.checksum);
        bytes
    }
}

fn check_overlaps(table: &[Section]) -> Result<(), FormatError> {
    let mut sorted: Vec<&Section> = table.iter().filter(|section| section.bytes() > 0).collect();
    sorted.sort_by_key(|section| section.offset);
    for pair in sorted.windows(2) {
        let end = pair[0].offset + pair[0].bytes();
        if pair[1].offset < end {
            let name = format!("offset of section {}", tag_text(pair[1].tag));
            let expected = format!("at least {end}, where {} ends", tag_text(pair[0].tag));
            return Err(FormatError::field(HEADER_BYTES, name, pair[1].offset, expected));
        }
    }
    Ok(())
}

/// Where the first section starts in a file of `sections` sections, before alignment.
pub(super) fn table_end(sections: usize) -> u64 {
    HEADER_BYTES + sections as u64 * SECTION_BYTES
}
