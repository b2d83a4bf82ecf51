//! `bvh-view` as a user sees it: pictures of every mode, keys and mouse, the command line, and a real window on a display in memory.

mod cli;
#[path = "../compare_support/mod.rs"]
mod compare_support;
mod events;
mod pictures;
mod room;
mod window;
