//! Whether an answer agrees with the recorded one; where they differ, double precision decides who can be right.
//!
//! A verdict goes by the answers themselves. An answer is *possible* when its point o + t·d lies within rounding of the triangle that it
//! names and of the interval; it is *right* when also nothing is clearly hit before it, or anywhere when it is a miss. Two answers that differ and are both
//! right are *borderline*; if one of them is not, it is a mismatch. What rounding is, and what is clear, is stated in [`super::exact`].

use super::exact::{end_rounding, is_clear, near, within};
use crate::format::rays::{NO_TRIANGLE, Record, flag};
use crate::geometry::{Ray, Triangle};
use crate::traverse::{Candidates, Hit, Masks, PreparedTriangle};
use crate::tree::TreeView;

/// Greatest relative difference of t between two right answers that name one triangle, beyond which they are borderline.
pub const T_TOLERANCE: f64 = 1e-4;

/// Two triangles at distances closer than this, relatively, are hit at the same t: either is the answer.
pub const SAME_T: f64 = 1e-6;

/// Relative difference of t that two tests of one triangle make in nearly every query, from the last division alone; below it nothing else is asked.
const LAST_DIGITS: f64 = 4.0 / (1 << 24) as f64;

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
            return self.interrupted(record, ray, candidates);
        }
        let undecided = record.is_hit() && record.flags & flag::UNDECIDED != 0;
        let recorded_moves = undecided
            && if record.is_occlusion() { self.masks.any_moves() } else { self.masks.moves(record.triangle) };
        if recorded_moves || answer.is_some_and(|hit| self.masks.moves(hit.triangle)) {
            return self.standing(record, ray, answer, undecided, candidates);
        }
        if record.is_occlusion() {
            return match (record.is_hit(), answer.is_some()) {
                _ if undecided => Verdict::Unchecked,
                (recorded, found) if recorded == found => Verdict::Agrees,
                _ => self.occlusion(ray, candidates),
            };
        }
        if record.is_hit() && !is_inside(&record.ray(), record.t) {
            return Verdict::Mismatch;
        }
        let recorded = (record.is_hit() && record.triangle != NO_TRIANGLE)
            .then_some(Hit { t: record.t, triangle: record.triangle });
        self.closest(ray, recorded, answer, candidates)
    }

    /// A query that the program itself has ended. Embree may have left out what is closer, but what
    /// it hit is there.
    fn interrupted(&self, record: &Record, ray: &Ray, candidates: &impl Candidates) -> Verdict {
        let stands = record.is_hit() && record.triangle != NO_TRIANGLE && !self.masks.moves(record.triangle);
        let recorded = Hit { t: record.t, triangle: record.triangle };
        if stands && !self.is_possible(ray, recorded, candidates) {
            return Verdict::Mismatch;
        }
        Verdict::Unchecked
    }

    /// A query whose answer, or ours, moves. Where that was at the query's time is not known; but what stands still must be where it
    /// is said to be hit, and must not be hit before the recorded answer.
    fn standing(
        &self,
        record: &Record,
        ray: &Ray,
        answer: Option<Hit>,
        undecided: bool,
        candidates: &impl Candidates,
    ) -> Verdict {
        if answer.is_some_and(|hit| !self.is_possible(ray, hit, candidates)) {
            return Verdict::Mismatch;
        }
        if record.is_occlusion() && record.is_hit() {
            // Anything may have occluded it.
            return Verdict::Moving;
        }
        let mut ray = *ray;
        if record.is_hit() {
            let recorded = Hit { t: record.t, triangle: record.triangle };
            let possible = if undecided {
                is_inside(&record.ray(), record.t)
            } else {
                self.is_possible(&ray, recorded, candidates)
            };
            if !possible {
                return Verdict::Mismatch;
            }
            ray.tfar = ray.tfar.min(record.t);
        }
        match self.find(&ray, &Still { candidates, masks: &self.masks }) {
            Found::Clear => Verdict::Mismatch,
            Found::Graze | Found::Nothing => Verdict::Moving,
        }
    }

    fn closest(
        &self,
        ray: &Ray,
        recorded: Option<Hit>,
        found: Option<Hit>,
        candidates: &impl Candidates,
    ) -> Verdict {
        if let (Some(recorded), Some(found)) = (recorded, found)
            && recorded.triangle == found.triangle
            && relative_difference(recorded.t, found.t) <= LAST_DIGITS
        {
            return Verdict::Agrees;
        }
        if recorded.is_none() && found.is_none() {
            return Verdict::Agrees;
        }
        if recorded.into_iter().chain(found).any(|hit| !self.is_possible(ray, hit, candidates)) {
            return Verdict::Mismatch;
        }
        let mut until = *ray;
        let mut alike = Verdict::Borderline;
        if let (Some(recorded), Some(found)) = (recorded, found) {
            let difference = relative_difference(recorded.t, found.t);
            if difference <= SAME_T {
                return Verdict::Agrees;
            }
            if recorded.triangle == found.triangle && difference <= T_TOLERANCE {
                alike = Verdict::Agrees;
            }
            until.tfar = until.tfar.min(recorded.t.max(found.t));
        }
        match self.find(&until, candidates) {
            Found::Clear => Verdict::Mismatch,
            Found::Graze | Found::Nothing => alike,
        }
    }

    /// One says occluded, the other not: borderline when something grazes and nothing is clearly hit.
    fn occlusion(&self, ray: &Ray, candidates: &impl Candidates) -> Verdict {
        match self.find(ray, candidates) {
            Found::Graze => Verdict::Borderline,
            Found::Clear | Found::Nothing => Verdict::Mismatch,
        }
    }

    /// Whether the point of a hit lies within rounding of a triangle that the query may hit, and of the interval.
    fn is_possible(&self, ray: &Ray, hit: Hit, candidates: &impl Candidates) -> bool {
        self.triangles.get(hit.triangle as usize).is_some_and(|&vertices| {
            candidates.accepts(&self.prepared(vertices, hit.triangle))
                && within(ray, &vertices, self.flattened)
                    .is_some_and(|range| range.contains(&f64::from(hit.t)))
        })
    }

    fn prepared(&self, vertices: Triangle, index: u32) -> PreparedTriangle {
        let [mask, instance_mask] = self.masks.of(index);
        PreparedTriangle { vertices, index, mask, instance_mask }
    }

    /// A clear hit of any candidate, or else a graze.
    fn find(&self, ray: &Ray, candidates: &impl Candidates) -> Found {
        let mut grazes = false;
        let mut stack = vec![0u32];
        while let Some(index) = stack.pop() {
            let node = &self.tree.nodes[index as usize];
            if !near(ray, &node.bounds(), self.flattened) {
                continue;
            }
            if !node.is_leaf() {
                stack.extend(node.range().map(|child| child as u32));
                continue;
            }
            for &index in &self.tree.primitives[node.range()] {
                let vertices = self.triangles[index as usize];
                if !candidates.accepts(&self.prepared(vertices, index)) {
                    continue;
                }
                if is_clear(ray, &vertices, self.flattened) {
                    return Found::Clear;
                }
                grazes = grazes || within(ray, &vertices, self.flattened).is_some();
            }
        }
        if grazes { Found::Graze } else { Found::Nothing }
    }
}

/// What double precision finds of a query.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Found {
    /// A triangle that every test must find.
    Clear,
    /// None of these, and one that a test may find.
    Graze,
    Nothing,
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

/// Whether t lies within the interval, within rounding.
fn is_inside(ray: &Ray, t: f32) -> bool {
    let [t, tnear, tfar] = [t, ray.tnear, ray.tfar].map(f64::from);
    tnear - end_rounding(tnear) <= t && t <= tfar + end_rounding(tfar)
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
        judged_in(&[at(0.0), at(1e-5), at(0.5)], geometries, record, answer)
    }

    fn judged_in(
        triangles: &[Triangle; 3],
        geometries: &[Geometry],
        record: Record,
        answer: Option<Hit>,
    ) -> Verdict {
        let bounds = triangles.iter().fold(Aabb::EMPTY, |all, t| all.union(&t.bounds()));
        let tree = Tree { nodes: vec![Node::leaf(bounds, 0, 3)], primitives: vec![0, 1, 2] };
        let judge = Judge { tree: tree.view(), triangles, masks: Masks::new(geometries), flattened: false };
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
        assert_eq!(closest(Some((0.5, 2)), hit(0.500_000_3, 2)), Verdict::Agrees);
        assert_eq!(closest(Some((0.5, 2)), hit(0.50001, 2)), Verdict::Mismatch);
        assert_eq!(closest(Some((0.50001, 2)), hit(0.5, 2)), Verdict::Mismatch);
        assert_eq!(closest(Some((0.5, 2)), None), Verdict::Mismatch);
        assert_eq!(closest(None, hit(0.5, 2)), Verdict::Mismatch);
        assert_eq!(closest(Some((0.5, 2)), hit(1.0, 0)), Verdict::Mismatch);
        // Another triangle that is not there, and one behind another by more than rounding.
        assert_eq!(closest(Some((0.5, 1)), hit(0.5, 2)), Verdict::Mismatch);
        assert_eq!(closest(Some((0.5, 2)), hit(0.500_000_06, 1)), Verdict::Mismatch);
        assert_eq!(closest(Some((1.0, 0)), hit(0.99999, 1)), Verdict::Mismatch);
        // A triangle that does not exist, and an answer that is none.
        assert_eq!(closest(Some((0.5, 77)), hit(1.0, 0)), Verdict::Mismatch);
        assert_eq!(closest(Some((0.5, 77)), None), Verdict::Mismatch);
        assert_eq!(closest(Some((0.3, 0)), hit(1.0, 0)), Verdict::Mismatch);
        assert_eq!(closest(Some((f32::NAN, 2)), hit(0.5, 2)), Verdict::Mismatch);
    }

    /// Two triangles at one place, 2e-7 apart, and a third that is clearly hit before both.
    #[test]
    fn two_triangles_at_one_place_are_either_and_what_is_clearly_before_them_is_not_overlooked() {
        let at = |z: f32| Triangle([Vec3::new(0.0, 0.0, z), Vec3::new(1.0, 0.0, z), Vec3::new(0.0, 1.0, z)]);
        let verdict = |third: f32, recorded, found| {
            judged_in(
                &[at(0.0), at(2e-7), at(third)],
                &[],
                record(0.25, 0.25, kind::CLOSEST_HIT, recorded),
                found,
            )
        };
        assert_eq!(verdict(-0.5, Some((1.0, 0)), hit(1.0, 1)), Verdict::Agrees);
        assert_eq!(verdict(-0.5, Some((1.000_000_5, 0)), hit(0.999_999_2, 1)), Verdict::Borderline);
        // Both answers overlook the third.
        assert_eq!(verdict(0.5, Some((1.000_000_5, 0)), hit(0.999_999_2, 1)), Verdict::Mismatch);
    }

    /// The kinds of `false hit`: beside the plane and parallel to it, and at an edge, but elsewhere.
    #[test]
    fn grazing_excuses_only_what_is_there() {
        let parallel = |z: f32, t: f32| {
            let along = Record { direction: Vec3::X, ..record(-5.0, 0.2, kind::CLOSEST_HIT, Some((t, 2))) };
            judged(Record { origin: Vec3::new(-5.0, 0.2, z), ..along }, None)
        };
        // It passes the triangle at z = 0.5 from x = 0 to 0.8.
        assert_eq!(parallel(0.5, 5.4), Verdict::Borderline);
        for (z, t) in [(3.5, 7.0), (0.5, 7.0), (0.5, 4.9), (0.5, 1e5), (0.501, 5.4)] {
            assert_eq!(parallel(z, t), Verdict::Mismatch, "{z} {t}");
        }
        let edge = |x: f32, t: f32| judged(record(x, 0.5, kind::CLOSEST_HIT, Some((t, 2))), None);
        assert_eq!(edge(0.0, 0.5), Verdict::Borderline);
        for (x, t) in [(0.0, 100.0), (-1e-8, 100.0), (0.0, 0.501)] {
            assert_eq!(edge(x, t), Verdict::Mismatch, "{x} {t}");
        }
        // The same triangle at two distances: both have to be possible.
        let two = |t: f32| judged(record(0.0, 0.5, kind::CLOSEST_HIT, Some((t, 2))), hit(0.5, 2));
        assert_eq!(
            [two(0.500_000_3), two(0.51), two(100.0)],
            [Verdict::Agrees, Verdict::Mismatch, Verdict::Mismatch]
        );
    }

    /// At x = 1,000,000 Embree's boxes are rounded to an eighth: of two walls 0.01 apart either is an answer, of walls 1 apart the nearer one.
    #[test]
    fn far_from_the_origin_boxes_excuse_the_order_and_not_the_place() {
        let wall =
            |x: f32| Triangle([Vec3::new(x, -9.0, -9.0), Vec3::new(x, 9.0, -9.0), Vec3::new(x, 0.0, 9.0)]);
        for (start, order) in [(0.0, Verdict::Mismatch), (1e6, Verdict::Borderline)] {
            let slanted = Triangle([
                Vec3::new(start + 7.0, -9.0, -9.0),
                Vec3::new(start + 9.0, 9.0, -9.0),
                Vec3::new(start + 8.0, 0.0, 9.0),
            ]);
            let triangles = [wall(start + 8.0), slanted, wall(start + 9.0)];
            let verdict = |t: f32, triangle: u32, found| {
                let record = Record {
                    origin: Vec3::new(start, 0.125, 0.5),
                    direction: Vec3::X,
                    ..record(0.0, 0.0, kind::CLOSEST_HIT, Some((t, triangle)))
                };
                judged_in(&triangles, &[], record, found)
            };
            // x = 8 + y/9 on the slanted one, so 8 + 1/72.
            let behind = 8.0 + 0.125 / 9.0;
            assert_eq!(verdict(behind, 1, hit(8.0, 0)), order);
            assert_eq!(verdict(behind + 0.01, 1, hit(8.0, 0)), Verdict::Mismatch);
            assert_eq!(verdict(9.0, 2, hit(8.0, 0)), Verdict::Mismatch);
        }
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
        // But not beyond one that stands still, a hundred-thousandth before it.
        assert_eq!(closest(Some((1.0, 0)), hit(0.5, 2)), Verdict::Mismatch);
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
