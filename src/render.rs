//! Where our own queries come from: cameras and integrators that ask a scene what its rays hit.
//!
//! A [`Job`] says what to compute; [`scenery::Scenery`] is what it looks at (camera, lights, materials); [`tiles`] cuts the
//! image into units of work; an integrator ([`path`], [`ao`], [`primary`], [`shadow`]) turns each sample of a pixel into
//! queries and a radiance; [`workers`] runs the units on threads and puts the radiance on the [`film::Film`]. Every random number comes from [`sampler::Sampler`],
//! so nothing depends on threads. Integrators know Embree only as [`RayQueries`].
//!
//! Each query says which pixel it serves (y * width + x), why it is asked, and its depth: the number of surfaces that the path has met before, so
//! 0 for camera rays, and 1 for all that leaves the first surface: its shadow or ambient occlusion rays and its bounce.

pub mod ao;
pub mod camera;
pub mod film;
pub mod framing;
pub mod job;
pub mod lights;
pub mod path;
pub mod primary;
pub mod queries;
pub mod sampler;
pub mod scenery;
pub mod shadow;
pub mod summary;
pub mod surface;
#[cfg(test)]
mod testing;
pub mod tiles;
pub mod workers;

pub use job::{Integrator, Job, JobError, Limits};
pub use queries::RayQueries;
