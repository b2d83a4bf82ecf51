//! For the crate's own tests: the live tree read from falsified memory, so that every check of its layout is seen to work.

use super::{BuiltTree, EmbreeError, Scene, ffi};

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
}

impl Object {
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

/// What [`Scene::tree`] gives for the live tree, when the process is as `fault` says.
pub fn live_tree(scene: &Scene, fault: Fault) -> Result<BuiltTree, EmbreeError> {
    let none = ffi::ShimFault {
        version: 0,
        no_image: 0,
        object: 0,
        offset: 0,
        nth: u64::MAX,
        length: 0,
        keep: [0; 16],
        flip: [0; 16],
    };
    let fault = match fault {
        Fault::Version(version) => ffi::ShimFault { version, ..none },
        Fault::NoImage => ffi::ShimFault { no_image: 1, ..none },
        Fault::Set { object, nth, offset, bytes, length } => {
            ffi::ShimFault { object: object as u32, nth, offset, flip: bytes, length: length.min(16), ..none }
        }
        Fault::Flip { object, nth, offset, bytes, length } => ffi::ShimFault {
            object: object as u32,
            nth,
            offset,
            keep: [0xFF; 16],
            flip: bytes,
            length: length.min(16),
            ..none
        },
    };
    scene.live_tree(Some(&fault))
}
