//! Planting: the tree of a `.bvh` in a live scene, so that Embree's own kernels traverse it.
//!
//! A [`Bvh`], of which every index has been checked, goes as borrowed arrays into the shim. That
//! checks the scene's memory, the file and the two together, and changes nothing when there is any
//! doubt (`embree-shim/plant.hpp`).

use super::{EmbreeError, Scene, ffi};
use crate::format::bvh::Bvh;
use crate::format::checksum;
use crate::tree::TreeView;

/// A tree that was planted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Planted {
    /// Counted from 1 since the scene was committed.
    number: u32,
    /// Trees of Embree's that it stands in for: one of triangles, one of quads, or both.
    pub trees: usize,
    pub nodes: usize,
    /// Blocks of up to four triangles or quads.
    pub blocks: usize,
    /// Memory that it takes.
    pub bytes: usize,
    /// Entries of the stack that a traversal needs at most.
    pub stack: usize,
    /// Children that a node of the scene has room for: 4 or 8.
    pub width: usize,
}

impl Planted {
    fn new(planted: &ffi::ShimPlanted) -> Planted {
        Planted {
            number: planted.number,
            trees: planted.trees as usize,
            nodes: planted.nodes as usize,
            blocks: planted.blocks as usize,
            bytes: planted.bytes as usize,
            stack: planted.stack as usize,
            width: planted.width as usize,
        }
    }
}

/// What of a file goes along with its tree.
#[derive(Default)]
pub(super) struct Origin {
    /// Of the nodes: a tree with others has another order.
    nodes: u64,
    order: Option<Vec<u8>>,
}

impl Origin {
    /// The order of a tree that was read back, when that has the file's nodes.
    pub(super) fn order_of(&self, tree: TreeView) -> Option<Vec<u8>> {
        self.order.clone().filter(|_| checksum(bytemuck::cast_slice(tree.nodes)) == self.nodes)
    }
}

impl Scene {
    /// Plants a tree over the triangles that the scene has: from now on every query traverses it,
    /// and [`Scene::tree`] reads it back. It is freed with the scene, or with the next
    /// [`Scene::update`], after which the scene has Embree's own tree.
    ///
    /// Both triangles of a quad are one primitive, and triangles and quads have trees of their own
    /// in Embree: such a tree is planted as far as it is over the one kind, and over the other.
    ///
    /// # Errors
    /// [`EmbreeError::NotPlanted`] when the tree is not one of this scene, Embree's kernels cannot follow it, or the scene's
    /// memory is not laid out as expected. Then the scene keeps the tree that it has.
    pub fn plant(&mut self, bvh: &Bvh) -> Result<Planted, EmbreeError> {
        let planted = self.plant_with(&tree_file(bvh), None)?;
        if let (Some(order), Some(origin)) = (bvh.order, self.planted.last_mut()) {
            origin.nodes = checksum(bytemuck::cast_slice(bvh.tree.nodes));
            origin.order = Some(order.to_vec());
        }
        Ok(planted)
    }

    /// Of the planted tree that is traversed.
    pub(super) fn chosen(&self) -> Option<&Origin> {
        self.planted.get((self.chosen as usize).checked_sub(1)?)
    }

    /// Plants arrays that need not be those of a valid file; `fault` falsifies what is read of the
    /// scene, for tests.
    pub(super) fn plant_with(
        &mut self,
        file: &ffi::ShimTreeFile,
        fault: Option<&ffi::ShimFault>,
    ) -> Result<Planted, EmbreeError> {
        let fault = fault.map_or(std::ptr::null(), |fault| fault as *const ffi::ShimFault);
        let mut planted = ffi::ShimPlanted::default();
        let mut error = ffi::no_error();
        // SAFETY: the handle is live and, by `&mut self`, nobody asks it; the arrays of `file` are
        // live for the call, of the lengths that stand beside them, and nothing in them is
        // believed; `fault` is null or borrowed for this call.
        let failed =
            unsafe { ffi::shim_scene_plant(self.handle.as_ptr(), file, fault, &mut planted, &mut error) };
        if failed == 0 {
            self.planted.push(Origin::default());
            self.chosen = planted.number;
            return Ok(Planted::new(&planted));
        }
        match EmbreeError::from_shim(&error) {
            EmbreeError::Device { code, message } if code == ffi::SHIM_DOUBT as i32 => {
                Err(EmbreeError::NotPlanted(message))
            }
            other => Err(other),
        }
    }

    /// Which tree queries traverse from now on: one that was planted since the last commit, or, for
    /// `None`, Embree's own. That takes no time, so trees can be measured in turn.
    ///
    /// # Errors
    /// When it was planted before the last commit, or in another scene that has more of them.
    pub fn choose(&mut self, planted: Option<&Planted>) -> Result<(), EmbreeError> {
        let number = planted.map_or(0, |planted| planted.number);
        // SAFETY: the handle is live.
        match unsafe { ffi::shim_scene_choose(self.handle.as_ptr(), number) } {
            0 => {
                self.chosen = number;
                Ok(())
            }
            _ => Err(EmbreeError::NotPlanted("the scene has been committed since".to_owned())),
        }
    }
}

/// A file as the shim wants it; the arrays stay the file's.
pub(super) fn tree_file(bvh: &Bvh) -> ffi::ShimTreeFile {
    ffi::ShimTreeFile {
        nodes: bvh.tree.nodes.as_ptr().cast(),
        node_count: bvh.tree.nodes.len() as u64,
        primitives: bvh.tree.primitives.as_ptr(),
        primitive_count: bvh.tree.primitives.len() as u64,
        triangles: bvh.triangles.as_ptr().cast(),
        triangle_count: bvh.triangles.len() as u64,
        geometries: bvh.geometries.as_ptr().cast(),
        geometry_count: bvh.geometries.len() as u64,
        order: bvh.order.map_or(std::ptr::null(), <[u8]>::as_ptr),
        flags: bvh.header.flags,
    }
}
