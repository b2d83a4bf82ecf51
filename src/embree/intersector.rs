//! Asking Embree, with or without recording: one call into the shim a query, nothing allocated.

use super::{EmbreeError, ffi};
use crate::format::rays::{NO_DEPTH, NO_PATH, Purpose, Record, Reject};
use crate::geometry::{Ray, Vec3};
use std::any::Any;
use std::ffi::c_void;
use std::marker::PhantomData;
use std::mem::MaybeUninit;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::ptr::NonNull;

/// Records in each full batch that a [`BatchSink`] gets.
pub const BATCH_RECORDS: usize = ffi::SHIM_BATCH_RECORDS as usize;

/// A question to a scene; which one, the method says.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Query {
    pub ray: Ray,
    /// 0 to 1; no matter without motion blur.
    pub time: f32,
    /// A geometry is seen when its mask shares a bit with this one: 0 sees nothing.
    pub mask: u32,
    /// y * width + x of the pixel, or [`NO_PATH`].
    pub path: u32,
    /// 0 for camera rays, or [`NO_DEPTH`].
    pub depth: u8,
    pub purpose: Purpose,
    /// Whether the queries asked together are alike, such as camera rays: Embree may traverse them otherwise then.
    pub coherent: bool,
}

impl Query {
    /// A query that sees everything and of which nothing else is known.
    pub fn new(ray: Ray) -> Query {
        Query {
            ray,
            time: 0.0,
            mask: u32::MAX,
            path: NO_PATH,
            depth: NO_DEPTH,
            purpose: Purpose::Unknown,
            coherent: false,
        }
    }
}

/// What a closest-hit query found.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Hit {
    /// In units of the length of the ray's direction.
    pub t: f32,
    /// Index into `TRIS`, as [`crate::mesh::Mesh::triangles`] numbers them.
    pub triangle: u32,
    /// Index into [`crate::mesh::Mesh::parts`].
    pub part: u32,
    /// Barycentric coordinates in that triangle: (1 - u - v) v0 + u v1 + v v2.
    pub u: f32,
    pub v: f32,
    /// Geometric, not normalised.
    pub normal: Vec3,
}

/// A sink wants no more records: the disk is full, say. It keeps the reason itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stop;

/// Takes what an intersector has recorded.
pub trait BatchSink: Send {
    /// Records in the order in which they were asked: [`BATCH_RECORDS`] of them, or fewer before a flush and at the end.
    /// `rejects` refer to records of this batch. After a `Stop` it is not called again, and queries are only answered.
    fn batch(&mut self, records: &[Record], rejects: &[Reject]) -> Result<(), Stop>;
}

/// A sink as the shim's callback sees it.
struct Recording<'a> {
    sink: &'a mut dyn BatchSink,
    /// A panic of the sink; it goes on in the next flush, outside of C++.
    panic: Option<Box<dyn Any + Send>>,
}

/// Answers queries for one thread at a time.
pub struct Intersector<'a> {
    handle: NonNull<ffi::ShimIntersector>,
    /// Made by `Box::into_raw`; null without recording. The shim's callback uses it, so it is not held as a box.
    recording: *mut Recording<'a>,
    /// The scene that is asked.
    scene: PhantomData<&'a super::Scene>,
}

// SAFETY: the C++ object has no ties to a thread; the scene is `Sync` and the sink `Send`.
unsafe impl Send for Intersector<'_> {}

impl<'a> Intersector<'a> {
    /// Takes over a plain intersector, which borrows a scene for `'a`.
    pub(super) fn new(handle: NonNull<ffi::ShimIntersector>) -> Intersector<'a> {
        Intersector { handle, recording: std::ptr::null_mut(), scene: PhantomData }
    }

    /// Decorates a plain intersector.
    pub(super) fn recording(self, sink: &'a mut dyn BatchSink) -> Result<Intersector<'a>, EmbreeError> {
        let inner = self.handle;
        // The shim owns the handle from here, also when it fails.
        std::mem::forget(self);
        let recording = Box::into_raw(Box::new(Recording { sink, panic: None }));
        let sink = ffi::ShimSink { batch: Some(take_batch), user: recording.cast() };
        let mut error = ffi::no_error();
        // SAFETY: `inner` is live and given away; `recording` stays until after the handle is freed.
        let handle = unsafe { ffi::shim_recording_new(inner.as_ptr(), sink, &mut error) };
        match NonNull::new(handle) {
            Some(handle) => Ok(Intersector { handle, recording, scene: PhantomData }),
            None => {
                // SAFETY: made above, and nobody else knows it after the failure.
                drop(unsafe { Box::from_raw(recording) });
                Err(EmbreeError::from_shim(&error))
            }
        }
    }

    /// The nearest hit within [tnear, tfar].
    #[inline]
    pub fn closest_hit(&mut self, query: &Query) -> Option<Hit> {
        let mut hit = MaybeUninit::<Hit>::uninit();
        // SAFETY: the handle is live and ours alone (`&mut`); `Query` and `Hit` have the layouts of the shim's structs
        // (checked in `ffi`).
        let outcome = unsafe {
            ffi::shim_closest_hit(
                self.handle.as_ptr(),
                (query as *const Query).cast(),
                hit.as_mut_ptr().cast(),
            )
        };
        // SAFETY: the shim fills the whole hit when it says so.
        (outcome == ffi::SHIM_HIT).then(|| unsafe { hit.assume_init() })
    }

    /// Whether anything lies within [tnear, tfar].
    #[inline]
    pub fn occluded(&mut self, query: &Query) -> bool {
        // SAFETY: as in `closest_hit`.
        let outcome = unsafe { ffi::shim_occluded(self.handle.as_ptr(), (query as *const Query).cast()) };
        outcome == ffi::SHIM_HIT
    }

    /// [`Self::closest_hit`] of each query, in packets of 16, 8 and 4 as far as they go. On triangles the answers are the
    /// same bit for bit; on quads Embree's packets differ in the last bits, mostly of u and v.
    ///
    /// # Panics
    /// When the slices differ in length.
    pub fn closest_hits(&mut self, queries: &[Query], hits: &mut [Option<Hit>]) {
        assert_eq!(queries.len(), hits.len(), "a query needs a place for its hit");
        let mut done = 0;
        while done < queries.len() {
            let Some(width) = packet_width(queries.len() - done) else {
                hits[done] = self.closest_hit(&queries[done]);
                done += 1;
                continue;
            };
            let mut found = [MaybeUninit::<Hit>::uninit(); MAX_WIDTH];
            let mut outcomes = [ffi::SHIM_MISS; MAX_WIDTH];
            // SAFETY: as in `closest_hit`; all arrays have at least `width` elements.
            unsafe {
                ffi::shim_closest_hits(
                    self.handle.as_ptr(),
                    queries[done..done + width].as_ptr().cast(),
                    width as u32,
                    found.as_mut_ptr().cast(),
                    outcomes.as_mut_ptr(),
                );
            }
            for lane in 0..width {
                // SAFETY: the shim fills the hits of the lanes for which it says so.
                hits[done + lane] =
                    (outcomes[lane] == ffi::SHIM_HIT).then(|| unsafe { found[lane].assume_init() });
            }
            done += width;
        }
    }

    /// [`Self::occluded`] of each query, in packets of 16, 8 and 4 as far as they go, with the same answers.
    ///
    /// # Panics
    /// When the slices differ in length.
    pub fn occluded_packet(&mut self, queries: &[Query], occluded: &mut [bool]) {
        assert_eq!(queries.len(), occluded.len(), "a query needs a place for its answer");
        let mut done = 0;
        while done < queries.len() {
            let Some(width) = packet_width(queries.len() - done) else {
                occluded[done] = self.occluded(&queries[done]);
                done += 1;
                continue;
            };
            let mut outcomes = [ffi::SHIM_MISS; MAX_WIDTH];
            // SAFETY: as in `closest_hit`; both arrays have at least `width` elements.
            unsafe {
                ffi::shim_occluded_packet(
                    self.handle.as_ptr(),
                    queries[done..done + width].as_ptr().cast(),
                    width as u32,
                    outcomes.as_mut_ptr(),
                );
            }
            for lane in 0..width {
                occluded[done + lane] = outcomes[lane] == ffi::SHIM_HIT;
            }
            done += width;
        }
    }

    /// Hands an incomplete batch to the sink; `Stop` once the sink has said so. Nothing happens without recording.
    /// A panic of the sink comes out here.
    pub fn flush(&mut self) -> Result<(), Stop> {
        // SAFETY: the handle is live and ours alone.
        let stopped = unsafe { ffi::shim_flush(self.handle.as_ptr()) } != 0;
        // SAFETY: null, or made by `Box::into_raw` and live; the callback, its other user, runs only inside calls like the
        // one above.
        if let Some(recording) = unsafe { self.recording.as_mut() }
            && let Some(panic) = recording.panic.take()
        {
            resume_unwind(panic);
        }
        if stopped { Err(Stop) } else { Ok(()) }
    }

    /// Queries refused so far: Embree's asserts would end the process at a NaN or huge ray, or a negative tnear. They
    /// are answered as misses and not recorded.
    pub fn refused(&self) -> u64 {
        // SAFETY: the handle is live.
        unsafe { ffi::shim_refused(self.handle.as_ptr()) }
    }
}

impl Drop for Intersector<'_> {
    /// Hands the last batch to the sink; call [`Self::flush`] before, to learn whether it was taken.
    fn drop(&mut self) {
        // SAFETY: made by the shim, freed once. It may call the sink a last time, so the sink goes after it.
        unsafe { ffi::shim_intersector_free(self.handle.as_ptr()) };
        if !self.recording.is_null() {
            // SAFETY: made by `Box::into_raw`; the shim, its other user, is gone.
            drop(unsafe { Box::from_raw(self.recording) });
        }
    }
}

/// Lanes of the widest packet.
const MAX_WIDTH: usize = 16;

/// The widest packet that `count` queries fill.
fn packet_width(count: usize) -> Option<usize> {
    [16, 8, 4].into_iter().find(|&width| width <= count)
}

/// The shim's callback: no panic leaves it.
unsafe extern "C" fn take_batch(user: *mut c_void, records: *const ffi::ShimRecord, count: u64) -> u32 {
    // SAFETY: `user` is the `Recording` given with this function; the shim is inside a call of the intersector that owns it,
    // and so nobody else uses it.
    let recording = unsafe { &mut *user.cast::<Recording>() };
    // SAFETY: the shim passes `count` initialised records, whose layout is that of `Record` (checked in `ffi`).
    let records = unsafe { std::slice::from_raw_parts(records.cast::<Record>(), count as usize) };
    // Scenes made here have no intersection filters, so nothing is ever rejected.
    match catch_unwind(AssertUnwindSafe(|| recording.sink.batch(records, &[]))) {
        Ok(Ok(())) => 0,
        Ok(Err(Stop)) => 1,
        Err(panic) => {
            recording.panic = Some(panic);
            1
        }
    }
}
