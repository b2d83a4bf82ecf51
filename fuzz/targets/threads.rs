//! No threads beside the fuzzer's: handing tiny files to others takes more time than reading them.

/// Makes rayon run everything on the calling thread.
pub fn none() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread();
    if let Err(error) = pool.build_global() {
        panic!("{error}");
    }
}
