//! The form of binary trees: both children's boxes in one cache line, tested together in one vector register.

use super::form::{Below, Children, Faces, Form, Link, Stack};
use super::memory;
use super::ray::PreparedRay;
use super::simd::{F32x4, Machine};
use crate::tree::{LEAF_BIT, TreeView};

/// Both children of an inner node. The left one is node 2 × index + 1 of the file.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Pair {
    /// Per axis: lower faces, upper faces; each the bits of left (low half) and right.
    faces: [[u64; 2]; 3],
    /// Left, right; the first of an inner child is the index of its pair.
    below: [Below; 2],
}

/// All pairs of a tree in which every inner node has two children.
#[derive(Debug)]
pub struct Pairs {
    pairs: Vec<Pair>,
    root: Below,
}

impl Pairs {
    /// `slots` are where the triangles of each leaf begin. None when some inner node has not two children.
    ///
    /// Children are adjacent and every node but the root has one parent, so pairs tile the nodes from 1 on: the pair of
    /// nodes 2 i + 1 and 2 i + 2 is number i, in file order, and nothing has to be looked up.
    pub fn new(tree: TreeView, slots: &[u32]) -> Option<Pairs> {
        if tree.nodes.iter().any(|node| !node.is_leaf() && (node.len() != 2 || node.first % 2 == 0)) {
            return None;
        }
        let (children, rest) = tree.nodes.get(1..)?.as_chunks::<2>();
        if !rest.is_empty() {
            return None;
        }
        let pack = |left: f32, right: f32| u64::from(left.to_bits()) | u64::from(right.to_bits()) << 32;
        let below = |index: usize| {
            let node = &tree.nodes[index];
            Below { first: if node.is_leaf() { slots[index] } else { node.first / 2 }, count: node.count }
        };
        let pairs = children.iter().enumerate().map(|(index, [left, right])| Pair {
            faces: std::array::from_fn(|axis| {
                [pack(left.lower[axis], right.lower[axis]), pack(left.upper[axis], right.upper[axis])]
            }),
            below: [below(2 * index + 1), below(2 * index + 2)],
        });
        let mut list = memory::with_capacity(children.len());
        list.extend(pairs);
        let (pairs, root) = (list, below(0));
        Some(Pairs { pairs, root })
    }

    /// What is below the root.
    pub(super) fn root(&self) -> Below {
        self.root
    }

    /// The bits of which children are overlapped, and where each is entered.
    #[inline(always)]
    fn test(pair: &Pair, ray: &PairRay, tfar: f32) -> (u32, f32, f32) {
        // Lanes: left's near, right's near, left's -far, right's -far. With far distances negated, one maximum does both.
        let mut bound = F32x4::splat(ray.tnear).join(F32x4::splat(-tfar));
        for axis in 0..3 {
            let near = ray.near_face[axis] & 1;
            let faces = F32x4::from_halves(pair.faces[axis][near], pair.faces[axis][near ^ 1]);
            bound = faces.sub(ray.origin[axis]).mul(ray.inverse[axis]).max_or(bound);
        }
        let mask = bound.le_mask(bound.negated_high()) & 3;
        let [left, right, ..] = bound.to_array();
        (mask, left, right)
    }

    #[inline(always)]
    fn link(pair: &Pair, index: u32, side: usize, entry: f32) -> Link {
        Link::to(2 * index + 1 + side as u32, pair.below[side & 1], entry)
    }

    /// The child visited first, if any is overlapped; the other one goes onto the stack. `right_first` is asked with where the ray enters
    /// both. `found` is called with each as soon as it is known.
    #[inline(always)]
    fn entered(
        &self,
        parent: &Link,
        ray: &PairRay,
        tfar: f32,
        right_first: impl Fn(f32, f32) -> bool,
        found: impl Fn(&Link),
        stack: &mut Stack,
    ) -> Option<Link> {
        let pair = &self.pairs[parent.first as usize];
        let (mask, left, right) = Self::test(pair, ray, tfar);
        // With branches, not arithmetic: where they are predicted, the next pair is on its way before this one is decided.
        let link = |side: usize, entry: f32| {
            let link = Self::link(pair, parent.first, side, entry);
            found(&link);
            link
        };
        if mask & 1 == 0 {
            return if mask == 0 { None } else { Some(link(1, right)) };
        }
        if mask & 2 == 0 {
            return Some(link(0, left));
        }
        if right_first(left, right) {
            stack.push(link(0, left));
            Some(link(1, right))
        } else {
            stack.push(link(1, right));
            Some(link(0, left))
        }
    }
}

/// A ray as pairs are tested against it.
#[derive(Clone, Copy, Debug)]
pub struct PairRay {
    origin: [F32x4; 3],
    /// Lanes 0, 1: the near inverse; 2, 3: the far one, negated.
    inverse: [F32x4; 3],
    near_face: [usize; 3],
    tnear: f32,
}

impl<M: Machine> Form<M> for Pairs {
    type Ray = PairRay;

    #[inline(always)]
    fn ray(ray: &PreparedRay) -> PairRay {
        PairRay {
            origin: std::array::from_fn(|axis| F32x4::splat(ray.origin[axis])),
            inverse: std::array::from_fn(|axis| {
                F32x4::splat(ray.near_inverse[axis]).join(F32x4::splat(-ray.far_inverse[axis]))
            }),
            near_face: ray.downwards(),
            tnear: ray.tnear,
        }
    }

    #[inline(always)]
    fn address(&self, parent: &Link) -> *const u8 {
        self.pairs.as_ptr().wrapping_add(parent.first as usize).cast()
    }

    #[inline(always)]
    fn each(&self, parent: &Link, ray: &PairRay, tfar: f32, mut found: impl FnMut(Link)) {
        let pair = &self.pairs[parent.first as usize];
        let (mask, left, right) = Self::test(pair, ray, tfar);
        if mask & 1 != 0 {
            found(Self::link(pair, parent.first, 0, left));
        }
        if mask & 2 != 0 {
            found(Self::link(pair, parent.first, 1, right));
        }
    }

    #[inline(always)]
    fn nearest(
        &self,
        parent: &Link,
        ray: &PairRay,
        tfar: f32,
        found: impl Fn(&Link),
        stack: &mut Stack,
    ) -> Option<Link> {
        self.entered(parent, ray, tfar, |left, right| right < left, found, stack)
    }

    #[inline(always)]
    fn push_all<const OUTSIDE: bool>(
        &self,
        parent: &Link,
        ray: &PairRay,
        tfar: f32,
        stack: &mut [Below],
        mut top: usize,
    ) -> usize {
        let pair = &self.pairs[parent.first as usize];
        let (mask, left, right) = Self::test(pair, ray, tfar);
        let first = usize::from(OUTSIDE && left <= ray.tnear && right > ray.tnear);
        for side in [first ^ 1, first] {
            stack[top] = pair.below[side];
            top += (mask >> side & 1) as usize;
        }
        top
    }

    #[inline(always)]
    fn first(
        &self,
        parent: &Link,
        ray: &PairRay,
        tfar: f32,
        found: impl Fn(&Link),
        stack: &mut Stack,
    ) -> Option<Link> {
        self.entered(parent, ray, tfar, |_, _| false, found, stack)
    }
}

impl Children for Pairs {
    #[inline(always)]
    fn child(&self, parent: &Link, number: usize, near_face: &[usize; 3]) -> (Link, Faces) {
        let pair = &self.pairs[parent.first as usize];
        let face =
            |axis: usize, side: usize| f32::from_bits((pair.faces[axis][side] >> (32 * number)) as u32);
        (Self::link(pair, parent.first, number, f32::INFINITY), Faces::new(face, near_face))
    }
}

const _: () = assert!(size_of::<Pair>() == 64 && LEAF_BIT == 1 << 31);
