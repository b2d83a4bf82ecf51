//! Reading OBJ text against tobj: the same bytes in memory, the same triangles out.
//!
//! Scenes come from `$EMBREE_TRACE_SCENES` or `../shared/scenes` when they are there, and are generated otherwise.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use embree_trace::mesh::{generate, obj};
use embree_trace::progress::Progress;
use std::hint::black_box;
use std::path::PathBuf;

fn scenes() -> Vec<(String, Vec<u8>)> {
    let folder = std::env::var_os("EMBREE_TRACE_SCENES")
        .map_or_else(|| PathBuf::from("../shared/scenes"), PathBuf::from);
    let mut scenes = Vec::new();
    for name in ["sponza", "kitchen"] {
        if let Ok(file) = std::fs::File::open(folder.join(format!("{name}.obj.zst"))) {
            let mut decoder = zstd::Decoder::new(file).expect("a zstd file");
            decoder.window_log_max(27).expect("a window");
            let mut text = Vec::new();
            std::io::copy(&mut decoder, &mut text).expect("a whole zstd file");
            scenes.push((name.to_owned(), text));
        }
    }
    if scenes.is_empty() {
        let mut text = Vec::new();
        obj::write(&generate::courtyard(8, 1), "none.mtl", &mut text, std::io::sink(), &Progress::hidden())
            .expect("a vector");
        scenes.push(("courtyard".to_owned(), text));
    }
    scenes
}

fn read(c: &mut Criterion) {
    for (name, text) in scenes() {
        let mut group = c.benchmark_group(format!("mesh/{name}"));
        group.throughput(Throughput::Bytes(text.len() as u64)).sample_size(10);
        group.bench_function("ours", |b| {
            b.iter(|| obj::parse(black_box(&text), &obj::Options::default(), &mut |_| None))
        });
        group.bench_function("tobj", |b| {
            b.iter(|| {
                let options = tobj::LoadOptions { triangulate: true, ..Default::default() };
                tobj::load_obj_buf(&mut black_box(&text[..]), &options, |_| {
                    Ok((Vec::new(), Default::default()))
                })
            });
        });
        group.finish();
    }
}

criterion_group! {
    name = benches;
    // Its plots want a font that the machine may not have.
    config = Criterion::default().without_plots();
    targets = read
}
criterion_main!(benches);
