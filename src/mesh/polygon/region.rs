//! Triangles over what a closed chain of edges encloses, which may touch itself in points and along
//! edges.
//!
//! Corners at one place become one; edges that are walked both ways cancel. A constrained Delaunay
//! triangulation (the crate spade, whose predicates are exact) of the rest splits the plane, and a
//! walk over it counts how often the chain runs round each triangle: that winding number is 1
//! inside and 0 outside, or the chain crosses itself. A corner that lies beyond an edge by rounding
//! only is taken to be on it.

use spade::handles::FixedVertexHandle;
use spade::{ConstrainedDelaunayTriangulation, HasPosition, Point2, Triangulation};
use std::cmp::Ordering;

/// The smallest number above zero that [`Region::cover`] takes, as an absolute value.
pub const SMALLEST: f64 = spade::MIN_ALLOWED_VALUE;

/// Edges may be moved onto corners so often, per edge; what needs more is no rounding.
const MOVES_PER_EDGE: usize = 4;

/// Chains of more corners are stretched to be about as high as wide: spade finds its way by angles
/// round the middle, which are all alike in what is long and thin. Smaller ones get better triangles
/// as they are.
const LARGE: usize = 1_000;

/// No stretch beyond this, so that numbers stay in spade's range.
const MOST_STRETCHED: f64 = (1 << 24) as f64;

type Faces = ConstrainedDelaunayTriangulation<Place, (), i32>;

/// Buffers that are kept from polygon to polygon.
#[derive(Default)]
pub struct Region {
    order: Vec<u32>,
    numbers: Vec<u32>,
    names: Vec<u32>,
    edges: Vec<Edge>,
}

#[derive(Clone, Copy)]
struct Place([f64; 2]);

impl HasPosition for Place {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        let [x, y] = self.0;
        Point2::new(x, y)
    }
}

/// An edge from a place to a later one, and how often it is walked that way, less how often back.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Edge {
    from: u32,
    to: u32,
    times: i32,
}

impl Edge {
    fn new(from: u32, to: u32, times: i32) -> Edge {
        if from <= to { Edge { from, to, times } } else { Edge { from: to, to: from, times: -times } }
    }
}

impl Region {
    /// Covers what `points` enclose with triangles that turn as the chain of points does, and
    /// appends their names; of several corners at one place, the smallest name is taken. `rounding`
    /// is how far each coordinate may be off.
    ///
    /// Returns `false`, and appends nothing, when the chain crosses itself.
    pub fn cover(
        &mut self,
        points: &[[f64; 2]],
        names: &[u32],
        rounding: [f64; 2],
        triangles: &mut Vec<u32>,
    ) -> bool {
        let stretch = stretch(points);
        let places = self.places(points, names, stretch);
        let rounding = [rounding[0] * stretch[0], rounding[1] * stretch[1]];
        if places.len() < 3 {
            return true;
        }
        self.edges();
        let Some(faces) = divide(places, &mut self.edges, rounding) else { return false };
        self.collect(&faces, rounding, triangles)
    }

    /// The different points, sorted; numbers each corner by its place, and names each place.
    fn places(&mut self, points: &[[f64; 2]], names: &[u32], stretch: [f64; 2]) -> Vec<Place> {
        self.order.clear();
        self.order.extend(0..points.len() as u32);
        self.order.sort_unstable_by(|&a, &b| {
            let (a, b) = (a as usize, b as usize);
            points[a].partial_cmp(&points[b]).unwrap_or(Ordering::Equal).then(names[a].cmp(&names[b]))
        });
        self.numbers.clear();
        self.numbers.resize(points.len(), 0);
        self.names.clear();
        let mut places: Vec<Place> = Vec::with_capacity(points.len());
        for &corner in &self.order {
            let corner = corner as usize;
            let [x, y] = points[corner];
            let place = [x * stretch[0], y * stretch[1]];
            if places.last().is_none_or(|last| last.0 != place) {
                places.push(Place(place));
                self.names.push(names[corner]);
            }
            self.numbers[corner] = places.len() as u32 - 1;
        }
        places
    }

    /// Every edge once, in order, without those that cancel.
    fn edges(&mut self) {
        self.edges.clear();
        let ends = self.numbers.iter().zip(self.numbers.iter().cycle().skip(1));
        self.edges.extend(ends.filter(|(from, to)| from != to).map(|(&from, &to)| Edge::new(from, to, 1)));
        self.edges.sort_unstable();
        self.edges.dedup_by(|next, edge| {
            let same = (next.from, next.to) == (edge.from, edge.to);
            if same {
                edge.times += next.times;
            }
            same
        });
        self.edges.retain(|edge| edge.times != 0);
    }

    /// Appends the triangles inside; `false` when some are walked round otherwise than once.
    fn collect(&self, faces: &Faces, rounding: [f64; 2], triangles: &mut Vec<u32>) -> bool {
        let windings = windings(faces);
        let area: f64 = faces.inner_faces().map(|f| f64::from(windings[f.index()]) * f.area()).sum();
        let sense = if area < 0.0 { -1 } else { 1 };
        let wound = || faces.inner_faces().map(|face| (face, sense * windings[face.index()]));
        let twice = |winding: i32| !(0..=1).contains(&winding);
        if wound().any(|(face, winding)| twice(winding) && !is_thin(face.positions(), rounding)) {
            return false;
        }
        for (face, _) in wound().filter(|&(_, winding)| winding > 0) {
            let [a, b, c] = face.vertices().map(|vertex| self.names[vertex.index()]);
            let mut triangle = if sense > 0 { [a, b, c] } else { [a, c, b] };
            let least = (0..3).min_by_key(|&corner| triangle[corner]).unwrap_or(0);
            triangle.rotate_left(least);
            triangles.extend(triangle);
        }
        true
    }
}

/// By which powers of two to stretch a large chain. They round nothing, so what is on one line stays
/// on it.
fn stretch(points: &[[f64; 2]]) -> [f64; 2] {
    let width = |axis: usize| {
        let values = points.iter().map(|point| point[axis]);
        values.clone().fold(f64::MIN, f64::max) - values.fold(f64::MAX, f64::min)
    };
    let ratio = if points.len() < LARGE { 1.0 } else { width(0) / width(1) };
    let ratio = ratio.clamp(1.0 / MOST_STRETCHED, MOST_STRETCHED);
    // The bits of the exponent alone are the power of two that is not above.
    let power = |ratio: f64| f64::from_bits(ratio.to_bits() & f64::INFINITY.to_bits());
    if ratio > 1.0 {
        [1.0, power(ratio)]
    } else if ratio < 1.0 {
        [power(1.0 / ratio), 1.0]
    } else {
        // As wide as high, or a single point.
        [1.0, 1.0]
    }
}

/// The triangulation of all places, with every edge in it; `None` when edges cross.
fn divide(places: Vec<Place>, edges: &mut Vec<Edge>, rounding: [f64; 2]) -> Option<Faces> {
    let mut faces = Faces::bulk_load_cdt(places, Vec::new()).ok()?;
    let mut moves = MOVES_PER_EDGE * edges.len();
    // The last edge first: what a move leaves to be done is done at once.
    edges.reverse();
    while let Some(edge) = edges.pop() {
        if edge.from == edge.to {
            continue;
        }
        let [from, to] = [edge.from, edge.to].map(|number| FixedVertexHandle::from_index(number as usize));
        let parts = faces.try_add_constraint(from, to);
        if !parts.is_empty() {
            for part in parts {
                // On the way from one place to a later one, all places are in order.
                *faces.undirected_edge_data_mut(part.as_undirected()).data_mut() += edge.times;
            }
            continue;
        }
        moves = moves.checked_sub(1)?;
        move_onto_corner(&mut faces, edge, edges, rounding)?;
    }
    Some(faces)
}

/// Of two edges that cross by rounding only, splits one at that end of the other which is next to
/// it, and leaves what is to be added in `edges`.
fn move_onto_corner(faces: &mut Faces, edge: Edge, edges: &mut Vec<Edge>, rounding: [f64; 2]) -> Option<()> {
    let [from, to] = [edge.from, edge.to].map(|number| FixedVertexHandle::from_index(number as usize));
    let conflict = faces.get_conflicting_edges_between_vertices(from, to).next()?.as_undirected();
    let [a, b] = conflict.vertices().map(|vertex| vertex.index() as u32);
    let other = Edge { from: a.min(b), to: a.max(b), times: *conflict.data().data() };
    let conflict = conflict.fix();
    let place = |number: u32| {
        let position = faces.vertex(FixedVertexHandle::from_index(number as usize)).position();
        [position.x, position.y]
    };
    let candidates = [(edge, other.from), (edge, other.to), (other, edge.from), (other, edge.to)];
    let beside = |&(edge, corner): &(Edge, u32)| {
        beyond(place(edge.from), place(edge.to), place(corner), rounding).map(|share| (share, edge, corner))
    };
    let (_, split, corner) =
        candidates.iter().filter_map(beside).min_by(|one, two| one.0.total_cmp(&two.0))?;
    if split == other {
        faces.remove_constraint_edge(conflict);
        *faces.undirected_edge_data_mut(conflict).data_mut() = 0;
        edges.push(edge);
    }
    edges.push(Edge::new(corner, split.to, split.times));
    edges.push(Edge::new(split.from, corner, split.times));
    Some(())
}

/// How far `p` is from the edge between `a` and `b`, as a share of what rounding explains; `None`
/// above 1, or when it is beyond one of the ends.
fn beyond(a: [f64; 2], b: [f64; 2], p: [f64; 2], rounding: [f64; 2]) -> Option<f64> {
    let [along, to] = [b, p].map(|point| [point[0] - a[0], point[1] - a[1]]);
    let dot = along[0] * to[0] + along[1] * to[1];
    if dot <= 0.0 || dot >= along[0] * along[0] + along[1] * along[1] {
        return None;
    }
    let area = (along[0] * to[1] - along[1] * to[0]).abs();
    let allowed = along[0].abs() * rounding[1] + along[1].abs() * rounding[0];
    (area <= allowed).then(|| area / allowed)
}

/// Whether rounding may have turned a triangle over.
fn is_thin(positions: [Point2<f64>; 3], rounding: [f64; 2]) -> bool {
    let [a, b, c] = positions;
    let area = ((b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x)).abs();
    let slack =
        |p: Point2<f64>, q: Point2<f64>| (q.x - p.x).abs() * rounding[1] + (q.y - p.y).abs() * rounding[0];
    area <= 2.0 * slack(a, b).max(slack(b, c)).max(slack(c, a))
}

/// How often the edges run counter-clockwise round each face, by the face's index.
fn windings(faces: &Faces) -> Vec<i32> {
    let mut windings = vec![None; faces.num_all_faces()];
    windings[faces.outer_face().index()] = Some(0);
    // Faces are reached over edges; what is left of one is walked round so much more often than
    // what is right of it.
    let mut reached: Vec<_> = faces.convex_hull().map(|edge| edge.fix()).collect();
    while let Some(edge) = reached.pop() {
        let edge = faces.directed_edge(edge);
        let Some(left) = windings[edge.face().index()] else { continue };
        let right = edge.rev().face();
        if windings[right.index()].is_some() {
            continue;
        }
        let times = *edge.as_undirected().data().data();
        let forward = edge.from().index() < edge.to().index();
        windings[right.index()] = Some(if forward { left - times } else { left + times });
        if let Some(face) = right.as_inner() {
            reached.extend(face.adjacent_edges().map(|edge| edge.fix()));
        }
    }
    windings.into_iter().map(|winding| winding.unwrap_or(0)).collect()
}
