//! Trees out of Embree against an independent validator, and a naive traversal of them against Embree's own answers.
#![cfg(feature = "embree")]

mod embree_support;

use embree_support::*;
use embree_trace::embree::{BuiltTree, EmbreeError, Isa, Quality, Scene, Settings, TRI_ACCELS, TreeSource};
use embree_trace::geometry::{Aabb, Ray, Triangle, Vec3};
use embree_trace::mesh::{Faces, Material, Mesh, Part};
use embree_trace::tree::statistics::Statistics;

const SPATIAL_SPLITS: u32 = 1;

/// Meshes by name: few and many primitives of each kind, and what files have in store.
fn meshes() -> Vec<(String, Mesh)> {
    let mut meshes = Vec::new();
    for count in [0, 1, 2, 5, 1000] {
        meshes.push((format!("{count} triangles"), soup(Faces::Triangles, count, 0.2, 1)));
        meshes.push((format!("{count} quads"), soup(Faces::Quads, count, 0.2, 2)));
        let mut both = soup(Faces::Quads, count, 0.2, 3);
        add_soup(&mut both, Faces::Triangles, count, 0.2, &mut Random(4));
        meshes.push((format!("{count} of both"), both));
    }
    meshes.push(("nothing".into(), Mesh::default()));
    meshes.push(("grid".into(), grid(Faces::Triangles, 20)));
    let mut parts = Mesh::default();
    for part in 0..25 {
        let faces = if part % 5 == 3 { Faces::Quads } else { Faces::Triangles };
        add_soup(&mut parts, faces, part % 7 * 4, 0.3, &mut Random(part as u64));
    }
    meshes.push(("25 parts".into(), parts));
    // Long, thin and large: spatial splits pay.
    meshes.push(("slivers".into(), soup(Faces::Triangles, 300, 2.0, 5)));
    meshes.push(("identical".into(), repeated(500, |_| [Vec3::ZERO, Vec3::X, Vec3::Y])));
    meshes.push(("points".into(), repeated(300, |i| [Vec3::splat((i % 7) as f32); 3])));
    meshes.push((
        "equal centroids".into(),
        repeated(200, |i| [Vec3::X, Vec3::Y, -Vec3::ONE].map(|v| v * i as f32)),
    ));
    meshes
        .push(("huge".into(), repeated(100, |i| [Vec3::X, Vec3::Y, Vec3::Z].map(|v| v * 1.8e16 * i as f32))));
    meshes
        .push(("tiny".into(), repeated(100, |i| [Vec3::X, Vec3::Y, Vec3::Z].map(|v| v * 1e-38 * i as f32))));
    let mut bad = soup(Faces::Triangles, 200, 0.3, 6);
    add_soup(&mut bad, Faces::Quads, 200, 0.3, &mut Random(7));
    let values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1.844e18, -1e30, f32::MAX];
    for (index, vertex) in bad.vertices.iter_mut().enumerate().filter(|(index, _)| index % 17 == 0) {
        vertex[index % 3] = values[index / 17 % values.len()];
    }
    meshes.push(("bad vertices".into(), bad));
    let mut all_bad = soup(Faces::Triangles, 20, 0.3, 6);
    all_bad.vertices.iter_mut().for_each(|vertex| vertex.y = f32::NAN);
    meshes.push(("only bad vertices".into(), all_bad));
    meshes
}

fn repeated(count: usize, triangle: impl Fn(usize) -> [Vec3; 3]) -> Mesh {
    Mesh {
        vertices: (0..count).flat_map(triangle).collect(),
        parts: vec![Part {
            name: "repeated".into(),
            material: 0,
            faces: Faces::Triangles,
            indices: (0..3 * count as u32).collect(),
        }],
        materials: vec![Material::default()],
    }
}

/// Every instruction set, quality and flag; then every triangle structure by name.
fn variants() -> Vec<Settings> {
    let mut variants = Vec::new();
    for isa in [Isa::Sse42, Isa::Avx, Isa::Avx2, Isa::Avx512] {
        for quality in Quality::ALL {
            let base = Settings { isa: Some(isa), quality, ..Settings::default() };
            for flags in 0..4 {
                variants.push(Settings { robust: flags & 1 != 0, compact: flags & 2 != 0, ..base.clone() });
            }
            for name in TRI_ACCELS.into_iter().filter(|name| isa >= Isa::Avx || !name.contains("bvh8")) {
                variants.push(Settings { tri_accel: Some(name.into()), ..base.clone() });
            }
        }
    }
    variants.retain(|settings| match Scene::new(&Mesh::default(), settings) {
        Ok(_) => true,
        Err(EmbreeError::UnsupportedIsa(isa)) => {
            eprintln!("SKIPPED: this CPU has no {isa}");
            false
        }
        Err(error) => panic!("{settings:?}: {error}"),
    });
    variants
}

/// Everything that `docs/formats.md` promises of a tree.
fn validate(built: &BuiltTree) {
    let BuiltTree { tree, triangles, flags, .. } = built;
    let splits = flags & SPATIAL_SPLITS != 0;
    let mut parents = vec![0; tree.nodes.len()];
    let mut in_leaves = vec![0; triangles.len()];
    let mut covered = vec![Aabb::EMPTY; triangles.len()];
    let mut next_primitive = 0;
    for (index, node) in tree.nodes.iter().enumerate() {
        if !node.is_leaf() {
            assert!(node.first as usize > index && (1..=8).contains(&node.len()));
            for child in node.range() {
                parents[child] += 1;
                let inside = node.bounds().contains(&tree.nodes[child].bounds());
                assert!(inside, "{node:?} does not contain {:?}", tree.nodes[child]);
            }
            continue;
        }
        assert!(!node.is_empty() || tree.nodes.len() == 1, "an empty leaf");
        next_primitive += node.len();
        for &triangle in &tree.primitives[node.range()] {
            in_leaves[triangle as usize] += 1;
            covered[triangle as usize] = covered[triangle as usize].union(&node.bounds());
            let (box_, bounds) = (node.bounds(), triangles[triangle as usize].bounds());
            assert!(triangles[triangle as usize].is_finite());
            assert!(box_.contains(&bounds) || splits && overlaps(&box_, &bounds), "{box_:?} {bounds:?}");
        }
    }
    assert_eq!(next_primitive, tree.primitives.len(), "each entry of PRIM is in one leaf");
    assert_eq!(parents[0], 0);
    assert!(parents[1..].iter().all(|&count| count == 1), "each node has one parent");
    for (triangle, &count) in triangles.iter().zip(&in_leaves) {
        match (triangle.is_finite(), splits) {
            (true, false) => assert_eq!(count, 1),
            (true, true) => assert!(count >= 1),
            (false, _) => assert_eq!(count, 0),
        }
    }
    assert!(Statistics::of(tree.view()).depth < 100);
    assert!(built.producer.len() <= 48, "{:?} does not fit", built.producer);
}

fn overlaps(a: &Aabb, b: &Aabb) -> bool {
    a.lower.cmple(b.upper).all() && b.lower.cmple(a.upper).all()
}

/// Whether the ray's line passes the box, in double precision and with a little room.
fn passes(ray: &Ray, bounds: &Aabb) -> bool {
    let (mut near, mut far) = (ray.tnear as f64, ray.tfar as f64);
    for axis in 0..3 {
        let (origin, direction) = (ray.origin[axis] as f64, ray.direction[axis] as f64);
        let room = 1e-6 * (1.0 + origin.abs());
        let (lower, upper) = (bounds.lower[axis] as f64 - room, bounds.upper[axis] as f64 + room);
        if direction == 0.0 {
            if origin < lower || origin > upper {
                return false;
            }
            continue;
        }
        let (a, b) = ((lower - origin) / direction, (upper - origin) / direction);
        near = near.max(a.min(b) - 1e-6);
        far = far.min(a.max(b) + 1e-6);
    }
    near <= far
}

/// The triangles of all leaves that the ray passes, and their numbers.
fn reached(built: &BuiltTree, ray: &Ray, node: usize, into: &mut Vec<u32>) {
    let node = &built.tree.nodes[node];
    if !passes(ray, &node.bounds()) {
        return;
    }
    if node.is_leaf() {
        into.extend(&built.tree.primitives[node.range()]);
    } else {
        node.range().for_each(|child| reached(built, ray, child, into));
    }
}

/// A naive traversal of the tree finds what `rtcIntersect1` finds. Returns the number of hits.
fn agree(built: &BuiltTree, scene: &Scene, rays: usize, seed: u64) -> usize {
    let mut intersector = scene.intersector().unwrap();
    let mut hits = 0;
    for query in queries(rays, seed) {
        let mut numbers = Vec::new();
        reached(built, &query.ray, 0, &mut numbers);
        let triangles: Vec<Triangle> =
            numbers.iter().map(|&number| built.triangles[number as usize]).collect();
        let surely = nearest(&query.ray, &triangles, 1e-3);
        let near_tfar = |t: f64| query.ray.tfar.is_finite() && (t - query.ray.tfar as f64).abs() < 1e-3;
        let hit = intersector.closest_hit(&query);
        if let Some(hit) = hit {
            hits += 1;
            assert!(numbers.contains(&hit.triangle), "{query:?} does not reach {hit:?}");
            let found = crossing(&query.ray, &built.triangles[hit.triangle as usize]).unwrap();
            assert!((found.t - hit.t as f64).abs() <= 2e-4 * found.t.abs().max(0.1), "{hit:?} {found:?}");
            let nearer = nearest(&query.ray, &triangles, -1e-3).unwrap();
            assert!(nearer.1.t <= hit.t as f64 + 2e-4);
        }
        match (surely, hit) {
            (Some((_, surely)), Some(hit)) => assert!(hit.t as f64 <= surely.t + 2e-4 * surely.t.max(0.1)),
            (Some((_, surely)), None) => {
                assert!(
                    near_tfar(surely.t) || (surely.t - query.ray.tnear as f64) < 1e-3,
                    "{query:?} {surely:?}"
                )
            }
            (None, _) => {}
        }
    }
    hits
}

#[test]
fn live_trees_of_every_kind_are_valid() {
    let meshes = meshes();
    for settings in variants() {
        for (name, mesh) in &meshes {
            let scene = Scene::new(mesh, &settings).unwrap();
            let built = scene.tree(TreeSource::Live).unwrap();
            assert_eq!(built.flags & !SPATIAL_SPLITS, 4, "{name} {settings:?}: {:?}", built.warning);
            validate(&built);
            assert_eq!(built.tree.nodes[0].bounds(), scene.bounds(), "{name} {settings:?}");
            assert_eq!(built.warning.is_some(), name.starts_with("bad"), "{name}: {:?}", built.warning);
            if built.flags & SPATIAL_SPLITS != 0 {
                assert_eq!(settings.quality, Quality::High);
            }
        }
    }
}

#[test]
fn a_traversal_of_the_live_tree_finds_what_embree_finds() {
    let mut both = soup(Faces::Quads, 800, 0.2, 3);
    add_soup(&mut both, Faces::Triangles, 1200, 0.2, &mut Random(4));
    let meshes = [soup(Faces::Triangles, 2000, 0.2, 1), both, soup(Faces::Triangles, 300, 2.0, 5)];
    let mut split = 0;
    for (index, settings) in variants().iter().enumerate() {
        for mesh in &meshes {
            let scene = Scene::new(mesh, settings).unwrap();
            let built = scene.tree(TreeSource::Live).unwrap();
            split += built.flags & SPATIAL_SPLITS;
            let hits = agree(&built, &scene, 200, index as u64);
            assert!(hits > 20, "{hits} hits are too few to say anything");
        }
    }
    assert!(split > 0, "no tree has spatial splits: they are not tested");
    for mesh in &meshes {
        let scene = Scene::new(mesh, &Settings::default()).unwrap();
        agree(&scene.tree(TreeSource::Live).unwrap(), &scene, 5000, 77);
        agree(&scene.tree(TreeSource::Builder).unwrap(), &scene, 2000, 78);
    }
}

#[test]
fn structures_are_named_and_shaped_as_asked() {
    let mut mesh = soup(Faces::Triangles, 1000, 0.2, 1);
    let shape = |mesh: &Mesh, settings: &Settings| {
        let built = Scene::new(mesh, settings).unwrap().tree(TreeSource::Live).unwrap();
        (built.producer, Statistics::of(built.tree.view()).max_children)
    };
    let sse42 = Settings { isa: Some(Isa::Sse42), ..Settings::default() };
    let named = |name: &str| Settings { tri_accel: Some(name.into()), ..sse42.clone() };
    // The instruction set is that of the kernel that Embree picked: it has none of its own for SSE 4.2 in the first case.
    assert_eq!(shape(&mesh, &sse42), ("embree 3.13.5 sse2 BVH4<triangle4>".into(), 4));
    assert_eq!(shape(&mesh, &named("bvh4.triangle4i")), ("embree 3.13.5 sse42 BVH4<triangle4i>".into(), 4));
    assert_eq!(shape(&mesh, &named("qbvh4.triangle4i")).0, "embree 3.13.5 sse42 QBVH4<triangle4i>");
    let avx = Settings { isa: Some(Isa::Avx), ..Settings::default() };
    match Scene::new(&mesh, &avx) {
        Err(error) => eprintln!("SKIPPED: {error}"),
        Ok(_) => assert_eq!(shape(&mesh, &avx), ("embree 3.13.5 avx BVH8<triangle4>".into(), 8)),
    }
    add_soup(&mut mesh, Faces::Quads, 1000, 0.2, &mut Random(1));
    assert_eq!(shape(&mesh, &sse42).0, "embree 3.13.5 sse2 BVH4<triangle4,quad4v>");
    assert_eq!(shape(&Mesh::default(), &sse42), ("embree 3.13.5".into(), 0));
    let built = Scene::new(&mesh, &sse42).unwrap().tree(TreeSource::Builder).unwrap();
    assert_eq!((built.producer.as_str(), built.flags), ("embree 3.13.5 rtcBuildBVH", 8));
}

#[test]
fn trees_do_not_depend_on_threads() {
    let mut meshes = meshes();
    meshes.push(("many".into(), soup(Faces::Triangles, 60_000, 0.05, 9)));
    for quality in Quality::ALL {
        for (name, mesh) in &meshes {
            for source in TreeSource::ALL {
                let tree = |threads| {
                    let settings = Settings { threads, quality, ..Settings::default() };
                    let built = Scene::new(mesh, &settings).unwrap().tree(source).unwrap();
                    (built.tree, built.producer, built.flags)
                };
                assert!(tree(1) == tree(2), "{name} {quality:?} {source:?}");
            }
        }
    }
}

#[test]
fn builder_trees_are_valid_and_binary() {
    for quality in Quality::ALL {
        for (name, mesh) in meshes() {
            let scene = Scene::new(&mesh, &Settings { quality, ..Settings::default() }).unwrap();
            let built = scene.tree(TreeSource::Builder).unwrap();
            validate(&built);
            let statistics = Statistics::of(built.tree.view());
            assert!(statistics.max_leaf <= 1 && statistics.max_children <= 2, "{name}: {statistics:?}");
            assert_eq!(built.tree.nodes[0].bounds(), scene.bounds(), "{name}");
            assert_eq!(built.flags, 8);
        }
    }
}

#[test]
fn what_embree_drops_is_not_finite_in_the_triangles() {
    let mut mesh = soup(Faces::Triangles, 4, 0.3, 1);
    add_soup(&mut mesh, Faces::Quads, 3, 0.3, &mut Random(2));
    mesh.vertices[0].x = 1.844e18; // triangle 0: dropped, though finite
    mesh.vertices[3].x = 1.843e18; // triangle 1: kept
    mesh.vertices[6].y = f32::NAN; // triangle 2: not finite anyway
    mesh.vertices[12 + 2].z = f32::INFINITY; // the first quad's v2: (v0, v1, v3) is finite, and dropped too
    let scene = Scene::new(&mesh, &Settings::default()).unwrap();
    let (triangles, replaced) = scene.triangles();
    assert_eq!(replaced, 2);
    let finite: Vec<bool> = triangles.iter().map(Triangle::is_finite).collect();
    assert_eq!(finite, [false, true, false, true, false, false, true, true, true, true]);
    for (kept, original) in triangles.iter().zip(mesh.triangles()).filter(|(kept, _)| kept.is_finite()) {
        assert_eq!(*kept, original);
    }
    for source in TreeSource::ALL {
        let built = scene.tree(source).unwrap();
        validate(&built);
        assert!(built.warning.unwrap().starts_with("2 triangles are written as NaN"));
    }
}

#[test]
fn geometries_say_where_each_parts_triangles_are() {
    let mut mesh = soup(Faces::Quads, 3, 0.3, 1);
    add_soup(&mut mesh, Faces::Triangles, 0, 0.3, &mut Random(2));
    add_soup(&mut mesh, Faces::Triangles, 5, 0.3, &mut Random(2));
    let built = Scene::new(&mesh, &Settings::default()).unwrap().tree(TreeSource::Live).unwrap();
    let rows: Vec<_> = built
        .geometries
        .iter()
        .map(|g| (g.instance, g.geometry, g.first_triangle, g.triangle_count, g.mask, g.kind))
        .collect();
    let none = u32::MAX;
    assert_eq!(rows, [(none, 0, 0, 6, none, 1), (none, 1, 6, 0, none, 0), (none, 2, 6, 5, none, 0)]);
}
