//! What `fuzz/` checks of every reader, without a fuzzer: for described files in property tests, for damaged meshes, and for the committed corpus.

mod corpus;
#[path = "../../fuzz/src/lib.rs"]
mod fuzz;
mod meshes;
mod properties;
