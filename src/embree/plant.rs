//! Planting: the tree of a `.bvh` in a live scene, so that Embree's own kernels traverse it.
//!
//! A [`Bvh`], of which every index has been checked, goes as borrowed arrays into the shim. That
//! checks the scene's memory, the file and the two together, and changes nothing when there is any
//! doubt (`embree-shim/plant.hpp`).

use super::{EmbreeError, Scene, ffi};
use crate::format::bvh::{Bvh, Geometry};
use crate::format::checksum;
use crate::geometry::Triangle;
use crate::tree::TreeView;

/// What is planted: what a `.bvh` holds, or what was made of that. Nothing in it is believed.
#[derive(Clone, Copy, Debug)]
pub struct Arrays<'a> {
    pub tree: TreeView<'a>,
    pub triangles: &'a [Triangle],
    pub geometries: &'a [Geometry],
    /// As in `ORDR`.
    pub order: Option<&'a [u8]>,
    /// As in the header.
    pub flags: u32,
}

impl<'a> From<&'a Bvh<'_>> for Arrays<'a> {
    fn from(bvh: &'a Bvh<'_>) -> Arrays<'a> {
        let Bvh { tree, triangles, geometries, order, .. } = *bvh;
        Arrays { tree, triangles, geometries, order, flags: bvh.header.flags }
    }
}

impl Arrays<'_> {
    /// As the shim wants them. An order that does not have one byte for each node is none.
    pub(super) fn file(&self) -> ffi::ShimTreeFile {
        let TreeView { nodes, primitives } = self.tree;
        let order = self.order.filter(|order| order.len() == nodes.len());
        ffi::ShimTreeFile {
            nodes: nodes.as_ptr().cast(),
            node_count: nodes.len() as u64,
            primitives: primitives.as_ptr(),
            primitive_count: primitives.len() as u64,
            triangles: self.triangles.as_ptr().cast(),
            triangle_count: self.triangles.len() as u64,
            geometries: self.geometries.as_ptr().cast(),
            geometry_count: self.geometries.len() as u64,
            order: order.map_or(std::ptr::null(), <[u8]>::as_ptr),
            flags: self.flags,
        }
    }
}

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
    pub(super) fn new(planted: &ffi::ShimPlanted) -> Planted {
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
pub(super) struct Origin {
    /// Of the nodes: a tree with others has another order.
    nodes: u64,
    order: Option<Vec<u8>>,
}

impl Origin {
    fn of(arrays: &Arrays) -> Origin {
        let order = arrays.order.map(<[u8]>::to_vec);
        let nodes = order.as_ref().map_or(0, |_| checksum(bytemuck::cast_slice(arrays.tree.nodes)));
        Origin { nodes, order }
    }

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
    pub fn plant<'a>(&mut self, file: impl Into<Arrays<'a>>) -> Result<Planted, EmbreeError> {
        self.plant_with(&file.into(), None)
    }

    /// Of the planted tree that is traversed.
    pub(super) fn chosen(&self) -> Option<&Origin> {
        self.planted.get((self.chosen as usize).checked_sub(1)?)
    }

    /// `fault` falsifies what is read of the scene, for tests.
    pub(super) fn plant_with(
        &mut self,
        arrays: &Arrays,
        fault: Option<&ffi::ShimFault>,
    ) -> Result<Planted, EmbreeError> {
        let fault = fault.map_or(std::ptr::null(), |fault| fault as *const ffi::ShimFault);
        let mut planted = ffi::ShimPlanted::default();
        let mut error = ffi::no_error();
        // SAFETY: the handle is live and, by `&mut self`, nobody asks it; the arrays are live for
        // the call, of the lengths that stand beside them, and nothing in them is believed;
        // `fault` is null or borrowed for this call.
        let failed = unsafe {
            ffi::shim_scene_plant(self.handle.as_ptr(), &arrays.file(), fault, &mut planted, &mut error)
        };
        if failed == 0 {
            self.planted.push(Origin::of(arrays));
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
