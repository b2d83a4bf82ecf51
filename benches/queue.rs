//! What should RayOrder keep its waiting nodes in: an unsorted list, a sorted list, or a heap? The paper leaves it to measurement:
//! `cargo bench --bench queue -- [BVH RAYS]…`. Without any, a generated scene.
//!
//! The same plain traversal with each of the three, over the tree of the file, on the recorded closest-hit queries of one purpose. Rounds take them in
//! turn; the table has median nanoseconds of a thread's processor time per query, and how many nodes wait on average when one is taken.

#[allow(dead_code, reason = "the wall clock is for benches with several threads")]
mod stopwatch;

use embree_trace::builder::{self, Config};
use embree_trace::files::MappedFile;
use embree_trace::format::bvh::Bvh;
use embree_trace::format::rays::{Purpose, Rays};
use embree_trace::geometry::{Ray, Triangle, Vec3};
use embree_trace::mesh::generate::courtyard;
use embree_trace::progress::Progress;
use embree_trace::random::Random;
use embree_trace::traverse::{PreparedRay, PreparedTriangle};
use embree_trace::tree::TreeView;
use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::path::Path;
use stopwatch::{Stopwatch, median};

const ROUNDS: usize = 7;
/// Queries of a purpose, spread over the recording.
const QUERIES: usize = 30_000;
/// How often they are asked in a round: the clock of a thread is coarse.
const PASSES: usize = 20;

/// A node that waits, and where the ray enters its box.
#[derive(Clone, Copy)]
struct Waiting {
    entry: f32,
    node: u32,
}

/// Gives back what is entered first.
trait Queue: Default {
    const NAME: &str;
    fn clear(&mut self);
    fn push(&mut self, waiting: Waiting);
    fn pop(&mut self) -> Option<Waiting>;
    fn len(&self) -> usize;
}

/// Pushed anywhere, searched when one is taken.
#[derive(Default)]
struct Unsorted(Vec<Waiting>);

impl Queue for Unsorted {
    const NAME: &str = "unsorted list";

    fn clear(&mut self) {
        self.0.clear();
    }

    fn push(&mut self, waiting: Waiting) {
        self.0.push(waiting);
    }

    fn pop(&mut self) -> Option<Waiting> {
        let (mut least, mut place) = (f32::INFINITY, None);
        for (index, waiting) in self.0.iter().enumerate() {
            if waiting.entry <= least {
                (least, place) = (waiting.entry, Some(index));
            }
        }
        place.map(|place| self.0.swap_remove(place))
    }

    fn len(&self) -> usize {
        self.0.len()
    }
}

/// The first at the end: what the library has.
#[derive(Default)]
struct Sorted(Vec<Waiting>);

impl Queue for Sorted {
    const NAME: &str = "sorted list";

    fn clear(&mut self) {
        self.0.clear();
    }

    fn push(&mut self, waiting: Waiting) {
        let mut place = self.0.len();
        self.0.push(waiting);
        while place > 0 && waiting.entry > self.0[place - 1].entry {
            self.0[place] = self.0[place - 1];
            place -= 1;
        }
        self.0[place] = waiting;
    }

    fn pop(&mut self) -> Option<Waiting> {
        self.0.pop()
    }

    fn len(&self) -> usize {
        self.0.len()
    }
}

/// The standard library's binary heap.
#[derive(Default)]
struct Heap(BinaryHeap<Waiting>);

impl Ord for Waiting {
    /// The greatest is what is entered first.
    fn cmp(&self, other: &Waiting) -> Ordering {
        other.entry.total_cmp(&self.entry)
    }
}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Waiting) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Waiting) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Waiting {}

impl Queue for Heap {
    const NAME: &str = "heap";

    fn clear(&mut self) {
        self.0.clear();
    }

    fn push(&mut self, waiting: Waiting) {
        self.0.push(waiting);
    }

    fn pop(&mut self) -> Option<Waiting> {
        self.0.pop()
    }

    fn len(&self) -> usize {
        self.0.len()
    }
}

/// A scene with its tree; triangles in the tree's order.
struct Scene<'a> {
    tree: TreeView<'a>,
    triangles: Vec<PreparedTriangle>,
}

impl<'a> Scene<'a> {
    fn new(tree: TreeView<'a>, triangles: &[Triangle]) -> Scene<'a> {
        let prepared = |&index: &u32| PreparedTriangle {
            vertices: triangles[index as usize],
            index,
            mask: !0,
            instance_mask: !0,
        };
        Scene { tree, triangles: tree.primitives.iter().map(prepared).collect() }
    }

    /// The distance of the closest hit. Adds to `waited` the lengths of the queue at each pop, and how many there were.
    fn closest(&self, ray: &PreparedRay, queue: &mut impl Queue, waited: &mut [usize; 2]) -> f32 {
        let mut best = f32::INFINITY;
        queue.clear();
        if let Some(entry) = ray.entry(&self.tree.nodes[0].bounds(), ray.tfar) {
            queue.push(Waiting { entry, node: 0 });
        }
        loop {
            *waited = [waited[0] + queue.len(), waited[1] + 1];
            let Some(next) = queue.pop().filter(|next| next.entry <= best) else { return best };
            let node = &self.tree.nodes[next.node as usize];
            if node.is_leaf() {
                for triangle in &self.triangles[node.range()] {
                    best = triangle.intersect(ray).map_or(best, |t| best.min(t));
                }
            } else {
                for child in node.range() {
                    if let Some(entry) = ray.entry(&self.tree.nodes[child].bounds(), best.min(ray.tfar)) {
                        queue.push(Waiting { entry, node: child as u32 });
                    }
                }
            }
        }
    }

    /// Nanoseconds per ray and the sum of distances, which is what all queues must agree on.
    fn run<Q: Queue>(&self, rays: &[PreparedRay], waited: &mut [usize; 2]) -> (f64, f64) {
        let (mut queue, watch) = (Q::default(), Stopwatch::start());
        let mut sum = 0.0;
        for _ in 0..PASSES {
            let distances = rays.iter().map(|ray| self.closest(ray, &mut queue, waited));
            sum = distances.filter(|t| t.is_finite()).map(f64::from).sum();
        }
        (1e9 * watch.stop().processor / (PASSES * rays.len()) as f64, sum)
    }

    fn compare(&self, name: &str, rays: &[PreparedRay]) {
        let mut times = [const { Vec::new() }; 3];
        let mut waited = [0; 2];
        for _ in 0..=ROUNDS {
            let runs = [
                self.run::<Unsorted>(rays, &mut waited),
                self.run::<Sorted>(rays, &mut waited),
                self.run::<Heap>(rays, &mut waited),
            ];
            assert!(runs.iter().all(|run| run.1 == runs[0].1), "a queue changed an answer");
            times.iter_mut().zip(runs).for_each(|(times, run)| times.push(run.0));
        }
        // The first round warms up.
        let medians = times.map(|mut times| median(&mut times[1..]));
        let mean = waited[0] as f64 / waited[1].max(1) as f64;
        println!("{name:<40}{}{mean:>10.1}", medians.map(|time| format!("{time:>15.0}")).concat());
    }
}

fn main() {
    let paths: Vec<String> = std::env::args().skip(1).filter(|path| !path.starts_with("--")).collect();
    println!("{:<40}{:>15}{:>15}{:>15}{:>10}", "", Unsorted::NAME, Sorted::NAME, Heap::NAME, "waiting");
    if paths.is_empty() {
        let triangles = courtyard(64, 1).triangles();
        let tree = builder::build(&triangles, &Config::default(), &Progress::hidden())
            .expect("a valid configuration");
        let random = &mut Random::new(1);
        let bounds = tree.nodes[0].bounds();
        let mut vector = || Vec3::from_array([0; 3].map(|_| random.signed() as f32));
        let rays: Vec<PreparedRay> = (0..QUERIES)
            .map(|_| Ray { origin: bounds.center(), tnear: 0.0, direction: vector(), tfar: f32::INFINITY })
            .map(|ray| PreparedRay::new(&ray))
            .collect();
        Scene::new(tree.view(), &triangles).compare("generated courtyard, from its middle", &rays);
    }
    for pair in paths.chunks_exact(2) {
        let [bvh, rays] =
            [&pair[0], &pair[1]].map(|path| MappedFile::open(Path::new(path)).expect("a readable file"));
        let bvh = Bvh::parse(&bvh).expect("a .bvh");
        let recording = Rays::parse(&rays).expect("a .rays");
        let scene = Scene::new(bvh.tree, bvh.triangles);
        for purpose in [Purpose::Camera, Purpose::Diffuse] {
            let chunks =
                (0..recording.chunks().len()).map(|index| recording.chunk(index).expect("a whole chunk"));
            let all: Vec<PreparedRay> = chunks
                .flat_map(|chunk| chunk.records.into_owned())
                .filter(|record| Purpose::from_byte(record.purpose) == purpose && !record.is_occlusion())
                .map(|record| PreparedRay::new(&record.ray()))
                .collect();
            let chosen: Vec<PreparedRay> =
                all.iter().step_by(all.len().div_ceil(QUERIES).max(1)).copied().collect();
            let stem = Path::new(&pair[0]).file_stem().unwrap_or_default().to_string_lossy().into_owned();
            if !chosen.is_empty() {
                scene.compare(&format!("{stem}, {}", purpose.name()), &chosen);
            }
        }
    }
}
