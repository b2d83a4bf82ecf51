//! The text at the start of a PLY file: which elements follow, and how their numbers are written.
//!
//! Its first line tells how lines end, here and in an ascii body: with LF (a CR before it is a
//! blank), LF CR, or CR. In a binary file the body starts right behind the last line's end,
//! whatever bytes it starts with. Letters may be capital.

use super::PlyError;
use crate::format::excerpt;
use crate::mesh::lines::without_mark;
use memchr::memchr;

/// A header beyond this is none.
const MAX_HEADER: usize = 1 << 20;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Type {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Type {
    fn parse(name: &str) -> Option<Type> {
        Some(match name {
            "char" | "int8" => Type::I8,
            "uchar" | "uint8" => Type::U8,
            "short" | "int16" => Type::I16,
            "ushort" | "uint16" => Type::U16,
            "int" | "int32" => Type::I32,
            "uint" | "uint32" => Type::U32,
            "float" | "float32" => Type::F32,
            "double" | "float64" => Type::F64,
            _ => return None,
        })
    }

    pub fn bytes(self) -> usize {
        match self {
            Type::I8 | Type::U8 => 1,
            Type::I16 | Type::U16 => 2,
            Type::I32 | Type::U32 | Type::F32 => 4,
            Type::F64 => 8,
        }
    }
}

#[derive(Debug)]
pub struct Property {
    pub name: String,
    pub value: Type,
    /// The type of a list's length, when it is a list.
    pub list: Option<Type>,
}

#[derive(Debug)]
pub struct Element {
    pub name: String,
    pub count: u64,
    pub properties: Vec<Property>,
}

impl Element {
    /// Bytes of each one in a binary file, when it holds no list.
    pub fn fixed_size(&self) -> Option<usize> {
        self.properties.iter().map(|property| property.list.is_none().then(|| property.value.bytes())).sum()
    }

    /// Bytes that one takes at least: of an empty list its length, of an ascii number a digit and a separator.
    pub fn least_size(&self, encoding: Encoding) -> usize {
        match encoding {
            Encoding::Ascii => 2 * self.properties.len(),
            _ => self.properties.iter().map(|property| property.list.unwrap_or(property.value).bytes()).sum(),
        }
    }
}

/// What ends a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineEnd {
    /// A line feed; a carriage return before it is a blank.
    Feed,
    /// A line feed, and a carriage return behind it where there is one.
    FeedReturn,
    Return,
}

impl LineEnd {
    fn of_first_line(bytes: &[u8]) -> LineEnd {
        match bytes.iter().position(|&byte| byte == b'\n' || byte == b'\r') {
            Some(end) if bytes[end..].starts_with(b"\n\r") => LineEnd::FeedReturn,
            Some(end) if bytes[end] == b'\r' && !bytes[end..].starts_with(b"\r\n") => LineEnd::Return,
            _ => LineEnd::Feed,
        }
    }

    /// The first line of `bytes`, and how many bytes it takes with its end.
    #[inline]
    pub fn line(self, bytes: &[u8]) -> (&[u8], usize) {
        let end = if self == LineEnd::Return { b'\r' } else { b'\n' };
        let Some(length) = memchr(end, bytes) else { return (bytes, bytes.len()) };
        let two = self == LineEnd::FeedReturn && bytes[length..].starts_with(b"\n\r");
        (&bytes[..length], length + if two { 2 } else { 1 })
    }
}

/// Whether a file is a PLY by its first line, which may have a byte order mark before it and blanks
/// behind.
pub fn is_ply(bytes: &[u8]) -> bool {
    let bytes = without_mark(bytes);
    let Some((word, rest)) = bytes.split_at_checked(3) else { return false };
    let behind = rest.iter().find(|byte| !matches!(byte, b' ' | b'\t'));
    word.eq_ignore_ascii_case(b"ply") && matches!(behind, Some(b'\n' | b'\r'))
}

#[derive(Debug)]
pub struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    /// Where the first element starts.
    pub body: usize,
    /// The header's lines, and what ends these and those of an ascii body.
    pub lines: usize,
    pub line_end: LineEnd,
}

impl Header {
    pub fn parse(bytes: &[u8]) -> Result<Header, PlyError> {
        let window = &bytes[..bytes.len().min(MAX_HEADER)];
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        let mut at = bytes.len() - without_mark(bytes).len();
        let line_end = LineEnd::of_first_line(window);
        let mut number = 0;
        while at < window.len() {
            let (line, length) = line_end.line(&window[at..]);
            let text = String::from_utf8_lossy(line).trim().to_ascii_lowercase();
            at += length;
            number += 1;
            let error = |what: &str| PlyError::Header {
                line: number,
                what: format!("{what}: `{}`", excerpt(&text, 60)),
            };
            let words: Vec<&str> = text.split_whitespace().collect();
            match words.as_slice() {
                [] | ["comment" | "obj_info", ..] => {}
                ["ply"] if number == 1 => {}
                ["format", name, ..] => {
                    encoding = Some(match *name {
                        "ascii" => Encoding::Ascii,
                        "binary_little_endian" => Encoding::Little,
                        "binary_big_endian" => Encoding::Big,
                        _ => return Err(error("unknown format")),
                    });
                }
                ["element", name, count] => {
                    let count = count.parse().map_err(|_| error("the count is no number"))?;
                    elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
                }
                ["property", description @ ..] => {
                    let element =
                        elements.last_mut().ok_or_else(|| error("a property before any element"))?;
                    let (list, value, name) = match description {
                        ["list", length, value, name] => (Some(*length), *value, *name),
                        [value, name] => (None, *value, *name),
                        _ => return Err(error("expected `property TYPE NAME`")),
                    };
                    let kind = |name: &str| Type::parse(name).ok_or_else(|| error("unknown type"));
                    element.properties.push(Property {
                        name: name.to_owned(),
                        value: kind(value)?,
                        list: list.map(kind).transpose()?,
                    });
                }
                ["end_header", ..] => {
                    let encoding = encoding.ok_or_else(|| error("no `format` line before"))?;
                    return Ok(Header { encoding, elements, body: at, lines: number, line_end });
                }
                _ => return Err(error("not a header line")),
            }
        }
        Err(PlyError::NoEndOfHeader(window.len()))
    }
}
