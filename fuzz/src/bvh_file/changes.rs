//! Changes to the pieces of a `.bvh`: fields of the header and the table, words of sections, their number and order.

use super::super::edit::{Value, pick, set};
use super::pieces::{Piece, Pieces};
use arbitrary::Arbitrary;

/// A field of an entry of the section table.
#[derive(Clone, Copy, Debug, Arbitrary)]
pub(super) enum Field {
    Tag,
    ElementBytes,
    Offset,
    Count,
    Checksum,
}

impl Field {
    fn range(self) -> std::ops::Range<usize> {
        match self {
            Field::Tag => 0..4,
            Field::ElementBytes => 4..8,
            Field::Offset => 8..16,
            Field::Count => 16..24,
            Field::Checksum => 24..32,
        }
    }
}

/// A change to one piece, or to their order.
#[derive(Debug, Arbitrary)]
pub(super) enum Edit {
    /// A 4-byte word of the header.
    Header {
        word: u8,
        value: Value,
    },
    /// A 4-byte word of a section: a node's child, a geometry's first triangle, ….
    Word {
        section: u8,
        word: u16,
        value: Value,
    },
    Byte {
        section: u8,
        at: u16,
        value: u8,
    },
    /// A field of a node: box, first or count.
    Node {
        node: u8,
        word: u8,
        value: Value,
    },
    Entry {
        section: u8,
        field: Field,
        value: Value,
    },
    /// Elements at the end, copied from the start, or taken away; the table says so.
    Resize {
        section: u8,
        by: i8,
    },
    SwapEntries(u8, u8),
    SwapPlaces(u8, u8),
    Repeat(u8),
    Remove(u8),
    /// A section of any tag.
    Add {
        tag: Tag,
        element_bytes: u8,
        elements: u8,
        fill: u8,
    },
}

#[derive(Clone, Copy, Debug, Arbitrary)]
pub(super) enum Tag {
    Order,
    Meta,
    Unknown([u8; 4]),
}

impl Edit {
    /// Changes the pieces; whether a reader must find the same content as before.
    pub(super) fn apply(self, pieces: &mut Pieces) -> bool {
        let Pieces { header, sections, places } = pieces;
        match self {
            Edit::Header { word, value } => {
                let at = word as usize % 32 * 4;
                value.apply(&mut header[at..at + 4]);
            }
            Edit::Word { section, word, value } => {
                if let Some(piece) = pick(sections, section) {
                    set_word(&mut piece.body, word.into(), value);
                }
            }
            Edit::Byte { section, at, value } => {
                if let Some(piece) = pick(sections, section) {
                    set(&mut piece.body, at, value);
                }
            }
            Edit::Node { node, word, value } => {
                if let Some(piece) = sections.iter_mut().find(|piece| piece.entry.starts_with(b"NODE")) {
                    // First and count matter more than the six numbers of a box.
                    let word = [0, 1, 2, 3, 4, 5, 6, 7, 3, 3, 3, 3, 7, 7, 7, 7][word as usize % 16];
                    set_word(&mut piece.body, node as usize * 8 + word, value);
                }
            }
            Edit::Entry { section, field, value } => {
                if let Some(piece) = pick(sections, section) {
                    value.apply(&mut piece.entry[field.range()]);
                }
            }
            Edit::Resize { section, by } => {
                if let Some(piece) = pick(sections, section) {
                    piece.resize(by);
                }
            }
            Edit::SwapEntries(a, b) if !sections.is_empty() => {
                let count = sections.len();
                sections.swap(a as usize % count, b as usize % count);
                return true;
            }
            Edit::SwapPlaces(a, b) if !places.is_empty() => {
                let count = places.len();
                places.swap(a as usize % count, b as usize % count);
                return true;
            }
            Edit::Repeat(section) if sections.len() < 16 => {
                let copy = pick(sections, section).cloned();
                places.push(sections.len());
                sections.extend(copy);
            }
            Edit::Remove(section) if !sections.is_empty() => {
                drop(sections.remove(section as usize % sections.len()));
            }
            Edit::SwapEntries(..) | Edit::SwapPlaces(..) | Edit::Repeat(_) | Edit::Remove(_) => {}
            Edit::Add { tag, element_bytes, elements, fill } => {
                let tag = match tag {
                    Tag::Order => *b"ORDR",
                    Tag::Meta => *b"META",
                    Tag::Unknown(tag) => tag,
                };
                let element_bytes = element_bytes.max(1);
                let count = elements % 64;
                let body = vec![fill; count as usize * element_bytes as usize];
                let mut piece = Piece { entry: [0; 32], body };
                piece.entry[Field::Tag.range()].copy_from_slice(&tag);
                piece.entry[Field::ElementBytes.range()]
                    .copy_from_slice(&u32::from(element_bytes).to_le_bytes());
                piece.entry[Field::Count.range()].copy_from_slice(&u64::from(count).to_le_bytes());
                places.push(sections.len());
                sections.push(piece);
                let known = [b"NODE", b"PRIM", b"TRIS", b"GEOM", b"ORDR", b"META"];
                return !known.contains(&&tag);
            }
        }
        false
    }
}

fn set_word(bytes: &mut [u8], word: usize, value: Value) {
    let (words, _) = bytes.as_chunks_mut::<4>();
    let index = word % words.len().max(1);
    if let Some(word) = words.get_mut(index) {
        value.apply(word);
    }
}

impl Piece {
    fn resize(&mut self, by: i8) {
        let element = match &self.entry[..4] {
            b"NODE" | b"GEOM" => 32,
            b"TRIS" => 36,
            b"PRIM" => 4,
            _ => 1,
        };
        let bytes = (by.unsigned_abs() % 8) as usize * element;
        if by < 0 {
            self.body.truncate(self.body.len().saturating_sub(bytes));
        } else {
            let copy: Vec<u8> = self.body.iter().copied().cycle().take(bytes).collect();
            self.body.extend(copy);
        }
        let count = (self.body.len() / element) as u64;
        self.entry[Field::Count.range()].copy_from_slice(&count.to_le_bytes());
    }
}
