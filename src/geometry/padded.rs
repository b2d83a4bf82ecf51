//! A box in two SIMD registers, for loops that see millions of them: builders and probabilities.

use super::{Aabb, Vec3};
use bytemuck::{Pod, Zeroable};
use glam::Vec4;
use std::fmt::Debug;

/// What a node of a tree takes up: a box, or several where things move ([`crate::optimize::frames`]).
pub trait Extent: Copy + PartialEq + Debug + Send + Sync {
    /// The identity of [`Self::union`].
    const EMPTY: Self;

    /// The smallest extent around both.
    fn union(&self, other: &Self) -> Self;

    /// How far the centres of two extents are apart, in some unit: only for comparing.
    fn apart(&self, other: &Self) -> f32;
}

impl Extent for PaddedAabb {
    const EMPTY: PaddedAabb = PaddedAabb::EMPTY;

    #[inline(always)]
    fn union(&self, other: &PaddedAabb) -> PaddedAabb {
        PaddedAabb::union(self, other)
    }

    #[inline(always)]
    fn apart(&self, other: &PaddedAabb) -> f32 {
        ((self.lower + self.upper) - (other.lower + other.upper)).abs().element_sum()
    }
}

impl<const N: usize> Extent for [PaddedAabb; N] {
    const EMPTY: [PaddedAabb; N] = [PaddedAabb::EMPTY; N];

    #[inline(always)]
    fn union(&self, other: &[PaddedAabb; N]) -> [PaddedAabb; N] {
        std::array::from_fn(|frame| self[frame].union(&other[frame]))
    }

    #[inline(always)]
    fn apart(&self, other: &[PaddedAabb; N]) -> f32 {
        self.iter().zip(other).map(|(a, b)| a.apart(b)).sum()
    }
}

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
