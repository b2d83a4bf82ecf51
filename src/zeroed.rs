//! Vectors of zeros, in memory that the system hands out zeroed.

use bytemuck::Zeroable;
use std::alloc::{Layout, handle_alloc_error};

/// `length` zeros. Without memory for them the process ends as it does at any other allocation, where `bytemuck::zeroed_vec` panics.
pub(crate) fn zeroed_vec<T: Zeroable>(length: usize) -> Vec<T> {
    bytemuck::allocation::try_zeroed_vec(length)
        .unwrap_or_else(|()| handle_alloc_error(Layout::array::<T>(length).unwrap_or(Layout::new::<T>())))
}
