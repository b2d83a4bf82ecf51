//! PLY files of every encoding, and headers that promise too much.

use crate::indices;
use embree_trace::geometry::Vec3;
use embree_trace::mesh::{Kind, Mesh, Warnings, ply};

fn read(bytes: &[u8]) -> Result<(Mesh, Warnings), ply::PlyError> {
    ply::parse(bytes, &Default::default())
}

const ASCII: &str = "ply\nformat ascii 1.0\ncomment made by hand\nobj_info x\nelement vertex 4\nproperty uchar red\n\
    property double z\nproperty float x\nproperty list uchar int extra\nproperty float y\nelement edge 1\nproperty int a\n\
    element face 3\nproperty list uchar int vertex_indices\nproperty float quality\nend_header\n\
    255 0.5 0 0 0\n1 0.5 1 2 7 7 0\n1 0.5 1 0 1\n1 .5 0 0 1\n9\n4 0 1 2 3 1.5\n3 0 1 2 0\n2 0 1 0\n";

#[test]
fn ascii_with_properties_in_any_order() {
    for text in [
        ASCII.to_owned(),
        ASCII.replace('\n', "\r\n"),
        ASCII.trim_end().to_owned(),
        ASCII.replace("vertex_indices", "vertex_index"),
    ] {
        let (mesh, warnings) = read(text.as_bytes()).unwrap();
        assert_eq!(mesh.vertices[2], Vec3::new(1.0, 1.0, 0.5));
        assert_eq!(indices(&mesh), [0, 1, 2, 0, 2, 3, 0, 1, 2]);
        assert_eq!(
            (warnings.count(Kind::TooFewCorners), warnings.first_line(Kind::TooFewCorners)),
            (1, Some(24))
        );
    }
}

/// One triangle and one strip as a binary file, with `i16` list lengths, faces first, and an element of no use between.
fn binary(big: bool) -> Vec<u8> {
    let order = if big { "big" } else { "little" };
    let mut bytes = format!(
        "ply\nformat binary_{order}_endian 1.0\nelement face 1\nproperty uchar flag\nproperty list short uint vertex_index\n\
         element nothing 1000000000000\nelement vertex 4\nproperty float x\nproperty float y\nproperty double z\n\
         element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    )
    .into_bytes();
    let mut put = |little: &[u8]| {
        let mut number = little.to_vec();
        if big {
            number.reverse();
        }
        bytes.extend(number);
    };
    put(&[7]);
    put(&3_i16.to_le_bytes());
    for index in [0_u32, 1, 2] {
        put(&index.to_le_bytes());
    }
    for (x, y, z) in [(0.0_f32, 0.0_f32, 0.25_f64), (1.0, 0.0, 0.25), (0.0, 1.0, 0.25), (1.0, 1.0, 0.25)] {
        put(&x.to_le_bytes());
        put(&y.to_le_bytes());
        put(&z.to_le_bytes());
    }
    put(&9_i32.to_le_bytes());
    for index in [0, 1, 2, 3, -1, 3, 2, 1, 9] {
        put(&i32::to_le_bytes(index));
    }
    bytes
}

#[test]
fn binary_of_both_orders_with_strips_and_faces_first() {
    for big in [false, true] {
        let (mesh, warnings) = read(&binary(big)).unwrap();
        assert_eq!(mesh.vertices[3], Vec3::new(1.0, 1.0, 0.25));
        assert_eq!(indices(&mesh), [0, 1, 2, 0, 1, 2, 2, 1, 3, 3, 2, 1]);
        assert_eq!(warnings.to_string(), "1 faces skipped: no such vertex (first at tristrips 1)");
    }
}

#[test]
fn a_file_cut_anywhere_is_an_error_that_names_the_place() {
    for big in [false, true] {
        let whole = binary(big);
        for length in 0..whole.len() {
            let error = read(&whole[..length]).unwrap_err().to_string();
            assert!(error.contains("offset") || error.contains("header"), "{error}");
        }
    }
    // The last character of an ascii file may go unnoticed; anything before it not.
    for length in 0..ASCII.len() - 2 {
        assert!(read(&ASCII.as_bytes()[..length]).is_err(), "{length}");
    }
}

#[test]
fn a_header_cannot_ask_for_memory_or_time() {
    let message = |text: &str| read(text.as_bytes()).unwrap_err().to_string();
    let vertex = "property float x\nproperty float y\nproperty float z\n";
    let header =
        |count: &str| format!("ply\nformat ascii 1.0\nelement vertex {count}\n{vertex}end_header\n1 2 3\n");
    assert!(message(&header("4000000000")).contains("only 6 bytes follow"));
    assert!(message(&header("18446744073709551615")).contains("32-bit"));
    assert!(message(&header("-1")).contains("the count is no number"));
    let list = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex 0\n{vertex}element face 1\nproperty list uint uint vertex_indices\nend_header\n"
    );
    assert!(read(&[list.as_bytes(), &[0xFF; 4]].concat()).unwrap_err().to_string().contains("offset"));
    assert!(message("ply\nformat ascii 2.0\nfoo\nend_header\n").contains("line 3"));
    assert!(message("ply\nelement vertex 0\nend_header\n").contains("format"));
    assert!(
        message("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n")
            .contains("x and y")
    );
    assert!(message("ply\nformat ascii 1.0\nelement face 0\nend_header\n").contains("no vertex"));
    assert!(message(&HEADER.replace("vertex_indices", "corners")).contains("no list `vertex_indices`"));
    let word = message(&header("1").replace("1 2 3", "1 b 3"));
    assert!(word.contains("line 8") && word.contains("found `b`"), "{word}");
}

#[test]
fn indices_of_odd_types() {
    let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 3\n\
        property list float float vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 nan\n3.0 0.0 1 2.0\n3 0 1 -1\n3 0 1 3\n";
    let (mesh, warnings) = read(text.as_bytes()).unwrap();
    assert_eq!(indices(&mesh), [0, 1, 2]);
    assert_eq!((warnings.count(Kind::IndexOutOfRange), warnings.count(Kind::NonFiniteCoordinate)), (2, 1));
    assert!(read(text.replace("3.0 0.0", "3.5 0.0").as_bytes()).is_err());
}

const HEADER: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
    element face 1\nproperty list uchar int vertex_indices\nend_header\n";

/// An ascii file of three vertices and a face; its header has nine lines.
pub fn ascii(body: &str) -> Vec<u8> {
    format!("{HEADER}{body}").into_bytes()
}

/// That of a triangle in a binary file, where the first coordinate's first byte is `first`.
fn triangle(header: &str, first: u8) -> Vec<u8> {
    let mut bytes = header.replace("ascii", "binary_little_endian").into_bytes();
    for coordinate in [f32::from_bits(0x3F80_0000 | u32::from(first)), 0.0, 0.5, 2.0, 0.0, 0.5, 0.0, 1.0, 0.5]
    {
        bytes.extend(coordinate.to_le_bytes());
    }
    bytes.push(3);
    bytes.extend([0_i32, 1, 2].into_iter().flat_map(i32::to_le_bytes));
    bytes
}

const BODY: &str = "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";

#[test]
fn headers_of_every_kind() {
    let odd = [
        HEADER.to_owned(),
        HEADER.replace("ply\n", "ply \t\n"),
        HEADER.replace('\n', " \n"),
        HEADER.replace(' ', "\t"),
        HEADER.to_ascii_uppercase(),
        HEADER.replace("format", "comment # a\n\nformat").replace("element face", "obj_info b\nelement face"),
        format!("\u{FEFF}{HEADER}"),
    ];
    for header in &odd {
        for end in ["\n", "\r\n", "\r", "\n\r"] {
            let ends = |text: &str| text.replace('\n', end);
            let (mesh, warnings) = read(ends(&format!("{header}{BODY}")).as_bytes()).unwrap();
            assert_eq!(
                (indices(&mesh), mesh.vertices[1], warnings.is_empty()),
                (vec![0, 1, 2], Vec3::X, true)
            );
            assert!(ply::is_ply(ends(header).as_bytes()));
            if header.chars().any(|c| c.is_ascii_lowercase()) {
                // A body may start with what could be the second half of a line's end.
                for first in [0, 1, b'\n', b'\r', b' '] {
                    let (mesh, _) = read(&triangle(&ends(header), first)).unwrap();
                    assert_eq!(mesh.vertices[0].x.to_bits(), 0x3F80_0000 | u32::from(first), "{end:?}");
                    assert_eq!((indices(&mesh), mesh.vertices[2]), (vec![0, 1, 2], Vec3::new(0.0, 1.0, 0.5)));
                }
            }
        }
    }
    for text in ["pl", "ply", "plyx\n", "ply 1\n", "# ply\n", "\u{FEFF}", ""] {
        assert!(!ply::is_ply(text.as_bytes()), "{text}");
    }
}

#[test]
fn in_ascii_a_line_is_an_element() {
    for body in [
        "0 0 0 255 9\n1 0 0 1\n0 1 0\n3 0 1 2 255 255 255\n",
        "\n0 0 0\n\n \t\n1 0 0\ncomment 5\n0 1 0\nobj_info\n\n3 0 1 2",
        "  0\t0 0 # a\n1 0 0\n0 1 0\n\t3 0 1 2 \n3 2 1 0\n",
    ] {
        let (mesh, warnings) = read(&ascii(body)).unwrap();
        assert_eq!(mesh.vertices, [Vec3::ZERO, Vec3::X, Vec3::Y], "{body}");
        assert_eq!((indices(&mesh), warnings.is_empty()), (vec![0, 1, 2], true), "{body}");
    }
    let message = |body: &str| read(&ascii(body)).unwrap_err().to_string();
    let short = "the line ends inside";
    assert_eq!(
        message("0 0 0\n1 0\n0\n0 1 0\n3 0 1 2\n"),
        "line 11: the line ends inside `vertex` 1; in an ascii PLY each line holds one whole element"
    );
    assert!(message("0 0 0\n1 0 0\n0 1 0\n3 0 1\n2\n").starts_with(&format!("line 13: {short} `face` 0")));
    assert!(message("0 0 0\n1 0 0\n0 1 0\n3\n0 1 2\n").starts_with(&format!("line 13: {short} `face` 0")));
    for too_few in ["0 0 0 1 0 0\n0 1 0\n3 0 1 2\n", "0 0 0\n1 0 0\n0 1 0\n"] {
        assert!(message(too_few).ends_with("only 0 bytes follow: the file is cut off"), "{too_few}");
    }
    let cut = message("0 0 0\n1 0 0\n0 1 0\n  3 0 1");
    assert_eq!(cut, "line 13: the file ends inside `face` 0 of 1");
}

#[test]
fn warnings_name_the_line_or_the_element() {
    let (_, warnings) = read(&ascii("0 0 0\n\n1 0 0\nnan 1 0\n3 0 1 3\n")).unwrap();
    let place = "(first at line";
    assert_eq!(
        warnings.to_string(),
        format!(
            "1 vertices with a NaN or infinite coordinate {place} 13)\n1 faces skipped: no such vertex {place} 14)"
        )
    );
    let mut bytes = triangle(HEADER, 0);
    let body = bytes.len() - 13 - 36;
    bytes[body + 12..body + 16].copy_from_slice(&f32::NAN.to_le_bytes());
    let (_, warnings) = read(&bytes).unwrap();
    assert_eq!(warnings.to_string(), "1 vertices with a NaN or infinite coordinate (first at vertex 2)");
}

#[test]
fn two_coordinates_are_in_the_plane() {
    let text = HEADER.replace("property float z\n", "") + "0 0\n1 0\n0 1\n3 0 1 2\n";
    let (mesh, warnings) = read(text.as_bytes()).unwrap();
    assert_eq!((mesh.vertices, warnings.is_empty()), (vec![Vec3::ZERO, Vec3::X, Vec3::Y], true));
}
