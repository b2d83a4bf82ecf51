//! The judge: of answers made wrong none passes, of Embree's true ones none is called wrong.
//!
//! What is wrong is decided here without the code under test: brute force over all triangles in double precision, the closest point of a
//! triangle by its regions, and the rounding that README states. An altered answer that happens to be right, or that may be, is not counted.

use crate::compare_support::*;
use embree_trace::embree::{EmbreeError, Isa, Query, Scene, Settings};
use embree_trace::format::rays::{NO_TRIANGLE, Record, flag, kind};
use embree_trace::geometry::{DVec3, Ray, Triangle, Vec3};
use embree_trace::mesh::{Faces, Material, Mesh, Part};
use embree_trace::replay::check::{Judge, Verdict};
use embree_trace::traverse::{All, Hit, Masks, Prepared, PreparedRay, Scratch, Traversal};

/// Rounding as README states it: 16 units of 2⁻²⁴ of the distance of the farthest corner from the ray's origin.
fn rounding(ray: &Ray, triangle: &Triangle) -> f64 {
    let o = ray.origin.as_dvec3();
    let farthest = triangle.0.map(|corner| corner.as_dvec3().distance(o)).into_iter().fold(0.0, f64::max);
    16.0 / f64::from(1 << 24) * farthest
}

/// Distance of a point from a triangle: from the plane over the triangle, else from the nearest edge.
fn distance(point: DVec3, triangle: &Triangle) -> f64 {
    let corners = triangle.0.map(|corner| corner.as_dvec3());
    let [a, b, c] = corners;
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let edges = [(a, b), (b, c), (c, a)];
    let over = edges.iter().all(|&(start, end)| (end - start).cross(point - start).dot(normal) > 0.0);
    if over {
        return normal.dot(point - a).abs();
    }
    let from_edge = |(start, end): (DVec3, DVec3)| {
        let along = end - start;
        let share = (along.dot(point - start) / along.length_squared()).clamp(0.0, 1.0);
        point.distance(if share.is_finite() { start + share * along } else { start })
    };
    edges.map(from_edge).into_iter().fold(f64::INFINITY, f64::min)
}

/// Distance between a triangle and what the interval leaves of a ray.
fn clearance(ray: &Ray, triangle: &Triangle) -> f64 {
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let (tnear, tfar) = (f64::from(ray.tnear), f64::from(ray.tfar));
    if exact(ray, triangle).is_some_and(|hit| hit.margin >= 0.0 && hit.t >= tnear && hit.t <= tfar) {
        return 0.0;
    }
    let corners = triangle.0.map(|corner| corner.as_dvec3());
    // Two segments: the nearest parameter on one, then on the other, each clamped to its own, and once more (Ericson, *Real-Time Collision
    // Detection*, 2005, section 5.1.9).
    let from_edge = |start: usize| {
        let (a, edge) = (corners[start], corners[(start + 1) % 3] - corners[start]);
        let (dd, ee, de) = (d.length_squared(), edge.length_squared(), d.dot(edge));
        let between = o - a;
        let (along_ray, along_edge) = (d.dot(between), edge.dot(between));
        let denominator = dd * ee - de * de;
        let t = if denominator > 0.0 { (de * along_edge - along_ray * ee) / denominator } else { 0.0 };
        let t = t.clamp(tnear, tfar);
        let s = if ee > 0.0 { ((de * t + along_edge) / ee).clamp(0.0, 1.0) } else { 0.0 };
        let t = ((de * s - along_ray) / dd).clamp(tnear, tfar);
        (o + t * d).distance(a + s * edge)
    };
    let ends =
        [tnear, tfar].into_iter().filter(|end| end.is_finite()).map(|end| distance(o + end * d, triangle));
    (0..3).map(from_edge).chain(ends).fold(f64::INFINITY, f64::min)
}

/// Whether the ray passes a triangle's inside before `end` by more than twice what rounding and boxes may do.
fn passes(ray: &Ray, triangle: &Triangle, end: f64) -> bool {
    let Some(hit) = exact(ray, triangle) else { return false };
    let corners = triangle.0.map(|corner| corner.as_dvec3());
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let largest = corners.iter().fold(o.abs(), |most, corner| most.max(corner.abs())).max_element();
    let margin = 2.0 * rounding(ray, triangle) + 8.0 / f64::from(1 << 24) * largest;
    let [a, b, c] = corners;
    let point = o + hit.t * d;
    let depth = [(a, b), (b, c), (c, a)]
        .map(|(start, end)| (end - start).cross(point - start).length() / (end - start).length())
        .into_iter()
        .fold(f64::INFINITY, f64::min);
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    // An angle beside 1e-2 or an aspect beside 1e-3 is left to others; there rounding grows, and how much is the judge's to say.
    hit.margin > 0.0
        && hit.cosine > 1e-2
        && depth > 1e-3 * longest
        && depth * hit.cosine > 4.0 * margin
        && (hit.t - f64::from(ray.tnear)) * d.length() * hit.cosine > 4.0 * margin
        && (end - hit.t) * d.length() * hit.cosine > 4.0 * margin
}

/// Whether an answer is off by so many roundings.
fn is_wrong(record: &Record, triangles: &[Triangle], roundings: f64) -> bool {
    let ray = record.ray();
    let passed = |end: f64| triangles.iter().any(|triangle| passes(&ray, triangle, end));
    let tfar = f64::from(ray.tfar);
    if record.is_occlusion() {
        let far = |triangle: &Triangle| clearance(&ray, triangle) > roundings * rounding(&ray, triangle);
        return if record.is_hit() { triangles.iter().all(far) } else { passed(tfar) };
    }
    if !record.is_hit() {
        return passed(tfar);
    }
    let Some(triangle) = triangles.get(record.triangle as usize) else { return true };
    let t = f64::from(record.t);
    if !t.is_finite() || t < f64::from(ray.tnear) * (1.0 - 1e-5) || t > tfar * (1.0 + 1e-5) {
        return true;
    }
    let point = ray.origin.as_dvec3() + t * ray.direction.as_dvec3();
    distance(point, triangle) > roundings * rounding(&ray, triangle) || passed(t)
}

fn mesh_of(triangles: &[Triangle]) -> Mesh {
    let vertices: Vec<Vec3> = triangles.iter().flat_map(|triangle| triangle.0).collect();
    let indices = (0..vertices.len() as u32).collect();
    let part = Part { name: "all".into(), material: 0, faces: Faces::Triangles, indices };
    Mesh { vertices, parts: vec![part], materials: vec![Material::default()] }
}

/// Scenes with slivers, with edges and planes in common, far from the origin, small and large.
fn hard_scenes() -> Vec<(&'static str, Vec<Triangle>)> {
    let random = &mut Random(2);
    let soup = soup(200, 0.3, random);
    let moved = |by: Vec3, scale: f32| -> Vec<Triangle> {
        soup.iter().map(|triangle| Triangle(triangle.0.map(|v| scale * v + by))).collect()
    };
    let cells = height_field(7, 0.2, random);
    vec![
        ("height field", height_field(10, 0.1, random)),
        ("flat plane", height_field(8, 0.0, random)),
        ("slivers", slivers(150, random)),
        ("coincident", coincident(&cells)),
        ("at 1 km", moved(Vec3::splat(1e3), 1.0)),
        ("at 1,000 km", moved(Vec3::new(1e6, 0.0, -3e5), 20.0)),
        ("small", moved(Vec3::ZERO, 1e-3)),
        ("large", moved(Vec3::ZERO, 1e4)),
        ("soup", soup),
    ]
}

/// Rays that meet planes at angles from a tenth down to nothing, in the triangle or beside it.
fn flat_rays(triangles: &[Triangle], count: usize, random: &mut Random) -> Vec<Ray> {
    (0..count)
        .map(|i| {
            let Triangle([a, b, c]) = triangles[random.below(triangles.len())];
            let across = (b - a).cross(c - a).normalize_or_zero();
            let target = a.lerp(b, 0.6 * random.signed() + 0.5).lerp(c, 0.3);
            let size = a.distance(b);
            let along = (b - a) * random.signed() + (c - a) * random.signed();
            let tilt = [0.0, 1e-8, 1e-6, 1e-4, 1e-2, 0.1][i % 6];
            let origin = target - 3.0 * along + tilt * size * across;
            Ray { origin, tnear: 0.0, direction: target - origin, tfar: f32::INFINITY }
        })
        .filter(|ray| ray.direction != Vec3::ZERO)
        .collect()
}

fn record(ray: &Ray, kind: u8, hit: Option<(f32, u32)>) -> Record {
    Record {
        origin: ray.origin,
        tnear: ray.tnear,
        direction: ray.direction,
        tfar: ray.tfar,
        mask: u32::MAX,
        t: hit.map_or(f32::INFINITY, |(t, _)| t),
        triangle: hit.map_or(NO_TRIANGLE, |(_, triangle)| triangle),
        kind,
        flags: if hit.is_some() { flag::HIT } else { 0 },
        ..bytemuck::Zeroable::zeroed()
    }
}

/// What is not so: other distances, other triangles, hits for misses and misses for hits.
fn altered(truth: &Record, triangles: &[Triangle], random: &mut Random) -> Vec<Record> {
    let ray = truth.ray();
    if truth.is_occlusion() {
        let hit = (!truth.is_hit()).then_some((f32::NEG_INFINITY, NO_TRIANGLE));
        return vec![record(&ray, kind::OCCLUSION, hit)];
    }
    let other = random.below(triangles.len()) as u32;
    let hit = |t: f32, triangle: u32| record(&ray, kind::CLOSEST_HIT, Some((t, triangle)));
    // Where the ray meets the plane of another triangle, and where it comes nearest to its corner.
    let plane = exact(&ray, &triangles[other as usize]).map_or(1.0, |hit| hit.t as f32);
    let towards = triangles[other as usize].0[0] - ray.origin;
    let nearest = towards.dot(ray.direction) / ray.direction.length_squared();
    let mut made = vec![hit(plane, other), hit(nearest, other), hit(random.signed().abs() * 5.0, other)];
    if !truth.is_hit() {
        return made;
    }
    let (t, named) = (truth.t, truth.triangle);
    made.push(record(&ray, kind::CLOSEST_HIT, None));
    made.extend(
        [0.0, -1.0, 0.5, 0.9, 0.99, 0.9999, 1.0001, 1.01, 2.0, 100.0, 1e5].map(|by| hit(by * t, named)),
    );
    made.extend([f32::NAN, f32::INFINITY, f32::NEG_INFINITY].map(|t| hit(t, named)));
    made.extend([other, named ^ 1, named + 1, u32::MAX - 1].map(|triangle| hit(t, triangle)));
    // Ten times the rounding off the plane, and as much along the ray.
    if let Some(exact) = exact(&ray, &triangles[named as usize]) {
        let step = 10.5 * rounding(&ray, &triangles[named as usize]) / f64::from(ray.direction.length());
        let by = [step, -step, step / exact.cosine, -step / exact.cosine];
        made.extend(by.map(|by| hit((exact.t + by) as f32, named)));
    }
    made
}

/// Rays of each scene that are not made flat.
const ORDINARY: usize = 3000;

#[test]
fn no_wrong_answer_passes_and_no_right_one_is_called_wrong() {
    // Of ordinary rays, and of those in a triangle's plane or nearly so.
    let (mut right, mut borderline, mut not_right) = ([0u32; 2], [0u32; 2], [0u32; 2]);
    let mut wrong = 0u32;
    let random = &mut Random(31);
    let scratch = &mut Scratch::default();
    for (name, triangles) in hard_scenes() {
        let tree = random_tree(&triangles, 4, 2, random);
        let prepared = Prepared::new(tree.view(), &triangles, &[]);
        let judge =
            Judge { tree: tree.view(), triangles: &triangles, masks: Masks::new(&[]), flattened: false };
        let mut rays = rays(&triangles, ORDINARY, random);
        rays.extend(flat_rays(&triangles, 600, random));
        for (isa, robust) in Isa::ALL.into_iter().flat_map(|isa| [(isa, false), (isa, true)]) {
            let settings = Settings { isa: Some(isa), robust, ..Settings::default() };
            let scene = match Scene::new(&mesh_of(&triangles), &settings) {
                Err(EmbreeError::UnsupportedIsa(_)) => continue,
                scene => scene.expect("a scene"),
            };
            let mut intersector = scene.intersector().expect("an intersector");
            for (number, ray) in rays.iter().enumerate() {
                let flat = usize::from(number >= ORDINARY);
                let query = PreparedRay::new(ray);
                let asked = Query::new(*ray);
                let closest = intersector.closest_hit(&asked).map(|hit| (hit.t, hit.triangle));
                let occluded = intersector.occluded(&asked).then_some((f32::NEG_INFINITY, NO_TRIANGLE));
                let found = prepared.closest_hit(Traversal::Odf, &query, &All, &mut (), scratch);
                let occluder = prepared.occluder(Traversal::Odf, &query, &All, &mut (), scratch);
                for (truth, answer) in [
                    (record(ray, kind::CLOSEST_HIT, closest), found),
                    (record(ray, kind::OCCLUSION, occluded), occluder),
                ] {
                    let verdict =
                        |record: &Record, answer: Option<Hit>| judge.judge(record, ray, answer, &All);
                    let said = || format!("{name} {isa:?} {robust} {truth:?} {answer:?}");
                    right[flat] += 1;
                    match verdict(&truth, answer) {
                        Verdict::Agrees => {}
                        Verdict::Borderline => borderline[flat] += 1,
                        _ => {
                            // Nothing but a ray in a triangle's plane makes single precision answer so: Embree, or us.
                            let ours =
                                answer.map(|hit| record(ray, kind::CLOSEST_HIT, Some((hit.t, hit.triangle))));
                            let blame = [Some(truth), ours].into_iter().flatten();
                            assert!(
                                blame.into_iter().any(|answer| is_wrong(&answer, &triangles, 4.0)),
                                "{} is right",
                                said()
                            );
                            not_right[flat] += 1;
                        }
                    }
                    if number % 40 != 0 {
                        continue;
                    }
                    for altered in altered(&truth, &triangles, random) {
                        if is_wrong(&altered, &triangles, 10.0) {
                            wrong += 1;
                            assert_eq!(
                                verdict(&altered, answer),
                                Verdict::Mismatch,
                                "{}: {altered:?}",
                                said()
                            );
                        }
                    }
                }
            }
        }
    }
    let numbers =
        format!("right {right:?}, borderline {borderline:?}, not right {not_right:?}, wrong {wrong}");
    assert!(not_right[0] * 10_000 < right[0] && not_right[1] * 20 < right[1], "too many: {numbers}");
    assert!(wrong >= 100_000 && right[0] >= 100_000 && right[1] >= 10_000, "too few: {numbers}");
}
