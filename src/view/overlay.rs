//! What is drawn into the scene beside its surfaces: lines, points and faces, each batch with its own opacity.
//!
//! A batch that does not change keeps its `Arc`: the GPU then keeps its copy.

use super::paint::Rgba;
use crate::geometry::{Aabb, Vec3};
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;

/// A segment, as wide as so many pixels.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Line {
    pub from: Vec3,
    pub width: f32,
    pub to: Vec3,
    pub color: Rgba,
}

/// A disc of so many pixels across.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Point {
    pub at: Vec3,
    pub size: f32,
    pub color: Rgba,
}

/// A corner of a face: three make a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Corner {
    pub at: Vec3,
    pub color: Rgba,
}

/// Shapes of one kind.
#[derive(Clone, Debug)]
pub enum Shapes {
    Lines(Arc<Vec<Line>>),
    Points(Arc<Vec<Point>>),
    Faces(Arc<Vec<Corner>>),
}

impl PartialEq for Shapes {
    /// Shapes that are kept are the same at a glance.
    fn eq(&self, other: &Shapes) -> bool {
        fn same<T: PartialEq>(a: &Arc<Vec<T>>, b: &Arc<Vec<T>>) -> bool {
            Arc::ptr_eq(a, b) || a == b
        }
        match (self, other) {
            (Shapes::Lines(a), Shapes::Lines(b)) => same(a, b),
            (Shapes::Points(a), Shapes::Points(b)) => same(a, b),
            (Shapes::Faces(a), Shapes::Faces(b)) => same(a, b),
            _ => false,
        }
    }
}

/// Shapes that are drawn alike.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    pub shapes: Shapes,
    /// 0 to 1, times that of each shape's colour.
    pub opacity: f32,
    /// How much of it is left behind surfaces, 0 to 1.
    pub behind: f32,
    /// Times the widths of lines and the sizes of points.
    pub scale: f32,
    /// Whether fewer of the shapes are drawn while the camera moves.
    pub thinned: bool,
}

/// Everything that is drawn over one picture, in this order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Overlay {
    pub batches: Vec<Batch>,
}

impl Overlay {
    pub fn push(&mut self, shapes: Shapes, opacity: f32, behind: f32) {
        self.batches.push(Batch { shapes, opacity, behind, scale: 1.0, thinned: false });
    }

    /// The twelve edges of boxes.
    pub fn boxes(&mut self, boxes: &[(Aabb, Rgba, f32)], opacity: f32, behind: f32) {
        let mut lines = Vec::with_capacity(12 * boxes.len());
        for (bounds, color, width) in boxes {
            edges(bounds, *color, *width, &mut lines);
        }
        if !lines.is_empty() {
            self.push(Shapes::Lines(Arc::new(lines)), opacity, behind);
        }
    }
}

/// Corner `number` (bit 0: x, 1: y, 2: z; set for the upper bound) of a box.
pub fn corner(bounds: &Aabb, number: usize) -> Vec3 {
    let ends = [bounds.lower, bounds.upper];
    Vec3::new(ends[number & 1].x, ends[number >> 1 & 1].y, ends[number >> 2 & 1].z)
}

/// Adds the twelve edges of a box.
pub fn edges(bounds: &Aabb, color: Rgba, width: f32, lines: &mut Vec<Line>) {
    for axis in 0..3 {
        for number in (0..8usize).filter(|number| number >> axis & 1 == 0) {
            let (from, to) = (corner(bounds, number), corner(bounds, number | 1 << axis));
            lines.push(Line { from, width, to, color });
        }
    }
}

/// Adds a rectangle as two triangles; `corners` go round it.
pub fn rectangle(corners: [Vec3; 4], color: Rgba, faces: &mut Vec<Corner>) {
    faces.extend([0, 1, 2, 0, 2, 3].map(|index: usize| Corner { at: corners[index], color }));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_has_twelve_edges_of_its_own_lengths() {
        let bounds = Aabb { lower: Vec3::ZERO, upper: Vec3::new(1.0, 2.0, 4.0) };
        let mut lines = Vec::new();
        edges(&bounds, [255; 4], 1.0, &mut lines);
        assert_eq!(lines.len(), 12);
        let total: f32 = lines.iter().map(|line| line.from.distance(line.to)).sum();
        assert_eq!(total, 4.0 * (1.0 + 2.0 + 4.0));
        lines.sort_by_key(|line| format!("{line:?}"));
        lines.dedup();
        assert_eq!(lines.len(), 12);
    }
}
