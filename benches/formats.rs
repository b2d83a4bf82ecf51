//! Reading a `.rays`: what validation costs over summing the same bytes through the same memory map, and what compression costs.
//!
//! `cargo bench --bench formats`; `FORMATS_BENCH_MB` sets the size of the raw file (default 1024). The ratios that
//! `docs/performance.md` quotes are printed first: medians of interleaved rounds, so that a busy machine disturbs both sides alike.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use embree_trace::files::{self, MappedFile};
use embree_trace::format::rays::{
    ChunkInfo, Codec, Header, MAX_CHUNK_RECORDS, NO_TRIANGLE, Rays, RaysWriter, Record, flag, kind,
};
use embree_trace::geometry::Vec3;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Interleaved rounds of each measurement.
const ROUNDS: usize = 9;

fn megabytes() -> usize {
    std::env::var("FORMATS_BENCH_MB").ok().and_then(|text| text.parse().ok()).unwrap_or(1024)
}

/// Records like a path tracer's: a smooth camera in the plane, neighbours alike, half of the queries occlusions.
fn records(start: usize) -> Vec<Record> {
    let record = |index: usize| {
        let pixel = (index / 2) as u32;
        let (x, y) = ((pixel % 1024) as f32 / 1024.0, (pixel / 1024 % 1024) as f32 / 1024.0);
        let noise = (pixel.wrapping_mul(0x9E37_79B9) >> 8) as f32 / 16_777_216.0;
        let occlusion = index % 2 == 1;
        let hit = noise < 0.7;
        Record {
            origin: if occlusion { Vec3::new(x, y, noise) } else { Vec3::new(0.5, 0.5, -2.0) },
            tnear: 0.0,
            direction: Vec3::new(x - 0.5, y - 0.5, 1.0 + 0.01 * noise).normalize(),
            tfar: if occlusion { 10.0 } else { f32::INFINITY },
            time: 0.0,
            mask: u32::MAX,
            t: match (hit, occlusion) {
                (true, false) => 2.0 + noise,
                (true, true) => f32::NEG_INFINITY,
                _ => f32::INFINITY,
            },
            triangle: if hit && !occlusion { pixel / 64 } else { NO_TRIANGLE },
            u: if hit && !occlusion { noise } else { 0.0 },
            v: if hit && !occlusion { 1.0 - noise } else { 0.0 },
            path: pixel,
            kind: if occlusion { kind::OCCLUSION } else { kind::CLOSEST_HIT },
            depth: 0,
            flags: if hit { flag::HIT } else { 0 },
            purpose: if occlusion { 2 } else { 1 },
        }
    };
    (start..start + MAX_CHUNK_RECORDS).map(record).collect()
}

fn write(path: &Path, chunks: usize, codec: Codec) -> Duration {
    let file = files::create(path).expect("the temporary directory is writable");
    let mut writer = RaysWriter::new(file, &Header::default()).expect("there is room for a header");
    let mut spent = Duration::ZERO;
    for chunk in 0..chunks {
        let records = records(chunk * MAX_CHUNK_RECORDS);
        let info = ChunkInfo { sequence: (chunk * MAX_CHUNK_RECORDS) as u64, ..ChunkInfo::default() };
        let start = Instant::now();
        writer.write_chunk(&info, &records, &[], codec).expect("there is room for the file");
        spent += start.elapsed();
    }
    writer.finish().expect("there is room for the index");
    spent
}

/// In 16-bit sums of 256 bytes, which cannot overflow: a vector holds eight of them, so this waits for memory, not for additions.
fn sum(bytes: &[u8]) -> u64 {
    let part = |bytes: &[u8]| bytes.iter().map(|&byte| u16::from(byte)).sum::<u16>();
    bytes.chunks(256).map(|bytes| u64::from(part(bytes))).sum()
}

/// Reads and validates on this thread alone.
fn validate(bytes: &[u8]) -> u64 {
    let rays = Rays::parse(bytes).expect("the file is valid");
    (0..rays.chunks().len())
        .map(|index| rays.chunk(index).expect("the chunk is valid").records.len() as u64)
        .sum()
}

fn validate_parallel(bytes: &[u8]) -> u64 {
    let rays = Rays::parse(bytes).expect("the file is valid");
    rays.validate_all().expect("the file is valid");
    rays.query_count()
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn print_ratios(raw: &[u8], compressed: &[u8], decoded_bytes: u64) {
    let measurements: [(&str, &dyn Fn() -> u64, u64); 5] = [
        ("sum of the bytes", &|| sum(raw), raw.len() as u64),
        ("read and validate", &|| validate(raw), raw.len() as u64),
        ("on all threads", &|| validate_parallel(raw), raw.len() as u64),
        ("compressed", &|| validate(compressed), decoded_bytes),
        ("compressed, all threads", &|| validate_parallel(compressed), decoded_bytes),
    ];
    let mut seconds = vec![Vec::new(); measurements.len()];
    for _ in 0..ROUNDS {
        for ((_, measurement, _), seconds) in measurements.iter().zip(&mut seconds) {
            let start = Instant::now();
            black_box(measurement());
            seconds.push(start.elapsed().as_secs_f64());
        }
    }
    let medians: Vec<f64> = seconds.into_iter().map(median).collect();
    for ((name, _, bytes), seconds) in measurements.iter().zip(&medians) {
        let (rate, ratio) = (*bytes as f64 / seconds / 1e9, seconds / medians[0]);
        println!("{name:<24} {seconds:.3} s  {rate:6.2} GB/s  {ratio:.2} x the sum");
    }
}

fn formats(criterion: &mut Criterion) {
    let directory = tempfile::tempdir().expect("there is a temporary directory");
    let chunks = (megabytes() * (1 << 20)).div_ceil(MAX_CHUNK_RECORDS * size_of::<Record>()).max(1);
    let decoded_bytes = (chunks * MAX_CHUNK_RECORDS * size_of::<Record>()) as u64;
    let paths: [PathBuf; 2] = ["raw.rays", "compressed.rays"].map(|name| directory.path().join(name));
    for (path, codec) in paths.iter().zip([Codec::Raw, Codec::Compressed]) {
        let rate = decoded_bytes as f64 / write(path, chunks, codec).as_secs_f64() / 1e9;
        println!("write {:<18} {rate:15.2} GB/s", codec.name());
    }
    let [raw, compressed] = paths.map(|path| MappedFile::open(&path).expect("the file was just written"));
    println!("compressed to 1/{:.2}", raw.len() as f64 / compressed.len() as f64);
    print_ratios(&raw, &compressed, decoded_bytes);

    let mut group = criterion.benchmark_group("rays");
    group
        .sample_size(10)
        .measurement_time(Duration::from_secs(3))
        .throughput(Throughput::Bytes(decoded_bytes));
    group.bench_function("sum", |bencher| bencher.iter(|| sum(black_box(&raw))));
    group.bench_function("validate", |bencher| bencher.iter(|| validate(black_box(&raw))));
    group.bench_function("validate_parallel", |bencher| bencher.iter(|| validate_parallel(black_box(&raw))));
    group.bench_function("validate_compressed", |bencher| bencher.iter(|| validate(black_box(&compressed))));
    group.finish();
}

criterion_group! {
    name = benches;
    // Its plots want a font that the machine may not have.
    config = Criterion::default().without_plots();
    targets = formats
}
criterion_main!(benches);
