//! Eight floats: two fours, or one register of AVX.

use super::four::Mask;
use super::{F32x4, Lanes};

/// What a triangle's test against eight rays needs beside [`Lanes`].
pub trait Eight: Lanes<8> {
    type Mask: LaneMask;

    fn add(self, other: Self) -> Self;
    fn div(self, other: Self) -> Self;
    /// `self` * `other` + `addend`, rounded once.
    fn mul_add(self, other: Self, addend: Self) -> Self;
    /// The sign bit of each lane, the other bits zero.
    fn signs(self) -> Self;
    /// Each lane's bits, those that are set in `other` flipped.
    fn flip(self, other: Self) -> Self;
    /// Per lane: `self` <= `other`.
    fn le(self, other: Self) -> Self::Mask;
    /// Per lane: `self` < `other`.
    fn lt(self, other: Self) -> Self::Mask;
    /// Each lane from `yes` where `mask` holds, else from `no`.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// The least lane; none may be NaN.
    fn least(self) -> f32;
    /// Vector i: element i of each row.
    fn columns(rows: &[[f32; 8]; 8]) -> [Self; 8];
    fn store(self, to: &mut [f32; 8]);
}

/// Eight answers of a comparison.
pub trait LaneMask: Copy {
    fn and(self, other: Self) -> Self;
    /// Bit i: lane i.
    fn bits(self) -> u32;
}

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

impl LaneMask for [Mask; 2] {
    #[inline(always)]
    fn and(self, other: [Mask; 2]) -> [Mask; 2] {
        [self[0].and(other[0]), self[1].and(other[1])]
    }

    #[inline(always)]
    fn bits(self) -> u32 {
        self[0].bits() | self[1].bits() << 4
    }
}

impl Eight for Halves {
    type Mask = [Mask; 2];

    #[inline(always)]
    fn add(self, other: Halves) -> Halves {
        self.zip(other, F32x4::add)
    }

    #[inline(always)]
    fn div(self, other: Halves) -> Halves {
        self.zip(other, F32x4::div)
    }

    #[inline(always)]
    fn mul_add(self, other: Halves, addend: Halves) -> Halves {
        let (a, b, c) = (self.to_array(), other.to_array(), addend.to_array());
        Halves::load(&std::array::from_fn(|lane| a[lane].mul_add(b[lane], c[lane])))
    }

    #[inline(always)]
    fn signs(self) -> Halves {
        Halves(self.0.map(F32x4::signs))
    }

    #[inline(always)]
    fn flip(self, other: Halves) -> Halves {
        self.zip(other, F32x4::flip)
    }

    #[inline(always)]
    fn le(self, other: Halves) -> [Mask; 2] {
        [self.0[0].le(other.0[0]), self.0[1].le(other.0[1])]
    }

    #[inline(always)]
    fn lt(self, other: Halves) -> [Mask; 2] {
        [self.0[0].lt(other.0[0]), self.0[1].lt(other.0[1])]
    }

    #[inline(always)]
    fn select(mask: [Mask; 2], yes: Halves, no: Halves) -> Halves {
        Halves([mask[0].select(yes.0[0], no.0[0]), mask[1].select(yes.0[1], no.0[1])])
    }

    #[inline(always)]
    fn least(self) -> f32 {
        let [a, b, c, d] = self.0[0].min_or(self.0[1]).to_array();
        a.min(b).min(c.min(d))
    }

    #[inline(always)]
    fn columns(rows: &[[f32; 8]; 8]) -> [Halves; 8] {
        std::array::from_fn(|column| Halves::load(&std::array::from_fn(|row| rows[row][column])))
    }

    #[inline(always)]
    fn store(self, to: &mut [f32; 8]) {
        *to = self.to_array();
    }
}

#[cfg(target_arch = "x86_64")]
mod whole {
    //! SAFETY, for every block: `Whole` is used by the machine [`super::super::Avx2`] only, which has AVX2 and FMA; memory is touched by
    //! the loads, the store and the transposition alone, in the arrays that they are given.

    use super::{Eight, LaneMask, Lanes};
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

    /// One register of answers.
    #[derive(Clone, Copy, Debug)]
    pub struct WholeMask(__m256);

    impl LaneMask for WholeMask {
        #[inline(always)]
        fn and(self, other: WholeMask) -> WholeMask {
            // SAFETY: see above.
            unsafe { WholeMask(_mm256_and_ps(self.0, other.0)) }
        }

        #[inline(always)]
        fn bits(self) -> u32 {
            // SAFETY: see above.
            unsafe { _mm256_movemask_ps(self.0) as u32 }
        }
    }

    impl Eight for Whole {
        type Mask = WholeMask;

        #[inline(always)]
        fn add(self, other: Whole) -> Whole {
            // SAFETY: see above.
            unsafe { Whole(_mm256_add_ps(self.0, other.0)) }
        }

        #[inline(always)]
        fn div(self, other: Whole) -> Whole {
            // SAFETY: see above.
            unsafe { Whole(_mm256_div_ps(self.0, other.0)) }
        }

        #[inline(always)]
        fn mul_add(self, other: Whole, addend: Whole) -> Whole {
            // SAFETY: see above.
            unsafe { Whole(_mm256_fmadd_ps(self.0, other.0, addend.0)) }
        }

        #[inline(always)]
        fn signs(self) -> Whole {
            // SAFETY: see above.
            unsafe { Whole(_mm256_and_ps(self.0, _mm256_set1_ps(-0.0))) }
        }

        #[inline(always)]
        fn flip(self, other: Whole) -> Whole {
            // SAFETY: see above.
            unsafe { Whole(_mm256_xor_ps(self.0, other.0)) }
        }

        #[inline(always)]
        fn le(self, other: Whole) -> WholeMask {
            // SAFETY: see above.
            unsafe { WholeMask(_mm256_cmp_ps::<_CMP_LE_OQ>(self.0, other.0)) }
        }

        #[inline(always)]
        fn lt(self, other: Whole) -> WholeMask {
            // SAFETY: see above.
            unsafe { WholeMask(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0)) }
        }

        #[inline(always)]
        fn select(mask: WholeMask, yes: Whole, no: Whole) -> Whole {
            // SAFETY: see above.
            unsafe { Whole(_mm256_blendv_ps(no.0, yes.0, mask.0)) }
        }

        #[inline(always)]
        fn least(self) -> f32 {
            // SAFETY: see above.
            unsafe {
                let four = _mm_min_ps(_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0));
                let two = _mm_min_ps(four, _mm_movehl_ps(four, four));
                _mm_cvtss_f32(_mm_min_ss(two, _mm_shuffle_ps::<1>(two, two)))
            }
        }

        #[inline(always)]
        fn columns(rows: &[[f32; 8]; 8]) -> [Whole; 8] {
            // No closures here: they would not be compiled for AVX.
            macro_rules! four {
                ($start:literal) => {{
                    // Row i beside row i + 4.
                    macro_rules! rows {
                        ($row:literal) => {
                            _mm256_insertf128_ps::<1>(
                                _mm256_castps128_ps256(_mm_loadu_ps(rows[$row].as_ptr().add($start))),
                                _mm_loadu_ps(rows[$row + 4].as_ptr().add($start)),
                            )
                        };
                    }
                    let (a, b, c, d) = (rows!(0), rows!(1), rows!(2), rows!(3));
                    let (low, high) = (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
                    let (next_low, next_high) = (_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d));
                    (
                        Whole(_mm256_shuffle_ps::<0x44>(low, next_low)),
                        Whole(_mm256_shuffle_ps::<0xEE>(low, next_low)),
                        Whole(_mm256_shuffle_ps::<0x44>(high, next_high)),
                        Whole(_mm256_shuffle_ps::<0xEE>(high, next_high)),
                    )
                }};
            }
            // SAFETY: see above; each load reads four of a row's eight floats.
            unsafe {
                let ((a, b, c, d), (e, f, g, h)) = (four!(0), four!(4));
                [a, b, c, d, e, f, g, h]
            }
        }

        #[inline(always)]
        fn store(self, to: &mut [f32; 8]) {
            // SAFETY: see above; `to` has room for eight floats.
            unsafe { _mm256_storeu_ps(to.as_mut_ptr(), self.0) }
        }
    }
}

#[cfg(target_arch = "x86_64")]
pub use whole::Whole;
