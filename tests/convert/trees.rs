//! Trees: those of 2011, arrays, and boxes.

use super::support::Place;
use embree_trace::format::bvh::{self, Bvh, Contents};
use embree_trace::geometry::{Aabb, Triangle, Vec3};
use embree_trace::tree::{Node, Tree};
use std::fs;

/// Words of a file of 2011.
#[derive(Default)]
pub struct Words(pub Vec<u8>);

impl Words {
    pub fn int(mut self, value: i32) -> Words {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn float(mut self, value: f32) -> Words {
        self.0.extend(value.to_le_bytes());
        self
    }

    /// x, y and z ranges.
    fn bounds(self, ranges: [[f32; 2]; 3]) -> Words {
        ranges.into_iter().flatten().fold(self, Words::float)
    }
}

/// Four triangles in the planes z = 0 to 3, of two parts that take turns: in `TRIS`, those at 0 and 2 come first.
const SCENE: &str = "\
o a
v 0 0 0
v 1 0 0
v 0 1 0
f 1 2 3
o b
v 0 0 1
v 1 0 1
v 0 1 1
f 4 5 6
o a
v 0 0 2
v 1 0 2
v 0 1 2
f 7 8 9
o b
v 0 0 3
v 1 0 3
v 0 1 3
f 10 11 12
";

const UNIT: [f32; 2] = [0.0, 1.0];

/// A root over a branch without bounds (leaves of triangles 0 and 1, 2) and a leaf of triangle 3.
pub fn plain() -> Words {
    Words::default()
        .int(267_534)
        .int(201)
        .int(0)
        .bounds([UNIT, UNIT, [0.0, 3.0]])
        .int(2)
        .int(1)
        .bounds([UNIT, UNIT, [0.0, 0.0]])
        .int(1)
        .int(0)
        .int(3)
        .int(2)
        .int(1)
        .int(2)
        .int(1)
        .bounds([UNIT, UNIT, [3.0, 3.0]])
        .int(1)
        .int(3)
        .int(9215)
}

/// A root whose left child is likelier, and below it a branch whose right one is.
fn ordered() -> Words {
    let leaf = |words: Words, triangle: i32| words.int(3).int(1).int(triangle);
    let words = Words::default().int(267_534).int(202).int(2).float(0.75).int(2).float(0.0);
    let words = leaf(leaf(words, 0), 1).int(2).float(0.5);
    leaf(leaf(words, 2), 3).int(9215)
}

fn at(lower: f32, upper: f32) -> Aabb {
    Aabb { lower: Vec3::new(0.0, 0.0, lower), upper: Vec3::new(1.0, 1.0, upper) }
}

#[test]
fn a_tree_of_2011_means_what_its_specification_says() {
    let place = Place::new();
    place.put("scene.obj", SCENE.as_bytes());
    place.put("old.bvh2011", &plain().0);
    let said = place.convert("old.bvh2011 new.bvh --mesh scene.obj");
    assert_eq!((&said["unit"], &said["count"]), (&"nodes".into(), &5.into()));
    assert_eq!((&said["lost"], &said["warnings"]), (&serde_json::json!({}), &serde_json::json!([])));

    let bytes = place.get("new.bvh");
    let bvh = Bvh::parse(&bytes).unwrap();
    // The file's triangles 0, 1, 2, 3 are 0, 2, 1, 3 of TRIS.
    let heights: Vec<f32> = bvh.triangles.iter().map(|triangle| triangle.0[0].z).collect();
    assert_eq!(heights, [0.0, 2.0, 1.0, 3.0]);
    assert_eq!(
        bvh.tree.nodes,
        [
            Node::inner(at(0.0, 3.0), 1, 2),
            Node::inner(at(0.0, 2.0), 3, 2),
            Node::leaf(at(3.0, 3.0), 3, 1),
            Node::leaf(at(0.0, 0.0), 0, 1),
            Node::leaf(at(1.0, 2.0), 1, 2),
        ]
    );
    assert_eq!(bvh.tree.primitives, [0, 2, 1, 3]);
    assert_eq!(
        bvh.geometries.iter().map(|g| (g.first_triangle, g.triangle_count)).collect::<Vec<_>>(),
        [(0, 2), (2, 2)]
    );
    assert!(bvh.order.is_none());
    let verified = place.run(env!("CARGO_BIN_EXE_trace-info"), "new.bvh --verify");
    assert_eq!(verified.code, 0, "{}", verified.error);
}

#[test]
fn probabilities_become_an_order_and_come_back() {
    let place = Place::new();
    place.put("scene.obj", SCENE.as_bytes());
    place.put("old.bvh2011", &ordered().0);
    let said = place.convert("old.bvh2011 new.bvh --mesh scene.obj");
    assert_eq!(said["lost"], serde_json::json!({"probability of a branch other than 0, 0.5 and 1": 1}));
    let bytes = place.get("new.bvh");
    // First child first, last child first, the nearest; leaves have none.
    assert_eq!(Bvh::parse(&bytes).unwrap().order, Some(&[1, 2, 0, 0, 0, 0, 0][..]));

    place.convert("new.bvh once.bvh2011 --mesh scene.obj");
    place.convert("once.bvh2011 again.bvh --mesh scene.obj");
    place.convert("again.bvh twice.bvh2011 --mesh scene.obj");
    assert_eq!(place.get("once.bvh2011"), place.get("twice.bvh2011"));
    let (first, second) = (place.get("new.bvh"), place.get("again.bvh"));
    let (first, second) = (Bvh::parse(&first).unwrap(), Bvh::parse(&second).unwrap());
    assert_eq!((first.tree.nodes, first.order), (second.tree.nodes, second.order));
    // The probability of the root, behind its id.
    assert_eq!(place.get("once.bvh2011")[12..16], 1.0_f32.to_le_bytes());
}

#[test]
fn a_tree_with_all_bounds_comes_back_byte_for_byte() {
    let place = Place::new();
    place.put("scene.obj", SCENE.as_bytes());
    let leaf =
        |words: Words, z: f32, triangle: i32| words.int(1).bounds([UNIT, UNIT, [z, z]]).int(1).int(triangle);
    let words = Words::default().int(267_534).int(201).int(0).bounds([UNIT, UNIT, [0.0, f32::INFINITY]]);
    let words = leaf(words.int(0).bounds([UNIT, UNIT, [0.0, 1.0]]), 0.0, 0);
    let words = leaf(leaf(words, 1.0, 1).int(0).bounds([UNIT, UNIT, [2.0, 3.0]]), 2.0, 2);
    let bytes = leaf(words, 3.0, 3).int(9215).0;
    place.put("old.bin", &bytes);
    place.convert("old.bin new.bvh --mesh scene.obj");
    let said = place.convert("new.bvh again.bvh2011 --mesh scene.obj");
    assert_eq!(place.get("again.bvh2011"), bytes);
    assert_eq!(said["lost"], serde_json::json!({"META": 1}));
}

/// Writes a tree of four children over triangles at z = 0 to 3, which it returns.
fn wide(place: &Place) -> Vec<Triangle> {
    let triangle =
        |z: f32| Triangle([Vec3::new(0.0, 0.0, z), Vec3::new(1.0, 0.0, z), Vec3::new(0.0, 1.0, z)]);
    let triangles: Vec<Triangle> = (0..4).map(|z| triangle(z as f32)).collect();
    let leaf = |index: u32| Node::leaf(at(index as f32, index as f32), index, 1);
    let nodes = vec![Node::inner(at(0.0, 3.0), 1, 4), leaf(0), leaf(1), leaf(2), leaf(3)];
    let tree = Tree { nodes, primitives: vec![0, 1, 2, 3] };
    let contents = Contents {
        tree: tree.view(),
        triangles: &triangles,
        geometries: &[],
        order: None,
        meta: None,
        flags: 0,
        producer: "test",
    };
    bvh::write(fs::File::create(place.path("wide.bvh")).unwrap(), &contents).unwrap();
    triangles
}

#[test]
fn a_wide_tree_is_made_binary_and_says_so() {
    let place = Place::new();
    let triangles = wide(&place);
    let said = place.convert("wide.bvh old.bvh2011");
    assert!(said["warnings"][0].as_str().unwrap().contains("5 nodes became 7"), "{said}");
    assert_eq!(said["lost"], serde_json::json!({"triangle: only its number in TRIS is written": 4}));
    // The triangles as an OBJ are the scene that the numbers are of.
    place.convert("wide.bvh scene.obj --part triangles");
    let said = place.convert("old.bvh2011 back.bvh --mesh scene.obj");
    assert_eq!(said["warnings"], serde_json::json!([]));
    let bytes = place.get("back.bvh");
    let bvh = Bvh::parse(&bytes).unwrap();
    assert_eq!((bvh.triangles, bvh.statistics.max_children), (&triangles[..], 2));
    let verified = place.run(env!("CARGO_BIN_EXE_trace-info"), "back.bvh --verify");
    assert_eq!(verified.code, 0, "{}", verified.error);
}

#[test]
fn another_scene_is_noticed() {
    let place = Place::new();
    wide(&place);
    place.put("scene.obj", SCENE.as_bytes());
    let line = place.refuse("wide.bvh out.bvh2011 --mesh scene.obj");
    assert!(line.contains("scene.obj: its 4 triangles are not the 4 of the tree"), "{line}");
    place.put("old.bvh2011", &plain().0);
    let line = place.refuse("old.bvh2011 out.bvh");
    assert!(line.contains("a tree of 2011 holds no triangles") && line.contains("--mesh"), "{line}");
    // The same faces elsewhere, and two more.
    let moved = SCENE.replace("0 1\n", "0 9\n") + "f 1 2 4\nf 1 2 5\n";
    place.put("moved.obj", moved.as_bytes());
    let said = place.convert("old.bvh2011 out.bvh --mesh moved.obj");
    let warnings = said["warnings"].to_string();
    assert!(warnings.contains("2 triangles are in no leaf"), "{warnings}");
}

#[test]
fn arrays_of_a_tree_are_numpys() {
    let place = Place::new();
    wide(&place);
    for part in ["nodes", "primitives", "triangles"] {
        place.convert(&format!("wide.bvh {part}.npy --part {part}"));
    }
    let seen = place.python(
        r#"
import numpy as np
nodes, primitives, triangles = (np.load(name + ".npy", mmap_mode="r") for name in ["nodes", "primitives", "triangles"])
print(nodes.shape, nodes["upper"][0].tolist(), (nodes["count"] >> 31).tolist(), nodes["first"].tolist())
print(primitives.tolist(), triangles.shape, triangles[2].tolist())
"#,
    );
    assert_eq!(
        seen,
        "(5,) [1.0, 1.0, 3.0] [0, 1, 1, 1, 1] [1, 0, 1, 2, 3]\n\
         [0, 1, 2, 3] (4, 3, 3) [[0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [0.0, 1.0, 2.0]]"
    );
    let line = place.refuse("wide.bvh boxes.npy --part boxes");
    assert!(line.contains("--part boxes cannot be written as npy"), "{line}");
    let line = place.refuse("wide.bvh out.parquet");
    assert!(line.contains("bvh cannot become parquet"), "{line}");
}

fn load(place: &Place, name: &str) -> Vec<tobj::Model> {
    tobj::load_obj(place.path(name), &tobj::LoadOptions::default()).unwrap().0
}

#[test]
fn boxes_load_elsewhere() {
    let place = Place::new();
    wide(&place);
    let said = place.convert("wide.bvh boxes.obj --level 1.. --boxes faces");
    assert_eq!((&said["unit"], &said["count"]), (&"boxes".into(), &4.into()));
    assert_eq!(said["left_out"], serde_json::json!({"node of another level": 1}));
    let models = load(&place, "boxes.obj");
    assert_eq!((models.len(), models[0].name.as_str()), (1, "level_1"));
    assert_eq!(
        (models[0].mesh.positions.len(), models[0].mesh.face_arities.iter().sum::<u32>()),
        (4 * 8 * 3, 4 * 6 * 4)
    );

    // Faces look outwards: the volume by the divergence theorem is that of the root's box.
    place.convert("wide.bvh root.obj --level 0 --boxes faces");
    let root = &load(&place, "root.obj")[0].mesh;
    let vertex = |index: u32| Vec3::from_slice(&root.positions[3 * index as usize..]);
    let tetrahedron = |a, b, c| vertex(a).dot(vertex(b).cross(vertex(c))) / 6.0;
    let quads = root.indices.chunks_exact(4);
    let volume: f32 = quads.map(|q| tetrahedron(q[0], q[1], q[2]) + tetrahedron(q[0], q[2], q[3])).sum();
    assert_eq!(volume, 3.0);

    // All twelve edges once: 4 of each length.
    place.convert("wide.bvh edges.obj --level 0");
    let edges = &load(&place, "edges.obj")[0].mesh;
    let vertex = |index: u32| Vec3::from_slice(&edges.positions[3 * index as usize..]);
    let mut lengths: Vec<f32> =
        edges.indices.chunks_exact(2).map(|e| vertex(e[0]).distance(vertex(e[1]))).collect();
    lengths.sort_by(f32::total_cmp);
    assert_eq!(lengths, [[1.0; 8].as_slice(), &[3.0; 4]].concat());
}
