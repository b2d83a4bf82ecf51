#![no_main]

mod threads;

use embree_trace_fuzz::rays_file;

libfuzzer_sys::fuzz_target!(init: threads::none(), |bytes: &[u8]| rays_file::check(bytes));
