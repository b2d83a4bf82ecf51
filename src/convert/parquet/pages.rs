//! The headers of a column's pages, walked before the column is decoded: a page says how large it becomes, and the decoder takes its word for it.
//!
//! A header is a struct of Thrift's compact protocol: its first fields are the page's type, its size once decoded, and its size in the file. What else is in
//! it is passed over, so that every length in it is known to end within the file.

use super::wrong;
use crate::convert::ConvertError;
use parquet::file::metadata::ColumnChunkMetaData;

/// Bytes that a page may decode to: writers cut pages at 1 MiB, a few at 100 MB.
const LARGEST: u64 = 256 << 20;

/// Structs within structs of a header: a page's statistics are in its second level.
const DEEPEST: usize = 8;

/// Types of the compact protocol that have a length of their own.
mod wire {
    pub const STOP: u8 = 0;
    pub const TRUE: u8 = 1;
    pub const FALSE: u8 = 2;
    pub const BYTE: u8 = 3;
    pub const I16: u8 = 4;
    pub const I32: u8 = 5;
    pub const I64: u8 = 6;
    pub const DOUBLE: u8 = 7;
    pub const BINARY: u8 = 8;
    pub const LIST: u8 = 9;
    pub const SET: u8 = 10;
    pub const STRUCT: u8 = 12;
}

/// Checks that a column's pages lie in the file one behind the other, and are of a sensible size.
///
/// # Errors
/// At the first that is not.
pub fn check(file: &[u8], column: &ColumnChunkMetaData) -> Result<(), ConvertError> {
    let damaged = |at: usize| {
        wrong(format!("at byte {at}: the header of a page, or the size that it says, is damaged"))
    };
    let offset = column.dictionary_page_offset().unwrap_or(column.data_page_offset());
    let place = usize::try_from(offset).ok().zip(usize::try_from(column.compressed_size()).ok());
    let place = place.and_then(|(start, bytes)| Some((start, start.checked_add(bytes)?)));
    let Some((mut at, end)) = place.filter(|&(_, end)| end <= file.len()) else {
        return Err(wrong(format!("column {}: its pages are not in the file", column.column_path())));
    };
    while at < end {
        let mut header = Header { bytes: &file[at..end], decoded: None, stored: None };
        header.fields(0).ok_or_else(|| damaged(at))?;
        let left = header.bytes.len();
        let (Some(decoded), Some(stored)) = (header.decoded, header.stored) else { return Err(damaged(at)) };
        let stored =
            usize::try_from(stored).ok().filter(|&stored| stored <= left).ok_or_else(|| damaged(at))?;
        if decoded > LARGEST {
            return Err(wrong(format!(
                "at byte {at}: a page of {decoded} bytes; expected at most {LARGEST}"
            )));
        }
        at = end - left + stored;
    }
    Ok(())
}

/// What is left of a header, and what was found in it.
struct Header<'a> {
    bytes: &'a [u8],
    decoded: Option<u64>,
    stored: Option<u64>,
}

impl Header<'_> {
    fn byte(&mut self) -> Option<u8> {
        let (&first, rest) = self.bytes.split_first()?;
        self.bytes = rest;
        Some(first)
    }

    /// A number of 7 bits a byte, the lowest first.
    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7F) << shift;
            if byte & 0x80 == 0 {
                return Some(value);
            }
        }
        None
    }

    fn pass(&mut self, count: u64) -> Option<()> {
        self.bytes = self.bytes.get(usize::try_from(count).ok()?..)?;
        Some(())
    }

    /// The fields of a struct, up to its end; `depth` structs are around it.
    fn fields(&mut self, depth: usize) -> Option<()> {
        let mut number = 0_i64;
        loop {
            let head = self.byte()?;
            let kind = head & 0x0F;
            if kind == wire::STOP {
                return Some(());
            }
            number = match head >> 4 {
                0 => zigzag(self.varint()?),
                step => number.wrapping_add(step.into()),
            };
            if depth == 0 && kind == wire::I32 && (number == 2 || number == 3) {
                // No page has less than no bytes.
                let size = u64::try_from(zigzag(self.varint()?)).ok()?;
                *(if number == 2 { &mut self.decoded } else { &mut self.stored }) = Some(size);
            } else if kind != wire::TRUE && kind != wire::FALSE {
                self.value(kind, depth)?;
            }
        }
    }

    fn value(&mut self, kind: u8, depth: usize) -> Option<()> {
        match kind {
            // In a list; a field has its truth in its head.
            wire::TRUE | wire::FALSE | wire::BYTE => self.pass(1),
            wire::I16 | wire::I32 | wire::I64 => self.varint().map(|_| ()),
            wire::DOUBLE => self.pass(8),
            wire::BINARY => {
                let length = self.varint()?;
                self.pass(length)
            }
            wire::LIST | wire::SET if depth < DEEPEST => {
                let head = self.byte()?;
                let count = if head >> 4 == 15 { self.varint()? } else { u64::from(head >> 4) };
                // Each takes a byte at least, so this ends with the bytes.
                (0..count).try_for_each(|_| self.value(head & 0x0F, depth + 1))
            }
            wire::STRUCT if depth < DEEPEST => self.fields(depth + 1),
            _ => None,
        }
    }
}

fn zigzag(value: u64) -> i64 {
    (value >> 1) as i64 ^ -((value & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sizes(bytes: &[u8]) -> Option<(Option<u64>, Option<u64>, usize)> {
        let mut header = Header { bytes, decoded: None, stored: None };
        header.fields(0)?;
        Some((header.decoded, header.stored, header.bytes.len()))
    }

    #[test]
    fn sizes_of_a_header_are_read_and_the_rest_is_passed_over() {
        // Type 0; 300 bytes decoded, 5 stored; field 5 a struct of an i32 and a binary of two bytes; then two bytes of data.
        let header =
            [0x15, 0x00, 0x15, 0xD8, 0x04, 0x15, 0x0A, 0x2C, 0x15, 0x02, 0x18, 0x02, 1, 2, 0x00, 0x00, 7, 7];
        assert_eq!(sizes(&header), Some((Some(300), Some(5), 2)));
        assert!((0..16).all(|end| sizes(&header[..end]).is_none()));
    }

    #[test]
    fn lengths_that_leave_the_file_and_endless_nesting_are_refused() {
        // A binary of 2^63 bytes; a size of -1; a list of 2^60 structs; structs within structs.
        let huge = [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x7F];
        assert_eq!(sizes(&[&[0x18][..], &huge].concat()), None);
        assert_eq!(sizes(&[0x25, 0x01, 0x00]), None);
        assert_eq!(sizes(&[&[0x19, 0xFC][..], &huge].concat()), None);
        assert_eq!(sizes(&[0x1C; 1000]), None);
    }
}
