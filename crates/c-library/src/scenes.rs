//! The scenes that something was done to, by handle.

use crate::Handle;
use crate::error::Failure;
use embree_trace::embree::host::HostScene;
use embree_trace::record::host::HostRecording;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Mutex, PoisonError};

/// A scene, and what is to be undone.
pub struct Held {
    pub scene: HostScene,
    pub planted: bool,
    pub recording: Option<HostRecording>,
}

/// As long as a scene is here it is retained, so a handle cannot become another scene's.
static SCENES: Mutex<BTreeMap<usize, Held>> = Mutex::new(BTreeMap::new());

/// Works on a scene, which is released afterwards when there is nothing to be undone.
///
/// # Errors
/// What `work` says, or when the handle leads to no scene.
///
/// # Safety
/// As [`HostScene::new`] says.
pub unsafe fn with_scene<T>(
    handle: Handle,
    work: impl FnOnce(&mut Held) -> Result<T, Failure>,
) -> Result<T, Failure> {
    let mut scenes = SCENES.lock().unwrap_or_else(PoisonError::into_inner);
    let mut held = match scenes.remove(&handle.addr()) {
        Some(held) => held,
        None => {
            // SAFETY: the caller's promise.
            let scene = unsafe { HostScene::new(handle) }.map_err(Failure::argument)?;
            Held { scene, planted: false, recording: None }
        }
    };
    let outcome = catch_unwind(AssertUnwindSafe(|| work(&mut held)));
    if held.planted || held.recording.is_some() {
        scenes.insert(handle.addr(), held);
    }
    outcome.unwrap_or_else(|panic| resume_unwind(panic))
}
