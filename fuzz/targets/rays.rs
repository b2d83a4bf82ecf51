#![no_main]

mod threads;

use embree_trace::format::RAYS_MAGIC;
use embree_trace_fuzz::{rays, rays_file, repair};
use libfuzzer_sys::{fuzz_mutator, fuzz_target, fuzzer_mutate};

fuzz_target!(init: threads::none(), |bytes: &[u8]| rays::check(bytes));

// What does not start as a file does is taken as the description of one; three in four inputs get checksums that hold.
fuzz_mutator!(|bytes: &mut [u8], size: usize, room: usize, seed: u32| {
    if !bytes[..size].starts_with(&RAYS_MAGIC)
        && let Some(file) = rays_file::described(&bytes[..size]).filter(|file| file.len() <= room)
    {
        bytes[..file.len()].copy_from_slice(&file);
        return file.len();
    }
    let size = fuzzer_mutate(bytes, size, room);
    if seed % 4 != 0 {
        repair::rays(&mut bytes[..size]);
    }
    size
});
