//! Embree's own kernels on each tree, beside Embree on the trees that it builds itself.
//!
//! The first tree's file gives a scene, every tree is planted in it (`scenes`), and the queries of
//! a recording go to one after the other: all of them for their answers, which are checked against
//! the recording and against Embree's on its own tree, and some of them for their time
//! ([`super::timing`]).

#[cfg(not(feature = "embree"))]
#[path = "kernels/none.rs"]
mod scenes;
#[cfg(feature = "embree")]
mod scenes;
#[cfg(feature = "embree")]
mod sums;

pub(super) use scenes::EmbreeScenes;

use crate::replay::Mismatch;

/// Relative difference of t beyond which two answers of Embree's are counted as apart.
pub const APART: f64 = 1e-4;

/// Which kernels are asked, of those that Embree has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// Name of an instruction set; `None` is the best that the processor has.
    pub isa: Option<&'static str>,
    /// Embree's robust kernels; without this, where a scene stands too far from the origin for
    /// others.
    pub robust: bool,
}

/// What is asked.
#[derive(Clone, Debug, PartialEq)]
pub struct Kernels {
    /// 31305 for 3.13.5.
    pub version: u32,
    /// Such as `avx2`; empty when Embree's memory does not tell.
    pub isa: String,
    /// What Embree traverses, such as `BVH8<triangle4>`, or `rtcBuildBVH` where memory does not tell.
    pub structure: String,
    pub robust: bool,
    /// Qualities of the trees that Embree built itself. Others are planted in the scene of the first.
    pub own: Vec<&'static str>,
    /// By tree, as in the comparison: what was planted, or why it was not.
    pub trees: Vec<Result<Planting, String>>,
}

impl Kernels {
    /// What is asked, for people.
    pub fn name(&self) -> String {
        name(self.version, &self.isa, &self.structure, self.robust)
    }
}

/// Kernels for people: `Embree 3.13.5, avx2, BVH8<triangle4>`.
pub fn name(number: u32, isa: &str, structure: &str, robust: bool) -> String {
    let robust = if robust { "robust" } else { "" };
    let words = [isa, structure, robust].into_iter().filter(|word| !word.is_empty());
    let words = std::iter::once(format!("Embree {}", version(number))).chain(words.map(str::to_owned));
    words.collect::<Vec<_>>().join(", ")
}

/// 31305 as 3.13.5.
pub fn version(number: u32) -> String {
    format!("{}.{}.{}", number / 10_000, number / 100 % 100, number % 100)
}

/// A tree in Embree's memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Planting {
    pub nodes: usize,
    /// Of up to four triangles or quads.
    pub blocks: usize,
    pub bytes: usize,
}

/// What was answered over one recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AnswersOnTrees {
    /// On Embree's own tree.
    pub own: Answers,
    /// By tree; `None` where it is not planted.
    pub trees: Vec<Option<Answers>>,
}

/// The answers on one tree.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Answers {
    pub queries: u64,
    /// Neither the recorded answer nor as good.
    pub mismatches: u64,
    /// Others than recorded, and both are right.
    pub borderline: u64,
    /// Not judged: a filter of the program's had its say, or what was hit moves or is no triangle.
    pub unjudged: u64,
    /// Hits for misses and the reverse, filters or not.
    pub differing: u64,
    /// The first in the file.
    pub mismatch: Option<Mismatch>,
    /// One by one, against the same on Embree's own tree.
    pub singly: Differences,
    /// In packets of up to 16, against the same on Embree's own tree.
    pub in_packets: Differences,
}

/// Two answers of Embree's for each of some queries.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Differences {
    /// A hit in the one, a miss in the other.
    pub flipped: u64,
    /// Closest hits of which the one lies more than [`APART`] beyond the other.
    pub apart: u64,
}
