//! What a triangle has from its geometry: masks, and whether it moves.

use crate::format::bvh::{Geometry, geometry_flag};

/// Finds a triangle's masks.
#[derive(Clone, Debug)]
pub struct Masks<'a> {
    /// By first triangle.
    geometries: Vec<&'a Geometry>,
    any_moves: bool,
    any_two: bool,
}

impl<'a> Masks<'a> {
    pub fn new(geometries: &'a [Geometry]) -> Masks<'a> {
        let mut geometries: Vec<&Geometry> = geometries.iter().filter(|g| g.triangle_count > 0).collect();
        geometries.sort_by_key(|geometry| geometry.first_triangle);
        let any_moves = geometries.iter().any(|geometry| moves(geometry));
        let any_two = geometries.iter().any(|geometry| geometry.masks()[1] != u32::MAX);
        Masks { geometries, any_moves, any_two }
    }

    /// Those of the geometry and of its instance, with each of which a query must share a bit. All
    /// bits where there is none: every query sees a triangle that no geometry names.
    pub fn of(&self, triangle: u32) -> [u32; 2] {
        self.geometry(triangle).map_or([u32::MAX; 2], Geometry::masks)
    }

    /// Whether any triangle has two masks of which neither is all bits.
    pub fn any_two(&self) -> bool {
        self.any_two
    }

    /// Whether any triangle moves.
    pub fn any_moves(&self) -> bool {
        self.any_moves
    }

    /// Whether a triangle moves: then it was elsewhere for queries of another time.
    pub fn moves(&self, triangle: u32) -> bool {
        self.any_moves && self.geometry(triangle).is_some_and(moves)
    }

    fn geometry(&self, triangle: u32) -> Option<&'a Geometry> {
        let after = self.geometries.partition_point(|geometry| geometry.first_triangle <= triangle);
        let geometry = self.geometries[after.checked_sub(1)?];
        (triangle - geometry.first_triangle < geometry.triangle_count).then_some(geometry)
    }
}

fn moves(geometry: &Geometry) -> bool {
    geometry.flags & geometry_flag::MOVING != 0
}
