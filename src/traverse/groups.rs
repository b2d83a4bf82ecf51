//! The form of all other trees: children in groups of four or eight, faces side by side, one vector operation for all boxes of a
//! group. A node with more children than a group holds has several.

use super::form::{Below, Children, Faces, Form, Link, Stack};
use super::memory;
use super::ray::PreparedRay;
use super::simd::{Lanes, Supports};
use crate::geometry::Vec3;
use crate::tree::TreeView;
use glam::Vec4;

/// `N` children: two cache lines for four, four for eight.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Group<const N: usize> {
    /// Per axis: lower faces, upper faces, a lane per child. Lanes without a child have the faces of a box that no ray meets.
    pub faces: [[[f32; N]; 2]; 3],
    /// The first of an inner child is the index of its first group.
    pub below: [Below; N],
}

/// All groups of a tree, and where each inner node's are.
#[derive(Debug)]
pub struct Groups<const N: usize> {
    groups: Vec<Group<N>>,
    /// Node in the file of the first child of each group.
    child: Vec<u32>,
    root: Below,
    is_one_a_node: bool,
    extent: Vec4,
}

impl<const N: usize> Groups<N> {
    /// `slots` are where the triangles of each leaf begin.
    pub fn new(tree: TreeView, slots: &[u32]) -> Groups<N> {
        let mut total = 0u32;
        let below = tree.nodes.iter().zip(slots).map(|(node, slot)| {
            let mut first = *slot;
            if !node.is_leaf() {
                first = total;
                total += node.len().div_ceil(N) as u32;
            }
            Below { first, count: node.count }
        });
        let below: Vec<Below> = below.collect();
        let mut groups = memory::with_capacity(total as usize);
        let mut child = memory::with_capacity(total as usize);
        for node in tree.nodes.iter().filter(|node| !node.is_leaf()) {
            for first in node.range().step_by(N) {
                let children = first..node.range().end.min(first + N);
                let nowhere = [[f32::INFINITY; N], [f32::NEG_INFINITY; N]];
                let mut group = Group { faces: [nowhere; 3], below: [Below::NOTHING; N] };
                for (lane, index) in children.enumerate() {
                    let bounds = tree.nodes[index].bounds();
                    for axis in 0..3 {
                        group.faces[axis][0][lane] = bounds.lower[axis];
                        group.faces[axis][1][lane] = bounds.upper[axis];
                    }
                    group.below[lane] = below[index];
                }
                groups.push(group);
                child.push(first as u32);
            }
        }
        let is_one_a_node = tree.nodes.iter().all(|node| node.is_leaf() || node.len() <= N);
        let mut extent = Vec3::ZERO;
        for node in tree.nodes {
            extent = extent.max(node.bounds().lower.abs()).max(node.bounds().upper.abs());
        }
        Groups { groups, child, root: below[0], is_one_a_node, extent: extent.extend(0.0) }
    }

    /// Whether no node has more children than a group holds.
    #[inline(always)]
    pub(super) fn is_one_a_node(&self) -> bool {
        self.is_one_a_node
    }

    /// The greatest face on each axis, whatever its sign, and 0.
    #[inline(always)]
    pub(super) fn extent(&self) -> Vec4 {
        self.extent
    }

    /// All groups; what is below an inner node says which is whose.
    #[inline(always)]
    pub(super) fn all(&self) -> &[Group<N>] {
        &self.groups
    }

    /// What is below the root.
    pub(super) fn root(&self) -> Below {
        self.root
    }
}

/// A ray as groups are tested against it.
#[derive(Clone, Copy, Debug)]
pub struct GroupRay<V> {
    origin: [V; 3],
    near_inverse: [V; 3],
    far_inverse: [V; 3],
    near_face: [usize; 3],
    tnear: V,
}

impl<const N: usize> Group<N> {
    /// The first `children` lanes that the ray overlaps within [tnear, `tfar`], as bits, and where each is entered.
    #[inline(always)]
    fn test<V: Lanes<N>>(&self, children: usize, ray: &GroupRay<V>, tfar: f32) -> (u32, V) {
        let mut entry = ray.tnear;
        let mut exit = V::splat(tfar);
        for axis in 0..3 {
            let near = ray.near_face[axis] & 1;
            let (origin, faces) = (ray.origin[axis], &self.faces[axis]);
            entry = V::load(&faces[near]).sub(origin).mul(ray.near_inverse[axis]).max_or(entry);
            exit = V::load(&faces[near ^ 1]).sub(origin).mul(ray.far_inverse[axis]).min_or(exit);
        }
        // Lanes without a child never count, whatever their faces say.
        let lanes = (1u32 << children.min(N)) - 1;
        (entry.le_mask(exit) & lanes, entry)
    }

    /// As [`Self::test`], the lanes that the ray starts in apart from those that it enters later; without `APART`, all of them the latter.
    #[inline(always)]
    fn sides<const APART: bool, V: Lanes<N>>(
        &self,
        children: usize,
        ray: &GroupRay<V>,
        tfar: f32,
    ) -> (u32, u32) {
        let (mask, entry) = self.test(children, ray, tfar);
        let inside = if APART { mask & entry.le_mask(ray.tnear) } else { 0 };
        (inside, mask & !inside)
    }

    /// Pushes what is below the lanes in `mask`, the lowest on top.
    #[inline(always)]
    pub(super) fn push(&self, mut mask: u32, stack: &mut [Below], mut top: usize) -> usize {
        while mask != 0 {
            let lane = mask.ilog2() as usize % N;
            mask &= !(1 << lane);
            stack[top] = self.below[lane];
            top += 1;
        }
        top
    }
}

/// Takes the lowest of the lanes in `mask`.
#[inline(always)]
fn next_lane<const N: usize>(mask: &mut u32) -> usize {
    let lane = mask.trailing_zeros() as usize % N;
    *mask &= *mask - 1;
    lane
}

impl<M: Supports<N>, const N: usize> Form<M> for Groups<N> {
    type Ray = GroupRay<M::Vector>;

    #[inline(always)]
    fn ray(ray: &PreparedRay) -> GroupRay<M::Vector> {
        GroupRay {
            origin: std::array::from_fn(|axis| M::Vector::splat(ray.origin[axis])),
            near_inverse: std::array::from_fn(|axis| M::Vector::splat(ray.near_inverse[axis])),
            far_inverse: std::array::from_fn(|axis| M::Vector::splat(ray.far_inverse[axis])),
            near_face: ray.downwards(),
            tnear: M::Vector::splat(ray.tnear),
        }
    }

    #[inline(always)]
    fn address(&self, parent: &Link) -> *const u8 {
        self.groups.as_ptr().wrapping_add(parent.first as usize).cast()
    }

    #[inline(always)]
    fn each(&self, parent: &Link, ray: &GroupRay<M::Vector>, tfar: f32, mut found: impl FnMut(Link)) {
        let groups = parent.first as usize..;
        for (index, children) in groups.zip((1..=parent.count as usize).rev().step_by(N)) {
            let group = &self.groups[index];
            let (mut mask, entry) = group.test(children, ray, tfar);
            let entries = entry.to_array();
            while mask != 0 {
                let lane = next_lane::<N>(&mut mask);
                found(Link::to(self.child[index] + lane as u32, group.below[lane], entries[lane]));
            }
        }
    }

    #[inline(always)]
    fn nearest(
        &self,
        parent: &Link,
        ray: &GroupRay<M::Vector>,
        tfar: f32,
        found: impl Fn(&Link),
        stack: &mut Stack,
    ) -> Option<Link> {
        let (index, children) = (parent.first as usize, parent.count as usize);
        if children > N {
            let before = stack.len();
            <Self as Form<M>>::each(self, parent, ray, tfar, |link| {
                found(&link);
                stack.insert(before, link);
            });
            return if stack.len() > before { stack.pop() } else { None };
        }
        let group = &self.groups[index];
        let (mut mask, entry) = group.test(children, ray, tfar);
        if mask == 0 {
            return None;
        }
        let (entries, child) = (entry.to_array(), self.child[index]);
        let link = |lane: usize| {
            let link = Link::to(child + lane as u32, group.below[lane], entries[lane]);
            found(&link);
            link
        };
        let first = link(next_lane::<N>(&mut mask));
        if mask == 0 {
            return Some(first);
        }
        let second = link(next_lane::<N>(&mut mask));
        let (mut nearest, mut farther) =
            if second.entry < first.entry { (second, first) } else { (first, second) };
        let before = stack.len();
        stack.push(farther);
        // Few have more than two: insertion keeps the farthest at the bottom, of equals the last child.
        while mask != 0 {
            farther = link(next_lane::<N>(&mut mask));
            if farther.entry < nearest.entry {
                std::mem::swap(&mut farther, &mut nearest);
                stack.push(farther);
            } else {
                stack.insert(before, farther);
            }
        }
        Some(nearest)
    }

    #[inline(always)]
    fn push_all<const OUTSIDE: bool>(
        &self,
        parent: &Link,
        ray: &GroupRay<M::Vector>,
        tfar: f32,
        stack: &mut [Below],
        mut top: usize,
    ) -> usize {
        let (start, count) = (parent.first as usize, parent.count as usize);
        if count <= N {
            let group = &self.groups[start];
            let (inside, outside) = group.sides::<OUTSIDE, _>(count, ray, tfar);
            top = group.push(inside, stack, top);
            return group.push(outside, stack, top);
        }
        // Few trees have such nodes: testing twice keeps the order without more room.
        for second in [false, true] {
            for index in (0..count.div_ceil(N)).rev() {
                let group = &self.groups[start + index];
                let (inside, outside) = group.sides::<OUTSIDE, _>(count - index * N, ray, tfar);
                top = group.push(if second { outside } else { inside }, stack, top);
            }
        }
        top
    }

    #[inline(always)]
    fn first(
        &self,
        parent: &Link,
        ray: &GroupRay<M::Vector>,
        tfar: f32,
        found: impl Fn(&Link),
        stack: &mut Stack,
    ) -> Option<Link> {
        let before = stack.len();
        let count = parent.count as usize;
        let groups = parent.first as usize..parent.first as usize + count.div_ceil(N);
        for (index, start) in groups.zip((0..count).step_by(N)).rev() {
            let group = &self.groups[index];
            let (mut mask, entry) = group.test(count - start, ray, tfar);
            let entries = entry.to_array();
            while mask != 0 {
                let lane = mask.ilog2() as usize % N;
                mask &= !(1 << lane);
                let link = Link::to(self.child[index] + lane as u32, group.below[lane], entries[lane]);
                found(&link);
                stack.push(link);
            }
        }
        if stack.len() > before { stack.pop() } else { None }
    }
}

impl<const N: usize> Children for Groups<N> {
    #[inline(always)]
    fn child(&self, parent: &Link, number: usize, near_face: &[usize; 3]) -> (Link, Faces) {
        let (index, lane) = (parent.first as usize + number / N, number % N);
        let group = &self.groups[index];
        let link = Link::to(self.child[index] + lane as u32, group.below[lane], f32::INFINITY);
        (link, Faces::new(|axis, side| group.faces[axis][side][lane], near_face))
    }
}
