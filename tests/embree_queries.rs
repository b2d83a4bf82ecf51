//! Queries through the shim against brute force in double precision, and packets against single queries.
#![cfg(feature = "embree")]

mod embree_support;

use embree_support::*;
use embree_trace::embree::{EmbreeError, Hit, Isa, Quality, Query, Scene, Settings};
use embree_trace::geometry::{Ray, Triangle, Vec3};
use embree_trace::mesh::{Faces, Mesh};

/// Everything that has to hold of an answer, with room for rays that graze an edge. Returns whether it was such a ray.
fn judge(query: &Query, hit: Option<Hit>, occluded: bool, triangles: &[Triangle], mesh: &Mesh) -> bool {
    const MARGIN: f64 = 1e-4;
    let (surely, perhaps) = (nearest(&query.ray, triangles, MARGIN), nearest(&query.ray, triangles, -MARGIN));
    let same_t = |a: f64, b: f64| (a - b).abs() <= 1e-4 * a.abs().max(b.abs()).max(1e-2);
    let at_an_end = |t: f64| {
        [query.ray.tnear, query.ray.tfar].iter().any(|&end| end.is_finite() && same_t(t, end as f64))
    };
    if let Some(hit) = hit {
        let triangle = &triangles[hit.triangle as usize];
        let found = crossing(&query.ray, triangle).expect("a hit triangle is crossed");
        assert!(found.inside >= -MARGIN, "hit outside its triangle: {query:?} {hit:?} {found:?}");
        assert!(same_t(found.t, hit.t as f64), "wrong t: {query:?} {hit:?} {found:?}");
        assert!(
            (found.u - hit.u as f64).abs() < 1e-3 && (found.v - hit.v as f64).abs() < 1e-3,
            "{hit:?} {found:?}"
        );
        let (part, _) = part_of(mesh, hit.triangle);
        assert_eq!(part, hit.part as usize);
        let normal = triangle.scaled_normal();
        let aligned = hit.normal.dot(normal) / (hit.normal.length() * normal.length());
        assert!(aligned > 0.999, "{:?} is not along {normal:?}", hit.normal);
        assert!(perhaps.is_some_and(|(_, nearest)| nearest.t <= hit.t as f64 * (1.0 + 1e-4) + 1e-6));
    }
    match (surely, perhaps) {
        (None, None) => assert!(hit.is_none() && !occluded, "{query:?} hits nothing, but {hit:?} {occluded}"),
        (Some((_, surely)), _) if !at_an_end(surely.t) => {
            let hit = hit.unwrap_or_else(|| panic!("{query:?} is missing {surely:?}"));
            assert!(
                hit.t as f64 <= surely.t * (1.0 + 1e-4) + 1e-6,
                "{query:?}: {hit:?} is behind {surely:?}"
            );
            assert!(occluded);
        }
        _ => return true,
    }
    false
}

fn part_of(mesh: &Mesh, triangle: u32) -> (usize, u32) {
    let mut rest = triangle;
    for (index, part) in mesh.parts.iter().enumerate() {
        let count = (part.indices.len() / part.faces.corners() * part.faces.triangles()) as u32;
        if rest < count {
            return (index, rest);
        }
        rest -= count;
    }
    panic!("there is no triangle {triangle}");
}

fn mixed() -> Mesh {
    let random = &mut Random(11);
    let mut mesh = Mesh::default();
    add_soup(&mut mesh, Faces::Quads, 40, 0.5, random);
    add_soup(&mut mesh, Faces::Triangles, 0, 0.5, random);
    add_soup(&mut mesh, Faces::Triangles, 70, 0.5, random);
    add_soup(&mut mesh, Faces::Quads, 1, 0.5, random);
    add_soup(&mut mesh, Faces::Triangles, 30, 0.2, random);
    mesh
}

#[test]
fn answers_are_those_of_brute_force() {
    let meshes = [
        soup(Faces::Triangles, 300, 0.3, 1),
        soup(Faces::Quads, 150, 0.3, 2),
        mixed(),
        grid(Faces::Triangles, 12),
        grid(Faces::Quads, 12),
    ];
    let settings = [
        Settings::default(),
        Settings { robust: true, ..Settings::default() },
        Settings { compact: true, quality: Quality::Low, ..Settings::default() },
        Settings { isa: Some(Isa::Sse42), quality: Quality::High, ..Settings::default() },
    ];
    for mesh in &meshes {
        let triangles = mesh.triangles();
        for settings in &settings {
            let scene = Scene::new(mesh, settings).unwrap();
            assert_eq!(scene.triangles(), (triangles.clone(), 0));
            let mut intersector = scene.intersector().unwrap();
            let queries = queries(3000, 5);
            let mut hits = 0;
            let mut borderline = 0;
            for query in &queries {
                let hit = intersector.closest_hit(query);
                let occluded = intersector.occluded(query);
                hits += usize::from(hit.is_some());
                borderline += usize::from(judge(query, hit, occluded, &triangles, mesh));
            }
            assert!(hits > 300, "{hits} hits are too few to say anything");
            assert!(borderline < 30, "{borderline} rays near an edge are too many to be chance");
            assert_eq!(intersector.refused(), 0);
        }
    }
}

/// The scene, or `None` where this CPU has not the instruction set.
fn scene_if_possible(mesh: &Mesh, settings: &Settings) -> Option<Scene> {
    match Scene::new(mesh, settings) {
        Err(EmbreeError::UnsupportedIsa(isa)) => {
            eprintln!("SKIPPED: this CPU has no {isa}");
            None
        }
        scene => Some(scene.unwrap()),
    }
}

/// The same answer up to the last bits, in which Embree's packet kernels for quads differ from its single ones.
fn alike(a: Option<Hit>, b: Option<Hit>) -> bool {
    match (a, b) {
        (Some(a), Some(b)) => {
            (a.t - b.t).abs() <= 1e-5 * a.t.abs().max(1e-2)
                && (a.triangle != b.triangle || ((a.u - b.u).abs() < 1e-4 && (a.v - b.v).abs() < 1e-4))
        }
        (a, b) => a == b,
    }
}

#[test]
fn packets_answer_as_single_queries_do_bit_for_bit_on_triangles() {
    let meshes = [soup(Faces::Triangles, 300, 0.3, 1), mixed()];
    for (mesh, isa) in meshes.iter().flat_map(|mesh| Isa::ALL.map(|isa| (mesh, isa))) {
        let only_triangles = mesh.parts.iter().all(|part| part.faces == Faces::Triangles);
        for robust in [false, true] {
            let settings = Settings { isa: Some(isa), robust, ..Settings::default() };
            let Some(scene) = scene_if_possible(mesh, &settings) else { continue };
            let mut intersector = scene.intersector().unwrap();
            for coherent in [false, true] {
                // Every length up to two packets and a rest, so every mixture of widths.
                let mut all = queries(2000, 9);
                all.iter_mut().for_each(|query| query.coherent = coherent);
                let mut start = 0;
                let mut length = 0;
                while start + length <= all.len() {
                    let queries = &all[start..start + length];
                    let mut hits = vec![None; length];
                    intersector.closest_hits(queries, &mut hits);
                    let mut occluded = vec![false; length];
                    intersector.occluded_packet(queries, &mut occluded);
                    for (lane, query) in queries.iter().enumerate() {
                        let (hit, single) = (hits[lane], intersector.closest_hit(query));
                        let same = if only_triangles { hit == single } else { alike(hit, single) };
                        assert!(same, "{settings:?} {hit:?} {single:?} {query:?}");
                        assert_eq!(occluded[lane], intersector.occluded(query), "{settings:?} {query:?}");
                    }
                    start += length;
                    length = (length + 1) % 38;
                }
            }
        }
    }
}

#[test]
fn masks_decide_who_sees_what() {
    let mesh = soup(Faces::Triangles, 100, 0.5, 3);
    let scene = Scene::new(&mesh, &Settings::default()).unwrap();
    let mut intersector = scene.intersector().unwrap();
    let hitting = queries(200, 1).into_iter().find(|query| intersector.closest_hit(query).is_some()).unwrap();
    for mask in [1, 0x8000_0000, u32::MAX] {
        assert!(intersector.closest_hit(&Query { mask, ..hitting }).is_some());
    }
    assert_eq!(intersector.closest_hit(&Query { mask: 0, ..hitting }), None);
    assert!(!intersector.occluded(&Query { mask: 0, ..hitting }));
}

#[test]
fn an_empty_interval_is_a_miss_for_both_kinds() {
    let mesh = soup(Faces::Triangles, 200, 0.8, 4);
    let scene = Scene::new(&mesh, &Settings::default()).unwrap();
    let mut intersector = scene.intersector().unwrap();
    for query in queries(500, 2) {
        for (tnear, tfar) in
            [(0.0, f32::NEG_INFINITY), (2.0, 1.0), (f32::INFINITY, f32::INFINITY), (0.0, -1.0)]
        {
            let query = Query { ray: Ray { tnear, tfar, ..query.ray }, ..query };
            assert_eq!(intersector.closest_hit(&query), None);
            assert!(!intersector.occluded(&query));
            let mut occluded = [true; 4];
            intersector.occluded_packet(&[query; 4], &mut occluded);
            assert_eq!(occluded, [false; 4]);
        }
    }
    assert_eq!(intersector.refused(), 0);
}

/// Rays that would end the process: each number that Embree asserts on, in each place, and in company.
fn hostile_rays() -> Vec<Ray> {
    let good = Ray { origin: Vec3::new(0.1, 0.2, -3.0), tnear: 0.0, direction: Vec3::Z, tfar: f32::INFINITY };
    let too_large = 1.844e18f32.next_up();
    let mut rays = Vec::new();
    for bad in
        [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY, too_large, -too_large, f32::MAX, f32::MIN]
    {
        for axis in 0..3 {
            let mut ray = good;
            ray.origin[axis] = bad;
            rays.push(ray);
            let mut ray = good;
            ray.direction[axis] = bad;
            rays.push(ray);
        }
        rays.push(Ray { origin: Vec3::splat(bad), direction: Vec3::splat(bad), ..good });
    }
    for tnear in [f32::NAN, -f32::NAN, f32::NEG_INFINITY, -1.0, -1e-40, f32::MIN] {
        rays.push(Ray { tnear, ..good });
        rays.push(Ray { tnear, tfar: -1.0, ..good });
    }
    for tfar in [f32::NAN, -f32::NAN] {
        rays.push(Ray { tfar, ..good });
        rays.push(Ray { tfar, tnear: 1.0, ..good });
    }
    // NaNs with every kind of payload.
    for bits in (0x7F80_0001u32..0x7FFF_FFFF).step_by(0x7_FFFF) {
        rays.push(Ray { direction: Vec3::new(f32::from_bits(bits), 0.0, 1.0), ..good });
    }
    rays
}

/// Rays that look bad and are not: Embree answers them.
fn odd_rays() -> Vec<Ray> {
    let good = Ray { origin: Vec3::new(0.1, 0.2, -3.0), tnear: 0.0, direction: Vec3::Z, tfar: f32::INFINITY };
    let mut rays = vec![good];
    for odd in [0.0, -0.0, 1e-45, -1e-45, 1e-38, 1e18, 1.844e18, -1.844e18] {
        rays.push(Ray { direction: Vec3::splat(odd), ..good });
        rays.push(Ray { direction: Vec3::new(odd, 0.0, 0.0), ..good });
        rays.push(Ray { origin: Vec3::splat(odd), ..good });
        rays.push(Ray { origin: Vec3::splat(odd), direction: Vec3::splat(-odd), ..good });
        rays.push(Ray { tfar: odd, ..good });
    }
    for tnear in [-0.0, 1e-45, f32::MAX, f32::INFINITY] {
        rays.push(Ray { tnear, ..good });
        rays.push(Ray { tnear, tfar: f32::NEG_INFINITY, ..good });
    }
    rays
}

#[test]
fn no_ray_aborts_and_refused_ones_are_counted() {
    let (hostile, odd) = (hostile_rays(), odd_rays());
    assert!(hostile.len() >= 80, "{}", hostile.len());
    for mesh in [soup(Faces::Triangles, 100, 0.5, 6), grid(Faces::Quads, 4), Mesh::default()] {
        for robust in [false, true] {
            let scene = Scene::new(&mesh, &Settings { robust, ..Settings::default() }).unwrap();
            let mut intersector = scene.intersector().unwrap();
            for ray in &odd {
                let query = Query::new(*ray);
                let hit = intersector.closest_hit(&query);
                assert!(hit.is_none() || (hit.is_some() && intersector.occluded(&query)));
                intersector.closest_hits(&[query; 28], &mut [None; 28]);
                intersector.occluded_packet(&[query; 28], &mut [false; 28]);
            }
            assert_eq!(intersector.refused(), 0);
            for (index, ray) in hostile.iter().enumerate() {
                let query = Query::new(*ray);
                assert_eq!(intersector.closest_hit(&query), None);
                assert!(!intersector.occluded(&query));
                assert_eq!(intersector.refused(), 2 * index as u64 + 2, "{ray:?} was not refused");
            }
            // In packets, beside rays that are answered as if they were alone.
            let refused = intersector.refused();
            let good = queries(hostile.len(), 7);
            let packet: Vec<Query> =
                good.iter().zip(&hostile).flat_map(|(good, &bad)| [*good, Query::new(bad)]).collect();
            let mut hits = vec![
                Some(Hit { t: 0.0, triangle: 0, part: 0, u: 0.0, v: 0.0, normal: Vec3::ZERO });
                packet.len()
            ];
            let mut occluded = vec![true; packet.len()];
            intersector.closest_hits(&packet, &mut hits);
            intersector.occluded_packet(&packet, &mut occluded);
            assert_eq!(intersector.refused(), refused + 2 * hostile.len() as u64);
            for (lane, query) in packet.iter().enumerate() {
                assert!(alike(hits[lane], intersector.closest_hit(query)));
                assert_eq!(occluded[lane], intersector.occluded(query));
            }
        }
    }
}

#[test]
fn one_scene_serves_several_threads() {
    let mesh = soup(Faces::Triangles, 500, 0.3, 8);
    let scene = Scene::new(&mesh, &Settings::default()).unwrap();
    let queries = queries(4000, 3);
    let alone: Vec<_> = {
        let mut intersector = scene.intersector().unwrap();
        queries.iter().map(|query| intersector.closest_hit(query)).collect()
    };
    std::thread::scope(|scope| {
        for _ in 0..4 {
            let mut intersector = scene.intersector().unwrap();
            let (queries, alone) = (&queries, &alone);
            scope.spawn(move || {
                for (query, expected) in queries.iter().zip(alone) {
                    assert_eq!(intersector.closest_hit(query), *expected);
                }
            });
        }
    });
}

#[test]
fn bad_settings_and_meshes_are_errors_that_say_why() {
    let mesh = soup(Faces::Triangles, 10, 0.3, 8);
    let error = |mesh: &Mesh, settings: &Settings| match Scene::new(mesh, settings) {
        Ok(_) => panic!("{settings:?} was accepted"),
        Err(error) => error.to_string(),
    };
    let accel = |name: &str, isa| Settings { tri_accel: Some(name.into()), isa, ..Settings::default() };
    assert!(error(&mesh, &accel("nonsense", None)).contains("nonsense"));
    assert!(error(&mesh, &accel("bvh4.triangle4,verbose=3", None)).contains("unknown triangle structure"));
    assert!(error(&mesh, &accel("bvh4.triangle4\0", None)).contains("unknown triangle structure"));
    assert!(
        error(&mesh, &accel("bvh8.triangle4", Some(Isa::Sse42))).contains("needs the instruction set avx")
    );
    let mut broken = mesh.clone();
    broken.parts[0].indices[4] = broken.vertices.len() as u32;
    assert!(error(&broken, &Settings::default()).contains("names vertex 30, but the mesh has 30 vertices"));
    for isa in Isa::ALL {
        match Scene::new(&mesh, &Settings { isa: Some(isa), ..Settings::default() }) {
            Ok(_) => {}
            Err(error) => {
                assert_eq!(error, EmbreeError::UnsupportedIsa(isa));
                assert!(error.to_string().contains(isa.name()));
            }
        }
    }
    assert_eq!(Scene::version(), 31305);
}
