//! Rays per second of binary trees, ours beside other crates', on recorded queries by purpose:
//! `cargo bench --bench replay -- [BVH RAYS]…`, with files that `embree-trace` wrote. Without any, a generated scene and
//! queries that our own traversal answers.
//!
//! Not criterion: it measures one contender after the other, and a shared machine drifts meanwhile. Here every round
//! runs each contender once on the same queries; the table shows medians over rounds, in million queries per processor
//! second of one thread, and how many answers are those of the recording.

mod casters;
#[allow(dead_code, reason = "of some crates only the traversal takes part here, and of some only the tree")]
mod peers;

use casters::*;
use embree_trace::builder::{self, Config, Splits};
use embree_trace::files::MappedFile;
use embree_trace::format::bvh::Bvh;
use embree_trace::format::rays::{Purpose, Rays, Record, flag, kind};
use embree_trace::geometry::{Triangle, Vec3};
use embree_trace::mesh::generate::courtyard;
use embree_trace::progress::Progress;
use embree_trace::random::Random;
use embree_trace::traverse::{All, Counts, Prepared, PreparedRay, Scratch, Traversal};
use obvhs::BvhBuildParams;
use peers::Peer;
use peers::obvhs_crate::Obvhs;
use std::path::Path;

const ROUNDS: usize = 7;
/// Queries of each purpose, spread over the recording.
const QUERIES: usize = 100_000;

fn main() {
    let paths: Vec<String> =
        std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    if paths.is_empty() {
        let triangles = courtyard(64, 1).triangles();
        let records = made_up(&triangles);
        compare("generated courtyard", &triangles, &records);
    }
    for pair in paths.chunks(2) {
        let [bvh_path, rays_path] = pair else {
            eprintln!("expected pairs of a .bvh and a .rays");
            return;
        };
        let (bvh, rays) = (open(bvh_path), open(rays_path));
        let bvh = Bvh::parse(&bvh).expect("a .bvh");
        let rays = Rays::parse(&rays).expect("a .rays");
        let records: Vec<Record> = (0..rays.chunks().len())
            .flat_map(|index| rays.chunk(index).expect("a whole chunk").records.into_owned())
            .collect();
        compare(bvh_path, bvh.triangles, &records);
    }
}

fn open(path: &str) -> MappedFile {
    MappedFile::open(Path::new(path)).expect("a readable file")
}

fn compare(name: &str, triangles: &[Triangle], records: &[Record]) {
    let build =
        |config| builder::build(triangles, &config, &Progress::hidden()).expect("a valid configuration");
    let binned = Prepared::new(build(Config::default()).view(), triangles, &[]);
    let leaves = Prepared::new(build(Config { max_leaf: 4, ..Config::default() }).view(), triangles, &[]);
    let sweep =
        Prepared::new(build(Config { splits: Splits::Sweep, ..Config::default() }).view(), triangles, &[]);
    let medium = Obvhs(BvhBuildParams::medium_build());
    let theirs = Obvhs::tree(&medium.build(&mut Obvhs::prepare(triangles)));
    let on_theirs = Prepared::new(theirs.view(), triangles, &[]);
    let corners: Vec<[f32; 4]> = triangles.iter().flat_map(|t| t.0.map(|v| [v.x, v.y, v.z, 0.0])).collect();
    let tiny = tinybvh_rs::bvh::BVH::new(corners.as_slice().into()).expect("whole triangles");
    let (odf, ray_order) = (Traversal::Odf, Traversal::RayOrder);
    let mut contenders: Vec<(&str, Runner)> = vec![
        ("ours ODF", runner(Ours::<()>::new(&binned, odf))),
        ("ours ODF, counting", runner(Ours::<Counts>::new(&binned, odf))),
        ("ours RayOrder", runner(Ours::<()>::new(&binned, ray_order))),
        ("ours RayOrder, counting", runner(Ours::<Counts>::new(&binned, ray_order))),
        ("ours ODF, leaf 4", runner(Ours::<()>::new(&leaves, odf))),
        ("ours ODF, sweep", runner(Ours::<()>::new(&sweep, odf))),
        ("ours ODF, obvhs' tree", runner(Ours::<()>::new(&on_theirs, odf))),
        ("obvhs medium", runner(ObvhsCaster::new(triangles, BvhBuildParams::medium_build()))),
        ("obvhs very slow", runner(ObvhsCaster::new(triangles, BvhBuildParams::very_slow_build()))),
        ("tinybvh-rs", runner(TinyBvhCaster(tiny))),
        ("parry3d", runner(ParryCaster::new(triangles))),
        ("bvh", runner(BvhCrateCaster::new(triangles))),
    ];
    for purpose in Purpose::ALL {
        let chosen: Vec<Record> = records
            .iter()
            .filter(|r| Purpose::from_byte(r.purpose) == purpose && r.flags & flag::HAS_REJECTS == 0)
            .copied()
            .collect();
        let queries: Vec<Record> =
            chosen.iter().step_by(chosen.len().div_ceil(QUERIES).max(1)).copied().collect();
        if queries.is_empty() {
            continue;
        }
        let mut seconds = vec![Vec::new(); contenders.len()];
        let mut right = vec![0; contenders.len()];
        for _ in 0..ROUNDS {
            for (index, (_, run)) in contenders.iter_mut().enumerate() {
                let before = processor_seconds();
                right[index] = run(&queries);
                seconds[index].push(processor_seconds() - before);
            }
        }
        println!("\n{name}, {} triangles, {}: {} queries", triangles.len(), purpose.name(), queries.len());
        println!("{:<26}{:>12}{:>10}{:>10}", "", "M queries/s", "spread", "wrong");
        for (((name, _), mut seconds), right) in contenders.iter().zip(seconds).zip(right) {
            seconds.sort_by(f64::total_cmp);
            let rate = |seconds: f64| queries.len() as f64 * 1e-6 / seconds;
            let spread = (rate(seconds[0]) - rate(seconds[ROUNDS - 1])) / rate(seconds[ROUNDS / 2]);
            println!(
                "{name:<26}{:>12.3}{:>9.0}%{:>10}",
                rate(seconds[ROUNDS / 2]),
                100.0 * spread,
                queries.len() - right
            );
        }
    }
}

/// Casts all queries, and counts the answers that are the recorded ones.
type Runner<'a> = Box<dyn FnMut(&[Record]) -> usize + 'a>;

fn runner<'a>(mut caster: impl Caster + 'a) -> Runner<'a> {
    Box::new(move |records| {
        let mut right = 0;
        for record in records {
            right += if record.is_occlusion() {
                caster.occluded(record) == record.is_hit()
            } else {
                let t = caster.closest(record);
                if record.is_hit() {
                    (t - record.t).abs() <= 1e-3 * record.t
                } else {
                    t.is_nan() || t >= record.tfar
                }
            } as usize;
        }
        right
    })
}

/// Time that this thread has spent on a processor, from Linux; elsewhere the wall clock.
fn processor_seconds() -> f64 {
    let spent = || {
        let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        text.split(' ').next()?.parse::<u64>().ok()
    };
    match spent() {
        Some(nanoseconds) => nanoseconds as f64 * 1e-9,
        None => std::time::SystemTime::now()
            .duration_since(std::time::UNIX_EPOCH)
            .map_or(0.0, |elapsed| elapsed.as_secs_f64()),
    }
}

/// Camera rays over a grid, a bounce and a shadow ray from each hit.
fn made_up(triangles: &[Triangle]) -> Vec<Record> {
    let tree =
        builder::build(triangles, &Config::default(), &Progress::hidden()).expect("a valid configuration");
    let prepared = Prepared::new(tree.view(), triangles, &[]);
    let bounds = tree.nodes[0].bounds();
    let eye = bounds.center() + 0.2 * bounds.extent() * Vec3::new(-1.0, 0.3, 0.7);
    let sun = bounds.center() + bounds.extent() * Vec3::new(0.3, 1.5, 0.2);
    let random = &mut Random::new(1);
    let scratch = &mut Scratch::default();
    let mut records = Vec::new();
    let mut ask = |origin: Vec3, direction: Vec3, tfar: f32, purpose: Purpose| {
        let occlusion = purpose == Purpose::Shadow;
        let mut record: Record = bytemuck::Zeroable::zeroed();
        record.origin = origin;
        record.direction = direction;
        record.tnear = 1e-4;
        record.tfar = tfar;
        record.kind = if occlusion { kind::OCCLUSION } else { kind::CLOSEST_HIT };
        record.purpose = purpose as u8;
        let hit =
            prepared.closest_hit(Traversal::Odf, &PreparedRay::new(&record.ray()), &All, &mut (), scratch);
        record.t = hit.map_or(f32::INFINITY, |hit| if occlusion { f32::NEG_INFINITY } else { hit.t });
        record.flags = hit.map_or(0, |_| flag::HIT);
        records.push(record);
        hit.map(|hit| record.ray().at(hit.t * 0.9999))
    };
    for pixel in 0..QUERIES {
        let (x, y) = ((pixel % 400) as f32 / 200.0 - 1.0, (pixel / 400) as f32 / 125.0 - 1.0);
        let forward = (bounds.center() - eye).normalize();
        let side = forward.cross(Vec3::Y).normalize();
        let direction = forward + x * side - 0.75 * y * side.cross(forward);
        if let Some(point) = ask(eye, direction, f32::INFINITY, Purpose::Camera) {
            let bounce = Vec3::from_array([0; 3].map(|_| random.signed() as f32));
            ask(point, bounce, f32::INFINITY, Purpose::Diffuse);
            ask(point, sun - point, 0.9999, Purpose::Shadow);
        }
    }
    records
}
