//! The C ABI of `include/embree_trace/plant.h`: pointers become slices and paths, errors codes and
//! a line; the work is [`embree_trace::embree::host`]'s and [`embree_trace::record::host`]'s.
//!
//! Scenes in which something is planted, or that are recorded, stand in one table, whose lock every
//! call holds while it works on one. A scene leaves it, and is released, when there is nothing more
//! to be undone.

mod error;
mod scenes;

use error::{Failure, guarded};
use scenes::with_scene;
use std::ffi::{CStr, OsStr, c_char, c_int, c_void};
use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use embree_trace::embree::Planted;
use embree_trace::embree::host::label;
use embree_trace::format::bvh::Bvh;
use embree_trace::format::rays::Codec;
use embree_trace::record::host::{HostRecording, Recorded};

/// The header's structs and numbers, by bindgen.
#[allow(non_camel_case_types, non_snake_case, non_upper_case_globals, dead_code, clippy::all)]
mod header {
    include!(concat!(env!("OUT_DIR"), "/plant.rs"));
}
use header::{ET_API_VERSION, ET_RECORD_COMPRESSED, EtPlanted, EtRecorded};

/// An `RTCScene`, of which nothing is known.
type Handle = *const c_void;

/// `ET_API_VERSION`.
#[unsafe(no_mangle)]
pub extern "C" fn et_api_version() -> u32 {
    ET_API_VERSION
}

/// The library's version, a text.
#[unsafe(no_mangle)]
pub extern "C" fn et_version() -> *const c_char {
    const VERSION: &CStr =
        match CStr::from_bytes_with_nul(concat!(env!("CARGO_PKG_VERSION"), "\0").as_bytes()) {
            Ok(version) => version,
            Err(_) => c"",
        };
    VERSION.as_ptr()
}

/// What the calling thread's last call that failed said.
#[unsafe(no_mangle)]
pub extern "C" fn et_error_message() -> *const c_char {
    error::message()
}

/// Plants the tree of a file.
///
/// # Safety
/// As the header says of scenes and threads; `path` is null or a text, `planted` null or one to be
/// filled.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn et_plant(scene: Handle, path: *const c_char, planted: *mut EtPlanted) -> c_int {
    guarded(|| {
        // SAFETY: the caller's promise.
        let path = unsafe { path_of(path, "path") }?;
        let bytes = read(path)?;
        // SAFETY: as above.
        unsafe { plant(scene, &bytes, planted) }.map_err(|failure| failure.of(path))
    })
}

/// Plants a tree in memory.
///
/// # Safety
/// As for [`et_plant`]; `data` is null or `size` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn et_plant_memory(
    scene: Handle,
    data: *const c_void,
    size: usize,
    planted: *mut EtPlanted,
) -> c_int {
    guarded(|| {
        if data.is_null() || size > isize::MAX as usize {
            return Err(Failure::argument("there are no bytes to plant: data is null, or size is none"));
        }
        // SAFETY: the caller's promise, and no more than a slice may have.
        let bytes = unsafe { std::slice::from_raw_parts(data.cast::<u8>(), size) };
        // SAFETY: as above.
        unsafe { plant(scene, bytes, planted) }
    })
}

/// Gives Embree's own tree back.
///
/// # Safety
/// As the header says of scenes and threads.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn et_unplant(scene: Handle) -> c_int {
    guarded(|| {
        // SAFETY: the caller's promise.
        unsafe {
            with_scene(scene, |held| {
                if !held.planted {
                    return Err(Failure::state("nothing is planted in the scene"));
                }
                held.scene.restore()?;
                held.planted = false;
                Ok(())
            })
        }
    })
}

/// Begins a recording.
///
/// # Safety
/// As the header says of scenes and threads; both paths are null or texts.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn et_record_begin(
    scene: Handle,
    rays: *const c_char,
    bvh: *const c_char,
    flags: u32,
) -> c_int {
    guarded(|| {
        // SAFETY: the caller's promise.
        let (rays, bvh) = unsafe { (path_of(rays, "rays")?, path_of(bvh, "bvh")?) };
        if flags & !ET_RECORD_COMPRESSED != 0 {
            return Err(Failure::argument(format!("{flags:#x} has flags that are unknown")));
        }
        let codec = if flags & ET_RECORD_COMPRESSED == 0 { Codec::Raw } else { Codec::Compressed };
        // SAFETY: as above.
        unsafe {
            with_scene(scene, |held| {
                if held.recording.is_some() {
                    return Err(Failure::state("the scene is being recorded already"));
                }
                held.recording = Some(HostRecording::begin(&mut held.scene, rays, bvh, codec)?);
                Ok(())
            })
        }
    })
}

/// Ends a recording.
///
/// # Safety
/// As the header says of scenes and threads; `recorded` is null or one to be filled.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn et_record_end(scene: Handle, recorded: *mut EtRecorded) -> c_int {
    guarded(|| {
        // SAFETY: the caller's promise.
        let Recorded { totals, ended } = unsafe {
            with_scene(scene, |held| {
                let recording =
                    held.recording.take().ok_or_else(|| Failure::state("the scene is not being recorded"))?;
                Ok(recording.end(&mut held.scene)?)
            })
        }?;
        let numbers = EtRecorded {
            queries: totals.records,
            rejects: totals.rejects,
            bytes: totals.bytes,
            threads: ended.threads,
            unrecorded: ended.unrecorded,
            lost_rejects: ended.lost_rejects,
            interrupted: ended.interrupted,
        };
        // SAFETY: null, or one to be filled.
        unsafe { fill(recorded, numbers) };
        if ended.was_committed {
            return Err(Failure::state(format!(
                "the scene was committed with a change while it was recorded: the {} queries before are in the file",
                totals.records
            )));
        }
        Ok(())
    })
}

/// Labels what the calling thread asks from now on.
#[unsafe(no_mangle)]
pub extern "C" fn et_record_label(path: u32, depth: u8, purpose: u8) {
    label(path, depth, purpose);
}

/// # Safety
/// As for [`et_plant`].
unsafe fn plant(scene: Handle, bytes: &[u8], planted: *mut EtPlanted) -> Result<(), Failure> {
    let copy = aligned_copy(bytes);
    let bytes = copy.as_deref().map_or(bytes, |words| &bytemuck::cast_slice(words)[..bytes.len()]);
    let bvh = Bvh::parse(bytes).map_err(Failure::file)?;
    // SAFETY: the caller's promise.
    let Planted { trees, nodes, blocks, bytes, stack, width, .. } = unsafe {
        with_scene(scene, |held| {
            let found = held.scene.plant(&bvh).map_err(Failure::not_planted)?;
            held.planted = true;
            Ok(found)
        })
    }?;
    let numbers = EtPlanted {
        trees: trees as u32,
        width: width as u32,
        stack: stack as u32,
        unused: 0,
        nodes: nodes as u64,
        blocks: blocks as u64,
        bytes: bytes as u64,
    };
    // SAFETY: null, or one to be filled.
    unsafe { fill(planted, numbers) };
    Ok(())
}

/// A copy at an address at which a file's arrays can be viewed, where these bytes have none.
fn aligned_copy(bytes: &[u8]) -> Option<Vec<u64>> {
    if bytes.as_ptr().addr().is_multiple_of(align_of::<u64>()) {
        return None;
    }
    let mut words = vec![0u64; bytes.len().div_ceil(size_of::<u64>())];
    bytemuck::cast_slice_mut::<u64, u8>(&mut words)[..bytes.len()].copy_from_slice(bytes);
    Some(words)
}

/// The whole file, not mapped: one that shrinks meanwhile must not end the program.
fn read(path: &Path) -> Result<Vec<u8>, Failure> {
    let said = |error: &dyn std::fmt::Display| Failure::file(format!("cannot be read: {error}")).of(path);
    match fs::metadata(path) {
        Ok(metadata) if !metadata.is_file() => Err(said(&"it is not a regular file")),
        Ok(_) => fs::read(path).map_err(|error| said(&error)),
        Err(error) => Err(said(&error)),
    }
}

/// # Safety
/// `text` is null or a text, which lives as long as the path.
unsafe fn path_of<'a>(text: *const c_char, name: &str) -> Result<&'a Path, Failure> {
    if text.is_null() {
        return Err(Failure::argument(format!("{name} is null")));
    }
    // SAFETY: the caller's promise.
    let text = unsafe { CStr::from_ptr(text) };
    Ok(Path::new(OsStr::from_bytes(text.to_bytes())))
}

/// # Safety
/// `place` is null, or may be written.
unsafe fn fill<T>(place: *mut T, value: T) {
    if !place.is_null() {
        // SAFETY: the caller's promise.
        unsafe { place.write(value) };
    }
}
