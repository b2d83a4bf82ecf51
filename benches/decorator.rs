//! What the recording decorator alone costs: CPU time per query with and without it, one thread, a million triangles.
//!
//! `cargo bench --bench decorator`. The sink copies each batch into a buffer, as a writer's front does. Plain and recording runs
//! alternate and use the same queries; the table has medians over rounds, since the machine is rarely alone with us.

use embree_trace::embree::{BatchSink, Intersector, Query, Scene, Settings, Stop};
use embree_trace::format::rays::{Record, Reject};
use embree_trace::geometry::{Ray, Vec3};
use embree_trace::mesh::{Faces, Material, Mesh, Part};

/// Cells along a side: 999,698 triangles.
const CELLS: u32 = 707;
const QUERIES: usize = 200_000;
const ROUNDS: usize = 15;

/// SplitMix64 (Steele, Lea and Flood 2014).
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 24) as f32
    }

    fn point(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit()) * 2.0 - Vec3::ONE
    }
}

/// Copies batches behind each other, round and round.
struct Copy {
    buffer: Vec<Record>,
    used: usize,
    total: usize,
}

impl BatchSink for Copy {
    fn batch(&mut self, records: &[Record], _: &[Reject]) -> Result<(), Stop> {
        if self.used + records.len() > self.buffer.len() {
            self.used = 0;
        }
        self.buffer[self.used..self.used + records.len()].copy_from_slice(records);
        self.used += records.len();
        self.total += records.len();
        Ok(())
    }
}

/// A wavy height field over the square -1..1: two triangles a cell, shared vertices, as in a scanned surface.
fn scene() -> Mesh {
    let at = |x: u32, z: u32| z * (CELLS + 1) + x;
    let mut vertices = Vec::new();
    for z in 0..=CELLS {
        for x in 0..=CELLS {
            let (x, z) = (x as f32 / CELLS as f32 * 2.0 - 1.0, z as f32 / CELLS as f32 * 2.0 - 1.0);
            vertices.push(Vec3::new(x, 0.1 * ((9.0 * x).sin() + (11.0 * z + 5.0 * x).cos()), z));
        }
    }
    let cells = (0..CELLS).flat_map(|z| (0..CELLS).map(move |x| (x, z)));
    let indices = cells
        .flat_map(|(x, z)| {
            let [a, b, c, d] = [at(x, z), at(x + 1, z), at(x + 1, z + 1), at(x, z + 1)];
            [a, b, d, c, d, b]
        })
        .collect();
    let part = Part { name: "field".into(), material: 0, faces: Faces::Triangles, indices };
    Mesh { vertices, parts: vec![part], materials: vec![Material::default()] }
}

/// CPU time of this thread so far, in nanoseconds.
fn cpu_time() -> u64 {
    let statistics = std::fs::read_to_string("/proc/thread-self/schedstat").expect("schedstat is on");
    statistics
        .split_whitespace()
        .next()
        .and_then(|time| time.parse().ok())
        .expect("schedstat starts with a number")
}

type Ask = fn(&mut Intersector, &[Query]) -> usize;

fn closest(intersector: &mut Intersector, queries: &[Query]) -> usize {
    queries.iter().filter(|query| intersector.closest_hit(query).is_some()).count()
}

fn occluded(intersector: &mut Intersector, queries: &[Query]) -> usize {
    queries.iter().filter(|query| intersector.occluded(query)).count()
}

fn packets(intersector: &mut Intersector, queries: &[Query]) -> usize {
    let mut hits = [None; 16];
    let count = |queries: &[Query]| {
        intersector.closest_hits(queries, &mut hits[..queries.len()]);
        hits[..queries.len()].iter().flatten().count()
    };
    queries.chunks(16).map(count).sum()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn main() {
    let scene = Scene::new(&scene(), &Settings::default()).expect("the scene is good");
    let random = &mut Random(2);
    let queries: Vec<Query> = (0..QUERIES)
        .map(|_| {
            Query::new(Ray {
                origin: random.point(),
                tnear: 0.0,
                direction: random.point(),
                tfar: f32::INFINITY,
            })
        })
        .collect();
    println!("{:24} {:>9} {:>10} {:>9} {:>7}", "ns per query", "plain", "recording", "added", "ratio");
    for (name, ask) in
        [("closest hit", closest as Ask), ("occlusion", occluded), ("closest hit, packets", packets)]
    {
        let mut sink = Copy { buffer: vec![bytemuck::Zeroable::zeroed(); 65_536], used: 0, total: 0 };
        let (mut plain, mut recording, mut ratios) = (Vec::new(), Vec::new(), Vec::new());
        {
            let mut without = scene.intersector().expect("memory for an intersector");
            let mut with = scene.recording_intersector(&mut sink).expect("memory for an intersector");
            let time = |intersector: &mut Intersector| {
                let start = cpu_time();
                std::hint::black_box(ask(intersector, &queries));
                (cpu_time() - start) as f64 / QUERIES as f64
            };
            time(&mut without);
            for _ in 0..ROUNDS {
                let (a, b) = (time(&mut without), time(&mut with));
                plain.push(a);
                recording.push(b);
                ratios.push(b / a);
            }
        }
        assert_eq!(sink.total, ROUNDS * QUERIES);
        let (plain, recording, ratio) = (median(plain), median(recording), median(ratios));
        println!("{name:24} {plain:9.1} {recording:10.1} {:9.1} {ratio:7.3}", recording - plain);
    }
}
