#![no_main]

use embree_trace_fuzz::bvh_2011;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| bvh_2011::check(bytes));
