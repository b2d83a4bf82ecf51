//! A camera and lights for a scene that says nothing about them.
//!
//! Everything is decided by asking rays. A scene is an *interior* when most of its triangles are hidden from outside and there is free,
//! enclosed space: then the camera stands in it at eye height, away from walls, and looks along the longest free way that
//! shows much. Otherwise it stands outside, far enough to see all, on the side that shows most (a box with an open side is
//! looked into).

#[cfg(feature = "embree")]
pub mod lighting;

use crate::geometry::{Aabb, Ray, Triangle, Vec3};
use crate::render::camera::{Camera, View};
use crate::render::sampler::Sampler;
use std::collections::HashSet;
use std::f32::consts::{PI, TAU};

/// Height of the image in degrees, when nobody chose.
const OUTSIDE_FOV: f32 = 40.0;
const INSIDE_FOV: f32 = 60.0;
/// Rays of a glimpse: the small image by which views are compared.
const GLIMPSE: [u32; 2] = [32, 24];
/// Directions of the sphere or the horizon that are asked from a point.
const DIRECTIONS: u32 = 64;
/// Triangles that are asked whether they are seen from outside.
const SURFACE_SAMPLES: u32 = 512;
/// Below this share of free directions over the sphere, the surfaces are those of an interior. A convex solid has a half.
const INTERIOR_OPENNESS: f32 = 0.2;
/// From a point inside, this share of all directions meets something. An atrium without a roof has about 0.8.
const ENCLOSED: f32 = 0.65;
/// Nearer than this share of the diagonal, things are in the way of a view.
const CLOSE: f32 = 0.1;
/// A view from inside is at least this share of the diagonal long. In a tangle there is none.
const MIN_LENGTH: f32 = 0.15;
/// Places that a camera inside may stand, and how many of the best are looked from.
const PLACES: u32 = 512;
const FINALISTS: usize = 40;

/// Directions of a scene, all of length 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axes {
    pub up: Vec3,
    /// Horizontal, towards who looks at the scene from its front.
    pub front: Vec3,
    pub right: Vec3,
}

impl Axes {
    /// Axes with `up` along the largest component of a vector.
    pub fn with_up(up: Vec3) -> Axes {
        let index = up.abs().max_position();
        let up = Vec3::AXES[index] * up[index].signum();
        // y up: front +z; z up: front -y; both have +x to the right.
        let front = if index == 2 { -Vec3::Y * up.z } else { Vec3::Z };
        Axes { up, front, right: up.cross(front) }
    }

    /// A direction by its angle around `up`, from the front to the right, and above the horizon, in radians.
    fn direction(&self, azimuth: f32, elevation: f32) -> Vec3 {
        let horizontal = self.front * libm::cosf(azimuth) + self.right * libm::sinf(azimuth);
        (horizontal * libm::cosf(elevation) + self.up * libm::sinf(elevation)).normalize()
    }
}

/// Which axis points up: y, as in most files, unless two signs speak clearly for z. More area faces along it than along y (floors,
/// roofs, tables); and its two ends differ more (a floor at the bottom, less at the top; the ends of y are alike).
pub fn guess_up(triangles: &[Triangle], bounds: &Aabb) -> Axes {
    let extent = bounds.extent();
    let mut facing = [0.0f64; 3];
    let mut bottom_less_top = [0.0f64; 3];
    for triangle in triangles.iter().filter(|t| t.is_finite()) {
        let normal = triangle.scaled_normal();
        let area = f64::from(normal.length());
        let axis = normal.abs().max_position();
        if f64::from(normal[axis].abs()) <= 0.98 * area {
            continue;
        }
        facing[axis] += area;
        let height = (triangle.centroid()[axis] - bounds.lower[axis]) / extent[axis];
        if height < 0.05 {
            bottom_less_top[axis] += area;
        } else if height > 0.95 {
            bottom_less_top[axis] -= area;
        }
    }
    // The ends are compared as shares of the cross section that they could fill.
    let end = |axis: usize| {
        let section = extent[(axis + 1) % 3] * extent[(axis + 2) % 3];
        if section > 0.0 { bottom_less_top[axis].abs() / f64::from(section) } else { 0.0 }
    };
    let [_, y, z] = facing;
    Axes::with_up(if z > 1.25 * y && end(2) > 2.0 * end(1) + 0.05 { Vec3::Z } else { Vec3::Y })
}

/// The box of nearly everything: a few stray points far away (files have them) are left out.
pub fn main_bounds(triangles: &[Triangle]) -> Aabb {
    let all = triangles.iter().filter(|t| t.is_finite()).fold(Aabb::EMPTY, |all, t| all.union(&t.bounds()));
    if all.is_empty() {
        return Aabb { lower: -Vec3::ONE, upper: Vec3::ONE };
    }
    let step = triangles.len().div_ceil(1 << 16).max(1);
    let sampled: Vec<Aabb> =
        triangles.iter().step_by(step).filter(|t| t.is_finite()).map(Triangle::bounds).collect();
    let mut main = all;
    for axis in 0..3 {
        let mut lower: Vec<f32> = sampled.iter().map(|b| b.lower[axis]).collect();
        let mut upper: Vec<f32> = sampled.iter().map(|b| b.upper[axis]).collect();
        if lower.is_empty() {
            continue;
        }
        lower.sort_by(f32::total_cmp);
        upper.sort_by(f32::total_cmp);
        let strays = sampled.len() / 200;
        let (low, high) = (lower[strays], upper[upper.len() - 1 - strays]);
        // A scene that only thins out towards its ends is taken whole.
        if high > low && all.extent()[axis] > 4.0 * (high - low) {
            (main.lower[axis], main.upper[axis]) = (low, high);
        }
    }
    main
}

/// The surface that a ray meets first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// In units of the length of the ray's direction.
    pub t: f32,
    pub triangle: u32,
    /// Geometric, of any length.
    pub normal: Vec3,
}

/// Whoever can say what a ray meets first.
pub trait Sight {
    fn first(&mut self, ray: &Ray) -> Option<Seen>;
}

/// What a scene looks like to someone who has to choose a view.
pub struct Framing<'a, Q> {
    queries: &'a mut Q,
    triangles: &'a [Triangle],
    bounds: Aabb,
    pub axes: Axes,
    /// Length of the diagonal of `bounds`.
    size: f32,
}

/// What can be seen from a view, roughly.
struct Glimpse {
    distinct: usize,
    /// Neighbouring rays, as a share of all, between which the surface breaks off: outlines and corners, however finely
    /// they are tessellated.
    edges: f32,
    /// Share of rays that hit.
    covered: f32,
    /// Share of rays that hit something close by.
    obstructed: f32,
    /// Share of hits on the back of a triangle.
    backs: f32,
}

impl<'a, Q: Sight> Framing<'a, Q> {
    /// `bounds` are [`main_bounds`] of the triangles.
    pub fn new(queries: &'a mut Q, triangles: &'a [Triangle], bounds: Aabb, axes: Axes) -> Framing<'a, Q> {
        let size = bounds.extent().length().max(f32::MIN_POSITIVE);
        Framing { queries, triangles, bounds, axes, size }
    }

    /// A view that shows the scene: from inside when it is an interior.
    pub fn view(&mut self, fov_degrees: Option<f32>, aspect: f32) -> View {
        let inside =
            if self.openness() < INTERIOR_OPENNESS { self.inside(fov_degrees, aspect) } else { None };
        inside.unwrap_or_else(|| self.outside(fov_degrees, aspect))
    }

    fn distance(&mut self, origin: Vec3, direction: Vec3) -> Option<f32> {
        let ray = Ray { origin, tnear: 0.0, direction, tfar: f32::INFINITY };
        self.queries.first(&ray).map(|seen| seen.t)
    }

    /// Mean share of the sphere around a triangle in which nothing hides it, over triangles at regular steps of their numbers: so
    /// the many small ones of what stands in a room outvote its walls.
    fn openness(&mut self) -> f32 {
        let count = self.triangles.len().min(SURFACE_SAMPLES as usize);
        let (mut free, mut asked) = (0, 0);
        for number in 0..count {
            let triangle = self.triangles[number * self.triangles.len() / count];
            let normal = triangle.scaled_normal().normalize_or_zero();
            if !triangle.is_finite() || normal == Vec3::ZERO {
                continue;
            }
            for direction in 0..DIRECTIONS {
                let direction = sphere_direction(direction, number as u32);
                let side = if direction.dot(normal) < 0.0 { -normal } else { normal };
                let origin = triangle.centroid() + side * (1e-4 * self.size);
                asked += 1;
                free += u32::from(self.distance(origin, direction).is_none());
            }
        }
        if asked == 0 { 1.0 } else { free as f32 / asked as f32 }
    }

    /// Share of all directions in which something is met from a point.
    fn enclosure(&mut self, point: Vec3) -> f32 {
        let hits = (0..DIRECTIONS)
            .filter(|&direction| self.distance(point, sphere_direction(direction, 0)).is_some())
            .count();
        hits as f32 / DIRECTIONS as f32
    }

    fn glimpse(&mut self, view: &View, aspect: f32) -> Option<Glimpse> {
        let [width, height] = GLIMPSE;
        let camera = Camera::new(&View { ..*view }, (aspect * 1024.0) as u32 + 1, 1024).ok()?;
        let scale = [(aspect * 1024.0 + 1.0) / width as f32, 1024.0 / height as f32];
        let mut seen = HashSet::new();
        let (mut hits, mut close, mut backs, mut edges) = (0, 0, 0, 0);
        // Distances in the row above, up to the current column in this one.
        let mut distances = vec![f32::INFINITY; width as usize];
        for y in 0..height {
            let mut left = f32::INFINITY;
            for x in 0..width {
                let ray = camera.ray((x as f32 + 0.5) * scale[0], (y as f32 + 0.5) * scale[1]);
                let mut distance = f32::INFINITY;
                if let Some(first) = self.queries.first(&ray) {
                    hits += 1;
                    seen.insert(first.triangle);
                    distance = first.t;
                    close += u32::from(first.t < CLOSE * self.size);
                    backs += u32::from(first.normal.dot(ray.direction) > 0.0);
                }
                let above = std::mem::replace(&mut distances[x as usize], distance);
                let breaks = |other: f32| other.min(distance) < 0.8 * other.max(distance);
                edges += u32::from(x > 0 && breaks(left)) + u32::from(y > 0 && breaks(above));
                left = distance;
            }
        }
        let rays = (width * height) as f32;
        Some(Glimpse {
            distinct: seen.len(),
            edges: edges as f32 / rays,
            covered: hits as f32 / rays,
            obstructed: close as f32 / rays,
            backs: backs as f32 / (hits as f32).max(1.0),
        })
    }

    /// The view from outside that shows most triangles, with a preference for one from the front, a little from above.
    fn outside(&mut self, fov_degrees: Option<f32>, aspect: f32) -> View {
        let fov_degrees = fov_degrees.unwrap_or(OUTSIDE_FOV);
        let mut best: Option<(f32, View)> = None;
        for (preference, azimuth, elevation) in [
            (1.0, 30.0, 20.0),
            (0.98, -30.0, 20.0),
            (0.9, 150.0, 20.0),
            (0.9, -150.0, 20.0),
            (0.9, 0.0, 5.0),
            (0.88, 180.0, 5.0),
            (0.85, 90.0, 5.0),
            (0.85, -90.0, 5.0),
            (0.85, 35.0, 50.0),
        ] {
            let (azimuth, elevation): (f32, f32) = (azimuth, elevation);
            let towards = self.axes.direction(azimuth.to_radians(), elevation.to_radians());
            let view = self.fit(towards, fov_degrees, aspect);
            if let Some(glimpse) = self.glimpse(&view, aspect) {
                let score =
                    preference * libm::logf(1.0 + glimpse.distinct as f32) * (0.5 + glimpse.covered).min(1.0);
                if best.is_none_or(|(other, _)| score > other) {
                    best = Some((score, view));
                }
            }
        }
        best.map_or_else(|| self.fit(self.axes.front, fov_degrees, aspect), |(_, view)| view)
    }

    /// The nearest view along `-towards` with all corners of the bounds in the image.
    fn fit(&self, towards: Vec3, fov_degrees: f32, aspect: f32) -> View {
        let up = self.axes.up;
        let side = up.cross(towards).normalize();
        let down = side.cross(towards);
        let margin = 0.94;
        let half_height = libm::tanf(fov_degrees.to_radians() / 2.0) * margin;
        let half_width = half_height * aspect;
        let centre = self.bounds.center();
        let mut distance = 0.05 * self.size;
        for corner in 0..8 {
            let pick = |axis: usize| {
                let bound = if corner >> axis & 1 == 0 { self.bounds.lower } else { self.bounds.upper };
                bound[axis] - centre[axis]
            };
            let corner = Vec3::new(pick(0), pick(1), pick(2));
            let needed = (corner.dot(side).abs() / half_width).max(corner.dot(down).abs() / half_height);
            distance = distance.max(corner.dot(towards) + needed);
        }
        View { eye: centre + towards * distance, target: centre, up, fov_degrees }
    }

    /// The best view from a free, enclosed place; `None` when there is no such place.
    fn inside(&mut self, fov_degrees: Option<f32>, aspect: f32) -> Option<View> {
        let fov_degrees = fov_degrees.unwrap_or(INSIDE_FOV);
        let mut places: Vec<(f32, Vec3, f32)> = Vec::new();
        for number in 0..PLACES {
            if let Some(place) = self.place(number) {
                places.push(place);
            }
        }
        // The order of equal ones is that of their numbers: the sort is stable.
        places.sort_by(|a, b| b.0.total_cmp(&a.0));
        places.truncate(FINALISTS);
        let mut best: Option<(f32, View)> = None;
        for (length, eye, azimuth) in places {
            let target = eye + self.axes.direction(azimuth, -0.06) * (0.1 * self.size);
            let view = View { eye, target, up: self.axes.up, fov_degrees };
            let Some(glimpse) = self.glimpse(&view, aspect) else { continue };
            // In a tangle everything is in the way.
            if glimpse.obstructed > 0.4 {
                continue;
            }
            // Much to see, and nothing in front of it.
            let score = 1.5 * glimpse.edges.min(0.5) + 0.1 * libm::logf(1.0 + glimpse.distinct as f32)
                - 3.0 * glimpse.obstructed
                - glimpse.backs
                + glimpse.covered
                + (length / self.size).min(0.6);
            if best.is_none_or(|(other, _)| score > other) {
                best = Some((score, view));
            }
        }
        best.map(|(_, view)| view)
    }

    /// A place to stand: how far and freely one sees from there, the eye, and the direction of the longest view.
    fn place(&mut self, number: u32) -> Option<(f32, Vec3, f32)> {
        let sampler = Sampler::new(0, 0, number);
        let [x, y] = sampler.pair(0);
        let inner = |f: f32| 0.04 + 0.92 * f;
        let fraction = Vec3::new(inner(x), inner(y), inner(sampler.single(1)));
        let point = self.bounds.lower + fraction * self.bounds.extent();
        let up = self.axes.up;
        let below = self.distance(point, -up)?;
        let floor = point - up * below;
        let top = if up.element_sum() > 0.0 { self.bounds.upper } else { self.bounds.lower };
        let above = self.distance(point, up).unwrap_or_else(|| (top - point).dot(up).abs());
        let extent = self.bounds.extent();
        let wide = (extent - extent * up.abs()).max_element();
        let clearance = below + above;
        let eye = floor + up * (0.45 * clearance).min(0.15 * wide);

        let horizon: Vec<f32> = (0..DIRECTIONS)
            .map(|i| {
                let azimuth = TAU * i as f32 / DIRECTIONS as f32;
                self.distance(eye, self.axes.direction(azimuth, 0.0)).unwrap_or(0.5 * wide)
            })
            .collect();
        let nearest = horizon.iter().copied().fold(f32::INFINITY, f32::min);
        if nearest < 0.015 * self.size || clearance < 0.03 * self.size || self.enclosure(eye) < ENCLOSED {
            return None;
        }
        // A long view is one that is long to both sides of its middle, too.
        let count = horizon.len();
        let (direction, length) = (0..count)
            .map(|i| {
                let window = (0..7).map(|k| libm::logf(horizon[(i + count + k - 3) % count]));
                (i, libm::expf(window.sum::<f32>() / 7.0))
            })
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
        if length < MIN_LENGTH * self.size {
            return None;
        }
        // Away from walls, and on the floor of the room rather than on a table or under it.
        let freedom = (nearest / (0.05 * self.size)).min(1.0);
        let height = (clearance / (extent * up).element_sum().abs()).min(1.0).sqrt();
        Some((length * freedom * height, eye, TAU * direction as f32 / count as f32))
    }
}

/// Direction `index` of [`DIRECTIONS`] spread evenly over the sphere (a Fibonacci lattice), turned by `turn`.
fn sphere_direction(index: u32, turn: u32) -> Vec3 {
    const GOLDEN: f32 = 0.618_034;
    let z = 1.0 - (2.0 * index as f32 + 1.0) / DIRECTIONS as f32;
    let angle = TAU * ((index as f32 * GOLDEN).fract() + turn as f32 * 0.137) + PI * 0.01;
    let radius = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(radius * libm::cosf(angle), z, radius * libm::sinf(angle))
}
