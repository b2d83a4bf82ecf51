//! The triangles of hits whose distance is known and whose triangle is not: found by asking again, over a tree of the scene.
//!
//! For recordings of 2011. A hit is looked for within [`T_TOLERANCE`] of the recorded t only, so that what the ray started from is not taken
//! for it; what a whole query would meet before that is counted, because a replay will meet it, too.

use super::ConvertError;
use crate::format::bvh::Bvh;
use crate::format::rays::{Chunk, NO_TRIANGLE, Record, flag};
use crate::geometry::{DVec3, Ray, Triangle, Vec3};
use crate::replay::check::T_TOLERANCE;
use crate::replay::scene::Scenes;
use crate::traverse::{Prepared, PreparedRay, Recorded, Scratch, Traversal};
use rayon::prelude::*;
use serde::Serialize;
use std::iter::Sum;
use std::ops::Add;

/// What was found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Found {
    /// Hits that have a triangle now.
    pub found: u64,
    /// Hits without one: no triangle is where the recording says. They keep the flag that says that no triangle decides them.
    pub not_found: u64,
    /// Of those found, hits before which the ray meets another triangle: most start on one, and the recording program kept a distance.
    pub met_before: u64,
}

impl Add for Found {
    type Output = Found;

    fn add(self, other: Found) -> Found {
        Found {
            found: self.found + other.found,
            not_found: self.not_found + other.not_found,
            met_before: self.met_before + other.met_before,
        }
    }
}

impl Sum for Found {
    fn sum<I: Iterator<Item = Found>>(all: I) -> Found {
        all.fold(Found::default(), Add::add)
    }
}

/// Finds triangles over one tree.
pub struct Replayer<'a> {
    bvh: &'a Bvh<'a>,
    /// Number of its scene among those of the queries.
    scene: u16,
    prepared: Prepared,
}

impl<'a> Replayer<'a> {
    /// `scenes` are those of the queries, `asked` the one that somebody asked for.
    ///
    /// # Errors
    /// When the tree is of none of them, or of another one, or does not say of which.
    pub fn new(bvh: &'a Bvh<'a>, scenes: &Scenes, asked: Option<u16>) -> Result<Replayer<'a>, ConvertError> {
        let scene = scenes.of_trees(&[bvh], asked)?;
        Ok(Replayer { bvh, scene, prepared: Prepared::new(bvh.tree, bvh.triangles, bvh.geometries) })
    }

    /// Completes the hits of a chunk of its scene that have no triangle, on rayon's threads.
    pub fn complete(&self, chunk: &mut Chunk) -> Found {
        if chunk.info.scene != self.scene {
            return Found::default();
        }
        let records = chunk.records.to_mut();
        let pieces = records.par_chunks_mut(1024);
        pieces
            .map(|piece| {
                let mut scratch = Scratch::default();
                piece.iter_mut().map(|record| self.record(record, &mut scratch)).sum()
            })
            .sum()
    }

    fn record(&self, record: &mut Record, scratch: &mut Scratch) -> Found {
        if record.is_occlusion() || !record.is_hit() || record.triangle != NO_TRIANGLE {
            return Found::default();
        }
        let margin = (f64::from(record.t).abs() * T_TOLERANCE) as f32;
        let candidates = Recorded { mask: record.mask, rejects: &[] };
        let mut ask = |tnear: f32, tfar: f32| {
            let ray = Ray { tnear, tfar, ..record.ray() };
            let ray = PreparedRay::new(&ray);
            self.prepared.closest_hit(Traversal::Odf, &ray, &candidates, &mut (), scratch)
        };
        let near = record.t - margin;
        let Some(hit) = ask(near, record.t + margin) else {
            return Found { not_found: 1, ..Found::default() };
        };
        let before = ask(record.tnear, near).is_some();
        (record.u, record.v) = barycentrics(&self.bvh.triangles[hit.triangle as usize], &record.ray());
        (record.t, record.triangle) = (hit.t, hit.triangle);
        record.flags &= !flag::UNDECIDED;
        Found { found: 1, not_found: 0, met_before: before.into() }
    }
}

/// u and v of the point where the ray's line meets the triangle's plane, in double precision; 0 where it meets none.
fn barycentrics(triangle: &Triangle, ray: &Ray) -> (f32, f32) {
    let double = |v: Vec3| -> DVec3 { v.as_dvec3() };
    let [v0, v1, v2] = triangle.0.map(double);
    let (e1, e2) = (v1 - v0, v2 - v0);
    let direction = double(ray.direction);
    let p = direction.cross(e2);
    let determinant = p.dot(e1);
    if determinant == 0.0 {
        return (0.0, 0.0);
    }
    let s = double(ray.origin) - v0;
    let u = s.dot(p) / determinant;
    let v = direction.dot(s.cross(e1)) / determinant;
    (u as f32, v as f32)
}
