//! The triangles of a tree in blocks of four, tested together.
//!
//! A leaf's triangles lie side by side in slots, four slots to a block. Small leaves share a block, so that trees with one
//! triangle a leaf waste no memory, but no leaf lies in more blocks than it must: one of up to four costs one test.
//! A test answers for the lanes of one leaf; the bits are those of [`PreparedTriangle::intersect`], lane by lane.

use super::masks::Masks;
use super::ray::PreparedRay;
use super::simd::{F32x4, Machine};
use super::triangle::{PreparedTriangle, cross, edges};
use crate::geometry::{Triangle, Vec3};
use crate::tree::TreeView;

/// Triangles in a block.
pub(super) const LANES: usize = 4;

/// What the test needs of four triangles, by axis and lane: three cache lines. Empty lanes are zero, and hit by nothing.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Block {
    vertex: [[f32; LANES]; 3],
    /// First vertex minus second.
    edge1: [[f32; LANES]; 3],
    /// Third vertex minus first.
    edge2: [[f32; LANES]; 3],
    normal: [[f32; LANES]; 3],
}

/// All triangles of a tree, in leaf order.
#[derive(Debug)]
pub struct Blocks {
    blocks: Vec<Block>,
    /// By slot.
    triangles: Vec<PreparedTriangle>,
}

/// A ray as blocks are tested against it.
#[derive(Clone, Copy, Debug)]
pub struct BlockRay {
    origin: [F32x4; 3],
    direction: [F32x4; 3],
    tnear: F32x4,
    tfar: F32x4,
}

impl BlockRay {
    #[inline(always)]
    pub fn new(ray: &PreparedRay) -> BlockRay {
        BlockRay {
            origin: std::array::from_fn(|axis| F32x4::splat(ray.origin[axis])),
            direction: std::array::from_fn(|axis| F32x4::splat(ray.direction[axis])),
            tnear: F32x4::splat(ray.tnear),
            tfar: F32x4::splat(ray.tfar),
        }
    }
}

#[inline(always)]
fn dot<M: Machine>(a: [F32x4; 3], b: [F32x4; 3]) -> F32x4 {
    M::mul_add(a[0], b[0], M::mul_add(a[1], b[1], a[2].mul(b[2])))
}

impl Block {
    #[inline(always)]
    fn test<M: Machine>(&self, ray: &BlockRay) -> (u32, F32x4) {
        let zero = F32x4::splat(0.0);
        let minus = F32x4::splat(-0.0);
        let [edge1, edge2, normal] = [self.edge1, self.edge2, self.normal].map(|rows| rows.map(F32x4::new));
        let c: [F32x4; 3] = std::array::from_fn(|axis| F32x4::new(self.vertex[axis]).sub(ray.origin[axis]));
        let d = ray.direction;
        let minor = |a1: F32x4, b2, a2: F32x4, b1| M::mul_add(a1, b2, a2.mul(b1).flip(minus));
        let r = [minor(c[1], d[2], c[2], d[1]), minor(c[2], d[0], c[0], d[2]), minor(c[0], d[1], c[1], d[0])];
        let den = dot::<M>(normal, d);
        let sign = den.signs();
        let den_abs = den.flip(sign);
        let u = dot::<M>(r, edge2).flip(sign);
        let v = dot::<M>(r, edge1).flip(sign);
        let t = dot::<M>(normal, c).flip(sign);
        // A denominator of zero fails one of the last two.
        let inside = zero.le(u).and(zero.le(v)).and(u.add(v).le(den_abs));
        let within = den_abs.mul(ray.tnear).lt(t).and(t.le(den_abs.mul(ray.tfar)));
        let mask = inside.and(within).bits();
        (mask, if mask == 0 { zero } else { t.div(den_abs) })
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
        let empty = Block {
            vertex: [[0.0; LANES]; 3],
            edge1: [[0.0; LANES]; 3],
            edge2: [[0.0; LANES]; 3],
            normal: [[0.0; LANES]; 3],
        };
        let nothing = PreparedTriangle { vertices: Triangle([Vec3::ZERO; 3]), index: 0, mask: 0 };
        let mut made = Blocks { blocks: vec![empty; end.div_ceil(LANES)], triangles: vec![nothing; end] };
        for (slot, node) in slots.iter().zip(tree.nodes).filter(|(_, node)| node.is_leaf()) {
            for (place, &index) in (*slot as usize..).zip(&tree.primitives[node.range()]) {
                made.put(
                    place,
                    PreparedTriangle { vertices: triangles[index as usize], index, mask: masks.of(index) },
                );
            }
        }
        (made, slots)
    }

    fn put(&mut self, slot: usize, triangle: PreparedTriangle) {
        let block = &mut self.blocks[slot / LANES];
        let (edge1, edge2) = edges(&triangle.vertices);
        let rows = [triangle.vertices.0[0], edge1, edge2, cross(edge2, edge1)];
        for (to, from) in
            [&mut block.vertex, &mut block.edge1, &mut block.edge2, &mut block.normal].into_iter().zip(rows)
        {
            for axis in 0..3 {
                to[axis][slot % LANES] = from[axis];
            }
        }
        self.triangles[slot] = triangle;
    }

    /// The triangle in a slot of some leaf.
    #[inline(always)]
    pub fn triangle(&self, slot: usize) -> &PreparedTriangle {
        &self.triangles[slot]
    }

    /// The triangles in `slots`.
    #[inline(always)]
    pub fn triangles(&self, slots: std::ops::Range<usize>) -> &[PreparedTriangle] {
        &self.triangles[slots]
    }

    /// Of the lanes of `block` that `lanes` names: which the ray hits within its interval, as bits, and at which t; both
    /// before the triangle's own box has been asked.
    #[inline(always)]
    pub fn test<M: Machine>(&self, block: usize, lanes: u32, ray: &BlockRay) -> (u32, [f32; LANES]) {
        let (mask, t) = self.blocks[block].test::<M>(ray);
        (mask & lanes, t.to_array())
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
                    let (mask, t) = blocks.test::<Any>(slot / LANES, 1 << (slot % LANES), &block_ray);
                    let t = (mask != 0).then(|| t[slot % LANES]).and_then(|t| triangle.confirm(&ray, t));
                    let expected = triangle.intersect(&ray);
                    assert_eq!(t.map(f32::to_bits), expected.map(f32::to_bits), "{triangle:?} {ray:?}");
                    hits += u32::from(t.is_some());
                }
            }
        }
        assert!(hits > 500, "{hits} hits are too few to mean anything");
    }
}
