//! `.bvh` files from a description: written by the library, taken apart, changed, and put together again with checksums that hold.

use super::bvh as accepted;
use super::edit::{Damage, Value, pick};
use super::text;
use arbitrary::{Arbitrary, Result, Unstructured};
use embree_trace::format::bvh::{self, Bvh, Contents, Geometry, flag};
use embree_trace::format::checksum;
use embree_trace::geometry::{Aabb, Triangle, Vec3};
use embree_trace::tree::{LEAF_BIT, Node, Tree};

/// A valid file: every triangle that is finite stands in the leaves of a tree with exact boxes.
#[derive(Debug)]
pub struct File {
    pub tree: Tree,
    pub triangles: Vec<Triangle>,
    pub geometries: Vec<Geometry>,
    pub order: Option<Vec<u8>>,
    pub meta: Option<String>,
    pub flags: u32,
    pub producer: String,
}

impl<'a> Arbitrary<'a> for File {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<File> {
        let count = u.int_in_range(0..=24u8)?;
        let triangles: Vec<Triangle> = (0..count).map(|_| triangle(u)).collect::<Result<_>>()?;
        let finite = (0..u32::from(count)).filter(|&index| triangles[index as usize].is_finite());
        let mut primitives: Vec<u32> = finite.collect();
        let mut flags = u.arbitrary::<u32>()? & !flag::SPATIAL_SPLITS;
        if u.ratio(1, 4)? {
            flags |= flag::SPATIAL_SPLITS;
            primitives.extend(primitives.clone());
        }
        let tree = tree(u, primitives, &triangles)?;
        let geometries = geometries(u, count.into())?;
        let orders = |u: &mut Unstructured| {
            (0..tree.nodes.len()).map(|_| u.int_in_range(0..=3)).collect::<Result<_>>()
        };
        let order = if u.arbitrary()? { Some(orders(u)?) } else { None };
        let meta = match u.int_in_range(0..=3u8)? {
            0 => None,
            1 => Some(String::from("{\"alpha\":[1,2,{}]}")),
            2 => Some(String::new()),
            _ => Some(text(u)?),
        };
        let producer = text(u)?;
        Ok(File { tree, triangles, geometries, order, meta, flags, producer })
    }
}

/// Mostly small numbers, so that boxes meet and coincide; sometimes any bits.
fn coordinate(u: &mut Unstructured) -> Result<f32> {
    Ok(match u.arbitrary::<u8>()? {
        255 => f32::from_bits(u.arbitrary()?),
        value => (f32::from(value) - 100.0) / 8.0,
    })
}

fn triangle(u: &mut Unstructured) -> Result<Triangle> {
    let mut vertices = [Vec3::ZERO; 3];
    for vertex in &mut vertices {
        *vertex = Vec3::new(coordinate(u)?, coordinate(u)?, coordinate(u)?);
    }
    Ok(Triangle(vertices))
}

/// Any tree over `primitives`: leaves are split into one to nine, which may be empty.
fn tree(u: &mut Unstructured, primitives: Vec<u32>, triangles: &[Triangle]) -> Result<Tree> {
    let bounds = |first: u32, count: u32| {
        let entries = &primitives[first as usize..(first + count) as usize];
        entries.iter().fold(Aabb::EMPTY, |bounds, &entry| bounds.union(&triangles[entry as usize].bounds()))
    };
    let all = primitives.len() as u32;
    let mut nodes = vec![Node::leaf(bounds(0, all), 0, all)];
    for _ in 0..u.int_in_range(0..=12u8)? {
        let index = u.choose_index(nodes.len())?;
        let node = nodes[index];
        let parts = u.int_in_range(1..=9u32)?;
        if !node.is_leaf() {
            continue;
        }
        let (first, count) = (node.first, node.len() as u32);
        nodes[index] = Node::inner(node.bounds(), nodes.len() as u32, parts);
        for part in 0..parts {
            let (from, to) = (first + count * part / parts, first + count * (part + 1) / parts);
            nodes.push(Node::leaf(bounds(from, to - from), from, to - from));
        }
    }
    Ok(Tree { nodes, primitives })
}

/// Geometries one behind the other, with gaps.
fn geometries(u: &mut Unstructured, triangles: u32) -> Result<Vec<Geometry>> {
    let mut geometries = Vec::new();
    let mut first_triangle = 0;
    for _ in 0..u.int_in_range(0..=4u8)? {
        first_triangle += u.int_in_range(0..=triangles - first_triangle)?;
        let kind = u.int_in_range(0..=1)?;
        let triangle_count =
            u.int_in_range(0..=triangles - first_triangle)? & if kind == 1 { !1 } else { !0 };
        geometries.push(Geometry {
            instance: u.arbitrary()?,
            geometry: u.arbitrary()?,
            first_triangle,
            triangle_count,
            mask: u.arbitrary()?,
            kind,
            flags: u.arbitrary()?,
            reserved: u.arbitrary()?,
        });
        first_triangle += triangle_count;
    }
    Ok(geometries)
}

impl File {
    /// The file as our writer makes it.
    ///
    /// # Panics
    /// When the writer refuses it.
    pub fn bytes(&self) -> Vec<u8> {
        let contents = Contents {
            tree: self.tree.view(),
            triangles: &self.triangles,
            geometries: &self.geometries,
            order: self.order.as_deref(),
            meta: self.meta.as_deref(),
            flags: self.flags,
            producer: &self.producer,
        };
        let mut bytes = Vec::new();
        if let Err(error) = bvh::write(&mut bytes, &contents) {
            panic!("a valid file is refused: {error}");
        }
        bytes
    }
}

/// A section of a file taken apart.
#[derive(Clone, Debug)]
pub struct Piece {
    entry: [u8; 32],
    body: Vec<u8>,
}

/// A file taken apart.
#[derive(Clone, Debug)]
pub struct Pieces {
    header: [u8; 128],
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
    /// Takes apart what [`File::bytes`] made.
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

/// A field of an entry of the section table.
#[derive(Clone, Copy, Debug, Arbitrary)]
enum Field {
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

#[derive(Debug, Arbitrary)]
enum Edit {
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
enum Tag {
    Order,
    Meta,
    Unknown([u8; 4]),
}

impl Edit {
    /// Changes the pieces; whether a reader must find the same content as before.
    fn apply(self, pieces: &mut Pieces) -> bool {
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
                if let Some(piece) = pick(sections, section).filter(|piece| !piece.body.is_empty()) {
                    let at = at as usize % piece.body.len();
                    piece.body[at] = value;
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

/// The file that bytes describe, without changes.
pub fn described(bytes: &[u8]) -> Option<Vec<u8>> {
    Unstructured::new(bytes).arbitrary().ok().map(|file: File| file.bytes())
}

/// Takes bytes as the description of a file and of changes, and gives the changed file to the reader.
///
/// # Panics
/// Where a promise of the reader does not hold.
pub fn check(bytes: &[u8]) {
    // An error says that the bytes describe nothing; there are none left to say more.
    let _ = run(&mut Unstructured::new(bytes));
}

fn run(u: &mut Unstructured) -> Result<()> {
    let file: File = u.arbitrary()?;
    let bytes = file.bytes();
    let mut pieces = Pieces::of(&bytes);
    let mut same = true;
    for _ in 0..u.int_in_range(0..=5u8)? {
        same &= u.arbitrary::<Edit>()?.apply(&mut pieces);
    }
    // Mostly, or little would be seen behind the checksums.
    let remake = if u.ratio(1, 4)? { u.arbitrary()? } else { Remake::ALL };
    let mut changed = pieces.bytes(remake);
    let damages = u.int_in_range(0..=2u8)?;
    for _ in 0..damages {
        u.arbitrary::<Damage>()?.apply(&mut changed);
    }
    accepted::check(&changed);

    if same && remake.offsets && remake.sections && remake.table && damages == 0 {
        assert_same(&bytes, &changed);
    }
    Ok(())
}

/// Two files have the same content, wherever their sections stand.
pub fn assert_same(bytes: &[u8], changed: &[u8]) {
    let (before, after) = match (Bvh::parse(bytes), Bvh::parse(changed)) {
        (Ok(before), Ok(after)) => (before, after),
        (Err(error), _) | (_, Err(error)) => panic!("a valid file is refused: {error}"),
    };
    assert_eq!(after.tree.nodes, before.tree.nodes);
    assert_eq!(after.tree.primitives, before.tree.primitives);
    let bits = |triangles| bytemuck::cast_slice::<Triangle, u8>(triangles).to_vec();
    assert_eq!(bits(after.triangles), bits(before.triangles));
    assert_eq!(after.geometries, before.geometries);
    assert_eq!((after.order, after.meta), (before.order, before.meta));
    assert_eq!(after.header.fingerprint, before.header.fingerprint);
}
