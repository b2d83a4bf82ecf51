//! What must hold of every reader, whatever bytes it is given.
//!
//! A target is a function of bytes that panics where a promise is broken. Plain targets (`rays`, `bvh`, `bvh_2011`, `queries`, `mesh`) give the bytes to the reader;
//! structured ones (`rays_file`, `bvh_file`, `table`) take them as the description of a valid file and of changes to it, made behind its checksums.
//! The binaries in `targets/` hand them to libFuzzer; `tests/readers` in the root calls them for the corpus, and uses the descriptions
//! in property tests. Nothing here depends on libFuzzer.

pub mod bvh;
pub mod bvh_2011;
pub mod bvh_file;
pub mod edit;
pub mod mesh;
pub mod queries;
pub mod rays;
pub mod rays_file;
pub mod repair;
pub mod table;

use arbitrary::{Result, Unstructured};
use std::fmt::Display;

/// A fuzz target: the name of its binary and of its corpus, and what is run for an input.
pub struct Target {
    pub name: &'static str,
    pub check: fn(&[u8]),
}

/// Every target.
pub const TARGETS: [Target; 11] = [
    Target { name: "rays", check: rays::check },
    Target { name: "rays_structured", check: rays_file::check },
    Target { name: "bvh", check: bvh::check },
    Target { name: "bvh_structured", check: bvh_file::check },
    Target { name: "bvh_2011", check: bvh_2011::check },
    Target { name: "rays_2011", check: queries::check_rays_2011 },
    Target { name: "npy", check: queries::check_npy },
    Target { name: "parquet", check: queries::check_parquet },
    Target { name: "parquet_structured", check: table::check },
    Target { name: "obj", check: mesh::check_obj },
    Target { name: "ply", check: mesh::check_ply },
];

/// An error is one line: what a binary prints behind the path.
fn check_line(error: &impl Display) {
    let line = error.to_string();
    assert!(!line.is_empty() && !line.contains(['\n', '\r']), "not one line: {line:?}");
}

/// The bits of a number, with one pattern for every NaN: text and wider numbers keep neither its sign nor its payload.
fn bits(value: f32) -> u32 {
    if value.is_nan() { f32::NAN.to_bits() } else { value.to_bits() }
}

/// Up to 24 bytes of any text without a zero.
fn text(u: &mut Unstructured) -> Result<String> {
    let length = u.int_in_range(0..=8usize)?.min(u.len());
    // A byte that is not UTF-8 becomes a character of three.
    Ok(String::from_utf8_lossy(u.bytes(length)?).replace('\0', "0"))
}
