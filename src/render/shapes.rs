//! The triangles that queries meet: from what an intersector names to where a ray met it.

use crate::geometry::{Ray, Triangle};
use crate::mesh::{Faces, Mesh};
use crate::render::meeting::Meeting;

/// What a closest-hit query found. Of Embree's answer only this is passed on: t, u, v and the
/// normal differ in their last bits from processor to processor, and must not decide what is asked
/// next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Met {
    /// Index into `TRIS`, as [`Mesh::triangles`] numbers them.
    pub triangle: u32,
    /// Index into [`Mesh::parts`].
    pub part: u32,
}

/// The triangles of a scene by their numbers, and which of them make quads.
#[derive(Clone, Debug)]
pub struct Shapes {
    triangles: Vec<Triangle>,
    /// One per part of the mesh.
    places: Vec<Place>,
}

/// A part among all triangles.
#[derive(Clone, Copy, Debug)]
struct Place {
    first_triangle: usize,
    quads: bool,
}

impl Shapes {
    /// `triangles` are the mesh's, in its order.
    pub fn new(mesh: &Mesh, triangles: Vec<Triangle>) -> Shapes {
        let mut first_triangle = 0;
        let place = |part: &crate::mesh::Part| {
            let place = Place { first_triangle, quads: part.faces == Faces::Quads };
            first_triangle += part.triangle_count();
            place
        };
        Shapes { places: mesh.parts.iter().map(place).collect(), triangles }
    }

    pub fn triangles(&self) -> &[Triangle] {
        &self.triangles
    }

    /// The same faces with other vertices.
    pub fn replace(&mut self, triangles: Vec<Triangle>) {
        self.triangles = triangles;
    }

    /// Where a ray met what was named: the triangle's number, and the point.
    ///
    /// Embree names a quad, and by u and v one of its two triangles; those are rounded, so near the
    /// diagonal the choice depends on the processor. It is made anew here.
    ///
    /// # Panics
    /// When there is no such triangle.
    pub fn meeting(&self, ray: &Ray, met: &Met) -> (u32, Meeting) {
        let of = |number: u32| (number, Meeting::of(ray, &self.triangles[number as usize]));
        match self.places.get(met.part as usize) {
            Some(place) if place.quads => {
                let first = met.triangle - (met.triangle - place.first_triangle as u32) % 2;
                let (one, other) = (of(first), of(first + 1));
                let is_other = if one.1.miss <= 0.0 && other.1.miss <= 0.0 {
                    // A folded quad can be met twice.
                    other.1.t < one.1.t && other.1.t >= f64::from(ray.tnear)
                } else {
                    other.1.miss < one.1.miss
                };
                if is_other { other } else { one }
            }
            _ => of(met.triangle),
        }
    }
}
