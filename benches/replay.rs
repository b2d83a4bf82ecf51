//! Rays per second, ours beside other crates' and Embree's, on recorded queries by purpose:
//! `cargo bench --bench replay -- [BVH RAYS]…`, with files that `embree-trace` wrote. Without any, a generated scene and
//! queries that our own traversal answers.
//!
//! Not criterion: it measures one contender after the other, and a shared machine drifts meanwhile. Here every round
//! runs each contender on the same queries, first untimed to warm it up; the tables show medians over rounds, in million queries per processor
//! second of one thread, and how many answers are those of the recording. The last tables have what the targets ask for:
//! ratios of ours to the fastest of others and of packets to single rays, by scene, and their medians. With `--threads`, only how much faster
//! two threads are than one, in wall-clock time: for that the machine has to be at rest.
//!
//! Crates that don't choose kernels at run time want `RUSTFLAGS="-C target-cpu=native"`; without, tinybvh's tree of eight does not take part.

mod casters;
#[allow(dead_code, reason = "of some crates only the traversal takes part here, and of some only the tree")]
mod peers;

use casters::*;
use embree_trace::builder::{self, Config, Splits, spatial};
use embree_trace::files::MappedFile;
use embree_trace::format::bvh::Bvh;
use embree_trace::format::rays::{Purpose, Rays, Record, flag, kind};
use embree_trace::geometry::{Triangle, Vec3};
use embree_trace::mesh::generate::courtyard;
use embree_trace::optimize::{Stage, reinsertion};
use embree_trace::progress::Progress;
use embree_trace::random::Random;
use embree_trace::recipe::{Heuristic, Recipe};
use embree_trace::traverse::packet::MOST;
use embree_trace::traverse::{All, Counts, OcclusionOrder, Prepared, PreparedRay, Scratch, Traversal};
use embree_trace::tree::{Tree, TreeView, collapse, likely};
use obvhs::BvhBuildParams;
use peers::Peer;
use peers::obvhs_crate::Obvhs;
use peers::tinybvh_crate::TinyBvh;
use std::path::Path;

const ROUNDS: usize = 5;
/// Queries of each purpose, spread over the recording in stretches of [`MOST`], as packets want neighbours.
const QUERIES: usize = 100_000;
/// Least seconds of one contender in a round: the clock of a thread is coarse, and caches have to be filled first.
const LEAST: f64 = 0.15;
/// The purposes that targets are about.
const PURPOSES: [Purpose; 3] = [Purpose::Camera, Purpose::Diffuse, Purpose::Shadow];

fn main() {
    let paths: Vec<String> =
        std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let (titles, compare): (&[&str], Compare) = match std::env::args().any(|argument| argument == "--threads")
    {
        true => (&THREADS, threads),
        false => (&RACE, race),
    };
    let mut ratios = Vec::new();
    if paths.is_empty() {
        let triangles = courtyard(64, 1).triangles();
        let records = made_up(&triangles);
        ratios.push(("courtyard".to_owned(), compare("generated courtyard", &triangles, &records, None)));
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
        let name = Path::new(bvh_path).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        ratios.push((name, compare(bvh_path, bvh.triangles, &records, Some(bvh.tree))));
    }
    for (place, title) in titles.iter().enumerate() {
        print_ratios(
            title,
            ratios.iter().map(|(name, ratios)| (name.as_str(), ratios.each_ref().map(|of| of[place]))),
        );
    }
}

fn open(path: &str) -> MappedFile {
    MappedFile::open(Path::new(path)).expect("a readable file")
}

/// Whom a contender is compared with.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Side {
    /// Our binary tree, in any order of occlusion queries that needs no rays: the target is the fastest `BinaryPeer`.
    Binary,
    BinaryCounting,
    /// Packets over our binary tree: the target is `Binary`.
    Packets,
    /// Our tree of eight: the targets are `Embree`, and every crate.
    Eight,
    BinaryPeer,
    /// Trees of eight of other crates.
    WidePeer,
    /// Our traversal of Embree's own tree: the target is `EmbreeMedium`.
    SameTree,
    /// Packets over our tree of eight: the target is `Eight`.
    WidePackets,
    EmbreeMedium,
    Embree,
    /// Shown only.
    Other,
}

/// Trees of ours, from area alone.
struct Trees {
    binary: Tree,
    four: Tree,
    eight: Tree,
}

impl Trees {
    fn new(triangles: &[Triangle]) -> Trees {
        let recipe = Recipe {
            heuristic: Heuristic::Sah,
            builder: Config::of(Splits::Spatial(spatial::Options::default())),
            stages: vec![Stage::Reinsertion(reinsertion::Config::default())],
            budget: None,
        };
        let tree = recipe.make(triangles, &[], &Progress::hidden()).expect("a valid recipe").tree;
        let area = |node: usize| f64::from(tree.nodes[node].bounds().area());
        let [binary, four, eight] = [2, 4, 8].map(|width| {
            let config = collapse::Config::vector(width);
            let wide = collapse::collapse(tree.view(), area, &config).expect("a binary tree");
            likely::likeliest_first(&wide, triangles)
        });
        Trees { binary, four, eight }
    }
}

/// Runs what there is to run on the queries of one scene, called by a name. Returns ratios by purpose.
/// The last argument is the tree that the recorded program's Embree built.
type Compare = fn(&str, &[Triangle], &[Record], Option<TreeView>) -> Ratios;

/// By purpose a ratio for each title.
type Ratios = [Vec<f64>; 3];

const THREADS: [&str; 2] = ["two threads / one, 8 wide", "two threads / one, Embree medium"];

/// How much faster two threads are, ours and Embree's.
fn threads(_: &str, triangles: &[Triangle], records: &[Record], _: Option<TreeView>) -> Ratios {
    let tree = Trees::new(triangles).eight;
    let eight = Prepared::new(tree.view(), triangles, &[]);
    let ours = || Ours::<()>::in_order(&eight, OcclusionOrder::Outside);
    #[cfg(feature = "embree")]
    let scenes = EmbreeScenes::new(triangles);
    PURPOSES.map(|purpose| {
        let queries = queries(records, purpose);
        #[cfg(feature = "embree")]
        let embree = two_over_one(|| EmbreeCaster::new(scenes.medium()), &queries, LEAST, ROUNDS);
        #[cfg(not(feature = "embree"))]
        let embree = f64::NAN;
        vec![two_over_one(ours, &queries, LEAST, ROUNDS), embree]
    })
}

/// Queries of one purpose without rejects, [`QUERIES`] about, spread over the recording.
fn queries(records: &[Record], purpose: Purpose) -> Vec<Record> {
    let chosen: Vec<Record> = records
        .iter()
        .filter(|r| Purpose::from_byte(r.purpose) == purpose && r.flags & flag::HAS_REJECTS == 0)
        .copied()
        .collect();
    let every = chosen.len().div_ceil(QUERIES).max(1);
    chosen.chunks(MOST).step_by(every).flatten().copied().collect()
}

const RACE: [&str; 7] = [
    "binary / fastest binary crate",
    "the same, counting",
    "8 wide / fastest Embree (medium, high)",
    "8 wide / fastest crate of any width",
    "packets of 256 / single rays, binary",
    "packets of 256 / single rays, 8 wide",
    "Embree's medium tree, ours / Embree",
];

/// Every contender, one thread.
fn race(name: &str, triangles: &[Triangle], records: &[Record], recorded: Option<TreeView>) -> Ratios {
    let prepared = |tree: &Tree| Prepared::new(tree.view(), triangles, &[]);
    let trees = Trees::new(triangles);
    let (binary, four, eight) = (prepared(&trees.binary), prepared(&trees.four), prepared(&trees.eight));
    let theirs = |parameters| Obvhs::tree(&Obvhs(parameters).build(&mut Obvhs::prepare(triangles)));
    let on_medium = prepared(&theirs(BvhBuildParams::medium_build()));
    let on_slow = prepared(&theirs(BvhBuildParams::very_slow_build()));
    let corners: Vec<[f32; 4]> = triangles.iter().flat_map(|t| t.0.map(|v| [v.x, v.y, v.z, 0.0])).collect();
    let tiny = tinybvh_rs::bvh::BVH::new(corners.as_slice().into()).expect("whole triangles");
    let tiny_hq = tinybvh_rs::bvh::BVH::new_hq(corners.as_slice().into()).expect("whole triangles");
    let on_tiny =
        prepared(&TinyBvh::tree(&TinyBvh { spatial: true }.build(&mut TinyBvh::prepare(triangles))));
    let recorded = recorded.map(|tree| Prepared::new(tree, triangles, &[]));
    let (odf, ray_order) = (Traversal::Odf, Traversal::RayOrder);
    #[cfg(feature = "embree")]
    let scenes = EmbreeScenes::new(triangles);
    #[allow(unused_mut, reason = "rows are added where their library and the processor's features are there")]
    let mut contenders: Vec<(&str, Side, Runner)> = vec![
        ("ours ODF", Side::Binary, runner(Ours::<()>::new(&binary, odf))),
        ("ours ODF, counting", Side::BinaryCounting, runner(Ours::<Counts>::new(&binary, odf))),
        (
            "ours ODF, farthest first",
            Side::Binary,
            runner(Ours::<()>::in_order(&binary, OcclusionOrder::Farthest)),
        ),
        (
            "ours ODF, in file order",
            Side::Binary,
            runner(Ours::<()>::in_order(&binary, OcclusionOrder::First)),
        ),
        ("ours ODF, packets of 16", Side::Other, packets(&binary, odf, 16)),
        ("ours ODF, packets of 64", Side::Other, packets(&binary, odf, 64)),
        ("ours ODF, packets of 256", Side::Packets, packets(&binary, odf, MOST)),
        ("ours RayOrder, packets of 256", Side::Other, packets(&binary, ray_order, MOST)),
        ("ours RayOrder", Side::Other, runner(Ours::<()>::new(&binary, ray_order))),
        ("ours ODF, obvhs medium tree", Side::Other, runner(Ours::<()>::new(&on_medium, odf))),
        ("ours ODF, obvhs slow tree", Side::Other, runner(Ours::<()>::new(&on_slow, odf))),
        ("ours ODF, tinybvh-rs HQ tree", Side::Other, runner(Ours::<()>::new(&on_tiny, odf))),
        (
            "obvhs medium",
            Side::BinaryPeer,
            runner(ObvhsCaster::new(triangles, BvhBuildParams::medium_build())),
        ),
        (
            "obvhs very slow",
            Side::BinaryPeer,
            runner(ObvhsCaster::new(triangles, BvhBuildParams::very_slow_build())),
        ),
        ("tinybvh-rs", Side::BinaryPeer, runner(TinyBvhCaster(tiny))),
        ("tinybvh-rs HQ", Side::BinaryPeer, runner(TinyBvhCaster(tiny_hq))),
        (
            "obvhs very slow, 8 wide",
            Side::WidePeer,
            runner(CwBvhCaster::new(triangles, BvhBuildParams::very_slow_build())),
        ),
        ("parry3d", Side::BinaryPeer, runner(ParryCaster::new(triangles))),
        ("bvh", Side::BinaryPeer, runner(BvhCrateCaster::new(triangles))),
        ("ours ODF, 4 wide", Side::Other, runner(Ours::<()>::new(&four, odf))),
        ("ours ODF, 8 wide, packets of 256", Side::WidePackets, packets(&eight, odf, MOST)),
        ("ours ODF, 8 wide", Side::Eight, runner(Ours::<()>::new(&eight, odf))),
        (
            "ours ODF, 8 wide, outside",
            Side::Eight,
            runner(Ours::<()>::in_order(&eight, OcclusionOrder::Outside)),
        ),
        ("ours RayOrder, 8 wide", Side::Other, runner(Ours::<()>::new(&eight, ray_order))),
    ];
    #[cfg(target_feature = "avx2")]
    contenders.extend(
        [("tinybvh-rs, 8 wide", false), ("tinybvh-rs HQ, 8 wide", true)]
            .map(|(name, spatial)| (name, Side::WidePeer, runner(TinyBvhEight::new(triangles, spatial)))),
    );
    #[cfg(feature = "embree")]
    for ((name, caster), side) in scenes.casters().zip([Side::EmbreeMedium, Side::Embree]) {
        contenders.push((name, side, runner(caster)));
    }
    if let Some(tree) = &recorded {
        // Embree's kernels go to the last child first.
        let caster = Ours::<()>::in_order(tree, OcclusionOrder::Last);
        contenders.push(("ours ODF, Embree's tree", Side::SameTree, runner(caster)));
    }
    PURPOSES.map(|purpose| {
        let queries = queries(records, purpose);
        if queries.is_empty() {
            return vec![f64::NAN; RACE.len()];
        }
        println!("\n{name}, {} triangles, {}: {} queries", triangles.len(), purpose.name(), queries.len());
        let rates = measured(&mut contenders, &queries);
        let best = |side: Side| {
            let rates = contenders.iter().zip(&rates).filter(|((_, other, _), _)| *other == side);
            rates.map(|(_, rate)| *rate).fold(f64::NAN, f64::max)
        };
        // An order is a choice for occlusion queries alone: elsewhere its rows repeat the first one, and the best of several runs would flatter.
        let ours = |side: Side| match purpose {
            Purpose::Shadow => best(side),
            _ => contenders
                .iter()
                .zip(&rates)
                .find(|((_, other, _), _)| *other == side)
                .map_or(f64::NAN, |(_, rate)| *rate),
        };
        let peer = best(Side::BinaryPeer);
        let alone = rates[0];
        vec![
            ours(Side::Binary) / peer,
            ours(Side::BinaryCounting) / peer,
            ours(Side::Eight) / best(Side::EmbreeMedium).max(best(Side::Embree)),
            ours(Side::Eight) / peer.max(best(Side::WidePeer)),
            best(Side::Packets) / alone,
            best(Side::WidePackets) / ours(Side::Eight),
            best(Side::SameTree) / best(Side::EmbreeMedium),
        ]
    })
}

/// Prints and returns the rate of each contender.
fn measured(contenders: &mut [(&str, Side, Runner)], queries: &[Record]) -> Vec<f64> {
    let mut seconds = vec![Vec::new(); contenders.len()];
    let mut right = vec![0; contenders.len()];
    let mut passes = vec![1; contenders.len()];
    for round in 0..=ROUNDS {
        for (index, (_, _, run)) in contenders.iter_mut().enumerate() {
            // Not timed: whoever follows another contender on the same tree would find it in the caches.
            run(queries);
            let before = processor_seconds();
            (0..passes[index]).for_each(|_| right[index] = run(queries));
            let each = (processor_seconds() - before) / passes[index] as f64;
            if round == 0 {
                // Only to learn how long it takes.
                passes[index] = (LEAST / each.max(1e-3)).ceil() as usize;
            } else {
                seconds[index].push(each);
            }
        }
    }
    println!("{:<30}{:>12}{:>10}{:>10}", "", "M queries/s", "spread", "wrong");
    let mut rates = Vec::new();
    for (((name, ..), mut seconds), right) in contenders.iter().zip(seconds).zip(right) {
        seconds.sort_by(f64::total_cmp);
        let rate = |seconds: f64| queries.len() as f64 * 1e-6 / seconds;
        let spread = (rate(seconds[0]) - rate(seconds[ROUNDS - 1])) / rate(seconds[ROUNDS / 2]);
        println!(
            "{name:<30}{:>12.3}{:>9.0}%{:>10}",
            rate(seconds[ROUNDS / 2]),
            100.0 * spread,
            queries.len() - right
        );
        rates.push(rate(seconds[ROUNDS / 2]));
    }
    rates
}

/// A line for each scene, and the medians.
fn print_ratios<'a>(title: &str, scenes: impl Iterator<Item = (&'a str, [f64; 3])> + Clone) {
    println!("\n{title:<40}{}", PURPOSES.map(|purpose| format!("{:>10}", purpose.name())).concat());
    let print = |name: &str, ratios: [f64; 3]| {
        println!("{name:<40}{}", ratios.map(|ratio| format!("{ratio:>10.2}")).concat());
    };
    scenes.clone().for_each(|(name, ratios)| print(name, ratios));
    let medians = [0, 1, 2].map(|purpose| {
        let mut all: Vec<f64> =
            scenes.clone().map(|(_, ratios)| ratios[purpose]).filter(|r| r.is_finite()).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied().unwrap_or(f64::NAN)
    });
    print("median", medians);
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
