#![no_main]

mod threads;

use embree_trace_fuzz::queries;

libfuzzer_sys::fuzz_target!(init: threads::none(), |bytes: &[u8]| queries::check_npy(bytes));
