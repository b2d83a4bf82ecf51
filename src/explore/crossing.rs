//! A plane across the scene: where queries pass it, how dense that traffic is, and how many boxes of the tree overlap at each of its points.

use super::queries::{Sampled, Source};
use crate::format::FormatError;
use crate::format::rays::Purpose;
use crate::geometry::{Ray, Vec3};
use crate::progress::Progress;
use crate::training::even;
use crate::tree::TreeView;
use rayon::prelude::*;
use std::ops::RangeInclusive;

/// A rectangle in space: the points `center` + a · `across` + b · `up` with a and b from -1 to 1. Both vectors have a length, and are not parallel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    pub center: Vec3,
    pub across: Vec3,
    pub up: Vec3,
}

impl Plane {
    /// Through a point, perpendicular to `normal`, with `width` and `height` from edge to edge; `upwards` on the plane is where its own up is,
    /// or any direction when it stands on the plane.
    pub fn facing(center: Vec3, normal: Vec3, upwards: Vec3, [width, height]: [f32; 2]) -> Plane {
        let normal = normal.normalize_or(Vec3::Z);
        let up = upwards.reject_from_normalized(normal);
        let up = up.try_normalize().unwrap_or_else(|| normal.any_orthonormal_vector());
        Plane { center, across: 0.5 * width * up.cross(normal), up: 0.5 * height * up }
    }

    pub fn normal(&self) -> Vec3 {
        self.across.cross(self.up).normalize_or_zero()
    }

    /// The point at a, b.
    pub fn at(&self, [a, b]: [f32; 2]) -> Vec3 {
        self.center + a * self.across + b * self.up
    }

    /// Where `ray` passes the rectangle within its interval: t, a and b. A ray in the plane passes nowhere.
    pub fn crossing(&self, ray: &Ray) -> Option<(f32, [f32; 2])> {
        let [center, across, up] = [self.center, self.across, self.up].map(|v| v.as_dvec3());
        let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let normal = across.cross(up);
        let t = (center - origin).dot(normal) / direction.dot(normal);
        let point = origin + t * direction - center;
        // Coordinates of a point on the plane, whatever the angle between its axes.
        let size = normal.length_squared();
        let (a, b) = (point.cross(up).dot(normal) / size, across.cross(point).dot(normal) / size);
        let within =
            t >= f64::from(ray.tnear) && t <= f64::from(ray.tfar) && a.abs() <= 1.0 && b.abs() <= 1.0;
        within.then_some((t as f32, [a as f32, b as f32]))
    }
}

/// Cells over a plane: row by row, the first row at b = -1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// Cells in direction `across`, at least 1.
    pub columns: usize,
    /// Cells in direction `up`, at least 1.
    pub rows: usize,
}

impl Grid {
    pub fn cells(&self) -> usize {
        self.columns * self.rows
    }

    /// The cell of a point.
    pub fn cell(&self, [a, b]: [f32; 2]) -> usize {
        let place = |x: f32, cells: usize| ((0.5 * (x + 1.0) * cells as f32) as usize).min(cells.max(1) - 1);
        place(b, self.rows) * self.columns + place(a, self.columns)
    }

    /// The middle of a cell.
    pub fn middle(&self, cell: usize) -> [f32; 2] {
        let middle = |place: usize, cells: usize| (2 * place + 1) as f32 / cells as f32 - 1.0;
        [middle(cell % self.columns, self.columns), middle(cell / self.columns, self.rows)]
    }
}

/// Where a query passes the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Of the query in the file.
    pub query: u64,
    /// On the plane, -1 to 1 each.
    pub place: [f32; 2],
    /// Whether the query hit something.
    pub hit: bool,
    pub purpose: Purpose,
}

/// Everything that passes a plane.
#[derive(Clone, Debug)]
pub struct Traffic {
    /// In the order of the file; of more than were wanted, an even part.
    pub points: Vec<Point>,
    /// Queries that pass it, by whether they hit something.
    pub misses: u64,
    pub hits: u64,
    pub grid: Grid,
    /// Of those, by cell.
    pub misses_by_cell: Vec<u32>,
    pub hits_by_cell: Vec<u32>,
    pub sampled: Sampled,
}

/// Effective segments, as recorded, that pass `plane`; no more than `most` of their points.
///
/// # Errors
/// When a chunk is damaged.
pub fn traffic(
    source: &Source,
    plane: &Plane,
    grid: Grid,
    most: usize,
    progress: &Progress,
) -> Result<Traffic, FormatError> {
    let (gathered, sampled) = source.gather(progress, Vec::new, |points: &mut Vec<Point>, query| {
        let record = query.record;
        if let Some((_, place)) = plane.crossing(&record.effective_segment()) {
            let purpose = Purpose::from_byte(record.purpose);
            points.push(Point { query: query.number, place, hit: record.is_hit(), purpose });
        }
    })?;
    let mut points = gathered.concat();
    points.sort_unstable_by_key(|point| point.query);
    let (mut misses_by_cell, mut hits_by_cell) = (vec![0; grid.cells()], vec![0; grid.cells()]);
    for point in &points {
        let counts = if point.hit { &mut hits_by_cell } else { &mut misses_by_cell };
        counts[grid.cell(point.place)] += 1;
    }
    let hits = points.iter().filter(|point| point.hit).count() as u64;
    let misses = points.len() as u64 - hits;
    let points = even(&points, most);
    Ok(Traffic { points, misses, hits, grid, misses_by_cell, hits_by_cell, sampled })
}

/// How many nodes' boxes hold the middle of each cell, faces included: of the nodes on these levels, of which the root's is 0.
pub fn overlaps(tree: TreeView, plane: &Plane, grid: Grid, levels: RangeInclusive<usize>) -> Vec<u32> {
    let count = |open: &mut Vec<(u32, usize)>, cell: usize| {
        let point = plane.at(grid.middle(cell));
        let mut found = 0;
        open.push((0, 0));
        while let Some((index, level)) = open.pop() {
            let node = &tree.nodes[index as usize];
            if !(node.lower.cmple(point).all() && point.cmple(node.upper).all()) {
                continue;
            }
            found += u32::from(levels.contains(&level));
            if !node.is_leaf() && level < *levels.end() {
                open.extend(node.range().map(|child| (child as u32, level + 1)));
            }
        }
        found
    };
    (0..grid.cells()).into_par_iter().map_init(Vec::new, count).collect()
}
