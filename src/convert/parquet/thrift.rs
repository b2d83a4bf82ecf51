//! A walk through a struct of Thrift's compact protocol, in which a Parquet file says everything about itself: every length ends within the bytes,
//! every element of a list is there, and nesting ends. Numbers go to a visitor; nothing is kept.

/// Structs and lists within one another: the statistics of a column are in the sixth level of the footer.
const DEEPEST: usize = 12;

/// Types of values, as a field's head and a list's have them.
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

/// Walks the struct that `bytes` begin with, and returns what is behind it. `visit` gets every whole number with its path: the number of the
/// field, before that those of the fields around it; elements of a list have the path of the list. `None` when the struct is damaged.
pub fn walk<'a>(bytes: &'a [u8], visit: &mut impl FnMut(&[i64], i64)) -> Option<&'a [u8]> {
    let mut walk = Walk { bytes, path: Vec::new(), depth: 0, visit };
    walk.fields()?;
    Some(walk.bytes)
}

struct Walk<'a, 'v, V> {
    bytes: &'a [u8],
    path: Vec<i64>,
    /// Structs and lists around.
    depth: usize,
    visit: &'v mut V,
}

impl<V: FnMut(&[i64], i64)> Walk<'_, '_, V> {
    /// The fields of a struct, up to its end.
    fn fields(&mut self) -> Option<()> {
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
            // A field has its truth in its head.
            if kind != wire::TRUE && kind != wire::FALSE {
                self.path.push(number);
                self.value(kind)?;
                self.path.pop();
            }
        }
    }

    fn value(&mut self, kind: u8) -> Option<()> {
        match kind {
            wire::TRUE | wire::FALSE | wire::BYTE => self.pass(1),
            wire::I16 | wire::I32 | wire::I64 => {
                let value = zigzag(self.varint()?);
                (self.visit)(&self.path, value);
                Some(())
            }
            wire::DOUBLE => self.pass(8),
            wire::BINARY => {
                let length = self.varint()?;
                self.pass(length)
            }
            wire::LIST | wire::SET => {
                let head = self.byte()?;
                let count = if head >> 4 == 15 { self.varint()? } else { u64::from(head >> 4) };
                // Each takes a byte at least, so this ends with the bytes.
                self.within(|walk| (0..count).try_for_each(|_| walk.value(head & 0x0F)))
            }
            wire::STRUCT => self.within(Self::fields),
            _ => None,
        }
    }

    fn within(&mut self, walk: impl FnOnce(&mut Self) -> Option<()>) -> Option<()> {
        if self.depth == DEEPEST {
            return None;
        }
        self.depth += 1;
        walk(self)?;
        self.depth -= 1;
        Some(())
    }

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
}

fn zigzag(value: u64) -> i64 {
    (value >> 1) as i64 ^ -((value & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    type Number = (Vec<i64>, i64);

    /// Every number with its path, and how many bytes are left.
    fn numbers(bytes: &[u8]) -> Option<(Vec<Number>, usize)> {
        let mut found = Vec::new();
        let rest = walk(bytes, &mut |path, value| found.push((path.to_vec(), value)))?;
        Some((found, rest.len()))
    }

    #[test]
    fn numbers_have_their_path_and_the_rest_is_passed_over() {
        // Fields 1 to 3: 0, 300, 5; field 5 a struct of 1 and a binary of two bytes; field 6 true; field 9 a list of two structs, each a number 7;
        // then two bytes more.
        let bytes = [
            0x15, 0x00, 0x15, 0xD8, 0x04, 0x15, 0x0A, 0x2C, 0x15, 0x02, 0x18, 0x02, 1, 2, 0x00, 0x11, 0x39,
            0x2C, 0x15, 0x0E, 0x00, 0x15, 0x0E, 0x00, 0x00, 9, 9,
        ];
        let expected = [(&[1][..], 0), (&[2], 300), (&[3], 5), (&[5, 1], 1), (&[9, 1], 7), (&[9, 1], 7)];
        let expected = expected.map(|(path, value)| (path.to_vec(), value)).to_vec();
        assert_eq!(numbers(&bytes), Some((expected, 2)));
        assert!((0..bytes.len() - 2).all(|end| numbers(&bytes[..end]).is_none()));
        // A field's number may stand behind its head: -1 here, in a number of -2.
        assert_eq!(numbers(&[0x05, 0x01, 0x03, 0x00]), Some((vec![(vec![-1], -2)], 0)));
    }

    #[test]
    fn lengths_that_leave_the_bytes_and_endless_nesting_are_refused() {
        // A binary of 2^63 bytes; a list of 2^60 structs; structs within structs; lists within lists; a type that is none.
        let huge = [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x7F];
        assert_eq!(numbers(&[&[0x18][..], &huge].concat()), None);
        assert_eq!(numbers(&[&[0x19, 0xFC][..], &huge].concat()), None);
        assert_eq!(numbers(&[0x1C; 1000]), None);
        assert_eq!(numbers(&[0x19; 1000]), None);
        assert_eq!(numbers(&[0x1D, 0x00]), None);
    }
}
