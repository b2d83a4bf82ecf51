//! What a `.bvh` keeps once its reader has accepted it.

use super::check_line;
use embree_trace::format::bvh::{self, Bvh, Contents, Geometry, flag, geometry_kind};
use embree_trace::geometry::{Ray, Triangle, Vec3};
use embree_trace::traverse::{All, Counts, Hit, Prepared, PreparedRay, Scratch, Traversal};

/// Triangles whose coordinates stay below this are asked for hits: beyond, products of coordinates leave the range of `f32`.
const MODERATE: f32 = 1e6;

/// Reads any bytes as a `.bvh`.
///
/// # Panics
/// Where a promise of the reader does not hold.
pub fn check(bytes: &[u8]) {
    // Aligned as a map is, wherever the fuzzer's bytes lie.
    let mut words = vec![0u64; bytes.len().div_ceil(8)];
    let aligned = &mut bytemuck::cast_slice_mut::<_, u8>(&mut words)[..bytes.len()];
    aligned.copy_from_slice(bytes);
    let bvh = match Bvh::parse(aligned) {
        Ok(bvh) => bvh,
        Err(error) => return check_line(&error),
    };
    check_sections(&bvh, bytes.len() as u64);
    let depth = check_tree(&bvh);
    check_geometries(bvh.geometries, bvh.triangles.len());
    assert_eq!((bvh.statistics.nodes, bvh.statistics.depth), (bvh.tree.nodes.len(), depth));
    if let Some(order) = bvh.order {
        assert!(order.len() == bvh.tree.nodes.len() && order.iter().all(|&value| value <= 3));
    }
    let verified = bvh.verify();
    match &verified {
        Ok(_) => check_verified(&bvh),
        Err(error) => check_line(error),
    }
    check_traversal(&bvh, verified.is_ok());
    check_written(&bvh, verified.is_ok());
}

/// Sections lie in the file and share no byte.
fn check_sections(bvh: &Bvh, length: u64) {
    let mut ranges = Vec::new();
    for section in &bvh.sections {
        assert!(section.offset.is_multiple_of(64) && section.offset + section.bytes() <= length);
        if section.bytes() > 0 {
            ranges.push(section.offset..section.offset + section.bytes());
        }
    }
    ranges.sort_by_key(|range| range.start);
    assert!(ranges.is_sorted_by(|a, b| a.end <= b.start));
}

/// Walks the tree from its root: every node and every entry of `PRIM` is reached once. The depth.
fn check_tree(bvh: &Bvh) -> usize {
    let nodes = bvh.tree.nodes;
    let (mut nodes_seen, mut entries_seen) =
        (vec![false; nodes.len()], vec![false; bvh.tree.primitives.len()]);
    let mut stack = vec![(0, 1)];
    let mut depth = 0;
    while let Some((index, level)) = stack.pop() {
        assert!(!std::mem::replace(&mut nodes_seen[index], true));
        depth = depth.max(level);
        let node = &nodes[index];
        assert!(!node.lower.is_nan() && !node.upper.is_nan());
        if node.is_leaf() {
            for entry in node.range() {
                assert!(!std::mem::replace(&mut entries_seen[entry], true));
                assert!((bvh.tree.primitives[entry] as usize) < bvh.triangles.len());
            }
        } else {
            stack.extend(node.range().map(|child| (child, level + 1)));
        }
    }
    assert!(nodes_seen.iter().all(|&seen| seen) && entries_seen.iter().all(|&seen| seen));
    depth
}

fn check_geometries(geometries: &[Geometry], triangles: usize) {
    let mut end = 0;
    for geometry in geometries {
        assert!(geometry.first_triangle as usize >= end);
        end = geometry.first_triangle as usize + geometry.triangle_count as usize;
        assert!(geometry.kind <= geometry_kind::QUADS);
        assert!(geometry.kind == geometry_kind::TRIANGLES || geometry.triangle_count % 2 == 0);
    }
    assert!(end <= triangles);
}

/// What `verify` took is so: finite triangles stand in leaves whose boxes hold them.
fn check_verified(bvh: &Bvh) {
    let clipped = bvh.header.flags & flag::SPATIAL_SPLITS != 0;
    let mut leaves = vec![0; bvh.triangles.len()];
    for node in bvh.tree.nodes {
        for index in node.range() {
            if !node.is_leaf() {
                let child = bvh.tree.nodes[index].bounds();
                assert!(child.is_empty() || node.bounds().contains(&child));
                continue;
            }
            let triangle = bvh.tree.primitives[index] as usize;
            assert!(clipped || node.bounds().contains(&bvh.triangles[triangle].bounds()));
            leaves[triangle] += 1;
        }
    }
    for (triangle, leaves) in bvh.triangles.iter().zip(leaves) {
        let right = if clipped { leaves > 0 } else { leaves == 1 };
        assert!(if triangle.is_finite() { right } else { leaves == 0 });
    }
}

/// Every traversal of an accepted tree ends; over a verified one without clipped boxes, all give the same answer.
fn check_traversal(bvh: &Bvh, verified: bool) {
    let prepared = Prepared::new(bvh.tree, bvh.triangles, bvh.geometries);
    let clipped = bvh.header.flags & flag::SPATIAL_SPLITS != 0;
    let comparable = verified && !clipped && bvh.triangles.iter().all(is_moderate);
    let mut scratch = Scratch::default();
    for ray in rays(bvh.triangles) {
        let sensible = ray.origin.is_finite() && ray.direction.is_finite() && ray.direction != Vec3::ZERO;
        let ray = PreparedRay::new(&ray);
        let mut counts = Counts::default();
        let closest =
            Traversal::ALL.map(|order| prepared.closest_hit(order, &ray, &All, &mut counts, &mut scratch));
        let any = Traversal::ALL.map(|order| prepared.occluder(order, &ray, &All, &mut counts, &mut scratch));
        if comparable && sensible {
            let bits = |hit: Option<Hit>| hit.map(|hit| (hit.t.to_bits(), hit.triangle));
            assert_eq!(bits(closest[0]), bits(closest[1]));
            assert!(any.iter().all(|hit| hit.is_some() == closest[0].is_some()));
        }
    }
}

fn is_moderate(triangle: &Triangle) -> bool {
    triangle.0.iter().all(|vertex| vertex.abs().max_element() < MODERATE)
}

/// A few rays towards triangles, and some that have no sense.
fn rays(triangles: &[Triangle]) -> Vec<Ray> {
    let mut rays = vec![
        Ray { origin: Vec3::splat(-3.0), tnear: 0.0, direction: Vec3::ONE, tfar: f32::INFINITY },
        Ray { origin: Vec3::ZERO, tnear: 0.0, direction: Vec3::X, tfar: 10.0 },
        Ray { origin: Vec3::splat(f32::NAN), tnear: f32::NAN, direction: Vec3::ZERO, tfar: f32::NAN },
        Ray {
            origin: Vec3::splat(f32::INFINITY),
            tnear: 1.0,
            direction: Vec3::NEG_Y,
            tfar: f32::NEG_INFINITY,
        },
    ];
    for triangle in triangles.iter().take(4) {
        let origin = Vec3::new(5.0, -7.0, 11.0);
        rays.push(Ray { origin, tnear: 0.0, direction: triangle.centroid() - origin, tfar: f32::INFINITY });
    }
    rays
}

/// What was read can be written, is the same when read again, and makes the same bytes the next time.
fn check_written(bvh: &Bvh, verified: bool) {
    let first = write(bvh);
    let again = match Bvh::parse(&first) {
        Ok(again) => again,
        Err(error) => panic!("our own file is refused: {error}"),
    };
    let raw = |bvh: &Bvh| -> [Vec<u8>; 4] {
        [
            bytemuck::cast_slice(bvh.tree.nodes).to_vec(),
            bytemuck::cast_slice(bvh.tree.primitives).to_vec(),
            bytemuck::cast_slice(bvh.triangles).to_vec(),
            bytemuck::cast_slice(bvh.geometries).to_vec(),
        ]
    };
    assert_eq!(raw(&again), raw(bvh));
    assert_eq!((again.order, again.meta), (bvh.order, bvh.meta));
    assert_eq!(again.statistics, bvh.statistics);
    let (before, after) = (&bvh.header, &again.header);
    assert_eq!((after.fingerprint, after.flags), (before.fingerprint, before.flags));
    assert_eq!((after.max_leaf, after.depth), (before.max_leaf, before.depth));
    assert_eq!(again.verify().is_ok(), verified);
    assert_eq!(write(&again), first, "the same content makes the same bytes");
}

fn write(bvh: &Bvh) -> Vec<u8> {
    let Bvh { tree, triangles, geometries, order, meta, .. } = *bvh;
    let Bvh { header, .. } = bvh;
    let contents = Contents {
        tree,
        triangles,
        geometries,
        order,
        meta,
        flags: header.flags,
        producer: &header.producer,
    };
    let mut bytes = Vec::new();
    match bvh::write(&mut bytes, &contents) {
        Ok(fingerprint) => assert_eq!(fingerprint, header.fingerprint),
        Err(error) => panic!("the writer refuses what the reader took: {error}"),
    }
    bytes
}
