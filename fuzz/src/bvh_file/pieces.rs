//! A `.bvh` taken apart into header, table and sections, and put together again with numbers that fit.

use arbitrary::Arbitrary;
use embree_trace::format::bvh::Bvh;
use embree_trace::format::checksum;
use embree_trace::tree::LEAF_BIT;
/// A section of a file taken apart.
#[derive(Clone, Debug)]
pub struct Piece {
    pub(super) entry: [u8; 32],
    pub(super) body: Vec<u8>,
}

/// A file taken apart.
#[derive(Clone, Debug)]
pub struct Pieces {
    pub(super) header: [u8; 128],
    pub sections: Vec<Piece>,
    /// The order in which the sections' bodies stand behind the table.
    pub places: Vec<usize>,
}

/// Which numbers are made new when a file is put together, so that they fit what was changed.
#[derive(Clone, Copy, Debug, Arbitrary)]
pub struct Remake {
    pub offsets: bool,
    /// Checksums of sections, and the fingerprint.
    pub sections: bool,
    /// The table's length and checksum.
    pub table: bool,
    /// The bounds, widths and depth in the header.
    pub summary: bool,
}

impl Remake {
    pub const ALL: Remake = Remake { offsets: true, sections: true, table: true, summary: true };
}

impl Pieces {
    /// Takes apart what [`super::File::bytes`] made.
    ///
    /// # Panics
    /// When it is not a valid file.
    pub fn of(bytes: &[u8]) -> Pieces {
        let bvh = match Bvh::parse(bytes) {
            Ok(bvh) => bvh,
            Err(error) => panic!("our own file is refused: {error}"),
        };
        let sections: Vec<Piece> = (bvh.sections.iter().enumerate())
            .map(|(number, section)| Piece {
                entry: std::array::from_fn(|byte| bytes[128 + 32 * number + byte]),
                body: bytes[section.offset as usize..][..section.bytes() as usize].to_vec(),
            })
            .collect();
        let places = (0..sections.len()).collect();
        Pieces { header: std::array::from_fn(|byte| bytes[byte]), sections, places }
    }

    /// Puts the file together.
    pub fn bytes(&self, remake: Remake) -> Vec<u8> {
        let table_end = 128 + 32 * self.sections.len();
        let mut bytes = vec![0; table_end];
        let mut offsets = vec![table_end as u64; self.sections.len()];
        for &number in self.places.iter().filter(|&&number| number < self.sections.len()) {
            bytes.resize(bytes.len().next_multiple_of(64), 0);
            offsets[number] = bytes.len() as u64;
            bytes.extend_from_slice(&self.sections[number].body);
        }
        let mut header = self.header;
        let mut table = Vec::new();
        for (Piece { entry, body }, offset) in self.sections.iter().zip(offsets) {
            let mut entry = *entry;
            if remake.offsets {
                entry[8..16].copy_from_slice(&offset.to_le_bytes());
            }
            if remake.sections {
                entry[24..32].copy_from_slice(&checksum(body).to_le_bytes());
            }
            if remake.sections && entry.starts_with(b"TRIS") {
                header[16..24].copy_from_slice(&entry[24..32]);
            }
            if remake.summary && entry.starts_with(b"NODE") {
                summarise(&mut header, body);
            }
            table.extend_from_slice(&entry);
        }
        if remake.table {
            header[112..116].copy_from_slice(&(self.sections.len() as u32).to_le_bytes());
            header[120..128].copy_from_slice(&checksum(&table).to_le_bytes());
        }
        bytes[..128].copy_from_slice(&header);
        bytes[128..table_end].copy_from_slice(&table);
        bytes
    }
}

/// Writes what the header says of nodes: bounds, children, largest leaf and depth. Of nodes that are no tree, something near.
fn summarise(header: &mut [u8; 128], nodes: &[u8]) {
    let (nodes, _) = nodes.as_chunks::<32>();
    let word =
        |node: &[u8; 32], at: usize| u32::from_le_bytes([node[at], node[at + 1], node[at + 2], node[at + 3]]);
    let (mut children, mut leaf, mut depth) = (0, 0, 0);
    let mut levels = vec![1u32; nodes.len()];
    for (index, node) in nodes.iter().enumerate() {
        let (first, count) = (word(node, 12) as usize, word(node, 28));
        depth = depth.max(levels[index]);
        if count & LEAF_BIT != 0 {
            leaf = leaf.max(count & !LEAF_BIT);
            continue;
        }
        children = children.max(count);
        let below = first..first.saturating_add(count as usize).min(nodes.len());
        if first > index && first < below.end {
            let level = levels[index] + 1;
            levels[below].fill(level);
        }
    }
    if let Some(root) = nodes.first() {
        header[24..36].copy_from_slice(&root[..12]);
        header[36..48].copy_from_slice(&root[16..28]);
    }
    let width = [2, 4, 8].into_iter().find(|&width| children <= width).unwrap_or(children);
    for (at, value) in [(48, width), (52, leaf), (56, depth)] {
        header[at..at + 4].copy_from_slice(&value.to_le_bytes());
    }
}
