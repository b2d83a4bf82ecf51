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
    /// [`Geometry::instance_mask`](super::Geometry::instance_mask) counts, too.
    pub const INSTANCE_MASK: u32 = 2;
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
    /// A query sees the geometry when its mask shares a bit with this one, and with
    /// [`Self::instance_mask`] where that counts.
    pub mask: u32,
    /// 0 triangles, 1 quads (two triangles each).
    pub kind: u32,
    /// Bits of [`geometry_flag`].
    pub flags: u32,
    /// With [`geometry_flag::INSTANCE_MASK`]: the mask of its instance, where no one mask can say
    /// both. 0 without.
    pub instance_mask: u32,
}

impl Geometry {
    /// The masks with each of which a query must share a bit: all bits where there is no second
    /// one.
    pub fn masks(&self) -> [u32; 2] {
        let two = self.flags & geometry_flag::INSTANCE_MASK != 0;
        [self.mask, if two { self.instance_mask } else { u32::MAX }]
    }
}
