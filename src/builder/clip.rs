//! The part of a triangle that lies in a box, when the box is cut in two: no point of the triangle is lost to rounding.
//!
//! The triangle is cut by the planes of the box as a polygon in double precision (Sutherland and Hodgman 1974), and the polygon
//! by the new plane into two. Each fragment's box is rounded outward and then limited to its half of the box.
//!
//! # Why nothing is lost
//! Let u be 2^-53 and M the largest coordinate of the triangle. Cutting a polygon whose vertices are as stored puts each new vertex
//! within 16 u M of where it belongs, however flat the angle, because the distances to the plane that it is computed from
//! have opposite signs. So a polygon that holds all points of the true one up to an error e, cut by the plane moved
//! outward by a margin of at least e, holds all points of the true cut up to e + 16 u M. Seven cuts stay below the
//! margin of 256 u M that every plane, and in the end the box, is moved by.

use crate::geometry::padded::PaddedAabb;
use crate::geometry::{Aabb, DVec3, Triangle, Vec3};

/// The margin over the largest coordinate.
const MARGIN: f64 = 256.0 / (1u64 << 53) as f64;

/// A triangle cut by seven planes has no more vertices. Without rounding each cut adds at most one; at worst it replaces every other
/// vertex by two: 3, 4, 6, 9, 13, 19, 28, 42.
const MOST_VERTICES: usize = 42;

/// Which half-space is kept.
#[derive(Clone, Copy, PartialEq)]
enum Keep {
    Below,
    Above,
}

/// A convex polygon in space, possibly empty.
struct Polygon {
    vertices: [DVec3; MOST_VERTICES],
    count: usize,
}

impl Polygon {
    const EMPTY: Polygon = Polygon { vertices: [DVec3::ZERO; MOST_VERTICES], count: 0 };

    fn of(triangle: &Triangle) -> Polygon {
        let mut polygon = Polygon::EMPTY;
        triangle.0.into_iter().for_each(|vertex| polygon.push(vertex.as_dvec3()));
        polygon
    }

    fn push(&mut self, vertex: DVec3) {
        self.vertices[self.count] = vertex;
        self.count += 1;
    }

    /// Makes `part` the part on one side of a plane across `axis`, borders included.
    fn cut(&self, axis: usize, plane: f64, keep: Keep, part: &mut Polygon) {
        part.count = 0;
        let vertices = &self.vertices[..self.count];
        let Some(mut from) = vertices.last() else { return };
        // Positive outside.
        let outside = |vertex: &DVec3| match keep {
            Keep::Below => vertex[axis] - plane,
            Keep::Above => plane - vertex[axis],
        };
        let mut from_outside = outside(from);
        for to in vertices {
            let to_outside = outside(to);
            if from_outside * to_outside < 0.0 {
                let mut crossing = *from + (*to - *from) * (from_outside / (from_outside - to_outside));
                crossing[axis] = plane;
                part.push(crossing);
            }
            if to_outside <= 0.0 {
                part.push(*to);
            }
            (from, from_outside) = (to, to_outside);
        }
    }

    /// The smallest box around it, `margin` wider on all sides and rounded outward, as far as it lies in `limit`; empty for no vertex.
    fn bounds(&self, margin: f64, limit: &Aabb) -> Aabb {
        let [mut lower, mut upper] = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        for vertex in &self.vertices[..self.count] {
            lower = lower.min(*vertex);
            upper = upper.max(*vertex);
        }
        if self.count == 0 {
            return Aabb::EMPTY;
        }
        let [x, y, z] = (lower - margin).to_array().map(below);
        let lower = Vec3::new(x, y, z).max(limit.lower);
        let [x, y, z] = (upper + margin).to_array().map(above);
        let part = Aabb { lower, upper: Vec3::new(x, y, z).min(limit.upper) };
        if part.is_empty() { Aabb::EMPTY } else { part }
    }
}

/// The largest number in single precision that is not above `x`.
fn below(x: f64) -> f32 {
    let nearest = x as f32;
    if f64::from(nearest) > x { nearest.next_down() } else { nearest }
}

/// The smallest number in single precision that is not below `x`.
fn above(x: f64) -> f32 {
    let nearest = x as f32;
    if f64::from(nearest) < x { nearest.next_up() } else { nearest }
}

/// Boxes around what of `triangle`, which is finite, lies in `bounds` below and above a plane across `axis`, which cuts `bounds`. Both lie
/// in their halves of `bounds`, and every point of the triangle in `bounds` lies in at least one. [`Aabb::EMPTY`]
/// where there is nothing.
pub fn fragments(triangle: &Triangle, bounds: &PaddedAabb, axis: usize, plane: f32) -> [Aabb; 2] {
    let bounds = Aabb::from(*bounds);
    let whole = triangle.bounds();
    let largest = whole.lower.abs().max(whole.upper.abs()).max_element();
    let margin = f64::from(largest) * MARGIN;
    let mut buffers = [Polygon::of(triangle), Polygon::EMPTY];
    let [mut polygon, mut part] = buffers.each_mut();
    for side in 0..3 {
        if whole.lower[side] < bounds.lower[side] {
            polygon.cut(side, f64::from(bounds.lower[side]) - margin, Keep::Above, part);
            std::mem::swap(&mut polygon, &mut part);
        }
        if whole.upper[side] > bounds.upper[side] {
            polygon.cut(side, f64::from(bounds.upper[side]) + margin, Keep::Below, part);
            std::mem::swap(&mut polygon, &mut part);
        }
    }
    let plane_64 = f64::from(plane);
    let mut left = bounds;
    left.upper[axis] = plane;
    polygon.cut(axis, plane_64 + margin, Keep::Below, part);
    left = part.bounds(margin, &left);
    let mut right = bounds;
    right.lower[axis] = plane;
    polygon.cut(axis, plane_64 - margin, Keep::Above, part);
    right = part.bounds(margin, &right);
    [left, right]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    fn vector(random: &mut Random) -> Vec3 {
        Vec3::new(random.unit(), random.unit(), random.unit()) - 0.5
    }

    /// Ordinary ones, slivers, flat ones, segments and points, far from the origin, huge and tiny.
    fn triangles(random: &mut Random) -> Vec<Triangle> {
        let mut triangles = Vec::new();
        for kind in 0..8 {
            for scale in [1.0, 1e-30, 1e30, f32::MAX, 1e-42] {
                let [a, b, c] = [0; 3].map(|_| vector(random));
                let corners = match kind {
                    0 => [a, b, c],
                    1 => [a, b, b + 1e-6 * c],
                    2 => [a, b, a + 0.3 * (b - a) + 1e-7 * c],
                    3 => [a, Vec3::new(a.x, b.y, b.z), Vec3::new(a.x, c.y, c.z)],
                    4 => [a, b, a],
                    5 => [a, a, a],
                    6 => [a, b, c].map(|v| Vec3::splat(0.4) + 1e-4 * v),
                    _ => [a, Vec3::new(b.x, a.y.next_up(), b.z), Vec3::new(c.x, a.y, c.z)],
                };
                triangles.push(Triangle(corners.map(|v| v * scale)));
            }
        }
        triangles
    }

    /// Points of a triangle, its corners and edges included.
    fn points(triangle: &Triangle, random: &mut Random) -> Vec<DVec3> {
        let [a, b, c] = triangle.0.map(|v| v.as_dvec3());
        let mut points = vec![a, b, c];
        for _ in 0..60 {
            let (u, v) = (random.unit() as f64, random.unit() as f64);
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            points.push(a + u * (b - a) + v * (c - a));
            points.extend([a + u * (b - a), a + u * (c - a), b + u * (c - b)]);
        }
        points
    }

    fn holds(bounds: &Aabb, point: DVec3, slack: f64) -> bool {
        (bounds.lower.as_dvec3() - slack).cmple(point).all()
            && point.cmple(bounds.upper.as_dvec3() + slack).all()
    }

    #[test]
    fn fragments_of_fragments_cover_the_triangle_and_stay_in_their_boxes() {
        let mut random = Random::new(5);
        for _ in 0..40 {
            for triangle in triangles(&mut random) {
                let mut boxes = vec![triangle.bounds()];
                for _ in 0..60 {
                    let bounds = boxes.swap_remove(random.below(boxes.len() as u64) as usize);
                    let axis = random.below(3) as usize;
                    let share = [0.0, 1.0, 0.5, random.unit()][random.below(4) as usize];
                    let plane = bounds.lower[axis] * (1.0 - share) + bounds.upper[axis] * share;
                    let plane = plane.clamp(bounds.lower[axis], bounds.upper[axis]);
                    let [left, right] = fragments(&triangle, &bounds.into(), axis, plane);
                    for part in [left, right].iter().filter(|part| !part.is_empty()) {
                        assert!(bounds.contains(part), "{triangle:?} in {bounds:?}: {part:?}");
                        boxes.push(*part);
                    }
                    assert!(left.is_empty() || left.upper[axis] <= plane);
                    assert!(right.is_empty() || right.lower[axis] >= plane);
                    assert!(!left.is_empty() || !right.is_empty(), "{triangle:?} in {bounds:?} at {plane}");
                }
                // The points themselves are rounded.
                let largest = triangle.0.iter().map(|v| v.abs().max_element()).fold(0.0, f32::max);
                let slack = 8.0 * f64::EPSILON * largest as f64;
                for point in points(&triangle, &mut random) {
                    let held = boxes.iter().any(|bounds| holds(bounds, point, slack));
                    assert!(held, "{point} of {triangle:?} is in none of {boxes:?}");
                }
            }
        }
    }

    #[test]
    fn the_triangle_is_cut_not_its_box() {
        let triangle = Triangle([Vec3::ZERO, Vec3::new(4.0, 4.0, 0.0), Vec3::new(4.0, 0.0, 0.0)]);
        let [left, right] = fragments(&triangle, &triangle.bounds().into(), 0, 1.0);
        let near = |a: Vec3, b: Vec3| (a - b).abs().max_element() <= 1e-6;
        assert!(near(left.upper, Vec3::new(1.0, 1.0, 0.0)) && left.lower == Vec3::ZERO);
        assert!(right.lower == Vec3::new(1.0, 0.0, 0.0) && right.upper == Vec3::new(4.0, 4.0, 0.0));
        // Above y = 3 the triangle only has x from 3, whatever box was cut before.
        let [_, top] = fragments(&triangle, &right.into(), 1, 3.0);
        assert!(near(top.lower, Vec3::new(3.0, 3.0, 0.0)) && top.upper == right.upper);
        // Nothing is left of the plane above the diagonal.
        let corner = Aabb { lower: Vec3::new(0.0, 2.0, 0.0), upper: Vec3::new(4.0, 4.0, 0.0) };
        assert!(fragments(&triangle, &corner.into(), 0, 1.0)[0].is_empty());
    }
}
