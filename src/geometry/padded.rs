//! A box in two SIMD registers, for loops that see millions of them: builders and probabilities.

use super::{Aabb, Vec3};
use bytemuck::{Pod, Zeroable};
use glam::Vec4;

/// An axis-aligned box whose corners are padded to four lanes. The fourth lane means nothing and is 0, so that no
/// arithmetic on it is slow (subnormal numbers) or raises a NaN.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct PaddedAabb {
    pub lower: Vec4,
    pub upper: Vec4,
}

impl PaddedAabb {
    /// The identity of [`Self::union`].
    pub const EMPTY: PaddedAabb = PaddedAabb {
        lower: Vec4::new(f32::INFINITY, f32::INFINITY, f32::INFINITY, 0.0),
        upper: Vec4::new(f32::NEG_INFINITY, f32::NEG_INFINITY, f32::NEG_INFINITY, 0.0),
    };

    /// The smallest box around both.
    #[inline(always)]
    pub fn union(&self, other: &PaddedAabb) -> PaddedAabb {
        PaddedAabb { lower: self.lower.min(other.lower), upper: self.upper.max(other.upper) }
    }

    /// The smallest box around `self` and a point (its fourth lane is 0).
    #[inline(always)]
    pub fn grown(&self, point: Vec4) -> PaddedAabb {
        PaddedAabb { lower: self.lower.min(point), upper: self.upper.max(point) }
    }
}

impl From<Aabb> for PaddedAabb {
    #[inline(always)]
    fn from(bounds: Aabb) -> PaddedAabb {
        PaddedAabb { lower: bounds.lower.extend(0.0), upper: bounds.upper.extend(0.0) }
    }
}

impl From<PaddedAabb> for Aabb {
    #[inline(always)]
    fn from(bounds: PaddedAabb) -> Aabb {
        let corner = |v: Vec4| Vec3::new(v.x, v.y, v.z);
        Aabb { lower: corner(bounds.lower), upper: corner(bounds.upper) }
    }
}
