//! Whether an answer agrees with the recorded one; where they differ, double precision decides who can be right.
//!
//! Two correct single-precision tests can differ on a ray that passes an edge, a plane, or the end of its interval
//! within their rounding. So a difference is *borderline* when the exact values lie within the rounding error of such
//! a test: [`ROUNDINGS`](super::exact::ROUNDINGS) units of 2⁻²⁴ of the magnitudes that go into each value, and [`BOX_ROUNDINGS`](super::exact::BOX_ROUNDINGS) units of the coordinates. Anything
//! else is a mismatch.

use super::exact::{Exact, Truth, exact, near};
use crate::format::rays::{NO_TRIANGLE, Record, flag};
use crate::geometry::{Ray, Triangle};
use crate::traverse::{Candidates, Hit, Masks, PreparedTriangle};
use crate::tree::TreeView;

/// Greatest relative difference of t between two right answers.
pub const T_TOLERANCE: f64 = 1e-4;

/// Two triangles at distances closer than this, relatively, are hit at the same t: either is the answer.
pub const SAME_T: f64 = 1e-6;

/// How an answer compares with the recorded one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    Agrees,
    /// They differ, and both can be right.
    Borderline,
    /// They differ, and one of them is wrong.
    Mismatch,
    /// The recorded program hit something that is not a triangle, or ended the ray itself;
    /// triangles cannot tell.
    Unchecked,
    /// The recorded program or the replay hit something that moves, and nothing that stands still says otherwise.
    Moving,
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
        if record.flags & flag::INTERRUPTED != 0 {
            return self.interrupted(record, ray);
        }
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

    /// A query that the program itself has ended. Embree may have left out what is closer, but what
    /// it hit is there.
    fn interrupted(&self, record: &Record, ray: &Ray) -> Verdict {
        let stands = record.is_hit() && record.triangle != NO_TRIANGLE && !self.masks.moves(record.triangle);
        let missed = |exact: Exact| exact.truth == Truth::Miss || !exact.can_be(record.t);
        if stands && self.exact(ray, Hit { t: record.t, triangle: record.triangle }).is_none_or(missed) {
            return Verdict::Mismatch;
        }
        Verdict::Unchecked
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
                let [mask, instance_mask] = self.masks.of(index);
                let triangle = PreparedTriangle { vertices, index, mask, instance_mask };
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::bvh::{Geometry, geometry_flag};
    use crate::format::rays::kind;
    use crate::geometry::{Aabb, Vec3};
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

    /// What is hit before a hit at which a filter ended the ray is no matter, but that must be one.
    #[test]
    fn hits_of_interrupted_queries_are_hits() {
        let closest = |recorded: Option<(f32, u32)>, found| {
            let mut record = record(0.25, 0.25, kind::CLOSEST_HIT, recorded);
            record.flags |= flag::UNDECIDED | flag::INTERRUPTED;
            judged(record, found)
        };
        assert_eq!(closest(Some((1.0, 0)), hit(0.5, 2)), Verdict::Unchecked);
        assert_eq!(closest(Some((1.0, 0)), hit(1.0, 0)), Verdict::Unchecked);
        assert_eq!(closest(None, hit(0.5, 2)), Verdict::Unchecked);
        assert_eq!(closest(Some((0.0, NO_TRIANGLE)), None), Verdict::Unchecked);
        assert_eq!(closest(Some((0.9, 0)), hit(0.5, 2)), Verdict::Mismatch);
        assert_eq!(closest(Some((1.0, 77)), hit(0.5, 2)), Verdict::Mismatch);
        assert_eq!(closest(Some((0.0, 2)), None), Verdict::Mismatch);
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
