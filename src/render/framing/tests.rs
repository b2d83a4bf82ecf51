//! Scenes of which it is known from where they are to be seen: what is hollow and what is solid
//! from outside, furnished rooms from inside.

use super::{Framing, Seen, Sight, guess_up, main_bounds};
use crate::builder::Config;
use crate::experiment::measure::area_tree;
use crate::geometry::{Aabb, Ray, Triangle, Vec3};
use crate::random::Random;
use crate::render::camera::{Camera, View};
use crate::traverse::{All, Prepared, PreparedRay, Scratch, Traversal};
use std::f32::consts::{PI, TAU};

type Triangles = Vec<Triangle>;

struct Scene<'a> {
    prepared: Prepared,
    triangles: &'a [Triangle],
}

impl Sight for Scene<'_> {
    fn first(&mut self, ray: &Ray) -> Option<Seen> {
        let mut scratch = Scratch::default();
        let hit =
            self.prepared.closest_hit(Traversal::Odf, &PreparedRay::new(ray), &All, &mut (), &mut scratch)?;
        let normal = self.triangles[hit.triangle as usize].scaled_normal();
        Some(Seen { t: hit.t, triangle: hit.triangle, normal })
    }
}

/// The view that is chosen, and the share of its rays that hit.
fn chosen(triangles: &[Triangle]) -> (View, f32) {
    let tree = area_tree(triangles, &Config::default()).unwrap();
    let mut scene = Scene { prepared: Prepared::new(tree.view(), triangles, &[]), triangles };
    let bounds = main_bounds(triangles);
    let axes = guess_up(triangles, &bounds);
    let view = Framing::new(&mut scene, triangles, bounds, axes).view(None, 4.0 / 3.0);
    let camera = Camera::new(&view, 64, 48).unwrap();
    let pixels = (0..48).flat_map(|y| (0..64).map(move |x| (x as f32 + 0.5, y as f32 + 0.5)));
    let hits = pixels.filter(|&(x, y)| scene.first(&camera.ray(x, y)).is_some()).count();
    (view, hits as f32 / (64.0 * 48.0))
}

fn bounds(triangles: &[Triangle]) -> Aabb {
    triangles.iter().fold(Aabb::EMPTY, |all, triangle| all.union(&triangle.bounds()))
}

fn is_within(bounds: &Aabb, point: Vec3) -> bool {
    bounds.contains(&Aabb { lower: point, upper: point })
}

/// The eye is outside of all, and at least `share` of the rays hits.
fn seen_from_outside(name: &str, triangles: &[Triangle], share: f32) {
    let (view, hits) = chosen(triangles);
    assert!(!is_within(&bounds(triangles), view.eye), "{name}: {view:?}");
    assert!(hits >= share, "{name}: {hits} of the rays hit, {view:?}");
}

fn quad(triangles: &mut Triangles, [a, b, c, d]: [Vec3; 4]) {
    triangles.extend([Triangle([a, b, c]), Triangle([a, c, d])]);
}

/// `u` and `v` run over the unit square in so many steps.
fn surface(triangles: &mut Triangles, [nu, nv]: [u32; 2], inwards: bool, at: impl Fn(f32, f32) -> Vec3) {
    for (i, j) in (0..nu).flat_map(|i| (0..nv).map(move |j| (i, j))) {
        let point = |i: u32, j: u32| at(i as f32 / nu as f32, (j % nv) as f32 / nv as f32);
        let mut corners = [point(i, j), point(i, j + 1), point(i + 1, j + 1), point(i + 1, j)];
        if inwards {
            corners.reverse();
        }
        quad(triangles, corners);
    }
}

fn on_sphere(u: f32, v: f32) -> Vec3 {
    let (polar, azimuth) = (PI * u, TAU * v);
    Vec3::new(polar.sin() * azimuth.cos(), polar.cos(), polar.sin() * azimuth.sin())
}

/// The sides of a box without those whose numbers are left out, each `n` × `n` quads.
fn cuboid(triangles: &mut Triangles, lower: Vec3, upper: Vec3, n: u32, inwards: bool, left_out: &[usize]) {
    let extent = upper - lower;
    for side in (0..6).filter(|side| !left_out.contains(side)) {
        let (axis, is_upper) = (side / 2, side % 2 == 1);
        let [across, along] = [1, 2].map(|k| Vec3::AXES[(axis + k) % 3] * extent[(axis + k) % 3]);
        let corner = lower + if is_upper { Vec3::AXES[axis] * extent[axis] } else { Vec3::ZERO };
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let at = |i: u32, j: u32| corner + (across * i as f32 + along * j as f32) / n as f32;
            let mut corners = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            if is_upper == inwards {
                corners.reverse();
            }
            quad(triangles, corners);
        }
    }
}

/// A profile of radius and height, turned around the y axis.
fn turned(profile: &[[f32; 2]], steps: u32) -> Triangles {
    let mut triangles = Vec::new();
    let rings = profile.len() - 1;
    surface(&mut triangles, [rings as u32, steps], false, |u, v| {
        let [radius, height] = profile[((u * rings as f32).round() as usize).min(rings)];
        Vec3::new(radius * (TAU * v).cos(), height, radius * (TAU * v).sin())
    });
    triangles
}

fn moved(triangles: &Triangles, scale: f32, offset: Vec3) -> Triangles {
    triangles.iter().map(|triangle| Triangle(triangle.0.map(|vertex| vertex * scale + offset))).collect()
}

#[test]
fn what_is_hollow_is_seen_from_outside() {
    for thickness in [1e-3, 0.03, 0.2] {
        // The inner wall is finer than the outer one: most triangles are hidden.
        for (outer, inner) in [(8, 24), (12, 12)] {
            let mut egg = Vec::new();
            surface(&mut egg, [outer, 2 * outer], false, |u, v| on_sphere(u, v) * Vec3::new(1.0, 1.3, 1.0));
            surface(&mut egg, [inner, 2 * inner], true, |u, v| {
                on_sphere(u, v) * Vec3::new(1.0, 1.3, 1.0) * (1.0 - thickness)
            });
            seen_from_outside(&format!("egg {thickness} {outer}"), &egg, 0.1);
            let mut figure = Vec::new();
            // A body with three arms and a head.
            let at = |u: f32, v: f32, inset: f32| {
                let direction = on_sphere(u, v);
                let arms = 0.9 * (0.5 + 0.5 * (3.0 * TAU * v).cos()).powi(6) * (PI * u).sin().powi(4);
                direction * (0.5 + arms + 0.5 * direction.y.max(0.0).powi(8) - inset)
            };
            surface(&mut figure, [2 * outer, 4 * outer], false, |u, v| at(u, v, 0.0));
            surface(&mut figure, [2 * inner, 4 * inner], true, |u, v| at(u, v, thickness));
            seen_from_outside(&format!("figure {thickness} {outer}"), &figure, 0.1);
            let mut case = Vec::new();
            cuboid(&mut case, Vec3::ZERO, Vec3::new(1.0, 1.0, 1.5), outer / 4, false, &[]);
            let inset = Vec3::splat(thickness);
            cuboid(&mut case, inset, Vec3::new(1.0, 1.0, 1.5) - inset, inner / 2, true, &[]);
            seen_from_outside(&format!("case {thickness} {outer}"), &case, 0.1);
            // Turned inside out, as careless programs write them.
            let inside_out: Triangles = egg.iter().map(|t| Triangle([t.0[0], t.0[2], t.0[1]])).collect();
            seen_from_outside(&format!("egg inside out {thickness} {outer}"), &inside_out, 0.1);
        }
        // An open vase: up outside, over the lip, down inside.
        let radius = |height: f32| 0.5 + 0.25 * (3.0 * height).sin();
        let up = (0..=20).map(|step| [radius(0.1 * step as f32), 0.1 * step as f32]);
        let down = (1..=20).rev().map(|step| [radius(0.1 * step as f32) - thickness, 0.1 * step as f32]);
        let profile: Vec<[f32; 2]> =
            [[0.0, 0.0]].into_iter().chain(up).chain(down).chain([[0.0, 0.1]]).collect();
        seen_from_outside(&format!("vase {thickness}"), &turned(&profile, 24), 0.1);
    }
}

/// A room with a few boxes and a table in it.
fn furnished(seed: u64, extent: Vec3) -> Triangles {
    let mut random = Random::new(seed);
    let mut triangles = Vec::new();
    for number in 0..3 + random.below(5) {
        let size = extent.min_element() * random.range(0.15, 0.35) as f32;
        let free = extent - 1.3 * size;
        let place = Vec3::new(random.unit() * free.x, 0.0, random.unit() * free.z);
        if number == 0 {
            let top = place + Vec3::Y * (0.6 * size);
            cuboid(&mut triangles, top, top + size * Vec3::new(1.2, 0.05, 0.8), 1, false, &[]);
            for leg in [[0.0, 0.0], [1.1, 0.0], [0.0, 0.7], [1.1, 0.7]] {
                let foot = place + size * Vec3::new(leg[0], 0.0, leg[1]);
                cuboid(&mut triangles, foot, foot + size * Vec3::new(0.08, 0.6, 0.08), 1, false, &[]);
            }
        } else {
            cuboid(&mut triangles, place, place + size * Vec3::new(1.0, 0.8, 0.7), 1, false, &[]);
        }
    }
    triangles
}

#[test]
fn rooms_are_seen_from_inside() {
    for seed in 0..24 {
        let mut random = Random::new(seed + 100);
        let extent = Vec3::new(random.range(3.0, 12.0) as f32, 3.0, random.range(3.0, 12.0) as f32);
        let mut triangles = furnished(seed, extent);
        let fine = [1, 1, 4][(seed / 4 % 3) as usize];
        match seed % 4 {
            0 => cuboid(&mut triangles, Vec3::ZERO, extent, fine, true, &[]),
            1 => cuboid(&mut triangles, Vec3::ZERO, extent, fine, false, &[]),
            thick => {
                // Walls of some thickness; the last kind has a window in one of them, as wide as
                // the wall.
                let thickness = Vec3::splat(0.2);
                let open: &[usize] = if thick == 3 { &[4] } else { &[] };
                cuboid(&mut triangles, Vec3::ZERO, extent, fine, true, open);
                cuboid(&mut triangles, -thickness, extent + thickness, 1, false, open);
                let [low, high] = [0.0, 2.0].map(|height| Vec3::new(-0.2, height, -0.2));
                for corner in [low, high].into_iter().filter(|_| thick == 3) {
                    let part = Vec3::new(extent.x + 0.4, 1.0, 0.2);
                    cuboid(&mut triangles, corner, corner + part, 1, false, &[]);
                }
            }
        }
        let (scale, offset) = [(1.0, Vec3::ZERO), (100.0, Vec3::new(5e3, 0.0, -7e3))][(seed / 12) as usize];
        let triangles = moved(&triangles, scale, offset);
        let (view, hits) = chosen(&triangles);
        let room = Aabb { lower: offset, upper: extent * scale + offset };
        assert!(is_within(&room, view.eye), "room {seed}: {view:?} {room:?}");
        assert!(hits > 0.6, "room {seed}: {hits} of the rays hit");
    }
}

#[test]
fn of_any_scene_something_is_seen() {
    for seed in 0..36 {
        let mut random = Random::new(seed);
        let (mut boxes, mut row, mut groups) = (Vec::new(), Vec::new(), Vec::new());
        let mut point = || Vec3::new(random.unit(), random.unit(), random.unit());
        let size = [0.1, 0.4, 1.0][(seed % 3) as usize];
        for _ in 0..[1, 3, 8, 30, 150, 400][(seed / 3 % 6) as usize] {
            let (centre, half) = (point(), 0.5 * size * point());
            // A third of them are open on a side, so that one can look out of them.
            let left_out: &[usize] = if centre.x < 0.3 { &[5] } else { &[] };
            cuboid(&mut boxes, centre - half, centre + half, 1, false, left_out);
        }
        for number in 0..[2, 20, 300][(seed % 3) as usize] {
            let place = Vec3::AXES[(seed / 3 % 3) as usize] * (10.0 * number as f32);
            cuboid(&mut row, place, place + point(), 1, false, &[]);
        }
        for _ in 0..2 + seed % 4 {
            let place = 10f32.powi(1 + (seed % 4) as i32) * point();
            for _ in 0..10 {
                let corner = place + point();
                cuboid(&mut groups, corner, corner + 0.3 * point(), 1, false, &[]);
            }
        }
        let single = vec![Triangle([point(), point(), point()])];
        let mut plane = Vec::new();
        quad(&mut plane, [Vec3::ZERO, Vec3::X, Vec3::X + 0.02 * Vec3::Y, 0.02 * Vec3::Y]);
        let scenes =
            [("boxes", boxes), ("row", row), ("groups", groups), ("triangle", single), ("plane", plane)];
        for (name, triangles) in scenes {
            let (_, hits) = chosen(&triangles);
            assert!(hits > 0.015, "{name} {seed}: {hits} of the rays hit");
            let scale = 10f32.powi(seed as i32 / 4 - 4);
            let (_, hits) = chosen(&moved(&triangles, scale, scale * Vec3::new(300.0, -20.0, 4000.0)));
            assert!(hits > 0.015, "{name} {seed} elsewhere: {hits} of the rays hit");
        }
    }
}

/// A georeferenced house: floats are half a metre apart.
#[test]
fn far_from_the_origin_a_camera_still_sees_what_is_there() {
    let mut house = Vec::new();
    cuboid(&mut house, Vec3::ZERO, Vec3::new(40.0, 20.0, 30.0), 2, false, &[]);
    let (view, hits) = chosen(&moved(&house, 1.0, Vec3::new(450_000.0, 5_700_000.0, 120.0)));
    assert!(hits > 0.1, "{hits} of the rays hit: {view:?}");
}

#[test]
fn a_camera_can_be_made_of_whatever_is_chosen() {
    let point = |at: Vec3| vec![Triangle([at; 3])];
    let far = Vec3::new(400_000.0, 5_700_000.0, 3.0);
    for triangles in [point(Vec3::ZERO), point(Vec3::splat(5.0)), point(far), point(Vec3::splat(1e-30))] {
        chosen(&triangles);
    }
}
