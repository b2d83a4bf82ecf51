//! The numbers behind a PLY header, one after the other, with every length checked before it is believed.
//!
//! In an ascii file a line is an element: what it holds beyond the element's properties is passed
//! over, and what it lacks is an error. Empty lines, and those that begin with `comment` or
//! `obj_info`, are none.

use super::header::{Element, Encoding, Header, LineEnd, Property, Type};
use super::{Place, PlyError};
use crate::mesh::{Kind, Warnings, number};

/// A place in the body of a file.
#[derive(Clone)]
pub struct Values<'a> {
    bytes: &'a [u8],
    at: usize,
    encoding: Encoding,
    line_end: LineEnd,
    /// Of an ascii file: the number of the line that is being read, and what is left of it.
    line: u64,
    words: &'a [u8],
}

impl<'a> Values<'a> {
    pub fn new(bytes: &'a [u8], header: &Header) -> Values<'a> {
        let Header { encoding, body, lines, line_end, .. } = *header;
        Values { bytes, at: body, encoding, line_end, line: lines as u64, words: &[] }
    }

    /// Goes to the next element: in an ascii file, to the next line that holds one.
    #[inline]
    pub fn begin(&mut self) {
        if self.encoding != Encoding::Ascii {
            return;
        }
        loop {
            let rest = self.bytes.get(self.at..).unwrap_or(&[]);
            let (line, length) = self.line_end.line(rest);
            self.at += length;
            self.line += u64::from(!rest.is_empty());
            self.words = line;
            let first = self.word();
            if rest.is_empty() || !matches!(first, b"" | b"comment" | b"obj_info") {
                self.words = line;
                return;
            }
        }
    }

    /// Counts a trouble with the element that is being read: at its line, or its number where there
    /// are no lines.
    pub fn warn(&self, warnings: &mut Warnings, kind: Kind, unit: &'static str, index: u64) {
        match self.encoding {
            Encoding::Ascii => warnings.add(kind, self.line),
            _ => warnings.add_at(kind, unit, index + 1, ""),
        }
    }

    fn place(&self) -> Place {
        match self.encoding {
            Encoding::Ascii => Place::Line(self.line),
            _ => Place::Offset(self.at),
        }
    }

    fn left(&self) -> usize {
        self.bytes.len() - self.at
    }

    /// Whether so many elements can follow at all; memory is only reserved after this.
    pub fn check_length(&self, element: &Element) -> Result<(), PlyError> {
        let least = element.least_size(self.encoding) as u64;
        // The last ascii number needs no separator behind it.
        if element.count.saturating_mul(least) > self.left() as u64 + 1 {
            return Err(PlyError::TooShort {
                offset: self.at,
                element: element.name.clone(),
                count: element.count,
                left: self.left(),
            });
        }
        Ok(())
    }

    /// Steps over all elements of a kind.
    pub fn skip(&mut self, element: &Element) -> Result<(), PlyError> {
        if element.properties.is_empty() {
            return Ok(());
        }
        self.check_length(element)?;
        if let (Some(size), Encoding::Little | Encoding::Big) = (element.fixed_size(), self.encoding) {
            let total = size as u64 * element.count;
            if total > self.left() as u64 {
                return Err(self.cut_off(element, element.count));
            }
            self.at += total as usize;
            return Ok(());
        }
        for index in 0..element.count {
            self.begin();
            for property in &element.properties {
                self.skip_property(element, index, property)?;
            }
        }
        Ok(())
    }

    pub fn skip_property(
        &mut self,
        element: &Element,
        index: u64,
        property: &Property,
    ) -> Result<(), PlyError> {
        let count = match property.list {
            Some(kind) => self.length(element, index, kind)?,
            None => 1,
        };
        match self.encoding {
            Encoding::Ascii => {
                for _ in 0..count {
                    if self.word().is_empty() {
                        return Err(self.cut_off(element, index));
                    }
                }
            }
            _ => {
                let total = count.checked_mul(property.value.bytes()).filter(|&total| total <= self.left());
                self.at += total.ok_or_else(|| self.cut_off(element, index))?;
            }
        }
        Ok(())
    }

    /// One coordinate; an ascii word that is no number is refused here, since nothing after it could be trusted.
    pub fn coordinate(
        &mut self,
        element: &Element,
        index: u64,
        property: &Property,
    ) -> Result<f32, PlyError> {
        if self.encoding == Encoding::Ascii {
            let word = self.word();
            return number::parse_f32(word).ok_or_else(|| self.unexpected(element, index, "a number", word));
        }
        Ok(self.binary(element, index, property.value)? as f32)
    }

    /// A list of whole numbers, appended to `list`.
    pub fn list(
        &mut self,
        element: &Element,
        index: u64,
        property: &Property,
        list: &mut Vec<i64>,
    ) -> Result<(), PlyError> {
        let kind = property.list.unwrap_or(Type::U8);
        let count = self.length(element, index, kind)?;
        let (least, left) = match self.encoding {
            Encoding::Ascii => (1, self.words.len()),
            _ => (property.value.bytes(), self.left()),
        };
        if count.saturating_mul(least) > left {
            return Err(self.cut_off(element, index));
        }
        list.reserve(count);
        for _ in 0..count {
            list.push(self.whole(element, index, property.value)?);
        }
        Ok(())
    }

    fn length(&mut self, element: &Element, index: u64, kind: Type) -> Result<usize, PlyError> {
        let place = self.place();
        let length = self.whole(element, index, kind)?;
        usize::try_from(length).map_err(|_| PlyError::Value {
            place,
            element: element.name.clone(),
            index,
            expected: "a list's length",
            found: length.to_string(),
        })
    }

    /// A whole number, of whatever type it was stored as.
    fn whole(&mut self, element: &Element, index: u64, kind: Type) -> Result<i64, PlyError> {
        let place = self.place();
        let value = if self.encoding == Encoding::Ascii {
            let word = self.word();
            let text = std::str::from_utf8(word).unwrap_or("");
            if let Ok(value) = text.parse() {
                return Ok(value);
            }
            text.parse().map_err(|_| self.unexpected(element, index, "a whole number", word))?
        } else {
            self.binary(element, index, kind)?
        };
        // Some exporters write numbers of vertices as floats.
        if value.trunc() == value && value.abs() <= 9e15 {
            return Ok(value as i64);
        }
        Err(PlyError::Value {
            place,
            element: element.name.clone(),
            index,
            expected: "a whole number",
            found: value.to_string(),
        })
    }

    /// One binary number; `f64` holds every type exactly.
    #[inline]
    fn binary(&mut self, element: &Element, index: u64, kind: Type) -> Result<f64, PlyError> {
        let size = kind.bytes();
        let Some(stored) = self.bytes.get(self.at..).and_then(|rest| rest.get(..size)) else {
            return Err(self.cut_off(element, index));
        };
        self.at += size;
        let mut raw = [0; 8];
        raw[..size].copy_from_slice(stored);
        if self.encoding == Encoding::Big {
            raw[..size].reverse();
        }
        let [a, b, c, d, ..] = raw;
        Ok(match kind {
            Type::I8 => f64::from(a as i8),
            Type::U8 => f64::from(a),
            Type::I16 => f64::from(i16::from_le_bytes([a, b])),
            Type::U16 => f64::from(u16::from_le_bytes([a, b])),
            Type::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Type::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Type::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Type::F64 => f64::from_le_bytes(raw),
        })
    }

    /// The next word of the line; empty at its end.
    #[inline]
    fn word(&mut self) -> &'a [u8] {
        let line = self.words;
        let start = line.iter().position(|&byte| byte > b' ').unwrap_or(line.len());
        let line = &line[start..];
        let length = line.iter().position(|&byte| byte <= b' ').unwrap_or(line.len());
        self.words = &line[length..];
        &line[..length]
    }

    fn unexpected(&self, element: &Element, index: u64, expected: &'static str, found: &[u8]) -> PlyError {
        if found.is_empty() {
            return self.cut_off(element, index);
        }
        let found = String::from_utf8_lossy(&found[..found.len().min(40)]).into_owned();
        PlyError::Value { place: self.place(), element: element.name.clone(), index, expected, found }
    }

    fn cut_off(&self, element: &Element, index: u64) -> PlyError {
        let (place, element, count) = (self.place(), element.name.clone(), element.count);
        if self.encoding == Encoding::Ascii && self.at < self.bytes.len() {
            return PlyError::TooFewValues { place, element, index };
        }
        PlyError::CutOff { place, element, index, count }
    }
}
