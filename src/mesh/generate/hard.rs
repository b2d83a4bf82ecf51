//! Scenes that are hard on builders and on traversal: needles, triangles in the same place, and quads that are not flat.

use super::{Builder, circle, direction};
use crate::mesh::{Faces, Mesh};
use crate::random::Random;

/// Long thin triangles: needles at all angles, a fan of blades around one vertex, and a stack of large sheets so close
/// together and so flat that rays along them graze all of them.
pub fn slivers(needles: u32, seed: u64) -> Mesh {
    let mut random = Random::new(seed);
    let mut b = Builder::new();
    let grey = b.matt("grey", 0.6, 0.6, 0.6);
    b.part("needles", grey, Faces::Triangles);
    for _ in 0..needles {
        let start: [f64; 3] = std::array::from_fn(|_| random.range(-1.0, 1.0));
        let (along, across) = (direction(&mut random), direction(&mut random));
        let length = random.range(0.3, 2.0);
        // From one in a hundred to one in a million.
        let width = length / [1e2, 1e3, 1e4, 1e6][random.bits() as usize % 4];
        let corners = [
            start,
            std::array::from_fn(|axis| start[axis] + length * along[axis]),
            std::array::from_fn(|axis| start[axis] + 0.5 * length * along[axis] + width * across[axis]),
        ];
        let [i, j, k] = corners.map(|corner| b.vertex(corner));
        b.triangle(i, j, k);
    }
    b.part("fan", grey, Faces::Triangles);
    let hub = b.vertex([0.0, 0.0, 0.0]);
    const BLADES: u32 = 180;
    for blade in 0..BLADES {
        let turn = f64::from(blade) / f64::from(BLADES);
        let (left, right) = (circle(turn), circle(turn + 1e-4));
        let i = b.vertex([3.0 * left.0, 0.2 * left.1, 3.0 * left.1]);
        let j = b.vertex([3.0 * right.0, 0.2 * right.1, 3.0 * right.1]);
        b.triangle(hub, i, j);
    }
    b.part("sheets", grey, Faces::Triangles);
    for sheet in 0..40 {
        let y = -1.5 + 1e-4 * f64::from(sheet);
        let slope = 1e-5 * f64::from(sheet % 7);
        b.rectangle([[-3.0, y, -3.0], [-3.0, y + slope, 3.0], [3.0, y + slope, 3.0], [3.0, y, -3.0]]);
    }
    b.finish()
}

/// Triangles in the same place: copies, copies turned over, two tessellations of one plane, edges that meet in a T, and
/// triangles without area. Every ray at them has a tie to break.
pub fn coincident() -> Mesh {
    const CELLS: u32 = 8;
    let mut b = Builder::new();
    let grey = b.matt("grey", 0.6, 0.6, 0.6);
    let plane = |y: f64| move |u: f64, v: f64| [4.0 * u - 2.0, y, 2.0 - 4.0 * v];
    b.part("same", grey, Faces::Triangles);
    for _ in 0..3 {
        b.sheet(CELLS, CELLS, plane(0.0));
    }
    b.part("turned over", grey, Faces::Triangles);
    b.sheet(CELLS, CELLS, |u, v| plane(0.0)(v, u));
    b.part("other tessellation", grey, Faces::Triangles);
    b.sheet(CELLS - 3, CELLS + 3, plane(0.0));
    b.part("T-junctions", grey, Faces::Triangles);
    // Walls whose lower edge is one segment and whose upper neighbour has seven.
    b.sheet(1, 1, |u, v| [4.0 * u - 2.0, v, -2.0]);
    b.sheet(7, 1, |u, v| [4.0 * u - 2.0, 1.0 + v, -2.0]);
    b.sheet(3, 2, |u, v| [-2.0, 2.0 * v, 2.0 - 4.0 * u]);
    b.sheet(5, 1, |u, v| [-2.0, 2.0 + v, 2.0 - 4.0 * u]);
    b.part("no area", grey, Faces::Triangles);
    for i in 0..32 {
        let x = f64::from(i) / 8.0 - 2.0;
        let [p, q, r] =
            [[x, 1.0, 0.0], [x + 0.5, 1.5, 0.25], [x + 1.0, 2.0, 0.5]].map(|point| b.vertex(point));
        b.triangle(p, q, r);
        b.triangle(p, p, r);
        b.triangle(q, q, q);
    }
    b.part("one point, many times", grey, Faces::Triangles);
    let [p, q, r] = [[0.0, 3.0, 0.0], [0.5, 3.0, 0.0], [0.0, 3.5, 0.0]].map(|point| b.vertex(point));
    for _ in 0..64 {
        b.triangle(p, q, r);
    }
    b.finish()
}

/// A scene of quads: a flat floor, a wavy sheet whose quads are not flat, boxes, and one part of plain triangles.
/// About 4 `cells`² triangles.
pub fn quads(cells: u32) -> Mesh {
    let mut b = Builder::new();
    let grey = b.matt("grey", 0.6, 0.6, 0.6);
    let blue = b.matt("blue", 0.2, 0.3, 0.6);
    b.part("floor", grey, Faces::Quads);
    b.sheet(cells, cells, |u, v| [8.0 * u - 4.0, 0.0, 4.0 - 8.0 * v]);
    b.part("waves", blue, Faces::Quads);
    b.sheet(cells, cells, |u, v| {
        // The product makes a saddle of each quad.
        let height = 2.0 + 0.4 * circle(1.5 * u).1 * circle(2.0 * v).0 + 0.3 * (u - 0.5) * (v - 0.5);
        [6.0 * u - 3.0, height, 3.0 - 6.0 * v]
    });
    b.part("boxes", grey, Faces::Quads);
    for i in 0..9 {
        let (x, z) = (f64::from(i % 3) * 2.0 - 2.0, f64::from(i / 3) * 2.0 - 2.0);
        let (cos, sin) = circle(f64::from(i) / 40.0);
        b.cuboid([-0.4, 0.0, -0.4], [0.4, 0.5 + 0.1 * f64::from(i), 0.4], |p| {
            [x + cos * p[0] + sin * p[2], p[1], z + cos * p[2] - sin * p[0]]
        });
    }
    b.part("cone", blue, Faces::Triangles);
    let tip = b.vertex([0.0, 4.0, 0.0]);
    let rim: Vec<u32> = (0..12)
        .map(|i| {
            let (cos, sin) = circle(f64::from(i) / 12.0);
            b.vertex([cos, 3.0, sin])
        })
        .collect();
    for (i, &corner) in rim.iter().enumerate() {
        b.triangle(tip, rim[(i + 1) % rim.len()], corner);
    }
    b.finish()
}
