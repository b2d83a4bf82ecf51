//! Four floats at a time: SSE2, which every x86-64 has, and plain arrays elsewhere. Same results on both.

#[cfg(target_arch = "x86_64")]
mod imp {
    //! SAFETY, for every block without its own: the functions need SSE2 at most, which is part of x86-64, and touch no memory.

    use std::arch::x86_64::*;

    /// Four floats.
    #[derive(Clone, Copy, Debug)]
    pub struct F32x4(__m128);

    impl F32x4 {
        #[inline(always)]
        pub fn splat(value: f32) -> F32x4 {
            // SAFETY: see above.
            unsafe { F32x4(_mm_set1_ps(value)) }
        }

        #[inline(always)]
        pub fn new(values: [f32; 4]) -> F32x4 {
            // SAFETY: see above.
            unsafe { F32x4(_mm_set_ps(values[3], values[2], values[1], values[0])) }
        }

        /// Lanes 0 and 1 from the bits of `low`, 2 and 3 from those of `high`; each holds its first lane in its low half.
        #[inline(always)]
        pub fn from_halves(low: u64, high: u64) -> F32x4 {
            // Through doubles: two plain loads, without a detour over general registers.
            // SAFETY: see above.
            unsafe { F32x4(_mm_castpd_ps(_mm_set_pd(f64::from_bits(high), f64::from_bits(low)))) }
        }

        /// Lanes 0 and 1 of `self`, then lanes 0 and 1 of `high`.
        #[inline(always)]
        pub fn join(self, high: F32x4) -> F32x4 {
            // SAFETY: see above.
            unsafe { F32x4(_mm_movelh_ps(self.0, high.0)) }
        }

        #[inline(always)]
        pub fn to_array(self) -> [f32; 4] {
            // SAFETY: both are 16 bytes of plain floats.
            unsafe { std::mem::transmute(self.0) }
        }

        #[inline(always)]
        pub fn sub(self, other: F32x4) -> F32x4 {
            // SAFETY: see above.
            unsafe { F32x4(_mm_sub_ps(self.0, other.0)) }
        }

        #[inline(always)]
        pub fn mul(self, other: F32x4) -> F32x4 {
            // SAFETY: see above.
            unsafe { F32x4(_mm_mul_ps(self.0, other.0)) }
        }

        /// The greater of each lane; `other`'s when either is NaN, or both are zero.
        #[inline(always)]
        pub fn max_or(self, other: F32x4) -> F32x4 {
            // SAFETY: see above.
            unsafe { F32x4(_mm_max_ps(self.0, other.0)) }
        }

        /// The lesser of each lane; `other`'s when either is NaN, or both are zero.
        #[inline(always)]
        pub fn min_or(self, other: F32x4) -> F32x4 {
            // SAFETY: see above.
            unsafe { F32x4(_mm_min_ps(self.0, other.0)) }
        }

        #[inline(always)]
        pub fn add(self, other: F32x4) -> F32x4 {
            // SAFETY: see above.
            unsafe { F32x4(_mm_add_ps(self.0, other.0)) }
        }

        #[inline(always)]
        pub fn div(self, other: F32x4) -> F32x4 {
            // SAFETY: see above.
            unsafe { F32x4(_mm_div_ps(self.0, other.0)) }
        }

        /// The sign bit of each lane, the other bits zero.
        #[inline(always)]
        pub fn signs(self) -> F32x4 {
            // SAFETY: see above.
            unsafe { F32x4(_mm_and_ps(self.0, _mm_set1_ps(-0.0))) }
        }

        /// Each lane's bits, those that are set in `other` flipped.
        #[inline(always)]
        pub fn flip(self, other: F32x4) -> F32x4 {
            // SAFETY: see above.
            unsafe { F32x4(_mm_xor_ps(self.0, other.0)) }
        }

        /// Per lane: `self` <= `other`.
        #[inline(always)]
        pub fn le(self, other: F32x4) -> Mask {
            // SAFETY: see above.
            unsafe { Mask(_mm_cmple_ps(self.0, other.0)) }
        }

        /// Per lane: `self` < `other`.
        #[inline(always)]
        pub fn lt(self, other: F32x4) -> Mask {
            // SAFETY: see above.
            unsafe { Mask(_mm_cmplt_ps(self.0, other.0)) }
        }

        /// `self` * `other` + `addend`, rounded once.
        ///
        /// # Safety
        /// The processor must have FMA.
        #[inline(always)]
        pub unsafe fn fused(self, other: F32x4, addend: F32x4) -> F32x4 {
            // SAFETY: the caller says so.
            unsafe { F32x4(_mm_fmadd_ps(self.0, other.0, addend.0)) }
        }

        /// `self` * `other` - `less`, rounded once.
        ///
        /// # Safety
        /// The processor must have FMA.
        #[inline(always)]
        pub unsafe fn fused_less(self, other: F32x4, less: F32x4) -> F32x4 {
            // SAFETY: the caller says so.
            unsafe { F32x4(_mm_fmsub_ps(self.0, other.0, less.0)) }
        }

        /// Bit i: lane i of `self` <= lane i of `other`.
        #[inline(always)]
        pub fn le_mask(self, other: F32x4) -> u32 {
            self.le(other).bits()
        }

        /// Lanes 2 and 3, negated, as lanes 0 and 1 (and again as 2 and 3).
        #[inline(always)]
        pub fn negated_high(self) -> F32x4 {
            // SAFETY: see above.
            unsafe { F32x4(_mm_xor_ps(_mm_movehl_ps(self.0, self.0), _mm_set1_ps(-0.0))) }
        }
    }

    /// Four answers of a comparison.
    #[derive(Clone, Copy, Debug)]
    pub struct Mask(__m128);

    impl Mask {
        #[inline(always)]
        pub fn and(self, other: Mask) -> Mask {
            // SAFETY: see above.
            unsafe { Mask(_mm_and_ps(self.0, other.0)) }
        }

        /// Each lane from `yes` where the comparison holds, else from `no`.
        #[inline(always)]
        pub fn select(self, yes: F32x4, no: F32x4) -> F32x4 {
            // SAFETY: see above.
            unsafe { F32x4(_mm_or_ps(_mm_and_ps(self.0, yes.0), _mm_andnot_ps(self.0, no.0))) }
        }

        /// Bit i: lane i.
        #[inline(always)]
        pub fn bits(self) -> u32 {
            // SAFETY: see above.
            unsafe { _mm_movemask_ps(self.0) as u32 }
        }
    }
}

#[cfg(not(target_arch = "x86_64"))]
mod imp {
    /// Four floats.
    #[derive(Clone, Copy, Debug)]
    pub struct F32x4([f32; 4]);

    impl F32x4 {
        #[inline(always)]
        fn zip(self, other: F32x4, f: impl Fn(f32, f32) -> f32) -> F32x4 {
            F32x4(std::array::from_fn(|lane| f(self.0[lane], other.0[lane])))
        }

        #[inline(always)]
        pub fn splat(value: f32) -> F32x4 {
            F32x4([value; 4])
        }

        #[inline(always)]
        pub fn new(values: [f32; 4]) -> F32x4 {
            F32x4(values)
        }

        /// Lanes 0 and 1 from the bits of `low`, 2 and 3 from those of `high`; each holds its first lane in its low half.
        #[inline(always)]
        pub fn from_halves(low: u64, high: u64) -> F32x4 {
            F32x4([low as u32, (low >> 32) as u32, high as u32, (high >> 32) as u32].map(f32::from_bits))
        }

        /// Lanes 0 and 1 of `self`, then lanes 0 and 1 of `high`.
        #[inline(always)]
        pub fn join(self, high: F32x4) -> F32x4 {
            F32x4([self.0[0], self.0[1], high.0[0], high.0[1]])
        }

        #[inline(always)]
        pub fn to_array(self) -> [f32; 4] {
            self.0
        }

        #[inline(always)]
        pub fn sub(self, other: F32x4) -> F32x4 {
            self.zip(other, |a, b| a - b)
        }

        #[inline(always)]
        pub fn mul(self, other: F32x4) -> F32x4 {
            self.zip(other, |a, b| a * b)
        }

        /// The greater of each lane; `other`'s when either is NaN, or both are zero.
        #[inline(always)]
        pub fn max_or(self, other: F32x4) -> F32x4 {
            self.zip(other, |a, b| if a > b { a } else { b })
        }

        /// The lesser of each lane; `other`'s when either is NaN, or both are zero.
        #[inline(always)]
        pub fn min_or(self, other: F32x4) -> F32x4 {
            self.zip(other, |a, b| if a < b { a } else { b })
        }

        #[inline(always)]
        pub fn add(self, other: F32x4) -> F32x4 {
            self.zip(other, |a, b| a + b)
        }

        #[inline(always)]
        pub fn div(self, other: F32x4) -> F32x4 {
            self.zip(other, |a, b| a / b)
        }

        /// The sign bit of each lane, the other bits zero.
        #[inline(always)]
        pub fn signs(self) -> F32x4 {
            F32x4(self.0.map(|lane| f32::from_bits(lane.to_bits() & 0x8000_0000)))
        }

        /// Each lane's bits, those that are set in `other` flipped.
        #[inline(always)]
        pub fn flip(self, other: F32x4) -> F32x4 {
            self.zip(other, |a, b| f32::from_bits(a.to_bits() ^ b.to_bits()))
        }

        /// Per lane: `self` <= `other`.
        #[inline(always)]
        pub fn le(self, other: F32x4) -> Mask {
            Mask(std::array::from_fn(|lane| self.0[lane] <= other.0[lane]))
        }

        /// Per lane: `self` < `other`.
        #[inline(always)]
        pub fn lt(self, other: F32x4) -> Mask {
            Mask(std::array::from_fn(|lane| self.0[lane] < other.0[lane]))
        }

        /// Bit i: lane i of `self` <= lane i of `other`.
        #[inline(always)]
        pub fn le_mask(self, other: F32x4) -> u32 {
            self.le(other).bits()
        }

        /// Lanes 2 and 3, negated, as lanes 0 and 1 (and again as 2 and 3).
        #[inline(always)]
        pub fn negated_high(self) -> F32x4 {
            F32x4([-self.0[2], -self.0[3], -self.0[2], -self.0[3]])
        }
    }

    /// Four answers of a comparison.
    #[derive(Clone, Copy, Debug)]
    pub struct Mask([bool; 4]);

    impl Mask {
        #[inline(always)]
        pub fn and(self, other: Mask) -> Mask {
            Mask(std::array::from_fn(|lane| self.0[lane] & other.0[lane]))
        }

        /// Each lane from `yes` where the comparison holds, else from `no`.
        #[inline(always)]
        pub fn select(self, yes: F32x4, no: F32x4) -> F32x4 {
            F32x4(std::array::from_fn(|lane| if self.0[lane] { yes.0[lane] } else { no.0[lane] }))
        }

        /// Bit i: lane i.
        #[inline(always)]
        pub fn bits(self) -> u32 {
            (0..4).map(|lane| u32::from(self.0[lane]) << lane).sum()
        }
    }
}

pub use imp::{F32x4, Mask};
