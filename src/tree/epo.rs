//! End-point overlap (Aila, Karras and Laine, "On Quality Metrics of Bounding Volume Hierarchies", HPG 2013, section 4):
//! how much surface lies in boxes that it does not belong to.
//!
//! Rays begin and end on surfaces, so every node whose box holds a point of a surface is entered by the rays that begin or end there.
//! For the surface's own nodes that cannot be helped; for all others it is waste:
//!
//! EPO = Σ over nodes n of C(n) · area((S \ Q(n)) ∩ n) / area(S)
//!
//! with S all surface, Q(n) the triangles in the leaves below n, and C(n) the cost of n: c_I per child, c_P per primitive.
//! A triangle that spatial splits put into several leaves belongs to each of their ancestors. Boxes are closed: a wall in the
//! plane of a box's face counts.

use super::places::Places;
use super::{Node, TreeView};
use crate::geometry::{DVec3, Triangle};
use rayon::prelude::*;

/// Triangles that one thread takes at a time: fixed, so that sums are added in the same order by any number of threads.
const PIECE: usize = 1024;

/// End-point overlap of `tree`, on rayon's threads; 0 when its triangles have no area.
pub fn end_point_overlap(tree: TreeView, triangles: &[Triangle], c_i: f64, c_p: f64) -> f64 {
    let places = Places::of(tree, triangles.len());
    let indices: Vec<u32> =
        (0..triangles.len() as u32).filter(|&index| !places.of_triangle(index).is_empty()).collect();
    let cost = |node: &Node| node.len() as f64 * if node.is_leaf() { c_p } else { c_i };
    let sums: Vec<(f64, f64)> = indices
        .par_chunks(PIECE)
        .map(|piece| {
            let mut stack = Vec::new();
            let mut sums = (0.0, 0.0);
            for &index in piece {
                let whole = Polygon::of(&triangles[index as usize]);
                sums.1 += whole.area();
                stack.push((0usize, whole));
                while let Some((number, polygon)) = stack.pop() {
                    let node = &tree.nodes[number];
                    if !places.holds(number, index) {
                        sums.0 += cost(node) * polygon.area();
                    }
                    if !node.is_leaf() {
                        let inside = |child| Some((child, polygon.clipped(&tree.nodes[child])?));
                        stack.extend(node.range().filter_map(inside));
                    }
                }
            }
            sums
        })
        .collect();
    let (overlap, surface) = sums.iter().fold((0.0, 0.0), |sum, part| (sum.0 + part.0, sum.1 + part.1));
    if surface > 0.0 { overlap / surface } else { 0.0 }
}

/// A triangle clipped to boxes: each of the six planes adds a corner at most.
#[derive(Clone, Copy)]
struct Polygon {
    corners: [DVec3; 9],
    count: usize,
}

impl Polygon {
    fn of(triangle: &Triangle) -> Polygon {
        let mut corners = [DVec3::ZERO; 9];
        for (corner, vertex) in corners.iter_mut().zip(&triangle.0) {
            *corner = vertex.as_dvec3();
        }
        Polygon { corners, count: 3 }
    }

    fn corners(&self) -> &[DVec3] {
        &self.corners[..self.count]
    }

    fn area(&self) -> f64 {
        let corners = self.corners();
        let fan = corners[1..].windows(2).map(|edge| (edge[0] - corners[0]).cross(edge[1] - corners[0]));
        0.5 * fan.sum::<DVec3>().length()
    }

    /// What lies in the closed box of `node` (Sutherland and Hodgman 1974); `None` when that is nothing.
    fn clipped(&self, node: &Node) -> Option<Polygon> {
        let (lower, upper) = (node.lower.as_dvec3(), node.upper.as_dvec3());
        let mut polygon = *self;
        for axis in 0..3 {
            for (sign, limit) in [(1.0, -lower[axis]), (-1.0, upper[axis])] {
                let inside = |corner: &DVec3| sign * corner[axis] + limit;
                let within = polygon.corners().iter().filter(|corner| inside(corner) >= 0.0).count();
                if within == 0 {
                    return None;
                }
                if within < polygon.count {
                    polygon = polygon.cut(inside);
                }
            }
        }
        Some(polygon)
    }

    /// What lies where `inside` is not negative.
    fn cut(&self, inside: impl Fn(&DVec3) -> f64) -> Polygon {
        let mut cut = Polygon { corners: [DVec3::ZERO; 9], count: 0 };
        let mut add = |corner| {
            // Rounding can make an outline cross a plane more than twice; what is beyond the room is nothing but rounding.
            if let Some(place) = cut.corners.get_mut(cut.count) {
                *place = corner;
                cut.count += 1;
            }
        };
        let mut from = self.corners[self.count - 1];
        for &to in self.corners() {
            let (a, b) = (inside(&from), inside(&to));
            if (a < 0.0) != (b < 0.0) {
                add(from.lerp(to, a / (a - b)));
            }
            if b >= 0.0 {
                add(to);
            }
            from = to;
        }
        cut
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Aabb, Vec3};
    use crate::tree::Tree;

    fn aabb(lower: [f32; 3], upper: [f32; 3]) -> Aabb {
        Aabb { lower: lower.into(), upper: upper.into() }
    }

    fn triangle(corners: [[f32; 3]; 3]) -> Triangle {
        Triangle(corners.map(Vec3::from))
    }

    /// Two flat triangles of area 8, half of the second in the box of the first.
    fn overlapping() -> (Tree, Vec<Triangle>) {
        let triangles = vec![
            triangle([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]]),
            triangle([[4.0, -2.0, 0.0], [4.0, 2.0, 0.0], [0.0, 2.0, 0.0]]),
        ];
        let boxes = [triangles[0].bounds(), triangles[1].bounds()];
        let nodes = vec![
            Node::inner(boxes[0].union(&boxes[1]), 1, 2),
            Node::leaf(boxes[0], 0, 1),
            Node::leaf(boxes[1], 1, 1),
        ];
        (Tree { nodes, primitives: vec![0, 1] }, triangles)
    }

    #[test]
    fn a_case_that_can_be_done_by_hand() {
        let (tree, triangles) = overlapping();
        // Of the second, the part above y = 0: 8 less the triangle below of legs 2, so 6, lies in the first's box [0,4] × [0,4].
        // Of the first, the part below y = 2 lies in the second's box [0,4] × [-2,2]: 8 less legs of 2, so 6.
        let epo = end_point_overlap(tree.view(), &triangles, 100.0, 1.0);
        assert!((epo - 12.0 / 16.0).abs() < 1e-12, "{epo}");
        assert_eq!(end_point_overlap(tree.view(), &triangles, 100.0, 0.0), 0.0, "all belongs to the root");
    }

    #[test]
    fn what_is_in_several_leaves_belongs_to_each() {
        let (mut tree, triangles) = overlapping();
        tree.primitives = vec![0, 1, 1];
        tree.nodes[1] = Node::leaf(tree.nodes[1].bounds(), 0, 2);
        tree.nodes[2] = Node::leaf(tree.nodes[2].bounds(), 2, 1);
        let epo = end_point_overlap(tree.view(), &triangles, 1.0, 1.0);
        assert!((epo - 6.0 / 16.0).abs() < 1e-12, "only the first triangle in the second's box: {epo}");
    }

    #[test]
    fn clipping_keeps_the_area_inside() {
        let node = |bounds| Node::leaf(bounds, 0, 1);
        let large = Polygon::of(&triangle([[-9.0, -9.0, 0.5], [9.0, -9.0, 0.5], [0.0, 18.0, 0.5]]));
        let slice = large.clipped(&node(aabb([0.0; 3], [1.0; 3]))).expect("an overlap");
        assert!((slice.area() - 1.0).abs() < 1e-12);
        assert!(large.clipped(&node(aabb([0.0, 0.0, 0.6], [1.0; 3]))).is_none());
        // In the plane of a face it counts whole; beside it by a point or an edge it has no area.
        assert!(
            (large.clipped(&node(aabb([0.0, 0.0, 0.5], [1.0; 3]))).expect("a touch").area() - 1.0).abs()
                < 1e-12
        );
        // A regular hexagon of side √2 is what the plane x + y + z = 3 leaves of a cube of side 2.
        let diagonal = Polygon::of(&triangle([[9.0, -3.0, -3.0], [-3.0, 9.0, -3.0], [-3.0, -3.0, 9.0]]));
        let hexagon = diagonal.clipped(&node(aabb([0.0; 3], [2.0; 3]))).expect("an overlap");
        assert_eq!(hexagon.count, 6);
        assert!((hexagon.area() - 3.0 * 3f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn nothing_has_no_overlap() {
        let empty = Tree { nodes: vec![Node::leaf(Aabb::EMPTY, 0, 0)], primitives: vec![] };
        assert_eq!(end_point_overlap(empty.view(), &[], 1.0, 1.0), 0.0);
        let point = triangle([[1.0; 3]; 3]);
        let tree = Tree { nodes: vec![Node::leaf(point.bounds(), 0, 1)], primitives: vec![0] };
        assert_eq!(end_point_overlap(tree.view(), &[point], 1.0, 1.0), 0.0);
    }
}
