//! The elements of a chunk, as they stand in the file: records (queries with their results) and rejects.

use crate::geometry::{Ray, Vec3};
use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// No triangle: a miss, or a hit of something that is not a triangle.
pub const NO_TRIANGLE: u32 = u32::MAX;
/// The pixel is not known.
pub const NO_PATH: u32 = u32::MAX;
/// The depth is not known.
pub const NO_DEPTH: u8 = 0xFF;

/// What a query asks ([`Record::kind`]).
pub mod kind {
    pub const CLOSEST_HIT: u8 = 0;
    pub const OCCLUSION: u8 = 1;
}

/// Bits of [`Record::flags`].
pub mod flag {
    pub const HIT: u8 = 1;
    pub const COHERENT: u8 = 2;
    pub const HAS_REJECTS: u8 = 4;
    /// The triangles cannot decide this hit: it is of something that is none, or that moves; or it is an occlusion, in a scene
    /// with such things.
    pub const UNDECIDED: u8 = 8;
    /// The program's own functions, a filter or those of a user geometry, changed where the ray
    /// ends: the hit is one, but there may be closer ones, and where there is none there may be
    /// some.
    pub const INTERRUPTED: u8 = 16;
}

/// Why a renderer asked ([`Record::purpose`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum Purpose {
    Unknown = 0,
    Camera = 1,
    Shadow = 2,
    AmbientOcclusion = 3,
    Diffuse = 4,
    Specular = 5,
}

impl Purpose {
    pub const ALL: [Purpose; 6] = [
        Purpose::Unknown,
        Purpose::Camera,
        Purpose::Shadow,
        Purpose::AmbientOcclusion,
        Purpose::Diffuse,
        Purpose::Specular,
    ];

    /// The purpose of a record's byte; a number that this version does not know is `Unknown`.
    pub fn from_byte(byte: u8) -> Purpose {
        *Purpose::ALL.get(byte as usize).unwrap_or(&Purpose::Unknown)
    }

    /// The name used in options, tables and JSON.
    pub fn name(self) -> &'static str {
        match self {
            Purpose::Unknown => "unknown",
            Purpose::Camera => "camera",
            Purpose::Shadow => "shadow",
            Purpose::AmbientOcclusion => "ao",
            Purpose::Diffuse => "diffuse",
            Purpose::Specular => "specular",
        }
    }
}

/// One query and its result, as it stands in the file: 64 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Record {
    pub origin: Vec3,
    pub tnear: f32,
    /// As given, not normalised.
    pub direction: Vec3,
    /// As asked.
    pub tfar: f32,
    pub time: f32,
    pub mask: u32,
    /// Closest hit: distance of the hit, +inf on a miss. Occlusion: -inf if occluded, +inf if not.
    pub t: f32,
    /// Index into `TRIS`, or [`NO_TRIANGLE`].
    pub triangle: u32,
    pub u: f32,
    pub v: f32,
    /// y * width + x of the pixel, or [`NO_PATH`].
    pub path: u32,
    pub kind: u8,
    pub depth: u8,
    pub flags: u8,
    pub purpose: u8,
}

impl Record {
    /// The ray as it was asked, [tnear, tfar].
    #[inline]
    pub fn ray(&self) -> Ray {
        Ray { origin: self.origin, tnear: self.tnear, direction: self.direction, tfar: self.tfar }
    }

    /// The ray as it is asked again among triangles: where something that is none ended it, it ends
    /// there, for no triangle is hit before.
    #[inline]
    pub fn ray_among_triangles(&self) -> Ray {
        let ends = self.flags & flag::UNDECIDED != 0 && self.is_hit() && !self.is_occlusion();
        Ray { tfar: if ends { self.tfar.min(self.t) } else { self.tfar }, ..self.ray() }
    }

    /// The ray over its *effective segment*: up to the recorded hit for a closest-hit query, as asked for an occlusion.
    #[inline]
    pub fn effective_segment(&self) -> Ray {
        let tfar = if self.is_occlusion() { self.tfar } else { self.tfar.min(self.t) };
        Ray { tfar, ..self.ray() }
    }

    #[inline]
    pub fn is_occlusion(&self) -> bool {
        self.kind == kind::OCCLUSION
    }

    /// Whether anything was hit (for an occlusion: whether it was occluded).
    #[inline]
    pub fn is_hit(&self) -> bool {
        self.flags & flag::HIT != 0
    }
}

/// A candidate hit that the program's intersection filter refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Reject {
    /// Index of the record within its chunk.
    pub record: u32,
    /// Index into `TRIS`.
    pub triangle: u32,
}
