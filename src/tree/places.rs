//! Which triangles are below which nodes: entries of the leaves numbered depth first, so that those below a node are an interval.
//!
//! A tree's own `primitives` are in leaf order, but need not be in that order of leaves: Embree's trees and collapsed ones are not.

use super::TreeView;
use std::ops::Range;

/// The places of a tree's triangles. A triangle has a place in every leaf that holds it.
///
/// Takes 8 bytes a node, 8 an entry of `primitives`, and 4 a triangle.
#[derive(Clone, Debug)]
pub struct Places {
    /// Of each node, the places below.
    ranges: Vec<Range<u32>>,
    /// The triangle at each place.
    triangles: Vec<u32>,
    /// Places of each triangle, ascending; those of triangle i from `starts[i]` to `starts[i + 1]`.
    holding: Vec<u32>,
    starts: Vec<u32>,
}

impl Places {
    /// Of a tree over `triangles` triangles, whose indices have been checked.
    pub fn of(tree: TreeView, triangles: usize) -> Places {
        // Children stand behind their parents: sums go from the back, places from the front.
        let mut ranges = vec![0..0; tree.nodes.len()];
        for (number, node) in tree.nodes.iter().enumerate().rev() {
            let below = if node.is_leaf() {
                node.len() as u32
            } else {
                node.range().map(|child| ranges[child].end).sum()
            };
            ranges[number].end = below;
        }
        let mut order = vec![0; ranges.first().map_or(0, |root| root.end as usize)];
        for (number, node) in tree.nodes.iter().enumerate() {
            let Range { start, end } = ranges[number];
            if node.is_leaf() {
                order[start as usize..end as usize].copy_from_slice(&tree.primitives[node.range()]);
                continue;
            }
            let mut next = start;
            for child in node.range() {
                ranges[child] = next..next + ranges[child].end;
                next = ranges[child].end;
            }
        }
        let mut starts = vec![0u32; triangles + 1];
        for &triangle in &order {
            starts[triangle as usize + 1] += 1;
        }
        for index in 0..triangles {
            starts[index + 1] += starts[index];
        }
        let mut holding = vec![0; order.len()];
        let mut next = starts.clone();
        for (place, &triangle) in order.iter().enumerate() {
            holding[next[triangle as usize] as usize] = place as u32;
            next[triangle as usize] += 1;
        }
        Places { ranges, triangles: order, holding, starts }
    }

    /// The places below a node: an interval within its parent's, children in the order of the file.
    #[inline]
    pub fn below(&self, node: usize) -> Range<usize> {
        let Range { start, end } = self.ranges[node];
        start as usize..end as usize
    }

    /// The triangle at each place.
    #[inline]
    pub fn triangles(&self) -> &[u32] {
        &self.triangles
    }

    /// Triangles that the tree is over, those in no leaf included.
    pub fn triangle_count(&self) -> usize {
        self.starts.len() - 1
    }

    /// The places of a triangle, ascending; none of one that is in no leaf.
    #[inline]
    pub fn of_triangle(&self, triangle: u32) -> &[u32] {
        let index = triangle as usize;
        &self.holding[self.starts[index] as usize..self.starts[index + 1] as usize]
    }

    /// Whether a leaf below the node holds the triangle.
    #[inline]
    pub fn holds(&self, node: usize, triangle: u32) -> bool {
        let (own, below) = (self.of_triangle(triangle), &self.ranges[node]);
        own.get(own.partition_point(|place| place < &below.start)).is_some_and(|place| place < &below.end)
    }
}
