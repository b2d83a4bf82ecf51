//! Scenes of any size, for measuring how time and memory grow.

use super::Builder;
use crate::mesh::{Faces, Mesh};
use crate::random::Random;

/// A landscape of fractal noise: about `triangles` triangles in a square grid, neighbours in memory near in space.
pub fn terrain(triangles: usize, seed: u64) -> Mesh {
    let cells = ((triangles as f64 / 2.0).sqrt() as u32).max(1);
    let mut b = Builder::new();
    let green = b.matt("ground", 0.4, 0.45, 0.25);
    b.part("terrain", green, Faces::Triangles);
    b.sheet(cells, cells, |u, v| {
        let mut height = 0.0;
        let (mut scale, mut weight) = (4.0, 6.0);
        for octave in 0..9 {
            height += weight * noise(scale * u, scale * v, seed.wrapping_add(octave));
            scale *= 2.0;
            weight *= 0.5;
        }
        [100.0 * u - 50.0, height, 50.0 - 100.0 * v]
    });
    b.finish()
}

/// Value noise in -1..1: random numbers at whole coordinates, smoothly interpolated.
fn noise(x: f64, y: f64, seed: u64) -> f64 {
    let (column, row) = (x.floor(), y.floor());
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let (u, v) = (smooth(x - column), smooth(y - row));
    let at = |dx: u64, dy: u64| {
        let (i, j) = (column as u64 + dx, row as u64 + dy);
        Random::new(seed ^ i.wrapping_mul(0xD6E8_FEB8_6659_FD93) ^ j.wrapping_mul(0xA3B1_9535_4A39_B70D))
            .range(-1.0, 1.0)
    };
    let bottom = at(0, 0) + (at(1, 0) - at(0, 0)) * u;
    let top = at(0, 1) + (at(1, 1) - at(0, 1)) * u;
    bottom + (top - bottom) * v
}

/// Exactly `triangles` unconnected triangles at random in a cube, of a size that keeps the share of occupied space the same:
/// the opposite of [`terrain`], with no order in memory at all.
pub fn soup(triangles: usize, seed: u64) -> Mesh {
    let mut random = Random::new(seed);
    let mut b = Builder::new();
    let grey = b.matt("grey", 0.6, 0.6, 0.6);
    b.part("soup", grey, Faces::Triangles);
    // The cube root by Newton's method: the library's is not the same everywhere.
    let count = triangles.max(1) as f64;
    let mut root = count;
    for _ in 0..120 {
        root = (2.0 * root + count / (root * root)) / 3.0;
    }
    let size = 10.0 / root;
    for _ in 0..triangles {
        let centre: [f64; 3] = std::array::from_fn(|_| random.range(-10.0, 10.0));
        let corners: [u32; 3] = std::array::from_fn(|_| {
            b.vertex(centre.map(|coordinate| coordinate + random.range(-size, size)))
        });
        b.triangle(corners[0], corners[1], corners[2]);
    }
    b.finish()
}
