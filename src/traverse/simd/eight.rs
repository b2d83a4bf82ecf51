//! Eight floats: two fours, or one register of AVX.

use super::{F32x4, Lanes};

/// Two vectors of four.
#[derive(Clone, Copy, Debug)]
pub struct Halves([F32x4; 2]);

impl Halves {
    #[inline(always)]
    fn zip(self, other: Halves, f: impl Fn(F32x4, F32x4) -> F32x4) -> Halves {
        Halves([f(self.0[0], other.0[0]), f(self.0[1], other.0[1])])
    }
}

impl Lanes<8> for Halves {
    #[inline(always)]
    fn splat(value: f32) -> Halves {
        Halves([F32x4::splat(value); 2])
    }

    #[inline(always)]
    fn load(values: &[f32; 8]) -> Halves {
        let [a, b, c, d, e, f, g, h] = *values;
        Halves([F32x4::new([a, b, c, d]), F32x4::new([e, f, g, h])])
    }

    #[inline(always)]
    fn to_array(self) -> [f32; 8] {
        let ([a, b, c, d], [e, f, g, h]) = (self.0[0].to_array(), self.0[1].to_array());
        [a, b, c, d, e, f, g, h]
    }

    #[inline(always)]
    fn sub(self, other: Halves) -> Halves {
        self.zip(other, F32x4::sub)
    }

    #[inline(always)]
    fn mul(self, other: Halves) -> Halves {
        self.zip(other, F32x4::mul)
    }

    #[inline(always)]
    fn max_or(self, other: Halves) -> Halves {
        self.zip(other, F32x4::max_or)
    }

    #[inline(always)]
    fn min_or(self, other: Halves) -> Halves {
        self.zip(other, F32x4::min_or)
    }

    #[inline(always)]
    fn le_mask(self, other: Halves) -> u32 {
        self.0[0].le_mask(other.0[0]) | self.0[1].le_mask(other.0[1]) << 4
    }
}

#[cfg(target_arch = "x86_64")]
mod whole {
    //! SAFETY, for every block: `Whole` is used by the machine [`super::super::Avx2`] only, which has AVX; memory is touched by
    //! the load alone, and it reads the eight floats that it is given.

    use super::Lanes;
    use std::arch::x86_64::*;

    /// One register.
    #[derive(Clone, Copy, Debug)]
    pub struct Whole(__m256);

    impl Lanes<8> for Whole {
        #[inline(always)]
        fn splat(value: f32) -> Whole {
            // SAFETY: see above.
            unsafe { Whole(_mm256_set1_ps(value)) }
        }

        #[inline(always)]
        fn load(values: &[f32; 8]) -> Whole {
            // SAFETY: see above.
            unsafe { Whole(_mm256_loadu_ps(values.as_ptr())) }
        }

        #[inline(always)]
        fn to_array(self) -> [f32; 8] {
            // SAFETY: both are 32 bytes of plain floats.
            unsafe { std::mem::transmute(self.0) }
        }

        #[inline(always)]
        fn sub(self, other: Whole) -> Whole {
            // SAFETY: see above.
            unsafe { Whole(_mm256_sub_ps(self.0, other.0)) }
        }

        #[inline(always)]
        fn mul(self, other: Whole) -> Whole {
            // SAFETY: see above.
            unsafe { Whole(_mm256_mul_ps(self.0, other.0)) }
        }

        #[inline(always)]
        fn max_or(self, other: Whole) -> Whole {
            // SAFETY: see above.
            unsafe { Whole(_mm256_max_ps(self.0, other.0)) }
        }

        #[inline(always)]
        fn min_or(self, other: Whole) -> Whole {
            // SAFETY: see above.
            unsafe { Whole(_mm256_min_ps(self.0, other.0)) }
        }

        #[inline(always)]
        fn le_mask(self, other: Whole) -> u32 {
            // SAFETY: see above.
            unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(self.0, other.0)) as u32 }
        }
    }
}

#[cfg(target_arch = "x86_64")]
pub use whole::Whole;
