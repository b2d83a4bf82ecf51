//! Polygons cut into triangles: as a fan when convex, by ear clipping (Meisters 1975) when not.
//!
//! A polygon is projected along the largest axis of its normal (Newell's sum). Products of `f32` differences are computed
//! in `f64`, where they are exact for all but extreme coordinates. The work for one polygon is bounded in its corner count;
//! one that crosses itself, or that is too large, ends as a fan.

use crate::geometry::Vec3;

/// Containment tests that ear clipping may spend per corner. A polygon of up to 1,024 corners never needs more.
const TESTS_PER_CORNER: usize = 1024;

/// Buffers that are kept from polygon to polygon.
#[derive(Default)]
pub struct Cutter {
    points: Vec<[f64; 2]>,
    previous: Vec<usize>,
    next: Vec<usize>,
}

impl Cutter {
    /// Cuts the polygon with these corners into `corners.len() - 2` triangles and appends their vertex indices.
    /// Every corner must be an index into `vertices`. The first triangle of a fan starts at the first corner, as everywhere.
    ///
    /// Returns whether the cut is right; `false` when it is the fan of last resort.
    pub fn cut(&mut self, vertices: &[Vec3], corners: &[u32], triangles: &mut Vec<u32>) -> bool {
        if corners.len() <= 3 {
            if corners.len() == 3 {
                triangles.extend_from_slice(corners);
            }
            return true;
        }
        if !self.project(vertices, corners) {
            // No area or not finite: no cut is better than another.
            fan(corners, triangles);
            return true;
        }
        if corners.len() == 4 {
            return self.cut_quad(corners, triangles);
        }
        if self.is_convex() {
            fan(corners, triangles);
            return true;
        }
        self.clip_ears(corners, triangles)
    }

    /// Fills `points` with the polygon seen from the side of its normal, so that it runs counter-clockwise.
    fn project(&mut self, vertices: &[Vec3], corners: &[u32]) -> bool {
        let Some(&first) = corners.first() else { return false };
        let origin = vertices[first as usize].as_dvec3();
        let mut normal = glam::DVec3::ZERO;
        let at = |corner: u32| vertices[corner as usize].as_dvec3() - origin;
        for (&corner, &after) in corners.iter().zip(corners.iter().cycle().skip(1)) {
            normal += at(corner).cross(at(after));
        }
        if !normal.is_finite() || normal == glam::DVec3::ZERO {
            return false;
        }
        let axis = normal.abs().max_position();
        let (mut x, mut y) = ((axis + 1) % 3, (axis + 2) % 3);
        if normal[axis] < 0.0 {
            std::mem::swap(&mut x, &mut y);
        }
        self.points.clear();
        self.points.extend(corners.iter().map(|&corner| {
            let point = at(corner);
            [point[x], point[y]]
        }));
        true
    }

    /// The diagonal from corner 0 unless only the other one is inside.
    fn cut_quad(&self, corners: &[u32], triangles: &mut Vec<u32>) -> bool {
        let &[a, b, c, d] = corners else { return false };
        let turn = |i: usize, j: usize, k: usize| turn(self.points[i], self.points[j], self.points[k]);
        if turn(0, 1, 2) >= 0.0 && turn(0, 2, 3) >= 0.0 {
            triangles.extend([a, b, c, a, c, d]);
            return true;
        }
        if turn(1, 2, 3) >= 0.0 && turn(1, 3, 0) >= 0.0 {
            triangles.extend([b, c, d, b, d, a]);
            return true;
        }
        fan(corners, triangles);
        false
    }

    /// No right turn, and once around only: the first corner sees every edge from its left.
    fn is_convex(&self) -> bool {
        let points = &self.points;
        let count = points.len();
        (0..count).all(|i| {
            let (a, b, c) = (points[i], points[(i + 1) % count], points[(i + 2) % count]);
            turn(a, b, c) >= 0.0 && turn(points[0], a, b) >= 0.0
        })
    }

    fn clip_ears(&mut self, corners: &[u32], triangles: &mut Vec<u32>) -> bool {
        let count = corners.len();
        self.previous.clear();
        self.previous.extend((0..count).map(|i| (i + count - 1) % count));
        self.next.clear();
        self.next.extend((0..count).map(|i| (i + 1) % count));
        let mut tests = TESTS_PER_CORNER.saturating_mul(count);
        let mut remaining = count;
        let mut ear = 0;
        // Corners looked at since the last ear. A second round also accepts corners without area (repeated or collinear
        // vertices), which would otherwise be cut first and leave the polygon with needles.
        let mut looked = 0;
        while remaining > 3 {
            let (before, after) = (self.previous[ear], self.next[ear]);
            if self.is_ear(before, ear, after, looked >= remaining, &mut tests) {
                triangles.extend([corners[before], corners[ear], corners[after]]);
                self.next[before] = after;
                self.previous[after] = before;
                remaining -= 1;
                looked = 0;
                // Stepping over the new neighbour spreads the ears around the polygon instead of making a fan of slivers.
                ear = self.next[after];
            } else {
                ear = after;
                looked += 1;
                if looked > 2 * remaining || tests == 0 {
                    break;
                }
            }
        }
        let right = remaining == 3;
        // What is left: the last triangle, or a ring that cannot be cut properly.
        let mut middle = self.next[ear];
        for _ in 2..remaining {
            let after = self.next[middle];
            triangles.extend([corners[ear], corners[middle], corners[after]]);
            middle = after;
        }
        right
    }

    /// Whether the triangle at `ear` turns left (or, on the second round, has no area) and no other corner lies in it.
    fn is_ear(&self, before: usize, ear: usize, after: usize, flat: bool, tests: &mut usize) -> bool {
        let [a, b, c] = [before, ear, after].map(|i| self.points[i]);
        let area = turn(a, b, c);
        if area < 0.0 || area.is_nan() {
            return false;
        }
        if area == 0.0 {
            // A corner in the middle of a straight edge, or a repeated one, can go; the tip of a spike too.
            return flat;
        }
        let mut other = self.next[after];
        while other != before {
            if *tests == 0 {
                return false;
            }
            *tests -= 1;
            let p = self.points[other];
            if turn(a, b, p) >= 0.0
                && turn(b, c, p) >= 0.0
                && turn(c, a, p) >= 0.0
                && !self.only_touches([a, b, c], other)
            {
                return false;
            }
            other = self.next[other];
        }
        true
    }

    /// Whether corner `other`, which lies in or on the triangle, is one of its three points again and its edges stay out:
    /// the two sides of a keyhole cut share points like that.
    fn only_touches(&self, [a, b, c]: [[f64; 2]; 3], other: usize) -> bool {
        let p = self.points[other];
        let (entering, leaving) = (self.points[self.previous[other]], self.points[self.next[other]]);
        let inside = |from: [f64; 2], at: [f64; 2], to: [f64; 2], q: [f64; 2]| {
            turn(from, at, q) > 0.0 && turn(at, to, q) > 0.0
        };
        let free = |from: [f64; 2], at: [f64; 2], to: [f64; 2]| {
            p == at && !inside(from, at, to, entering) && !inside(from, at, to, leaving)
        };
        free(c, a, b) || free(a, b, c) || free(b, c, a)
    }
}

fn fan(corners: &[u32], triangles: &mut Vec<u32>) {
    if let [first, rest @ ..] = corners {
        for pair in rest.windows(2) {
            triangles.extend([*first, pair[0], pair[1]]);
        }
    }
}

/// Twice the signed area of a triangle: positive for a left turn.
#[inline]
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}
