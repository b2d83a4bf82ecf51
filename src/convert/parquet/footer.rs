//! The footer of a table, looked at before the crate `parquet` decodes it: the crate makes room for as many children of a column, and goes as deep into
//! them, as a few bytes may say.

use super::thrift::walk;
use super::{MAGIC, wrong};
use crate::convert::ConvertError;

/// Columns that consist of others; ours have three, with the whole table. Each may be within the one before.
const MOST_GROUPS: usize = 1000;

/// Bytes of a footer's length.
const LENGTH: usize = size_of::<u32>();

/// Checks that the footer is there, and that what it says of columns can be.
///
/// # Errors
/// When it is not.
pub fn check(file: &[u8]) -> Result<(), ConvertError> {
    let damaged = || wrong("its footer is damaged, or cut off");
    let footer = file.strip_suffix(MAGIC).and_then(|file| file.split_last_chunk::<LENGTH>());
    let (before, length) = footer.ok_or_else(damaged)?;
    let start =
        usize::try_from(u32::from_le_bytes(*length)).ok().and_then(|length| before.len().checked_sub(length));
    let footer = &before[start.ok_or_else(damaged)?..];
    let (mut groups, mut children) = (0, 0_u64);
    // The columns are the structs of field 2's list, one behind the other, and field 5 of each says how many of the next are within it.
    walk(footer, &mut |path, value| {
        if path == [2, 5] && value != 0 {
            groups += 1;
            children = children.saturating_add(u64::try_from(value).unwrap_or(u64::MAX));
        }
    })
    .ok_or_else(damaged)?;
    // Each takes a byte at least.
    if children > footer.len() as u64 {
        return Err(damaged());
    }
    if groups > MOST_GROUPS {
        return Err(wrong(format!(
            "{groups} columns that consist of others; expected at most {MOST_GROUPS}"
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file whose footer lists columns that say only how many of the next are within them.
    fn file(children: &[u8]) -> Vec<u8> {
        let count = [(children.len() & 0x7F) as u8 | 0x80, (children.len() >> 7) as u8];
        let mut footer = [&[0x29, 0xFC][..], &count].concat();
        for &children in children {
            footer.extend([0x55, children << 1, 0x00]);
        }
        footer.push(0x00);
        let length = (footer.len() as u32).to_le_bytes();
        [MAGIC, &footer, &length, MAGIC].concat()
    }

    fn error(file: &[u8]) -> Option<String> {
        check(file).err().map(|error| error.to_string())
    }

    #[test]
    fn columns_within_columns_are_counted() {
        assert_eq!(error(&file(&[2, 0, 1, 0])), None);
        assert_eq!(error(&file(&[1; 1000])), None);
        let line = error(&file(&[1; 1001])).unwrap();
        assert!(line.ends_with("1001 columns that consist of others; expected at most 1000"), "{line}");
        // 60 and 20 children, and 16 bytes.
        let line = error(&file(&[60, 20, 0])).unwrap();
        assert!(line.ends_with("its footer is damaged, or cut off"), "{line}");
    }

    #[test]
    fn a_footer_lies_in_the_file() {
        let whole = file(&[1, 0]);
        assert!((0..whole.len()).all(|end| error(&whole[..end]).is_some()));
        let mut long = whole.clone();
        let length = long.len() - 8;
        long[length] = 200;
        assert!(error(&long).is_some());
    }
}
