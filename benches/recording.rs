//! What recording costs: CPU time per query of the path tracer with and without it, single thread, depth 4.
//!
//! `cargo bench --bench recording [-- SCENE…]`; scenes come from `EMBREE_TRACE_SCENES` (default `../shared/scenes`). Rounds
//! without and with recording take turns; CPU time is that of the whole process, the writing thread and the kernel's part of it
//! included; the file is on disk, in the current directory.

use embree_trace::embree::{Scene, Settings};
use embree_trace::format::rays::{Codec, Header};
use embree_trace::mesh;
use embree_trace::progress::Progress;
use embree_trace::record::Recorder;
use embree_trace::render::scenery::{Scenery, Wishes};
use embree_trace::render::workers::render;
use embree_trace::render::{Integrator, Job};
use std::error::Error;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

const ROUNDS: usize = 9;

fn main() -> Result<(), Box<dyn Error>> {
    let scenes = std::env::var_os("EMBREE_TRACE_SCENES").unwrap_or_else(|| "../shared/scenes".into());
    let named: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let names = if named.is_empty() { vec!["crytek_sponza".to_owned(), "kitchen".to_owned()] } else { named };
    println!(
        "{:<16}{:>12}{:>14}{:>14}{:>14}{:>9}",
        "scene", "queries", "without ns", "raw ns", "zstd ns", "raw/without"
    );
    for name in names {
        let path = Path::new(&scenes).join(format!("{name}.obj.zst"));
        if !path.exists() {
            println!("{name:<16}no {}: left out", path.display());
            continue;
        }
        measure(&name, &path)?;
    }
    Ok(())
}

fn measure(name: &str, path: &Path) -> Result<(), Box<dyn Error>> {
    let (mesh, _) = mesh::read(path)?;
    let scene = Scene::new(&mesh, &Settings::default())?;
    let job = Job {
        width: 320,
        height: 240,
        samples: 2,
        seed: 0,
        integrator: Integrator::Path,
        max_depth: 4,
        ao_rays: 1,
        threads: 1,
        packet: 1,
    };
    let (triangles, _) = scene.triangles();
    let scenery = Scenery::new(
        &mesh,
        triangles,
        &mut scene.intersector()?,
        &Wishes::default(),
        [job.width, job.height],
    )?;
    let output = PathBuf::from(format!("recording-bench-{}.rays", std::process::id()));
    let mut queries = 0;
    let mut round = |codec: Option<Codec>| -> Result<f64, Box<dyn Error>> {
        let before = cpu_seconds()?;
        let recorder = match codec {
            Some(codec) => {
                let header = Header {
                    fingerprint: 0,
                    embree_version: Scene::version(),
                    deterministic: true,
                    producer: "bench".into(),
                };
                Some(Recorder::start(File::create(&output)?, &header, codec, job.threads)?)
            }
            None => None,
        };
        let rendered = render(&scene, &scenery, &job, recorder.as_ref(), &Progress::hidden())?;
        if let Some(recorder) = recorder {
            recorder.finish()?;
        }
        queries = rendered.tally.total().queries;
        Ok((cpu_seconds()? - before) / queries as f64 * 1e9)
    };
    round(None)?;
    let mut times = [const { Vec::new() }; 3];
    for _ in 0..ROUNDS {
        for (times, codec) in times.iter_mut().zip([None, Some(Codec::Raw), Some(Codec::Compressed)]) {
            times.push(round(codec)?);
        }
    }
    fs::remove_file(&output)?;
    // Of each pair of neighbouring rounds: what slows both does not count.
    let mut ratios: Vec<f64> = times[0].iter().zip(&times[1]).map(|(without, with)| with / without).collect();
    let ratio = median(&mut ratios);
    let [without, raw, compressed] = times.each_mut().map(|times| median(times));
    println!("{name:<16}{queries:>12}{without:>14.1}{raw:>14.1}{compressed:>14.1}{ratio:>9.3}");
    Ok(())
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// User and system time of this process with all its threads, ended ones included: fields 14 and 15 of `/proc/self/stat`
/// have 10 ms steps, `schedstat` of each thread vanishes with it, so the clock of the process is asked.
fn cpu_seconds() -> Result<f64, Box<dyn Error>> {
    #[repr(C)]
    struct Timespec {
        seconds: i64,
        nanoseconds: i64,
    }
    unsafe extern "C" {
        fn clock_gettime(clock: i32, time: *mut Timespec) -> i32;
    }
    const CLOCK_PROCESS_CPUTIME_ID: i32 = 2;
    let mut time = Timespec { seconds: 0, nanoseconds: 0 };
    // SAFETY: libc's function on 64-bit Linux, where both fields are 64 bits wide; it writes one `Timespec`.
    if unsafe { clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &mut time) } != 0 {
        return Err(std::io::Error::last_os_error().into());
    }
    Ok(time.seconds as f64 + time.nanoseconds as f64 * 1e-9)
}
