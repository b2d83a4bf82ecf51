//! Scenes as they come from files: vertices, parts and materials, before any ray tracer sees them.
//!
//! A reader (`obj`, `ply`) or a generator (`generate`) returns a [`Mesh`]; `embree` attaches each [`Part`] as one geometry,
//! in order, so a part's number is its Embree geomID; [`Mesh::triangles`] numbers the triangles as the files do.

pub mod frames;
pub mod generate;
mod lines;
pub mod mtl;
mod number;
pub mod obj;
pub mod ply;
mod polygon;
mod read;
mod warnings;

pub use read::{MeshError, Problem, read, read_with};
pub use warnings::{Kind, Warnings};

use crate::format::bvh::{Geometry, NO_INSTANCE, geometry_kind};
use crate::geometry::{Triangle, Vec3};

/// Corners of each face of a [`Part`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Faces {
    Triangles,
    /// Embree quads (v0, v1, v2, v3): triangles (v0, v1, v3) and (v2, v3, v1), in this order.
    Quads,
}

impl Faces {
    pub fn corners(self) -> usize {
        match self {
            Faces::Triangles => 3,
            Faces::Quads => 4,
        }
    }

    /// Triangles that one face counts for in `TRIS`.
    pub fn triangles(self) -> usize {
        self.corners() - 2
    }
}

/// Faces that share a name and a material: one Embree geometry.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    pub name: String,
    /// Index into [`Mesh::materials`].
    pub material: u32,
    pub faces: Faces,
    /// Vertex indices, [`Faces::corners`] a face; all are in range.
    pub indices: Vec<u32>,
}

/// How a surface looks, as far as it decides which rays follow.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    pub name: String,
    /// Radiance that it emits, RGB, linear; zero for almost all.
    pub emission: Vec3,
    /// Diffuse reflectance, RGB, linear, 0 to 1.
    pub diffuse: Vec3,
    /// Mirror reflectance, RGB, linear, 0 to 1.
    pub specular: Vec3,
}

impl Default for Material {
    /// A light grey, matt surface.
    fn default() -> Material {
        Material {
            name: String::new(),
            emission: Vec3::ZERO,
            diffuse: Vec3::splat(0.6),
            specular: Vec3::ZERO,
        }
    }
}

/// A scene. Vertices may be non-finite (files are like that); indices are always in range.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    pub vertices: Vec<Vec3>,
    pub parts: Vec<Part>,
    /// At least one when there is a part.
    pub materials: Vec<Material>,
}

impl Mesh {
    /// Every triangle in the order of `TRIS`: by part, then by face, a quad as two.
    pub fn triangles(&self) -> Vec<Triangle> {
        let mut triangles = Vec::with_capacity(self.triangle_count());
        for part in &self.parts {
            for face in part.indices.chunks_exact(part.faces.corners()) {
                let vertex = |corner: usize| self.vertices[face[corner] as usize];
                match part.faces {
                    Faces::Triangles => triangles.push(Triangle([vertex(0), vertex(1), vertex(2)])),
                    Faces::Quads => {
                        triangles.push(Triangle([vertex(0), vertex(1), vertex(3)]));
                        triangles.push(Triangle([vertex(2), vertex(3), vertex(1)]));
                    }
                }
            }
        }
        triangles
    }

    pub fn triangle_count(&self) -> usize {
        self.parts.iter().map(Part::triangle_count).sum()
    }

    /// The elements of `GEOM` for its parts: one geometry each, all seen by what `mask` says.
    pub fn geometries(&self, mask: u32) -> Vec<Geometry> {
        let mut first_triangle = 0;
        let geometry = |(number, part): (usize, &Part)| {
            let triangle_count = part.triangle_count() as u32;
            let geometry = Geometry {
                instance: NO_INSTANCE,
                geometry: number as u32,
                first_triangle,
                triangle_count,
                mask,
                kind: match part.faces {
                    Faces::Triangles => geometry_kind::TRIANGLES,
                    Faces::Quads => geometry_kind::QUADS,
                },
                flags: 0,
                instance_mask: 0,
            };
            first_triangle += triangle_count;
            geometry
        };
        self.parts.iter().enumerate().map(geometry).collect()
    }
}

impl Part {
    /// Triangles of its faces, two for a quad.
    pub fn triangle_count(&self) -> usize {
        self.indices.len() / self.faces.corners() * self.faces.triangles()
    }
}
