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
        let last = [self.previous[ear], ear, self.next[ear]].map(|i| self.points[i]);
        // A loop that runs the other way round leaves a triangle that does, too.
        let right = remaining == 3 && turn(last[0], last[1], last[2]) >= 0.0;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Triangle;
    use proptest::prelude::*;
    use std::f64::consts::TAU;

    /// Cuts a polygon and returns whether that went well, and the triangles.
    fn cut(polygon: &[Vec3]) -> (bool, Vec<Triangle>) {
        let corners: Vec<u32> = (0..polygon.len() as u32).collect();
        let mut indices = Vec::new();
        let right = Cutter::default().cut(polygon, &corners, &mut indices);
        assert_eq!(indices.len(), 3 * polygon.len().saturating_sub(2), "n - 2 triangles, always");
        let (faces, _) = indices.as_chunks::<3>();
        (right, faces.iter().map(|face| Triangle(face.map(|i| polygon[i as usize]))).collect())
    }

    /// The vector area of a planar polygon and the sum of its triangles' areas agree only when they cover it once.
    fn covers(polygon: &[Vec3]) -> bool {
        let (right, triangles) = cut(polygon);
        let mut vector = glam::DVec3::ZERO;
        for (i, a) in polygon.iter().enumerate() {
            vector += a.as_dvec3().cross(polygon[(i + 1) % polygon.len()].as_dvec3());
        }
        let area = |t: &Triangle| {
            let [a, b, c] = t.0.map(|v| v.as_dvec3());
            (b - a).cross(c - a).length()
        };
        let sum: f64 = triangles.iter().map(area).sum();
        right && (sum - vector.length()).abs() <= 1e-5 * vector.length()
    }

    fn flat(points: &[(f32, f32)]) -> Vec<Vec3> {
        points.iter().map(|&(x, y)| Vec3::new(x, y, 0.0)).collect()
    }

    #[test]
    fn convex_polygons_are_fans_from_the_first_corner() {
        let mut indices = Vec::new();
        let hexagon = flat(&[(0.0, 0.0), (1.0, 0.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0), (0.0, 1.0)]);
        assert!(Cutter::default().cut(&hexagon, &[0, 1, 2, 3, 4, 5], &mut indices));
        assert_eq!(indices, [0, 1, 2, 0, 2, 3, 0, 3, 4, 0, 4, 5]);
    }

    #[test]
    fn a_concave_quad_is_cut_through_its_reflex_corner() {
        for turn in 0..4 {
            let mut arrow = flat(&[(0.0, 0.0), (2.0, 1.0), (0.0, 2.0), (0.5, 1.0)]);
            arrow.rotate_left(turn);
            assert!(covers(&arrow), "turned by {turn}");
            arrow.reverse();
            assert!(covers(&arrow), "reversed, turned by {turn}");
        }
    }

    #[test]
    fn combs_keyholes_and_straight_edges() {
        let mut comb = Vec::new();
        for tooth in 0..230 {
            let x = tooth as f32;
            comb.extend([(x, 0.0), (x + 0.1, 9.0), (x + 0.2, 9.0), (x + 0.3, 0.0)]);
        }
        comb.extend([(230.0, -1.0), (0.0, -1.0)]);
        assert!(comb.len() > 900 && covers(&flat(&comb)));
        // A square with a square hole, joined by a cut that is walked both ways.
        let ring = [
            (0.0, 0.0),
            (4.0, 0.0),
            (4.0, 4.0),
            (0.0, 4.0),
            (0.0, 0.0),
            (1.0, 1.0),
            (1.0, 3.0),
            (3.0, 3.0),
            (3.0, 1.0),
            (1.0, 1.0),
        ];
        assert!(covers(&flat(&ring)));
        let straight =
            [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 0.0), (2.0, 2.0), (1.0, 1.0), (0.0, 2.0), (0.0, 1.0)];
        assert!(covers(&flat(&straight)));
    }

    #[test]
    fn what_crosses_itself_or_has_no_plane_still_gives_triangles() {
        let loops: Vec<(f32, f32)> = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].repeat(234);
        cut(&flat(&loops));
        assert!(!cut(&flat(&[(0.0, 0.0), (4.0, 4.0), (4.0, 0.0), (0.0, 4.1), (2.0, 9.0)])).0);
        assert!(cut(&flat(&[(0.0, 0.0), (1.0, 1.0), (2.0, 2.0), (3.0, 3.0)])).0);
        assert!(cut(&flat(&[(0.0, 0.0), (f32::NAN, 1.0), (2.0, 2.0), (f32::INFINITY, 3.0), (0.0, 1.0)])).0);
        assert!(cut(&flat(&[(0.0, 0.0); 700])).0);
    }

    #[test]
    fn the_work_for_a_huge_polygon_is_bounded() {
        // A saw of 200,000 corners in which no ear is left after the first few: without a bound, hours.
        let polygon: Vec<Vec3> = (0..200_000)
            .map(|i| {
                let angle = TAU * f64::from(i) * 7919.0 / 200_000.0;
                Vec3::new(angle.cos() as f32, angle.sin() as f32, 0.0) * (1.0 + (i % 3) as f32)
            })
            .collect();
        let started = std::time::Instant::now();
        cut(&polygon);
        assert!(started.elapsed().as_secs() < 20);
    }

    proptest! {
        /// Star-shaped around the origin, and so simple, with corners that are reflex as often as not; in any plane.
        #[test]
        fn random_simple_polygons_keep_their_area(
            radii in proptest::collection::vec(0.05_f64..1.0, 4..120),
            axis in prop::array::uniform3(-1.0_f32..1.0),
            reversed: bool,
        ) {
            let normal = Vec3::from(axis).try_normalize().unwrap_or(Vec3::Z);
            let (x, y) = normal.any_orthonormal_pair();
            let count = radii.len() as f64;
            let mut polygon: Vec<Vec3> = radii
                .iter()
                .enumerate()
                .map(|(i, radius)| {
                    let angle = TAU * i as f64 / count;
                    x * (radius * angle.cos()) as f32 + y * (radius * angle.sin()) as f32
                })
                .collect();
            if reversed {
                polygon.reverse();
            }
            prop_assert!(covers(&polygon));
        }

        #[test]
        fn any_points_give_n_minus_2_triangles(points in proptest::collection::vec(any::<(f32, f32, f32)>(), 3..40)) {
            let polygon: Vec<Vec3> = points.into_iter().map(Vec3::from).collect();
            cut(&polygon);
        }
    }
}
