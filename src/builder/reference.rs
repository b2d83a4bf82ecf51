//! What builders sort and divide: one box with the triangle that it stands for.
//!
//! A reference carries its own box, not its triangle's, so that a split of space can cut it in two fragments.

use crate::geometry::padded::PaddedAabb;
use crate::geometry::{Aabb, Triangle};
use crate::probability::area::unit_for;
use crate::zeroed::zeroed_vec;
use bytemuck::{Pod, Zeroable};
use glam::Vec4;
use rayon::prelude::*;

/// A box and a triangle index in 32 bytes; the index is stored in the padding of the box.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C, align(32))]
pub struct Reference {
    lower_and_triangle: Vec4,
    upper: Vec4,
}

impl Reference {
    #[inline]
    pub fn new(bounds: Aabb, triangle: u32) -> Reference {
        Reference {
            lower_and_triangle: bounds.lower.extend(f32::from_bits(triangle)),
            upper: bounds.upper.extend(0.0),
        }
    }

    #[inline(always)]
    pub fn triangle(&self) -> u32 {
        self.lower_and_triangle.w.to_bits()
    }

    #[inline(always)]
    pub fn bounds(&self) -> PaddedAabb {
        // An index read as a number is subnormal: arithmetic on it would be correct, but slow.
        PaddedAabb { lower: self.lower_and_triangle.with_w(0.0), upper: self.upper }
    }

    /// Centre of the box times `unit`. Every algorithm orders references by this; it never overflows.
    #[inline(always)]
    pub fn centroid(&self, half_unit: f32) -> Vec4 {
        centroid(&self.bounds(), half_unit)
    }
}

/// See [`Reference::centroid`].
#[inline(always)]
pub fn centroid(bounds: &PaddedAabb, half_unit: f32) -> Vec4 {
    bounds.lower * half_unit + bounds.upper * half_unit
}

/// The references of a scene, and what bounds them.
pub struct References<'a> {
    /// All triangles of the scene: references number them, and splits of space cut them.
    pub triangles: &'a [Triangle],
    pub list: Vec<Reference>,
    /// Box around all of them.
    pub bounds: PaddedAabb,
    /// Half of the factor that scales centroids (see [`unit_for`]).
    pub half_unit: f32,
}

/// Triangles that a thread takes at a time.
const BLOCK: usize = 1 << 14;

impl<'a> References<'a> {
    /// One reference for each triangle with finite vertices, in order; the others are left out, as Embree does.
    pub fn of(triangles: &'a [Triangle]) -> References<'a> {
        let mut list: Vec<Reference> = zeroed_vec(triangles.len());
        let (bounds, finite) = list
            .par_chunks_mut(BLOCK)
            .zip(triangles.par_chunks(BLOCK))
            .enumerate()
            .map(|(block, (references, triangles))| {
                let mut bounds = PaddedAabb::EMPTY;
                let mut finite = 0;
                let first = block * BLOCK;
                for (offset, (reference, triangle)) in references.iter_mut().zip(triangles).enumerate() {
                    *reference = Reference::new(triangle.bounds(), (first + offset) as u32);
                    if triangle.is_finite() {
                        bounds = bounds.union(&reference.bounds());
                        finite += 1;
                    }
                }
                (bounds, finite)
            })
            .reduce(|| (PaddedAabb::EMPTY, 0), |a, b| (a.0.union(&b.0), a.1 + b.1));
        if finite < triangles.len() {
            list.retain(|reference| triangles[reference.triangle() as usize].is_finite());
        }
        References { triangles, list, bounds, half_unit: 0.5 * unit_for(&bounds) }
    }
}
