//! Scenes that move: frames of one mesh, the same faces in each, as a function of time from 0 to 1.

use super::{Builder, Point, circle, direction};
use crate::mesh::{Faces, Mesh};
use crate::random::Random;

/// A sequence; each is about the size that is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sequence {
    /// A column between floor and ceiling, twisted by a turn and a half: what was beside it comes to lie around it.
    Twist,
    /// A sphere whose triangles fly apart, tumbling.
    Burst,
    /// A cloth that waves and folds over itself.
    Cloth,
    /// Two spheres that pass through each other.
    Crossing,
}

impl Sequence {
    pub const ALL: [Sequence; 4] = [Sequence::Twist, Sequence::Burst, Sequence::Cloth, Sequence::Crossing];

    pub fn name(self) -> &'static str {
        match self {
            Sequence::Twist => "twist",
            Sequence::Burst => "burst",
            Sequence::Cloth => "cloth",
            Sequence::Crossing => "crossing",
        }
    }

    /// The frame at `time`, of about `triangles` triangles.
    pub fn frame(self, triangles: u32, time: f64) -> Mesh {
        let mut b = Builder::new();
        match self {
            Sequence::Twist => twist(&mut b, triangles, time),
            Sequence::Burst => burst(&mut b, triangles, time),
            Sequence::Cloth => cloth(&mut b, triangles, time),
            Sequence::Crossing => crossing(&mut b, triangles, time),
        }
        b.finish()
    }
}

/// The side of a square sheet of so many triangles.
fn side(triangles: f64) -> u32 {
    ((triangles / 2.0).sqrt().round() as u32).max(2)
}

/// The floor of all sequences, 10 units wide.
fn floor(b: &mut Builder) {
    let grey = b.matt("floor", 0.6, 0.6, 0.6);
    b.part("floor", grey, Faces::Triangles);
    b.sheet(16, 16, |u, v| [10.0 * u - 5.0, 0.0, 5.0 - 10.0 * v]);
}

/// A square column with fins, so that its cross-section is no circle.
fn twist(b: &mut Builder, triangles: u32, time: f64) {
    floor(b);
    let red = b.matt("column", 0.7, 0.3, 0.2);
    b.part("column", red, Faces::Triangles);
    let around = side(f64::from(triangles));
    b.sheet(around, around, |u, v| {
        // Eight fins: the radius goes in and out along the circumference.
        let (wave, _) = circle(8.0 * u);
        let radius = 1.0 + 0.35 * wave;
        let (cos, sin) = circle(u + 1.5 * time * v);
        [radius * cos, 4.0 * v, -radius * sin]
    });
}

/// Each triangle has vertices of its own, flies outwards and turns about itself.
fn burst(b: &mut Builder, triangles: u32, time: f64) {
    floor(b);
    let yellow = b.matt("shell", 0.8, 0.6, 0.2);
    b.part("shell", yellow, Faces::Triangles);
    let mut random = Random::new(3);
    let segments = side(f64::from(triangles));
    let at = |column: u32, row: u32| -> Point {
        let (cos, sin) = circle(f64::from(column) / f64::from(segments));
        // Open at the poles, where triangles would have no area.
        let (up, out) = circle(0.01 + 0.48 * f64::from(row) / f64::from(segments));
        [out * cos, 2.5 - up, out * sin]
    };
    for row in 0..segments {
        for column in 0..segments {
            let [a, b1, c, d] =
                [at(column, row), at(column + 1, row), at(column + 1, row + 1), at(column, row + 1)];
            for corners in [[a, b1, c], [a, c, d]] {
                let centre: Point =
                    [0, 1, 2].map(|axis| corners.iter().map(|corner| corner[axis]).sum::<f64>() / 3.0);
                let speed = random.range(0.5, 2.0);
                let axis = direction(&mut random);
                let turns = random.range(-1.0, 1.0) * time;
                let moved = [0, 1, 2].map(|k| centre[k] + speed * time * (centre[k] - [0.0, 2.5, 0.0][k]));
                let placed = corners.map(|corner| {
                    let arm = turned([0, 1, 2].map(|k| corner[k] - centre[k]), axis, turns);
                    b.vertex([0, 1, 2].map(|k| moved[k] + arm[k]))
                });
                b.triangle(placed[0], placed[1], placed[2]);
            }
        }
    }
}

/// A vector turned about a unit axis (Rodrigues).
fn turned(v: Point, axis: Point, turns: f64) -> Point {
    let (cos, sin) = circle(turns);
    let along: f64 = (0..3).map(|k| axis[k] * v[k]).sum();
    let cross =
        [axis[1] * v[2] - axis[2] * v[1], axis[2] * v[0] - axis[0] * v[2], axis[0] * v[1] - axis[1] * v[0]];
    [0, 1, 2].map(|k| cos * v[k] + sin * cross[k] + (1.0 - cos) * along * axis[k])
}

/// Waves run through it while it is folded in half, one side over the other.
fn cloth(b: &mut Builder, triangles: u32, time: f64) {
    floor(b);
    let blue = b.matt("cloth", 0.2, 0.3, 0.7);
    b.part("cloth", blue, Faces::Triangles);
    let cells = side(f64::from(triangles));
    b.sheet(cells, cells, |u, v| {
        let (_, ripple) = circle(2.0 * u + 1.5 * time);
        let (_, swell) = circle(3.0 * v - time + 0.5 * u);
        let height = 0.12 * ripple + 0.08 * swell;
        // The left half turns about the middle, up to just before it lies on the right one.
        let (x, lift) = if u < 0.5 {
            let (cos, sin) = circle(0.48 * time);
            let arm = 4.0 * (0.5 - u);
            (-arm * cos - height * sin, arm * sin + height * cos)
        } else {
            (4.0 * (u - 0.5), height)
        };
        [x, 1.0 + lift, 2.0 - 4.0 * v]
    });
}

/// One sphere from left to right, the other from right to left.
fn crossing(b: &mut Builder, triangles: u32, time: f64) {
    floor(b);
    let half = f64::from(triangles) / 2.0;
    for (name, sign, [red, green, blue]) in
        [("first", 1.0, [0.8, 0.4, 0.2]), ("second", -1.0, [0.2, 0.4, 0.8])]
    {
        let material = b.matt(name, red, green, blue);
        b.part(name, material, Faces::Triangles);
        let x = sign * (4.0 * time - 2.0);
        let segments = side(half);
        b.revolve([x, 1.6, 0.2 * sign], segments, segments, |up| {
            let (height, radius) = circle(0.49 - 0.48 * up);
            (1.2 * radius, 1.2 * height)
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_have_the_same_faces_finite_vertices_and_about_the_size_asked_for() {
        for sequence in Sequence::ALL {
            let frames = [0.0, 0.3, 1.0].map(|time| sequence.frame(20_000, time));
            let count = frames[0].triangle_count();
            assert!((15_000..25_000).contains(&count), "{}: {count}", sequence.name());
            for frame in &frames {
                assert!(frame.vertices.iter().all(|v| v.is_finite()));
                assert_eq!(frame.parts, frames[0].parts);
            }
            let moved = frames[0].vertices.iter().zip(&frames[2].vertices).filter(|(a, b)| a != b).count();
            assert!(2 * moved > frames[0].vertices.len(), "{}: {moved}", sequence.name());
            assert_eq!(sequence.frame(20_000, 0.3).vertices, frames[1].vertices);
        }
    }

    #[test]
    fn every_triangle_has_an_area() {
        for sequence in Sequence::ALL {
            for time in [0.0, 0.5, 1.0] {
                let triangles = sequence.frame(2000, time).triangles();
                assert!(triangles.iter().all(|triangle| triangle.scaled_normal().length() > 0.0));
            }
        }
    }

    #[test]
    fn turning_keeps_lengths_and_the_axis() {
        let axis = [0.6, 0.0, 0.8];
        let v = [1.0, 2.0, 3.0];
        let length = |v: Point| v.iter().map(|x| x * x).sum::<f64>();
        assert!((length(turned(v, axis, 0.3)) - length(v)).abs() < 1e-12);
        assert!(turned(axis, axis, 0.3).iter().zip(axis).all(|(a, b)| (a - b).abs() < 1e-12));
        let quarter = turned([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], 0.25);
        assert!((quarter[1] - 1.0).abs() < 1e-12);
    }
}
