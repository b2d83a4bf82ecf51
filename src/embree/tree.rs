//! Trees out of Embree: the one that it traverses, read from its memory, or that of `rtcBuildBVH`.

use super::{EmbreeError, Scene, ffi};
use crate::format::bvh::{Contents, Geometry};
use crate::geometry::Triangle;
use crate::tree::{Node, Tree};
use std::ptr::NonNull;

/// Where a tree comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TreeSource {
    /// Embree's own, as it is in memory after the commit: 4 or 8 wide, leaves of several triangles. When a check says that
    /// memory is not laid out as expected, the builder's instead, with a warning.
    #[default]
    Live,
    /// `rtcBuildBVH`: binary, one triangle a leaf.
    Builder,
}

impl TreeSource {
    pub const ALL: [TreeSource; 2] = [TreeSource::Live, TreeSource::Builder];

    /// The name in options.
    pub fn name(self) -> &'static str {
        match self {
            TreeSource::Live => "live",
            TreeSource::Builder => "builder",
        }
    }

    pub fn from_name(name: &str) -> Option<TreeSource> {
        TreeSource::ALL.into_iter().find(|source| source.name() == name)
    }
}

/// Bits of [`BuiltTree::flags`]: those of the header of a `.bvh` that a scene of ours can have.
mod flag {
    pub const SPATIAL_SPLITS: u32 = 1;
    pub const LIVE: u32 = 4;
    pub const BUILDER: u32 = 8;
}

/// A tree and all that a `.bvh` says of it.
#[derive(Clone, Debug, PartialEq)]
pub struct BuiltTree {
    pub tree: Tree,
    /// The elements of `TRIS` (see [`Scene::triangles`]).
    pub triangles: Vec<Triangle>,
    /// The elements of `GEOM`, one per part of the mesh.
    pub geometries: Vec<Geometry>,
    /// The element of `ORDR` of each node, where the tree was planted with it.
    pub order: Option<Vec<u8>>,
    /// Such as `embree 3.13.5 avx2 BVH8<triangle4>`; of a tree that was planted, `planted in` that.
    pub producer: String,
    /// Flags of the `.bvh`'s header.
    pub flags: u32,
    /// One line about what is not as was asked for: which check of the live tree failed, or what was left out.
    pub warning: Option<String>,
}

impl BuiltTree {
    /// What its file holds; a `META` is the caller's to add.
    pub fn contents(&self) -> Contents<'_> {
        Contents {
            tree: self.tree.view(),
            triangles: &self.triangles,
            geometries: &self.geometries,
            order: self.order.as_deref(),
            meta: None,
            flags: self.flags,
            producer: &self.producer,
        }
    }
}

impl Scene {
    /// The scene's tree. An empty scene has one empty leaf.
    pub fn tree(&self, source: TreeSource) -> Result<BuiltTree, EmbreeError> {
        match source {
            TreeSource::Live => self.live_tree(None),
            TreeSource::Builder => {
                let mut built = self.assemble(self.take(|error| {
                    // SAFETY: the handle is live.
                    unsafe { ffi::shim_tree_built(self.handle.as_ptr(), error) }
                })?);
                built.flags |= flag::BUILDER;
                Ok(built)
            }
        }
    }

    /// The live tree, or the builder's when a check fails. `fault` falsifies what is read, for tests.
    pub(super) fn live_tree(&self, fault: Option<&ffi::ShimFault>) -> Result<BuiltTree, EmbreeError> {
        let fault = fault.map_or(std::ptr::null(), |fault| fault as *const ffi::ShimFault);
        let taken = self.take(|error| {
            // SAFETY: the handle is live; `fault` is null or borrowed for this call.
            unsafe { ffi::shim_tree_live(self.handle.as_ptr(), fault, error) }
        });
        match taken {
            Ok(taken) => {
                let mut built = self.assemble(taken);
                built.flags |= flag::LIVE;
                if let Some(origin) = self.chosen() {
                    built.producer = format!("planted in {}", built.producer);
                    built.order = origin.order_of(built.tree.view());
                }
                Ok(built)
            }
            Err(EmbreeError::Device { code, message }) if code == ffi::SHIM_DOUBT as i32 => {
                let mut built = self.tree(TreeSource::Builder)?;
                let reason =
                    format!("Embree's live tree cannot be read ({message}); rtcBuildBVH's is used instead");
                built.warning = Some(match built.warning {
                    Some(warning) => format!("{reason}; {warning}"),
                    None => reason,
                });
                Ok(built)
            }
            Err(error) => Err(error),
        }
    }

    /// Copies a tree out of the shim.
    fn take(
        &self,
        make: impl FnOnce(&mut ffi::ShimError) -> *mut ffi::ShimTree,
    ) -> Result<TakenTree, EmbreeError> {
        let mut error = ffi::no_error();
        let handle = NonNull::new(make(&mut error)).ok_or_else(|| EmbreeError::from_shim(&error))?;
        // SAFETY: the shim's tree is live until it is freed below; its arrays have the lengths that stand beside them (a
        // pointer to no element may be null, hence `slice`), and a `ShimNode` is a `Node` (checked in `ffi`).
        unsafe {
            let view = handle.as_ref();
            let taken = TakenTree {
                tree: Tree {
                    nodes: ffi::slice(view.nodes.cast::<Node>(), view.node_count).to_vec(),
                    primitives: ffi::slice(view.primitives, view.primitive_count).to_vec(),
                },
                producer: ffi::text(&view.producer),
                splits: view.splits != 0,
            };
            ffi::shim_tree_free(handle.as_ptr());
            Ok(taken)
        }
    }

    fn assemble(&self, taken: TakenTree) -> BuiltTree {
        let (triangles, replaced) = self.triangles();
        let warning = (replaced > 0).then(|| {
            format!(
                "{replaced} triangles are written as NaN: Embree drops them, for a coordinate of 1.844e18 or more, or for a \
                 bad vertex of their quad"
            )
        });
        BuiltTree {
            tree: taken.tree,
            triangles,
            geometries: self.geometries.clone(),
            order: None,
            producer: taken.producer,
            flags: if taken.splits { flag::SPATIAL_SPLITS } else { 0 },
            warning,
        }
    }
}

/// What the shim says of a tree.
struct TakenTree {
    tree: Tree,
    producer: String,
    splits: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::embree::Settings;
    use crate::mesh::generate;

    /// Not a test: the shim's tree says that it has more primitives than there are, and they are copied. A sanitizer must see it, or it sees nothing.
    #[test]
    #[ignore = "a defect that is planted for tools/sanitizers, which alone runs it"]
    fn planted_defect() {
        let scene = Scene::new(&generate::quads(3), &Settings::default()).unwrap();
        let taken = scene.take(|error| {
            // SAFETY: the handle is live; for what follows there is none, see above.
            unsafe {
                let tree = ffi::shim_tree_built(scene.handle.as_ptr(), error);
                (*tree).primitive_count += 4096;
                tree
            }
        });
        std::hint::black_box(taken.unwrap().tree);
    }
}
