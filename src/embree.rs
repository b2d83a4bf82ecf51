//! Embree, safely: scenes, intersectors that answer (and record) queries, and the trees that Embree built.
//!
//! A [`Mesh`] becomes a [`Scene`], committed; any number of threads ask it, each through an [`Intersector`] of its own; a
//! recording one hands batches of [`Record`]s to a [`BatchSink`]. [`Scene::tree`] gives the tree as the files have it.
//! Everything unsafe is here: the C++ side of `embree-shim/shim.h` never throws, and is checked by the layouts in `ffi`.
//!
//! [`Record`]: crate::format::rays::Record

pub(crate) mod ffi;
mod file;
pub mod host;
mod intersector;
mod plant;
mod settings;
#[doc(hidden)]
pub mod testing;
mod tree;

pub use file::whole;
pub use intersector::{BATCH_RECORDS, BatchSink, Hit, Intersector, Query, Stop};
pub use plant::{Arrays, Planted};
pub use settings::{Commit, Isa, Quality, Settings, TRI_ACCELS};
pub use tree::{BuiltTree, TreeSource};

use crate::format::bvh::{Geometry, geometry_kind};
use crate::geometry::{Aabb, Triangle, Vec3};
use crate::mesh::Mesh;
use std::ptr::NonNull;
use thiserror::Error;

/// Why there is no scene, or no tree.
#[derive(Debug, Error, PartialEq)]
pub enum EmbreeError {
    /// The instruction set is not there on this CPU, or not in this libembree3.
    #[error("Embree cannot use the instruction set {0} on this CPU")]
    UnsupportedIsa(Isa),
    /// A setting that Embree would refuse, or silently ignore.
    #[error("{0}")]
    Setting(String),
    /// A mesh that breaks the promises of [`crate::mesh`], or does not fit into the files.
    #[error("{0}")]
    Mesh(String),
    /// Why a tree is not planted; the scene keeps the one that it has.
    #[error("{0}")]
    NotPlanted(String),
    /// Whatever else Embree reported: RTCError and message.
    #[error("Embree (error {code}): {message}")]
    Device { code: i32, message: String },
}

impl EmbreeError {
    fn from_shim(error: &ffi::ShimError) -> EmbreeError {
        EmbreeError::Device { code: error.code, message: ffi::text(&error.message) }
    }
}

/// A committed scene. Part `i` of a mesh is Embree's geomID `i`; triangles are numbered as [`Mesh::triangles`] does, or as in
/// the file whose scene it is.
pub struct Scene {
    handle: NonNull<ffi::ShimScene>,
    geometries: Vec<Geometry>,
    /// Trees that were planted since the last commit, by number from 1.
    planted: Vec<plant::Origin>,
    /// The number of the one that is traversed; 0 is Embree's own.
    chosen: u32,
}

/// Mask of every geometry: each query sees it, unless its own mask is 0.
const ALL_MASKS: u32 = u32::MAX;

// SAFETY: between commits, which need `&mut self`, the C++ scene is only read, and Embree allows queries and reads from any thread.
unsafe impl Send for Scene {}
// SAFETY: as above; every `&self` method only reads.
unsafe impl Sync for Scene {}

impl Scene {
    /// Copies the mesh into Embree and builds its tree. Triangles with a NaN or huge coordinate are kept in the numbering,
    /// though Embree drops them.
    pub fn new(mesh: &Mesh, settings: &Settings) -> Result<Scene, EmbreeError> {
        check(mesh)?;
        let geometries = mesh.geometries(ALL_MASKS);
        let parts: Vec<ffi::ShimPart> = mesh
            .parts
            .iter()
            .zip(&geometries)
            .map(|(part, geometry)| attached(&part.indices, geometry))
            .collect();
        // SAFETY: `check` has shown every index of the parts, whose arrays are the mesh's, to be in range.
        unsafe { Scene::commit(&mesh.vertices, &parts, geometries, settings) }
    }

    /// Makes and commits a scene of `parts`, of which the one at `i` is Embree's geometry `i`.
    ///
    /// # Safety
    /// The parts' arrays are live, of the lengths that stand beside them, and every index in them is one of `vertices`.
    unsafe fn commit(
        vertices: &[Vec3],
        parts: &[ffi::ShimPart],
        geometries: Vec<Geometry>,
        settings: &Settings,
    ) -> Result<Scene, EmbreeError> {
        let config = settings.device_config()?;
        let shim_settings = ffi::ShimSettings {
            device: config.as_ptr(),
            quality: settings.quality.shim_value(),
            flags: settings.shim_flags(),
            commit: settings.commit.shim_value(),
        };
        let mut error = ffi::no_error();
        // SAFETY: the vertices are three floats each, as many as is said; the caller vouches for the parts; the shim copies what
        // it needs.
        let handle = unsafe {
            ffi::shim_scene_new(
                &shim_settings,
                vertices.as_ptr().cast(),
                vertices.len() as u64,
                parts.as_ptr(),
                parts.len() as u32,
                &mut error,
            )
        };
        NonNull::new(handle)
            .map(|handle| Scene { handle, geometries, planted: Vec::new(), chosen: 0 })
            .ok_or_else(|| match settings.isa {
                Some(isa) if error.code == ffi::UNSUPPORTED_CPU => EmbreeError::UnsupportedIsa(isa),
                _ => EmbreeError::from_shim(&error),
            })
    }

    /// Gives the scene other vertices, as many as it has, for the same faces, and commits it as [`Settings::commit`] said.
    /// Triangles that Embree dropped and could keep now, or the reverse, make their part's tree be built anew.
    ///
    /// # Errors
    /// When the scene is for one commit only, or the number of vertices is another: then nothing has changed. When Embree
    /// fails, out of memory, the scene must not be asked any more.
    pub fn update(&mut self, vertices: &[Vec3]) -> Result<(), EmbreeError> {
        let mut error = ffi::no_error();
        // SAFETY: the handle is live and, by `&mut self`, nobody asks it; the pointer is to an array of the length given, of
        // three floats each, which the shim copies.
        let failed = unsafe {
            ffi::shim_scene_update(
                self.handle.as_ptr(),
                vertices.as_ptr().cast(),
                vertices.len() as u64,
                &mut error,
            )
        };
        if failed != 0 {
            return Err(EmbreeError::from_shim(&error));
        }
        self.planted.clear();
        self.chosen = 0;
        Ok(())
    }

    /// The version of the library, such as 31305 for 3.13.5; 0 when it cannot make a device.
    pub fn version() -> u32 {
        // SAFETY: no arguments, no preconditions.
        unsafe { ffi::shim_version() }
    }

    /// The box around everything that Embree has not dropped; [`Aabb::EMPTY`] when that is nothing.
    pub fn bounds(&self) -> Aabb {
        let mut bounds = [0.0f32; 6];
        // SAFETY: the handle is live, and the array has the six floats that are written.
        unsafe { ffi::shim_scene_bounds(self.handle.as_ptr(), bounds.as_mut_ptr()) };
        let [x, y, z, upper_x, upper_y, upper_z] = bounds;
        Aabb { lower: Vec3::new(x, y, z), upper: Vec3::new(upper_x, upper_y, upper_z) }
    }

    /// An intersector for one thread.
    pub fn intersector(&self) -> Result<Intersector<'_>, EmbreeError> {
        let mut error = ffi::no_error();
        // SAFETY: the handle is live, and the returned intersector borrows `self`.
        let handle = unsafe { ffi::shim_intersector_new(self.handle.as_ptr(), &mut error) };
        let handle = NonNull::new(handle).ok_or_else(|| EmbreeError::from_shim(&error))?;
        Ok(Intersector::new(handle))
    }

    /// An intersector for one thread that hands every query and its answer to `sink`, [`BATCH_RECORDS`] at a time.
    pub fn recording_intersector<'a>(
        &'a self,
        sink: &'a mut dyn BatchSink,
    ) -> Result<Intersector<'a>, EmbreeError> {
        self.intersector()?.recording(sink)
    }

    /// The elements of `TRIS`, and how many finite triangles were made NaN because Embree drops them: a coordinate has to
    /// be below 1.844e18, and a quad loses both its triangles to one bad vertex.
    pub fn triangles(&self) -> (Vec<Triangle>, u64) {
        // SAFETY: the handle is live.
        let count = unsafe { ffi::shim_scene_triangle_count(self.handle.as_ptr()) } as usize;
        let mut triangles = vec![Triangle([Vec3::ZERO; 3]); count];
        // SAFETY: a `Triangle` is nine floats (`repr(C)`, checked in `ffi`), and `count` of them are written.
        let replaced =
            unsafe { ffi::shim_scene_triangles(self.handle.as_ptr(), triangles.as_mut_ptr().cast()) };
        (triangles, replaced)
    }
}

impl Drop for Scene {
    fn drop(&mut self) {
        // SAFETY: made by `shim_scene_new`, freed once; whatever borrows the scene is gone.
        unsafe { ffi::shim_scene_free(self.handle.as_ptr()) }
    }
}

/// Faces of one geometry, for the shim.
fn attached(indices: &[u32], geometry: &Geometry) -> ffi::ShimPart {
    let corners = if geometry.kind == geometry_kind::QUADS { 4 } else { 3 };
    ffi::ShimPart {
        indices: indices.as_ptr(),
        faces: (indices.len() / corners) as u64,
        corners: corners as u32,
        mask: geometry.mask,
        first_triangle: geometry.first_triangle,
    }
}

/// What Embree itself does not check, and would read out of bounds without.
fn check(mesh: &Mesh) -> Result<(), EmbreeError> {
    for part in &mesh.parts {
        if let Some(index) = part.indices.iter().find(|&&index| index as usize >= mesh.vertices.len()) {
            return Err(EmbreeError::Mesh(format!(
                "part {:?} names vertex {index}, but the mesh has {} vertices",
                part.name,
                mesh.vertices.len()
            )));
        }
    }
    check_counts(mesh.triangle_count(), mesh.vertices.len(), mesh.parts.len())
}

/// NO_TRIANGLE is no index, and a leaf's count and Embree's own numbers have 31 bits.
fn check_counts(triangles: usize, vertices: usize, parts: usize) -> Result<(), EmbreeError> {
    let limit = i32::MAX as usize;
    for (what, count) in [("triangles", triangles), ("vertices", vertices), ("parts", parts)] {
        if count > limit {
            return Err(EmbreeError::Mesh(format!(
                "the mesh has {count} {what}; at most {limit} are possible"
            )));
        }
    }
    Ok(())
}
