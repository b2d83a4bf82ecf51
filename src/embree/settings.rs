//! How Embree is set up: what was asked for becomes a device configuration, or an error before Embree sees it.

use super::{EmbreeError, ffi};
use crate::geometry::{Aabb, Vec3};
use std::ffi::CString;
use std::fmt;

/// Instruction sets that Embree has kernels for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Isa {
    Sse2,
    /// Gives the same tree on every x86-64 CPU, and the same answers but for their last bits
    /// (`rcpps` and `rsqrtps` are approximations that each maker does otherwise): golden files
    /// are made with it.
    Sse42,
    Avx,
    Avx2,
    Avx512,
}

impl Isa {
    pub const ALL: [Isa; 5] = [Isa::Sse2, Isa::Sse42, Isa::Avx, Isa::Avx2, Isa::Avx512];

    /// The name in options and in Embree's configuration.
    pub fn name(self) -> &'static str {
        match self {
            Isa::Sse2 => "sse2",
            Isa::Sse42 => "sse42",
            Isa::Avx => "avx",
            Isa::Avx2 => "avx2",
            Isa::Avx512 => "avx512",
        }
    }

    pub fn from_name(name: &str) -> Option<Isa> {
        Isa::ALL.into_iter().find(|isa| isa.name() == name)
    }
}

impl fmt::Display for Isa {
    fn fmt(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

/// How much time Embree spends on its tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Quality {
    Low,
    #[default]
    Medium,
    /// Spatial splits, unless a scene is robust or compact.
    High,
}

impl Quality {
    pub const ALL: [Quality; 3] = [Quality::Low, Quality::Medium, Quality::High];

    /// The name in options.
    pub fn name(self) -> &'static str {
        match self {
            Quality::Low => "low",
            Quality::Medium => "medium",
            Quality::High => "high",
        }
    }

    pub fn from_name(name: &str) -> Option<Quality> {
        Quality::ALL.into_iter().find(|quality| quality.name() == name)
    }

    pub(super) fn shim_value(self) -> u32 {
        match self {
            Quality::Low => ffi::SHIM_QUALITY_LOW,
            Quality::Medium => ffi::SHIM_QUALITY_MEDIUM,
            Quality::High => ffi::SHIM_QUALITY_HIGH,
        }
    }
}

/// How often a scene is committed, and what becomes of its tree when its vertices have moved ([`Scene::update`]).
///
/// [`Scene::update`]: super::Scene::update
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Commit {
    /// Once: the vertices stay.
    #[default]
    Once,
    /// Embree keeps the tree of each part and fits its boxes to the vertices. A dynamic scene of low quality (two levels:
    /// a tree over the trees of the parts), the only ones that Embree refits.
    Refit,
    /// Embree builds anew, in a dynamic scene of the quality that is asked for.
    Rebuild,
}

impl Commit {
    /// The name in options and in `META`.
    pub fn name(self) -> &'static str {
        match self {
            Commit::Once => "once",
            Commit::Refit => "refit",
            Commit::Rebuild => "rebuild",
        }
    }

    pub(super) fn shim_value(self) -> u32 {
        match self {
            Commit::Once => ffi::SHIM_COMMIT_ONCE,
            Commit::Refit => ffi::SHIM_COMMIT_REFIT,
            Commit::Rebuild => ffi::SHIM_COMMIT_REBUILD,
        }
    }
}

/// The triangle structures that Embree 3.13 can be told to build; those with an 8 need AVX.
pub const TRI_ACCELS: [&str; 9] = [
    "bvh4.triangle4",
    "bvh4.triangle4v",
    "bvh4.triangle4i",
    "qbvh4.triangle4i",
    "bvh8.triangle4",
    "bvh8.triangle4v",
    "bvh8.triangle4i",
    "qbvh8.triangle4i",
    "qbvh8.triangle4",
];

/// From this many times its size away, floats are too far apart for a scene and default kernels.
const COARSE: f64 = 8192.0;

/// How a scene is built and traced. The default is Embree's own.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Settings {
    /// The CPU's best when `None`.
    pub isa: Option<Isa>,
    /// Threads that build; 0 = all. The tree does not depend on it.
    pub threads: usize,
    pub quality: Quality,
    /// Watertight: edges of neighbouring triangles lose no ray.
    pub robust: bool,
    /// Less memory.
    pub compact: bool,
    /// One of [`TRI_ACCELS`]; Embree's choice when `None`.
    pub tri_accel: Option<String>,
    pub commit: Commit,
}

impl Settings {
    /// What `rtcNewDevice` takes. Embree ignores what it does not know, so everything is checked here.
    pub(super) fn device_config(&self) -> Result<CString, EmbreeError> {
        let mut config = Vec::new();
        self.check_refit()?;
        if let Some(isa) = self.isa {
            config.push(format!("isa={isa}"));
        }
        if self.threads > 0 {
            // More would only be idle; Embree allocates for each.
            config.push(format!("threads={}", self.threads.min(1024)));
        }
        if let Some(name) = &self.tri_accel {
            if !TRI_ACCELS.contains(&name.as_str()) {
                return Err(EmbreeError::Setting(format!(
                    "unknown triangle structure {name:?}; Embree has {}",
                    TRI_ACCELS.join(", ")
                )));
            }
            if name.contains("bvh8") && self.isa.is_some_and(|isa| isa < Isa::Avx) {
                return Err(EmbreeError::Setting(format!(
                    "the triangle structure {name} is 8 wide and needs the instruction set avx or better"
                )));
            }
            config.push(format!("tri_accel={name}"));
        }
        CString::new(config.join(",")).map_err(|error| EmbreeError::Setting(error.to_string()))
    }

    /// Asks for Embree's robust kernels when a scene stands so far from the origin that the default
    /// ones lose hits there, and nothing was asked for that robust kernels go without. Returns what
    /// to tell the user.
    ///
    /// With AVX2, default kernels compute the distance of a box's side as fma(side, 1/d, -(o/d)),
    /// whose last term is rounded: sides are off by half the distance between floats at o, and rays
    /// slip by the rims of walls. Without AVX2 they do not, so the queries would also differ from
    /// machine to machine.
    pub fn suit(&mut self, vertices: &[Vec3]) -> Option<String> {
        let chosen = self.robust || self.compact || self.tri_accel.is_some();
        if chosen || self.quality == Quality::High {
            return None;
        }
        let finite = vertices.iter().filter(|vertex| vertex.is_finite());
        let bounds = finite.fold(Aabb::EMPTY, |bounds, vertex| bounds.grown(*vertex));
        let away = f64::from(bounds.lower.abs().max(bounds.upper.abs()).max_element());
        let size = bounds.extent().as_dvec3().length();
        if bounds.is_empty() || away < COARSE * size {
            return None;
        }
        self.robust = true;
        Some(format!(
            "the scene is {size:.3e} large and up to {away:.3e} from the origin, where Embree's default kernels miss boxes by \
             rounding: its robust ones are used (--flags robust)"
        ))
    }

    /// What Embree would silently do without refitting.
    fn check_refit(&self) -> Result<(), EmbreeError> {
        if self.commit != Commit::Refit {
            return Ok(());
        }
        let clash = |what: String| {
            Err(EmbreeError::Setting(format!("Embree does not refit {what}; leave that out, or rebuild")))
        };
        match &self.tri_accel {
            Some(name) => clash(format!("a triangle structure that is asked for by name ({name})")),
            None if self.quality == Quality::High => clash("trees of high quality".to_owned()),
            None => Ok(()),
        }
    }

    pub(super) fn shim_flags(&self) -> u32 {
        (if self.robust { ffi::SHIM_SCENE_ROBUST } else { 0 })
            | (if self.compact { ffi::SHIM_SCENE_COMPACT } else { 0 })
    }
}
