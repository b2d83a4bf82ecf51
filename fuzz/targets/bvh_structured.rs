#![no_main]

use embree_trace_fuzz::bvh_file;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| bvh_file::check(bytes));
