//! Seeded random numbers: SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014).
//! Small, the same on every machine, and any number of independent streams. Generators, optimisers, samples and experiments
//! all draw from here.

use crate::geometry::{DVec3, Vec3};
use std::f64::consts::TAU;

/// What is added for each number.
const STEP: u64 = 0x9E37_79B9_7F4A_7C15;

/// The output function of SplitMix64: a permutation whose values look random even for successive arguments.
#[inline]
pub fn mixed(value: u64) -> u64 {
    let mut z = value.wrapping_add(STEP);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// One stream of random numbers.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Random {
        Random(seed)
    }

    /// The stream of one trial: numbers of different `coordinates` have nothing to do with each other.
    pub fn stream(seed: u64, coordinates: &[u64]) -> Random {
        let mut random = Random::new(seed);
        for &coordinate in coordinates {
            random = Random(random.bits() ^ coordinate.wrapping_mul(0xD1B5_4A32_D192_ED03));
        }
        Random(random.bits())
    }

    pub fn bits(&mut self) -> u64 {
        let bits = mixed(self.0);
        self.0 = self.0.wrapping_add(STEP);
        bits
    }

    /// Uniform in [0, 1), 53 bits.
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in [0, 1), 24 bits.
    pub fn unit(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1u32 << 24) as f32
    }

    /// Uniform in [low, high).
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Uniform in -1..1.
    pub fn signed(&mut self) -> f64 {
        2.0 * self.uniform() - 1.0
    }

    /// Uniform in 0..`n`; `n` is not 0.
    pub fn below(&mut self, n: u64) -> u64 {
        ((u128::from(self.bits()) * u128::from(n)) >> 64) as u64
    }

    /// Uniform in a disk of radius `radius` around `center`, perpendicular to `axis`.
    pub fn in_disk(&mut self, center: DVec3, radius: f64, axis: DVec3) -> Vec3 {
        let (u, v) = axis.normalize().any_orthonormal_pair();
        let r = radius * self.uniform().sqrt();
        let (sin, cos) = (TAU * self.uniform()).sin_cos();
        (center + r * (cos * u + sin * v)).as_vec3()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_numbers_are_the_published_ones() {
        // From the reference implementation with seed 1234567.
        let mut random = Random::new(1234567);
        let expected = [6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431];
        assert_eq!([0; 4].map(|_| random.bits()), expected);
    }

    #[test]
    fn a_disk_is_filled_evenly_and_lies_across_its_axis() {
        let mut random = Random::stream(1, &[2, 3]);
        let (center, axis) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(1.0, -1.0, 0.5));
        let points: Vec<DVec3> =
            (0..4000).map(|_| random.in_disk(center, 8.0, axis).as_dvec3() - center).collect();
        assert!(points.iter().all(|p| p.length() < 8.0 + 1e-5 && p.dot(axis).abs() < 1e-4));
        let inner = points.iter().filter(|p| p.length() < 4.0).count() as f64 / 4000.0;
        assert!((inner - 0.25).abs() < 0.03, "a quarter of the area: {inner}");
    }
}
