//! The checks of a `.bvh` that look at every box and triangle.

use super::{Bvh, flag};
use crate::format::FormatError;
use crate::geometry::{Aabb, Vec3};

/// What [`Bvh::verify`] counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Verified {
    /// Triangles with a vertex that is not finite: no tree holds them.
    pub not_finite: usize,
    /// Entries of leaves beyond the first of each triangle: what spatial splits added.
    pub duplicates: usize,
}

impl Bvh<'_> {
    /// Checks that every box holds its children's boxes and its primitives, that every finite triangle is in a leaf (in exactly one
    /// without spatial splits), and that `META` is JSON.
    ///
    /// With spatial splits a leaf's box holds only a part of its triangle. Then the box has to meet the triangle's own box,
    /// and the boxes of all its leaves together have to reach as far as the triangle in each axis.
    ///
    /// # Errors
    /// At the first node or triangle for which that does not hold.
    pub fn verify(&self) -> Result<Verified, FormatError> {
        self.check_meta()?;
        self.check_children()?;
        self.check_leaves()
    }

    fn check_meta(&self) -> Result<(), FormatError> {
        let Some(meta) = self.meta else { return Ok(()) };
        serde_json::from_str::<serde::de::IgnoredAny>(meta)
            .map(|_| ())
            .map_err(|error| FormatError::field(self.offset_in(b"META", 0), "section META", error, "JSON"))
    }

    fn check_children(&self) -> Result<(), FormatError> {
        for (index, node) in self.tree.nodes.iter().enumerate() {
            let bounds = node.bounds();
            // Empty on any axis holds nothing: only right where nothing is below.
            if bounds.is_empty() && !(node.is_leaf() && node.is_empty()) {
                return Err(self.node_error(
                    index,
                    "box of a node",
                    text(&bounds),
                    "lower not above upper".into(),
                ));
            }
            if node.is_leaf() {
                continue;
            }
            for child in node.range() {
                let inner = self.tree.nodes[child].bounds();
                if !inner.is_empty() && !bounds.contains(&inner) {
                    let expected = format!("inside its parent's {}", text(&bounds));
                    return Err(self.node_error(child, "box of a node", text(&inner), expected));
                }
            }
        }
        Ok(())
    }

    fn check_leaves(&self) -> Result<Verified, FormatError> {
        let clipped = self.header.flags & flag::SPATIAL_SPLITS != 0;
        let mut leaves = vec![0u32; self.triangles.len()];
        let mut covered = if clipped { vec![Aabb::EMPTY; self.triangles.len()] } else { Vec::new() };
        for (index, node) in self.tree.nodes.iter().enumerate().filter(|(_, node)| node.is_leaf()) {
            let bounds = node.bounds();
            for &primitive in &self.tree.primitives[node.range()] {
                let triangle = &self.triangles[primitive as usize];
                leaves[primitive as usize] += 1;
                if !triangle.is_finite() {
                    let found = format!("triangle {primitive}, which is not finite");
                    return Err(self.node_error(
                        index,
                        "content of a leaf",
                        found,
                        "finite triangles".into(),
                    ));
                }
                let inside = triangle.bounds();
                let holds = if clipped { overlap(&bounds, &inside) } else { bounds.contains(&inside) };
                if !holds {
                    let found = format!("{}, outside triangle {primitive}", text(&bounds));
                    let verb = if clipped { "a box that meets" } else { "a box that holds" };
                    return Err(self.node_error(
                        index,
                        "box of a leaf",
                        found,
                        format!("{verb} {}", text(&inside)),
                    ));
                }
                if clipped {
                    covered[primitive as usize] = covered[primitive as usize].union(&bounds);
                }
            }
        }

        let mut verified = Verified::default();
        for (index, triangle) in self.triangles.iter().enumerate() {
            let found = leaves[index];
            verified.duplicates += found.saturating_sub(1) as usize;
            if !triangle.is_finite() {
                verified.not_finite += 1;
                continue;
            }
            if found == 0 || (found > 1 && !clipped) {
                let expected = if clipped { "at least 1" } else { "1" };
                return Err(FormatError::field(
                    self.offset_in(b"TRIS", index),
                    format!("leaves of triangle {index}"),
                    found,
                    expected,
                ));
            }
            if clipped && !reaches(&covered[index], &triangle.bounds()) {
                return Err(FormatError::field(
                    self.offset_in(b"TRIS", index),
                    format!("boxes of the leaves of triangle {index}"),
                    text(&covered[index]),
                    format!("at least {}", text(&triangle.bounds())),
                ));
            }
        }
        Ok(verified)
    }

    fn node_error(&self, index: usize, name: &str, found: String, expected: String) -> FormatError {
        FormatError::field(self.offset_in(b"NODE", index), format!("NODE {index}: {name}"), found, expected)
    }

    fn offset_in(&self, tag: &[u8; 4], index: usize) -> u64 {
        let section = self.sections.iter().find(|section| section.tag == *tag);
        section.map_or(0, |section| section.offset + index as u64 * u64::from(section.element_bytes))
    }
}

fn overlap(a: &Aabb, b: &Aabb) -> bool {
    a.lower.cmple(b.upper).all() && b.lower.cmple(a.upper).all()
}

/// Whether `outer` reaches as far as `inner`, up to the rounding of a clipped vertex: a few units in the last place of the
/// largest coordinate.
fn reaches(outer: &Aabb, inner: &Aabb) -> bool {
    let slack = 8.0 * f32::EPSILON * inner.lower.abs().max(inner.upper.abs()).max_element();
    let grown = Aabb { lower: outer.lower - Vec3::splat(slack), upper: outer.upper + Vec3::splat(slack) };
    grown.contains(inner)
}

fn text(bounds: &Aabb) -> String {
    format!("{} to {}", bounds.lower, bounds.upper)
}
