//! `.bvh`: a tree with its triangles, enough to replay a `.rays` without the scene file.
//!
//! Writing: [`Contents`] → `structure` (the checks that a reader makes) → [`write()`]. Reading: [`Bvh::parse`] checks the
//! section table, every checksum and, with the same `structure`, every index, and views the arrays in place; after it,
//! code may follow anything. [`Bvh::verify`] checks what costs more: that boxes hold what is below them.

mod layout;
mod read;
mod structure;
mod verify;
mod write;

pub use layout::{Header, Section};
pub use read::Bvh;
pub use verify::Verified;
pub use write::{Contents, fingerprint, write};

use bytemuck::{Pod, Zeroable};

/// [`Geometry::instance`] of a geometry that is not instanced.
pub const NO_INSTANCE: u32 = u32::MAX;

/// Bits of [`Header::flags`].
pub mod flag {
    /// A triangle may stand in several leaves, and boxes are clipped to what the leaf stands for.
    pub const SPATIAL_SPLITS: u32 = 1;
    /// Instances were flattened: their triangles are in world space.
    pub const FLATTENED: u32 = 2;
    /// Read from Embree's memory.
    pub const LIVE: u32 = 4;
    /// Built by `rtcBuildBVH`.
    pub const BUILDER: u32 = 8;
}

/// Values of [`Geometry::kind`].
pub mod geometry_kind {
    pub const TRIANGLES: u32 = 0;
    /// Two triangles each.
    pub const QUADS: u32 = 1;
}

/// Bits of [`Geometry::flags`].
pub mod geometry_flag {
    /// It has several time steps, or its instance has: its triangles are those of the first one.
    pub const MOVING: u32 = 1;
}

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
    /// Bits of [`geometry_flag`].
    pub flags: u32,
    pub reserved: u32,
}
