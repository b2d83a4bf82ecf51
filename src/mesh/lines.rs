//! Text files as statements: encodings, line ends and continuation lines are dealt with here, once, so that the OBJ and MTL
//! readers see plain lines of bytes.
//!
//! Bytes come as one slice (a memory map: nothing is copied) or from a reader in blocks (a decompressor: only one block and
//! the line it cuts are held). UTF-16, with or without a mark, is turned into UTF-8 on the way; a UTF-8 mark is dropped.

use memchr::{memchr2, memrchr};
use std::io::{self, Read};

/// The longest line, continuations included; a longer one is skipped.
pub const MAX_LINE: usize = 64 << 20;

const BLOCK: usize = 1 << 20;

/// Takes the lines of a file in order. Numbers count from 1; a joined line carries the number of its first part.
pub trait Sink {
    fn line(&mut self, number: u64, line: &[u8]);
    /// A line above [`MAX_LINE`] was skipped.
    fn too_long(&mut self, number: u64);
}

/// Feeds every line of `bytes` to `sink`.
pub fn from_slice(bytes: &[u8], sink: &mut impl Sink) {
    if Utf16::detect(bytes).is_some() {
        // Reading from a slice cannot fail.
        let _ = from_reader(bytes, sink);
        return;
    }
    let mut splitter = Splitter::default();
    splitter.block(without_mark(bytes), sink);
    splitter.finish(sink);
}

/// Feeds every line of what `reader` gives to `sink`.
///
/// # Errors
/// The reader's own; the lines before were fed.
pub fn from_reader(mut reader: impl Read, sink: &mut impl Sink) -> io::Result<()> {
    let mut splitter = Splitter::default();
    let mut raw = vec![0; BLOCK];
    let mut text = Vec::new();
    let mut utf16 = None;
    let mut at_start = true;
    let mut skipping = false;
    loop {
        let count = fill(&mut reader, &mut raw)?;
        let mut block = &raw[..count];
        if at_start {
            utf16 = Utf16::detect(block);
            block = without_mark(block);
            at_start = false;
        }
        match &mut utf16 {
            Some(decoder) => decoder.push(block, &mut text),
            None => text.extend_from_slice(block),
        }
        let last = count < raw.len();
        if skipping && let Some(end) = memchr2(b'\n', b'\r', &text) {
            text.drain(..end);
            skipping = false;
        }
        // Whole lines only. A last '\r' may be half of a line end, so it waits for the next block.
        let cut = match memrchr(b'\n', &text) {
            _ if last => text.len(),
            Some(end) => end + 1,
            None => memrchr(b'\r', &text[..text.len().saturating_sub(1)]).map_or(0, |end| end + 1),
        };
        if !skipping {
            splitter.block(&text[..cut], sink);
            text.drain(..cut);
        }
        if skipping || text.len() > MAX_LINE {
            if !skipping {
                sink.too_long(splitter.number + 1);
            }
            skipping = true;
            text.clear();
        }
        if last {
            splitter.finish(sink);
            return Ok(());
        }
    }
}

/// Reads until `buffer` is full or the reader has ended.
fn fill(reader: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut filled = 0;
    while filled < buffer.len() {
        match reader.read(&mut buffer[filled..]) {
            Ok(0) => break,
            Ok(count) => filled += count,
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(filled)
}

fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes)
}

/// Cuts blocks of whole lines into lines, and joins those that end in a backslash.
#[derive(Default)]
struct Splitter {
    /// Lines seen so far.
    number: u64,
    /// Parts of a line that goes on, and the number of the first.
    joined: Vec<u8>,
    joined_from: u64,
    joining: bool,
}

impl Splitter {
    #[inline]
    fn block(&mut self, mut block: &[u8], sink: &mut impl Sink) {
        while !block.is_empty() {
            let end = memchr2(b'\n', b'\r', block).unwrap_or(block.len());
            let line = &block[..end];
            let newline = if block[end..].starts_with(b"\r\n") { 2 } else { 1 };
            block = block.get(end + newline..).unwrap_or(&[]);
            self.number += 1;
            if self.joining || line.last() == Some(&b'\\') {
                self.join(line, sink);
            } else {
                sink.line(self.number, line);
            }
        }
    }

    fn join(&mut self, line: &[u8], sink: &mut impl Sink) {
        if !self.joining {
            if !can_continue(line) {
                sink.line(self.number, line);
                return;
            }
            self.joined_from = self.number;
            self.joining = true;
        }
        let goes_on = line.last() == Some(&b'\\');
        if self.joined.len() <= MAX_LINE {
            self.joined.extend_from_slice(line.strip_suffix(b"\\").unwrap_or(line));
            self.joined.push(b' ');
        }
        if !goes_on {
            self.finish(sink);
        }
    }

    fn finish(&mut self, sink: &mut impl Sink) {
        if self.joining {
            if self.joined.len() > MAX_LINE {
                sink.too_long(self.joined_from);
            } else {
                sink.line(self.joined_from, &self.joined);
            }
            self.joined.clear();
            self.joining = false;
        }
    }
}

/// Names and comments may end in a backslash of their own (`# from C:\`); statements made of numbers go on in the next line.
fn can_continue(line: &[u8]) -> bool {
    let line = line.trim_ascii_start();
    let keyword = line.split(u8::is_ascii_whitespace).next().unwrap_or(&[]);
    !(keyword.starts_with(b"#")
        || keyword.starts_with(b"map_")
        || matches!(keyword, b"o" | b"usemtl" | b"mtllib" | b"newmtl"))
}

/// Turns UTF-16 into UTF-8, a block at a time.
struct Utf16 {
    unit: fn([u8; 2]) -> u16,
    /// The bytes of a character that the last block cut.
    carry: Vec<u8>,
}

impl Utf16 {
    /// By the byte order mark, or by the zero byte beside a first ASCII character.
    fn detect(bytes: &[u8]) -> Option<Utf16> {
        let unit = match bytes {
            [0xFF, 0xFE, ..] => u16::from_le_bytes,
            [0xFE, 0xFF, ..] => u16::from_be_bytes,
            [first, 0, ..] if first.is_ascii() && *first != 0 => u16::from_le_bytes,
            [0, second, ..] if second.is_ascii() && *second != 0 => u16::from_be_bytes,
            _ => return None,
        };
        Some(Utf16 { unit, carry: Vec::new() })
    }

    fn push(&mut self, block: &[u8], text: &mut Vec<u8>) {
        self.carry.extend_from_slice(block);
        let (pairs, _) = self.carry.as_chunks::<2>();
        let mut whole = pairs.len();
        if pairs.last().is_some_and(|&pair| (0xD800..0xDC00).contains(&(self.unit)(pair))) {
            whole -= 1;
        }
        for character in char::decode_utf16(pairs[..whole].iter().map(|&pair| (self.unit)(pair))) {
            match character.unwrap_or(char::REPLACEMENT_CHARACTER) {
                '\u{FEFF}' => {}
                character => text.extend_from_slice(character.encode_utf8(&mut [0; 4]).as_bytes()),
            }
        }
        self.carry.drain(..2 * whole);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Default, Debug, PartialEq)]
    struct Collected(Vec<(u64, String)>);

    impl Sink for Collected {
        fn line(&mut self, number: u64, line: &[u8]) {
            if !line.is_empty() {
                self.0.push((number, String::from_utf8_lossy(line).into_owned()));
            }
        }

        fn too_long(&mut self, number: u64) {
            self.0.push((number, "too long".to_owned()));
        }
    }

    fn lines(bytes: &[u8]) -> Vec<(u64, String)> {
        let mut collected = Collected::default();
        from_slice(bytes, &mut collected);
        collected.0
    }

    fn expect(expected: &[(u64, &str)]) -> Vec<(u64, String)> {
        expected.iter().map(|&(number, line)| (number, line.to_owned())).collect()
    }

    #[test]
    fn every_line_end() {
        for text in ["a\nb\n\nc", "a\r\nb\r\n\r\nc\r\n", "a\rb\r\rc\r"] {
            assert_eq!(lines(text.as_bytes()), expect(&[(1, "a"), (2, "b"), (4, "c")]), "{text:?}");
        }
    }

    #[test]
    fn continuation_lines_are_joined_but_names_and_comments_are_not() {
        assert_eq!(lines(b"f 1 \\\n2\\\n3\nv"), expect(&[(1, "f 1  2 3 "), (4, "v")]));
        assert_eq!(
            lines(b"# C:\\\nv\no C:\\\r\nv"),
            expect(&[(1, "# C:\\"), (2, "v"), (3, "o C:\\"), (4, "v")])
        );
        assert_eq!(lines(b"f 1 2 3\\"), expect(&[(1, "f 1 2 3 ")]));
    }

    #[test]
    fn encodings() {
        let text = "# \u{1F600} é\nv 1 2 3\n";
        let expected = expect(&[(1, "# \u{1F600} é"), (2, "v 1 2 3")]);
        let little: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let big: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
        assert_eq!(lines(text.as_bytes()), expected);
        assert_eq!(lines(&[b"\xEF\xBB\xBF", text.as_bytes()].concat()), expected);
        assert_eq!(lines(&little), expected);
        assert_eq!(lines(&big), expected);
        assert_eq!(lines(&[b"\xFF\xFE", &little[..]].concat()), expected);
        assert_eq!(lines(&[b"\xFE\xFF", &big[..]].concat()), expected);
    }

    #[test]
    fn a_line_without_end_is_skipped_and_not_kept() {
        let long = io::repeat(b'f').take(MAX_LINE as u64 + 3 * BLOCK as u64);
        let reader = (&b"a\n"[..]).chain(long).chain(&b"\nb\n"[..]);
        let mut collected = Collected::default();
        from_reader(reader, &mut collected).unwrap();
        assert_eq!(collected.0, expect(&[(1, "a"), (2, "too long"), (3, "b")]));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(8))]

        #[test]
        fn blocks_do_not_show(
            line in proptest::collection::vec(prop_oneof![Just(b'\n'), Just(b'\r'), Just(b'\\'), Just(b'f'), any::<u8>()], 1..40),
        ) {
            // Long enough for three blocks, at a length that cuts lines anywhere. The first byte keeps it from being UTF-16.
            let mut bytes = b"vv".to_vec();
            while bytes.len() < 2 * BLOCK + 7 {
                bytes.extend_from_slice(&line);
            }
            let mut streamed = Collected::default();
            from_reader(&bytes[..], &mut streamed).unwrap();
            prop_assert!(streamed.0 == lines(&bytes));
        }
    }
}
