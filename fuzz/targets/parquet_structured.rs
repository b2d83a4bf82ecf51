#![no_main]

mod threads;

use embree_trace_fuzz::table;

libfuzzer_sys::fuzz_target!(init: threads::none(), |bytes: &[u8]| table::check(bytes));
