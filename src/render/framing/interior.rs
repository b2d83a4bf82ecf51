//! Rooms: whether a scene is looked at from inside, and from where.
//!
//! Free, enclosed space alone is no room: a double-walled vase has it, a hollow figure, and every
//! solid. In a room stand things: behind them the room goes on, while behind a wall there is not
//! the same space again. And a room is not one of many boxes that cut each other: most of what it
//! holds are things, or what is seen from outside is its walls.

use super::{CLOSE, DIRECTIONS, Framing, Sight, sphere_direction};
use crate::geometry::Vec3;
use crate::render::camera::{Camera, View};
use crate::render::sampler::Sampler;
use std::f32::consts::TAU;

/// Height of the image in degrees, when nobody chose.
const INSIDE_FOV: f32 = 60.0;
/// Triangles that are asked whether they are seen from outside.
const SURFACE_SAMPLES: usize = 512;
/// Below this share of free directions over the sphere, the surfaces are those of an interior. A
/// convex solid has a half.
const INTERIOR_OPENNESS: f32 = 0.2;
/// From a point inside, this share of all directions meets something. An atrium without a roof has
/// about 0.8.
const ENCLOSED: f32 = 0.65;
/// From a point between walls or in a room with windows, this share.
const SHUT: f32 = 0.97;
/// A view from inside is at least this share of the diagonal long. In a tangle there is none.
const MIN_LENGTH: f32 = 0.15;
/// Of a view from inside at least this share of rays hits.
const INSIDE_COVERED: f32 = 0.5;
/// Places that a camera inside may stand, how many of the best are looked from, and how many of
/// these are asked whether that is a room.
const PLACES: u32 = 512;
const FINALISTS: usize = 40;
const CANDIDATES: usize = 3;
/// Free points that stand for a room.
const ROOM_POINTS: u32 = 24;
/// Of these points, this share is seen from where the room is.
const SAME_ROOM: f32 = 0.125;
/// Surfaces that a look behind something goes through.
const LAYERS: usize = 4;
/// Of the triangles around a room, this share belongs to things that stand in it, whatever is seen
/// from outside.
const FULL: f32 = 0.4;
/// What is a room where most triangles are hidden from outside, and where they are not: many of
/// them are its walls then.
const HIDDEN: Room = Room { content: 0.01, whole: 0.55 };
const OPEN: Room = Room { content: 0.025, whole: 0.72 };

/// How much of a scene is a room.
struct Room {
    /// Of the triangles around it, the share of those that stand in it; the others are its walls.
    content: f32,
    /// Share of what is seen from outside that is its wall.
    whole: f32,
}

impl Room {
    /// Whether it has at least as much of both.
    fn is(&self, least: &Room) -> bool {
        self.content >= least.content && self.whole >= least.whole
    }
}

impl<Q: Sight> Framing<'_, Q> {
    /// The best view from a room; `None` when there is none. `outside` is a view of all.
    pub(super) fn inside(&mut self, outside: &View, fov_degrees: Option<f32>, aspect: f32) -> Option<View> {
        let hidden = self.openness() < INTERIOR_OPENNESS;
        let views = self.views_inside(fov_degrees.unwrap_or(INSIDE_FOV), aspect);
        views.into_iter().find(|view| {
            let room = self.room(view.eye, outside, aspect);
            if hidden {
                return room.content >= FULL || room.is(&HIDDEN);
            }
            room.is(&OPEN) && self.enclosure(view.eye) >= SHUT
        })
    }

    /// Mean share of the sphere around a triangle in which nothing hides it, over triangles at
    /// regular steps of their numbers: so the many small ones of what stands in a room outvote its
    /// walls.
    fn openness(&mut self) -> f32 {
        let count = self.triangles.len().min(SURFACE_SAMPLES);
        let offset = (1e-4 * self.size).max(self.nudge());
        let (mut free, mut asked) = (0, 0);
        for number in 0..count {
            let triangle = self.triangles[number * self.triangles.len() / count];
            let normal = triangle.scaled_normal().normalize_or_zero();
            if !triangle.is_finite() || normal == Vec3::ZERO {
                continue;
            }
            for direction in 0..DIRECTIONS {
                let direction = sphere_direction(direction, DIRECTIONS, number as u32);
                let side = if direction.dot(normal) < 0.0 { -normal } else { normal };
                let origin = triangle.centroid() + side * offset;
                asked += 1;
                free += u32::from(self.distance(origin, direction).is_none());
            }
        }
        if asked == 0 { 1.0 } else { free as f32 / asked as f32 }
    }

    /// Whether nothing is between two points.
    fn sees(&mut self, from: Vec3, to: Vec3) -> bool {
        self.distance(from, to - from).is_none_or(|t| t >= 0.999)
    }

    /// Share of `points` that are seen from another.
    fn seen(&mut self, from: Vec3, points: &[Vec3]) -> f32 {
        points.iter().filter(|&&point| self.sees(from, point)).count() as f32 / points.len().max(1) as f32
    }

    /// What the space around a point is.
    fn room(&mut self, eye: Vec3, outside: &View, aspect: f32) -> Room {
        let mut points = Vec::new();
        for index in 0..ROOM_POINTS {
            let direction = sphere_direction(index, ROOM_POINTS, 0);
            let share = if index % 2 == 0 { 0.5 } else { 0.85 };
            points.extend(self.distance(eye, direction).map(|t| eye + direction * (share * t)));
        }
        Room { content: self.content(&points), whole: self.wholeness(&points, outside, aspect) }
    }

    /// Of the triangles around a room, the share behind which the room goes on. They are taken at
    /// regular steps of their numbers.
    fn content(&mut self, points: &[Vec3]) -> f32 {
        let nudge = self.nudge();
        let (mut things, mut walls) = (0u32, 0u32);
        let count = self.triangles.len().min(SURFACE_SAMPLES);
        for number in 0..count {
            let triangle = self.triangles[number * self.triangles.len() / count];
            let normal = triangle.scaled_normal().normalize_or_zero();
            if !triangle.is_finite() || normal == Vec3::ZERO {
                continue;
            }
            let centre = triangle.centroid();
            let [front, back] = [normal, -normal].map(|side| self.seen(centre + side * nudge, points));
            if front.max(back) < SAME_ROOM {
                continue;
            }
            let behind = if front > back { -normal } else { normal };
            let is_thing = front.min(back) >= SAME_ROOM || self.goes_on(centre, behind, points);
            things += u32::from(is_thing);
            walls += u32::from(!is_thing);
        }
        things as f32 / (things + walls).max(1) as f32
    }

    /// Whether the room comes again behind a surface, before there is a way out.
    fn goes_on(&mut self, surface: Vec3, behind: Vec3, points: &[Vec3]) -> bool {
        let mut start = surface + behind * self.nudge();
        for _ in 0..LAYERS {
            let Some(gap) = self.distance(start, behind) else { return false };
            let middle = start + behind * (0.5 * gap);
            if self.seen(middle, points) >= SAME_ROOM {
                return true;
            }
            if self.enclosure(middle) < SHUT {
                return false;
            }
            start += behind * (gap + self.nudge());
        }
        false
    }

    /// Share of what a view from outside shows behind which the room is, at once or behind a thick
    /// wall.
    fn wholeness(&mut self, points: &[Vec3], outside: &View, aspect: f32) -> f32 {
        let [width, height] = super::GLIMPSE;
        let Ok(camera) = Camera::new(outside, (aspect * 1024.0) as u32 + 1, 1024) else { return 0.0 };
        let scale = [(aspect * 1024.0 + 1.0) / width as f32, 1024.0 / height as f32];
        let (mut hits, mut into) = (0u32, 0u32);
        for number in 0..width * height {
            let (x, y) = (number % width, number / width);
            let ray = camera.ray((x as f32 + 0.5) * scale[0], (y as f32 + 0.5) * scale[1]);
            let Some(t) = self.distance(ray.origin, ray.direction) else { continue };
            hits += 1;
            let mut start = ray.at(t + self.nudge());
            for _ in 0..2 {
                let Some(gap) = self.distance(start, ray.direction) else { break };
                let ahead = [0.1, 0.5].map(|share| start + ray.direction * (share * gap));
                if ahead.iter().any(|&point| self.seen(point, points) > 0.0) {
                    into += 1;
                    break;
                }
                if self.enclosure(ahead[1]) < SHUT {
                    break;
                }
                start += ray.direction * (gap + self.nudge());
            }
        }
        into as f32 / hits.max(1) as f32
    }

    /// How far from a surface one can look at what is on that side of it.
    fn nudge(&self) -> f32 {
        (1e-5 * self.size).max(super::smallest(&self.bounds) / 16.0)
    }

    /// The best views from free, enclosed places that are apart from each other.
    fn views_inside(&mut self, fov_degrees: f32, aspect: f32) -> Vec<View> {
        let mut places: Vec<(f32, Vec3, f32)> = (0..PLACES).filter_map(|number| self.place(number)).collect();
        // The order of equal ones is that of their numbers: the sort is stable.
        places.sort_by(|a, b| b.0.total_cmp(&a.0));
        places.truncate(FINALISTS);
        let mut views: Vec<(f32, View)> = Vec::new();
        for (length, eye, azimuth) in places {
            let target = eye + self.axes.direction(azimuth, -0.06) * (0.1 * self.size);
            let view = View { eye, target, up: self.axes.up, fov_degrees };
            let Some(glimpse) = self.glimpse(&view, aspect) else { continue };
            // In a tangle everything is in the way.
            if glimpse.obstructed > 0.4 || glimpse.covered < INSIDE_COVERED {
                continue;
            }
            // Much to see, and nothing in front of it.
            let score = 1.5 * glimpse.edges.min(0.5) + 0.1 * libm::logf(1.0 + glimpse.distinct as f32)
                - 3.0 * glimpse.obstructed
                - glimpse.backs
                + glimpse.covered
                + (length / self.size).min(0.6);
            views.push((score, view));
        }
        views.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut chosen: Vec<View> = Vec::new();
        for (_, view) in views {
            let apart = |other: &View| other.eye.distance(view.eye) > 2.0 * CLOSE * self.size;
            if chosen.len() < CANDIDATES && chosen.iter().all(apart) {
                chosen.push(view);
            }
        }
        chosen
    }

    /// A place to stand: how far and freely one sees from there, the eye, and the direction of the
    /// longest view.
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
