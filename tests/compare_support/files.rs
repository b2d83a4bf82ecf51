//! Files as a recording program would write them: a scene, a tree, queries, and answers by brute force.

use super::{Random, exact, random_tree, rays, truth};
use embree_trace::format::bvh::{self, Contents, Geometry, NO_INSTANCE};
use embree_trace::format::rays::{
    ChunkInfo, Codec, Header, NO_TRIANGLE, Purpose, RaysWriter, Record, Reject, flag, kind,
};
use embree_trace::geometry::Triangle;
use embree_trace::tree::Tree;

/// Two halves of the triangles, seen by masks 1 and 2.
pub fn geometries(triangles: &[Triangle]) -> [Geometry; 2] {
    let half = triangles.len() as u32 / 2;
    let geometry = |geometry, first_triangle, triangle_count, mask| Geometry {
        instance: NO_INSTANCE,
        geometry,
        first_triangle,
        triangle_count,
        mask,
        kind: 0,
        flags: 0,
        instance_mask: 0,
    };
    [geometry(0, 0, half, 1), geometry(1, half, triangles.len() as u32 - half, 2)]
}

/// A `.bvh` of a random tree.
pub fn bvh_bytes(
    triangles: &[Triangle],
    width: usize,
    max_leaf: usize,
    seed: u64,
    meta: Option<&str>,
) -> Vec<u8> {
    tree_bytes(triangles, &random_tree(triangles, width, max_leaf, &mut Random(seed)), meta)
}

pub fn tree_bytes(triangles: &[Triangle], tree: &Tree, meta: Option<&str>) -> Vec<u8> {
    let mut bytes = Vec::new();
    let geometries = geometries(triangles);
    let contents = Contents {
        tree: tree.view(),
        triangles,
        geometries: &geometries,
        order: None,
        meta,
        flags: 0,
        producer: "a test",
    };
    bvh::write(&mut bytes, &contents).expect("writing to memory");
    bytes
}

/// Size of the image that the records belong to.
pub const IMAGE: [u32; 2] = [16, 12];

/// `count` queries of all kinds, depths and purposes, some with masks and rejects, answered by a loop over all triangles.
/// Rays on which double precision does not settle the answer are left out.
pub fn records(triangles: &[Triangle], count: usize, seed: u64) -> (Vec<Record>, Vec<Reject>) {
    let half = triangles.len() as u32 / 2;
    let (mut records, mut rejects) = (Vec::new(), Vec::new());
    for (i, ray) in rays(triangles, 3 * count, &mut Random(seed)).iter().enumerate() {
        let mask = [u32::MAX, u32::MAX, 1, 2][i % 4];
        let sees = |index: u32| mask & if index < half { 1 } else { 2 } != 0;
        let mut rejected = None;
        let mut found = truth(ray, triangles, sees);
        if i % 7 == 0 && found.certain.is_finite() {
            rejected = nearest(&found.possible);
            found = truth(ray, triangles, |index| sees(index) && Some(index) != rejected);
        }
        // Settled: nothing possible but far misses, or the nearest possible hit is certain, and alone at its place.
        let nearest = nearest(&found.possible);
        let settled = found.possible.iter().all(|(_, t)| t.is_finite())
            && match nearest {
                None => true,
                Some(index) => {
                    let t = exact(ray, &triangles[index as usize]).map_or(f64::NAN, |hit| hit.t);
                    let alone =
                        found.possible.iter().filter(|(_, other)| *other <= t * 1.001 + 1e-4).count() == 1;
                    alone && found.certain >= t && found.certain <= t * 1.001 + 1e-4
                }
            };
        if !settled || records.len() == count {
            continue;
        }
        let occlusion = i % 3 == 1;
        let t = nearest.and_then(|index| exact(ray, &triangles[index as usize])).map(|hit| hit.t as f32);
        rejects.extend(rejected.map(|triangle| Reject { record: records.len() as u32, triangle }));
        records.push(Record {
            origin: ray.origin,
            tnear: ray.tnear,
            direction: ray.direction,
            tfar: ray.tfar,
            time: 0.0,
            mask,
            t: match (occlusion, t) {
                (true, Some(_)) => f32::NEG_INFINITY,
                (false, Some(t)) => t,
                (_, None) => f32::INFINITY,
            },
            triangle: if occlusion { NO_TRIANGLE } else { nearest.unwrap_or(NO_TRIANGLE) },
            u: 0.0,
            v: 0.0,
            path: records.len() as u32 % (IMAGE[0] * IMAGE[1]),
            kind: if occlusion { kind::OCCLUSION } else { kind::CLOSEST_HIT },
            depth: (i / 3 % 3) as u8,
            flags: nearest.map_or(0, |_| flag::HIT) | rejected.map_or(0, |_| flag::HAS_REJECTS),
            purpose: if occlusion { Purpose::Shadow } else { [Purpose::Camera, Purpose::Diffuse][i % 2] }
                as u8,
        });
    }
    assert_eq!(records.len(), count, "too many unsettled rays");
    (records, rejects)
}

fn nearest(possible: &[(u32, f64)]) -> Option<u32> {
    possible.iter().min_by(|a, b| a.1.total_cmp(&b.1)).map(|(index, _)| *index)
}

/// A `.rays` with a chunk per `chunk` records.
pub fn rays_bytes(fingerprint: u64, records: &[Record], rejects: &[Reject], chunk: usize) -> Vec<u8> {
    scenes_bytes(fingerprint, &[(records, rejects)], chunk)
}

/// A `.rays` of several scenes, numbered in their order, with a chunk per `chunk` records.
pub fn scenes_bytes(fingerprint: u64, scenes: &[(&[Record], &[Reject])], chunk: usize) -> Vec<u8> {
    let header =
        Header { fingerprint, embree_version: 0, deterministic: true, producer: "a test".to_owned() };
    let mut writer = RaysWriter::new(Vec::new(), &header).expect("writing to memory");
    let mut sequence = 0;
    for (scene, (records, rejects)) in (0..).zip(scenes) {
        for (number, part) in records.chunks(chunk).enumerate() {
            let start = (number * chunk) as u32;
            let own: Vec<Reject> = rejects
                .iter()
                .filter(|reject| (start..start + part.len() as u32).contains(&reject.record))
                .map(|reject| Reject { record: reject.record - start, ..*reject })
                .collect();
            let info = ChunkInfo { scene, thread: 0, sequence };
            sequence += part.len() as u64;
            let codec = if number % 2 == 0 { Codec::Raw } else { Codec::Compressed };
            writer.write_chunk(&info, part, &own, codec).expect("writing to memory");
        }
    }
    writer.finish().expect("writing to memory").0
}
