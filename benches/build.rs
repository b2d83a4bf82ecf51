//! Build time and what comes out, ours beside other crates' and Embree's, in one run:
//! `cargo bench --bench build -- [SCENE [RAYS]]… [--scenes [SCENE [RAYS]]…]`.
//!
//! Not criterion: it measures one contender after the other, and a shared machine drifts meanwhile. Here every round
//! runs each contender once; the table shows medians over rounds. Beside the wall clock it shows processor seconds of
//! all threads on a pool of one: other processes disturb them less, and they are what tinybvh, which makes its own
//! threads, can be compared by.
//!
//! Scenes before `--scenes` have a table each, of all contenders. Those behind it have a line each in a last table: our best tree from area beside Embree's and the best of all
//! crates.
//!
//! SAH cost: c_I 1.2 for a node visit (0.6 a box test), c_P 1, relative to the root's area, with our code for all.
//! ODF cost, with a recording of the scene: 0.6 for a box test and 1 for a primitive test, per recorded query; with it the answers are checked. A node visit of a
//! binary tree tests two boxes, so it counts 1.2; wide trees pay for each of their boxes.
//! Scenes are files (`.obj`, `.ply`, also `.zst`); without any, one that is generated. ONLY=TEXT runs the contenders whose names contain it.

mod build_tables;
mod contenders;
mod peers;
mod stopwatch;

use build_tables::{Found, Line, print_lines};
use contenders::{BEST, HIGH, Run, crates, embrees, ours};
use embree_trace::files::MappedFile;
use embree_trace::format::rays::Rays;
use embree_trace::mesh::generate::courtyard;
use embree_trace::mesh::{self, Mesh};
use embree_trace::tree::statistics::Statistics;
use embree_trace::tree::validate::validate;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::path::Path;
use stopwatch::median;

/// Rounds, unless the environment variable ROUNDS says another number.
const ROUNDS: usize = 7;
const THREADS: [usize; 2] = [1, 2];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    if arguments.is_empty() {
        compare("generated courtyard", &courtyard(64, 1), None);
    }
    let mut lines = Vec::new();
    let mut one_line = false;
    let mut arguments = arguments.iter().peekable();
    while let Some(path) = arguments.next() {
        if path == "--scenes" {
            one_line = true;
            continue;
        }
        let rays = arguments.next_if(|next| next.ends_with(".rays"));
        let bytes = rays.map(|rays| MappedFile::open(Path::new(rays)).expect("a readable file"));
        let rays = bytes.as_ref().map(|bytes| Rays::parse(bytes).expect("a .rays"));
        match mesh::read(Path::new(path)) {
            Ok((mesh, _)) if one_line => lines.push(line(path, &mesh, rays.as_ref())),
            Ok((mesh, _)) => compare(path, &mesh, rays.as_ref()),
            Err(error) => eprintln!("{error}"),
        }
    }
    if !lines.is_empty() {
        print_lines(&lines);
    }
}

fn pools() -> [ThreadPool; 2] {
    THREADS
        .map(|threads| ThreadPoolBuilder::new().num_threads(threads).build().expect("threads can be started"))
}

/// Runs each contender once a round on each pool. Of each: processor seconds on one thread, then wall seconds for each number of threads.
fn timed(contenders: &mut [(&str, Run)], pools: &[ThreadPool; 2]) -> Vec<[f64; 1 + THREADS.len()]> {
    let mut seconds = vec![[const { Vec::new() }; 1 + THREADS.len()]; contenders.len()];
    for _ in 0..rounds() {
        for (column, pool) in pools.iter().enumerate() {
            for ((_, run), seconds) in contenders.iter_mut().zip(&mut seconds) {
                let took = run(pool, false).0;
                seconds[1 + column].push(took.wall);
                if column == 0 {
                    seconds[0].push(took.processor);
                }
            }
        }
    }
    seconds.into_iter().map(|mut columns| columns.each_mut().map(|seconds| median(seconds))).collect()
}

fn rounds() -> usize {
    std::env::var("ROUNDS").ok().and_then(|text| text.parse().ok()).unwrap_or(ROUNDS).max(1)
}

/// The table of a scene.
fn compare(name: &str, mesh: &Mesh, rays: Option<&Rays>) {
    let triangles = &mesh.triangles();
    let pools = pools();
    let mut contenders = ours(triangles);
    contenders.extend(crates(triangles));
    contenders.extend(embrees(mesh));
    if let Ok(only) = std::env::var("ONLY") {
        contenders.retain(|(name, _)| only.split(',').any(|text| name.contains(text)));
    }
    let seconds = timed(&mut contenders, &pools);
    println!("\n{name}, {} triangles: median of {} rounds", triangles.len(), rounds());
    println!(
        "{:<36}{:>10}{:>10}{:>10}{:>10}{:>10}{:>7}{:>10}{:>10}{:>7}",
        "",
        "processor",
        "1 thread",
        "2 threads",
        "SAH cost",
        "ODF cost",
        "depth",
        "nodes",
        "entries",
        "wrong"
    );
    for ((name, mut run), [processor, one, two]) in contenders.into_iter().zip(seconds) {
        let tree = run(&pools[1], true).1.expect("asked for");
        let Found { sah, odf, wrong } = Found::of(&tree, triangles, rays);
        let Statistics { depth, nodes, .. } = Statistics::of(tree.view());
        let entries = tree.primitives.len();
        let note = if entries > triangles.len() {
            // Boxes of fragments cannot be told from wrong ones.
            String::new()
        } else {
            validate(&tree, triangles, usize::MAX).map_or_else(|error| error.to_string(), |()| String::new())
        };
        println!(
            "{name:<36}{processor:>10.3}{one:>10.3}{two:>10.3}{sah:>10.3}{odf:>10.3}{depth:>7}{nodes:>10}{entries:>10}{wrong:>7}  {note}"
        );
    }
}

/// What the last table says of a scene.
fn line(path: &str, mesh: &Mesh, rays: Option<&Rays>) -> Line {
    let triangles = &mesh.triangles();
    let pools = pools();
    let mut rivals: Vec<(&str, Run)> =
        ours(triangles).into_iter().filter(|(name, _)| *name == BEST).collect();
    rivals.extend(embrees(mesh).into_iter().filter(|(name, _)| *name == HIGH));
    let seconds = timed(&mut rivals, &pools);
    let found = |run: &mut Run| {
        let tree = run(&pools[1], true).1.expect("asked for");
        Found::of(&tree, triangles, rays)
    };
    let file = Path::new(path).file_name().unwrap_or_default().to_string_lossy();
    let mut rivals = rivals.iter_mut().map(|(_, run)| found(run)).collect::<Vec<_>>().into_iter();
    Line {
        scene: file.split('.').next().unwrap_or_default().to_owned(),
        triangles: triangles.len(),
        ours: rivals.next().expect("ours"),
        high: rivals.next(),
        crates: crates(triangles).into_iter().map(|(name, mut run)| (name, found(&mut run))).collect(),
        times_high: [1, 2]
            .map(|column| seconds[0][column] / seconds.get(1).map_or(f64::NAN, |high| high[column])),
    }
}
