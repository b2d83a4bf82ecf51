#![no_main]

use embree_trace_fuzz::mesh;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| mesh::check_obj(bytes));
