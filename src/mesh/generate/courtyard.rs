//! A courtyard with arcades on two floors: what a renderer meets in architecture, at any size.
//!
//! Columns, arches and balusters hide the galleries behind them from most directions, leaves overlap in the trees, and the large
//! plain walls meet small round shapes everywhere. All of it is tessellated along `detail`, so the number of triangles grows
//! with its square while the picture stays the same.

use super::{Builder, Point, along, circle, direction};
use crate::geometry::Vec3;
use crate::mesh::{Faces, Material, Mesh};
use crate::random::Random;

/// Half the width of the court, and of the outer walls.
const COURT: f64 = 6.0;
const OUTER: f64 = 9.0;
const BAYS: u32 = 3;
const BAY: f64 = 2.0 * COURT / BAYS as f64;
/// Half the thickness of the arcade's wall.
const WALL: f64 = 0.28;
/// Lower edge and height of each floor.
const FLOORS: [(f64, f64); 2] = [(0.0, 4.4), (4.4, 3.6)];
const EAVES: f64 = 8.0;

/// The courtyard. `detail` 1 has 5 thousand triangles, 18 a million, 56 ten million. The court's middle is the origin, y is
/// up, one unit is a metre; a camera at (5, 1.7, 1.5) looking at (-4, 2.9, -3) stands inside under the open sky.
pub fn courtyard(detail: u32, seed: u64) -> Mesh {
    let detail = detail.max(1);
    let mut b = Builder::new();
    let stone = b.matt("stone", 0.72, 0.66, 0.55);
    let marble = b.matt("marble", 0.80, 0.78, 0.74);
    let plaster = b.matt("plaster", 0.76, 0.56, 0.38);
    let tiles = b.matt("tiles", 0.60, 0.24, 0.14);
    let paving = b.matt("paving", 0.48, 0.46, 0.43);
    let leaves = b.matt("leaves", 0.16, 0.34, 0.09);
    let clay = b.matt("clay", 0.55, 0.30, 0.20);
    let water = b.material(Material {
        name: "water".to_owned(),
        diffuse: Vec3::new(0.02, 0.06, 0.07),
        specular: Vec3::splat(0.6),
        ..Material::default()
    });

    b.part("paving", paving, Faces::Triangles);
    let cells = 6 * detail;
    b.sheet(cells, cells, |u, v| {
        let (x, z) = (2.0 * OUTER * u - OUTER, OUTER - 2.0 * OUTER * v);
        // Rises a little towards the middle, as courts do to shed the rain.
        [x, 0.06 - 0.0012 * (x * x + z * z).min(50.0), z]
    });
    for side in 0..4 {
        b.part("walls", plaster, Faces::Triangles);
        back_wall(&mut b, side, detail);
        b.part("arches", stone, Faces::Triangles);
        for floor in FLOORS {
            for bay in 0..BAYS {
                arch(&mut b, side, bay, floor, detail);
            }
            corner_pier(&mut b, side, floor);
        }
        b.part("columns", marble, Faces::Triangles);
        for floor in FLOORS {
            for bay in 1..BAYS {
                column(&mut b, side, bay, floor, detail);
            }
        }
        for bay in 0..BAYS {
            balustrade(&mut b, side, bay, detail);
        }
        b.part("vaults", plaster, Faces::Triangles);
        for floor in FLOORS {
            vault(&mut b, side, floor, detail);
        }
        b.part("roof", tiles, Faces::Triangles);
        roof(&mut b, side, detail);
    }
    b.part("fountain", marble, Faces::Triangles);
    fountain(&mut b, detail);
    b.part("water", water, Faces::Triangles);
    pool(&mut b, detail);
    let mut random = Random::new(seed);
    for corner in 0..4 {
        let centre = turned(corner, [3.9, 0.0, 3.9]);
        b.part("pots", clay, Faces::Triangles);
        b.revolve(centre, 4 + 2 * detail, 3 * detail, |f| {
            along(&[(0.30, 0.0), (0.45, 0.7), (0.50, 0.75), (0.0, 0.70)], f)
        });
        b.part("leaves", leaves, Faces::Triangles);
        foliage(&mut b, [centre[0], 1.75, centre[2]], 70 * detail * detail, f64::from(detail), &mut random);
    }
    b.finish()
}

/// Side 0 runs along x at z = -`COURT`, its galleries behind it towards -z; the others are its quarter turns, which are exact.
fn turned(side: u32, [x, y, z]: Point) -> Point {
    match side {
        0 => [x, y, z],
        1 => [-z, y, x],
        2 => [-x, y, -z],
        _ => [z, y, -x],
    }
}

fn arch(b: &mut Builder, side: u32, bay: u32, (bottom, height): (f64, f64), detail: u32) {
    let centre = -COURT + BAY * (f64::from(bay) + 0.5);
    let radius = 0.5 * BAY - WALL;
    let spring = bottom + height - radius - 0.55;
    let top = bottom + height;
    let steps = 5 * detail;
    // Half a turn from the left end to the right; the outline above it has a straight piece over each column.
    let inner = |f: f64| {
        let (cos, sin) = circle(0.5 - 0.5 * f);
        (centre + radius * cos, spring + radius * sin)
    };
    let outer = |f: f64| (centre + BAY * (f - 0.5), top);
    for (z, front) in [(-COURT + WALL, true), (-COURT - WALL, false)] {
        b.sheet(steps, detail, |u, v| {
            let u = if front { u } else { 1.0 - u };
            let ((x0, y0), (x1, y1)) = (inner(u), outer(u));
            turned(side, [x0 + (x1 - x0) * v, y0 + (y1 - y0) * v, z])
        });
        // Down to the capitals, beside the arch.
        for end in [0.0, 1.0] {
            let (near, far) = (inner(end).0, outer(end).0);
            let (low, high) = if near < far { (near, far) } else { (far, near) };
            let (left, right) = if front { (low, high) } else { (high, low) };
            let corner = |x, y| turned(side, [x, y, z]);
            let shoulder = |x: f64| if x == near { spring } else { top };
            b.rectangle([
                corner(left, spring),
                corner(right, spring),
                corner(right, shoulder(right)),
                corner(left, shoulder(left)),
            ]);
        }
    }
    b.sheet(steps, detail, |u, v| {
        let (x, y) = inner(u);
        turned(side, [x, y, -COURT - WALL + 2.0 * WALL * v])
    });
}

/// Where four columns would meet in a corner stands one square pier.
fn corner_pier(b: &mut Builder, side: u32, (bottom, height): (f64, f64)) {
    let size = 1.4 * WALL;
    b.cuboid([-COURT - size, bottom, -COURT - size], [-COURT + size, bottom + height, -COURT + size], |p| {
        turned(side, p)
    });
}

fn column(b: &mut Builder, side: u32, bay: u32, (bottom, height): (f64, f64), detail: u32) {
    let x = -COURT + BAY * f64::from(bay);
    let shaft = height - (0.5 * BAY - WALL) - 0.55;
    let place = move |p: Point| turned(side, [x + p[0], bottom + p[1], -COURT + p[2]]);
    let radius = 0.8 * WALL;
    b.cuboid([-WALL, 0.0, -WALL], [WALL, 0.18, WALL], place);
    b.cuboid([-WALL, shaft - 0.14, -WALL], [WALL, shaft, WALL], place);
    let profile = [
        (1.2 * radius, 0.18),
        (1.15 * radius, 0.28),
        (radius, 0.34),
        (1.02 * radius, 0.5 * shaft),
        (0.85 * radius, shaft - 0.42),
        (0.95 * radius, shaft - 0.36),
        (1.25 * radius, shaft - 0.14),
    ];
    let middle = place([0.0; 3]);
    b.revolve(middle, 2 + 4 * detail, 6 * detail, |f| along(&profile, f));
}

/// Between the columns of the upper floor.
fn balustrade(b: &mut Builder, side: u32, bay: u32, detail: u32) {
    const BALUSTERS: u32 = 5;
    let bottom = FLOORS[1].0;
    let left = -COURT + BAY * f64::from(bay) + WALL;
    let width = BAY - 2.0 * WALL;
    let place = move |p: Point| turned(side, [left + p[0], bottom + p[1], -COURT + p[2]]);
    b.cuboid([0.0, 0.82, -0.10], [width, 0.92, 0.10], place);
    for i in 0..BALUSTERS {
        let x = width * (f64::from(i) + 0.5) / f64::from(BALUSTERS);
        let profile = [(0.09, 0.0), (0.05, 0.15), (0.10, 0.35), (0.04, 0.68), (0.08, 0.82)];
        b.revolve(place([x, 0.0, 0.0]), 3 + detail, 2 * detail, |f| along(&profile, f));
    }
}

/// The outer wall, with a rusticated surface: rows of stones whose faces stand out.
fn back_wall(b: &mut Builder, side: u32, detail: u32) {
    let wave = |f: f64| circle(f).1.abs();
    b.sheet(8 * detail, 4 * detail, |u, v| {
        let relief = 0.05 * wave(7.0 * u) * wave(4.0 * v);
        turned(side, [2.0 * OUTER * u - OUTER, EAVES * v, -OUTER + relief])
    });
}

/// The ceiling of a gallery, a quarter ellipse from over the arches down to the outer wall, and the floor on top.
fn vault(b: &mut Builder, side: u32, (bottom, height): (f64, f64), detail: u32) {
    let (near, far) = (-COURT - WALL, -OUTER);
    b.sheet(6 * detail, 4 * detail, |u, v| {
        let (cos, sin) = circle(0.25 * v);
        turned(side, [2.0 * OUTER * u - OUTER, bottom + height - 1.4 + 1.3 * sin, near + (far - near) * cos])
    });
    let top = bottom + height;
    b.rectangle(
        [[-OUTER, top, near], [OUTER, top, near], [OUTER, top, far], [-OUTER, top, far]]
            .map(|p| turned(side, p)),
    );
}

/// A slope of tiles: half rounds side by side, from the eaves up to the outer wall; mitred at the corners.
fn roof(b: &mut Builder, side: u32, detail: u32) {
    b.sheet(14 * detail, 2 * detail, |u, v| {
        let depth = COURT - 0.45 + (OUTER + 0.3 - COURT + 0.45) * v;
        let ridge = 0.07 * circle(12.0 * u).1.abs();
        turned(side, [depth * (2.0 * u - 1.0), EAVES + 0.05 + 1.3 * v + ridge, -depth])
    });
}

fn fountain(b: &mut Builder, detail: u32) {
    let basin = [(1.75, 0.0), (1.75, 0.45), (1.85, 0.5), (1.85, 0.58), (1.55, 0.58), (1.5, 0.1), (0.0, 0.1)];
    let stem = [
        (0.30, 0.1),
        (0.16, 0.4),
        (0.20, 0.9),
        (0.10, 1.25),
        (0.75, 1.5),
        (0.80, 1.58),
        (0.70, 1.55),
        (0.0, 1.38),
    ];
    let segments = 6 + 6 * detail;
    b.revolve([0.0; 3], segments, 6 * detail, |f| along(&basin, f));
    b.revolve([0.0; 3], segments, 7 * detail, |f| along(&stem, f));
}

/// The water in the basin, with rings around the stem.
fn pool(b: &mut Builder, detail: u32) {
    b.revolve([0.0; 3], 6 + 6 * detail, 2 * detail, |f| {
        let radius = 1.53 - 1.33 * f;
        (radius, 0.46 + 0.006 * circle(6.0 * radius).1)
    });
}

/// A ball of leaves: single triangles at all angles, most of them near its surface. They shrink as their number grows.
fn foliage(b: &mut Builder, centre: Point, count: u32, detail: f64, random: &mut Random) {
    let size = 0.22 / detail;
    for _ in 0..count {
        let outwards = direction(random);
        let distance = 1.0 - random.range(0.0, 1.0) * random.range(0.0, 0.6);
        let middle: Point = std::array::from_fn(|axis| centre[axis] + distance * outwards[axis]);
        let corners: [u32; 3] = std::array::from_fn(|_| {
            let offset = direction(random);
            b.vertex(std::array::from_fn(|axis| middle[axis] + size * offset[axis]))
        });
        b.triangle(corners[0], corners[1], corners[2]);
    }
}
