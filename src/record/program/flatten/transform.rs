//! Where an instance puts a scene. Boxes are transformed in double precision and rounded outward, vertices in the same order of
//! operations and rounded to the nearest: so a box holds what it held before.

use crate::geometry::{Aabb, Triangle, Vec3};

/// 3 x 4, row by row, in double precision.
#[derive(Clone, Copy)]
pub struct Transform([[f64; 4]; 3]);

impl Transform {
    pub fn new(rows: &[[f32; 4]; 3]) -> Transform {
        Transform(rows.map(|row| row.map(f64::from)))
    }

    fn point(&self, point: Vec3) -> Vec3 {
        let p = point.as_dvec3();
        Vec3::from(self.0.map(|[x, y, z, w]| (x * p.x + y * p.y + z * p.z + w) as f32))
    }

    pub fn triangle(&self, triangle: &Triangle) -> Triangle {
        Triangle(triangle.0.map(|vertex| self.point(vertex)))
    }

    /// Around the transformed box. Every operation keeps order, so a box inside of another stays inside.
    pub fn bounds(&self, bounds: &Aabb) -> Aabb {
        let (low, high) = (bounds.lower.as_dvec3(), bounds.upper.as_dvec3());
        let corner = |pick: fn(f64, f64) -> f64, round: fn(f64) -> f32| {
            Vec3::from(self.0.map(|[x, y, z, w]| {
                let term = |factor: f64, low: f64, high: f64| pick(factor * low, factor * high);
                round(term(x, low.x, high.x) + term(y, low.y, high.y) + term(z, low.z, high.z) + w)
            }))
        };
        Aabb { lower: corner(f64::min, round_down), upper: corner(f64::max, round_up) }
    }
}

/// The largest number of single precision that is not above.
fn round_down(value: f64) -> f32 {
    let nearest = value as f32;
    if f64::from(nearest) > value { nearest.next_down() } else { nearest }
}

fn round_up(value: f64) -> f32 {
    -round_down(-value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transformed_box_holds_what_it_held() {
        let mut random = crate::random::Random::new(7);
        let mut number = || (random.unit() - 0.5) * 200.0;
        for _ in 0..2000 {
            let mut row = || [number() / 30.0, number() / 30.0, number() / 30.0, number()];
            let transform = Transform::new(&[row(), row(), row()]);
            let triangle = Triangle([(); 3].map(|()| Vec3::new(number(), number(), number())));
            let outer = triangle.bounds().grown(Vec3::new(number(), number(), number()));
            let moved = transform.bounds(&triangle.bounds());
            assert!(moved.contains(&transform.triangle(&triangle).bounds()));
            assert!(transform.bounds(&outer).contains(&moved));
        }
    }
}
