//! embree-trace: what a renderer really asks of a ray tracer, and better trees from it.
//!
//! # Map, in the order in which data flows
//!
//! | layer | modules | job |
//! |---|---|---|
//! | shapes | [`geometry`], [`tree`] | boxes, rays, triangles; nodes as they stand in a file |
//! | scenes | [`mesh`] | triangles from OBJ, PLY and generators |
//! | building | [`builder`], [`probability`] | trees from triangles, and how likely a box is hit |
//! | formats | [`format`] | `.rays` and `.bvh`, each read and written in one place |
//! | experiments | [`experiment`], [`report`] | the figures of the paper, as CSV and plots |
//! | Embree | `embree` (feature) | queries, recording, and Embree's own trees |
//!
//! # Invariants
//!
//! 1. `format` knows neither builders nor Embree.
//! 2. Builders and optimisers see boxes, and rays only through a probability.
//! 3. Same input, same seed: same bytes out, whatever the number of threads.
//! 4. No input file makes a tool panic, read out of bounds, loop or allocate without limit.

pub mod builder;
pub mod cli;
pub mod compare;
pub mod diff;
#[cfg(feature = "embree")]
pub mod embree;
pub mod experiment;
pub mod files;
pub mod format;
pub mod geometry;
pub mod inspect;
pub mod mesh;
pub mod optimize;
pub mod probability;
pub mod progress;
pub mod random;
pub mod recipe;
#[cfg(feature = "embree")]
pub mod record;
#[cfg(feature = "embree")]
pub mod render;
pub mod replay;
pub mod report;
pub mod training;
pub mod traverse;
pub mod tree;
