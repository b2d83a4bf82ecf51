//! Memory for a prepared tree. Queries jump about in it, so each address costs a walk through the page tables unless pages are large.

/// An empty vector with room for `capacity` elements, in large pages where the system has them for those who ask, as Linux mostly does.
pub(super) fn with_capacity<T>(capacity: usize) -> Vec<T> {
    let list = Vec::with_capacity(capacity);
    #[cfg(target_os = "linux")]
    ask_for_large_pages(&list);
    list
}

#[cfg(target_os = "linux")]
fn ask_for_large_pages<T>(list: &Vec<T>) {
    use rustix::mm::{Advice, madvise};
    let page = rustix::param::page_size();
    let start = list.as_ptr().cast::<u8>();
    let before = start.align_offset(page);
    let inside = (list.capacity() * size_of::<T>()).saturating_sub(before) / page * page;
    if inside > 0 {
        // SAFETY: whole pages inside of the vector's memory. The advice changes neither what is in them nor what may be done with them.
        // It may fail, and then all stays as it is.
        let _ =
            unsafe { madvise(start.wrapping_add(before).cast_mut().cast(), inside, Advice::LinuxHugepage) };
    }
}
