//! The triangles of one leaf against one ray: the part that every traversal shares.

use super::Hit;
use super::candidates::Candidates;
use super::form::Link;
use super::observer::Observer;
use super::ray::PreparedRay;
use super::triangle::PreparedTriangle;
use crate::format::rays::NO_TRIANGLE;

/// The best hit so far, or the end of the ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct Best {
    pub t: f32,
    pub triangle: u32,
}

impl Best {
    #[inline(always)]
    pub fn end_of(ray: &PreparedRay) -> Best {
        Best { t: ray.tfar, triangle: NO_TRIANGLE }
    }

    #[inline(always)]
    pub fn hit(self) -> Option<Hit> {
        (self.triangle != NO_TRIANGLE).then_some(Hit { t: self.t, triangle: self.triangle })
    }
}

/// With spatial splits a leaf's box is smaller than its triangle's, and a hit on the cut may come out a rounding error
/// before the box. Within this relative distance it is moved to the box, so that hits are never before their leaf.
const SNAP: f32 = 1e-6;

/// Tests the triangles of `leaf`. True when the query is answered: with `ANY`, at the first hit.
///
/// Of equal hits the one with the lowest index wins, whatever the order in which they are found.
#[inline(always)]
pub(super) fn test<const ANY: bool>(
    leaf: &Link,
    triangles: &[PreparedTriangle],
    ray: &PreparedRay,
    candidates: &impl Candidates,
    observer: &mut impl Observer,
    best: &mut Best,
) -> bool {
    observer.leaf(leaf);
    for triangle in &triangles[leaf.triangles()] {
        observer.primitive(triangle);
        let Some(mut t) = triangle.intersect(ray) else { continue };
        if t < leaf.entry && t >= leaf.entry * (1.0 - SNAP) {
            t = leaf.entry;
        }
        let better = t < best.t || (t == best.t && triangle.index < best.triangle);
        if better && candidates.accepts(triangle) {
            *best = Best { t, triangle: triangle.index };
            if ANY {
                return true;
            }
        }
    }
    false
}
