//! One ray and one triangle in double precision, with the error that a single-precision test may make: what a [verdict](super::check) goes by.

use super::check::T_TOLERANCE;
use crate::geometry::{Aabb, Ray, Triangle};

/// Rounding errors, in units of 2⁻²⁴, that two single-precision tests together may make in a value, relative to the product of the lengths
/// that it is computed from: about 9 operations each (difference, cross product, dot product, sum).
pub const ROUNDINGS: f64 = 18.0;

/// Rounding errors, in units of 2⁻²⁴ of the greatest coordinate, that a box test may make in a position. Embree's default one computes
/// plane · (1/d) - o · (1/d): the second product is rounded at the magnitude of the coordinates, however near the plane is, and so it can lose
/// a hit at the edge of a box.
pub const BOX_ROUNDINGS: f64 = 2.0;

/// One rounding in single precision.
const UNIT: f64 = 1.0 / (1 << 24) as f64;

/// What double precision says of one ray and one triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Truth {
    Hit,
    Miss,
    /// Within rounding of an edge, the plane, or an end of the interval.
    Graze,
}

/// A ray and a triangle in double precision.
#[derive(Clone, Copy, Debug)]
pub(super) struct Exact {
    pub(super) truth: Truth,
    /// Distance of the plane.
    pub(super) t: f64,
    /// How far single precision may be off; infinite when the ray lies in the plane.
    pub(super) t_error: f64,
}

impl Exact {
    /// Whether rounding can make this distance of it.
    pub(super) fn can_be(&self, t: f32) -> bool {
        (f64::from(t) - self.t).abs() <= self.t_error.max(T_TOLERANCE * self.t.abs())
    }
}

/// Möller and Trumbore's values in double precision, each with the error that single precision may make in it.
pub(super) fn exact(ray: &Ray, triangle: &Triangle, flattened: bool) -> Exact {
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
pub(super) fn near(ray: &Ray, bounds: &Aabb) -> bool {
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
    use crate::geometry::Vec3;

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
}
