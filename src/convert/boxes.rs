//! A tree as a Wavefront OBJ, for Blender and MeshLab: its boxes, an object per level, or its triangles, an object per geometry.

use super::Losses;
use crate::format::bvh::{Bvh, Geometry, NO_INSTANCE};
use crate::geometry::{Aabb, Triangle, Vec3};
use crate::tree::TreeView;
use clap::ValueEnum;
use std::collections::HashMap;
use std::io::{self, Write};
use std::ops::RangeInclusive;

/// How boxes are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Style {
    /// Twelve lines, to be seen through
    Edges,
    /// Six faces, to be shaded
    Faces,
}

/// Corners are numbered by bits: 1 upper x, 2 upper y, 4 upper z.
const EDGES: [[u64; 2]; 12] =
    [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]];

/// Seen from outside, against the clock.
const FACES: [[u64; 4]; 6] =
    [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// Writes the boxes of the nodes of some levels; the root's is 0. Returns how many were written, and what was not.
///
/// # Errors
/// When `out` cannot be written.
pub fn write_boxes(
    out: &mut dyn Write,
    tree: TreeView,
    levels: &RangeInclusive<u32>,
    style: Style,
) -> io::Result<(u64, Losses)> {
    let mut losses = Losses::default();
    let level_of = tree.levels();
    let mut chosen: Vec<usize> =
        (0..tree.nodes.len()).filter(|&index| levels.contains(&level_of[index])).collect();
    chosen.sort_by_key(|&index| level_of[index]);
    losses.leave_out("node of another level", (tree.nodes.len() - chosen.len()) as u64);

    writeln!(out, "# Boxes of a tree, written by embree-trace: an object per level, the root's is 0")?;
    let mut level = None;
    let mut written = 0;
    for index in chosen {
        let bounds = tree.nodes[index].bounds();
        if bounds.is_empty() || !bounds.lower.is_finite() || !bounds.upper.is_finite() {
            losses.leave_out("node whose box is empty or not finite", 1);
            continue;
        }
        if level.replace(level_of[index]) != Some(level_of[index]) {
            writeln!(out, "o level_{}", level_of[index])?;
        }
        write_box(out, &bounds, written * 8 + 1, style)?;
        written += 1;
    }
    Ok((written, losses))
}

/// One box, whose first corner is vertex `first`.
fn write_box(out: &mut dyn Write, bounds: &Aabb, first: u64, style: Style) -> io::Result<()> {
    for corner in 0..8 {
        let side = |axis: usize| {
            let upper = corner >> axis & 1 == 1;
            if upper { bounds.upper[axis] } else { bounds.lower[axis] }
        };
        writeln!(out, "v {} {} {}", side(0), side(1), side(2))?;
    }
    match style {
        Style::Edges => EDGES.iter().try_for_each(|[a, b]| writeln!(out, "l {} {}", first + a, first + b)),
        Style::Faces => FACES.iter().try_for_each(|[a, b, c, d]| {
            writeln!(out, "f {} {} {} {}", first + a, first + b, first + c, first + d)
        }),
    }
}

/// Writes the triangles, in the order of `TRIS`, so that a face's number in the file is its triangle's; vertices of the same bits once. Returns how many,
/// and how many have a vertex that other programs cannot read.
///
/// # Errors
/// When `out` cannot be written.
pub fn write_triangles(out: &mut dyn Write, bvh: &Bvh) -> io::Result<(u64, Losses)> {
    let mut losses = Losses::default();
    let infinite = bvh.triangles.iter().filter(|triangle| !triangle.is_finite()).count();
    losses.lose(
        "coordinate of a triangle that is not finite, which other programs read as they like",
        infinite as u64,
    );
    writeln!(out, "# Triangles of a tree, written by embree-trace: in the order of its TRIS")?;
    let mut numbers: HashMap<[u32; 3], u64> = HashMap::new();
    let mut geometries = bvh.geometries.iter().filter(|geometry| geometry.triangle_count > 0).peekable();
    let mut named = None;
    for (index, Triangle(vertices)) in bvh.triangles.iter().enumerate() {
        let end = |geometry: &Geometry| geometry.first_triangle as usize + geometry.triangle_count as usize;
        while geometries.next_if(|geometry| end(geometry) <= index).is_some() {}
        let own = geometries.peek().filter(|geometry| geometry.first_triangle as usize <= index);
        let own = own.map(|geometry| (geometry.instance, geometry.geometry));
        if named.replace(own) != Some(own) {
            writeln!(out, "o {}", name(own))?;
        }
        let mut corners = [0; 3];
        for (corner, vertex) in corners.iter_mut().zip(vertices) {
            let next = numbers.len() as u64 + 1;
            *corner = *numbers.entry(vertex.to_array().map(f32::to_bits)).or_insert(next);
            if *corner == next {
                let Vec3 { x, y, z } = *vertex;
                writeln!(out, "v {x} {y} {z}")?;
            }
        }
        writeln!(out, "f {} {} {}", corners[0], corners[1], corners[2])?;
    }
    Ok((bvh.triangles.len() as u64, losses))
}

fn name(geometry: Option<(u32, u32)>) -> String {
    match geometry {
        None => "triangles".into(),
        Some((NO_INSTANCE, geometry)) => format!("geometry_{geometry}"),
        Some((instance, geometry)) => format!("instance_{instance}_geometry_{geometry}"),
    }
}
