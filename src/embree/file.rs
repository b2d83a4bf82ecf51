//! The scene that a `.bvh` is of, made anew from the file alone: its triangles and quads, under the
//! numbers and with the masks of their geometries.

use super::{EmbreeError, Scene, Settings, attached, check_counts};
use crate::format::bvh::{Geometry, NO_INSTANCE, geometry_kind};
use crate::geometry::{Triangle, Vec3};
use std::ops::Range;

/// Embree's geometries are an array, which a file's numbers are not to decide the size of.
const MOST_GEOMETRIES: u32 = 1 << 20;

impl Scene {
    /// Builds a scene of the triangles of a `.bvh`, which keep their numbers; quads are quads again.
    /// `geometries` is what [`whole`] makes of the file's.
    ///
    /// A geometry keeps its number where each has one of its own, as in a scene without instances;
    /// else they are numbered in their order, and such a tree can not be planted. What moves stands
    /// where it was at first. Of two masks only the bits of both count.
    ///
    /// # Errors
    /// What Embree refuses.
    pub fn of_file(
        triangles: &[Triangle],
        geometries: &[Geometry],
        settings: &Settings,
    ) -> Result<Scene, EmbreeError> {
        let vertices: &[Vec3] = bytemuck::cast_slice(triangles);
        let numbers = numbers(geometries);
        let parts = numbers.iter().map(|number| *number as usize + 1).max().unwrap_or(0);
        check_counts(triangles.len(), vertices.len(), parts)?;
        if !geometries.iter().all(|geometry| has_whole_faces(geometry, triangles.len())) {
            return Err(EmbreeError::Mesh("a geometry has triangles that the file lacks".to_owned()));
        }
        let faces: Vec<Vec<u32>> = geometries.iter().map(corners).collect();
        let nothing = Geometry { triangle_count: 0, ..part(0..0, 0) };
        let mut attaching = vec![attached(&[], &nothing); parts];
        for ((geometry, faces), number) in geometries.iter().zip(&faces).zip(numbers) {
            let [mask, instance_mask] = geometry.masks();
            attaching[number as usize] =
                attached(faces, &Geometry { mask: mask & instance_mask, ..*geometry });
        }
        // SAFETY: the arrays are those of `faces`, every index of which is in range: `has_whole_faces`.
        unsafe { Scene::commit(vertices, &attaching, geometries.to_vec(), settings) }
    }
}

/// The geometries of a file, and one more for each row of triangles that none has: those are seen by
/// every query, and so they are with all masks. Geometries stand in the order of their triangles.
pub fn whole(geometries: &[Geometry], triangles: usize) -> Vec<Geometry> {
    let mut whole = Vec::with_capacity(geometries.len() + 1);
    let mut free = geometries.iter().map(|geometry| geometry.geometry.saturating_add(1)).max().unwrap_or(0);
    let mut end = 0;
    let ends = [part(triangles as u32..triangles as u32, 0)];
    for (number, geometry) in geometries.iter().chain(&ends).enumerate() {
        if end < geometry.first_triangle {
            whole.push(part(end..geometry.first_triangle, free));
            free = free.saturating_add(1);
        }
        end = geometry.first_triangle + geometry.triangle_count;
        whole.extend((number < geometries.len()).then_some(*geometry));
    }
    whole
}

/// Triangles that everything sees.
fn part(triangles: Range<u32>, geometry: u32) -> Geometry {
    Geometry {
        instance: NO_INSTANCE,
        geometry,
        first_triangle: triangles.start,
        triangle_count: triangles.end - triangles.start,
        mask: u32::MAX,
        kind: geometry_kind::TRIANGLES,
        flags: 0,
        instance_mask: 0,
    }
}

/// Embree's number of each geometry.
fn numbers(geometries: &[Geometry]) -> Vec<u32> {
    let mut own: Vec<u32> = geometries.iter().map(|geometry| geometry.geometry).collect();
    let mut sorted = own.clone();
    sorted.sort_unstable();
    let are_distinct = sorted.windows(2).all(|pair| pair[0] != pair[1]);
    let are_low = sorted.last().is_none_or(|&last| last < MOST_GEOMETRIES);
    let are_placed = geometries.iter().any(|geometry| geometry.instance != NO_INSTANCE);
    if !are_distinct || !are_low || are_placed {
        own = (0..geometries.len() as u32).collect();
    }
    own
}

fn has_whole_faces(geometry: &Geometry, triangles: usize) -> bool {
    let is_quads = geometry.kind == geometry_kind::QUADS;
    let end = geometry.first_triangle as usize + geometry.triangle_count as usize;
    end <= triangles && !(is_quads && geometry.triangle_count % 2 == 1)
}

/// Vertices of a geometry's faces, of which every triangle of the file has three of its own. A quad
/// (v0, v1, v2, v3) stands there as (v0, v1, v3) and (v2, v3, v1).
fn corners(geometry: &Geometry) -> Vec<u32> {
    let first = 3 * geometry.first_triangle;
    let end = first + 3 * geometry.triangle_count;
    if geometry.kind == geometry_kind::QUADS {
        return (first..end).step_by(6).flat_map(|v| [v, v + 1, v + 3, v + 2]).collect();
    }
    (first..end).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_geometry_has_gets_one() {
        let rows = |geometries: &[Geometry], triangles| {
            let row = |g: &Geometry| (g.first_triangle, g.triangle_count, g.geometry);
            whole(geometries, triangles).iter().map(row).collect::<Vec<_>>()
        };
        assert_eq!(rows(&[], 5), [(0, 5, 0)]);
        assert_eq!(rows(&[], 0), []);
        let two = [part(1..3, 7), part(4..6, 2)];
        assert_eq!(rows(&two, 6), [(0, 1, 8), (1, 2, 7), (3, 1, 9), (4, 2, 2)]);
        assert_eq!(rows(&two, 9), [(0, 1, 8), (1, 2, 7), (3, 1, 9), (4, 2, 2), (6, 3, 10)]);
    }

    #[test]
    fn numbers_are_the_files_where_they_tell_geometries_apart() {
        assert_eq!(numbers(&[part(0..3, 7), part(3..6, 2)]), [7, 2]);
        assert_eq!(numbers(&[part(0..3, 7), part(3..6, 7)]), [0, 1]);
        assert_eq!(numbers(&[part(0..3, 7), part(3..6, u32::MAX)]), [0, 1]);
        let placed = Geometry { instance: 3, ..part(0..3, 7) };
        assert_eq!(numbers(&[placed]), [0]);
    }
}
