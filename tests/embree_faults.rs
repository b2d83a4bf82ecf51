//! The live tree's checks, one by one: falsified memory gives a warning that names the check, and the builder's tree.
#![cfg(feature = "embree")]

mod embree_support;

use embree_support::*;
use embree_trace::embree::testing::{Fault, Object, live_tree};
use embree_trace::embree::{Isa, Quality, Scene, Settings, TreeSource};
use embree_trace::mesh::Faces;

/// BVH4<triangle4>, which every CPU can build: the offsets below are those of its nodes.
fn scene(count: usize) -> Scene {
    let settings = Settings { isa: Some(Isa::Sse42), threads: 1, ..Settings::default() };
    Scene::new(&soup(Faces::Triangles, count, 0.2, 1), &settings).unwrap()
}

fn set(object: Object, nth: u64, offset: u32, value: &[u8]) -> Fault {
    let mut bytes = [0; 16];
    bytes[..value.len()].copy_from_slice(value);
    Fault::Set { object, nth, offset, bytes, length: value.len() as u32 }
}

fn flip(object: Object, nth: u64, offset: u32, value: &[u8]) -> Fault {
    let mut bytes = [0; 16];
    bytes[..value.len()].copy_from_slice(value);
    Fault::Flip { object, nth, offset, bytes, length: value.len() as u32 }
}

#[test]
fn each_check_is_seen_to_fail() {
    let scene = scene(300);
    let builder = scene.tree(TreeSource::Builder).unwrap();
    let wild = |value: u64| value.to_le_bytes();
    let float = |value: f32| value.to_le_bytes();
    let cases: Vec<(Fault, &str)> = vec![
        (Fault::Version(31304), "Embree's version is 31304, and the layout is known of 31305 only"),
        (Fault::Version(40000), "version is 40000"),
        (Fault::NoImage, "the image of libembree3 is not found"),
        (set(Object::Scene, 0, 0, &wild(0)), "the vtable of the scene is not in libembree3"),
        (set(Object::Scene, 0, 16, &float(-77.0)), "bounds differ from those of rtcGetSceneLinearBounds"),
        (
            set(Object::Scene, 0, 32 + 32 + 4, &float(77.0)),
            "bounds differ from those of rtcGetSceneLinearBounds",
        ),
        (set(Object::Scene, 0, 16, &float(f32::NAN)), "bounds differ from those of rtcGetSceneLinearBounds"),
        (set(Object::Scene, 1, 0, &wild(u64::MAX)), "list of acceleration structures is not a list"),
        (set(Object::Scene, 1, 8, &wild(u64::MAX)), "list of acceleration structures is not a list"),
        (flip(Object::Scene, 1, 0, &[4]), "list of acceleration structures is not a list"),
        (set(Object::AccelList, 0, 0, &wild(0x10)), "pointer to an acceleration structure leads outside"),
        (
            set(Object::AccelList, 0, 0, &wild(u64::MAX - 8)),
            "pointer to an acceleration structure leads outside",
        ),
        (
            set(Object::Accel, 0, 0, &wild(0x1000)),
            "the vtable of an acceleration structure is not in libembree3",
        ),
        (set(Object::Accel, 0, 80, &[4, 0, 0, 0]), "an acceleration structure of the scene has type 4"),
        (set(Object::Accel, 0, 88, &wild(0)), "pointer to a BVH leads outside"),
        (set(Object::Accel, 0, 144, &wild(0x1000)), "a name is not in libembree3"),
        (set(Object::Text, 10, 0, b"x"), "the kernel's name is unknown"),
        (set(Object::Bvh, 0, 0, &wild(0x1000)), "the vtable of a BVH is not in libembree3"),
        (set(Object::Bvh, 0, 16, &float(-77.0)), "the BVHs' bounds differ from the scene's"),
        (set(Object::Bvh, 0, 16, &float(77.0)), "a BVH's bounds are inverted"),
        (set(Object::Bvh, 0, 80, &[9, 0, 0, 0]), "a BVH has the unknown type 9"),
        (set(Object::Bvh, 0, 80, &[4, 0, 0, 0]), "the kernel's name is unknown"),
        (set(Object::Bvh, 0, 88, &wild(8)), "pointer to a vtable leads outside"),
        (flip(Object::Bvh, 0, 96, &[8]), "a BVH does not point back to its device"),
        (flip(Object::Bvh, 0, 104, &[8]), "a BVH does not point back to its scene"),
        (set(Object::Bvh, 0, 112, &wild(0x20)), "pointer to a node leads outside"),
        (set(Object::Bvh, 0, 112, &wild(0x29)), "pointer to a leaf leads outside"),
        (set(Object::Bvh, 0, 112, &wild(8)), "the BVHs' bounds differ from the scene's|the leaves hold 0"),
        (flip(Object::Bvh, 0, 112, &[1]), "a node has the unknown tag 1"),
        (flip(Object::Bvh, 0, 112, &[2]), "a node has the unknown tag 2"),
        (flip(Object::Bvh, 0, 112, &[7]), "a node has the unknown tag 7"),
        (set(Object::Vtable, 0, 0, &wild(0x1000)), "the vtable of a primitive type is not in libembree3"),
        (set(Object::Vtable, 1, 0, &wild(0x1000)), "a primitive type's function is not in libembree3"),
        (set(Object::Code, 0, 7, &[0x90]), "a primitive type's function does not return a name"),
        (set(Object::Code, 0, 0, &[0xE9]), "a primitive type's function does not return a name"),
        (set(Object::Code, 0, 3, &0x7FFF_0000i32.to_le_bytes()), "a name is not in libembree3"),
        (set(Object::Text, 0, 0, b"T"), "the primitive type is unknown: Triangle4|triangle4"),
        (flip(Object::Node, 0, 0, &[3]), "a node has the unknown tag 3"),
        (set(Object::Node, 0, 8, &wild(0x4000_0000_0000_0000)), "pointer to a node leads outside"),
        (set(Object::Node, 0, 32, &float(-1e30)), "a node's box is not inside its parent's"),
        (set(Object::Node, 1, 32 + 16, &float(1e30)), "a node's box is not inside its parent's"),
        (set(Object::Node, 0, 32, &float(1e30)), "a node's box is inverted"),
        (set(Object::Node, 0, 32, &float(f32::NAN)), "a node's box is inverted"),
        (set(Object::Leaf, 0, 144, &[7, 0, 0, 0]), "a leaf names a geometry that does not exist"),
        (set(Object::Leaf, 0, 160, &[0, 0, 1, 0]), "a leaf names a primitive that does not exist"),
        (
            set(Object::Leaf, 0, 160, &[0xFF; 4]),
            "a leaf is empty|the leaves hold 299 primitives, and 300 were",
        ),
        (
            set(Object::Leaf, 0, 160, &[0; 4]),
            "a leaf's box does not contain its primitives|stands in two leaves",
        ),
    ];
    for (fault, expected) in cases {
        let built = live_tree(&scene, fault).unwrap();
        let warning = built.warning.unwrap_or_else(|| panic!("{fault:?} was not noticed"));
        let named = expected.split('|').any(|expected| warning.contains(expected));
        assert!(named, "{fault:?}: {warning:?} should say {expected:?}");
        assert!(warning.starts_with("Embree's live tree cannot be read (") && !warning.contains('\n'));
        assert_eq!(
            (built.tree, built.producer, built.flags),
            (builder.tree.clone(), builder.producer.clone(), 8)
        );
    }
}

#[test]
fn a_wrong_path_through_the_tree_ends_at_a_check() {
    // Boxes do not tell children apart here, so only counts and depth can.
    let mut mesh = soup(Faces::Triangles, 1, 0.2, 1);
    let indices = mesh.parts[0].indices.repeat(300);
    mesh.parts[0].indices = indices;
    let settings = Settings { isa: Some(Isa::Sse42), threads: 1, ..Settings::default() };
    let scene = Scene::new(&mesh, &settings).unwrap();
    let own = live_tree(&scene, flip(Object::Node, 0, 0, &[0])).unwrap();
    assert_eq!((own.flags, own.warning), (4, None), "a fault that changes nothing is none");
    // Each in turn of the first nodes gets another address near its child's: often that of a sibling or of a node above.
    let mut noticed = 0;
    for (nth, bit) in (0..20).flat_map(|nth| (6..14).map(move |bit| (nth, bit))) {
        let flipped = (1u16 << bit).to_le_bytes();
        let built = live_tree(&scene, flip(Object::Node, nth, 0, &flipped)).unwrap();
        noticed += usize::from(built.warning.is_some());
        assert!(built.flags == 8 || built.tree == own.tree, "another tree was believed");
    }
    assert!(noticed > 50, "{noticed}");
}

#[test]
fn no_wrong_byte_anywhere_leads_to_a_crash_or_a_wrong_tree() {
    let settings = [
        Settings { isa: Some(Isa::Sse42), ..Settings::default() },
        Settings { quality: Quality::High, ..Settings::default() },
        Settings { isa: Some(Isa::Sse42), tri_accel: Some("qbvh4.triangle4i".into()), ..Settings::default() },
    ];
    let random = &mut Random(42);
    let (mut noticed, mut harmless) = (0, 0);
    for settings in settings {
        let mut mesh = soup(Faces::Triangles, 120, 0.3, 1);
        add_soup(&mut mesh, Faces::Quads, 60, 0.3, &mut Random(5));
        let scene = Scene::new(&mesh, &settings).unwrap();
        let truth = scene.tree(TreeSource::Live).unwrap();
        for _ in 0..6000 {
            let object = Object::ALL[random.below(Object::ALL.len())];
            let bits = random.bits().to_le_bytes();
            let mut bytes = [0; 16];
            bytes[..8].copy_from_slice(&bits);
            let length = 1 + random.below(8) as u32;
            let reach = [3, 60][random.below(2)];
            let nth = random.below(reach) as u64;
            // About the size of each object, so that most faults meet something.
            let size = [88, 16, 152, 120, 8, 8, 1, 200, 176][object as usize];
            let offset = random.below(size) as u32;
            let fault = match random.below(3) {
                0 => Fault::Set { object, nth, offset, bytes, length },
                1 => Fault::Flip { object, nth, offset, bytes, length },
                _ => Fault::Flip { object, nth, offset, bytes: [1 << random.below(8); 16], length: 1 },
            };
            let built = live_tree(&scene, fault).unwrap();
            match built.warning {
                Some(_) => noticed += 1,
                None => {
                    // What no check can notice leaves a tree that is valid, and holds the same triangles.
                    harmless += 1;
                    let sorted = |primitives: &[u32]| {
                        let mut sorted = primitives.to_vec();
                        sorted.sort();
                        sorted.dedup();
                        sorted
                    };
                    assert_eq!(sorted(&built.tree.primitives), sorted(&truth.tree.primitives));
                    for node in built.tree.nodes.iter().filter(|node| !node.is_leaf()) {
                        for child in node.range() {
                            assert!(node.bounds().contains(&built.tree.nodes[child].bounds()));
                        }
                    }
                }
            }
        }
    }
    assert!(noticed > 2000 && harmless > 2000, "{noticed} {harmless}");
}
