//! The checks after which code may follow any index of a tree: made before a file is written, and when it is read.

use super::{Geometry, geometry_kind};
use crate::tree::TreeView;
use crate::tree::statistics::Statistics;
use std::ops::Range;

/// A rule that does not hold: which element of which section, what was found, what was expected.
#[derive(Debug)]
pub(super) struct Violation {
    pub tag: [u8; 4],
    pub index: usize,
    pub name: &'static str,
    pub found: String,
    pub expected: String,
}

fn violation<T>(
    tag: &[u8; 4],
    index: usize,
    name: &'static str,
    found: impl ToString,
    expected: impl ToString,
) -> Result<T, Violation> {
    Err(Violation { tag: *tag, index, name, found: found.to_string(), expected: expected.to_string() })
}

/// Checks every index and count of a tree over `triangles` triangles, and returns what it looks like.
pub(super) fn check(
    tree: TreeView,
    triangles: usize,
    geometries: &[Geometry],
    order: Option<&[u8]>,
) -> Result<Statistics, Violation> {
    check_nodes(tree)?;
    check_primitives(tree, triangles)?;
    check_geometries(geometries, triangles)?;
    if let Some(order) = order {
        if order.len() != tree.nodes.len() {
            return violation(
                b"ORDR",
                0,
                "number of elements",
                order.len(),
                format!("{}, one per node", tree.nodes.len()),
            );
        }
        if let Some(index) = order.iter().position(|&value| value > 3) {
            return violation(b"ORDR", index, "traversal order", order[index], "0 to 3");
        }
    }
    Ok(Statistics::of(tree))
}

/// Every node but the root has one parent, which stands before it: there is no cycle, and nothing is reached twice.
fn check_nodes(tree: TreeView) -> Result<(), Violation> {
    let nodes = tree.nodes;
    if nodes.is_empty() {
        return violation(b"NODE", 0, "number of elements", 0, "at least the root");
    }
    if nodes.len() > u32::MAX as usize || tree.primitives.len() > u32::MAX as usize {
        return violation(b"NODE", 0, "number of elements", nodes.len(), "less than 2^32");
    }
    let mut has_parent = Marks::new(nodes.len());
    for (index, node) in nodes.iter().enumerate() {
        if node.lower.is_nan() || node.upper.is_nan() {
            return violation(b"NODE", index, "box of a node", "NaN", "numbers");
        }
        if node.is_leaf() {
            continue;
        }
        let children = node.range();
        if children.is_empty() {
            return violation(b"NODE", index, "children of an inner node", 0, "at least 1");
        }
        if children.start <= index {
            let expected = format!("greater than the node's own, {index}");
            return violation(b"NODE", index, "first child of a node", children.start, expected);
        }
        if children.end > nodes.len() {
            let expected = format!("within the {} nodes", nodes.len());
            return violation(b"NODE", index, "children of a node", text(&children), expected);
        }
        if !has_parent.mark(children.clone()) {
            return violation(
                b"NODE",
                index,
                "children of a node",
                text(&children),
                "nodes of no other parent",
            );
        }
    }
    match (1..nodes.len()).find(|&index| !has_parent.is_marked(index)) {
        Some(orphan) => violation(b"NODE", orphan, "parents of a node", 0, 1),
        None => Ok(()),
    }
}

/// Every entry of `PRIM` is a triangle and belongs to one leaf.
fn check_primitives(tree: TreeView, triangles: usize) -> Result<(), Violation> {
    let primitives = tree.primitives;
    if let Some(index) = primitives.iter().position(|&triangle| triangle as usize >= triangles) {
        let expected = format!("less than the {triangles} triangles");
        return violation(b"PRIM", index, "triangle of an entry", primitives[index], expected);
    }
    let mut in_leaf = Marks::new(primitives.len());
    for (index, node) in tree.nodes.iter().enumerate().filter(|(_, node)| node.is_leaf()) {
        let entries = node.range();
        if entries.end > primitives.len() {
            let expected = format!("within the {} entries of PRIM", primitives.len());
            return violation(b"NODE", index, "primitives of a leaf", text(&entries), expected);
        }
        if !in_leaf.mark(entries.clone()) {
            return violation(
                b"NODE",
                index,
                "primitives of a leaf",
                text(&entries),
                "entries of no other leaf",
            );
        }
    }
    match (0..primitives.len()).find(|&index| !in_leaf.is_marked(index)) {
        Some(orphan) => violation(b"PRIM", orphan, "leaves of an entry", 0, 1),
        None => Ok(()),
    }
}

/// Geometries stand in the order of their triangles and share none.
fn check_geometries(geometries: &[Geometry], triangles: usize) -> Result<(), Violation> {
    let mut end = 0;
    for (index, geometry) in geometries.iter().enumerate() {
        let first = geometry.first_triangle as usize;
        let range = first..first + geometry.triangle_count as usize;
        if first < end {
            return violation(
                b"GEOM",
                index,
                "first triangle of a geometry",
                first,
                format!("at least {end}"),
            );
        }
        if range.end > triangles {
            let expected = format!("within the {triangles} triangles");
            return violation(b"GEOM", index, "triangles of a geometry", text(&range), expected);
        }
        match geometry.kind {
            geometry_kind::TRIANGLES => {}
            geometry_kind::QUADS if range.len().is_multiple_of(2) => {}
            geometry_kind::QUADS => {
                return violation(b"GEOM", index, "triangles of quads", range.len(), "an even number");
            }
            other => {
                return violation(b"GEOM", index, "kind of a geometry", other, "0 (triangles) or 1 (quads)");
            }
        }
        end = range.end;
    }
    Ok(())
}

fn text(range: &Range<usize>) -> String {
    format!("{} to {}", range.start, range.end)
}

/// A bit per element.
struct Marks(Vec<u64>);

impl Marks {
    fn new(count: usize) -> Marks {
        Marks(vec![0; count.div_ceil(64)])
    }

    /// Marks a range; false when part of it was marked, at which it stops.
    /// All ranges together thus cost no more than there are elements.
    fn mark(&mut self, range: Range<usize>) -> bool {
        for index in range {
            let bit = 1 << (index % 64);
            if self.0[index / 64] & bit != 0 {
                return false;
            }
            self.0[index / 64] |= bit;
        }
        true
    }

    fn is_marked(&self, index: usize) -> bool {
        self.0[index / 64] & (1 << (index % 64)) != 0
    }
}
