//! A camera and lights for a scene that says nothing about them.
//!
//! Everything is decided by asking rays. Where there is a room (`interior`: free, enclosed space in
//! which things stand), the camera stands in it at eye height, away from walls, and looks along the
//! longest free way that shows much. Otherwise it stands outside, far enough to see all, on the
//! side that shows most (a box with an open side is looked into); where all is too small to be seen
//! from there, it goes to a part (`closer`). Either view is looked through with a few rays before
//! it is chosen.

mod closer;
mod interior;
#[cfg(feature = "embree")]
pub mod lighting;
#[cfg(test)]
mod tests;

use crate::geometry::{Aabb, Ray, Triangle, Vec3};
use crate::render::camera::{Camera, View};
use std::collections::HashSet;
use std::f32::consts::{PI, TAU};

/// Height of the image in degrees for a view from outside, when nobody chose.
const OUTSIDE_FOV: f32 = 40.0;
/// Rays of a glimpse: the small image by which views are compared.
const GLIMPSE: [u32; 2] = [32, 24];
/// Directions of the sphere or the horizon that are asked from a point.
const DIRECTIONS: u32 = 64;
/// Nearer than this share of the diagonal, things are in the way of a view.
const CLOSE: f32 = 0.1;
/// A view from outside in which a smaller share of rays hits shows too little.
const LEAST_COVERED: f32 = 0.03;

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
        let size = bounds.extent().length().max(smallest(&bounds));
        Framing { queries, triangles, bounds, axes, size }
    }

    /// A view that shows the scene: from inside when there is a room.
    pub fn view(&mut self, fov_degrees: Option<f32>, aspect: f32) -> View {
        let outside = self.outside(fov_degrees, aspect);
        self.inside(&outside, fov_degrees, aspect).unwrap_or(outside)
    }

    fn distance(&mut self, origin: Vec3, direction: Vec3) -> Option<f32> {
        let ray = Ray { origin, tnear: 0.0, direction, tfar: f32::INFINITY };
        self.queries.first(&ray).map(|seen| seen.t)
    }

    /// Share of all directions in which something is met from a point.
    fn enclosure(&mut self, point: Vec3) -> f32 {
        let hits = (0..DIRECTIONS)
            .filter(|&direction| self.distance(point, sphere_direction(direction, DIRECTIONS, 0)).is_some())
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

    /// The view from outside that shows most triangles, with a preference for one from the front, a
    /// little from above. Where it shows next to nothing, the scene is small in its own bounds, and
    /// the view is of a part.
    fn outside(&mut self, fov_degrees: Option<f32>, aspect: f32) -> View {
        let fov_degrees = fov_degrees.unwrap_or(OUTSIDE_FOV);
        let (covered, view) = self.around(&self.bounds.clone(), fov_degrees, aspect);
        if covered >= LEAST_COVERED { view } else { self.closer((covered, view), fov_degrees, aspect) }
    }

    /// The best view of a box from outside, and the share of its rays that hit.
    fn around(&mut self, bounds: &Aabb, fov_degrees: f32, aspect: f32) -> (f32, View) {
        let mut best: Option<(f32, f32, View)> = None;
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
            let view = self.fit(bounds, towards, fov_degrees, aspect);
            if let Some(glimpse) = self.glimpse(&view, aspect) {
                let score =
                    preference * libm::logf(1.0 + glimpse.distinct as f32) * (0.5 + glimpse.covered).min(1.0);
                if best.is_none_or(|(other, ..)| score > other) {
                    best = Some((score, glimpse.covered, view));
                }
            }
        }
        best.map_or_else(
            || (0.0, self.fit(bounds, self.axes.front, fov_degrees, aspect)),
            |(_, covered, view)| (covered, view),
        )
    }

    /// The nearest view along `-towards` with all corners of a box in the image.
    fn fit(&self, bounds: &Aabb, towards: Vec3, fov_degrees: f32, aspect: f32) -> View {
        let up = self.axes.up;
        let side = up.cross(towards).normalize();
        let down = side.cross(towards);
        let margin = 0.94;
        let half_height = libm::tanf(fov_degrees.to_radians() / 2.0) * margin;
        let half_width = half_height * aspect;
        let centre = bounds.center();
        // Far enough to be told from its target.
        let mut distance = (0.05 * bounds.extent().length()).max(0.25 * smallest(&self.bounds));
        for corner in 0..8 {
            let pick = |axis: usize| {
                let bound = if corner >> axis & 1 == 0 { bounds.lower } else { bounds.upper };
                bound[axis] - centre[axis]
            };
            let corner = Vec3::new(pick(0), pick(1), pick(2));
            let needed = (corner.dot(side).abs() / half_width).max(corner.dot(down).abs() / half_height);
            distance = distance.max(corner.dot(towards) + needed);
        }
        View { eye: centre + towards * distance, target: centre, up, fov_degrees }
    }
}

/// The smallest size that can be looked at among coordinates such as those of a box: many times
/// what they are rounded by.
fn smallest(bounds: &Aabb) -> f32 {
    let largest = bounds.lower.abs().max(bounds.upper.abs()).max_element();
    (64.0 * f32::EPSILON * largest).max(1e6 * f32::MIN_POSITIVE)
}

/// Direction `index` of `count` spread evenly over the sphere (a Fibonacci lattice), turned by
/// `turn`.
fn sphere_direction(index: u32, count: u32, turn: u32) -> Vec3 {
    const GOLDEN: f32 = 0.618_034;
    let z = 1.0 - (2.0 * index as f32 + 1.0) / count as f32;
    let angle = TAU * ((index as f32 * GOLDEN).fract() + turn as f32 * 0.137) + PI * 0.01;
    let radius = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(radius * libm::cosf(angle), z, radius * libm::sinf(angle))
}
