//! `.bvh` against its specification: a file made byte by byte, every bit flipped, every length cut, hostile trees.

use embree_trace::format::bvh::{self, Bvh, Contents, Geometry, NO_INSTANCE, flag};
use embree_trace::format::{FileKind, Problem, checksum};
use embree_trace::geometry::{Aabb, Triangle, Vec3};
use embree_trace::tree::{LEAF_BIT, Node, Tree, TreeView};
use proptest::prelude::*;

/// A section of a forged file: tag, bytes per element, elements, bytes.
type Section = ([u8; 4], u32, u64, Vec<u8>);

/// What a header says, when it should not be what the content is.
#[derive(Clone)]
struct Claims {
    fingerprint: u64,
    bounds: [f32; 6],
    counts: [u32; 4],
}

/// The file of the specification, put together without the library's writer. `table` may change the table before it is hashed.
fn forge(sections: &[Section], claims: &Claims, table: impl Fn(&mut Vec<u8>)) -> Vec<u8> {
    let mut entries = Vec::new();
    let mut end = 128 + 32 * sections.len();
    let mut body = Vec::new();
    for (tag, element_bytes, count, bytes) in sections {
        let offset = end.next_multiple_of(64);
        body.resize(offset - (128 + 32 * sections.len()), 0);
        body.extend_from_slice(bytes);
        end = offset + bytes.len();
        entries.extend_from_slice(tag);
        entries.extend(element_bytes.to_le_bytes());
        entries.extend((offset as u64).to_le_bytes());
        entries.extend(count.to_le_bytes());
        entries.extend(checksum(bytes).to_le_bytes());
    }
    table(&mut entries);

    let mut file = vec![0x89, 0x42, 0x56, 0x48, 0x0D, 0x0A, 0x1A, 0x0A, 1, 0, 0, 0, 128, 0, 0, 0];
    file.extend(claims.fingerprint.to_le_bytes());
    claims.bounds.iter().for_each(|value| file.extend(value.to_le_bytes()));
    claims.counts.iter().for_each(|value| file.extend(value.to_le_bytes()));
    file.extend(b"hand");
    file.resize(112, 0);
    file.extend((sections.len() as u32).to_le_bytes());
    file.extend(0u32.to_le_bytes());
    file.extend(checksum(&entries).to_le_bytes());
    file.extend(entries);
    file.extend(body);
    file
}

/// A root over two leaves of one triangle, in numbers as a table of the specification would have them.
struct Parts {
    nodes: Vec<([f32; 3], u32, [f32; 3], u32)>,
    primitives: Vec<u32>,
    triangles: Vec<[f32; 9]>,
    geometries: Vec<[u32; 8]>,
    order: Option<Vec<u8>>,
    meta: Option<Vec<u8>>,
    counts: [u32; 4],
}

impl Parts {
    fn new() -> Parts {
        Parts {
            nodes: vec![
                ([0.0, 0.0, 0.0], 1, [4.0, 1.0, 0.0], 2),
                ([3.0, 0.0, 0.0], 1, [4.0, 1.0, 0.0], 0x8000_0001),
                ([0.0, 0.0, 0.0], 0, [1.0, 1.0, 0.0], 0x8000_0001),
            ],
            primitives: vec![0, 1],
            triangles: vec![
                [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0],
                [3.0, 0.0, 0.0, 4.0, 0.0, 0.0, 3.0, 1.0, 0.0],
            ],
            geometries: vec![[u32::MAX, 5, 0, 2, 0xFF, 1, 0, 0]],
            order: Some(vec![0, 1, 3]),
            meta: Some(b"{\"alpha\":1}".to_vec()),
            counts: [2, 1, 2, 4],
        }
    }

    fn sections(&self) -> Vec<Section> {
        let mut nodes = Vec::new();
        for (lower, first, upper, count) in &self.nodes {
            lower.iter().for_each(|value| nodes.extend(value.to_le_bytes()));
            nodes.extend(first.to_le_bytes());
            upper.iter().for_each(|value| nodes.extend(value.to_le_bytes()));
            nodes.extend(count.to_le_bytes());
        }
        let primitives: Vec<u8> = self.primitives.iter().flat_map(|value| value.to_le_bytes()).collect();
        let triangles: Vec<u8> =
            self.triangles.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
        let geometries: Vec<u8> =
            self.geometries.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
        let mut sections = vec![
            (*b"NODE", 32, self.nodes.len() as u64, nodes),
            (*b"PRIM", 4, self.primitives.len() as u64, primitives),
            (*b"TRIS", 36, self.triangles.len() as u64, triangles),
            (*b"GEOM", 32, self.geometries.len() as u64, geometries),
        ];
        sections.extend(self.order.iter().map(|order| (*b"ORDR", 1, order.len() as u64, order.clone())));
        sections.extend(self.meta.iter().map(|meta| (*b"META", 1, meta.len() as u64, meta.clone())));
        sections
    }

    fn claims(&self) -> Claims {
        let (lower, _, upper, _) = self.nodes.first().copied().unwrap_or_default();
        let bounds = [lower[0], lower[1], lower[2], upper[0], upper[1], upper[2]];
        Claims { fingerprint: checksum(&self.sections()[2].3), bounds, counts: self.counts }
    }

    fn file(&self) -> Vec<u8> {
        forge(&self.sections(), &self.claims(), |_| ())
    }

    /// The line that a changed file gets, from `parse` or from `verify`.
    fn error(&self) -> String {
        let file = self.file();
        let verified = Bvh::parse(&file).and_then(|bvh| bvh.verify());
        verified.unwrap_err().to_string()
    }
}

fn changed(change: impl Fn(&mut Parts)) -> Parts {
    let mut parts = Parts::new();
    change(&mut parts);
    parts
}

#[test]
fn a_file_made_by_hand_is_read() {
    let file = Parts::new().file();
    let bvh = Bvh::parse(&file).unwrap();
    assert_eq!(bvh.verify().unwrap(), Default::default());
    let bounds = Aabb { lower: Vec3::ZERO, upper: Vec3::new(4.0, 1.0, 0.0) };
    assert_eq!((bvh.header.bounds, bvh.header.producer.as_str()), (bounds, "hand"));
    let header = &bvh.header;
    assert_eq!((header.max_children, header.max_leaf, header.depth, header.flags), (2, 1, 2, flag::LIVE));
    assert_eq!(header.fingerprint, bvh::fingerprint(bvh.triangles));
    assert_eq!(bvh.tree.nodes[0], Node::inner(bounds, 1, 2));
    assert_eq!((bvh.tree.nodes[1].range(), bvh.tree.nodes[1].is_leaf()), (1..2, true));
    assert_eq!(bvh.tree.primitives, [0, 1]);
    assert_eq!(
        bvh.triangles[1].0,
        [Vec3::new(3.0, 0.0, 0.0), Vec3::new(4.0, 0.0, 0.0), Vec3::new(3.0, 1.0, 0.0)]
    );
    let geometry = bvh.geometries[0];
    assert_eq!(
        (geometry.instance, geometry.geometry, geometry.mask, geometry.kind),
        (NO_INSTANCE, 5, 0xFF, 1)
    );
    assert_eq!((geometry.first_triangle, geometry.triangle_count), (0, 2));
    assert_eq!((bvh.order, bvh.meta), (Some(&[0, 1, 3][..]), Some("{\"alpha\":1}")));
}

#[test]
fn the_writer_makes_the_bytes_of_the_specification() {
    let by_hand = Parts::new().file();
    let bvh = Bvh::parse(&by_hand).unwrap();
    let Bvh { tree, triangles, geometries, order, meta, .. } = bvh;
    let contents = Contents { tree, triangles, geometries, order, meta, flags: flag::LIVE, producer: "hand" };
    let mut bytes = Vec::new();
    assert_eq!(bvh::write(&mut bytes, &contents).unwrap(), bvh.header.fingerprint);
    assert_eq!(bytes, by_hand);
}

#[test]
fn an_empty_scene_is_an_empty_root() {
    let tree = Tree { nodes: vec![Node::leaf(Aabb::EMPTY, 0, 0)], primitives: Vec::new() };
    let contents = Contents {
        tree: tree.view(),
        triangles: &[],
        geometries: &[],
        order: None,
        meta: None,
        flags: 0,
        producer: "none",
    };
    let mut bytes = Vec::new();
    bvh::write(&mut bytes, &contents).unwrap();
    let bvh = Bvh::parse(&bytes).unwrap();
    bvh.verify().unwrap();
    assert!(bvh.header.bounds.is_empty() && bvh.triangles.is_empty());
    assert_eq!((bvh.header.depth, bvh.header.max_leaf), (1, 0));
}

#[test]
fn every_flipped_bit_is_found_or_harmless() {
    let right = Parts::new().file();
    let table_end = 128 + 6 * 32;
    let sections: Vec<_> = Bvh::parse(&right).unwrap().sections;
    let in_section = |byte: u64| {
        sections.iter().any(|section| (section.offset..section.offset + section.bytes()).contains(&byte))
    };
    for bit in 0..right.len() * 8 {
        let mut flipped = right.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        let byte = bit / 8;
        let accepted = Bvh::parse(&flipped).is_ok();
        // The minor version, the flags, the producer and the reserved word describe, or are ignored; so is what pads.
        let describes = matches!(byte, 10..12 | 60..112 | 116..120);
        // The sign of a zero in the bounds makes no other box.
        let zero_sign = bit % 32 == 31 && (24..48).contains(&byte) && right[byte - 3..=byte] == [0; 4];
        let harmless = describes || zero_sign || byte >= table_end && !in_section(byte as u64);
        assert_eq!(accepted, harmless, "bit {} of byte {byte}", bit % 8);
    }
}

#[test]
fn every_length_is_refused() {
    let file = Parts::new().file();
    for length in 0..file.len() {
        let error = Bvh::parse(&file[..length]).unwrap_err();
        assert!(error.offset <= file.len() as u64);
    }
}

/// A part of the line that a change of [`Parts::new`] gets, and the change.
type Case = (&'static str, &'static dyn Fn(&mut Parts));

#[test]
fn hostile_trees_are_refused() {
    let cases: [Case; 26] = [
        ("NODE 0: number of elements: found 0", &|p| p.nodes.clear()),
        ("NODE 0: first child of a node: found 0", &|p| p.nodes[0].1 = 0),
        ("NODE 1: first child of a node: found 0", &|p| p.nodes[1] = ([0.0; 3], 0, [1.0; 3], 1)),
        ("NODE 1: first child of a node: found 1", &|p| p.nodes[1] = ([0.0; 3], 1, [1.0; 3], 1)),
        ("NODE 1: children of a node: found 2 to 3, expected nodes of no other parent", &|p| {
            p.nodes[1] = ([0.0; 3], 2, [1.0; 3], 1);
        }),
        ("NODE 0: children of a node: found 1 to 4, expected within the 3 nodes", &|p| p.nodes[0].3 = 3),
        ("NODE 0: children of a node: found 1 to 2147483648", &|p| p.nodes[0].3 = LEAF_BIT - 1),
        ("NODE 0: children of a node: found 4294967295 to 4294967297", &|p| p.nodes[0].1 = u32::MAX),
        ("NODE 0: children of an inner node: found 0", &|p| p.nodes[0].3 = 0),
        ("NODE 2: parents of a node: found 0", &|p| p.nodes[0].3 = 1),
        ("NODE 1: box of a node: found NaN", &|p| p.nodes[1].0[1] = f32::NAN),
        ("NODE 1: primitives of a leaf: found 1 to 3", &|p| p.nodes[1].3 = LEAF_BIT | 2),
        ("NODE 1: primitives of a leaf: found 1 to 2147483648", &|p| p.nodes[1].3 = u32::MAX),
        ("NODE 2: primitives of a leaf: found 1 to 2, expected entries of no other leaf", &|p| {
            p.nodes[2].1 = 1
        }),
        ("PRIM 1: leaves of an entry: found 0", &|p| p.nodes[1].3 = LEAF_BIT),
        ("PRIM 1: triangle of an entry: found 2", &|p| p.primitives[1] = 2),
        ("PRIM 0: triangle of an entry: found 4294967295", &|p| p.primitives[0] = u32::MAX),
        ("GEOM 0: triangles of a geometry: found 0 to 4", &|p| p.geometries[0][3] = 4),
        ("GEOM 0: triangles of a geometry: found 4294967295 to", &|p| p.geometries[0][2] = u32::MAX),
        ("GEOM 1: first triangle of a geometry: found 1, expected at least 2", &|p| {
            p.geometries.push([0, 0, 1, 1, 1, 0, 0, 0]);
        }),
        ("GEOM 0: triangles of quads: found 1", &|p| p.geometries[0][3] = 1),
        ("GEOM 0: kind of a geometry: found 2", &|p| p.geometries[0][5] = 2),
        ("ORDR 0: number of elements: found 2", &|p| p.order = Some(vec![0, 0])),
        ("ORDR 2: traversal order: found 4", &|p| p.order = Some(vec![0, 0, 4])),
        ("section META: found bytes that are not UTF-8", &|p| p.meta = Some(vec![b'{', 0xFF])),
        ("largest number of children: found 3, expected 2", &|p| p.counts[0] = 3),
    ];
    for (expected, change) in cases {
        let line = changed(change).error();
        assert!(line.contains(expected) && !line.contains('\n'), "{line}, expected {expected}");
    }
    assert!(
        changed(|p| p.counts[1] = 2).error().starts_with("at byte 52: largest leaf: found 2, expected 1")
    );
    assert!(changed(|p| p.counts[2] = 1).error().starts_with("at byte 56: depth: found 1, expected 2"));
    // The offset is that of the element: node 2 stands 64 bytes behind the first, at 320.
    let shared = changed(|p| p.nodes[2].1 = 1).error();
    assert!(shared.starts_with("at byte 384: "), "{shared}");
}

#[test]
fn header_and_table_must_agree_with_the_content() {
    let parts = Parts::new();
    let (sections, claims) = (parts.sections(), parts.claims());
    let line = |file: Vec<u8>| Bvh::parse(&file).unwrap_err().to_string();
    let other = Claims { fingerprint: 1, ..claims.clone() };
    assert!(line(forge(&sections, &other, |_| ())).starts_with("at byte 16: scene fingerprint"));
    for bounds in [[0.0; 6], [f32::NAN; 6]] {
        assert!(
            line(forge(&sections, &Claims { bounds, ..claims.clone() }, |_| ()))
                .starts_with("at byte 24: bounds")
        );
    }

    // Entry 1 is PRIM, at byte 160: tag, bytes per element at 4, offset at 8, count at 16, checksum at 24.
    let set = |at: usize, bytes: &[u8]| {
        let bytes = bytes.to_vec();
        line(forge(&sections, &claims, move |table| {
            table[32 + at..32 + at + bytes.len()].copy_from_slice(&bytes)
        }))
    };
    let node_offset = 320u64;
    let cases: [(&str, String); 12] = [
        ("at byte 168: offset of section PRIM: found 1,", set(8, &1u64.to_le_bytes())),
        ("at byte 168: offset of section PRIM: found 0,", set(8, &0u64.to_le_bytes())),
        ("at byte 168: offset of section PRIM: found 64,", set(8, &64u64.to_le_bytes())),
        (
            "at byte 176: count of section PRIM: found 2 of 4 bytes from byte 18446744073709551552",
            set(8, &(u64::MAX - 63).to_le_bytes()),
        ),
        ("at byte 176: count of section PRIM: found 18446744073709551615", set(16, &u64::MAX.to_le_bytes())),
        (
            "at byte 176: count of section PRIM: found 4611686018427387905",
            set(16, &((1u64 << 62) + 1).to_le_bytes()),
        ),
        ("at byte 176: count of section PRIM: found 4294967295", set(16, &0xFFFF_FFFFu64.to_le_bytes())),
        ("checksum of the content of section PRIM", set(24, &1u64.to_le_bytes())),
        ("checksum of the content of section PRIM", set(8, &node_offset.to_le_bytes())),
        ("section PRIM: found 8, expected 4", {
            let mut sections = parts.sections();
            (sections[1].1, sections[1].2) = (8, 1);
            line(forge(&sections, &claims, |_| ()))
        }),
        ("found no PRIM", set(0, b"XXXX")),
        ("section NODE: found a second one", set(0, b"NODE")),
    ];
    for (expected, line) in cases {
        assert!(line.contains(expected), "{line}, expected {expected}");
    }
}

#[test]
fn sections_must_not_overlap() {
    // ORDR becomes a view of the first bytes of GEOM, with the checksum of those bytes.
    let parts = changed(|p| p.geometries[0][0] = 0x0101_0101);
    let sections = parts.sections();
    let overlapping = forge(&sections, &parts.claims(), |table| {
        let geometry_offset: [u8; 8] = table[3 * 32 + 8..3 * 32 + 16].try_into().unwrap();
        table[4 * 32 + 8..4 * 32 + 16].copy_from_slice(&geometry_offset);
        table[4 * 32 + 24..5 * 32].copy_from_slice(&checksum(&[1, 1, 1]).to_le_bytes());
    });
    let line = Bvh::parse(&overlapping).unwrap_err().to_string();
    assert!(line.contains("offset of section") && line.contains("expected at least"), "{line}");
}

#[test]
fn a_table_longer_than_the_file_is_refused_at_once() {
    let mut file = Parts::new().file();
    file[112..116].copy_from_slice(&u32::MAX.to_le_bytes());
    let problem = Bvh::parse(&file).unwrap_err().problem;
    assert!(matches!(problem, Problem::Truncated { what: "section table", .. }), "{problem}");
}

#[test]
fn unknown_sections_are_ignored_but_not_unchecked() {
    let parts = Parts::new();
    let mut sections = parts.sections();
    sections.insert(2, (*b"CAMS", 5, 3, vec![7; 15]));
    let file = forge(&sections, &parts.claims(), |_| ());
    let bvh = Bvh::parse(&file).unwrap();
    assert_eq!((bvh.sections.len(), bvh.sections[2].tag), (7, *b"CAMS"));
    let beyond = forge(&sections, &parts.claims(), |table| table[2 * 32 + 16] = 255);
    assert!(Bvh::parse(&beyond).is_err());
}

#[test]
fn other_files_are_told_apart() {
    let swapped = Bvh::parse(b"\x89RAYS\r\n\x1a and more").unwrap_err().problem;
    assert_eq!(swapped, Problem::OtherKind { found: FileKind::Rays, expected: FileKind::Bvh });
    assert_eq!(Bvh::parse(b"").unwrap_err().problem, Problem::Empty { expected: FileKind::Bvh });
    let mut newer = Parts::new().file();
    newer[8] = 2;
    assert_eq!(Bvh::parse(&newer).unwrap_err().problem, Problem::Version { found: 2, supported: 1 });
}

#[test]
fn verify_finds_wrong_boxes_and_leaves() {
    let cases: [Case; 9] = [
        ("NODE 1: box of a node", &|p| p.nodes[1].2[0] = 4.5),
        ("NODE 1: box of a node: found [4.5", &|p| p.nodes[1].0[0] = 4.5),
        ("NODE 2: box of a leaf", &|p| p.nodes[2].2[0] = 0.5),
        ("leaves of triangle 1: found 0, expected 1", &|p| {
            p.triangles.push(p.triangles[0]);
            p.triangles.swap(1, 2);
            p.primitives[1] = 2;
        }),
        ("leaves of triangle 0: found 2, expected 1", &|p| {
            p.primitives = vec![0, 0];
            p.nodes[1] = ([0.0; 3], 1, [1.0, 1.0, 0.0], LEAF_BIT | 1);
        }),
        ("content of a leaf: found triangle 1, which is not finite", &|p| p.triangles[1][0] = f32::INFINITY),
        ("section META: found", &|p| p.meta = Some(b"{alpha}".to_vec())),
        // With spatial splits: a leaf away from its triangle, and leaves that leave a part of it out.
        ("NODE 2: box of a leaf", &|p| {
            p.counts[3] = flag::SPATIAL_SPLITS;
            (p.nodes[2].0[0], p.nodes[2].2[0]) = (2.0, 2.5);
        }),
        ("boxes of the leaves of triangle 0", &|p| {
            p.counts[3] = flag::SPATIAL_SPLITS;
            p.nodes[2].2[0] = 0.5;
        }),
    ];
    for (expected, change) in cases {
        let line = changed(change).error();
        assert!(line.contains(expected), "{line}, expected {expected}");
    }
    let not_finite = changed(|p| {
        p.triangles.push([f32::NAN; 9]);
        p.geometries.push([0, 0, 2, 1, 1, 0, 0, 0]);
    });
    assert_eq!(Bvh::parse(&not_finite.file()).unwrap().verify().unwrap().not_finite, 1);
}

#[test]
fn clipped_leaves_that_cover_their_triangle_are_good() {
    let parts = changed(|p| {
        p.counts = [4, 1, 2, flag::SPATIAL_SPLITS];
        p.nodes[0].3 = 3;
        p.nodes[2].2[0] = 0.5;
        p.nodes.push(([0.5, 0.0, 0.0], 2, [1.0, 1.0, 0.0], LEAF_BIT | 1));
        p.primitives.push(0);
        p.order = None;
    });
    let file = parts.file();
    assert_eq!(Bvh::parse(&file).unwrap().verify().unwrap().duplicates, 1);
    // The same file without the flag is wrong.
    assert!(
        changed(|p| (p.nodes, p.primitives) = (parts.nodes.clone(), parts.primitives.clone())).error().len()
            > 1
    );
}

#[test]
fn the_writer_refuses_what_no_reader_takes() {
    let bad = Tree { nodes: vec![Node::inner(Aabb::EMPTY, 0, 1)], primitives: Vec::new() };
    let contents = Contents {
        tree: bad.view(),
        triangles: &[],
        geometries: &[],
        order: None,
        meta: None,
        flags: 0,
        producer: "",
    };
    let mut bytes = Vec::new();
    let error = bvh::write(&mut bytes, &contents).unwrap_err();
    assert_eq!(error.kind(), std::io::ErrorKind::InvalidInput);
    assert!(bytes.is_empty() && error.to_string().contains("first child of a node"), "{error}");
}

/// A random tree of any width over random triangles: a leaf is split into several until the numbers run out.
fn random_tree(triangles: &[Triangle], splits: &[u8]) -> Tree {
    let bounds = triangles.iter().fold(Aabb::EMPTY, |bounds, triangle| bounds.union(&triangle.bounds()));
    let mut nodes = vec![Node::leaf(bounds, 0, triangles.len() as u32)];
    for &split in splits {
        let index = split as usize % nodes.len();
        let node = nodes[index];
        let parts = 2 + u32::from(split) % 7;
        if !node.is_leaf() || node.len() < parts as usize {
            continue;
        }
        let (first, count) = (node.first, node.len() as u32);
        nodes[index] = Node::inner(node.bounds(), nodes.len() as u32, parts);
        for part in 0..parts {
            let (from, to) = (first + count * part / parts, first + count * (part + 1) / parts);
            nodes.push(Node::leaf(bounds, from, to - from));
        }
    }
    Tree { nodes, primitives: (0..triangles.len() as u32).rev().collect() }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn what_is_written_is_read(
        coordinates in prop::collection::vec(prop::array::uniform9(-1e6f32..1e6), 0..80),
        splits in prop::collection::vec(any::<u8>(), 0..60),
        order in any::<bool>(),
        meta in prop::option::of("[a-z]{0,20}"),
        flags in any::<u32>(),
    ) {
        let vertex = |c: &[f32; 9], at: usize| Vec3::new(c[at], c[at + 1], c[at + 2]);
        let triangles: Vec<Triangle> =
            coordinates.iter().map(|c| Triangle([vertex(c, 0), vertex(c, 3), vertex(c, 6)])).collect();
        let tree = random_tree(&triangles, &splits);
        let order = order.then(|| (0..tree.nodes.len()).map(|index| (index % 4) as u8).collect::<Vec<u8>>());
        let meta = meta.map(|text| format!("{{\"name\":\"{text}\"}}"));
        let count = triangles.len() as u32;
        let geometry = Geometry {
            instance: NO_INSTANCE, geometry: 0, first_triangle: 0, triangle_count: count, mask: 1, kind: 0, flags: 0, instance_mask: 0,
        };
        let contents = Contents {
            tree: tree.view(),
            triangles: &triangles,
            geometries: &[geometry],
            order: order.as_deref(),
            meta: meta.as_deref(),
            flags: flags & !flag::SPATIAL_SPLITS,
            producer: "a producer with a name that is longer than forty-eight bytes",
        };
        let mut bytes = Vec::new();
        let fingerprint = bvh::write(&mut bytes, &contents).unwrap();
        let bvh = Bvh::parse(&bytes).unwrap();
        prop_assert_eq!(bvh.header.fingerprint, fingerprint);
        prop_assert_eq!(&bvh.header.producer, "a producer with a name that is longer than forty");
        let TreeView { nodes, primitives } = bvh.tree;
        prop_assert_eq!((nodes, primitives), (&tree.nodes[..], &tree.primitives[..]));
        prop_assert_eq!(bvh.triangles, &triangles[..]);
        prop_assert_eq!(bvh.geometries, &[geometry][..]);
        prop_assert_eq!((bvh.order, bvh.meta), (order.as_deref(), meta.as_deref()));
        bvh.verify().unwrap();
    }

    /// Any change of the nodes, with checksums to match: accepted or refused, the checks end and nothing panics.
    #[test]
    fn no_tree_makes_a_reader_panic(changes in prop::collection::vec((0..3usize, 0..8usize, any::<u32>()), 1..6)) {
        let parts = Parts::new();
        let mut sections = parts.sections();
        for (node, word, value) in changes {
            let at = node * 32 + word * 4;
            // Small values reach further than random ones.
            let value = if value % 2 == 0 { value % 5 } else { value };
            sections[0].3[at..at + 4].copy_from_slice(&value.to_le_bytes());
        }
        if let Ok(bvh) = Bvh::parse(&forge(&sections, &parts.claims(), |_| ())) {
            let _ = bvh.verify();
        }
    }
}
