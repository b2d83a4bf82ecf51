//! The form of all other trees: children in groups of four, faces side by side, one vector operation for four boxes.
//!
//! A node of up to 4 children has one group, one of 8 has two. Two cache lines a group.

use super::form::{Form, Link, Stack};
use super::ray::PreparedRay;
use super::simd::F32x4;
use crate::tree::TreeView;

const LANES: usize = 4;

#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Group {
    /// Per axis: lower faces, upper faces, a lane per child.
    faces: [[[f32; LANES]; 2]; 3],
    /// [`Link::first`] of each child; of an inner child, the index of its first group.
    first: [u32; LANES],
    /// [`Link::count`] of each child.
    count: [u32; LANES],
}

/// All groups of a tree, and where each inner node's are.
#[derive(Debug)]
pub struct Groups {
    groups: Vec<Group>,
    /// Node in the file of the first child of each group.
    child: Vec<u32>,
    root_first: u32,
}

impl Groups {
    pub fn new(tree: TreeView) -> Groups {
        // Where each inner node's groups will start; leaves keep their first triangle.
        let mut total = 0u32;
        let start: Vec<u32> = tree
            .nodes
            .iter()
            .map(|node| {
                if node.is_leaf() {
                    return node.first;
                }
                let first = total;
                total += node.len().div_ceil(LANES) as u32;
                first
            })
            .collect();
        let mut groups = Vec::with_capacity(total as usize);
        let mut child = Vec::with_capacity(total as usize);
        for node in tree.nodes.iter().filter(|node| !node.is_leaf()) {
            for first in node.range().step_by(LANES) {
                let children = first..node.range().end.min(first + LANES);
                let mut group = Group { faces: [[[0.0; LANES]; 2]; 3], first: [0; LANES], count: [0; LANES] };
                for (lane, index) in children.enumerate() {
                    let bounds = tree.nodes[index].bounds();
                    for axis in 0..3 {
                        group.faces[axis][0][lane] = bounds.lower[axis];
                        group.faces[axis][1][lane] = bounds.upper[axis];
                    }
                    group.first[lane] = start[index];
                    group.count[lane] = tree.nodes[index].count;
                }
                groups.push(group);
                child.push(first as u32);
            }
        }
        Groups { groups, child, root_first: start[0] }
    }

    /// The root as a link, entered at `entry`.
    pub fn root(&self, tree: TreeView, entry: f32) -> Link {
        Link { entry, node: 0, first: self.root_first, count: tree.nodes[0].count }
    }
}

/// A ray as groups are tested against it.
#[derive(Clone, Copy, Debug)]
pub struct GroupRay {
    origin: [F32x4; 3],
    near_inverse: [F32x4; 3],
    far_inverse: [F32x4; 3],
    near_face: [usize; 3],
    tnear: f32,
}

impl Form for Groups {
    type Ray = GroupRay;

    #[inline(always)]
    fn ray(ray: &PreparedRay) -> GroupRay {
        GroupRay {
            origin: std::array::from_fn(|axis| F32x4::splat(ray.origin[axis])),
            near_inverse: std::array::from_fn(|axis| F32x4::splat(ray.near_inverse[axis])),
            far_inverse: std::array::from_fn(|axis| F32x4::splat(ray.far_inverse[axis])),
            near_face: ray.downwards,
            tnear: ray.tnear,
        }
    }

    #[inline(always)]
    fn each(&self, parent: &Link, ray: &GroupRay, tfar: f32, mut found: impl FnMut(Link)) {
        let children = parent.count as usize;
        for (offset, taken) in (0..children).step_by(LANES).enumerate() {
            let index = parent.first as usize + offset;
            let group = &self.groups[index];
            let mut entry = F32x4::splat(ray.tnear);
            let mut exit = F32x4::splat(tfar);
            for axis in 0..3 {
                let near = ray.near_face[axis] & 1;
                let origin = ray.origin[axis];
                let faces = &group.faces[axis];
                entry = F32x4::new(faces[near]).sub(origin).mul(ray.near_inverse[axis]).max_or(entry);
                exit = F32x4::new(faces[near ^ 1]).sub(origin).mul(ray.far_inverse[axis]).min_or(exit);
            }
            // Lanes without a child never count, whatever their faces say.
            let lanes = (1u32 << (children - taken).min(LANES)) - 1;
            let mut mask = entry.le_mask(exit) & lanes;
            let entries = entry.to_array();
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize & (LANES - 1);
                mask &= mask - 1;
                found(Link {
                    entry: entries[lane],
                    node: self.child[index] + lane as u32,
                    first: group.first[lane],
                    count: group.count[lane],
                });
            }
        }
    }

    #[inline(always)]
    fn nearest(&self, parent: &Link, ray: &GroupRay, tfar: f32, stack: &mut Stack) -> Option<Link> {
        let before = stack.len();
        self.each(parent, ray, tfar, |link| stack.push(link));
        // Few are overlapped, mostly one or two: insertion, farthest at the bottom, of equals the last child.
        let pushed = stack.above(before);
        for end in 1..pushed.len() {
            let mut place = end;
            while place > 0 && pushed[place - 1].entry <= pushed[place].entry {
                pushed.swap(place - 1, place);
                place -= 1;
            }
        }
        if stack.len() > before { stack.pop() } else { None }
    }
}
