//! embree-trace: what a renderer really asks of a ray tracer, and better trees from it.
//!
//! # Map, in the order in which data flows
//!
//! | layer | modules | job |
//! |---|---|---|
//! | shapes | [`geometry`], [`tree`] | boxes, rays, triangles; nodes as they stand in a file |
//! | scenes | [`mesh`] | triangles from OBJ, PLY and generators |
//! | Embree | `embree` (feature) | queries through the shim, and Embree's own trees |
//! | queries | [`render`], `record` (feature) | a renderer that asks, or somebody else's (`record::program`), and the writer of what was asked |
//! | planting | `plant` (feature) | trees of files back into Embree's scenes |
//! | other programs' scenes | `embree::host`, `record::host` (feature) | planted in and recorded by their handles: what `crates/c-library` gives C and C++ |
//! | formats | [`mod@format`], [`files`] | `.rays` and `.bvh`, each read and written in one place |
//! | looking | [`inspect`], [`diff`] | what is in a file, and how two differ |
//! | other formats | [`convert`] | recordings and trees to NumPy and other programs, and back |
//! | building | [`builder`], [`probability`], [`optimize`], [`training`], [`recipe`] | trees from triangles, and from rays how likely a box is hit |
//! | moving | [`update`] | the tree of a frame, for the next one |
//! | traversal | [`traverse`], [`replay`] | recorded queries over any tree: counts, and agreement with the recording |
//! | cost | [`cost`] | what counts take on a machine |
//! | results | [`compare`], [`report`], [`experiment`] | trees side by side; tables, JSON, heat maps; the paper's figures |
//! | a window's logic | [`explore`] | walking a tree; where its work goes; what a query does, step by step |
//! | on screen | `view` (feature) | the window `bvh-view`, and its screenshots |
//! | all of it | `tune` (feature) | a program recorded, its trees built and planted, and the time that it saves |
//! | around it | [`cli`], [`progress`], [`random`], [`ranks`] | what all commands and all algorithms share; several processes that do the work of one |
//!
//! # Invariants
//!
//! 1. `format` knows neither builders nor Embree.
//! 2. Builders and optimisers see boxes, and rays only through a probability; whole queries are seen by `optimize::order`, which chooses orders, and `recipe::auto`, which judges trees.
//! 3. Same input, same seed: same bytes out, whatever the number of threads.
//! 4. `traverse` is the only code that counts, and allocates nothing per query.
//! 5. No input file makes a tool panic, read out of bounds, loop or allocate without limit.

pub mod builder;
pub mod cli;
pub mod compare;
pub mod convert;
pub mod cost;
pub mod diff;
#[cfg(feature = "embree")]
pub mod embree;
pub mod experiment;
pub mod explore;
pub mod files;
pub mod format;
pub mod geometry;
pub mod inspect;
mod median;
pub mod mesh;
pub mod optimize;
#[cfg(feature = "embree")]
pub mod plant;
pub mod probability;
pub mod progress;
pub mod random;
pub mod ranks;
pub mod recipe;
#[cfg(feature = "embree")]
pub mod record;
pub mod render;
pub mod replay;
pub mod report;
pub mod training;
pub mod traverse;
pub mod tree;
#[cfg(feature = "embree")]
pub mod tune;
pub mod update;
#[cfg(feature = "viewer")]
pub mod view;
mod zeroed;
