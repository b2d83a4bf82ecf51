//! Vectors of floats, with the same results on every machine: SSE2, which every x86-64 has; AVX2 with fused multiply-add
//! where a [`Machine`] says so; plain arrays elsewhere.

mod eight;
mod four;

#[cfg(target_arch = "x86_64")]
pub use eight::Whole;
pub use eight::{Eight, Halves, LaneMask};
pub use four::F32x4;

/// What box tests need of a vector of `N` floats.
pub trait Lanes<const N: usize>: Copy {
    fn splat(value: f32) -> Self;
    fn load(values: &[f32; N]) -> Self;
    fn to_array(self) -> [f32; N];
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    /// The greater of each lane; `other`'s when either is NaN, or both are zero.
    fn max_or(self, other: Self) -> Self;
    /// The lesser of each lane; `other`'s when either is NaN, or both are zero.
    fn min_or(self, other: Self) -> Self;
    /// Bit i: lane i of `self` <= lane i of `other`.
    fn le_mask(self, other: Self) -> u32;
}

impl Lanes<4> for F32x4 {
    #[inline(always)]
    fn splat(value: f32) -> F32x4 {
        F32x4::splat(value)
    }

    #[inline(always)]
    fn load(values: &[f32; 4]) -> F32x4 {
        F32x4::new(*values)
    }

    #[inline(always)]
    fn to_array(self) -> [f32; 4] {
        F32x4::to_array(self)
    }

    #[inline(always)]
    fn sub(self, other: F32x4) -> F32x4 {
        F32x4::sub(self, other)
    }

    #[inline(always)]
    fn mul(self, other: F32x4) -> F32x4 {
        F32x4::mul(self, other)
    }

    #[inline(always)]
    fn max_or(self, other: F32x4) -> F32x4 {
        F32x4::max_or(self, other)
    }

    #[inline(always)]
    fn min_or(self, other: F32x4) -> F32x4 {
        F32x4::min_or(self, other)
    }

    #[inline(always)]
    fn le_mask(self, other: F32x4) -> u32 {
        F32x4::le_mask(self, other)
    }
}

/// A kind of processor that traversals are compiled for. Chosen at run time, once per tree.
pub trait Machine: Copy {
    type Eight: Eight;

    /// a · b + c, rounded once.
    fn mul_add(a: F32x4, b: F32x4, c: F32x4) -> F32x4;

    /// a · b - c, rounded once.
    #[inline(always)]
    fn mul_sub(a: F32x4, b: F32x4, c: F32x4) -> F32x4 {
        Self::mul_add(a, b, c.flip(F32x4::splat(-0.0)))
    }
}

/// Any processor. Where it has no fused multiply-add, a library function gives the same bits, slowly.
#[derive(Clone, Copy, Debug)]
pub struct Any;

impl Machine for Any {
    type Eight = Halves;

    #[inline(always)]
    fn mul_add(a: F32x4, b: F32x4, c: F32x4) -> F32x4 {
        let (a, b, c) = (a.to_array(), b.to_array(), c.to_array());
        F32x4::new(std::array::from_fn(|lane| a[lane].mul_add(b[lane], c[lane])))
    }
}

/// An x86-64 with AVX2 and FMA. Named only where both are known to be there.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug)]
pub struct Avx2;

#[cfg(target_arch = "x86_64")]
impl Machine for Avx2 {
    type Eight = Whole;

    #[inline(always)]
    fn mul_add(a: F32x4, b: F32x4, c: F32x4) -> F32x4 {
        // SAFETY: this machine has FMA.
        unsafe { a.fused(b, c) }
    }

    #[inline(always)]
    fn mul_sub(a: F32x4, b: F32x4, c: F32x4) -> F32x4 {
        // SAFETY: this machine has FMA.
        unsafe { a.fused_less(b, c) }
    }
}

/// A machine's vector of `N` floats.
pub trait Supports<const N: usize>: Machine {
    type Vector: Lanes<N>;
}

impl<M: Machine> Supports<4> for M {
    type Vector = F32x4;
}

impl<M: Machine> Supports<8> for M {
    type Vector = M::Eight;
}

/// Asks for the four cache lines from `address` on, which may be anything, to be fetched while other work goes on.
#[inline(always)]
pub fn prefetch(address: *const u8) {
    #[cfg(target_arch = "x86_64")]
    for line in 0..4 {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a hint reads nothing, and does not fault whatever the address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(address.wrapping_add(64 * line).cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = address;
}
