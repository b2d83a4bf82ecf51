//! Scenes of the program that this library is linked with: all that is known of one is its
//! `RTCScene`.
//!
//! The shim looks at a handle before it uses it, and asks Embree or reads its memory for the rest
//! (`embree-shim/host_scene.hpp`, `host_faces.hpp`); a tree is planted in such a scene, and what
//! the program asks it is handed over in batches (`host_recording.hpp`). The scene is retained, so
//! that it lives as long as the [`HostScene`].

use super::plant::{Arrays, Planted};
use super::{BuiltTree, ffi};
use crate::format::bvh::{Geometry, flag};
use crate::format::rays::{Record, Reject};
use crate::geometry::Triangle;
use crate::tree::{Node, Tree};
use std::any::Any;
use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr::NonNull;
use std::sync::Mutex;
use thiserror::Error;

/// Why something was not done to a scene.
#[derive(Debug, Error, PartialEq)]
pub enum HostError {
    /// A check did not hold: one line says which. Nothing has changed.
    #[error("{0}")]
    Refused(String),
    /// Whatever else went wrong in the shim.
    #[error("Embree (error {code}): {message}")]
    Other { code: i32, message: String },
}

impl HostError {
    fn new(error: &ffi::ShimError) -> HostError {
        let message = ffi::text(&error.message);
        if error.code == ffi::SHIM_DOUBT as i32 {
            HostError::Refused(message)
        } else {
            HostError::Other { code: error.code, message }
        }
    }
}

/// A committed scene of the program.
#[derive(Debug)]
pub struct HostScene {
    handle: NonNull<ffi::ShimHost>,
    /// While it is recorded. The shim's callback refers to it.
    sink: Option<Box<Recording>>,
}

// SAFETY: the C++ object has no ties to a thread.
unsafe impl Send for HostScene {}

/// Takes what threads of the program ask.
pub trait HostSink: Send + Sync {
    /// Takes what a thread has asked; several call at the same time, each with its own number.
    /// `false` stops the recording.
    fn batch(&self, thread: u32, records: &[Record], rejects: &[Reject]) -> bool;
}

/// A sink as the shim's callback sees it.
struct Recording {
    sink: Box<dyn HostSink>,
    /// The first panic of the sink.
    panic: Mutex<Option<Box<dyn Any + Send>>>,
}

impl std::fmt::Debug for Recording {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("Recording")
    }
}

/// What became of a recording, beside what its sink was given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ended {
    /// Threads that asked, those that came after others had ended not counted.
    pub threads: u64,
    /// Queries for which there was no memory, or of streams whose packets are not understood.
    pub unrecorded: u64,
    /// Rejects that could not be assigned to a query, or were too many.
    pub lost_rejects: u64,
    /// Closest-hit queries whose interval the program's own functions have changed.
    pub interrupted: u64,
    /// Whether the scene was committed with a change meanwhile: what was asked afterwards is
    /// missing.
    pub was_committed: bool,
}

/// What a scene holds, and where hits are in it.
#[derive(Debug)]
pub struct Capture {
    handle: NonNull<ffi::ShimHostCapture>,
}

impl Capture {
    /// As a `.bvh` has it.
    pub fn built(&self) -> BuiltTree {
        // SAFETY: the handle is live; its arrays have the lengths that stand beside them (a pointer
        // to no element may be null, hence `slice`), and their elements the layouts of ours
        // (checked in `ffi`).
        let (view, nodes, primitives, triangles, geometries) = unsafe {
            let view = self.handle.as_ref();
            (
                view,
                ffi::slice(view.tree.nodes.cast::<Node>(), view.tree.node_count),
                ffi::slice(view.tree.primitives, view.tree.primitive_count),
                ffi::slice(view.triangles.cast::<Triangle>(), view.triangle_count),
                ffi::slice(view.geometries.cast::<Geometry>(), view.geometry_count),
            )
        };
        let producer = ffi::text(&view.tree.producer);
        BuiltTree {
            tree: Tree { nodes: nodes.to_vec(), primitives: primitives.to_vec() },
            triangles: triangles.to_vec(),
            geometries: geometries.to_vec(),
            order: None,
            producer: if view.planted == 0 { producer } else { format!("planted in {producer}") },
            flags: flag::LIVE | if view.tree.splits == 0 { 0 } else { flag::SPATIAL_SPLITS },
            warning: None,
        }
    }

    /// Embree's, such as 31305.
    pub fn version(&self) -> u32 {
        // SAFETY: the handle is live.
        unsafe { self.handle.as_ref() }.version
    }
}

impl Drop for Capture {
    fn drop(&mut self) {
        // SAFETY: made by `shim_host_capture`, freed once.
        unsafe { ffi::shim_host_capture_free(self.handle.as_ptr()) }
    }
}

impl HostScene {
    /// Takes a scene of the program's, if it is one.
    ///
    /// # Errors
    /// When the handle is null, or leads to no scene of the libembree3 in this process.
    ///
    /// # Safety
    /// When it is a scene, it has not been released by its last owner, and nobody does that during
    /// the call.
    pub unsafe fn new(scene: *const c_void) -> Result<HostScene, HostError> {
        let mut error = ffi::no_error();
        // SAFETY: the shim believes nothing of the pointer; what it cannot know, the caller
        // promises.
        let handle = unsafe { ffi::shim_host_new(scene, &mut error) };
        let handle = NonNull::new(handle).ok_or_else(|| HostError::new(&error))?;
        Ok(HostScene { handle, sink: None })
    }

    /// Plants a tree in place of Embree's own, or of the one that was planted before.
    ///
    /// # Errors
    /// As [`super::Scene::plant`], and when the scene is not committed. Then it keeps what it has.
    ///
    /// # Safety
    /// Nobody asks, changes or commits the scene during the call.
    pub unsafe fn plant<'a>(&mut self, file: impl Into<Arrays<'a>>) -> Result<Planted, HostError> {
        let mut planted = ffi::ShimPlanted::default();
        let mut error = ffi::no_error();
        // SAFETY: the handle is live; the arrays are live for the call, of the lengths that stand
        // beside them, and nothing in them is believed.
        let failed = unsafe {
            ffi::shim_host_plant(self.handle.as_ptr(), &file.into().file(), &mut planted, &mut error)
        };
        if failed == 0 { Ok(Planted::new(&planted)) } else { Err(HostError::new(&error)) }
    }

    /// Gives Embree's own trees back, and frees what was planted.
    ///
    /// # Errors
    /// When the scene's memory is not as expected: then nothing is freed.
    ///
    /// # Safety
    /// As for [`Self::plant`].
    pub unsafe fn restore(&mut self) -> Result<(), HostError> {
        let mut error = ffi::no_error();
        // SAFETY: the handle is live.
        match unsafe { ffi::shim_host_restore(self.handle.as_ptr(), &mut error) } {
            0 => Ok(()),
            _ => Err(HostError::new(&error)),
        }
    }

    /// Reads what the scene holds.
    ///
    /// # Errors
    /// When it is not committed, holds anything but triangles and quads that stand still, or its
    /// memory is not as expected.
    ///
    /// # Safety
    /// As for [`Self::plant`], but that others may ask the scene.
    pub unsafe fn capture(&self) -> Result<Capture, HostError> {
        let mut error = ffi::no_error();
        // SAFETY: the handle is live.
        let handle = unsafe { ffi::shim_host_capture(self.handle.as_ptr(), &mut error) };
        Ok(Capture { handle: NonNull::new(handle).ok_or_else(|| HostError::new(&error))? })
    }

    /// Hands over what is asked from now on. `capture` is of the scene as it is.
    ///
    /// # Errors
    /// When it is recorded already, or its kernels are not where they are expected.
    ///
    /// # Safety
    /// As for [`Self::plant`].
    pub unsafe fn record(&mut self, capture: &Capture, sink: Box<dyn HostSink>) -> Result<(), HostError> {
        if self.sink.is_some() {
            return Err(HostError::Refused("the scene is being recorded already".to_owned()));
        }
        let recording = self.sink.insert(Box::new(Recording { sink, panic: Mutex::new(None) }));
        let user: *const Recording = &**recording;
        let sink = ffi::ShimHostSink { batch: Some(take_batch), user: user.cast_mut().cast() };
        let mut error = ffi::no_error();
        // SAFETY: both handles are live, and the sink until the recording has ended.
        let failed =
            unsafe { ffi::shim_host_record(self.handle.as_ptr(), capture.handle.as_ptr(), sink, &mut error) };
        if failed == 0 {
            return Ok(());
        }
        self.sink = None;
        Err(HostError::new(&error))
    }

    /// Ends the recording: what threads still have is handed over, and nothing afterwards.
    ///
    /// # Safety
    /// As for [`Self::plant`].
    pub unsafe fn end(&mut self) -> Ended {
        let mut end = ffi::ShimHostEnd::default();
        // SAFETY: the handle is live.
        unsafe { ffi::shim_host_end(self.handle.as_ptr(), &mut end) };
        let panic = self.sink.take().and_then(|recording| {
            recording.panic.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner)
        });
        if let Some(panic) = panic {
            std::panic::resume_unwind(panic);
        }
        Ended {
            threads: end.threads,
            unrecorded: end.unrecorded,
            lost_rejects: end.lost_rejects,
            interrupted: end.interrupted,
            was_committed: end.interrupted_scene != 0,
        }
    }
}

impl Drop for HostScene {
    fn drop(&mut self) {
        // SAFETY: made by `shim_host_new`, freed once. It ends the recording, and only then the
        // sink goes.
        unsafe { ffi::shim_host_free(self.handle.as_ptr()) }
    }
}

/// What the calling thread asks recorded scenes from now on is of this pixel, depth and purpose
/// ([`Record`]; [`crate::format::rays::NO_PATH`] and [`crate::format::rays::NO_DEPTH`] where there
/// is none).
pub fn label(path: u32, depth: u8, purpose: u8) {
    // SAFETY: no preconditions.
    unsafe { ffi::shim_host_label(path, depth, purpose) }
}

/// Called by the shim with what a thread has asked.
unsafe extern "C" fn take_batch(
    user: *mut c_void,
    thread: u32,
    records: *const ffi::ShimRecord,
    count: u64,
    rejects: *const ffi::ShimReject,
    reject_count: u64,
) -> u32 {
    // SAFETY: `user` is the recording that `record` gave, which lives until the shim has ended it;
    // the arrays are live for the call, of these lengths, and their elements have the layouts of
    // ours (checked in `ffi`).
    let (recording, records, rejects) = unsafe {
        (
            &*user.cast::<Recording>(),
            ffi::slice(records.cast::<Record>(), count),
            ffi::slice(rejects.cast::<Reject>(), reject_count),
        )
    };
    match catch_unwind(AssertUnwindSafe(|| recording.sink.batch(thread, records, rejects))) {
        Ok(goes_on) => u32::from(!goes_on),
        Err(panic) => {
            recording.panic.lock().unwrap_or_else(std::sync::PoisonError::into_inner).get_or_insert(panic);
            1
        }
    }
}
