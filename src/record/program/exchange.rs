//! embree-trace's side of `embree-shim/exchange.h`: the mapping that the recorded program's threads write to.
//!
//! The mapping has no name: the program opens it through this process's descriptors, so nothing is left behind however both
//! end. Another process writes to it at any time, so there are no references into it: fields are read atomically, slots copied.
//! Slots have locks that the program's threads hold; here they are only made.

use crate::embree::ffi::{
    self, EXCHANGE_CAPTURES, EXCHANGE_FREE, EXCHANGE_FULL, EXCHANGE_MAGIC, EXCHANGE_OWNED, EXCHANGE_PATH,
    EXCHANGE_RECORDS, EXCHANGE_REJECTS, EXCHANGE_RELEASED, EXCHANGE_SCENES, EXCHANGE_SLOTS, ExchangeHeader,
    ExchangeSlot,
};
use crate::format::rays::{Record, Reject};
use crate::zeroed::zeroed_vec;
use memmap2::{MmapOptions, MmapRaw};
use std::fs::File;
use std::io;
use std::mem::{MaybeUninit, offset_of};
use std::os::fd::{AsRawFd, FromRawFd};
use std::path::Path;
use std::sync::atomic::{AtomicU8, AtomicU32, AtomicU64, Ordering};

const NUMBERS: usize = size_of::<ExchangeHeader>().next_multiple_of(64);
const CAPTURES: usize = NUMBERS + 4 * EXCHANGE_SCENES as usize;
const SLOTS: usize = CAPTURES + EXCHANGE_CAPTURES as usize;
const BYTES: usize = SLOTS + EXCHANGE_SLOTS as usize * size_of::<ExchangeSlot>();
const _: () = assert!(size_of::<libc::pthread_mutex_t>() <= 5 * size_of::<u64>());
const _: () = assert!(
    (SLOTS + offset_of!(ExchangeSlot, lock)).is_multiple_of(align_of::<libc::pthread_mutex_t>())
        && size_of::<ExchangeSlot>().is_multiple_of(align_of::<libc::pthread_mutex_t>())
);

/// A file in memory, without a name; closed in programs that are started.
pub fn memory_file(name: &std::ffi::CStr) -> io::Result<File> {
    // SAFETY: `name` is a zero-terminated text; the result is checked.
    let descriptor = unsafe { libc::memfd_create(name.as_ptr(), libc::MFD_CLOEXEC) };
    if descriptor < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: the descriptor was just made, and belongs to nobody else.
    Ok(unsafe { File::from_raw_fd(descriptor) })
}

/// A path that leads any process of the same user to a file that this one has open.
pub fn path_of(file: &File) -> String {
    format!("/proc/{}/fd/{}", std::process::id(), file.as_raw_fd())
}

/// What the program has counted.
#[derive(Clone, Debug, Default)]
pub struct Counters {
    pub processes: u32,
    pub threads: u32,
    pub embree_version: u32,
    /// Calls went to a library that is neither libembree3 nor libembree4.
    pub foreign: bool,
    pub unrecorded: u64,
    pub unnumbered: u64,
    pub lost_rejects: u64,
    /// Closest-hit queries whose interval the program's own functions have changed.
    pub interrupted: u64,
    /// What ended the recording early.
    pub failure: Option<String>,
}

/// What a slot held.
#[derive(Debug)]
pub struct Batch {
    pub thread: u32,
    /// Number, within the thread, of the first record.
    pub sequence: u64,
    pub records: Vec<Record>,
    /// The scene's number, for each record.
    pub scenes: Vec<u16>,
    /// Sorted by record.
    pub rejects: Vec<Reject>,
}

/// The mapping.
pub struct Exchange {
    file: File,
    map: MmapRaw,
}

impl Exchange {
    /// `directory` is where the program puts the files of its scenes.
    ///
    /// # Errors
    /// When there is no memory for it, or the directory's path is too long.
    pub fn new(directory: &Path) -> io::Result<Exchange> {
        let file = memory_file(c"embree-trace")?;
        file.set_len(BYTES as u64)?;
        let map = MmapOptions::new().len(BYTES).map_raw(&file)?;
        let exchange = Exchange { file, map };
        let path = directory.as_os_str().as_encoded_bytes();
        if path.len() >= EXCHANGE_PATH as usize {
            return Err(io::Error::other(format!(
                "the path has {} bytes, at most {EXCHANGE_PATH} fit",
                path.len()
            )));
        }
        let header = exchange.map.as_mut_ptr().cast::<ExchangeHeader>();
        // SAFETY: the mapping is page aligned and holds a header; no other process has it yet, and `path` fits.
        unsafe {
            (*header).collector = std::process::id() as i32;
            (*header).bytes = BYTES as u64;
            std::ptr::copy_nonoverlapping(
                path.as_ptr().cast(),
                (&raw mut (*header).directory).cast::<u8>(),
                path.len(),
            );
            (*header).magic = EXCHANGE_MAGIC;
        }
        exchange.make_locks()?;
        Ok(exchange)
    }

    /// Makes the slots' locks. Each is robust, so that the kernel tells when an owner has ended
    /// with it, and of several processes.
    fn make_locks(&self) -> io::Result<()> {
        let checked = |error: i32| if error == 0 { Ok(()) } else { Err(io::Error::from_raw_os_error(error)) };
        let mut attributes = MaybeUninit::<libc::pthread_mutexattr_t>::uninit();
        let attributes = attributes.as_mut_ptr();
        // SAFETY: the attributes are made before they are changed, used and destroyed, here and
        // once. A lock is made in bytes of its slot that are kept for it, large and aligned enough,
        // as asserted below; no other process has the mapping yet, and it is never moved: programs
        // map the same memory.
        unsafe {
            checked(libc::pthread_mutexattr_init(attributes))?;
            checked(libc::pthread_mutexattr_setrobust(attributes, libc::PTHREAD_MUTEX_ROBUST))?;
            checked(libc::pthread_mutexattr_setpshared(attributes, libc::PTHREAD_PROCESS_SHARED))?;
            for index in 0..EXCHANGE_SLOTS as usize {
                let lock = SLOTS + index * size_of::<ExchangeSlot>() + offset_of!(ExchangeSlot, lock);
                checked(libc::pthread_mutex_init(self.map.as_mut_ptr().add(lock).cast(), attributes))?;
            }
            checked(libc::pthread_mutexattr_destroy(attributes))
        }
    }

    /// What `EMBREE_TRACE_EXCHANGE` is set to.
    pub fn path(&self) -> String {
        path_of(&self.file)
    }

    fn u8_at(&self, offset: usize) -> &AtomicU8 {
        debug_assert!(offset < BYTES);
        // SAFETY: inside of the mapping, which lives as long as `self`; all access to these bytes is atomic.
        unsafe { AtomicU8::from_ptr(self.map.as_mut_ptr().add(offset)) }
    }

    fn u32_at(&self, offset: usize) -> &AtomicU32 {
        debug_assert!(offset + 4 <= BYTES && offset.is_multiple_of(4));
        // SAFETY: as above, and aligned: the mapping is page aligned, the offset a multiple of 4.
        unsafe { AtomicU32::from_ptr(self.map.as_mut_ptr().add(offset).cast()) }
    }

    fn u64_at(&self, offset: usize) -> &AtomicU64 {
        debug_assert!(offset + 8 <= BYTES && offset.is_multiple_of(8));
        // SAFETY: as above.
        unsafe { AtomicU64::from_ptr(self.map.as_mut_ptr().add(offset).cast()) }
    }

    /// Nothing more is to be recorded; the program goes on.
    pub fn stop(&self) {
        self.u32_at(offset_of!(ExchangeHeader, stop)).store(1, Ordering::Release);
    }

    /// How many scenes have a number.
    pub fn scene_count(&self) -> u32 {
        self.u32_at(offset_of!(ExchangeHeader, scenes)).load(Ordering::Acquire).min(EXCHANGE_SCENES)
    }

    /// The capture that scene `number` is; `None` for the moment between the number's being given and its being written.
    pub fn capture_of(&self, number: u32) -> Option<u32> {
        assert!(number < EXCHANGE_SCENES);
        self.u32_at(NUMBERS + 4 * number as usize).load(Ordering::Acquire).checked_sub(1)
    }

    /// How many captures there are or have been.
    pub fn capture_count(&self) -> u32 {
        self.u32_at(offset_of!(ExchangeHeader, captures)).load(Ordering::Acquire).min(EXCHANGE_CAPTURES)
    }

    /// Whether the program will not refer to a capture again.
    pub fn is_released(&self, capture: u32) -> bool {
        assert!(capture < EXCHANGE_CAPTURES);
        u32::from(self.u8_at(CAPTURES + capture as usize).load(Ordering::Acquire)) == EXCHANGE_RELEASED
    }

    pub fn counters(&self) -> Counters {
        let u32_at = |offset| self.u32_at(offset).load(Ordering::Acquire);
        let u64_at = |offset| self.u64_at(offset).load(Ordering::Acquire);
        Counters {
            processes: u32_at(offset_of!(ExchangeHeader, processes)),
            threads: u32_at(offset_of!(ExchangeHeader, threads)),
            embree_version: u32_at(offset_of!(ExchangeHeader, embree_version)),
            foreign: u32_at(offset_of!(ExchangeHeader, foreign)) != 0,
            unrecorded: u64_at(offset_of!(ExchangeHeader, unrecorded)),
            unnumbered: u64_at(offset_of!(ExchangeHeader, unnumbered)),
            lost_rejects: u64_at(offset_of!(ExchangeHeader, lost_rejects)),
            interrupted: u64_at(offset_of!(ExchangeHeader, interrupted)),
            failure: (u32_at(offset_of!(ExchangeHeader, failed)) == 2).then(|| {
                // SAFETY: inside of the mapping; the text is not written again once `failed` is 2.
                let text = unsafe {
                    let header = self.map.as_ptr().cast::<ExchangeHeader>();
                    std::ptr::read(&raw const (*header).failure)
                };
                ffi::text(&text)
            }),
        }
    }

    /// Empties the full slots, in the order in which each thread filled its own.
    pub fn take_full(&self) -> Vec<Batch> {
        self.take(|state| state == EXCHANGE_FULL)
    }

    /// Empties all slots: for when the program has ended, also those that a thread had no time to hand over.
    pub fn take_all(&self) -> Vec<Batch> {
        self.take(|state| state == EXCHANGE_FULL || state == EXCHANGE_OWNED)
    }

    fn take(&self, wanted: impl Fn(u32) -> bool) -> Vec<Batch> {
        let mut batches = Vec::new();
        for index in 0..EXCHANGE_SLOTS as usize {
            let slot = SLOTS + index * size_of::<ExchangeSlot>();
            let state = self.u32_at(slot + offset_of!(ExchangeSlot, state));
            let found = state.load(Ordering::Acquire);
            if !wanted(found) {
                continue;
            }
            let batch = self.copy(slot);
            if found == EXCHANGE_FULL {
                self.u32_at(slot + offset_of!(ExchangeSlot, count)).store(0, Ordering::Relaxed);
                state.store(EXCHANGE_FREE, Ordering::Release);
            }
            if !batch.records.is_empty() {
                batches.push(batch);
            }
        }
        batches.sort_by_key(|batch| (batch.thread, batch.sequence));
        batches
    }

    /// What is complete in the slot at this offset.
    fn copy(&self, slot: usize) -> Batch {
        let u32_at = |offset| self.u32_at(slot + offset).load(Ordering::Acquire);
        let count = u32_at(offset_of!(ExchangeSlot, count)).min(EXCHANGE_RECORDS) as usize;
        let reject_count = u32_at(offset_of!(ExchangeSlot, reject_count)).min(EXCHANGE_REJECTS) as usize;
        let mut records: Vec<Record> = zeroed_vec(count);
        let mut scenes = vec![0u16; count];
        let mut rejects: Vec<Reject> = zeroed_vec(reject_count);
        // SAFETY: all inside of the mapping, and as many elements as were just allocated. The program does not touch complete
        // records and their rejects until the slot is free again; what it adds meanwhile lies behind them, or is dropped
        // below. Records and rejects are plain numbers, so any bytes are ones.
        unsafe {
            let base = self.map.as_ptr().add(slot);
            let from = |offset: usize| base.add(offset);
            std::ptr::copy_nonoverlapping(
                from(offset_of!(ExchangeSlot, records)).cast(),
                records.as_mut_ptr(),
                count,
            );
            std::ptr::copy_nonoverlapping(
                from(offset_of!(ExchangeSlot, scenes)).cast(),
                scenes.as_mut_ptr(),
                count,
            );
            std::ptr::copy_nonoverlapping(
                from(offset_of!(ExchangeSlot, rejects)).cast(),
                rejects.as_mut_ptr(),
                reject_count,
            );
        }
        rejects.retain(|reject| (reject.record as usize) < count);
        Batch {
            thread: u32_at(offset_of!(ExchangeSlot, thread)),
            sequence: self.u64_at(slot + offset_of!(ExchangeSlot, sequence)).load(Ordering::Acquire),
            records,
            scenes,
            rejects,
        }
    }
}
