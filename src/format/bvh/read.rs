//! Reading a `.bvh` in place.

use super::layout::{Header, Section, tag_text};
use super::{Geometry, structure, write};
use crate::format::{FormatError, Problem};
use crate::geometry::Triangle;
use crate::tree::statistics::Statistics;
use crate::tree::{Node, TreeView};
use bytemuck::Pod;

/// A `.bvh` file over borrowed bytes, usually a memory map.
#[derive(Clone, Debug)]
pub struct Bvh<'a> {
    pub header: Header,
    /// As they stand in the table; tags that this library does not know are listed and otherwise ignored.
    pub sections: Vec<Section>,
    /// Counted while the tree was checked.
    pub statistics: Statistics,
    pub tree: TreeView<'a>,
    pub triangles: &'a [Triangle],
    pub geometries: &'a [Geometry],
    /// Traversal order for occlusion queries, one per node.
    pub order: Option<&'a [u8]>,
    /// JSON: how the tree was built.
    pub meta: Option<&'a str>,
}

impl<'a> Bvh<'a> {
    /// Reads a file and checks sizes, checksums and every index. After it, everything may be followed: each node but the
    /// root has one parent, which stands before it; each leaf has its own entries of `PRIM`; each entry names a triangle;
    /// geometries are in order and share no triangle; no box has a NaN. The tree may be as deep as it has nodes
    /// (`header.depth` says it): do not recurse over it.
    ///
    /// # Errors
    /// When anything is not what `docs/formats.md` says, or the bytes are not aligned to 4 in memory (a map always is).
    pub fn parse(bytes: &'a [u8]) -> Result<Bvh<'a>, FormatError> {
        let (header, sections) = Header::read(bytes)?;
        if !bytes.as_ptr().addr().is_multiple_of(align_of::<Node>()) {
            return Err(FormatError::new(0, Problem::Unaligned));
        }
        let reader = Reader { bytes, sections: &sections };
        let nodes = reader.required::<Node>(b"NODE")?;
        let primitives = reader.required::<u32>(b"PRIM")?;
        let triangles = reader.required::<Triangle>(b"TRIS")?;
        let geometries = reader.required::<Geometry>(b"GEOM")?;
        let order = reader.optional::<u8>(b"ORDR")?;
        let meta = reader.text(b"META")?;
        let tree = TreeView { nodes, primitives };
        let statistics = structure::check(tree, triangles.len(), geometries, order)
            .map_err(|violation| reader.locate(violation))?;
        reader.check_header(&header, tree, &statistics)?;
        Ok(Bvh { header, sections, statistics, tree, triangles, geometries, order, meta })
    }
}

struct Reader<'a, 's> {
    bytes: &'a [u8],
    sections: &'s [Section],
}

impl<'a> Reader<'a, '_> {
    fn find(&self, tag: &[u8; 4]) -> Result<Option<&Section>, FormatError> {
        let mut found = self.sections.iter().filter(|section| section.tag == *tag);
        let section = found.next();
        match found.next() {
            Some(second) => {
                let name = format!("section {}", tag_text(*tag));
                Err(FormatError::field(second.offset, name, "a second one", "one"))
            }
            None => Ok(section),
        }
    }

    fn optional<T: Pod>(&self, tag: &[u8; 4]) -> Result<Option<&'a [T]>, FormatError> {
        let Some(section) = self.find(tag)? else { return Ok(None) };
        if section.element_bytes as usize != size_of::<T>() {
            let name = format!("bytes per element of section {}", tag_text(*tag));
            return Err(FormatError::field(section.offset, name, section.element_bytes, size_of::<T>()));
        }
        // In range: the table has been checked against the length of these bytes.
        let bytes = &self.bytes[section.offset as usize..(section.offset + section.bytes()) as usize];
        let elements = bytemuck::try_cast_slice(bytes);
        elements.map(Some).map_err(|_| FormatError::new(section.offset, Problem::Unaligned))
    }

    fn required<T: Pod>(&self, tag: &[u8; 4]) -> Result<&'a [T], FormatError> {
        let missing =
            || FormatError::field(112, "section table", format!("no {}", tag_text(*tag)), tag_text(*tag));
        self.optional(tag)?.ok_or_else(missing)
    }

    fn text(&self, tag: &[u8; 4]) -> Result<Option<&'a str>, FormatError> {
        let Some(bytes) = self.optional::<u8>(tag)? else { return Ok(None) };
        let offset = self.offset_of(tag);
        let text = std::str::from_utf8(bytes).map_err(|error| {
            let at = offset + error.valid_up_to() as u64;
            FormatError::field(
                at,
                format!("section {}", tag_text(*tag)),
                "bytes that are not UTF-8",
                "JSON in UTF-8",
            )
        })?;
        Ok(Some(text))
    }

    fn offset_of(&self, tag: &[u8; 4]) -> u64 {
        self.sections.iter().find(|section| section.tag == *tag).map_or(0, |section| section.offset)
    }

    /// The error of a rule that does not hold, at its element's place in the file.
    fn locate(&self, violation: structure::Violation) -> FormatError {
        let structure::Violation { tag, index, name, found, expected } = violation;
        let section = self.sections.iter().find(|section| section.tag == tag);
        let offset =
            section.map_or(0, |section| section.offset + index as u64 * u64::from(section.element_bytes));
        FormatError::field(offset, format!("{} {index}: {name}", tag_text(tag)), found, expected)
    }

    /// Whether the header says what the content is.
    fn check_header(
        &self,
        header: &Header,
        tree: TreeView,
        statistics: &Statistics,
    ) -> Result<(), FormatError> {
        let tris = self.sections.iter().find(|section| section.tag == *b"TRIS");
        if let Some(section) = tris.filter(|section| section.checksum != header.fingerprint) {
            let expected = format!("{:016x}, the checksum of TRIS", section.checksum);
            return Err(FormatError::field(
                16,
                "scene fingerprint",
                format!("{:016x}", header.fingerprint),
                expected,
            ));
        }
        let root = tree.nodes[0].bounds();
        if header.bounds != root {
            let text = |bounds: crate::geometry::Aabb| format!("{} to {}", bounds.lower, bounds.upper);
            return Err(FormatError::field(
                24,
                "bounds",
                text(header.bounds),
                format!("the root's, {}", text(root)),
            ));
        }
        let children = statistics.max_children as u32;
        let width = write::width(statistics.max_children);
        if header.max_children != children && header.max_children != width {
            return Err(FormatError::field(48, "largest number of children", header.max_children, width));
        }
        if header.max_leaf as usize != statistics.max_leaf {
            return Err(FormatError::field(52, "largest leaf", header.max_leaf, statistics.max_leaf));
        }
        if header.depth as usize != statistics.depth {
            return Err(FormatError::field(56, "depth", header.depth, statistics.depth));
        }
        Ok(())
    }
}
