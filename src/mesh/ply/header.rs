//! The text at the start of a PLY file: which elements follow, and how their numbers are written.

use super::PlyError;
use crate::format::excerpt;

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

#[derive(Debug)]
pub struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    /// Where the first element starts.
    pub body: usize,
}

impl Header {
    pub fn parse(bytes: &[u8]) -> Result<Header, PlyError> {
        let window = &bytes[..bytes.len().min(MAX_HEADER)];
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        let mut at = 0;
        let mut number = 0;
        while at < window.len() {
            let rest = &window[at..];
            let length = rest.iter().position(|&byte| byte == b'\n' || byte == b'\r').unwrap_or(rest.len());
            let text = String::from_utf8_lossy(&rest[..length]);
            // "\r\n" is one line end; but behind a lone '\r' a binary body may start with '\n', which no writer is known to do.
            at += length + if rest[length..].starts_with(b"\r\n") { 2 } else { 1 };
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
                    return Ok(Header { encoding, elements, body: at.min(bytes.len()) });
                }
                _ => return Err(error("not a header line")),
            }
        }
        Err(PlyError::NoEndOfHeader(window.len()))
    }
}
