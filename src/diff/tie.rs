//! Whether two triangles are hit at one t, decided in double precision where the trees are known.

use super::query::Query;
use crate::format::bvh::{Bvh, flag as tree_flag};
use crate::format::rays::{Header, NO_TRIANGLE, flag};
use crate::geometry::{Ray, Triangle};
use std::cell::Cell;

/// Rounding errors, in units of 2⁻²⁴, that a single-precision test of a ray and a triangle may make in a value, relative to the
/// product of the lengths that it is computed from: about 9 operations (difference, cross product, dot product, sum), of each of two.
const ROUNDINGS: f64 = 18.0;

/// One rounding in single precision.
const UNIT: f64 = 1.0 / (1 << 24) as f64;

/// The trees of two recordings, as far as they are known.
#[derive(Clone, Copy, Debug, Default)]
pub struct Trees<'a> {
    pub a: Option<&'a Bvh<'a>>,
    pub b: Option<&'a Bvh<'a>>,
}

/// Why trees are not those of the recordings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TreesError {
    #[error(
        "the tree is of another scene than both recordings: its fingerprint is {found:016x}, expected {a:016x} or {b:016x}; \
         give the .bvh that was recorded with A or B"
    )]
    OtherScene { found: u64, a: u64, b: u64 },
    #[error("both trees are of the scene of {0}: give one for each recording")]
    Twice(&'static str),
    #[error(
        "{side} was not recorded with this tree: query {query} hit triangle {triangle}, and the tree has {triangles}; \
         give the .bvh that was recorded with {side}"
    )]
    NoTriangle { side: &'static str, query: u64, triangle: u32, triangles: u64 },
}

impl<'a> Trees<'a> {
    /// Finds out whose trees these are by their fingerprints: a recording of several scenes has none and takes what is left,
    /// and a single tree is both recordings' where their fingerprints allow it.
    ///
    /// # Errors
    /// When a tree is of neither, or two are of one.
    ///
    /// # Panics
    /// When there are more than two trees.
    pub fn assign(trees: &'a [Bvh<'a>], headers: &[Header; 2]) -> Result<Trees<'a>, TreesError> {
        assert!(trees.len() <= 2);
        let [a, b] = [headers[0].fingerprint, headers[1].fingerprint];
        let fits = |tree: &Bvh, known: u64| known == 0 || known == tree.header.fingerprint;
        for tree in trees {
            if !fits(tree, a) && !fits(tree, b) {
                return Err(TreesError::OtherScene { found: tree.header.fingerprint, a, b });
            }
        }
        match trees {
            [first, second] if fits(first, a) && fits(second, b) => {
                Ok(Trees { a: Some(first), b: Some(second) })
            }
            [first, second] if fits(first, b) && fits(second, a) => {
                Ok(Trees { a: Some(second), b: Some(first) })
            }
            [first, _] => Err(TreesError::Twice(if fits(first, a) { "A" } else { "B" })),
            _ => {
                let only = trees.first();
                Ok(Trees { a: only.filter(|tree| fits(tree, a)), b: only.filter(|tree| fits(tree, b)) })
            }
        }
    }

    pub fn is_empty(&self) -> bool {
        self.a.is_none() && self.b.is_none()
    }
}

/// Decides ties.
pub(super) struct Ties<'a> {
    trees: Trees<'a>,
    /// A hit of a triangle that its tree does not have.
    wrong: Cell<Option<TreesError>>,
}

impl<'a> Ties<'a> {
    pub(super) fn new(trees: Trees<'a>) -> Ties<'a> {
        Ties { trees, wrong: Cell::new(None) }
    }

    /// Whether the triangles that two answers name are hit at one t by every tree that is known. The recorded t are equal within the
    /// tolerance already, which is all that can be said without a tree, of scenes beyond the first, and of what moves.
    pub(super) fn are_at_one_t(&self, a: &Query, b: &Query) -> bool {
        let judged = |query: &Query| query.scene == 0 && query.record.flags & flag::UNDECIDED == 0;
        if !judged(a) || !judged(b) {
            return true;
        }
        let sides = [("A", self.trees.a, a, b), ("B", self.trees.b, b, a)];
        sides.into_iter().all(|(side, tree, own, other)| {
            tree.is_none_or(|tree| {
                let index = own.record.triangle;
                let Some(triangle) = tree.triangles.get(index as usize) else {
                    if index != NO_TRIANGLE {
                        let (query, triangles) = (own.number, tree.triangles.len() as u64);
                        let wrong = TreesError::NoTriangle { side, query, triangle: index, triangles };
                        self.wrong.set(Some(wrong));
                    }
                    return false;
                };
                // The scene of the other recording may have more triangles.
                let Some(second) = tree.triangles.get(other.record.triangle as usize) else { return false };
                let ray = own.record.ray();
                let flattened = tree.header.flags & tree_flag::FLATTENED != 0;
                match [triangle, second].map(|triangle| distance(&ray, triangle, flattened)) {
                    [Some(one), Some(other)] => (one.t - other.t).abs() <= one.error + other.error,
                    _ => false,
                }
            })
        })
    }

    pub(super) fn finish(self) -> Result<(), TreesError> {
        self.wrong.take().map_or(Ok(()), Err)
    }
}

/// Where a ray meets a triangle, and how far single precision may be off.
#[derive(Clone, Copy, Debug)]
struct Distance {
    t: f64,
    error: f64,
}

/// None when the ray passes the triangle by more than rounding, or lies in its plane.
fn distance(ray: &Ray, triangle: &Triangle, flattened: bool) -> Option<Distance> {
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let [v0, v1, v2] = triangle.0.map(|vertex| vertex.as_dvec3());
    let (e1, e2, c) = (v1 - v0, v2 - v0, v0 - o);
    let normal = e1.cross(e2);
    let den = normal.dot(d);
    let r = c.cross(d);
    let (u, v) = (r.dot(e2) * den.signum(), -r.dot(e1) * den.signum());
    let w = den.abs() - u - v;

    // An instance's vertices are rounded once more, at the magnitude of the coordinates.
    let largest = [v0, v1, v2, o].iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
    let reach = c.length() + if flattened { largest } else { 0.0 };
    let error = ROUNDINGS * UNIT;
    let edges = e1.length() + e2.length();
    let den_error = error * e1.length() * e2.length() * d.length();
    let outside = error * reach * d.length() * edges + den_error;
    if den.abs() <= den_error || [u, v, w].into_iter().any(|value| value < -outside) {
        return None;
    }
    let t = normal.dot(c) / den;
    let t_error = (error * reach * e1.length() * e2.length() + t.abs() * den_error) / den.abs();
    t.is_finite().then_some(Distance { t, error: t_error })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec3;

    fn triangle(z: f32) -> Triangle {
        Triangle([Vec3::new(0.0, 0.0, z), Vec3::new(1.0, 0.0, z), Vec3::new(0.0, 1.0, z)])
    }

    /// Distances by hand: a ray down from z = 1 meets the plane z = 0 at t = 1, at half the speed at t = 2.
    #[test]
    fn distances_are_those_of_the_plane() {
        let ray = |x: f32, speed: f32| Ray {
            origin: Vec3::new(x, 0.25, 1.0),
            direction: Vec3::new(0.0, 0.0, -speed),
            tnear: 0.0,
            tfar: f32::INFINITY,
        };
        let at = |x, speed, z| distance(&ray(x, speed), &triangle(z), false);
        assert!((at(0.25, 1.0, 0.0).unwrap().t - 1.0).abs() < 1e-12);
        assert!((at(0.25, 0.5, 0.0).unwrap().t - 2.0).abs() < 1e-12);
        // The edge x + y = 1 is a hit, beyond it is none; a ray in the plane has no distance.
        assert!(at(0.75, 1.0, 0.0).is_some() && at(0.7501, 1.0, 0.0).is_none());
        let along = Ray { direction: Vec3::X, ..ray(-1.0, 1.0) };
        assert!(distance(&along, &triangle(1.0), false).is_none());
        // Rounding at this distance is some 1e-6: planes 1e-4 apart are told from one.
        let error = at(0.25, 1.0, 0.0).unwrap().error;
        assert!((1e-7..1e-5).contains(&error), "{error}");
    }
}
