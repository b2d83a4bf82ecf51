#![no_main]

use embree_trace_fuzz::rays_file;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| rays_file::check(bytes));
