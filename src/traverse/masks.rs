//! What a triangle has from its geometry: a mask, and whether it moves.

use crate::format::bvh::{Geometry, geometry_flag};

/// Finds a triangle's mask.
#[derive(Clone, Debug)]
pub struct Masks<'a> {
    /// By first triangle.
    geometries: Vec<&'a Geometry>,
    any_moves: bool,
}

impl<'a> Masks<'a> {
    pub fn new(geometries: &'a [Geometry]) -> Masks<'a> {
        let mut geometries: Vec<&Geometry> = geometries.iter().filter(|g| g.triangle_count > 0).collect();
        geometries.sort_by_key(|geometry| geometry.first_triangle);
        let any_moves = geometries.iter().any(|geometry| moves(geometry));
        Masks { geometries, any_moves }
    }

    /// All bits for a triangle that no geometry names: every query sees it.
    pub fn of(&self, triangle: u32) -> u32 {
        self.geometry(triangle).map_or(u32::MAX, |geometry| geometry.mask)
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
