//! The headers of a column's pages, walked before the column is decoded: a page says how large it becomes and how many values it has, and the decoder
//! takes its word for it.
//!
//! A header is a struct of Thrift's compact protocol: its first fields are the page's type, its size once decoded, and its size in the file; the struct
//! of its type begins with the number of values. What else is in it is passed over, so that every length in it is known to end within the file.

use super::wrong;
use crate::convert::ConvertError;
use parquet::file::metadata::ColumnChunkMetaData;

/// Bytes that a page may decode to: writers cut pages at 1 MiB, a few at 100 MB.
const LARGEST: u64 = 256 << 20;

/// Values in the lists of a row group beside one per row: as runs, any number takes but a few bytes. Ours have as many as a chunk has rejects.
const MOST_LISTED: u64 = 16 << 20;

/// Bytes of the smallest number that a dictionary can hold.
const SMALLEST_VALUE: u64 = 4;

/// Structs within structs of a header: a page's statistics are in its second level.
const DEEPEST: usize = 8;

/// Fields of a header. Of those that are structs, the first field is the number of values.
mod field {
    pub const DECODED: i64 = 2;
    pub const STORED: i64 = 3;
    pub const DATA: i64 = 5;
    pub const DICTIONARY: i64 = 7;
    pub const DATA_2: i64 = 8;
    pub const VALUES: i64 = 1;
}

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

/// Checks that a column's pages lie in the file one behind the other, and are of a sensible size; and that they have no more values than `rows` lists
/// may, if it is a column of lists.
///
/// # Errors
/// At the first that is not.
pub fn check(file: &[u8], column: &ColumnChunkMetaData, rows: u64) -> Result<(), ConvertError> {
    let damaged = |at: usize| {
        wrong(format!("at byte {at}: the header of a page, or the size that it says, is damaged"))
    };
    let offset = column.dictionary_page_offset().unwrap_or(column.data_page_offset());
    let place = usize::try_from(offset).ok().zip(usize::try_from(column.compressed_size()).ok());
    let place = place.and_then(|(start, bytes)| Some((start, start.checked_add(bytes)?)));
    let Some((mut at, end)) = place.filter(|&(_, end)| end <= file.len()) else {
        return Err(wrong(format!("column {}: its pages are not in the file", column.column_path())));
    };
    let is_list = column.column_descr().max_rep_level() > 0;
    let mut listed = 0_u64;
    while at < end {
        let mut header = Header::new(&file[at..end]);
        header.fields(0, 0).ok_or_else(|| damaged(at))?;
        let left = header.bytes.len();
        let (Some(decoded), Some(stored)) = (header.decoded, header.stored) else { return Err(damaged(at)) };
        let stored =
            usize::try_from(stored).ok().filter(|&stored| stored <= left).ok_or_else(|| damaged(at))?;
        if decoded > LARGEST {
            return Err(wrong(format!(
                "at byte {at}: a page of {decoded} bytes; expected at most {LARGEST}"
            )));
        }
        if header.dictionary.is_some_and(|values| values > decoded / SMALLEST_VALUE) {
            return Err(damaged(at));
        }
        listed = listed.saturating_add(header.values.unwrap_or(0));
        if is_list && listed > rows.saturating_add(MOST_LISTED) {
            let name = column.column_path();
            return Err(wrong(format!(
                "column {name}: over {MOST_LISTED} values in the {rows} rows of a row group; write smaller ones"
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
    /// Of a page of data.
    values: Option<u64>,
    /// Values of a dictionary.
    dictionary: Option<u64>,
}

impl<'a> Header<'a> {
    fn new(bytes: &'a [u8]) -> Header<'a> {
        Header { bytes, decoded: None, stored: None, values: None, dictionary: None }
    }

    fn pass(&mut self, count: u64) -> Option<()> {
        self.bytes = self.bytes.get(usize::try_from(count).ok()?..)?;
        Some(())
    }

    /// The fields of a struct, up to its end; `depth` structs and lists are around it, and it is that field of the outermost.
    fn fields(&mut self, depth: usize, outermost: i64) -> Option<()> {
        let mut number = 0_i64;
        loop {
            let head = byte(&mut self.bytes)?;
            let kind = head & 0x0F;
            if kind == wire::STOP {
                return Some(());
            }
            number = match head >> 4 {
                0 => zigzag(varint(&mut self.bytes)?),
                step => number.wrapping_add(step.into()),
            };
            let outermost = if depth == 0 { number } else { outermost };
            let wanted = match (depth, outermost, number) {
                (0, field::DECODED, _) => Some(&mut self.decoded),
                (0, field::STORED, _) => Some(&mut self.stored),
                (1, field::DATA | field::DATA_2, field::VALUES) => Some(&mut self.values),
                (1, field::DICTIONARY, field::VALUES) => Some(&mut self.dictionary),
                _ => None,
            };
            if let (Some(wanted), wire::I32) = (wanted, kind) {
                // No page has less than no bytes or values.
                *wanted = Some(u64::try_from(zigzag(varint(&mut self.bytes)?)).ok()?);
            } else if kind != wire::TRUE && kind != wire::FALSE {
                self.value(kind, depth, outermost)?;
            }
        }
    }

    fn value(&mut self, kind: u8, depth: usize, outermost: i64) -> Option<()> {
        match kind {
            // In a list; a field has its truth in its head.
            wire::TRUE | wire::FALSE | wire::BYTE => self.pass(1),
            wire::I16 | wire::I32 | wire::I64 => varint(&mut self.bytes).map(|_| ()),
            wire::DOUBLE => self.pass(8),
            wire::BINARY => {
                let length = varint(&mut self.bytes)?;
                self.pass(length)
            }
            wire::LIST | wire::SET if depth < DEEPEST => {
                let head = byte(&mut self.bytes)?;
                let count = if head >> 4 == 15 { varint(&mut self.bytes)? } else { u64::from(head >> 4) };
                // Each takes a byte at least, so this ends with the bytes.
                (0..count).try_for_each(|_| self.value(head & 0x0F, depth + 1, outermost))
            }
            wire::STRUCT if depth < DEEPEST => self.fields(depth + 1, outermost),
            _ => None,
        }
    }
}

fn byte(bytes: &mut &[u8]) -> Option<u8> {
    let (&first, rest) = bytes.split_first()?;
    *bytes = rest;
    Some(first)
}

/// A number of 7 bits a byte, the lowest first.
fn varint(bytes: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let byte = byte(bytes)?;
        value |= u64::from(byte & 0x7F) << shift;
        if byte & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

fn zigzag(value: u64) -> i64 {
    (value >> 1) as i64 ^ -((value & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sizes(bytes: &[u8]) -> Option<(Option<u64>, Option<u64>, usize)> {
        let mut header = Header::new(bytes);
        header.fields(0, 0)?;
        Some((header.decoded, header.stored, header.bytes.len()))
    }

    fn values(bytes: &[u8]) -> Option<(Option<u64>, Option<u64>)> {
        let mut header = Header::new(bytes);
        header.fields(0, 0)?;
        Some((header.values, header.dictionary))
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
    fn values_are_those_of_the_struct_of_the_type() {
        // After fields 2 and 3: a struct whose fields 1 and 2 are 150 and 1, in field 5, 7 or 8; or in a struct in field 5.
        let header =
            |head: &[u8]| [&[0x25, 2, 0x15, 2][..], head, &[0x15, 0xAC, 0x02, 0x15, 2, 0, 0]].concat();
        assert_eq!(values(&header(&[0x2C])), Some((Some(150), None)));
        assert_eq!(values(&header(&[0x4C])), Some((None, Some(150))));
        assert_eq!(values(&header(&[0x5C])), Some((Some(150), None)));
        assert_eq!(values(&[&header(&[0x2C, 0x2C])[..], &[0]].concat()), Some((None, None)));
        // -1 values.
        assert_eq!(values(&[0x5C, 0x15, 1, 0, 0]), None);
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
