//! Random numbers that are a function of (seed, pixel, sample, dimension): no state, so images and traces depend
//! neither on the number of threads nor on the order of work.
//!
//! Each pair of dimensions is a two-dimensional Sobol' sequence over the samples of a pixel, shuffled and scrambled by a hash
//! (Burley, "Practical Hash-based Owen Scrambling", JCGT 2020), so that few samples already cover the square evenly.

use crate::random::mixed;

/// The random numbers of one sample of one pixel.
#[derive(Clone, Copy, Debug)]
pub struct Sampler {
    /// Hash of seed and pixel.
    key: u64,
    sample: u32,
}

impl Sampler {
    pub fn new(seed: u64, pixel: u32, sample: u32) -> Sampler {
        Sampler { key: mixed(mixed(seed) ^ u64::from(pixel)), sample }
    }

    /// Two numbers in [0, 1); evenly spread over the samples of a pixel.
    #[inline]
    pub fn pair(&self, dimension: u32) -> [f32; 2] {
        let [shuffle, first, second] = self.seeds(dimension);
        let index = scramble(self.sample, shuffle);
        [unit(scramble(sobol_0(index), first)), unit(scramble(sobol_1(index), second))]
    }

    /// One number in [0, 1); evenly spread over the samples of a pixel.
    #[inline]
    pub fn single(&self, dimension: u32) -> f32 {
        let [shuffle, first, _] = self.seeds(dimension);
        unit(scramble(sobol_0(scramble(self.sample, shuffle)), first))
    }

    #[inline]
    fn seeds(&self, dimension: u32) -> [u32; 3] {
        let a = mixed(self.key ^ (u64::from(dimension) << 32));
        let b = mixed(a);
        [a as u32, (a >> 32) as u32, b as u32]
    }
}

/// The upper 24 bits as a fraction, never 1.
#[inline]
fn unit(x: u32) -> f32 {
    (x >> 8) as f32 / (1 << 24) as f32
}

/// First dimension of Sobol's sequence: van der Corput's.
#[inline]
fn sobol_0(index: u32) -> u32 {
    index.reverse_bits()
}

/// Second dimension: its generator matrix is Pascal's triangle modulo 2, a Kronecker power of a 2 × 2 matrix, so five
/// butterflies multiply by it.
#[inline]
fn sobol_1(index: u32) -> u32 {
    let mut x = index;
    for (shift, low) in
        [(1, 0x5555_5555), (2, 0x3333_3333), (4, 0x0F0F_0F0F), (8, 0x00FF_00FF), (16, 0x0000_FFFF)]
    {
        x ^= (x >> shift) & low;
    }
    x.reverse_bits()
}

/// Owen's nested uniform scrambling by a Laine-Karras hash, with the constants of Burley's listing 3.
#[inline]
fn scramble(x: u32, seed: u32) -> u32 {
    let mut x = x.reverse_bits();
    x ^= x.wrapping_mul(0x3D20_ADEA);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6C56);
    x ^= x.wrapping_mul(0x53A2_2864);
    x.reverse_bits()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn second_dimension_is_sobols() {
        for index in [0u32, 1, 2, 3, 5, 77, 1 << 20, u32::MAX] {
            // The recurrence of its direction numbers: v_1 = 2^31, v_(k+1) = v_k ^ (v_k >> 1).
            let (mut expected, mut direction) = (0, 1u32 << 31);
            for bit in 0..32 {
                if index >> bit & 1 == 1 {
                    expected ^= direction;
                }
                direction ^= direction >> 1;
            }
            assert_eq!(sobol_1(index), expected, "index {index}");
        }
    }

    /// A (0, 2)-sequence: the first 256 points hit each of the 16 × 16, 256 × 1, 4 × 64, … cells exactly once.
    #[test]
    fn samples_of_a_pixel_are_stratified() {
        for (pixel, dimension) in [(0, 0), (1, 0), (12345, 7)] {
            for split in 0..=8 {
                let mut cells = [0u32; 256];
                for sample in 0..256 {
                    let [x, y] = Sampler::new(3, pixel, sample).pair(dimension);
                    let column = (x * (1 << split) as f32) as usize;
                    let row = (y * (256 >> split) as f32) as usize;
                    cells[row << split | column] += 1;
                }
                assert!(cells.iter().all(|&n| n == 1), "pixel {pixel}, {split} bits of x: {cells:?}");
            }
        }
    }

    /// One sample of many pixels must be as uniform as independent numbers: chi-squared of 64 cells.
    #[test]
    fn pixels_are_independent() {
        for dimension in 0..8 {
            let mut cells = [0f64; 64];
            let count = 1 << 16;
            for pixel in 0..count {
                let [x, y] = Sampler::new(0, pixel, 0).pair(dimension);
                cells[(x * 8.0) as usize * 8 + (y * 8.0) as usize] += 1.0;
            }
            let expected = f64::from(count) / 64.0;
            let chi_squared: f64 = cells.iter().map(|n| (n - expected).powi(2) / expected).sum();
            // 63 degrees of freedom: 99.99% lie below 113, 0.01% below 28.
            assert!((28.0..113.0).contains(&chi_squared), "dimension {dimension}: {chi_squared}");
        }
    }

    #[test]
    fn every_argument_matters() {
        let base = Sampler::new(1, 2, 3).pair(4);
        assert_eq!(base, Sampler::new(1, 2, 3).pair(4));
        for other in [
            Sampler::new(0, 2, 3).pair(4),
            Sampler::new(1, 0, 3).pair(4),
            Sampler::new(1, 2, 0).pair(4),
            Sampler::new(1, 2, 3).pair(0),
        ] {
            assert_ne!(base, other);
        }
    }
}
