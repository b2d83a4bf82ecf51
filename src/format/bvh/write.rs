//! Writing a `.bvh`: header, section table, sections.

use super::layout::{Header, Section, table_end};
use super::{Geometry, structure};
use crate::format::{ALIGNMENT, align, checksum};
use crate::geometry::{Aabb, Triangle};
use crate::tree::TreeView;
use std::io::{self, Write};

/// Everything that a file holds.
#[derive(Clone, Copy, Debug)]
pub struct Contents<'a> {
    pub tree: TreeView<'a>,
    pub triangles: &'a [Triangle],
    /// In the order of their triangles.
    pub geometries: &'a [Geometry],
    /// Traversal order for occlusion queries, one per node: 0 nearest first, 1 first child first, 2 last child first,
    /// 3 farthest first.
    pub order: Option<&'a [u8]>,
    /// JSON: how the tree was built.
    pub meta: Option<&'a str>,
    /// Bits of [`super::flag`].
    pub flags: u32,
    /// Cut to 48 bytes.
    pub producer: &'a str,
}

/// XXH3-64 of the triangles, as the header has it.
pub fn fingerprint(triangles: &[Triangle]) -> u64 {
    checksum(bytemuck::cast_slice(triangles))
}

/// Writes a file and returns its fingerprint. `w` need not be buffered: every section is one write.
///
/// # Errors
/// `InvalidInput` when a reader would refuse the tree (see [`super::Bvh::parse`]); otherwise what `w` says.
pub fn write<W: Write>(mut w: W, contents: &Contents) -> io::Result<u64> {
    let Contents { tree, triangles, geometries, order, meta, .. } = *contents;
    let statistics = structure::check(tree, triangles.len(), geometries, order).map_err(|violation| {
        let structure::Violation { tag, index, name, found, expected } = violation;
        let what = format!("{} {index}: {name}: found {found}, expected {expected}", tag.escape_ascii());
        io::Error::new(io::ErrorKind::InvalidInput, what)
    })?;

    let mut parts: Vec<([u8; 4], u32, &[u8])> = vec![
        (*b"NODE", 32, bytemuck::cast_slice(tree.nodes)),
        (*b"PRIM", 4, bytemuck::cast_slice(tree.primitives)),
        (*b"TRIS", 36, bytemuck::cast_slice(triangles)),
        (*b"GEOM", 32, bytemuck::cast_slice(geometries)),
    ];
    parts.extend(order.map(|order| (*b"ORDR", 1, order)));
    parts.extend(meta.map(|meta| (*b"META", 1, meta.as_bytes())));

    let mut end = table_end(parts.len());
    let mut table = Vec::new();
    let mut fingerprint = 0;
    for &(tag, element_bytes, bytes) in &parts {
        let offset = end.next_multiple_of(ALIGNMENT);
        let checksum = checksum(bytes);
        if tag == *b"TRIS" {
            fingerprint = checksum;
        }
        let count = bytes.len() as u64 / u64::from(element_bytes);
        table.extend_from_slice(&Section { tag, element_bytes, offset, count, checksum }.table_entry());
        end = offset + bytes.len() as u64;
    }

    let header = Header {
        fingerprint,
        bounds: tree.nodes.first().map_or(Aabb::EMPTY, |root| root.bounds()),
        max_children: width(statistics.max_children),
        max_leaf: statistics.max_leaf as u32,
        depth: statistics.depth as u32,
        flags: contents.flags,
        producer: contents.producer.to_string(),
    };
    w.write_all(&header.bytes(&table))?;
    w.write_all(&table)?;
    let mut written = table_end(parts.len());
    for (_, _, bytes) in parts {
        let padding = align(written).map_or(0, |aligned| aligned - written);
        w.write_all(&[0; ALIGNMENT as usize][..padding as usize])?;
        w.write_all(bytes)?;
        written += padding + bytes.len() as u64;
    }
    w.flush()?;
    Ok(fingerprint)
}

/// The header's number of children: that of the usual trees, 2, 4 or 8 wide; a wider node (where trees were joined)
/// stands as it is.
pub(super) fn width(max_children: usize) -> u32 {
    match max_children {
        0..=2 => 2,
        3..=4 => 4,
        5..=8 => 8,
        wider => wider as u32,
    }
}
