//! OBJ and PLY files that nobody meant to be read: whatever stands in them, the readers end soon, and what they give keeps every promise.

use crate::fuzz::mesh::{assert_same, check_mesh, check_obj, check_ply, written};
use embree_trace::geometry::Vec3;
use embree_trace::mesh::{Faces, Material, Mesh, Part, generate, obj, ply};
use embree_trace::progress::Progress;
use proptest::prelude::*;
use std::time::{Duration, Instant};

fn read_anything(bytes: &[u8]) {
    check_obj(bytes);
    check_ply(bytes);
}

/// A small file of every statement.
fn sample_obj() -> Vec<u8> {
    let mut text = b"\xEF\xBB\xBF# \xE9\r\nmtllib a.mtl b.mtl\nusemtl x\n".to_vec();
    obj::write(&generate::quads(3), "c.mtl", &mut text, std::io::sink(), &Progress::hidden()).unwrap();
    text.extend(
        b"g a b\nf 1 2 3 4 5 6 7 8\nf -1 -2 \\\n-3\nl 1 2\nf 1000 1 2\nv 1.#IND .5 1e9\np 1\nf 9 8 7 6 1 2 3",
    );
    text
}

fn sample_ply(format: &str) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat {format} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
         element face 2\nproperty list uchar int vertex_indices\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    )
    .into_bytes();
    if format == "ascii" {
        bytes.extend(b"0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n3 0 1 2\n6 0 1 2 -1 3 2\n");
        return bytes;
    }
    let big = format.contains("big");
    let mut put = |number: [u8; 4]| {
        bytes.extend(if big { [number[3], number[2], number[1], number[0]] } else { number })
    };
    for coordinate in [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0] {
        put(coordinate.to_le_bytes());
    }
    let mut faces = Vec::new();
    for face in [&[0_i32, 1, 2, 3][..], &[0, 1, 2]] {
        faces.push(face.len() as u8);
        faces.extend(face.iter().flat_map(|i| if big { i.to_be_bytes() } else { i.to_le_bytes() }));
    }
    bytes.extend(faces);
    for index in [6_i32, 0, 1, 2, -1, 3, 2] {
        bytes.extend(if big { index.to_be_bytes() } else { index.to_le_bytes() });
    }
    bytes
}

#[test]
fn a_thousand_damaged_files() {
    let started = Instant::now();
    let samples = [
        sample_obj(),
        sample_ply("ascii"),
        sample_ply("binary_little_endian"),
        sample_ply("binary_big_endian"),
    ];
    for sample in &samples[1..] {
        assert!(ply::parse(sample, &Default::default()).unwrap().0.triangle_count() == 4);
    }
    let mut state = 1_u64;
    let mut random = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    for sample in &samples {
        for _ in 0..250 {
            let mut bytes = sample.clone();
            for _ in 0..=random(6) {
                let at = random(bytes.len());
                match random(5) {
                    0 => bytes[at] ^= 1 << random(8),
                    1 => bytes[at] = random(256) as u8,
                    2 => bytes.truncate(at.max(1)),
                    3 => bytes.insert(at, b"0123456789-. \n\\/"[random(16)]),
                    _ => drop(bytes.drain(at..(at + random(20)).min(bytes.len()))),
                }
                if bytes.is_empty() {
                    break;
                }
            }
            read_anything(&bytes);
        }
    }
    assert!(started.elapsed() < Duration::from_secs(60));
}

#[test]
fn files_made_to_take_long() {
    let started = Instant::now();
    let cases = [
        b"f 1 2 3\n".repeat(200_000),
        b"g x\nusemtl y\n".repeat(100_000),
        [
            b"v 0 0 0\nv 1 0 0\nv 0 1 0\n".to_vec(),
            (0..50_000).flat_map(|i| format!("g {i}\nf 1 2 3\n").into_bytes()).collect(),
        ]
        .concat(),
        b"mtllib a b c d\n".repeat(50_000),
        b"\\\n".repeat(500_000),
        b"v \\\n".repeat(200_000),
        b"\r".repeat(1_000_000),
        [b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf ".to_vec(), b"1 2 3 4 ".repeat(50_000)].concat(),
    ];
    for bytes in cases {
        check_mesh(&obj::parse(&bytes, &obj::Options::default(), &mut |_| None).0);
    }
    assert!(started.elapsed() < Duration::from_secs(30), "{:?}", started.elapsed());
}

#[test]
fn a_decompression_bomb_is_read_in_pieces() {
    // 200 MB of one line, from 20 kB.
    let bomb = zstd::encode_all(std::io::Read::take(std::io::repeat(b' '), 200 << 20), 1).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bomb.obj.zst");
    std::fs::write(&path, bomb).unwrap();
    assert!(embree_trace::mesh::read(&path).unwrap_err().to_string().contains("lines above 64 MiB"));
}

fn meshes() -> impl Strategy<Value = Mesh> {
    let vertices = proptest::collection::vec(any::<(f32, f32, f32)>(), 4..30);
    (
        vertices,
        proptest::collection::vec((any::<bool>(), proptest::collection::vec(any::<u32>(), 1..20)), 1..6),
    )
        .prop_map(|(vertices, parts)| {
            let vertices: Vec<Vec3> = vertices.into_iter().map(Vec3::from).collect();
            let parts: Vec<Part> = parts
                .into_iter()
                .enumerate()
                .map(|(number, (quads, numbers))| {
                    let faces = if quads { Faces::Quads } else { Faces::Triangles };
                    let index =
                        |i: usize| numbers[i % numbers.len()].wrapping_add(i as u32) % vertices.len() as u32;
                    let indices = (0..numbers.len() * faces.corners()).map(index).collect();
                    Part { name: format!("part {number}"), material: number as u32, faces, indices }
                })
                .collect();
            let materials = parts
                .iter()
                .map(|part| Material {
                    name: format!("of {}", part.name),
                    emission: Vec3::new(part.material as f32, 0.1, 1e-7),
                    diffuse: Vec3::new(0.3, 1.0, 0.0),
                    specular: if part.material % 2 == 0 { Vec3::ZERO } else { Vec3::splat(0.7) },
                })
                .collect();
            Mesh { vertices, parts, materials }
        })
}

proptest! {
    #[test]
    fn any_bytes(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        read_anything(&bytes);
    }

    #[test]
    fn any_words(words in proptest::collection::vec(
        prop::sample::select(vec!["v", "f", "\n", "\r\n", "\\\n", "1", "-1", "2", "3/1", "0", ".5", "nan", "o", "g", "usemtl", "mtllib", "#", "l", "ply\n", "é"]), 0..200,
    )) {
        read_anything(words.join(" ").as_bytes());
    }

    #[test]
    fn what_is_written_is_read(mesh in meshes()) {
        assert_same(&written(&mesh), &mesh);
    }
}
