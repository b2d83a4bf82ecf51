//! For the crate's own tests: the live tree read from falsified memory, so that every check of its layout is seen to work.

use super::{Arrays, BuiltTree, EmbreeError, Planted, Scene, ffi};

/// Objects of Embree's that the live tree is read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Object {
    Scene = ffi::SHIM_OBJECT_SCENE,
    AccelList = ffi::SHIM_OBJECT_ACCEL_LIST,
    Accel = ffi::SHIM_OBJECT_ACCEL,
    Bvh = ffi::SHIM_OBJECT_BVH,
    Vtable = ffi::SHIM_OBJECT_VTABLE,
    Code = ffi::SHIM_OBJECT_CODE,
    Text = ffi::SHIM_OBJECT_TEXT,
    Node = ffi::SHIM_OBJECT_NODE,
    Leaf = ffi::SHIM_OBJECT_LEAF,
    Vertex = ffi::SHIM_OBJECT_VERTEX,
}

impl Object {
    /// Those that a tree is read from. Vertices are looked at before one is planted.
    pub const ALL: [Object; 9] = [
        Object::Scene,
        Object::AccelList,
        Object::Accel,
        Object::Bvh,
        Object::Vtable,
        Object::Code,
        Object::Text,
        Object::Node,
        Object::Leaf,
    ];
}

/// One lie about the process; memory itself is never written.
#[derive(Clone, Copy, Debug)]
pub enum Fault {
    Version(u32),
    NoImage,
    /// The `nth` read (from 0) of an object sees `bytes` at `offset`.
    Set {
        object: Object,
        nth: u64,
        offset: u32,
        bytes: [u8; 16],
        length: u32,
    },
    /// The same, with the bytes flipped where `bytes` has bits.
    Flip {
        object: Object,
        nth: u64,
        offset: u32,
        bytes: [u8; 16],
        length: u32,
    },
}

/// Nothing false.
const NO_FAULT: ffi::ShimFault = ffi::ShimFault {
    version: 0,
    no_image: 0,
    object: 0,
    slots: 0,
    offset: 0,
    length: 0,
    nth: u64::MAX,
    keep: [0; 16],
    flip: [0; 16],
};

fn shim_fault(fault: Fault) -> ffi::ShimFault {
    match fault {
        Fault::Version(version) => ffi::ShimFault { version, ..NO_FAULT },
        Fault::NoImage => ffi::ShimFault { no_image: 1, ..NO_FAULT },
        Fault::Set { object, nth, offset, bytes, length } => ffi::ShimFault {
            object: object as u32,
            nth,
            offset,
            flip: bytes,
            length: length.min(16),
            ..NO_FAULT
        },
        Fault::Flip { object, nth, offset, bytes, length } => ffi::ShimFault {
            object: object as u32,
            nth,
            offset,
            keep: [0xFF; 16],
            flip: bytes,
            length: length.min(16),
            ..NO_FAULT
        },
    }
}

/// What [`Scene::tree`] gives for the live tree, when the process is as `fault` says.
pub fn live_tree(scene: &Scene, fault: Fault) -> Result<BuiltTree, EmbreeError> {
    scene.live_tree(Some(&shim_fault(fault)))
}

/// The live tree with the children of each node in the order of its slots, which is that of the file where it was planted.
pub fn slots(scene: &Scene) -> Result<BuiltTree, EmbreeError> {
    scene.live_tree(Some(&ffi::ShimFault { slots: 1, ..NO_FAULT }))
}

/// [`Scene::plant`], when the process is as `fault` says.
pub fn plant_in_doubt(scene: &mut Scene, arrays: &Arrays, fault: Fault) -> Result<Planted, EmbreeError> {
    scene.plant_with(arrays, Some(&shim_fault(fault)))
}
