//! Polygons cut into triangles: as a fan from the first corner when convex, else over the region
//! that their edges enclose.
//!
//! A polygon is seen along the largest axis of its normal (Newell's sum): its coordinates stay
//! those of the file, so that what touches in the file touches here. One that has no plane is seen
//! along the normal itself. `region` then covers what is inside, in n log n, by positions alone:
//! whichever corner comes first, the triangles are the same.

mod region;

use crate::geometry::{DVec3, Vec3};
use region::Region;
use robust::{Coord, orient2d};

/// A power of two that lifts the smallest `f32` into the range that `region` computes in. It rounds
/// nothing.
const SCALE: f64 = (1_u64 << 40) as f64;

/// Coordinates may be off by one unit in the last place of the polygon's largest, and, as files are
/// often written with six digits, by a millionth of the polygon's size.
const LAST_PLACE: f64 = 1.0 / (1 << 23) as f64;
const SIX_DIGITS: f64 = 1.0 / (1 << 20) as f64;

/// Of two axes along which a polygon shows nearly the same area, the first is taken, whatever the
/// last bits say.
const NEARLY: f64 = 1.0 - 1e-6;

/// Areas of which no more than this share is left when they are added up tell no direction.
const CANCELS: f64 = 1e-3;

/// Buffers that are kept from polygon to polygon.
#[derive(Default)]
pub struct Cutter {
    points: Vec<[f64; 2]>,
    cycle: Vec<u32>,
    region: Region,
}

/// Along which axis a polygon is seen.
struct View {
    axis: usize,
    /// Whether it runs clockwise there.
    clockwise: bool,
    /// Twice the area as a vector, right-handed.
    normal: DVec3,
}

impl Cutter {
    /// Cuts the polygon with these corners and appends the vertex indices of its triangles, which
    /// turn as the polygon does. Every corner must be an index into `vertices`. A convex polygon
    /// becomes the fan from its first corner, as everywhere, and any simple one `corners.len() - 2`
    /// triangles; one that touches itself as many as cover it.
    ///
    /// Returns whether the triangles cover the polygon once; `false` when it crosses itself, and is
    /// cut as a fan.
    pub fn cut(&mut self, vertices: &[Vec3], corners: &[u32], triangles: &mut Vec<u32>) -> bool {
        if corners.len() <= 3 {
            if corners.len() == 3 {
                triangles.extend_from_slice(corners);
            }
            return true;
        }
        let Some(view) = View::of(vertices, corners) else {
            // On one line, or not finite: no cut is better than another.
            fan(corners, triangles);
            return true;
        };
        self.see_along_axis(vertices, corners, view.axis);
        let right = if let &[a, b, c, d] = corners {
            self.cut_quad([a, b, c, d], vertices, &view, triangles)
        } else if self.is_fan(view.clockwise) {
            fan(corners, triangles);
            true
        } else {
            self.cut_region(vertices, corners, view, triangles)
        };
        if !right {
            fan(corners, triangles);
        }
        right
    }

    fn see_along_axis(&mut self, vertices: &[Vec3], corners: &[u32], axis: usize) {
        let (x, y) = ((axis + 1) % 3, (axis + 2) % 3);
        self.points.clear();
        self.points.extend(corners.iter().map(|&corner| {
            let vertex = vertices[corner as usize];
            [f64::from(vertex[x]) * SCALE, f64::from(vertex[y]) * SCALE]
        }));
    }

    /// Twice the signed area of a triangle of corners, positive when it turns as the polygon; its
    /// sign is exact.
    #[inline]
    fn turn(&self, clockwise: bool, [i, j, k]: [usize; 3]) -> f64 {
        let [a, b, c] = [i, j, k].map(|corner| {
            let [x, y] = self.points[corner];
            Coord { x, y }
        });
        let turn = orient2d(a, b, c);
        if clockwise { -turn } else { turn }
    }

    /// Whether the polygon is convex, and the fan from its first corner has no triangle without
    /// area.
    fn is_fan(&self, clockwise: bool) -> bool {
        let count = self.points.len();
        let turn = |corners| self.turn(clockwise, corners);
        // Seen from the first corner, the others stand one after the other, through half a turn at
        // most.
        (1..count - 1).all(|i| turn([0, i, i + 1]) > 0.0)
            && (2..count - 1).all(|i| turn([0, 1, i]) > 0.0)
            && (0..count).all(|i| turn([i, (i + 1) % count, (i + 2) % count]) >= 0.0)
    }

    /// Along the diagonal from corner 0 unless only the other one is inside.
    fn cut_quad(
        &mut self,
        corners: [u32; 4],
        vertices: &[Vec3],
        view: &View,
        triangles: &mut Vec<u32>,
    ) -> bool {
        const DIAGONALS: [[[usize; 3]; 2]; 2] = [[[0, 1, 2], [0, 2, 3]], [[1, 2, 3], [1, 3, 0]]];
        // The smaller one of a diagonal's two triangles; below zero, the diagonal is not inside.
        let smaller = |cutter: &Cutter, clockwise: bool| {
            DIAGONALS.map(|[one, other]| cutter.turn(clockwise, one).min(cutter.turn(clockwise, other)))
        };
        // The first diagonal that leaves both triangles an area, else the better one.
        let choice = |[first, second]: [f64; 2], least: f64| {
            if first > 0.0 || second <= 0.0 && first >= second {
                (first >= least).then_some(0)
            } else {
                (second >= least).then_some(1)
            }
        };
        let along_axis = smaller(self, view.clockwise);
        let mut chosen = choice(along_axis, 0.0);
        if chosen.is_none() {
            let rounding = Rounding::of(vertices, &corners);
            let slack = self.slack(rounding.in_plane(view.axis));
            if self.see_along_normal(vertices, &corners, view, &rounding) {
                chosen = choice(smaller(self, false), 0.0);
            }
            chosen = chosen.or_else(|| choice(along_axis, -slack));
        }
        let Some(chosen) = chosen else { return false };
        triangles.extend(DIAGONALS[chosen].as_flattened().iter().map(|&corner| corners[corner]));
        true
    }

    /// By how much rounding changes the area of a triangle of these points at most.
    fn slack(&self, rounding: [f64; 2]) -> f64 {
        let width = |axis: usize| {
            let values = self.points.iter().map(|point| point[axis]);
            values.clone().fold(f64::MIN, f64::max) - values.fold(f64::MAX, f64::min)
        };
        width(0) * rounding[1] + width(1) * rounding[0]
    }

    fn cut_region(
        &mut self,
        vertices: &[Vec3],
        corners: &[u32],
        view: View,
        triangles: &mut Vec<u32>,
    ) -> bool {
        let mut cycle = std::mem::take(&mut self.cycle);
        let reversed = one_way_round(vertices, corners, &mut cycle);
        let rounding = Rounding::of(vertices, &cycle);
        let start = triangles.len();
        let view = View::of(vertices, &cycle).unwrap_or(view);
        let error = if self.see_along_normal(vertices, &cycle, &view, &rounding) {
            [rounding.largest(); 2]
        } else {
            self.see_along_axis(vertices, &cycle, view.axis);
            rounding.in_plane(view.axis)
        };
        let right = self.region.cover(&self.points, &cycle, error, triangles);
        self.cycle = cycle;
        if reversed {
            let (added, _) = triangles[start..].as_chunks_mut::<3>();
            added.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        }
        right
    }

    /// Fills `points` as seen along the normal, where the polygon runs counter-clockwise. Returns
    /// `false`, with no promise about them, when all corners are in one plane, when there is no
    /// telling which, or when two would become one.
    fn see_along_normal(
        &mut self,
        vertices: &[Vec3],
        corners: &[u32],
        view: &View,
        rounding: &Rounding,
    ) -> bool {
        let origin = vertices[corners[0] as usize].as_dvec3();
        let at = |corner: u32| vertices[corner as usize].as_dvec3() - origin;
        let edges = corners.iter().zip(corners.iter().cycle().skip(1));
        let length: f64 = edges.map(|(&from, &to)| at(from).distance(at(to))).sum();
        let Some(normal) = view.normal.try_normalize() else { return false };
        // Corners that are off by so much change the area by so much.
        if view.normal.length() * SCALE <= 4.0 * rounding.largest() * length {
            return false;
        }
        let mean = corners.iter().map(|&corner| normal.dot(at(corner))).sum::<f64>() / corners.len() as f64;
        let off_plane = |corner: u32| (normal.dot(at(corner)) - mean).abs() * SCALE;
        let allowed = 2.0 * normal.abs().dot(rounding.0);
        if corners.iter().all(|&corner| off_plane(corner) <= allowed) {
            return false;
        }
        let (x, y) = normal.any_orthonormal_pair();
        let seen = |corner: u32| {
            let place = at(corner);
            // Below this there is no precision left, and `region` computes no smaller numbers.
            [x, y]
                .map(|direction| direction.dot(place) * SCALE)
                .map(|value| if value.abs() < region::SMALLEST { 0.0 } else { value })
        };
        let mut seen: Vec<_> = corners.iter().map(|&corner| (seen(corner), corner)).collect();
        self.points.clear();
        self.points.extend(seen.iter().map(|(point, _)| *point));
        seen.sort_unstable_by(|a, b| a.0[0].total_cmp(&b.0[0]).then(a.0[1].total_cmp(&b.0[1])));
        let one = seen.windows(2).any(|pair| {
            let apart = || (at(pair[0].1) - at(pair[1].1)) * SCALE;
            pair[0].0 == pair[1].0 && apart().abs().cmpgt(2.0 * rounding.0).any()
        });
        !one
    }
}

impl View {
    /// `None` when no edge spans an area with the first corner, or when a corner is not finite.
    fn of(vertices: &[Vec3], corners: &[u32]) -> Option<View> {
        let &first = corners.first()?;
        let origin = vertices[first as usize].as_dvec3();
        let at = |corner: u32| vertices[corner as usize].as_dvec3() - origin;
        let (mut normal, mut spread) = (DVec3::ZERO, DVec3::ZERO);
        for pair in corners.windows(2) {
            let area = at(pair[0]).cross(at(pair[1]));
            normal += area;
            spread += area.abs();
        }
        if !normal.is_finite() || spread == DVec3::ZERO {
            return None;
        }
        // Where areas cancel, as in a figure of eight, only their sizes tell the plane.
        let cancels = normal.abs().max_element() <= CANCELS * spread.max_element();
        let shown = if cancels { spread } else { normal.abs() };
        let largest = shown.max_element() * NEARLY;
        let axis = (0..3).find(|&axis| shown[axis] >= largest)?;
        Some(View { axis, clockwise: normal[axis] < 0.0, normal })
    }
}

/// How far each coordinate may be from what was meant, times [`SCALE`].
struct Rounding(DVec3);

impl Rounding {
    fn of(vertices: &[Vec3], corners: &[u32]) -> Rounding {
        let (mut lower, mut upper) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &corner in corners {
            let vertex = vertices[corner as usize].as_dvec3();
            (lower, upper) = (lower.min(vertex), upper.max(vertex));
        }
        let size = (upper - lower).max_element();
        Rounding((lower.abs().max(upper.abs()) * LAST_PLACE + DVec3::splat(size * SIX_DIGITS)) * SCALE)
    }

    fn in_plane(&self, axis: usize) -> [f64; 2] {
        [self.0[(axis + 1) % 3], self.0[(axis + 2) % 3]]
    }

    fn largest(&self) -> f64 {
        self.0.max_element()
    }
}

/// Fills `cycle` with the corners in an order that depends on their positions only: from the
/// smallest one on, towards the smaller one of its neighbours. Returns whether that turned them
/// round.
fn one_way_round(vertices: &[Vec3], corners: &[u32], cycle: &mut Vec<u32>) -> bool {
    let place = |at: usize| vertices[corners[at % corners.len()] as usize].to_array();
    let less = |a: [f32; 3], b: [f32; 3]| a.partial_cmp(&b) == Some(std::cmp::Ordering::Less);
    let count = corners.len();
    let first = (0..count).reduce(|a, b| if less(place(b), place(a)) { b } else { a }).unwrap_or(0);
    cycle.clear();
    cycle.extend_from_slice(&corners[first..]);
    cycle.extend_from_slice(&corners[..first]);
    let reversed = less(place(first + count - 1), place(first + 1));
    if reversed {
        cycle[1..].reverse();
    }
    reversed
}

fn fan(corners: &[u32], triangles: &mut Vec<u32>) {
    if let [first, rest @ ..] = corners {
        for pair in rest.windows(2) {
            triangles.extend([*first, pair[0], pair[1]]);
        }
    }
}
