//! Queries in an order of their own before they are replayed: those that run alike after each other.
//!
//! A key is the octant of the direction, then places on a Morton curve, as in Moon et al., "Cache-oblivious ray reordering" (2010), and its
//! predecessors: of the origin, of the direction, or of both interleaved.

use crate::geometry::{Aabb, Ray, Vec3};

/// What comes first in the key, after the octant of the direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Sort {
    /// Where rays begin, then where they go
    Origin,
    /// Where rays go, then where they begin
    Direction,
    /// Both, bit by bit in turn
    Both,
}

impl Sort {
    pub const ALL: [Sort; 3] = [Sort::Origin, Sort::Direction, Sort::Both];

    /// The name in options, tables and JSON.
    pub fn key(self) -> &'static str {
        match self {
            Sort::Origin => "origin",
            Sort::Direction => "direction",
            Sort::Both => "both",
        }
    }

    /// Sorts `queries`; those of equal keys stay as they are.
    pub fn apply<T>(self, queries: &mut [T], ray: impl Fn(&T) -> Ray) {
        let origins = queries
            .iter()
            .map(|query| ray(query).origin)
            .filter(|origin| origin.is_finite())
            .fold(Aabb::EMPTY, |bounds, origin| bounds.grown(origin));
        queries.sort_by_cached_key(|query| self.place(&ray(query), &origins));
    }

    /// The key of a ray among rays that begin in `origins`: 3 bits of the octant, and 10 of each coordinate.
    fn place(self, ray: &Ray, origins: &Aabb) -> u64 {
        let octant = (0..3).map(|axis| u64::from(ray.direction[axis] < 0.0) << axis).sum::<u64>();
        let origin = steps(ray.origin, origins);
        let length = ray.direction.abs().max_element();
        let direction = steps(ray.direction / length, &Aabb { lower: Vec3::NEG_ONE, upper: Vec3::ONE });
        let after = match self {
            Sort::Origin => interleaved(&origin) << 30 | interleaved(&direction),
            Sort::Direction => interleaved(&direction) << 30 | interleaved(&origin),
            Sort::Both => {
                let [[a, b, c], [d, e, f]] = [origin, direction];
                interleaved(&[a, b, c, d, e, f])
            }
        };
        octant << 60 | after
    }
}

/// A point in 1024 steps from `bounds`' lower to its upper end; NaN at the lower end.
fn steps(point: Vec3, bounds: &Aabb) -> [u64; 3] {
    let share = (point - bounds.lower) / bounds.extent();
    share.to_array().map(|share| (share * 1024.0).clamp(0.0, 1023.0) as u64)
}

/// The bits of 10-bit numbers in turn, the highest first.
fn interleaved(numbers: &[u64]) -> u64 {
    (0..10)
        .rev()
        .flat_map(|bit| numbers.iter().map(move |number| number >> bit & 1))
        .fold(0, |key, bit| key << 1 | bit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    fn ray(origin: Vec3, direction: Vec3) -> Ray {
        Ray { origin, tnear: 0.0, direction, tfar: f32::INFINITY }
    }

    #[test]
    fn bits_are_taken_in_turn() {
        assert_eq!(interleaved(&[0b11, 0b00, 0b10]), 0b101_100);
        assert_eq!(interleaved(&[1023; 6]), (1 << 60) - 1);
    }

    #[test]
    fn octants_come_first_and_neighbours_stay_together() {
        let random = &mut Random::new(8);
        let mut vector = || Vec3::from_array([0; 3].map(|_| random.signed() as f32));
        let rays: Vec<Ray> = (0..2000).map(|_| ray(vector(), vector())).collect();
        for sort in Sort::ALL {
            let mut sorted = rays.clone();
            sort.apply(&mut sorted, |ray| *ray);
            let octant =
                |ray: &Ray| (0..3).map(|axis| u8::from(ray.direction[axis] < 0.0) << axis).sum::<u8>();
            assert!(sorted.is_sorted_by_key(octant), "{sort:?}");
            // How far apart consecutive rays are in what the order goes by.
            let apart = |rays: &[Ray]| -> f32 {
                let difference = |pair: &[Ray]| {
                    let origin = pair[0].origin.distance(pair[1].origin);
                    let direction = pair[0].direction.normalize().distance(pair[1].direction.normalize());
                    match sort {
                        Sort::Origin => origin,
                        Sort::Direction => direction,
                        Sort::Both => origin + direction,
                    }
                };
                rays.windows(2).map(difference).sum()
            };
            assert!(apart(&sorted) < 0.5 * apart(&rays), "{sort:?}: {} {}", apart(&sorted), apart(&rays));
            // Nothing is lost.
            let bits = |rays: &[Ray]| {
                let mut all: Vec<_> =
                    rays.iter().map(|ray| ray.origin.to_array().map(f32::to_bits)).collect();
                all.sort();
                all
            };
            assert_eq!(bits(&sorted), bits(&rays));
        }
    }

    #[test]
    fn rays_without_direction_or_place_have_a_key_too() {
        for odd in [Vec3::NAN, Vec3::INFINITY, Vec3::ZERO, Vec3::splat(1e-42)] {
            let mut rays = [ray(odd, odd), ray(Vec3::ONE, odd), ray(odd, Vec3::X)];
            Sort::ALL.iter().for_each(|sort| sort.apply(&mut rays, |ray| *ray));
        }
        Sort::Both.apply(&mut [] as &mut [Ray], |ray| *ray);
    }
}
