//! The time that a program's queries take in Embree: rows that its threads add to (`embree-shim/preload_clock.cpp`) → [`SceneTime`],
//! one for each scene of each process.

use super::exchange::{memory_file, path_of};
use crate::embree::ffi::{
    EXCHANGE_CLOCKS, EXCHANGE_CLOSEST_HIT, EXCHANGE_MAGIC, EXCHANGE_OCCLUSION, ExchangeClock, ExchangeClocks,
};
use memmap2::{MmapOptions, MmapRaw};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs::File;
use std::io;

/// Set for the program: the path of the rows.
pub const VARIABLE: &str = "EMBREE_TRACE_CLOCKS";
const BYTES: usize = size_of::<ExchangeClocks>() + EXCHANGE_CLOCKS as usize * size_of::<ExchangeClock>();

/// Queries of one kind, and the processor time that they took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct KindTime {
    pub queries: u64,
    /// Calls whose time was taken: the fewer, the rougher is `seconds`.
    pub timed: u64,
    /// Of all threads, inside of Embree's calls, as estimated from those.
    pub seconds: f64,
}

impl KindTime {
    fn add(&mut self, other: &KindTime) {
        self.queries += other.queries;
        self.timed += other.timed;
        self.seconds += other.seconds;
    }
}

/// What was asked of one scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SceneTime {
    pub closest_hit: KindTime,
    pub occlusion: KindTime,
}

impl SceneTime {
    pub fn add(&mut self, other: &SceneTime) {
        self.closest_hit.add(&other.closest_hit);
        self.occlusion.add(&other.occlusion);
    }

    pub fn queries(&self) -> u64 {
        self.closest_hit.queries + self.occlusion.queries
    }

    pub fn seconds(&self) -> f64 {
        self.closest_hit.seconds + self.occlusion.seconds
    }
}

/// Which scene it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SceneKey {
    pub process: u32,
    /// Which of the process's scenes, from 0.
    pub scene: u32,
    /// A hash of its triangles and quads by number, kind and count, the same in every run; 0 without any.
    pub geometry: u64,
}

/// The rows.
pub struct Clocks {
    file: File,
    map: MmapRaw,
}

impl Clocks {
    /// # Errors
    /// When there is no memory for them.
    pub fn new() -> io::Result<Clocks> {
        let file = memory_file(c"embree-trace clocks")?;
        file.set_len(BYTES as u64)?;
        let map = MmapOptions::new().len(BYTES).map_raw(&file)?;
        // SAFETY: the mapping is page aligned and holds a header; no other process has it yet.
        unsafe { (*map.as_mut_ptr().cast::<ExchangeClocks>()).magic = EXCHANGE_MAGIC };
        Ok(Clocks { file, map })
    }

    /// What [`VARIABLE`] is set to.
    pub fn path(&self) -> String {
        path_of(&self.file)
    }

    /// The sums until now.
    pub fn times(&self) -> BTreeMap<SceneKey, SceneTime> {
        let header = self.map.as_ptr().cast::<ExchangeClocks>();
        // SAFETY: inside of the mapping and aligned; the program changes the number meanwhile, so it is read as one that may.
        let count = unsafe { std::ptr::read_volatile(&raw const (*header).count) }.min(EXCHANGE_CLOCKS);
        let mut times: BTreeMap<SceneKey, SceneTime> = BTreeMap::new();
        for index in 0..count as usize {
            // SAFETY: as many rows lie behind the header, each of them plain numbers, so that any bytes are one. A thread that
            // still runs may add to one meanwhile, and then a sum is one query older than another.
            let row = unsafe { std::ptr::read_volatile(header.add(1).cast::<ExchangeClock>().add(index)) };
            if row.process == 0 {
                continue;
            }
            let kind = |kind: u32| {
                let kind = kind as usize;
                KindTime {
                    queries: row.rays[kind],
                    timed: row.timed[kind],
                    seconds: 1e-9 * row.nanoseconds[kind] as f64,
                }
            };
            let key = SceneKey { process: row.process, scene: row.scene, geometry: row.geometry };
            let time =
                SceneTime { closest_hit: kind(EXCHANGE_CLOSEST_HIT), occlusion: kind(EXCHANGE_OCCLUSION) };
            times.entry(key).or_default().add(&time);
        }
        times
    }
}
