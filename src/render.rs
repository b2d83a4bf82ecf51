//! Where our own queries come from: cameras and integrators that ask a scene what its rays hit.
//!
//! A `Job` says what to compute; `scenery::Scenery` is what it looks at (camera, lights, materials); `tiles` cuts the
//! image into units of work; an integrator (`path`, `ao`, `primary`, `shadow`) turns each sample of a pixel into
//! queries and a radiance; `workers` runs the units on threads and puts the radiance on the `film::Film`. Every random number comes from [`sampler::Sampler`],
//! so nothing depends on threads. `pair` writes the files of a recording, `frames` those of a sequence of frames. Integrators know Embree only as `RayQueries`.
//! Views ([`camera`]) and how they are chosen ([`framing`]) do not need it.
//!
//! Each query says which pixel it serves (y * width + x), why it is asked, and its depth: the number of surfaces that the path has met before, so
//! 0 for camera rays, and 1 for all that leaves the first surface: its shadow or ambient occlusion rays and its bounce.

#[cfg(feature = "embree")]
pub mod ao;
pub mod camera;
#[cfg(all(test, feature = "embree"))]
mod everywhere;
#[cfg(feature = "embree")]
pub mod film;
#[cfg(feature = "embree")]
pub mod frames;
pub mod framing;
#[cfg(feature = "embree")]
pub mod job;
#[cfg(feature = "embree")]
pub mod lights;
pub mod meeting;
#[cfg(feature = "embree")]
pub mod pair;
#[cfg(feature = "embree")]
pub mod path;
#[cfg(feature = "embree")]
pub mod primary;
#[cfg(feature = "embree")]
pub mod queries;
pub mod sampler;
#[cfg(feature = "embree")]
pub mod scenery;
#[cfg(feature = "embree")]
pub mod shadow;
pub mod shapes;
#[cfg(feature = "embree")]
pub mod summary;
#[cfg(feature = "embree")]
pub mod surface;
#[cfg(all(test, feature = "embree"))]
mod testing;
#[cfg(feature = "embree")]
pub mod tiles;
#[cfg(feature = "embree")]
pub mod workers;

#[cfg(feature = "embree")]
pub use job::{Integrator, Job, JobError, Limits};
#[cfg(feature = "embree")]
pub use queries::RayQueries;
