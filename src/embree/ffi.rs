//! The declarations that bindgen makes of `embree-shim/shim.h`, and the proof that its structs are the crate's own.
#![allow(non_camel_case_types, non_snake_case, non_upper_case_globals, dead_code, clippy::all)]

use super::intersector::{Hit, Query};
use crate::format::bvh::Geometry;
use crate::format::bvh::flag;
use crate::format::rays::{Record, Reject};
use crate::geometry::Triangle;
use crate::tree::Node;
use std::mem::{align_of, offset_of, size_of};

include!(concat!(env!("OUT_DIR"), "/shim.rs"));

/// RTC_ERROR_UNSUPPORTED_CPU.
pub const UNSUPPORTED_CPU: i32 = 5;

/// An error to be filled in.
pub fn no_error() -> ShimError {
    ShimError { code: 0, message: [0; 508] }
}

/// A zero-terminated text of the shim's.
pub fn text(letters: &[std::ffi::c_char]) -> String {
    let bytes: Vec<u8> = letters.iter().map(|&letter| letter as u8).take_while(|&byte| byte != 0).collect();
    String::from_utf8_lossy(&bytes).into_owned()
}

/// What the shim lends.
///
/// # Safety
/// `count` elements are live from `data`, which may be null when there are none.
pub unsafe fn slice<'a, T>(data: *const T, count: u64) -> &'a [T] {
    if count == 0 {
        &[]
    } else {
        // SAFETY: the caller's promise.
        unsafe { std::slice::from_raw_parts(data, count as usize) }
    }
}

/// Same size, alignment and offsets: a pointer to one struct may be used as a pointer to the other.
macro_rules! assert_same_layout {
    ($ours:ty, $theirs:ty, $(($our_field:ident $(. $nested:ident)?, $their_field:ident)),+) => {
        const _: () = {
            assert!(size_of::<$ours>() == size_of::<$theirs>());
            assert!(align_of::<$ours>() == align_of::<$theirs>());
            $(assert!(offset_of!($ours, $our_field $(. $nested)?) == offset_of!($theirs, $their_field));)+
        };
    };
}

assert_same_layout!(
    Record,
    ShimRecord,
    (origin, origin),
    (tnear, tnear),
    (direction, direction),
    (tfar, tfar),
    (time, time),
    (mask, mask),
    (t, t),
    (triangle, triangle),
    (u, u),
    (v, v),
    (path, path),
    (kind, kind),
    (depth, depth),
    (flags, flags),
    (purpose, purpose)
);
assert_same_layout!(Reject, ShimReject, (record, record), (triangle, triangle));
assert_same_layout!(
    Query,
    ShimQuery,
    (ray.origin, origin),
    (ray.tnear, tnear),
    (ray.direction, direction),
    (ray.tfar, tfar),
    (time, time),
    (mask, mask),
    (path, path),
    (depth, depth),
    (purpose, purpose),
    (coherent, coherent)
);
assert_same_layout!(
    Hit,
    ShimHit,
    (t, t),
    (triangle, triangle),
    (part, part),
    (u, u),
    (v, v),
    (normal, normal)
);
assert_same_layout!(Node, ShimNode, (lower, lower), (first, first), (upper, upper), (count, count));
assert_same_layout!(
    Geometry,
    ShimGeometry,
    (instance, instance),
    (geometry, geometry),
    (first_triangle, first_triangle),
    (triangle_count, triangle_count),
    (mask, mask),
    (kind, kind),
    (flags, flags),
    (instance_mask, instance_mask)
);
const _: () = assert!(flag::SPATIAL_SPLITS == SHIM_FILE_SPLITS && flag::FLATTENED == SHIM_FILE_FLATTENED);
const _: () = assert!(size_of::<Triangle>() == 9 * size_of::<f32>());
