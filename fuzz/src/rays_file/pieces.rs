//! A `.rays` taken apart into headers, bodies and index, and put together again with numbers that fit.

use arbitrary::Arbitrary;
use embree_trace::format::checksum;
use embree_trace::format::rays::Rays;

/// A chunk of a file taken apart.
#[derive(Clone, Debug)]
pub struct Piece {
    pub(super) header: [u8; 64],
    pub(super) body: Vec<u8>,
    /// Its number in the file, as long as nothing in it was changed.
    pub(super) unchanged: Option<usize>,
}

/// A file taken apart.
#[derive(Clone, Debug)]
pub struct Pieces {
    pub(super) header: [u8; 64],
    pub chunks: Vec<Piece>,
    pub(super) index_header: [u8; 64],
    pub(super) entries: Vec<[u8; 16]>,
    pub(super) end: [u8; 16],
}

/// Which numbers are made new when a file is put together, so that they fit what was changed.
#[derive(Clone, Copy, Debug, Arbitrary)]
pub struct Remake {
    /// Checksums of bodies.
    pub bodies: bool,
    /// The entries of the index, from the chunks' headers and places.
    pub entries: bool,
    /// The index's sizes and checksum.
    pub index: bool,
    /// The offset of the index at the end.
    pub end: bool,
}

impl Remake {
    pub const ALL: Remake = Remake { bodies: true, entries: true, index: true, end: true };
}

impl Pieces {
    /// Takes apart what [`super::File::bytes`] made.
    ///
    /// # Panics
    /// When it is not a valid file.
    pub fn of(bytes: &[u8]) -> Pieces {
        let rays = match Rays::parse(bytes) {
            Ok(rays) => rays,
            Err(error) => panic!("our own file is refused: {error}"),
        };
        let array = |at: usize| std::array::from_fn(|byte| bytes[at + byte]);
        let chunks = rays.chunks().iter().enumerate().map(|(number, chunk)| Piece {
            header: array(chunk.offset as usize),
            body: bytes[chunk.body() as usize..][..chunk.stored_bytes as usize].to_vec(),
            unchanged: Some(number),
        });
        let entries_at = bytes.len() - 16 - 16 * rays.chunks().len();
        let (entries, _) = bytes[entries_at..bytes.len() - 16].as_chunks::<16>();
        Pieces {
            header: array(0),
            chunks: chunks.collect(),
            index_header: array(entries_at - 64),
            entries: entries.to_vec(),
            end: std::array::from_fn(|byte| bytes[bytes.len() - 16 + byte]),
        }
    }

    /// The numbers that the chunks had in the file, when none was changed.
    pub fn order(&self) -> Option<Vec<usize>> {
        self.chunks.iter().map(|chunk| chunk.unchanged).collect()
    }

    /// Puts the file together.
    pub fn bytes(&self, remake: Remake) -> Vec<u8> {
        let mut bytes = self.header.to_vec();
        let mut entries = Vec::new();
        for Piece { header, body, .. } in &self.chunks {
            let mut header = *header;
            if remake.bodies {
                header[48..56].copy_from_slice(&checksum(body).to_le_bytes());
            }
            entries.extend((bytes.len() as u64).to_le_bytes());
            entries.extend_from_slice(&header[8..16]);
            bytes.extend_from_slice(&header);
            bytes.extend_from_slice(body);
            bytes.resize(bytes.len().next_multiple_of(64), 0);
        }
        if !remake.entries {
            entries = self.entries.concat();
        }
        let (mut index_header, mut end) = (self.index_header, self.end);
        if remake.index {
            let length = (entries.len() as u64).to_le_bytes();
            index_header[32..40].copy_from_slice(&length);
            index_header[40..48].copy_from_slice(&length);
            index_header[48..56].copy_from_slice(&checksum(&entries).to_le_bytes());
        }
        if remake.end {
            end[..8].copy_from_slice(&(bytes.len() as u64).to_le_bytes());
        }
        bytes.extend_from_slice(&index_header);
        bytes.extend_from_slice(&entries);
        bytes.extend_from_slice(&end);
        bytes
    }

    /// The chunks only: a recording that was killed.
    pub fn bytes_without_index(&self) -> Vec<u8> {
        let whole = self.bytes(Remake::ALL);
        whole[..whole.len() - 16 - 16 * self.chunks.len() - 64].to_vec()
    }
}
