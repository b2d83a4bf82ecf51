//! Rust declarations of the header's structs and numbers, and the shared library's name and ways.

use std::path::PathBuf;

const HEADER: &str = "../../include/embree_trace/plant.h";

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed={HEADER}");
    // Programs that were linked with it find a later one of the same number.
    println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libembree_trace.so.0");
    // Threads of the program have something of it to free when they end, and geometries may have
    // filters of it.
    println!("cargo::rustc-cdylib-link-arg=-Wl,-z,nodelete");
    if let Err(problem) = bind() {
        println!("cargo::error={problem}");
        std::process::exit(1);
    }
}

fn bind() -> Result<(), String> {
    let out = PathBuf::from(std::env::var_os("OUT_DIR").ok_or("OUT_DIR is not set")?);
    bindgen::Builder::default()
        .header(HEADER)
        .derive_default(true)
        .allowlist_type("Et.*")
        .allowlist_var("ET_.*")
        .prepend_enum_name(false)
        .rust_edition(bindgen::RustEdition::Edition2024)
        .formatter(bindgen::Formatter::None)
        .generate()
        .map_err(|error| format!("cannot bind {HEADER}: {error}"))?
        .write_to_file(out.join("plant.rs"))
        .map_err(|error| format!("cannot write the bindings in {}: {error}", out.display()))
}
