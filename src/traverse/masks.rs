//! Which mask a triangle has: that of its geometry.

use crate::format::bvh::Geometry;

/// Finds a triangle's mask.
#[derive(Clone, Debug)]
pub struct Masks<'a> {
    /// By first triangle.
    geometries: Vec<&'a Geometry>,
}

impl<'a> Masks<'a> {
    pub fn new(geometries: &'a [Geometry]) -> Masks<'a> {
        let mut geometries: Vec<&Geometry> = geometries.iter().filter(|g| g.triangle_count > 0).collect();
        geometries.sort_by_key(|geometry| geometry.first_triangle);
        Masks { geometries }
    }

    /// All bits for a triangle that no geometry names: every query sees it.
    pub fn of(&self, triangle: u32) -> u32 {
        let after = self.geometries.partition_point(|geometry| geometry.first_triangle <= triangle);
        match after.checked_sub(1).map(|index| self.geometries[index]) {
            Some(geometry) if triangle - geometry.first_triangle < geometry.triangle_count => geometry.mask,
            _ => u32::MAX,
        }
    }
}
