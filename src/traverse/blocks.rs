//! The triangles of a tree in blocks of four, tested together.
//!
//! A leaf's triangles lie side by side in slots, four slots to a block. Small leaves share a block, so that trees with one
//! triangle a leaf waste no memory, but no leaf lies in more blocks than it must: one of up to four costs one test.
//! A test answers for the lanes of one leaf; the bits are those of [`PreparedTriangle::intersect`], lane by lane.
//!
//! A block has all that is known of its triangles, in three cache lines side by side: edges and normals are computed anew in each test,
//! which takes less time than waiting for a fourth line.

use super::masks::Masks;
use super::memory;
use super::ray::PreparedRay;
use super::simd::{F32x4, Machine};
use super::triangle::PreparedTriangle;
use crate::geometry::{Triangle, Vec3};
use crate::tree::TreeView;

/// Triangles in a block.
pub(super) const LANES: usize = 4;

/// Cache lines of a block.
pub(super) const LINES: usize = 3;

/// Four triangles. Empty lanes are zero, and hit by nothing.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Block {
    /// By vertex, axis and lane.
    vertices: [[[f32; LANES]; 3]; 3],
    /// See [`PreparedTriangle::index`].
    index: [u32; LANES],
    /// See [`PreparedTriangle::mask`].
    mask: [u32; LANES],
}

const _: () = assert!(size_of::<Block>() == 64 * LINES);

/// All triangles of a tree, in leaf order.
#[derive(Debug)]
pub struct Blocks {
    blocks: Vec<Block>,
    /// By slot, see [`PreparedTriangle::instance_mask`]; empty, as in nearly every scene, where no
    /// triangle has two masks.
    instance_masks: Vec<u32>,
}

/// A ray as blocks are tested against it.
#[derive(Clone, Copy, Debug)]
pub struct BlockRay {
    origin: [F32x4; 3],
    direction: [F32x4; 3],
    /// The start of the interval times [`PreparedRay::magnified`].
    near: F32x4,
    magnified: F32x4,
}

impl BlockRay {
    #[inline(always)]
    pub fn new(ray: &PreparedRay) -> BlockRay {
        BlockRay {
            origin: std::array::from_fn(|axis| F32x4::splat(ray.origin[axis])),
            direction: std::array::from_fn(|axis| F32x4::splat(ray.direction[axis])),
            near: F32x4::splat(ray.tnear * ray.magnified),
            magnified: F32x4::splat(ray.magnified),
        }
    }
}

#[inline(always)]
fn cross<M: Machine>(a: [F32x4; 3], b: [F32x4; 3]) -> [F32x4; 3] {
    let minor = |a1: F32x4, b2, a2: F32x4, b1| M::mul_sub(a1, b2, a2.mul(b1));
    [minor(a[1], b[2], a[2], b[1]), minor(a[2], b[0], a[0], b[2]), minor(a[0], b[1], a[1], b[0])]
}

#[inline(always)]
fn difference(a: [F32x4; 3], b: [F32x4; 3]) -> [F32x4; 3] {
    [a[0].sub(b[0]), a[1].sub(b[1]), a[2].sub(b[2])]
}

#[inline(always)]
fn dot<M: Machine>(a: [F32x4; 3], b: [F32x4; 3]) -> F32x4 {
    M::mul_add(a[0], b[0], M::mul_add(a[1], b[1], a[2].mul(b[2])))
}

impl Block {
    /// Written out, because what a closure or `map` does is not always compiled for the processor that the caller is compiled for.
    #[inline(always)]
    fn vertices(&self) -> [[F32x4; 3]; 3] {
        let [v0, v1, v2] = &self.vertices;
        [
            [F32x4::new(v0[0]), F32x4::new(v0[1]), F32x4::new(v0[2])],
            [F32x4::new(v1[0]), F32x4::new(v1[1]), F32x4::new(v1[2])],
            [F32x4::new(v2[0]), F32x4::new(v2[1]), F32x4::new(v2[2])],
        ]
    }

    /// [`PreparedTriangle::intersect`] but for the triangles' boxes, for hits up to `bound`: which lanes pass, as bits, and t times the
    /// denominator, and the denominator, both positive.
    #[inline(always)]
    fn test<M: Machine>(&self, ray: &BlockRay, bound: f32) -> (u32, F32x4, F32x4) {
        let zero = F32x4::splat(0.0);
        let [v0, v1, v2] = self.vertices();
        let edge1 = difference(v0, v1);
        let edge2 = difference(v2, v0);
        let normal = cross::<M>(edge2, edge1);
        let c = difference(v0, ray.origin);
        let r = cross::<M>(c, ray.direction);
        let den = dot::<M>(normal, ray.direction);
        let sign = den.signs();
        let den_abs = den.flip(sign);
        let u = dot::<M>(r, edge2).flip(sign);
        let v = dot::<M>(r, edge1).flip(sign);
        let t = dot::<M>(normal, c).flip(sign);
        // A denominator of zero fails one of the last two.
        let inside = zero.le(u).and(zero.le(v)).and(u.add(v).le(den_abs));
        let behind_start = den_abs.mul(ray.near).lt(t.mul(ray.magnified));
        let within = behind_start.and(t.le(den_abs.mul(F32x4::splat(bound))));
        (inside.and(within).bits(), t, den_abs)
    }

    /// [`PreparedTriangle::confirm`], lane by lane: which lanes pass, as bits, and at which t.
    #[inline(always)]
    fn confirm(&self, ray: &PreparedRay, t: F32x4) -> (u32, F32x4) {
        let [v0, v1, v2] = self.vertices();
        let (mut entry, mut exit) = (F32x4::splat(ray.tnear), F32x4::splat(ray.tfar));
        for axis in 0..3 {
            let origin = F32x4::splat(ray.origin[axis]);
            let (near_inverse, far_inverse) =
                (F32x4::splat(ray.near_inverse[axis]), F32x4::splat(ray.far_inverse[axis]));
            let lower = v0[axis].min_or(v1[axis]).min_or(v2[axis]);
            let upper = v0[axis].max_or(v1[axis]).max_or(v2[axis]);
            let downwards = near_inverse.lt(F32x4::splat(0.0));
            let (near, far) = (downwards.select(upper, lower), downwards.select(lower, upper));
            entry = near.sub(origin).mul(near_inverse).max_or(entry);
            exit = far.sub(origin).mul(far_inverse).min_or(exit);
        }
        let t = t.max_or(entry);
        let finite = t.le(F32x4::splat(f32::MAX)).and(F32x4::splat(f32::MIN).le(t));
        (entry.le(exit).and(finite).bits(), t.min_or(F32x4::splat(ray.tfar)))
    }
}

impl Blocks {
    /// The triangles of the leaves of `tree`, and for each leaf node its first slot (0 for the others).
    pub fn new(tree: TreeView, triangles: &[Triangle], masks: &Masks) -> (Blocks, Vec<u32>) {
        let mut slots = vec![0; tree.nodes.len()];
        let mut end = 0usize;
        for (slot, node) in slots.iter_mut().zip(tree.nodes).filter(|(_, node)| node.is_leaf()) {
            if (end % LANES + node.len()).div_ceil(LANES) > node.len().div_ceil(LANES) {
                end = end.next_multiple_of(LANES);
            }
            *slot = end as u32;
            end += node.len();
        }
        let empty = Block { vertices: [[[0.0; LANES]; 3]; 3], index: [0; LANES], mask: [0; LANES] };
        let mut blocks = memory::with_capacity(end.div_ceil(LANES));
        blocks.resize(end.div_ceil(LANES), empty);
        let mut instance_masks = vec![u32::MAX; if masks.any_two() { end } else { 0 }];
        for (slot, node) in slots.iter().zip(tree.nodes).filter(|(_, node)| node.is_leaf()) {
            for (place, &index) in (*slot as usize..).zip(&tree.primitives[node.range()]) {
                let (block, lane) = (&mut blocks[place / LANES], place % LANES);
                for (rows, vertex) in block.vertices.iter_mut().zip(triangles[index as usize].0) {
                    (0..3).for_each(|axis| rows[axis][lane] = vertex[axis]);
                }
                let [mask, instance_mask] = masks.of(index);
                (block.index[lane], block.mask[lane]) = (index, mask);
                if let Some(of_slot) = instance_masks.get_mut(place) {
                    *of_slot = instance_mask;
                }
            }
        }
        (Blocks { blocks, instance_masks }, slots)
    }

    /// The triangle in a slot of some leaf.
    #[inline(always)]
    pub fn triangle(&self, slot: usize) -> PreparedTriangle {
        let (block, lane) = (&self.blocks[slot / LANES], slot % LANES);
        let vertex = |rows: &[[f32; LANES]; 3]| Vec3::new(rows[0][lane], rows[1][lane], rows[2][lane]);
        let [v0, v1, v2] = &block.vertices;
        PreparedTriangle {
            vertices: Triangle([vertex(v0), vertex(v1), vertex(v2)]),
            index: block.index[lane],
            mask: block.mask[lane],
            instance_mask: self.instance_masks.get(slot).copied().unwrap_or(u32::MAX),
        }
    }

    /// The triangles in `slots`.
    #[inline(always)]
    pub fn triangles(
        &self,
        slots: std::ops::Range<usize>,
    ) -> impl ExactSizeIterator<Item = PreparedTriangle> {
        slots.map(|slot| self.triangle(slot))
    }

    /// Of the lanes of `block` that `lanes` names: which the ray hits within its interval, as bits, and at which t. `bound` is the
    /// interval's end, or less: hits behind it may be left out.
    #[inline(always)]
    pub fn hits<M: Machine>(
        &self,
        block: usize,
        lanes: u32,
        ray: &PreparedRay,
        block_ray: &BlockRay,
        bound: f32,
    ) -> (u32, [f32; LANES]) {
        let block = &self.blocks[block];
        let (mask, t, den) = block.test::<M>(block_ray, bound);
        if mask & lanes == 0 {
            return (0, [0.0; LANES]);
        }
        let (confirmed, t) = block.confirm(ray, t.div(den));
        (mask & lanes & confirmed, t.to_array())
    }

    /// Where the block of a slot begins in memory.
    #[inline(always)]
    pub fn address(&self, slot: usize) -> *const u8 {
        self.blocks.as_ptr().wrapping_add(slot / LANES).cast()
    }
}

#[cfg(test)]
mod tests {
    use super::super::simd::Any;
    use super::*;
    use crate::geometry::Ray;
    use crate::random::Random;
    use crate::tree::{Node, Tree};

    /// One triangle a leaf, then leaves of 2, 3, 5, 4, 8 and so on.
    fn tree(triangles: usize) -> Tree {
        let mut tree = Tree { nodes: Vec::new(), primitives: (0..triangles as u32).rev().collect() };
        let mut first = 0;
        for size in [1, 1, 1, 2, 3, 5, 4, 8, 7, 1, 2].into_iter().cycle() {
            let size = triangles.min(first + size) - first;
            if size == 0 {
                return tree;
            }
            let bounds = Triangle([Vec3::ZERO; 3]).bounds();
            tree.nodes.push(Node::leaf(bounds, first as u32, size as u32));
            first += size;
        }
        tree
    }

    #[test]
    fn lanes_have_the_bits_of_the_plain_test() {
        let random = &mut Random::new(5);
        let mut vector = |scale: f64| Vec3::from_array([0; 3].map(|_| (scale * random.signed()) as f32));
        let mut triangles: Vec<Triangle> =
            (0..200).map(|_| Triangle([vector(1.0), vector(1.0), vector(1.0)])).collect();
        // Degenerate ones too: a point, a line, huge and tiny.
        triangles.push(Triangle([Vec3::ONE; 3]));
        triangles.push(Triangle([Vec3::ZERO, Vec3::X, 2.0 * Vec3::X]));
        triangles.push(Triangle([vector(1e30), vector(1e30), vector(1e30)]));
        triangles.push(Triangle([vector(1e-30), vector(1e-30), vector(1e-30)]));
        let tree = tree(triangles.len());
        let (blocks, slots) = Blocks::new(tree.view(), &triangles, &Masks::new(&[]));
        let mut hits = 0;
        for number in 0..300 {
            let origin = vector(2.0);
            let ray = Ray {
                origin,
                tnear: [0.0, -1.0, 0.5][number % 3],
                direction: (vector(0.5) - origin) * [1.0, 1e-20, 0.0][(number % 30) / 14],
                tfar: [f32::INFINITY, 1.5][number % 2],
            };
            let ray = PreparedRay::new(&ray);
            let block_ray = BlockRay::new(&ray);
            for (node, &slot) in tree.nodes.iter().zip(&slots) {
                let begins = slot as usize;
                let needed = (begins % LANES + node.len()).div_ceil(LANES);
                assert_eq!(needed, node.len().div_ceil(LANES), "a leaf lies in no more blocks than it must");
                for (slot, &index) in (begins..).zip(&tree.primitives[node.range()]) {
                    let triangle = blocks.triangle(slot);
                    assert_eq!(triangle.index, index);
                    let (mask, t) =
                        blocks.hits::<Any>(slot / LANES, 1 << (slot % LANES), &ray, &block_ray, ray.tfar);
                    let t = (mask != 0).then(|| t[slot % LANES]);
                    let expected = triangle.intersect(&ray);
                    assert_eq!(t.map(f32::to_bits), expected.map(f32::to_bits), "{triangle:?} {ray:?}");
                    hits += u32::from(t.is_some());
                }
            }
        }
        assert!(hits > 500, "{hits} hits are too few to mean anything");
    }
}
