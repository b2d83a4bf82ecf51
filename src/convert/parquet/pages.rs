//! The headers of a column's pages, looked at before the column is decoded: a page says how large it becomes and how many values it has, and the
//! decoder takes its word for it.

use super::thrift::walk;
use super::wrong;
use crate::convert::ConvertError;
use parquet::file::metadata::ColumnChunkMetaData;

/// Bytes that a page may decode to: writers cut pages at 1 MiB, a few at 100 MB.
const LARGEST: u64 = 256 << 20;

/// Values in the lists of a row group beside one per row: as runs, any number takes but a few bytes. Ours have as many as a chunk has rejects.
const MOST_LISTED: u64 = 16 << 20;

/// Bytes of the smallest number that a dictionary can hold.
const SMALLEST_VALUE: u64 = 4;

/// What the header of a page says.
#[derive(Debug, Default, PartialEq)]
struct Header {
    /// Bytes once decoded, and in the file.
    decoded: Option<u64>,
    stored: Option<u64>,
    /// Values of a page of data, and of a dictionary.
    values: Option<u64>,
    dictionary: Option<u64>,
}

impl Header {
    /// The header that `bytes` begin with, and what is behind it; `None` when it is damaged.
    fn read(bytes: &[u8]) -> Option<(Header, &[u8])> {
        let mut header = Header::default();
        let mut negative = false;
        // The sizes are fields of their own. In field 5, 7 or 8 is what is said of a page of data, a dictionary or data in the second form.
        let rest = walk(bytes, &mut |path, value| {
            let field = match path {
                [2] => &mut header.decoded,
                [3] => &mut header.stored,
                [5 | 8, 1] => &mut header.values,
                [7, 1] => &mut header.dictionary,
                _ => return,
            };
            *field = u64::try_from(value).ok();
            negative |= value < 0;
        })?;
        (!negative).then_some((header, rest))
    }
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
        let (header, body) = Header::read(&file[at..end]).ok_or_else(|| damaged(at))?;
        let (Some(decoded), Some(stored)) = (header.decoded, header.stored) else { return Err(damaged(at)) };
        let stored = usize::try_from(stored).ok().filter(|&stored| stored <= body.len());
        let stored = stored.ok_or_else(|| damaged(at))?;
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
        at = end - body.len() + stored;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_values_of_a_header() {
        // 300 bytes decoded, 5 stored; then a struct whose fields 1 and 2 are 150 and 1, in field 5, 7 or 8; the end, and a byte of data.
        let header = |head| {
            [&[0x25, 0xD8, 0x04, 0x15, 0x0A, head][..], &[0x15, 0xAC, 0x02, 0x15, 2, 0, 0, 7]].concat()
        };
        let sizes = || Header { decoded: Some(300), stored: Some(5), ..Header::default() };
        let read = |bytes: &[u8]| Header::read(bytes).map(|(header, rest)| (header, rest.to_vec()));
        assert_eq!(read(&header(0x2C)), Some((Header { values: Some(150), ..sizes() }, vec![7])));
        assert_eq!(read(&header(0x4C)), Some((Header { dictionary: Some(150), ..sizes() }, vec![7])));
        assert_eq!(read(&header(0x5C)), Some((Header { values: Some(150), ..sizes() }, vec![7])));
        // -1 bytes, and -1 values.
        assert_eq!(read(&[0x25, 0x01, 0x00]), None);
        assert_eq!(read(&[0x5C, 0x15, 1, 0, 0]), None);
    }
}
