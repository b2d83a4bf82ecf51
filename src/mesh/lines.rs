//! Text files as statements: encodings, line ends and continuation lines are dealt with here, once, so that the OBJ and MTL
//! readers see plain lines of bytes.
//!
//! A line ends with LF, CR LF or CR, or with LF CR where the first one does. A backslash at its
//! end, blanks behind it or not, continues the statement in the next line, except where that begins
//! a statement of its own. A comment ends with its line, whatever stands last in it; and in a
//! statement that gives a name, only a backslash that stands alone continues.
//!
//! Bytes come as one slice (a memory map: nothing is copied) or from a reader in blocks (a decompressor: only one block and
//! the line it cuts are held). UTF-16, with or without a mark, is turned into UTF-8 on the way; a UTF-8 mark is dropped.

use memchr::{memchr_iter, memchr2, memchr2_iter, memrchr2_iter};
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
        // Whole lines only, and no line end of two characters in two parts. What comes after the
        // last byte is not known yet.
        let cut = if last {
            text.len()
        } else {
            let known = text.len().saturating_sub(1);
            let whole = |&end: &usize| !matches!(&text[end..end + 2], b"\r\n" | b"\n\r");
            memrchr2_iter(b'\n', b'\r', &text[..known]).find(whole).map_or(0, |end| end + 1)
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

/// Without a UTF-8 byte order mark.
pub fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes)
}

/// Cuts blocks of whole lines into lines, and joins those that go on.
#[derive(Default)]
struct Splitter {
    /// Lines seen so far.
    number: u64,
    /// Whether lines end with LF CR.
    reversed_ends: bool,
    /// Parts of a statement that goes on, and the number of the first line.
    joined: Vec<u8>,
    joined_from: u64,
    joining: bool,
}

impl Splitter {
    #[inline]
    fn block(&mut self, mut block: &[u8], sink: &mut impl Sink) {
        if self.number == 0 {
            let first = memchr2_iter(b'\n', b'\r', block).next();
            self.reversed_ends = first.is_some_and(|end| block[end..].starts_with(b"\n\r"));
        }
        while !block.is_empty() {
            let end = memchr2(b'\n', b'\r', block).unwrap_or(block.len());
            let line = &block[..end];
            let two = match &block[end..] {
                [b'\r', b'\n', ..] => true,
                [b'\n', b'\r', ..] => self.reversed_ends,
                _ => false,
            };
            block = block.get(end + if two { 2 } else { 1 }..).unwrap_or(&[]);
            self.number += 1;
            if self.joining || may_go_on(line) {
                self.join(line, sink);
            } else {
                sink.line(self.number, line);
            }
        }
    }

    fn join(&mut self, line: &[u8], sink: &mut impl Sink) {
        if self.joining && begins_statement(line) {
            self.finish(sink);
        }
        let part = continued(line, self.joining);
        if !self.joining {
            let Some(part) = part else {
                sink.line(self.number, line);
                return;
            };
            self.joined_from = self.number;
            self.joining = true;
            self.joined.extend_from_slice(part);
            return;
        }
        if self.joined.len() <= MAX_LINE {
            self.joined.push(b' ');
            self.joined.extend_from_slice(part.unwrap_or(line));
        }
        if part.is_none() {
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

/// Whether a line ends in a backslash, or in blanks with one before.
#[inline]
fn may_go_on(line: &[u8]) -> bool {
    match line.last() {
        Some(b'\\') => true,
        Some(b' ' | b'\t') => line.trim_ascii_end().ends_with(b"\\"),
        _ => false,
    }
}

/// A line that goes on, without the backslash. `part` says that it is not the first line of its
/// statement.
fn continued(line: &[u8], part: bool) -> Option<&[u8]> {
    let statement = line.trim_ascii_end().strip_suffix(b"\\")?;
    let alone = statement.last().is_none_or(u8::is_ascii_whitespace);
    let commented = without_comment(line).len() < line.len();
    (!commented && (alone || part || !gives_name(statement))).then_some(statement)
}

fn keyword(line: &[u8]) -> &[u8] {
    line.trim_ascii_start().split(u8::is_ascii_whitespace).next().unwrap_or(&[])
}

/// Whether what stands behind the keyword may hold any character.
fn gives_name(line: &[u8]) -> bool {
    let keyword = keyword(line);
    keyword.starts_with(b"map_")
        || keyword.eq_ignore_ascii_case(b"newmtl")
        || matches!(
            keyword,
            b"o" | b"g"
                | b"usemtl"
                | b"mtllib"
                | b"usemap"
                | b"maplib"
                | b"bump"
                | b"disp"
                | b"decal"
                | b"refl"
                | b"norm"
                | b"shadow_obj"
                | b"trace_obj"
        )
}

/// Whether a line cannot be the second part of a statement: no number, and none of the names in
/// lists, is such a word.
fn begins_statement(line: &[u8]) -> bool {
    gives_name(line)
        || matches!(
            keyword(line),
            b"v" | b"vn"
                | b"vt"
                | b"vp"
                | b"f"
                | b"fo"
                | b"l"
                | b"p"
                | b"s"
                | b"Kd"
                | b"Ka"
                | b"Ks"
                | b"Ke"
                | b"Ns"
                | b"Ni"
                | b"Tf"
                | b"Tr"
                | b"d"
                | b"illum"
        )
}

/// A line up to its comment.
///
/// In a statement of numbers `#` begins one wherever it stands. In one that gives a name it does so
/// behind a blank, unless a digit follows: `Material #25` and `C#minor` are names.
pub fn without_comment(line: &[u8]) -> &[u8] {
    let named = gives_name(line);
    let comment = |at: &usize| {
        let blank_before = *at == 0 || line[at - 1].is_ascii_whitespace();
        !named || blank_before && !line.get(at + 1).is_some_and(u8::is_ascii_digit)
    };
    memchr_iter(b'#', line).find(comment).map_or(line, |at| &line[..at])
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
        for text in ["a\nb\n\nc", "a\r\nb\r\n\r\nc\r\n", "a\rb\r\rc\r", "a\n\rb\n\r\n\rc\n\r"] {
            assert_eq!(lines(text.as_bytes()), expect(&[(1, "a"), (2, "b"), (4, "c")]), "{text:?}");
        }
    }

    #[test]
    fn statements_go_on_in_the_next_line() {
        assert_eq!(lines(b"f 1 \\\n2\\\n3\nv"), expect(&[(1, "f 1  2 3"), (4, "v")]));
        assert_eq!(lines(b"f 1 2 3\\"), expect(&[(1, "f 1 2 3")]));
        assert_eq!(lines(b"f 1 2 \\ \t\r\n 3 # \\\r\nv"), expect(&[(1, "f 1 2   3 # \\"), (3, "v")]));
        assert_eq!(lines(b"#\n\rf 1 \\\n\r2\n\rv"), expect(&[(1, "#"), (2, "f 1  2"), (4, "v")]));
        // The backslash is one too many.
        assert_eq!(lines(b"f 1 2 3\\\nf 1 3 4"), expect(&[(1, "f 1 2 3"), (2, "f 1 3 4")]));
        assert_eq!(lines(b"mtllib a \\\n b\nv"), expect(&[(1, "mtllib a   b"), (3, "v")]));
    }

    #[test]
    fn names_and_comments_may_end_in_a_backslash() {
        for line in
            ["# C:\\", "f 1 2 3 # C:\\", "v 0 0 0# \\", "o C:\\", "g C:\\ ", "usemtl a # b \\", "bump C:\\"]
        {
            let text = format!("{line}\nx\n");
            assert_eq!(lines(text.as_bytes()), expect(&[(1, line), (2, "x")]));
        }
    }

    #[test]
    fn comments() {
        for (line, statement) in [
            ("f 1 2 3# a", "f 1 2 3"),
            ("v 0 0 0 # a # b", "v 0 0 0 "),
            ("# a", ""),
            ("usemtl m # main", "usemtl m "),
            ("usemtl m #main", "usemtl m "),
            ("usemtl #", "usemtl "),
            ("o C#minor", "o C#minor"),
            ("newmtl Material #25 # wood", "newmtl Material #25 "),
            ("illum 3# mirror", "illum 3"),
        ] {
            assert_eq!(without_comment(line.as_bytes()), statement.as_bytes());
        }
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
