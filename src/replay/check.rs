//! Whether an answer agrees with the recorded one; where they differ, double precision decides who can be right.
//!
//! Two correct single-precision tests can differ on a ray that passes an edge, a plane, or the end of its interval
//! within their rounding. So a difference is *borderline* when the exact values lie within the rounding error of such
//! a test: [`ROUNDINGS`] units of 2⁻²⁴ of the magnitudes that go into each value, and [`BOX_ROUNDINGS`] units of the coordinates. Anything
//! else is a mismatch.

use crate::format::rays::{NO_TRIANGLE, Record, flag};
use crate::geometry::{Aabb, Ray, Triangle};
use crate::traverse::{Candidates, Hit, Masks, PreparedTriangle};
use crate::tree::TreeView;

/// Greatest relative difference of t between two right answers.
pub const T_TOLERANCE: f64 = 1e-4;

/// Two triangles at distances closer than this, relatively, are hit at the same t: either is the answer.
pub const SAME_T: f64 = 1e-6;

/// Rounding errors, in units of 2⁻²⁴, that two single-precision tests together may make in a value, relative to the product of the lengths
/// that it is computed from: about 9 operations each (difference, cross product, dot product, sum).
pub const ROUNDINGS: f64 = 18.0;

/// Rounding errors, in units of 2⁻²⁴ of the greatest coordinate, that a box test may make in a position. Embree's default one computes
/// plane · (1/d) - o · (1/d): the second product is rounded at the magnitude of the coordinates, however near the plane is, and so it can lose
/// a hit at the edge of a box.
pub const BOX_ROUNDINGS: f64 = 2.0;

const UNIT: f64 = 1.0 / (1 << 24) as f64;

/// How an answer compares with the recorded one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    Agrees,
    /// They differ, and both can be right.
    Borderline,
    /// They differ, and one of them is wrong.
    Mismatch,
    /// The recorded program hit something that is not a triangle; triangles cannot tell.
    Unchecked,
    /// The recorded program or the replay hit something that moves, and nothing that stands still says otherwise.
    Moving,
}

/// What double precision says of one ray and one triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Truth {
    Hit,
    Miss,
    /// Within rounding of an edge, the plane, or an end of the interval.
    Graze,
}

/// Judges answers over one tree.
pub struct Judge<'a> {
    pub tree: TreeView<'a>,
    pub triangles: &'a [Triangle],
    pub masks: Masks<'a>,
    /// Whether instances were flattened: then the recorded program computed in another space, and vertices were rounded once more.
    pub flattened: bool,
}

impl Judge<'_> {
    /// `ray` is the ray as it was replayed, `answer` what was found among `candidates`.
    pub fn judge(
        &self,
        record: &Record,
        ray: &Ray,
        answer: Option<Hit>,
        candidates: &impl Candidates,
    ) -> Verdict {
        let undecided = record.is_hit() && record.flags & flag::UNDECIDED != 0;
        let recorded_moves = undecided
            && if record.is_occlusion() { self.masks.any_moves() } else { self.masks.moves(record.triangle) };
        if recorded_moves || answer.is_some_and(|hit| self.masks.moves(hit.triangle)) {
            return self.standing(record, ray, undecided, candidates);
        }
        if record.is_occlusion() {
            return match (record.is_hit(), answer.is_some()) {
                _ if undecided => Verdict::Unchecked,
                (recorded, found) if recorded == found => Verdict::Agrees,
                _ => self.occlusion(ray, candidates),
            };
        }
        let recorded = (record.is_hit() && record.triangle != NO_TRIANGLE)
            .then_some(Hit { t: record.t, triangle: record.triangle });
        self.closest(ray, recorded, answer)
    }

    /// A query whose answer, or ours, moves. Where that was at the query's time is not known; but what stands still must not be
    /// hit before the recorded answer.
    fn standing(&self, record: &Record, ray: &Ray, undecided: bool, candidates: &impl Candidates) -> Verdict {
        if record.is_occlusion() && record.is_hit() {
            // Anything may have occluded it.
            return Verdict::Moving;
        }
        let mut ray = *ray;
        if record.is_hit() {
            let recorded = Hit { t: record.t, triangle: record.triangle };
            let missed = |exact: Exact| exact.truth == Truth::Miss || !exact.can_be(recorded.t);
            if !undecided && self.exact(&ray, recorded).is_none_or(missed) {
                return Verdict::Mismatch;
            }
            // Not quite to it: what is hit at the same t is another answer.
            ray.tfar = ray.tfar.min(record.t * (1.0 - T_TOLERANCE as f32));
        }
        if self.find(&ray, &Still { candidates, masks: &self.masks }) == Truth::Hit {
            return Verdict::Mismatch;
        }
        Verdict::Moving
    }

    fn closest(&self, ray: &Ray, recorded: Option<Hit>, found: Option<Hit>) -> Verdict {
        let (recorded, found) = match (recorded, found) {
            (None, None) => return Verdict::Agrees,
            (Some(recorded), Some(found)) => (recorded, found),
            (Some(only), None) | (None, Some(only)) => return self.unmatched(ray, only),
        };
        let difference = relative_difference(recorded.t, found.t);
        if recorded.triangle == found.triangle {
            return if difference <= T_TOLERANCE {
                Verdict::Agrees
            } else {
                self.imprecise(ray, recorded, found)
            };
        }
        if difference <= SAME_T {
            return Verdict::Agrees;
        }
        let possible = |hit: Hit| self.exact(ray, hit).is_some_and(|exact| exact.truth != Truth::Miss);
        if difference <= T_TOLERANCE && possible(recorded) && possible(found) {
            return Verdict::Borderline;
        }
        self.unmatched(ray, if recorded.t < found.t { recorded } else { found })
    }

    /// One answer is `hit`; the other one misses or lies behind it.
    fn unmatched(&self, ray: &Ray, hit: Hit) -> Verdict {
        match self.exact(ray, hit) {
            Some(exact) if exact.truth == Truth::Graze => Verdict::Borderline,
            _ => Verdict::Mismatch,
        }
    }

    /// The same triangle at distances that differ: borderline when rounding can do that to both.
    fn imprecise(&self, ray: &Ray, a: Hit, b: Hit) -> Verdict {
        match self.exact(ray, a) {
            Some(exact) if exact.can_be(a.t) && exact.can_be(b.t) => Verdict::Borderline,
            _ => Verdict::Mismatch,
        }
    }

    /// One says occluded, the other not: borderline when something grazes and nothing is clearly hit.
    fn occlusion(&self, ray: &Ray, candidates: &impl Candidates) -> Verdict {
        match self.find(ray, candidates) {
            Truth::Graze => Verdict::Borderline,
            Truth::Hit | Truth::Miss => Verdict::Mismatch,
        }
    }

    /// A clear hit of any candidate, or else a graze.
    fn find(&self, ray: &Ray, candidates: &impl Candidates) -> Truth {
        let mut grazes = false;
        let mut stack = vec![0u32];
        while let Some(index) = stack.pop() {
            let node = &self.tree.nodes[index as usize];
            if !near(ray, &node.bounds()) {
                continue;
            }
            if !node.is_leaf() {
                stack.extend(node.range().map(|child| child as u32));
                continue;
            }
            for &index in &self.tree.primitives[node.range()] {
                let vertices = self.triangles[index as usize];
                let triangle = PreparedTriangle { vertices, index, mask: self.masks.of(index) };
                if !candidates.accepts(&triangle) {
                    continue;
                }
                match exact(ray, &vertices, self.flattened).truth {
                    Truth::Hit => return Truth::Hit,
                    Truth::Graze => grazes = true,
                    Truth::Miss => {}
                }
            }
        }
        if grazes { Truth::Graze } else { Truth::Miss }
    }

    /// None when the recorded triangle does not exist.
    fn exact(&self, ray: &Ray, hit: Hit) -> Option<Exact> {
        self.triangles.get(hit.triangle as usize).map(|triangle| exact(ray, triangle, self.flattened))
    }
}

/// Candidates that do not move.
struct Still<'a, C> {
    candidates: &'a C,
    masks: &'a Masks<'a>,
}

impl<C: Candidates> Candidates for Still<'_, C> {
    fn accepts(&self, triangle: &PreparedTriangle) -> bool {
        !self.masks.moves(triangle.index) && self.candidates.accepts(triangle)
    }
}

fn relative_difference(a: f32, b: f32) -> f64 {
    let (a, b) = (f64::from(a), f64::from(b));
    let difference = (a - b).abs() / a.abs().max(b.abs());
    if a == b { 0.0 } else { difference }
}

/// A ray and a triangle in double precision.
#[derive(Clone, Copy, Debug)]
struct Exact {
    truth: Truth,
    /// Distance of the plane.
    t: f64,
    /// How far single precision may be off; infinite when the ray lies in the plane.
    t_error: f64,
}

impl Exact {
    /// Whether rounding can make this distance of it.
    fn can_be(&self, t: f32) -> bool {
        (f64::from(t) - self.t).abs() <= self.t_error.max(T_TOLERANCE * self.t.abs())
    }
}

/// Möller and Trumbore's values in double precision, each with the error that single precision may make in it.
fn exact(ray: &Ray, triangle: &Triangle, flattened: bool) -> Exact {
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let [v0, v1, v2] = triangle.0.map(|vertex| vertex.as_dvec3());
    let (e1, e2, c) = (v1 - v0, v2 - v0, v0 - o);
    let normal = e1.cross(e2);
    let r = c.cross(d);
    let den = normal.dot(d);
    let sign = if den < 0.0 { -1.0 } else { 1.0 };
    let u = sign * r.dot(e2);
    let v = -sign * r.dot(e1);
    let w = den.abs() - u - v;

    // An instance's vertices are rounded in world space; the ray's rounding in its own space is of the same size.
    let largest = [v0, v1, v2, o].iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
    let moved = if flattened { largest } else { 0.0 };
    let error = ROUNDINGS * UNIT;
    let distance = c.length() + moved.max(largest * BOX_ROUNDINGS / ROUNDINGS);
    let reach = distance * d.length();
    let den_error = error * (e1.length() * e2.length() + moved * (e1.length() + e2.length())) * d.length();
    let errors = [
        error * reach * e2.length(),
        error * reach * e1.length(),
        error * reach * (e1.length() + e2.length()) + den_error,
    ];
    let t = normal.dot(c) / den;
    if !(den.abs() > den_error && t.is_finite()) {
        return Exact { truth: Truth::Graze, t, t_error: f64::INFINITY };
    }
    let t_error = error * (distance * e1.length() * e2.length() + t.abs() * den_error / error) / den.abs();

    let mut truth = Truth::Hit;
    let (tnear, tfar) = (f64::from(ray.tnear), f64::from(ray.tfar));
    let ends = [(t - tnear, t_error), (tfar - t, t_error)];
    for (value, error) in [u, v, w].into_iter().zip(errors).chain(ends) {
        if value < -error {
            return Exact { truth: Truth::Miss, t, t_error };
        }
        if value <= error {
            truth = Truth::Graze;
        }
    }
    Exact { truth, t, t_error }
}

/// Whether the ray passes through or close to a box: wider than any single-precision test, for a search that must not miss a graze.
fn near(ray: &Ray, bounds: &Aabb) -> bool {
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let (lower, upper) = (bounds.lower.as_dvec3(), bounds.upper.as_dvec3());
    let margin = 1e-5 * (lower.abs().max(upper.abs()).max(o.abs()));
    let (mut start, mut end) = (f64::from(ray.tnear), f64::from(ray.tfar));
    for axis in 0..3 {
        let (a, b) = (lower[axis] - margin[axis] - o[axis], upper[axis] + margin[axis] - o[axis]);
        if d[axis] == 0.0 {
            if a > 0.0 || b < 0.0 {
                return false;
            }
        } else {
            let (a, b) = (a / d[axis], b / d[axis]);
            start = start.max(a.min(b));
            end = end.min(a.max(b));
        }
    }
    // The ends of the interval are rounded too.
    start <= end + 1e-5 * end.abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::bvh::{Geometry, geometry_flag};
    use crate::format::rays::kind;
    use crate::geometry::Vec3;
    use crate::traverse::All;
    use crate::tree::{Node, Tree};
    use bytemuck::Zeroable;

    /// The triangle (0,0) (1,0) (0,1) in the plane z = 0, and its copy at z = 1e-5.
    fn judged(record: Record, answer: Option<Hit>) -> Verdict {
        judged_among(&[], record, answer)
    }

    fn judged_among(geometries: &[Geometry], record: Record, answer: Option<Hit>) -> Verdict {
        let at = |z: f32| Triangle([Vec3::new(0.0, 0.0, z), Vec3::new(1.0, 0.0, z), Vec3::new(0.0, 1.0, z)]);
        let triangles = [at(0.0), at(1e-5), at(0.5)];
        let bounds = triangles.iter().fold(Aabb::EMPTY, |all, t| all.union(&t.bounds()));
        let tree = Tree { nodes: vec![Node::leaf(bounds, 0, 3)], primitives: vec![0, 1, 2] };
        let judge = Judge {
            tree: tree.view(),
            triangles: &triangles,
            masks: Masks::new(geometries),
            flattened: false,
        };
        judge.judge(&record, &record.ray(), answer, &All)
    }

    /// A ray down from z = 1 at (x, y).
    fn record(x: f32, y: f32, kind: u8, hit: Option<(f32, u32)>) -> Record {
        Record {
            origin: Vec3::new(x, y, 1.0),
            direction: -Vec3::Z,
            tfar: f32::INFINITY,
            t: hit.map_or(f32::INFINITY, |(t, _)| t),
            triangle: hit.map_or(NO_TRIANGLE, |(_, triangle)| triangle),
            kind,
            flags: hit.is_some() as u8 * flag::HIT,
            ..Record::zeroed()
        }
    }

    fn hit(t: f32, triangle: u32) -> Option<Hit> {
        Some(Hit { t, triangle })
    }

    #[test]
    fn closest_hits_are_compared() {
        let closest = |recorded, found| judged(record(0.25, 0.25, kind::CLOSEST_HIT, recorded), found);
        assert_eq!(closest(Some((0.5, 2)), hit(0.5, 2)), Verdict::Agrees);
        assert_eq!(closest(Some((0.5, 2)), hit(0.50001, 2)), Verdict::Agrees);
        assert_eq!(closest(Some((0.5, 2)), hit(0.5002, 2)), Verdict::Mismatch);
        assert_eq!(closest(Some((0.5, 2)), None), Verdict::Mismatch);
        assert_eq!(closest(None, hit(0.5, 2)), Verdict::Mismatch);
        assert_eq!(closest(Some((0.5, 2)), hit(1.0, 0)), Verdict::Mismatch);
        // Another triangle: at the same t an answer, within the tolerance borderline, farther away neither.
        assert_eq!(closest(Some((0.5, 2)), hit(0.500_000_06, 1)), Verdict::Agrees);
        assert_eq!(closest(Some((1.0, 0)), hit(0.99999, 1)), Verdict::Borderline);
        // A triangle that does not exist, and an answer that is none.
        assert_eq!(closest(Some((0.5, 77)), hit(1.0, 0)), Verdict::Mismatch);
        assert_eq!(closest(Some((0.5, 77)), None), Verdict::Mismatch);
        assert_eq!(closest(Some((0.3, 0)), hit(1.0, 0)), Verdict::Mismatch);
    }

    #[test]
    fn edges_are_borderline_within_rounding_only() {
        let miss = |x: f32| judged(record(x, 0.25, kind::CLOSEST_HIT, Some((0.5, 2))), None);
        assert_eq!(miss(0.0), Verdict::Borderline);
        assert_eq!(miss(1e-7), Verdict::Borderline);
        assert_eq!(miss(-1e-7), Verdict::Borderline);
        assert_eq!(miss(1e-4), Verdict::Mismatch);
        // Outside: the recorded hit is wrong.
        assert_eq!(miss(-1e-4), Verdict::Mismatch);
    }

    #[test]
    fn interval_ends_and_planes_are_borderline() {
        let ending = |tfar: f32| {
            let record = Record { tfar, ..record(0.25, 0.25, kind::CLOSEST_HIT, Some((0.5, 2))) };
            judged(record, None)
        };
        assert_eq!(ending(0.5), Verdict::Borderline);
        assert_eq!(ending(0.49999994), Verdict::Borderline);
        assert_eq!(ending(0.51), Verdict::Mismatch);
        let along = Record { direction: Vec3::X, ..record(-1.0, 0.25, kind::CLOSEST_HIT, Some((1.0, 2))) };
        let in_plane = Record { origin: Vec3::new(-1.0, 0.25, 0.5), ..along };
        assert_eq!(judged(in_plane, None), Verdict::Borderline);
    }

    /// The only difference among a hundred million recorded queries: the ray passes the common edge of a triangle and its box at less than half a
    /// unit of the coordinates, and Embree's default box test lost it.
    #[test]
    fn a_hit_that_a_box_test_may_lose_is_borderline() {
        let origin = Vec3::new(-6.099354, 4.9793334, 8.997461);
        let direction = Vec3::new(0.49674717, 0.86588395, 0.05905305);
        let (x, z) = (-6.095_454_7, 8.997_925);
        let triangle = Triangle([
            Vec3::new(x, 4.981_818, z),
            Vec3::new(-6.1363635, 5.018_18, 8.998_131),
            Vec3::new(x, 5.018_18, z),
        ]);
        let at = |shift: Vec3| {
            let ray = Ray { origin: origin + shift, direction, tnear: 0.0, tfar: f32::INFINITY };
            exact(&ray, &triangle, false).truth
        };
        assert_eq!(at(Vec3::ZERO), Truth::Graze);
        assert_eq!(at(Vec3::new(0.0, 0.0, 1e-5)), Truth::Hit);
        assert_eq!(at(Vec3::new(0.0, 0.0, -1e-5)), Truth::Miss);
    }

    #[test]
    fn occlusions_are_searched() {
        let occlusion = |x: f32, recorded: bool, found| {
            judged(
                record(x, 0.25, kind::OCCLUSION, recorded.then_some((f32::NEG_INFINITY, NO_TRIANGLE))),
                found,
            )
        };
        assert_eq!(occlusion(0.25, true, hit(0.5, 2)), Verdict::Agrees);
        assert_eq!(occlusion(5.0, false, None), Verdict::Agrees);
        assert_eq!(occlusion(0.25, true, None), Verdict::Mismatch);
        assert_eq!(occlusion(0.25, false, hit(0.5, 2)), Verdict::Mismatch);
        assert_eq!(occlusion(5.0, true, None), Verdict::Mismatch);
        assert_eq!(occlusion(-1e-7, true, None), Verdict::Borderline);
        assert_eq!(occlusion(-1e-7, false, hit(0.5, 2)), Verdict::Borderline);
        let mut curve = record(5.0, 0.25, kind::OCCLUSION, Some((f32::NEG_INFINITY, NO_TRIANGLE)));
        curve.flags |= flag::UNDECIDED;
        assert_eq!(judged(curve, None), Verdict::Unchecked);
    }

    /// The triangle at z = 0.5 moves, those at 0 and 1e-5 stand still.
    #[test]
    fn what_moves_is_not_judged_and_what_stands_still_is() {
        let moving = [Geometry {
            first_triangle: 2,
            triangle_count: 1,
            mask: u32::MAX,
            flags: geometry_flag::MOVING,
            ..Geometry::zeroed()
        }];
        let closest = |recorded: Option<(f32, u32)>, found| {
            let mut record = record(0.25, 0.25, kind::CLOSEST_HIT, recorded);
            // As a recorder flags it.
            record.flags |=
                if recorded.is_some_and(|(_, triangle)| triangle == 2) { flag::UNDECIDED } else { 0 };
            judged_among(&moving, record, found)
        };
        // It was elsewhere at the query's time, and then before what stands still.
        assert_eq!(closest(Some((0.3, 2)), None), Verdict::Moving);
        assert_eq!(closest(Some((0.5, 2)), hit(0.5, 2)), Verdict::Moving);
        // It was out of the way then; the answer beyond it is the right one of those that stand still.
        assert_eq!(closest(Some((0.99999, 1)), hit(0.5, 2)), Verdict::Moving);
        assert_eq!(closest(Some((1.0, 0)), hit(0.5, 2)), Verdict::Moving);
        // What stands still would have been hit, or is not where it was recorded.
        assert_eq!(closest(None, hit(0.5, 2)), Verdict::Mismatch);
        assert_eq!(closest(Some((1.5, 2)), hit(0.5, 2)), Verdict::Mismatch);
        assert_eq!(closest(Some((0.7, 0)), hit(0.5, 2)), Verdict::Mismatch);
        // Nothing moves here.
        assert_eq!(closest(Some((1.0, 0)), hit(1.0, 0)), Verdict::Agrees);
        assert_eq!(closest(Some((1.0, 0)), None), Verdict::Mismatch);
        assert_eq!(closest(None, hit(1.0, 0)), Verdict::Mismatch);

        let occlusion = |x: f32, tfar: f32, recorded: bool, found| {
            let hit = recorded.then_some((f32::NEG_INFINITY, NO_TRIANGLE));
            let mut record = Record { tfar, ..record(x, 0.25, kind::OCCLUSION, hit) };
            record.flags |= if recorded { flag::UNDECIDED } else { 0 };
            judged_among(&moving, record, found)
        };
        assert_eq!(occlusion(5.0, 9.0, true, None), Verdict::Moving);
        assert_eq!(occlusion(0.25, 9.0, true, hit(1.0, 0)), Verdict::Moving);
        assert_eq!(occlusion(0.25, 0.8, false, hit(0.5, 2)), Verdict::Moving);
        assert_eq!(occlusion(0.25, 9.0, false, hit(0.5, 2)), Verdict::Mismatch);
        assert_eq!(occlusion(0.25, 9.0, false, hit(1.0, 0)), Verdict::Mismatch);
        assert_eq!(occlusion(5.0, 9.0, false, None), Verdict::Agrees);
    }
}
