//! Early miss: whether a box is missed by all rays of a packet, decided by interval arithmetic on all of them at once.
//!
//! For each axis the origins and the inverses of the directions lie in intervals, so the distances of a face lie in the interval of their
//! products (Boulos, Wald and Shirley, "Geometric and arithmetic culling methods for entire ray packets", 2006). Rounding is monotone: what
//! the bounds say of the intervals' ends, the single tests of all rays between them would say too.

use super::super::form::Faces;
use super::super::simd::{Eight, F32x4, LaneMask};
use super::bundle::Octet;

/// A lower and an upper bound by axis; the fourth lane is of no axis.
#[derive(Clone, Copy, Debug)]
struct Interval {
    low: F32x4,
    high: F32x4,
}

/// Bounds of everything that a box test takes of the rays of a packet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frustum {
    origin: Interval,
    /// NaN on an axis where a ray cannot be bounded, and in the fourth lane.
    near_inverse: Interval,
    far_inverse: Interval,
    tnear: f32,
}

impl Frustum {
    #[inline(always)]
    pub fn new<V: Eight>(octets: &[Octet]) -> Frustum {
        let (infinity, nan) = (V::splat(f32::INFINITY), V::splat(f32::NAN));
        let mut tnear = infinity;
        // By quantity and axis; upper bounds negated, so that minima do both.
        let mut bounds = [[[infinity; 3]; 2]; 3];
        let mut bounded = [true; 3];
        let minus = V::splat(-0.0);
        for octet in octets {
            let start = V::load(&octet.tnear);
            let able = start.le(V::load(&octet.tfar));
            tnear = start.min_or(tnear);
            for axis in 0..3 {
                let inverse = V::load(&octet.near_inverse[axis]);
                bounded[axis] &= able.and(inverse.le(inverse)).bits() == able.bits();
                let values = [&octet.origin[axis], &octet.near_inverse[axis], &octet.far_inverse[axis]];
                for (bounds, value) in bounds.iter_mut().zip(values) {
                    // A ray that hits nothing has no part in it: NaN loses.
                    let value = V::select(able, V::load(value), nan);
                    bounds[0][axis] = value.min_or(bounds[0][axis]);
                    bounds[1][axis] = value.flip(minus).min_or(bounds[1][axis]);
                }
            }
        }
        let interval = |quantity: usize, bounded: [bool; 3]| {
            let side = |side: usize, sign: f32| {
                let bound = |axis: usize| {
                    if bounded[axis] { sign * bounds[quantity][side][axis].least() } else { f32::NAN }
                };
                F32x4::new([bound(0), bound(1), bound(2), f32::NAN])
            };
            Interval { low: side(0, 1.0), high: side(1, -1.0) }
        };
        Frustum {
            origin: interval(0, [true; 3]),
            near_inverse: interval(1, bounded),
            far_inverse: interval(2, bounded),
            tnear: tnear.least(),
        }
    }

    /// Whether no ray enters the box before `end`.
    #[inline(always)]
    pub fn misses(&self, faces: &Faces, end: f32) -> bool {
        let [near, _] = self.distances(faces.near, &self.near_inverse);
        let [_, far] = self.distances(faces.far, &self.far_inverse);
        let ([a, b, c, _], [d, e, f, _]) = (near.to_array(), far.to_array());
        // None is NaN.
        let entry = a.max(b).max(c.max(self.tnear));
        let exit = d.min(e).min(f.min(end));
        entry > exit
    }

    /// Bounds of (face - origin) · inverse on each axis. A product that is NaN says nothing of the rays around it.
    #[inline(always)]
    fn distances(&self, faces: [f32; 3], inverse: &Interval) -> [F32x4; 2] {
        let faces = F32x4::new([faces[0], faces[1], faces[2], 0.0]);
        let (a, b) = (faces.sub(self.origin.high), faces.sub(self.origin.low));
        let (w, x) = (a.mul(inverse.low), a.mul(inverse.high));
        let (y, z) = (b.mul(inverse.low), b.mul(inverse.high));
        let numbers = w.le(w).and(x.le(x)).and(y.le(y)).and(z.le(z));
        let infinity = F32x4::splat(f32::INFINITY);
        let low = w.min_or(x).min_or(y.min_or(z));
        let high = w.max_or(x).max_or(y.max_or(z));
        [numbers.select(low, F32x4::splat(f32::NEG_INFINITY)), numbers.select(high, infinity)]
    }
}
