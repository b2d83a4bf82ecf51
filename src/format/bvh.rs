//! `.bvh`: a tree with its triangles.

use bytemuck::{Pod, Zeroable};

/// [`Geometry::instance`] of a geometry that is not instanced.
pub const NO_INSTANCE: u32 = u32::MAX;

/// Where one Embree geometry's triangles are: the element of `GEOM`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Geometry {
    /// Instance that placed it, or [`NO_INSTANCE`].
    pub instance: u32,
    /// Embree's geomID.
    pub geometry: u32,
    pub first_triangle: u32,
    pub triangle_count: u32,
    /// A query sees the geometry when its mask shares a bit with this one.
    pub mask: u32,
    /// 0 triangles, 1 quads (two triangles each).
    pub kind: u32,
    pub reserved: [u32; 2],
}
