//! Polygons of every kind against what their triangles must be: counted by exact winding numbers on
//! a lattice, by areas, and from every corner as the first one.

use crate::{indices, read_obj};
use embree_trace::geometry::{DVec3, Vec3};
use embree_trace::mesh::Kind;
use proptest::prelude::*;
use std::collections::BTreeSet;
use std::f64::consts::TAU;
use std::fmt::Write;

type Point = [i64; 2];

/// The triangles of one polygon, and whether it was said to cross itself. Corners number `vertices`
/// from 0.
fn cut(vertices: &[Vec3], corners: &[usize]) -> (Vec<[u32; 3]>, bool) {
    let mut text = String::new();
    for v in vertices {
        writeln!(text, "v {} {} {}", v.x, v.y, v.z).unwrap();
    }
    text.push('f');
    corners.iter().for_each(|corner| write!(text, " {}", corner + 1).unwrap());
    let (mesh, warnings) = read_obj(&text);
    for kind in Kind::ALL {
        assert!(kind == Kind::PolygonAsFan || warnings.count(kind) == 0, "{warnings}");
    }
    let indices = indices(&mesh);
    let (triangles, rest) = indices.as_chunks::<3>();
    assert!(rest.is_empty());
    (triangles.to_vec(), warnings.count(Kind::PolygonAsFan) > 0)
}

/// Twice the signed area of a lattice triangle, exactly.
fn turn(a: Point, b: Point, c: Point) -> i64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Twice the signed area of a closed chain, exactly.
fn twice_area(chain: &[Point]) -> i64 {
    let at = |i: usize| chain[i % chain.len()];
    (0..chain.len()).map(|i| turn([0, 0], at(i), at(i + 1))).sum()
}

/// How often a closed chain runs round `p`, counter-clockwise; `None` on the chain.
fn winding(chain: &[Point], p: Point) -> Option<i64> {
    let mut winding = 0;
    for (i, &a) in chain.iter().enumerate() {
        let b = chain[(i + 1) % chain.len()];
        let side = turn(a, b, p);
        let between = |k: usize| (a[k].min(b[k])..=a[k].max(b[k])).contains(&p[k]);
        if side == 0 && between(0) && between(1) {
            return None;
        }
        if a[1] <= p[1] && p[1] < b[1] && side > 0 {
            winding += 1;
        } else if b[1] <= p[1] && p[1] < a[1] && side < 0 {
            winding -= 1;
        }
    }
    Some(winding)
}

/// Whether two edges of the chain cross inside both.
fn crosses(chain: &[Point]) -> bool {
    let edge = |i: usize| [chain[i], chain[(i + 1) % chain.len()]];
    let apart = |[a, b]: [Point; 2], [c, d]: [Point; 2]| turn(a, b, c).signum() * turn(a, b, d).signum() < 0;
    let cross = |one, other| apart(one, other) && apart(other, one);
    (0..chain.len()).any(|i| (0..i).any(|j| cross(edge(i), edge(j))))
}

/// Units between neighbours of a lattice.
const APART: i64 = 90;

/// A lattice of `side` times `side` points, and two points near the middle of every triangle of
/// least area between them. A region that is bounded by lattice points and edges between them holds
/// two of these, and not both are on one edge.
struct Lattice {
    points: Vec<Point>,
    middles: Vec<Point>,
}

impl Lattice {
    fn new(side: i64) -> Lattice {
        let points: Vec<Point> = (0..side * side).map(|i| [APART * (i % side), APART * (i / side)]).collect();
        let mut middles = BTreeSet::new();
        for &a in &points {
            for &b in &points {
                for &c in points.iter().filter(|&&c| turn(a, b, c) == APART * APART) {
                    let [x, y] = [0, 1].map(|k| (a[k] + b[k] + c[k]) / 3);
                    middles.extend([[x + 1, y + 2], [x - 2, y + 1]]);
                }
            }
        }
        Lattice { points, middles: middles.into_iter().collect() }
    }

    /// Checks a polygon whose corners number lattice points, which stand at `vertices`; returns
    /// whether it was cut right.
    fn check(&self, vertices: &[Vec3], corners: &[usize]) -> bool {
        let chain: Vec<Point> = corners.iter().map(|&corner| self.points[corner]).collect();
        let windings: Vec<Option<i64>> = self.middles.iter().map(|&p| winding(&chain, p)).collect();
        let sense = if twice_area(&chain) < 0 { -1 } else { 1 };
        let once = windings.iter().flatten().all(|&winding| winding == 0 || winding == sense);
        let (triangles, warned) = cut(vertices, corners);
        // Where edges cross that are walked back again, either answer will do.
        assert!(warned || once, "{corners:?}: {triangles:?}");
        assert!(!warned || !once || crosses(&chain), "{corners:?}: {triangles:?}");
        if warned {
            return false;
        }
        let triangles: Vec<[Point; 3]> =
            triangles.iter().map(|triangle| triangle.map(|i| self.points[i as usize])).collect();
        assert!(triangles.iter().all(|&[a, b, c]| sense * turn(a, b, c) >= 0), "{corners:?}: {triangles:?}");
        let covered = triangles.iter().map(|&[a, b, c]| sense * turn(a, b, c)).sum::<i64>();
        assert_eq!(covered, twice_area(&chain).abs(), "{corners:?}: {triangles:?}");
        for (&middle, expected) in self.middles.iter().zip(&windings) {
            let sides = |&[a, b, c]: &[Point; 3]| {
                [turn(a, b, middle), turn(b, c, middle), turn(c, a, middle)].map(|side| sense * side)
            };
            let inside = triangles.iter().filter(|t| sides(t).iter().all(|&side| side > 0)).count();
            let touched = triangles.iter().filter(|t| sides(t).iter().all(|&side| side >= 0)).count();
            // What is on an edge between triangles shows nothing.
            if let Some(expected) = expected
                && inside == touched
            {
                assert_eq!(inside as i64, sense * expected, "{corners:?} {middle:?}: {triangles:?}");
            }
        }
        true
    }
}

/// Where the points of a lattice stand in space.
fn places(lattice: &Lattice, place: impl Fn(f64, f64) -> DVec3) -> Vec<Vec3> {
    lattice.points.iter().map(|&[x, y]| place((x / APART) as f64, (y / APART) as f64).as_vec3()).collect()
}

#[test]
fn every_chain_of_up_to_five_corners_on_nine_points() {
    let lattice = Lattice::new(3);
    let vertices = places(&lattice, |x, y| DVec3::new(x, y, 0.0));
    for count in 4..=5 {
        let right = (0..9_usize.pow(count))
            .filter(|&number| {
                let corners: Vec<usize> = (0..count).map(|i| number / 9_usize.pow(i) % 9).collect();
                lattice.check(&vertices, &corners)
            })
            .count();
        assert!(right > 1_000, "{count}: {right}");
    }
}

/// Chains of neighbours, so that many enclose something once and touch themselves.
fn chains(side: i64) -> impl Strategy<Value = Vec<usize>> {
    let count = (side * side) as usize;
    prop_oneof![
        proptest::collection::vec(0..count, 5..9),
        (0..count, proptest::collection::vec(0..8_usize, 3..40)).prop_map(move |(start, steps)| {
            let mut at = [start as i64 % side, start as i64 / side];
            let mut chain = vec![start];
            let mut walk = |step: [i64; 2], at: &mut [i64; 2]| {
                let next = [at[0] + step[0], at[1] + step[1]];
                if next.iter().all(|k| (0..side).contains(k)) {
                    *at = next;
                    chain.push((at[1] * side + at[0]) as usize);
                }
            };
            for step in steps {
                let step = [[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]][step];
                walk(step, &mut at);
            }
            while at != [start as i64 % side, start as i64 / side] {
                let home = [start as i64 % side - at[0], start as i64 / side - at[1]];
                walk(home.map(i64::signum), &mut at);
            }
            chain
        }),
    ]
    .prop_filter("a polygon", |chain| chain.len() > 3)
}

fn rotated(corners: &[usize], by: usize, reversed: bool) -> Vec<usize> {
    let mut corners = corners.to_vec();
    let count = corners.len();
    corners.rotate_left(by % count);
    if reversed {
        corners.reverse();
    }
    corners
}

fn turned(direction: DVec3, length: f64, x: f64, y: f64) -> DVec3 {
    let (right, up) = direction.normalize().any_orthonormal_pair();
    (right * x + up * y) * length
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn chains_on_a_lattice(corners in chains(5)) {
        let lattice = Lattice::new(5);
        lattice.check(&places(&lattice, |x, y| DVec3::new(x, y, 0.0)), &corners);
    }

    /// Touching corners and edges no longer meet exactly: coordinates are rounded.
    #[test]
    fn chains_on_a_lattice_anywhere(
        corners in chains(4),
        direction in prop::array::uniform3(-1.0_f64..1.0),
        scale in -30..30,
        place in 0..4,
    ) {
        let lattice = Lattice::new(4);
        let direction = DVec3::from(direction);
        prop_assume!(direction.length() > 0.1);
        let scale = f64::from(scale).exp2();
        let vertices = places(&lattice, |x, y| match place {
            0 => turned(direction, scale, x, y),
            // Many times its size from the origin.
            1 => turned(direction, scale, x, y) + DVec3::new(-3e3, 1e3, 2e3) * scale,
            // In UTM, northings are half a metre apart.
            2 => DVec3::new(400_000.0 + 10.3 * x, 5_700_000.0 + 10.3 * y, 33.3),
            // Six digits.
            _ => (turned(direction, 3.0, x, y) * 1e6).round() / 1e6,
        });
        lattice.check(&vertices, &corners);
    }

    #[test]
    fn the_same_triangles_from_every_corner_and_either_way(
        corners in chains(4),
        direction in prop::array::uniform3(-1_i8..=1),
    ) {
        let lattice = Lattice::new(4);
        let direction = DVec3::from(direction.map(f64::from));
        if corners.len() < 5 || direction == DVec3::ZERO {
            return Ok(());
        }
        let vertices = places(&lattice, |x, y| turned(direction, 1.0, x, y));
        let sorted = |by: usize, reversed: bool| {
            let (mut triangles, warned) = cut(&vertices, &rotated(&corners, by, reversed));
            for triangle in &mut triangles {
                if reversed {
                    triangle.reverse();
                }
                let least = (0..3).min_by_key(|&i| triangle[i]).unwrap();
                triangle.rotate_left(least);
            }
            triangles.sort_unstable();
            (triangles, warned)
        };
        let first = sorted(0, false);
        // The fan of a convex polygon, and that of what crosses itself, start at the first corner.
        let fan = first.0.iter().all(|triangle| triangle.contains(&(corners[0] as u32)));
        if first.1 || fan {
            return Ok(());
        }
        for by in 0..corners.len() {
            let other = sorted(by, by % 2 == 1);
            if !other.0.iter().all(|triangle| triangle.contains(&(rotated(&corners, by, by % 2 == 1)[0] as u32))) {
                prop_assert_eq!(&other, &first);
            }
        }
    }
}

/// Twice the vector area of a closed chain.
fn vector_area(points: &[Vec3]) -> DVec3 {
    let origin = points[0].as_dvec3();
    let at = |i: usize| points[i % points.len()].as_dvec3() - origin;
    (0..points.len()).map(|i| at(i).cross(at(i + 1))).sum()
}

/// Checks a simple polygon: its triangles use every corner, turn as it does, and have its area.
#[track_caller]
fn covers(points: &[Vec3]) -> Vec<[u32; 3]> {
    let corners: Vec<usize> = (0..points.len()).collect();
    let (triangles, warned) = cut(points, &corners);
    assert!(!warned);
    assert_eq!(triangles.len(), points.len() - 2);
    let used: BTreeSet<u32> = triangles.as_flattened().iter().copied().collect();
    assert_eq!(used.len(), points.len(), "every corner");
    let area = vector_area(points);
    let mut sum = 0.0;
    for triangle in &triangles {
        let part = vector_area(&triangle.map(|i| points[i as usize]));
        assert!(part.dot(area) > 0.0, "{triangle:?}");
        sum += part.length();
    }
    assert!((sum - area.length()).abs() <= 1e-6 * area.length(), "{sum} {}", area.length());
    triangles
}

fn flat(points: impl IntoIterator<Item = (f64, f64)>) -> Vec<Vec3> {
    points.into_iter().map(|(x, y)| DVec3::new(x, y, 0.0).as_vec3()).collect()
}

#[test]
fn convex_polygons_are_fans_from_the_first_corner() {
    let hexagon = flat([(0.0, 0.0), (1.0, 0.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0), (0.0, 1.0)]);
    assert_eq!(covers(&hexagon), [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]);
    assert_eq!(cut(&hexagon, &[3, 2, 1, 0]).0, [[3, 2, 1], [3, 1, 0]]);
}

#[test]
fn combs_of_any_size() {
    for teeth in [1, 3, 300, 2_500, 25_000] {
        let n = f64::from(teeth);
        let mut comb: Vec<(f64, f64)> = (0..teeth)
            .flat_map(|i| {
                let x = f64::from(2 * i);
                [(x + 1.0, 0.0), (x + 1.0, 5.0), (x + 2.0, 5.0), (x + 2.0, 0.0)]
            })
            .collect();
        comb.insert(0, (0.0, 0.0));
        comb.extend([(2.0 * n + 1.0, 0.0), (2.0 * n + 1.0, -1.0), (0.0, -1.0)]);
        assert_eq!(vector_area(&flat(comb.clone())).length() / 2.0, 7.0 * n + 1.0);
        covers(&flat(comb));
    }
}

#[test]
fn a_hundred_thousand_corners() {
    // A spiral of fifty turns, out along one side and back along the other.
    let side = |radius: f64| {
        move |i: i32| {
            let angle = TAU * f64::from(i) / 1_000.0;
            let radius = radius + f64::from(i) / 1_000.0;
            (radius * angle.cos(), radius * angle.sin())
        }
    };
    covers(&flat((0..50_000).map(side(1.0)).chain((0..50_000).rev().map(side(1.5)))));
    // A star whose points are long and thin.
    covers(&flat((0..100_000).map(|i| {
        let angle = TAU * f64::from(i) / 100_000.0;
        let radius = if i % 2 == 0 { 1.0 } else { 100.0 };
        (radius * angle.cos(), radius * angle.sin())
    })));
}

#[test]
fn what_touches_itself_has_its_own_area() {
    let area = |points: &[(f64, f64)]| {
        let points = flat(points.iter().copied());
        let corners: Vec<usize> = (0..points.len()).collect();
        let mut areas = Vec::new();
        for by in 0..points.len() {
            for reversed in [false, true] {
                let (triangles, warned) = cut(&points, &rotated(&corners, by, reversed));
                assert!(!warned);
                let area = |t: &[u32; 3]| vector_area(&t.map(|i| points[i as usize])).length() / 2.0;
                areas.push(triangles.iter().map(area).sum::<f64>());
            }
        }
        assert!(areas.iter().all(|area| *area == areas[0]), "{areas:?}");
        areas[0]
    };
    // An hourglass, a square with a square hole and a bridge to it, one with two holes at one
    // corner, spikes in and out.
    assert_eq!(area(&[(4.0, 0.0), (2.0, 2.0), (4.0, 4.0), (0.0, 4.0), (2.0, 2.0), (0.0, 0.0)]), 8.0);
    let square = [(0.0, 0.0), (6.0, 0.0), (6.0, 6.0), (0.0, 6.0), (0.0, 0.0)];
    let hole = [(1.0, 1.0), (1.0, 3.0), (3.0, 3.0), (3.0, 1.0), (1.0, 1.0)];
    let other = [(3.0, 3.0), (3.0, 5.0), (5.0, 5.0), (5.0, 3.0), (3.0, 3.0)];
    assert_eq!(area(&[&square[..], &hole].concat()), 32.0);
    assert_eq!(area(&[&square[..], &hole[..2], &other, &hole[2..]].concat()), 28.0);
    let spikes = [(2.0, 0.0), (2.0, 2.0), (2.0, 0.0), (6.0, 0.0), (9.0, 0.0), (6.0, 0.0)];
    assert_eq!(area(&[&square[..1], &spikes, &square[2..4]].concat()), 36.0);
    // A corner twice, and corners on straight edges.
    let runs =
        [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 0.0), (2.0, 2.0), (1.0, 1.0), (0.0, 2.0), (0.0, 1.0)];
    assert_eq!(area(&runs), 3.0);
    // Out and back again: no area at all.
    assert_eq!(area(&[(0.0, 0.0), (1.0, 0.0), (0.0, 0.0), (0.0, 1.0), (0.0, 0.0), (1.0, 1.0)]), 0.0);
    assert_eq!(area(&[(0.0, 0.0), (1.0, 1.0), (2.0, 2.0), (3.0, 3.0), (1.5, 1.5)]), 0.0);
}

#[test]
fn corners_on_straight_edges_are_corners_of_triangles_with_area() {
    let square =
        [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0), (0.0, 2.0), (0.0, 1.0)];
    let triangle = [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (1.0, 1.0)];
    for by in 0..8 {
        let mut points = flat(square);
        points.rotate_left(by);
        covers(&points);
        let mut points = flat(triangle);
        points.rotate_left(by % 4);
        covers(&points);
        points.reverse();
        covers(&points);
    }
}

#[test]
fn what_crosses_itself_is_said_to_once_each() {
    let crossing: [&[(f64, f64)]; 5] = [
        &[(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)],
        &[(0.0, 0.0), (2.0, 2.0), (2.0, 0.0), (0.0, 2.0), (-1.0, 1.0)],
        // A figure of eight whose loops cancel, and one through a corner.
        &[(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, -2.0), (0.0, -1.0)],
        &[(0.0, 0.0), (2.0, 2.0), (4.0, 4.0), (4.0, 0.0), (2.0, 2.0), (0.0, 4.0)],
        // Twice round the same square.
        &[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)],
    ];
    for points in crossing {
        let corners: Vec<usize> = (0..points.len()).collect();
        for by in 0..points.len() {
            let (triangles, warned) = cut(&flat(points.iter().copied()), &rotated(&corners, by, by % 2 == 0));
            assert!(warned && triangles.len() == points.len() - 2, "{points:?}");
        }
    }
    let star: Vec<usize> = (0..100_001).map(|i| i * 40_000 % 100_001).collect();
    let circle = flat((0..100_001).map(|i| (TAU * f64::from(i) / 100_001.0).sin_cos()));
    assert!(cut(&circle, &star).1);
}

#[test]
fn polygons_without_a_plane() {
    // A sheet that is folded once: seen along z, its upright half would be a line.
    let fold = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (2, 2, 2), (1, 2, 1), (0, 2, 2), (0, 2, 0)];
    let fold: Vec<Vec3> = fold.iter().map(|&(x, y, z)| Vec3::new(x as f32, y as f32, z as f32)).collect();
    for by in 0..fold.len() {
        let mut points = fold.clone();
        points.rotate_left(by);
        let (triangles, warned) = cut(&points, &[0, 1, 2, 3, 4, 5, 6]);
        assert!(!warned && triangles.len() == 5);
        let area = vector_area(&points);
        for triangle in &triangles {
            assert!(vector_area(&triangle.map(|i| points[i as usize])).dot(area) > 0.0, "{triangle:?}");
        }
    }
    // A crown: a star whose points are up and down by turns.
    for count in [6, 40, 1_000] {
        let crown: Vec<Vec3> = (0..count)
            .map(|i| {
                let (sin, cos) = (TAU * f64::from(i) / f64::from(count)).sin_cos();
                let radius = [1.0, 0.4, 0.7][i as usize % 3];
                let high = f64::from(i % 2) * 0.2;
                (DVec3::new(cos, sin, 0.0) * radius + DVec3::new(0.0, cos * 0.5, high)).as_vec3()
            })
            .collect();
        let (triangles, warned) = cut(&crown, &(0..count as usize).collect::<Vec<_>>());
        assert!(!warned && triangles.len() == count as usize - 2, "{count}");
        let area = vector_area(&crown);
        let sum: f64 = triangles
            .iter()
            .map(|t| vector_area(&t.map(|i| crown[i as usize])).dot(area.normalize()))
            .inspect(|part| assert!(*part > -1e-9))
            .sum();
        assert!((sum - area.length()).abs() < 1e-6 * sum);
    }
}

#[test]
fn corners_that_are_nowhere() {
    let mut points = flat([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (1.0, 1.0), (0.0, 2.0)]);
    for value in [f32::NAN, f32::INFINITY, f32::MAX, f32::MIN_POSITIVE, 1e-45, -1e-45] {
        points[1].x = value;
        points[3].z = value;
        let text: String = points.iter().map(|v| format!("v {} {} {}\n", v.x, v.y, v.z)).collect();
        let (mesh, _) = read_obj(text + "f 1 2 3 4 5\n");
        assert!(indices(&mesh).len() <= 9);
    }
    let tiny = flat([(0.0, 0.0), (4e-44, 0.0), (4e-44, 4e-44), (2e-44, 2e-44), (0.0, 4e-44)]);
    covers(&tiny);
    let huge = flat([(0.0, 0.0), (3e38, 0.0), (3e38, 3e38), (1e38, 2e38), (0.0, 3e38)]);
    covers(&huge);
}

proptest! {
    /// Star-shaped around the origin, and so simple, with corners that are reflex as often as not;
    /// in any plane.
    #[test]
    fn random_simple_polygons(
        radii in proptest::collection::vec(0.05_f64..1.0, 4..120),
        axis in prop::array::uniform3(-1.0_f64..1.0),
        reversed: bool,
    ) {
        let axis = DVec3::from(axis);
        prop_assume!(axis.length() > 0.1);
        let count = radii.len() as f64;
        let place = |(i, radius): (usize, &f64)| {
            let (sin, cos) = (TAU * i as f64 / count).sin_cos();
            turned(axis, *radius, cos, sin).as_vec3()
        };
        let mut points: Vec<Vec3> = radii.iter().enumerate().map(place).collect();
        if reversed {
            points.reverse();
        }
        covers(&points);
    }

    #[test]
    fn any_corners_at_all(
        vertices in proptest::collection::vec(any::<(f32, f32, f32)>(), 1..12),
        corners in proptest::collection::vec(any::<proptest::sample::Index>(), 3..40),
    ) {
        let corners: Vec<String> =
            corners.iter().map(|corner| (corner.index(vertices.len()) + 1).to_string()).collect();
        let lines: Vec<String> = vertices.iter().map(|(x, y, z)| format!("v {x} {y} {z}")).collect();
        read_obj(format!("{}\nf {}\n", lines.join("\n"), corners.join(" ")));
    }
}
