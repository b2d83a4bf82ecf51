//! What OBJ files in the wild do, each as the few bytes that show it.

use crate::{indices, read_obj};
use embree_trace::geometry::Vec3;
use embree_trace::mesh::{Faces, Kind, obj};

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

#[track_caller]
fn expect(text: impl AsRef<[u8]>, faces: &[u32], troubles: &[(Kind, u64, u64)]) {
    let (mesh, warnings) = read_obj(text);
    assert_eq!(indices(&mesh), faces);
    for kind in Kind::ALL {
        let expected = troubles.iter().find(|trouble| trouble.0 == kind);
        assert_eq!(warnings.count(kind), expected.map_or(0, |t| t.1), "{kind:?}: {warnings}");
        assert_eq!(warnings.first_line(kind), expected.map(|t| t.2), "{kind:?}");
    }
}

#[test]
fn corners_in_every_form() {
    expect(format!("{SQUARE}f 1 2 3"), &[0, 1, 2], &[]);
    expect(format!("{SQUARE}f 1/1 2/2 3/3"), &[0, 1, 2], &[]);
    expect(format!("{SQUARE}f 1//1 2//1 3//1\nf 1/9/9 2/-9/9 4"), &[0, 1, 2, 0, 1, 3], &[]);
    expect(format!("{SQUARE}f -4 -3 -2\nf -4/-1 -2 -1"), &[0, 1, 2, 0, 2, 3], &[]);
    expect(format!("{SQUARE}  f   1\t2 3   # a comment\nfo 1 2 3"), &[0, 1, 2, 0, 1, 2], &[]);
    expect(format!("{SQUARE}f 1 2 3 4"), &[0, 1, 2, 0, 2, 3], &[]);
}

#[test]
fn a_bad_face_costs_only_itself() {
    let trouble = |face: &str, kind: Kind| {
        expect(format!("{SQUARE}f 1 2 3\n{face}\nf 1 3 4"), &[0, 1, 2, 0, 2, 3], &[(kind, 1, 6)]);
    };
    trouble("f", Kind::TooFewCorners);
    trouble("f 1 2", Kind::TooFewCorners);
    trouble("f # 1 2 3", Kind::TooFewCorners);
    trouble("f 0 1 2", Kind::IndexOutOfRange);
    trouble("f 1 2 5", Kind::IndexOutOfRange);
    trouble("f 1 2 -5", Kind::IndexOutOfRange);
    trouble("f 1 2 3 9", Kind::IndexOutOfRange);
    trouble("f 1 2 99999999999999999999999", Kind::IndexOutOfRange);
    trouble("f 1 2 -99999999999999999999999", Kind::IndexOutOfRange);
    trouble("f 1 2 4294967296", Kind::IndexOutOfRange);
    trouble("f 1 2 x", Kind::UnreadableCorner);
    trouble("f 1 2 3.5", Kind::UnreadableCorner);
    trouble("f 1 2 /3", Kind::UnreadableCorner);
    trouble("f 1 2 -", Kind::UnreadableCorner);
    expect("vt 0 0\nf 1/-1 1/-1 1/-2", &[], &[(Kind::IndexOutOfRange, 1, 2)]);
}

#[test]
fn coordinates_that_are_no_numbers_keep_their_place() {
    let (mesh, warnings) = read_obj(
        "v nan -nan nan\nv inf -inf inf\nv 1.#IND -1.#IND 1.#INF\nv 3.1+e2 0 0\nv 1\nv .5 -.7e+2 5.\nf 6 6 6",
    );
    assert_eq!(mesh.vertices.len(), 6);
    assert_eq!(mesh.vertices[5], Vec3::new(0.5, -70.0, 5.0));
    assert_eq!(mesh.vertices[1], Vec3::new(f32::INFINITY, f32::NEG_INFINITY, f32::INFINITY));
    assert!(mesh.vertices[3].x.is_nan() && mesh.vertices[3].y == 0.0 && mesh.vertices[4].y.is_nan());
    assert_eq!(
        (warnings.count(Kind::UnreadableCoordinate), warnings.count(Kind::NonFiniteCoordinate)),
        (3, 2)
    );
    assert_eq!(warnings.first_line(Kind::UnreadableCoordinate), Some(3));
    assert_eq!(indices(&mesh), [5, 5, 5]);
}

#[test]
fn two_coordinates_and_foreign_numbers() {
    let text =
        "v 0 0\nv 1 0 # x\nv 1 1# y\nv 0,5 1.0D+00 -2.5d-1\nv 1.#IND 0\nv 1 2 1.#INF\nv 1,5 2,5 3\nf 1 2 3 4";
    let (mesh, warnings) = read_obj(text);
    assert_eq!(
        mesh.vertices[..4],
        [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::new(0.5, 1.0, -0.25)]
    );
    assert_eq!(mesh.vertices[6], Vec3::new(1.5, 2.5, 3.0));
    assert_eq!(
        (warnings.count(Kind::UnreadableCoordinate), warnings.first_line(Kind::UnreadableCoordinate)),
        (2, Some(5))
    );
    assert_eq!(mesh.triangle_count(), 2);
}

#[test]
fn comments_behind_every_statement() {
    for comment in ["# a", " # a", "#", "\t#1 2 3", " # C:\\work\\", "# \\", " #\\ "] {
        let text: String =
            format!("{SQUARE}vn 0 0 1\nvt 0 0\ns off\nf 1 2 3\nf 1/1/1 3/1/1 4/1/1\nf -4//1 -3//1 -2//1\n")
                .lines()
                .map(|line| format!("{line}{comment}\n"))
                .collect();
        expect(&text, &[0, 1, 2, 0, 2, 3, 0, 1, 2], &[]);
        expect(text.replace('\n', "\r\n"), &[0, 1, 2, 0, 2, 3, 0, 1, 2], &[]);
        assert_eq!(read_obj(&text).0.vertices, read_obj(SQUARE).0.vertices);
    }
    expect(format!("{SQUARE}p 1 # a\nl 1 2# b\nf 1 2 3"), &[0, 1, 2], &[(Kind::PointsLinesCurves, 2, 5)]);
}

#[test]
fn names_with_comments_backslashes_and_hashes() {
    let names = |line: &str| {
        let (mesh, warnings) = read_obj(format!("{SQUARE}{line}\nf 1 2 3\n"));
        assert_eq!(indices(&mesh), [0, 1, 2], "{line}");
        assert_eq!(warnings.count(Kind::UnknownStatement), 0, "{line}");
        (mesh.parts[0].name.clone(), mesh.materials[0].name.clone())
    };
    for (name, kept) in [
        ("a b", "a b"),
        ("a # front", "a"),
        ("a #front", "a"),
        ("C#1", "C#1"),
        ("Box #12 # a", "Box #12"),
        ("C:\\parts\\", "C:\\parts\\"),
        ("a\\ ", "a\\"),
        ("a \\", "a"),
    ] {
        assert_eq!(names(&format!("o {name}")).0, kept);
        assert_eq!(names(&format!("g {name}")).0, kept);
        assert_eq!(names(&format!("usemtl {name}")).1, kept);
    }
    // Of one material, whatever is remarked about it, there is one part.
    let text = format!("{SQUARE}usemtl a # front\nf 1 2 3\nusemtl a # back\nf 1 3 4");
    assert_eq!(read_obj(text).0.parts.len(), 1);
}

#[test]
fn statements_that_go_on() {
    for end in ["\n", "\r\n", "\r", "\n\r"] {
        for backslash in ["\\", " \\", " \\ ", "\\\t \t"] {
            let text = format!("{SQUARE}f 1{backslash}\n 2{backslash}\n 3 4 # a \\\nf 1 \\\n2 4{backslash}\nf 2 3 4{backslash}")
                .replace('\n', end);
            expect(&text, &[0, 1, 2, 0, 2, 3, 0, 1, 3, 1, 2, 3], &[]);
            expect(
                format!("{text}{end}f 1 2 9"),
                &[0, 1, 2, 0, 2, 3, 0, 1, 3, 1, 2, 3],
                &[(Kind::IndexOutOfRange, 1, 11)],
            );
        }
    }
    let (mesh, warnings) = read_obj("v 0 0 0 \\\nv 1 0 \\ \n0\nv 0 \\\n1\nf 1 2 3");
    assert_eq!((mesh.vertices, warnings.is_empty()), (vec![Vec3::ZERO, Vec3::X, Vec3::Y], true));
}

#[test]
fn weights_and_colours_are_passed_over() {
    let text = "v 0 0 0 0.1\nv 1 0 0 1 0 0\nv 0 1 0\nvn 0 0 1\nvt 0 0\nvp 1\ns off\nf 1 2 3";
    expect(text, &[0, 1, 2], &[]);
    assert_eq!(read_obj(text).0.vertices, [Vec3::ZERO, Vec3::X, Vec3::Y]);
}

#[test]
fn faces_before_their_vertices() {
    expect(
        format!("f 1 2 3\nf 1 2 3 4\nf 1 2 7\n{SQUARE}"),
        &[0, 1, 2, 0, 1, 2, 0, 2, 3],
        &[(Kind::IndexOutOfRange, 1, 3)],
    );
    // Backwards from the vertices so far, not from all of them; with none so far there is nothing to count from.
    expect("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 9 9 9", &[0, 1, 2], &[]);
    expect(format!("f -3 -2 -1\n{SQUARE}"), &[], &[(Kind::IndexOutOfRange, 1, 1)]);
}

#[test]
fn points_lines_and_strange_statements() {
    let text =
        format!("{SQUARE}p 1\nl 1 2 3 4\nl 1 2\ncurv 0 1 1 2\nf 1 2 3\nbogus 1\n\u{FFFD}\nt crease 2/1\n");
    expect(&text, &[0, 1, 2], &[(Kind::PointsLinesCurves, 4, 5), (Kind::UnknownStatement, 2, 10)]);
    assert!(read_obj(&text).1.to_string().contains("first: bogus at line 10"));
}

#[test]
fn encodings_line_ends_and_long_lines() {
    let text = format!("# caf\u{e9}\n{SQUARE}o caf\u{e9}\nf 1 2 3 \\\n  4\nf 1 2 3");
    let expected = [0, 1, 2, 0, 2, 3, 0, 1, 2];
    let latin1: Vec<u8> = text.chars().map(|c| c as u8).collect();
    let utf16: Vec<u8> =
        [0xFF, 0xFE].into_iter().chain(text.encode_utf16().flat_map(u16::to_le_bytes)).collect();
    let marked = [b"\xEF\xBB\xBF", text.as_bytes()].concat();
    for bytes in [text.clone().into_bytes(), text.replace('\n', "\r\n").into_bytes(), latin1, utf16, marked] {
        expect(&bytes, &expected, &[]);
        assert_eq!(read_obj(&bytes).0.parts[0].name, "caf\u{e9}");
    }
    let many = format!("{SQUARE}f{}", " 1 2 3 4".repeat(234));
    assert_eq!(read_obj(many).0.triangle_count(), 934, "936 corners, round and round");
}

#[test]
fn parts_by_object_group_and_material() {
    let text = format!(
        "{SQUARE}usemtl a b\no one\nf 1 2 3\ng left\nf 1 2 4\nusemtl c\nf 1 3 4\no two\ng\nf 1 2 3\no one\nusemtl a b\nf 2 3 4\nf 1 2 3 4\no empty\n"
    );
    let (mesh, warnings) = read_obj(&text);
    let parts: Vec<_> = mesh.parts.iter().map(|p| (p.name.as_str(), p.material, p.indices.len())).collect();
    assert_eq!(parts, [("one", 0, 12), ("one/left", 0, 3), ("one/left", 1, 3), ("two", 1, 3)]);
    assert_eq!(mesh.materials.iter().map(|m| m.name.as_str()).collect::<Vec<_>>(), ["a b", "c"]);
    assert_eq!(warnings.count(Kind::UnknownMaterial), 2);

    let (mesh, _) =
        obj::parse(text.as_bytes(), &obj::Options { quads: true, ..obj::Options::default() }, &mut |_| None);
    let quads: Vec<_> =
        mesh.parts.iter().filter(|p| p.faces == Faces::Quads).map(|p| p.indices.as_slice()).collect();
    assert_eq!(quads, [&[0, 1, 2, 3]]);
    assert_eq!(mesh.triangle_count(), 7);
}

#[test]
fn material_libraries() {
    let text = format!(
        "mtllib my lib.mtl\nmtllib gone.mtl\nmtllib gone.mtl\nmtllib one.mtl two.mtl\n{SQUARE}usemtl lamp\nf 1 2 3\nusemtl two\nf 1 2 4\nusemtl none\nf 1 3 4"
    );
    let mut asked = Vec::new();
    let (mesh, warnings) = obj::parse(text.as_bytes(), &Default::default(), &mut |name| {
        asked.push(name.to_owned());
        match name {
            "my lib.mtl" => Some(b"newmtl lamp\nKe 1 2 3\n".to_vec()),
            "one.mtl" | "two.mtl" => Some(format!("newmtl {}\nKd 0.5 0.5 0.5", &name[..3]).into_bytes()),
            _ => None,
        }
    });
    assert_eq!(asked, ["my lib.mtl", "gone.mtl", "one.mtl two.mtl", "one.mtl", "two.mtl"], "each once");
    assert_eq!(mesh.materials[0].emission, Vec3::new(1.0, 2.0, 3.0));
    assert_eq!(mesh.materials[1].diffuse, Vec3::splat(0.5));
    assert_eq!(
        (warnings.count(Kind::MissingLibrary), warnings.first_line(Kind::MissingLibrary)),
        (1, Some(2))
    );
    assert_eq!(
        (warnings.count(Kind::UnknownMaterial), warnings.first_line(Kind::UnknownMaterial)),
        (1, Some(13))
    );
}

#[test]
fn of_two_definitions_the_first_counts() {
    let diffuse = |statement: &str| {
        let text = format!("{statement}\n{SQUARE}usemtl m\nf 1 2 3");
        let (mesh, warnings) = obj::parse(text.as_bytes(), &Default::default(), &mut |name| match name {
            "red.mtl" | "red # one.mtl" => Some(b"newmtl m\nKd 1 0 0\n".to_vec()),
            "green.mtl" => Some(b"newmtl other\nnewmtl m\nKd 0 1 0\nnewmtl m\nKd 0 0 1".to_vec()),
            _ => None,
        });
        (mesh.materials[0].diffuse, warnings.to_string())
    };
    let none = String::new;
    for comment in ["", " # library", "# library", " #"] {
        assert_eq!(diffuse(&format!("mtllib red.mtl{comment}")), (Vec3::X, none()), "{comment}");
        assert_eq!(diffuse(&format!("mtllib red.mtl green.mtl{comment}")), (Vec3::X, none()), "{comment}");
        assert_eq!(diffuse(&format!("mtllib green.mtl red.mtl{comment}")), (Vec3::Y, none()), "{comment}");
    }
    assert_eq!(diffuse("mtllib red # one.mtl"), (Vec3::X, none()));
    assert_eq!(diffuse("mtllib red.mtl\nmtllib green.mtl"), (Vec3::X, none()));
    assert_eq!(diffuse("mtllib green.mtl \\\n red.mtl"), (Vec3::Y, none()));
    let (colour, warning) = diffuse("mtllib gone.mtl green.mtl red.mtl");
    assert_eq!(colour, Vec3::Y);
    assert_eq!(warning, "1 material libraries not found (first: gone.mtl at line 1)");
    assert!(
        diffuse("mtllib my library.mtl")
            .1
            .starts_with("1 material libraries not found (first: my library.mtl at")
    );
}

#[test]
fn no_obj_at_all_gives_no_faces() {
    for bytes in [&b""[..], b"\n", b"hello\nworld", &[0; 100], b"\xFF\xFE", b"\xFF", b"\\"] {
        let (mesh, _) = read_obj(bytes);
        assert!(mesh.parts.is_empty() && mesh.materials.is_empty());
    }
}

#[test]
fn the_reader_of_paths_says_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let message = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let message = embree_trace::mesh::read(&path).unwrap_err().to_string();
        assert!(message.contains(name) && !message.contains('\n'), "{message}");
        message
    };
    assert!(message("empty.obj", b"").contains("empty"));
    assert!(message("points.obj", b"v 1 2 3\n").contains("a point cloud: 1 vertices and no faces"));
    assert!(
        message("lines.obj", b"v 1 2 3\nv 0 0\nl 1 2").contains("no faces in 2 vertices (1 points, lines")
    );
    let nan = message("nan.obj", b"v 0 nan 0\nv 1 0 0\nv 1 1 1\nv 0 inf 1\nf 1 2 3\nf 1 2 3 4\n");
    assert!(nan.contains("no triangle of 3 has three finite corners (2 vertices with a NaN"), "{nan}");
    assert!(
        message("nan.ply", &crate::ply::ascii("0 0 nan\n1 0 0\n0 1 0\n3 0 1 2\n"))
            .contains("(first at line 10)")
    );
    let points = String::from_utf8(crate::ply::ascii("0 0 0\n1 0 0\n0 1 0\n")).unwrap();
    let no_faces = points.replace("face 1", "face 0");
    let no_element =
        points.split("element face").next().unwrap().to_owned() + "end_header\n0 0 0\n1 0 0\n0 1 0\n";
    for points in [no_faces, no_element] {
        assert!(message("points.ply", points.as_bytes()).contains("a point cloud: 3 vertices"), "{points}");
    }
    assert!(
        message("bad.obj", b"v 1 2 3\nf 1 2 3\n")
            .contains("1 faces skipped: no such vertex (first at line 2)")
    );
    assert!(message("text.obj", b"hello").contains("is it an OBJ?"));
    assert!(message("a.rays", b"\x89RAYS\r\n\x1a rest").contains(".rays"));
    assert!(message("a.bvh", b"\x89BVH\r\n\x1a\n rest").contains(".bvh"));
    assert!(message("cut.ply", b"ply\nformat ascii 1.0\n").contains("end_header"));
    let whole = zstd::encode_all(&b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".repeat(9000)[..], 1).unwrap();
    assert!(message("cut.obj.zst", &whole[..whole.len() - 9]).contains("decompress"));
    let path = folder.path().join("whole.obj.zst");
    std::fs::write(&path, &whole).unwrap();
    assert_eq!(embree_trace::mesh::read(&path).unwrap().0.triangle_count(), 9000);
    assert!(embree_trace::mesh::read(folder.path()).unwrap_err().to_string().contains("not a regular file"));
    assert!(
        embree_trace::mesh::read(&folder.path().join("none.obj"))
            .unwrap_err()
            .to_string()
            .contains("none.obj")
    );
}

#[test]
fn libraries_are_found_beside_the_scene_and_devices_are_not_opened() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("mats")).unwrap();
    std::fs::write(folder.path().join("mats/a b.mtl"), "newmtl lamp\nKe 5 5 5").unwrap();
    let path = folder.path().join("scene.obj");
    std::fs::write(&path, format!("mtllib mats\\a b.mtl\nmtllib /dev/zero\n{SQUARE}usemtl lamp\nf 1 2 3"))
        .unwrap();
    let (mesh, warnings) = embree_trace::mesh::read(&path).unwrap();
    assert_eq!(mesh.materials[0].emission, Vec3::splat(5.0));
    assert_eq!(warnings.count(Kind::MissingLibrary), 1);
}
