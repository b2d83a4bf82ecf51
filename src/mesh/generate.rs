//! Scenes from our own code: fixtures, demo scenes and scale tests, the same bytes on every machine.
//!
//! Only additions, multiplications, divisions and square roots of `f64` are used, which IEEE 754 defines to the last bit; the
//! system's `sin` and `cos` are not, so `circle` has its own. Rust never fuses a multiplication with an addition. Random
//! numbers come from [`crate::random`].

mod cornell;
mod courtyard;
mod hard;
mod large;
mod sequence;

use super::{Faces, Material, Mesh, Part};
use crate::geometry::Vec3;
use crate::random::Random;
pub use cornell::cornell_box;
pub use courtyard::courtyard;
pub use hard::{coincident, quads, slivers};
pub use large::{soup, terrain};
pub use sequence::Sequence;

/// Uniform on the unit sphere.
fn direction(random: &mut Random) -> [f64; 3] {
    let z = random.range(-1.0, 1.0);
    let radius = (1.0 - z * z).sqrt();
    let (cos, sin) = circle(random.uniform());
    [radius * cos, radius * sin, z]
}

/// Cosine and sine of a number of turns: Taylor's series on an eighth of a turn, exact signs and quarters.
pub(crate) fn circle(turns: f64) -> (f64, f64) {
    let turns = turns - turns.floor();
    let quarter = (4.0 * turns + 0.5).floor();
    let angle = (turns - quarter / 4.0) * std::f64::consts::TAU;
    let square = angle * angle;
    let (mut cos, mut sin) = (1.0, 1.0);
    // Terms below 2^-53 of the sum are left out: |angle| is at most pi / 4.
    let mut n = 18.0;
    while n >= 2.0 {
        cos = 1.0 - cos * square / (n * (n - 1.0));
        sin = 1.0 - sin * square / (n * (n + 1.0));
        n -= 2.0;
    }
    sin *= angle;
    match quarter as u32 % 4 {
        0 => (cos, sin),
        1 => (-sin, cos),
        2 => (-cos, -sin),
        _ => (sin, -cos),
    }
}

/// A mesh under construction: one part at a time, vertices in the order in which shapes ask for them.
pub(crate) struct Builder {
    mesh: Mesh,
}

pub(crate) type Point = [f64; 3];

impl Builder {
    pub fn new() -> Builder {
        Builder { mesh: Mesh::default() }
    }

    /// A matt material; returns its number.
    pub fn matt(&mut self, name: &str, red: f32, green: f32, blue: f32) -> u32 {
        self.material(Material {
            name: name.to_owned(),
            diffuse: Vec3::new(red, green, blue),
            ..Material::default()
        })
    }

    pub fn material(&mut self, material: Material) -> u32 {
        self.mesh.materials.push(material);
        self.mesh.materials.len() as u32 - 1
    }

    /// Starts a part; what follows goes into it.
    pub fn part(&mut self, name: &str, material: u32, faces: Faces) {
        self.mesh.parts.push(Part { name: name.to_owned(), material, faces, indices: Vec::new() });
    }

    pub fn vertex(&mut self, [x, y, z]: Point) -> u32 {
        self.mesh.vertices.push(Vec3::new(x as f32, y as f32, z as f32));
        self.mesh.vertices.len() as u32 - 1
    }

    pub fn triangle(&mut self, a: u32, b: u32, c: u32) {
        if let Some(part) = self.mesh.parts.last_mut() {
            part.indices.extend([a, b, c]);
        }
    }

    /// A quad in a part of quads, two triangles elsewhere; counter-clockwise from its front.
    pub fn quad(&mut self, [a, b, c, d]: [u32; 4]) {
        let Some(part) = self.mesh.parts.last_mut() else { return };
        match part.faces {
            Faces::Quads => part.indices.extend([a, b, c, d]),
            Faces::Triangles => part.indices.extend([a, b, c, a, c, d]),
        }
    }

    /// A rectangle from four corners with vertices of its own.
    pub fn rectangle(&mut self, corners: [Point; 4]) {
        let corners = corners.map(|corner| self.vertex(corner));
        self.quad(corners);
    }

    /// A sheet of `columns` × `rows` quads; `at` maps (column, row) fractions in 0..=1 to points. The front is the side from
    /// which columns run right and rows run up.
    pub fn sheet(&mut self, columns: u32, rows: u32, at: impl Fn(f64, f64) -> Point) {
        let first = self.mesh.vertices.len() as u32;
        for row in 0..=rows {
            for column in 0..=columns {
                self.vertex(at(f64::from(column) / f64::from(columns), f64::from(row) / f64::from(rows)));
            }
        }
        for row in 0..rows {
            for column in 0..columns {
                let a = first + row * (columns + 1) + column;
                let d = a + columns + 1;
                self.quad([a, a + 1, d + 1, d]);
            }
        }
    }

    /// An axis-aligned box, faces outwards, carried into place by `place`.
    pub fn cuboid(&mut self, low: Point, high: Point, place: impl Fn(Point) -> Point) {
        let corner =
            |i: usize| place([0, 1, 2].map(|axis| if i >> axis & 1 == 0 { low[axis] } else { high[axis] }));
        let corners: [u32; 8] = std::array::from_fn(|i| self.vertex(corner(i)));
        for face in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
            self.quad(face.map(|i| corners[i]));
        }
    }

    /// A surface of revolution about the vertical through `centre`: `profile(f)` gives (radius, height) for f in 0..=1, upwards.
    pub fn revolve(&mut self, centre: Point, segments: u32, rings: u32, profile: impl Fn(f64) -> (f64, f64)) {
        self.sheet(segments, rings, |around, up| {
            let (cos, sin) = circle(-around);
            let (radius, height) = profile(up);
            [centre[0] + radius * cos, centre[1] + height, centre[2] + radius * sin]
        });
    }

    pub fn finish(self) -> Mesh {
        self.mesh
    }
}

/// A point on a chain of points, (x, y) pairs spaced evenly over 0..=1.
pub(crate) fn along(chain: &[(f64, f64)], fraction: f64) -> (f64, f64) {
    let last = chain.len() - 1;
    let scaled = fraction * last as f64;
    let index = (scaled.floor() as usize).min(last.saturating_sub(1));
    let f = scaled - index as f64;
    let (a, b) = (chain[index], chain[(index + 1).min(last)]);
    (a.0 + (b.0 - a.0) * f, a.1 + (b.1 - a.1) * f)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn circle_is_right_to_the_last_bits() {
        for i in -100..2000 {
            let turns = f64::from(i) / 777.0;
            let (cos, sin) = circle(turns);
            let angle = turns * std::f64::consts::TAU;
            // The angle itself is rounded, by up to 2e-15 this far out.
            assert!((cos - angle.cos()).abs() < 4e-15 && (sin - angle.sin()).abs() < 4e-15, "{turns}");
        }
        assert_eq!(circle(0.25), (0.0, 1.0));
        assert_eq!(circle(0.5), (-1.0, 0.0));
    }

    #[test]
    fn random_is_splitmix64() {
        // The first outputs for seed 1234567, as published with the reference implementation.
        let mut random = Random::new(1_234_567);
        let outputs: Vec<u64> = (0..3).map(|_| random.bits()).collect();
        assert_eq!(
            outputs,
            [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423]
        );
    }
}
