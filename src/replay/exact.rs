//! One ray and one triangle in double precision, and what single precision may make of them: what a [verdict](super::check) goes by.
//!
//! Whether an answer can be right is asked of the answer itself: the point o + t·d has to lie within rounding of the named triangle and t
//! within rounding of the interval ([`within`]). Whether a triangle may be overlooked is asked of the triangle: it is hit *clearly* when the
//! ray passes every edge, both ends of the interval and the triangle's box by more than rounding ([`is_clear`]). Neither follows from the
//! other: between the two lies what is borderline.
//!
//! # The rounding
//!
//! One operation in single precision errs by at most u = 2⁻²⁴ of its result (Higham, *Accuracy and Stability of Numerical Algorithms*, 2002,
//! section 2.2), a sum of three products by 3u of the sum of their magnitudes (section 3.1). Embree's tests work on differences: v0 - o
//! and the edges v0 - v1, v2 - v0 (Möller and Trumbore), or all three corners minus o (Plücker, robust scenes). So what goes into a value is not
//! a coordinate but a distance from the origin of the ray. Let r be the greatest such distance of a corner, axis by axis, n the
//! unit normal, φ the angle between ray and plane.
//!
//! - **Off the plane**, along n. t = N·(v0 - o) / N·d: the difference, the product's sum and the one in the denominator, the quotient
//!   (a reciprocal that is approximated and improved once) make 1 + 3 + 3 + 5 units at most, [`ROUNDINGS`] units of Σ|nᵢ|rᵢ with what a
//!   Plücker test adds by rounding the corners first.
//! - **The shape.** N = e1 × e2 errs by [`SHAPE_ROUNDINGS`] units of the products |e1ᵢ e2ⱼ|, not of |N|: the normal of a needle is tilted about a
//!   corner, and so the point is moved by that many units of Σ(|e1| × |e2|)ᵢ mᵢ / |N|, where m is how far the triangle reaches from v0.
//! - **Within the plane**, beyond an edge. (v0 - o) × d errs by units of |r||d|, and the barycentrics are its products with the edges over N·d.
//!   That is [`ROUNDINGS`] units of |r|, and what the shape adds, over sin φ, whichever edge it is. t errs by as much along the ray.
//! - **Never more**: neither a needle nor a ray near the plane makes more of it than [`MOST`] times [`ROUNDINGS`] units of |r|. The worst case of
//!   either would, without limit; but a point farther than that is not on the triangle, whatever computed it. (Of seven million hits that
//!   were recorded in ten scenes, three instruction sets, robust and default, the farthest was 2.4 times off its plane, and 0.25 times beyond an edge.)
//! - **Interval.** t is compared with its ends before or after the division: [`ROUNDINGS`] units of them.
//! - **Boxes.** Embree's default test computes plane · (1/d) - o · (1/d), whose second product is rounded at the magnitude of the coordinates,
//!   however near the plane is (Ize, "Robust BVH Ray Traversal", JCGT 2013, has the test without it). That moves a face by [`BOX_ROUNDINGS`]
//!   units of the coordinates: a hit at the edge of its box is lost, and one box is taken to be behind another hit. It makes a hit unclear, and moves no answer.
//! - **Flattened instances.** The program asked in the instance's space, and corners were rounded once more in the world's: [`ROUNDINGS`] units of the
//!   greatest coordinate are added, and sums axis by axis become products of lengths, since the axes were others.

use crate::geometry::{Aabb, DVec3, Ray, Triangle, Vec3};
use std::ops::RangeInclusive;

/// Rounding errors, in units of 2⁻²⁴ of the distances that go into it, that a test may make in the place of a hit.
pub const ROUNDINGS: f64 = 16.0;

/// Rounding errors, in units of 2⁻²⁴ of the products of edges, that a test may make in the normal: three of each component (two edges, a product), and
/// one of the sum.
pub const SHAPE_ROUNDINGS: f64 = 4.0;

/// Rounding errors, in units of 2⁻²⁴ of a coordinate, that a box test may make in the place of a face.
pub const BOX_ROUNDINGS: f64 = 2.0;

/// How often [`ROUNDINGS`] a flat angle, of the triangle or between it and the ray, may explain.
pub const MOST: f64 = 4.0;

/// One rounding in single precision.
const UNIT: f64 = 1.0 / (1 << 24) as f64;

/// Products below this lose more than a rounding to underflow: 2⁻¹²⁶ in units of 2⁻²⁴, and some bits.
const UNDERFLOW: f64 = 1e-30;

/// The ray parameters whose points lie within rounding of the triangle and of the interval: what a test in single precision can answer. None when there
/// is no such point.
pub fn within(ray: &Ray, triangle: &Triangle, flattened: bool) -> Option<RangeInclusive<f64>> {
    Sight::new(ray, triangle, flattened)?.within()
}

/// Whether the ray passes the triangle's inside and its box by so much that every test must find it within the interval.
pub fn is_clear(ray: &Ray, triangle: &Triangle, flattened: bool) -> bool {
    Sight::new(ray, triangle, flattened).is_some_and(|sight| sight.is_clear(&triangle.bounds()))
}

/// Whether the ray meets two triangles at one place within rounding, so that a test may answer either.
pub fn tie(ray: &Ray, a: &Triangle, b: &Triangle, flattened: bool) -> bool {
    let of = |triangle| within(ray, triangle, flattened);
    matches!((of(a), of(b)), (Some(a), Some(b)) if a.start() <= b.end() && b.start() <= a.end())
}

/// A ray and a triangle in double precision, with the rounding of single precision in lengths.
#[derive(Clone, Copy, Debug)]
struct Sight {
    o: DVec3,
    d: DVec3,
    /// Ends of the interval.
    ends: [f64; 2],
    corners: [DVec3; 3],
    /// Unit; any perpendicular of the longest edge when there is no area.
    normal: DVec3,
    /// Length of e1 × e2.
    area: f64,
    /// Index of the corner where the longest edge starts, its direction and length; any direction and 0 when all corners are one.
    longest: (usize, DVec3, f64),
    /// |sin φ|.
    sine: f64,
    /// Rounding of a point near the triangle, in any direction.
    point: f64,
    /// The same along the normal.
    off_plane: f64,
    /// What the rounding of the normal adds; infinite when there is no area.
    shape: f64,
    /// How far the triangle reaches from its first corner.
    extent: f64,
}

impl Sight {
    /// None when the ray or the triangle is not finite, or the ray has no direction or an empty interval: then nothing is hit.
    fn new(ray: &Ray, triangle: &Triangle, flattened: bool) -> Option<Sight> {
        let finite = ray.origin.is_finite() && ray.direction.is_finite() && triangle.is_finite();
        let has_interval = ray.tnear <= ray.tfar;
        if !finite || ray.direction == Vec3::ZERO || !has_interval {
            return None;
        }
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let corners = triangle.0.map(|corner| corner.as_dvec3());
        let [v0, v1, v2] = corners;
        let (e1, e2) = (v1 - v0, v2 - v0);
        let edge = |start: usize| corners[(start + 1) % 3] - corners[start];
        let start = (0..3).max_by(|&a, &b| edge(a).length_squared().total_cmp(&edge(b).length_squared()))?;
        let length = edge(start).length();
        let along = if length > 0.0 { edge(start) / length } else { DVec3::X };
        let scaled = e1.cross(e2);
        let area = scaled.length();
        let normal = if area > 0.0 { scaled / area } else { along.any_orthonormal_vector() };

        let reach = corners.iter().fold(DVec3::ZERO, |reach, corner| reach.max((corner - o).abs()));
        let extents = e1.abs().max(e2.abs());
        let (distance, extent) = (reach.length(), extents.length());
        let (a1, a2) = (e1.abs(), e2.abs());
        let products =
            DVec3::new(a1.y * a2.z + a1.z * a2.y, a1.z * a2.x + a1.x * a2.z, a1.x * a2.y + a1.y * a2.x);
        let (point, along_normal, tilt) = if flattened {
            let largest = corners.iter().fold(o.abs(), |most, corner| most.max(corner.abs())).max_element();
            let point = ROUNDINGS * UNIT * (distance + largest);
            (point, point, a1.length() * a2.length() * extent)
        } else {
            let rounding = ROUNDINGS * UNIT;
            (rounding * distance, rounding * normal.abs().dot(reach), products.dot(extents))
        };
        // A triangle thinner than the rounding of its corners has no plane: what is beside it is off it, too.
        let off_plane = along_normal + point * (point * length / area).min(1.0);
        let shape = if tilt > 0.0 { SHAPE_ROUNDINGS * UNIT * tilt / area } else { 0.0 };
        Some(Sight {
            o,
            d,
            ends: [ray.tnear.into(), ray.tfar.into()],
            corners,
            normal,
            area,
            longest: (start, along, length),
            sine: normal.dot(d).abs() / d.length(),
            point,
            off_plane,
            shape,
            extent,
        })
    }

    /// See [`within`].
    fn within(&self) -> Option<RangeInclusive<f64>> {
        let most = MOST * self.point;
        let off_plane = self.off_plane + self.shape.min(most);
        let beyond = ((self.point + self.shape) / self.sine).min(most);
        let [tnear, tfar] = self.ends;
        let mut range = Range { start: tnear - end_rounding(tnear), end: tfar + end_rounding(tfar) };
        // Every condition is linear in t: a + b·t is a distance from a plane.
        let mut clip = |direction: DVec3, from: DVec3, least: f64, most: f64| {
            range.clip(direction.dot(self.o - from), direction.dot(self.d), least, most);
        };
        let (first, along, length) = self.longest;
        let first = self.corners[first];
        clip(self.normal, first, -off_plane, off_plane);
        // Needles end where they end, not where their edges' margins meet.
        clip(along, first, -beyond, length + beyond);
        if length == 0.0 {
            clip(self.normal.cross(along), first, -beyond, beyond);
        }
        for (inward, corner) in self.edges() {
            clip(inward, corner, -beyond, f64::INFINITY);
        }
        (range.start <= range.end).then_some(range.start..=range.end)
    }

    /// See [`is_clear`].
    fn is_clear(&self, bounds: &Aabb) -> bool {
        let (_, _, length) = self.longest;
        // The angle is as uncertain as the plane.
        let sine = self.sine - self.point * length / self.area - self.shape / self.extent;
        let speed = self.d.length();
        let certain = sine > 0.0 && self.area.min(self.area * speed * sine) > UNDERFLOW;
        if !certain {
            return false;
        }
        let t = self.normal.dot(self.corners[0] - self.o) / self.normal.dot(self.d);
        let point = self.o + t * self.d;
        let beyond = (self.point + self.shape) / sine;
        if self.edges().any(|(inward, corner)| inward.dot(point - corner) <= beyond) {
            return false;
        }
        let error = (self.off_plane + self.shape) / (sine * speed);
        let [tnear, tfar] = self.ends;
        t - error > tnear + end_rounding(tnear)
            && t + error < tfar - end_rounding(tfar)
            && self.is_in_box(bounds)
    }

    /// Whether no rounding of a box test lets the ray miss the box within the interval.
    fn is_in_box(&self, bounds: &Aabb) -> bool {
        let (lower, upper) = (bounds.lower.as_dvec3(), bounds.upper.as_dvec3());
        let [tnear, tfar] = self.ends;
        let mut slabs = [(f64::NEG_INFINITY, f64::INFINITY); 3];
        for axis in 0..3 {
            let (o, d) = (self.o[axis], self.d[axis]);
            let (below, above) = (lower[axis] - o, upper[axis] - o);
            let coordinate = o.abs().max(lower[axis].abs()).max(upper[axis].abs());
            let moved = UNIT * (BOX_ROUNDINGS * coordinate + ROUNDINGS * below.abs().max(above.abs()));
            if d == 0.0 {
                if below + moved >= 0.0 || above - moved <= 0.0 {
                    return false;
                }
                continue;
            }
            let (near, far) = if d > 0.0 { (below / d, above / d) } else { (above / d, below / d) };
            slabs[axis] = (near + moved / d.abs(), far - moved / d.abs());
        }
        // The two faces of one axis are rounded alike, so a box may be flat.
        (0..3).all(|a| {
            let (near, far) = slabs[a];
            near < tfar && far > tnear && (0..3).all(|b| a == b || near < slabs[b].1)
        })
    }

    /// Unit vectors within the plane, from each edge inwards, and a corner of the edge; without edges of no length.
    fn edges(&self) -> impl Iterator<Item = (DVec3, DVec3)> {
        (0..3).filter_map(|start| {
            let corner = self.corners[start];
            let edge = self.corners[(start + 1) % 3] - corner;
            edge.try_normalize().map(|edge| (self.normal.cross(edge), corner))
        })
    }
}

/// How far an end of the interval may be off.
pub(super) fn end_rounding(end: f64) -> f64 {
    if end.is_finite() { ROUNDINGS * UNIT * end.abs() } else { 0.0 }
}

/// Ray parameters that are left.
struct Range {
    start: f64,
    end: f64,
}

impl Range {
    /// Keeps those with `least` ≤ `a` + `b` t ≤ `most`.
    fn clip(&mut self, a: f64, b: f64, least: f64, most: f64) {
        if b == 0.0 {
            if !(least <= a && a <= most) {
                self.end = f64::NEG_INFINITY;
            }
            return;
        }
        let (one, other) = ((least - a) / b, (most - a) / b);
        self.start = self.start.max(one.min(other));
        self.end = self.end.min(one.max(other));
    }
}

/// Whether the ray passes through or close to a box: wider than anything that [`within`] allows its triangles, for a search that must not miss a graze.
pub(super) fn near(ray: &Ray, bounds: &Aabb, flattened: bool) -> bool {
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let (lower, upper) = (bounds.lower.as_dvec3(), bounds.upper.as_dvec3());
    let farthest = (lower - o).abs().max((upper - o).abs()).length();
    let largest = lower.abs().max(upper.abs()).max(o.abs()).max_element();
    let magnitude = farthest + if flattened { largest } else { 0.0 };
    let margin = 2.0 * MOST * ROUNDINGS * UNIT * magnitude;
    let [tnear, tfar] = [ray.tnear, ray.tfar].map(f64::from);
    let (mut start, mut end) = (tnear - end_rounding(tnear), tfar + end_rounding(tfar));
    for axis in 0..3 {
        let (a, b) = (lower[axis] - margin - o[axis], upper[axis] + margin - o[axis]);
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
    start <= end
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNIT_TRIANGLE: Triangle = Triangle([Vec3::ZERO, Vec3::X, Vec3::Y]);

    fn ray(origin: [f32; 3], direction: [f32; 3]) -> Ray {
        Ray { origin: origin.into(), direction: direction.into(), tnear: 0.0, tfar: f32::INFINITY }
    }

    fn answers(ray: &Ray, triangle: &Triangle, t: f64) -> bool {
        within(ray, triangle, false).is_some_and(|range| range.contains(&t))
    }

    /// By hand: the farthest corner is about 1.3 away, 16 units of it are 1.2e-6; at right angles t has that much room to either side.
    #[test]
    fn a_point_has_the_rounding_of_its_distance() {
        let down = ray([0.25, 0.25, 1.0], [0.0, 0.0, -1.0]);
        assert!(is_clear(&down, &UNIT_TRIANGLE, false));
        for (shift, expected) in [(0.0, true), (5e-7, true), (1.3e-6, false), (1e-5, false)] {
            assert_eq!(answers(&down, &UNIT_TRIANGLE, 1.0 + shift), expected, "{shift}");
            assert_eq!(answers(&down, &UNIT_TRIANGLE, 1.0 - shift), expected, "{shift}");
        }
        // Beside an edge there are 1.2e-6, too, and where it is not clear whether the ray passes, it is a hit and none.
        for (x, possible, clear) in
            [(1e-5, true, true), (5e-7, true, false), (-5e-7, true, false), (-3e-6, false, false)]
        {
            let down = ray([x, 0.25, 1.0], [0.0, 0.0, -1.0]);
            assert_eq!(answers(&down, &UNIT_TRIANGLE, 1.0), possible, "{x}");
            assert_eq!(is_clear(&down, &UNIT_TRIANGLE, false), clear, "{x}");
        }
    }

    /// A ray in the plane meets the triangle from x = 0 to 0.75; one beside the plane, or past the triangle, never.
    #[test]
    fn a_ray_in_the_plane_is_within_rounding_where_the_triangle_is() {
        let along = ray([-1.0, 0.25, 0.0], [1.0, 0.0, 0.0]);
        let range = within(&along, &UNIT_TRIANGLE, false).expect("it lies in the plane");
        assert!((range.start() - 1.0).abs() < 3e-5 && (range.end() - 1.75).abs() < 3e-5, "{range:?}");
        assert!(!is_clear(&along, &UNIT_TRIANGLE, false));
        assert_eq!(within(&ray([-1.0, 0.25, 3.0], [1.0, 0.0, 0.0]), &UNIT_TRIANGLE, false), None);
        assert_eq!(within(&ray([-1.0, 0.25, 1e-4], [1.0, 0.0, 0.0]), &UNIT_TRIANGLE, false), None);
        assert_eq!(within(&ray([-1.0, -0.25, 0.0], [1.0, 0.0, 0.0]), &UNIT_TRIANGLE, false), None);
    }

    /// Triangles without an area are lines and points: a ray through them may be said to hit, there and nowhere else.
    #[test]
    fn no_area_excuses_only_what_passes_through_it() {
        let line = Triangle([Vec3::ZERO, Vec3::new(2.0, 0.0, 0.0), Vec3::X]);
        let point = Triangle([Vec3::X; 3]);
        let down = |x: f32, y: f32| ray([x, y, 1.0], [0.0, 0.0, -1.0]);
        for (triangle, x, y, t, expected) in [
            (line, 1.5, 0.0, 1.0, true),
            (line, 1.5, 0.0, 1.001, false),
            (line, 1.5, 1e-4, 1.0, false),
            (line, 2.001, 0.0, 1.0, false),
            (point, 1.0, 0.0, 1.0, true),
            (point, 1.0, 1e-4, 1.0, false),
            (point, 1.001, 0.0, 1.0, false),
            (point, 1.0, 0.0, 0.999, false),
        ] {
            let ray = down(x, y);
            assert_eq!(answers(&ray, &triangle, t), expected, "{triangle:?} {x} {y} {t}");
            assert!(!is_clear(&ray, &triangle, false));
        }
    }

    /// A needle of 1 by 1e-5, whose acute margins would meet far beyond its tip.
    #[test]
    fn a_needle_ends_at_its_tip() {
        let needle = Triangle([Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1e-5, 0.0)]);
        assert!(answers(&ray([0.0, 0.0, 1.0], [0.0, 0.0, -1.0]), &needle, 1.0));
        assert!(!answers(&ray([-1e-4, 0.0, 1.0], [0.0, 0.0, -1.0]), &needle, 1.0));
        assert!(is_clear(&ray([0.75, 4e-6, 1.0], [0.0, 0.0, -1.0]), &needle, false));
    }

    #[test]
    fn triangles_that_cross_tie_along_their_common_line_only() {
        let upright =
            Triangle([Vec3::new(0.0, 0.25, -1.0), Vec3::new(1.0, 0.25, -1.0), Vec3::new(0.0, 0.25, 1.0)]);
        let slanted = |y: f32| ray([0.25, y + 1.0, 1.0], [0.0, -1.0, -1.0]);
        assert!(tie(&slanted(0.25), &UNIT_TRIANGLE, &upright, false));
        assert!(!tie(&slanted(0.2501), &UNIT_TRIANGLE, &upright, false));
    }

    /// At x = 1,000,000, where floats are 1/16 apart, a box test may move a wall by 1/8, although the triangle's own test is exact to 1e-5.
    #[test]
    fn boxes_are_rounded_like_coordinates_and_triangles_like_distances() {
        let wall =
            |x: f32| Triangle([Vec3::new(x, -9.0, -9.0), Vec3::new(x, 9.0, -9.0), Vec3::new(x, 0.0, 9.0)]);
        let across = |x: f32, tfar: f32| Ray { tfar, ..ray([x - 8.0, 0.5, 0.5], [1.0, 0.0, 0.0]) };
        for x in [0.0, 1e6] {
            assert!(answers(&across(x, 99.0), &wall(x), 8.0));
            assert!(!answers(&across(x, 99.0), &wall(x), 8.01));
            assert_eq!(is_clear(&across(x, 8.01), &wall(x), false), x == 0.0);
            assert!(is_clear(&across(x, 8.5), &wall(x), false));
        }
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
            (within(&ray, &triangle, false).is_some(), is_clear(&ray, &triangle, false))
        };
        assert_eq!(at(Vec3::ZERO), (true, false));
        assert_eq!(at(Vec3::new(0.0, 0.0, 1e-5)), (true, true));
        assert_eq!(at(Vec3::new(0.0, 0.0, -1e-5)), (false, false));
    }

    #[test]
    fn what_cannot_be_hit_is_not() {
        let fine = ray([0.25, 0.25, 1.0], [0.0, 0.0, -1.0]);
        let nan = Vec3::new(f32::NAN, 0.0, 0.0);
        for ray in [
            Ray { direction: Vec3::ZERO, ..fine },
            Ray { direction: nan, ..fine },
            Ray { origin: nan, ..fine },
            Ray { tfar: f32::NEG_INFINITY, ..fine },
            Ray { tfar: f32::NAN, ..fine },
            Ray { tnear: 2.0, tfar: 1.0, ..fine },
            Ray { tnear: 2.0, ..fine },
            Ray { tfar: 0.5, ..fine },
        ] {
            assert_eq!(within(&ray, &UNIT_TRIANGLE, false), None, "{ray:?}");
            assert!(!is_clear(&ray, &UNIT_TRIANGLE, false));
        }
        assert_eq!(within(&fine, &Triangle([nan; 3]), false), None);
    }
}
