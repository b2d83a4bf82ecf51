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

use super::{RecordingResult, TreeFacts};
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
    /// The instruction set as Embree's memory names it, which may be the least that the kernels need: as in the files of its trees.
    pub named: String,
    pub robust: bool,
    /// Whether the scene has the triangles of instances where the program had the instances.
    pub is_flattened: bool,
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

    /// What they are asked in, for people: a scene of the file alone.
    pub fn scene_name(&self) -> &'static str {
        if self.is_flattened { "instances flattened, without filters" } else { "without filters" }
    }

    /// In what these are not the kernels and the scene of the program that was recorded, a phrase each.
    pub fn unlike(&self, recorded: &Recorded) -> Vec<String> {
        let mut unlike = Vec::new();
        if let Some(number) = recorded.version.filter(|number| *number != self.version) {
            unlike.push(format!("it was recorded from Embree {}", version(number)));
        }
        if let Some(isa) = recorded.isa.as_ref().filter(|isa| **isa != self.named) {
            unlike.push(format!("the recorded kernels are those for {isa}"));
        }
        unlike.extend(self.is_flattened.then(|| "the program has instances".to_owned()));
        unlike.extend(recorded.has_filters.then(|| "the program has filters".to_owned()));
        unlike
    }
}

/// What files say of the Embree that the recorded program asked.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recorded {
    pub version: Option<u32>,
    /// As [`Kernels::named`].
    pub isa: Option<String>,
    pub has_filters: bool,
}

impl Recorded {
    /// Of a recording, and of the trees that were read from a program's memory.
    pub fn of(trees: &[TreeFacts], recording: &RecordingResult) -> Recorded {
        let live = trees.iter().filter(|tree| tree.is_live).map(|tree| told(&tree.producer).0);
        Recorded {
            version: Some(recording.embree_version).filter(|number| *number > 0),
            isa: live.into_iter().find(|isa| !isa.is_empty()),
            has_filters: recording.has_filters,
        }
    }
}

/// Instruction set and structure, from such as `embree 3.13.5 avx2 BVH8<triangle4>`, whatever stands before it; empty where it does not say.
pub(super) fn told(producer: &str) -> (String, String) {
    let mut words = producer.split(' ').skip_while(|word| *word != "embree").skip(2).map(str::to_owned);
    match (words.next(), words.next()) {
        (Some(isa), Some(structure)) => (isa, structure),
        (structure, _) => (String::new(), structure.unwrap_or_default()),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_recorded_otherwise_is_said() {
        let kernels = Kernels {
            version: 31305,
            isa: "avx512".to_owned(),
            structure: "BVH8<triangle4>".to_owned(),
            named: "avx2".to_owned(),
            robust: false,
            is_flattened: false,
            own: Vec::new(),
            trees: Vec::new(),
        };
        assert_eq!(kernels.name(), "Embree 3.13.5, avx512, BVH8<triangle4>");
        // Nothing is known, and nothing is other.
        assert_eq!(kernels.unlike(&Recorded::default()), Vec::<String>::new());
        let same = Recorded { version: Some(31305), isa: Some("avx2".to_owned()), has_filters: false };
        assert_eq!(kernels.unlike(&same), Vec::<String>::new());
        let other = Recorded { version: Some(40300), isa: Some("sse42".to_owned()), has_filters: true };
        let unlike = Kernels { is_flattened: true, ..kernels }.unlike(&other).join("; ");
        for part in ["4.3.0", "sse42", "instances", "filters"] {
            assert!(unlike.contains(part), "{unlike}");
        }
    }

    #[test]
    fn producers_tell_kernels() {
        let told = |producer| {
            let (isa, structure) = told(producer);
            format!("{isa}/{structure}")
        };
        assert_eq!(told("embree 3.13.5 avx2 BVH8<triangle4>"), "avx2/BVH8<triangle4>");
        assert_eq!(told("planted in embree 3.13.5 sse42 BVH4<triangle4>"), "sse42/BVH4<triangle4>");
        assert_eq!(told("binned + embree 3.13.5 rtcBuildBVH"), "/rtcBuildBVH");
        assert_eq!(told("bvh-build 0.1.0"), "/");
    }
}
