//! `.bvh` files from a description: written by the library, taken apart ([`pieces`]), changed ([`changes`]), and put together again with checksums
//! that hold.

mod changes;
mod pieces;

pub use pieces::{Pieces, Remake};

use super::bvh as accepted;
use super::edit::damage;
use super::text;
use arbitrary::{Arbitrary, Result, Unstructured};
use changes::Edit;
use embree_trace::format::bvh::{self, Bvh, Contents, Geometry, flag};
use embree_trace::geometry::{Aabb, Triangle, Vec3};
use embree_trace::tree::{Node, Tree};

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
            instance_mask: u.arbitrary()?,
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
    let damaged = damage(u, &mut changed)?;
    accepted::check(&changed);

    if same && remake.offsets && remake.sections && remake.table && !damaged {
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
