//! The Cornell box (Goral, Torrance, Greenberg and Battaile, SIGGRAPH 1984), to our own measures in metres.

use super::{Builder, Point};
use crate::geometry::Vec3;
use crate::mesh::{Faces, Material, Mesh};

/// A closed room of 5.5 m with an open front, a red and a green wall, two boxes and a light in the ceiling: 36 triangles.
/// It looks along +z; a camera at (2.75, 2.75, -8) with a view of 39 degrees sees all of it.
pub fn cornell_box() -> Mesh {
    const SIZE: f64 = 5.5;
    let mut b = Builder::new();
    let white = b.matt("white", 0.73, 0.73, 0.73);
    let red = b.matt("red", 0.65, 0.05, 0.05);
    let green = b.matt("green", 0.12, 0.45, 0.15);
    let light = b.material(Material {
        name: "light".to_owned(),
        emission: Vec3::new(17.0, 12.0, 4.0),
        diffuse: Vec3::splat(0.75),
        ..Material::default()
    });
    let s = SIZE;
    b.part("room", white, Faces::Triangles);
    b.rectangle([[0.0, 0.0, 0.0], [0.0, 0.0, s], [s, 0.0, s], [s, 0.0, 0.0]]);
    b.rectangle([[0.0, s, 0.0], [s, s, 0.0], [s, s, s], [0.0, s, s]]);
    b.rectangle([[0.0, 0.0, s], [0.0, s, s], [s, s, s], [s, 0.0, s]]);
    b.part("left wall", red, Faces::Triangles);
    b.rectangle([[s, 0.0, 0.0], [s, 0.0, s], [s, s, s], [s, s, 0.0]]);
    b.part("right wall", green, Faces::Triangles);
    b.rectangle([[0.0, 0.0, 0.0], [0.0, s, 0.0], [0.0, s, s], [0.0, 0.0, s]]);
    b.part("light", light, Faces::Triangles);
    // A little below the ceiling, facing down.
    let (y, x0, x1, z0, z1) = (s - 0.01, 2.1, 3.4, 2.2, 3.3);
    b.rectangle([[x0, y, z0], [x1, y, z0], [x1, y, z1], [x0, y, z1]]);
    // Turned by Pythagorean angles, so that cosine and sine are short decimals.
    b.part("short box", white, Faces::Triangles);
    b.cuboid([-0.82, 0.0, -0.82], [0.82, 1.65, 0.82], turned([1.85, 1.7], 0.96, 0.28));
    b.part("tall box", white, Faces::Triangles);
    b.cuboid([-0.83, 0.0, -0.83], [0.83, 3.3, 0.83], turned([3.7, 3.5], 0.936, -0.352));
    b.finish()
}

/// Turned about the vertical, then moved to (x, z).
fn turned([x, z]: [f64; 2], cos: f64, sin: f64) -> impl Fn(Point) -> Point {
    move |p| [x + cos * p[0] + sin * p[2], p[1], z + cos * p[2] - sin * p[0]]
}
