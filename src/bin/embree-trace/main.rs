//! `embree-trace`: renders a scene with Embree, or runs a program that does, and records every ray query with its result.

mod record;

use clap::{Parser, ValueEnum};
use embree_trace::cli::{self, Failure, Outcome, TextOrJson};
use embree_trace::embree::{BuiltTree, Isa, Quality, Scene, Settings, TreeSource};
use embree_trace::files::{self, FileError, OutputFile};
use embree_trace::format::bvh::{self, Contents};
use embree_trace::format::rays::{Codec, Header};
use embree_trace::geometry::Vec3;
use embree_trace::mesh;
use embree_trace::progress::Progress;
use embree_trace::record::{RecordError, Recorder};
use embree_trace::render::camera::parse_view;
use embree_trace::render::film::ImageKind;
use embree_trace::render::scenery::{Scenery, Wishes};
use embree_trace::render::summary::{RaysLine, Summary, TreeLine, camera_option, lights_name, query_lines};
use embree_trace::render::tiles::Tiles;
use embree_trace::render::workers::{Rendered, render};
use embree_trace::render::{Integrator, Job};
use std::ffi::OsString;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

const EXAMPLES: &str = "\
Examples:
  Record a scene, four samples per pixel:
    embree-trace sponza.obj --savetrace sponza.rays sponza.bvh
  Choose the camera, and look at the picture too:
    embree-trace room.obj --camera 1,1.6,4/0,1,0 --fov 50 --savetrace a.rays a.bvh --output a.png
  The same bytes on every x86-64 CPU, as golden files need them:
    embree-trace box.obj --isa sse42 --size 64x64 --spp 1 --savetrace box.rays box.bvh
  Only a picture, or nothing but the time it takes:
    embree-trace bunny.ply --integrator ao --spp 16 --output bunny.png
    embree-trace bunny.ply --integrator ao --spp 16

  Record a program that uses Embree (see embree-trace record --help):
    embree-trace record --savetrace casts.rays built.bvh -- blender -b scene.blend -f 1

Exit codes: 0 good, 2 bad input or usage.";

/// Renders a scene with Embree and records every ray query with its result, and the tree that answered.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Arguments {
    /// OBJ or PLY file; may be compressed (.zst)
    scene: PathBuf,
    /// Records the queries to RAYS and the tree to BVH (one dash will do, too); without it, only renders
    #[arg(long, num_args = 2, value_names = ["RAYS", "BVH"])]
    savetrace: Option<Vec<PathBuf>>,
    /// Compresses the recorded queries, two to four times
    #[arg(long, requires = "savetrace")]
    compress: bool,
    /// Picture to write: .png (exposed and tone mapped) or .exr (radiance)
    #[arg(long, value_name = "IMAGE")]
    output: Option<PathBuf>,
    /// EYE/TARGET or EYE/TARGET/UP, each X,Y,Z; chosen to show the scene when absent
    #[arg(long, value_name = "VIEW", allow_hyphen_values = true)]
    camera: Option<String>,
    /// Angle between the upper and lower edge of the picture, in degrees
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    fov: Option<f32>,
    /// Axis that points up; guessed when absent
    #[arg(long, value_enum)]
    up: Option<Up>,
    /// What rays are asked for
    #[arg(long, value_enum, default_value = "path")]
    integrator: Integrator,
    /// Size of the picture in pixels
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "640x480")]
    size: String,
    /// Samples per pixel
    #[arg(long, default_value_t = 4)]
    spp: u32,
    /// How often a path is scattered at most: also the largest depth of a query
    #[arg(long, value_name = "N", default_value_t = 4)]
    max_depth: u8,
    /// Ambient occlusion rays per camera ray
    #[arg(long, value_name = "N", default_value_t = 4)]
    ao_rays: u32,
    /// Another number gives other random numbers
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Threads that build and render; all CPUs when absent. Does not change a byte of the output
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Camera rays and first shadow rays asked at once: 1, 4, 8 or 16
    #[arg(long, value_name = "N", default_value_t = 1)]
    packet: usize,
    /// Instruction set of Embree's kernels: sse2, sse42, avx, avx2, avx512; the CPU's best when absent
    #[arg(long, value_parser = isa)]
    isa: Option<Isa>,
    /// How long Embree takes for its tree: low, medium or high (spatial splits)
    #[arg(long, default_value = "medium", value_parser = quality)]
    quality: Quality,
    /// Embree's scene flags: robust (watertight), compact (less memory)
    #[arg(long, value_enum, value_delimiter = ',')]
    flags: Vec<SceneFlag>,
    /// Embree's structure by name, such as bvh4.triangle4v or qbvh8.triangle4
    #[arg(long, value_name = "NAME")]
    tri_accel: Option<String>,
    /// Keeps faces of four corners as Embree quads
    #[arg(long)]
    quads: bool,
    /// Which tree is written: the one that Embree traces, read from its memory, or one from rtcBuildBVH
    #[arg(long, value_enum, default_value = "live")]
    bvh: TreeChoice,
    /// How the summary is printed
    #[arg(long, value_enum, default_value = "text")]
    format: TextOrJson,
}

#[derive(Clone, Copy, ValueEnum)]
enum Up {
    X,
    Y,
    Z,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SceneFlag {
    Robust,
    Compact,
}

#[derive(Clone, Copy, ValueEnum)]
enum TreeChoice {
    Live,
    Builder,
}

fn isa(name: &str) -> Result<Isa, String> {
    Isa::from_name(name).ok_or_else(|| format!("expected one of {}", Isa::ALL.map(Isa::name).join(", ")))
}

fn quality(name: &str) -> Result<Quality, String> {
    Quality::from_name(name)
        .ok_or_else(|| format!("expected one of {}", Quality::ALL.map(Quality::name).join(", ")))
}

fn main() -> ExitCode {
    // The paper's spelling of the option has one dash.
    let spelled = |a| if a == "-savetrace" { "--savetrace".into() } else { a };
    let mut arguments: Vec<OsString> = std::env::args_os().collect();
    match arguments.get(1).and_then(|word| word.to_str()) {
        // Everything behind `--` is the program's, so nothing is respelled.
        Some("record") => return record::main(arguments),
        Some("render") => drop(arguments.remove(1)),
        _ => {}
    }
    let arguments: Arguments = cli::parse("embree-trace", arguments.into_iter().map(spelled));
    cli::run("embree-trace", || run(&arguments))
}

/// The arguments, checked.
struct Plan<'a> {
    job: Job,
    settings: Settings,
    wishes: Wishes,
    trace: Option<[&'a Path; 2]>,
    image: Option<(&'a Path, ImageKind)>,
}

fn plan(arguments: &Arguments) -> Result<Plan<'_>, Failure> {
    let (width, height) = Job::parse_size(&arguments.size)?;
    let cpus = || std::thread::available_parallelism().map_or(1, |n| n.get());
    let job = Job {
        width,
        height,
        samples: arguments.spp,
        seed: arguments.seed,
        integrator: arguments.integrator,
        max_depth: arguments.max_depth,
        ao_rays: arguments.ao_rays,
        threads: arguments.threads.unwrap_or_else(cpus),
        packet: arguments.packet,
    }
    .validated()?;
    let settings = Settings {
        isa: arguments.isa,
        threads: job.threads,
        quality: arguments.quality,
        robust: arguments.flags.contains(&SceneFlag::Robust),
        compact: arguments.flags.contains(&SceneFlag::Compact),
        tri_accel: arguments.tri_accel.clone(),
    };
    let given = arguments.camera.as_deref().map(parse_view).transpose()?;
    let up = arguments.up.map(|up| match up {
        Up::X => Vec3::X,
        Up::Y => Vec3::Y,
        Up::Z => Vec3::Z,
    });
    let wishes = Wishes {
        eye_and_target: given.map(|(eye, target, _)| (eye, target)),
        up: given.and_then(|(_, _, up)| up).or(up),
        fov_degrees: arguments.fov,
    };
    wishes.check()?;
    let trace = match arguments.savetrace.as_deref() {
        Some([rays, bvh]) if rays == bvh => {
            return Err(Failure::new(format!("{}: given for both the rays and the tree", rays.display())));
        }
        Some([rays, bvh]) => Some([rays.as_path(), bvh.as_path()]),
        _ => None,
    };
    let image = match arguments.output.as_deref() {
        Some(path) => {
            let kind = ImageKind::of(path).ok_or_else(|| {
                Failure::new(format!("{}: a picture's name ends in .png or .exr", path.display()))
            })?;
            Some((path, kind))
        }
        None => None,
    };
    Ok(Plan { job, settings, wishes, trace, image })
}

fn run(arguments: &Arguments) -> Result<Outcome, Failure> {
    let Plan { job, settings, wishes, trace, image } = plan(arguments)?;
    let mut summary = Summary::new(&job);
    summary.scene = arguments.scene.display().to_string();
    let mut clock = Instant::now();
    let mut lap = || std::mem::replace(&mut clock, Instant::now()).elapsed().as_secs_f64();

    let (mesh, warnings) = mesh::read_with(&arguments.scene, &mesh::obj::Options { quads: arguments.quads })?;
    summary.warnings.extend(warnings.to_string().lines().map(str::to_owned));
    (summary.triangles, summary.parts) = (mesh.triangle_count() as u64, mesh.parts.len() as u64);
    summary.seconds.read = lap();

    // A path that cannot be written is known before the work, and the work's result never lost for it.
    let image =
        image.map(|(path, kind)| Ok::<_, FileError>((path, kind, OutputFile::create(path)?))).transpose()?;
    let scene = Scene::new(&mesh, &settings)?;
    let (triangles, _) = scene.triangles();
    summary.seconds.build = lap();

    let size = [job.width, job.height];
    let scenery = Scenery::new(&mesh, &triangles, &mut scene.intersector()?, &wishes, size)?;
    (summary.camera, summary.fov_degrees) = (camera_option(&scenery.view), scenery.view.fov_degrees);
    summary.lights = lights_name(&scenery.lights);
    summary.seconds.frame = lap();
    drop((mesh, triangles));

    let recorder = match trace {
        Some([rays, bvh]) => {
            // The file of rays first: the tree must not replace an old one when there will be no rays.
            let out = files::create(rays)?;
            let (tree, header) = write_tree(&scene, arguments.bvh, bvh, size, &mut summary)?;
            summary.tree = Some(tree);
            summary.seconds.tree = lap();
            Some(start_recorder(rays, out, &header, arguments.compress, job.threads)?)
        }
        None => None,
    };
    for warning in &summary.warnings {
        eprintln!("embree-trace: warning: {warning}");
    }

    let progress = Progress::new("rendering", Tiles::new(&job).len());
    let Rendered { film, tally, refused, .. } = render(&scene, &scenery, &job, recorder.as_ref(), &progress)?;
    drop(progress);
    if let (Some(recorder), Some([rays, _])) = (recorder, trace) {
        let totals = recorder.finish().map_err(|error| named(rays, &error))?;
        summary.rays = Some(RaysLine::new(rays.display().to_string(), &totals));
    }
    summary.seconds.render = lap();
    summary.queries_per_second = tally.total().queries as f64 / summary.seconds.render;
    (summary.queries, summary.refused) = (query_lines(&tally), refused);

    if let Some((path, kind, file)) = image {
        let bytes = film.encode(kind)?;
        file.commit_with(|out| out.write_all(&bytes))?;
        summary.image = Some(path.display().to_string());
    }
    let mut out = std::io::stdout().lock();
    match arguments.format {
        TextOrJson::Text => write!(out, "{summary}")?,
        TextOrJson::Json => {
            serde_json::to_writer_pretty(&mut out, &summary).map_err(std::io::Error::from)?;
            writeln!(out)?;
        }
    }
    Ok(Outcome::Good)
}

/// Writes the `.bvh`; its fingerprint goes into the header of the `.rays`.
fn write_tree(
    scene: &Scene,
    choice: TreeChoice,
    path: &Path,
    image: [u32; 2],
    summary: &mut Summary,
) -> Result<(TreeLine, Header), Failure> {
    // Records name pixels by y * width + x; with the size, tools that see only the files can draw them.
    let meta = serde_json::json!({ "image": image }).to_string();
    let source = match choice {
        TreeChoice::Live => TreeSource::Live,
        TreeChoice::Builder => TreeSource::Builder,
    };
    let BuiltTree { tree, triangles, geometries, producer, flags, warning } = scene.tree(source)?;
    summary.warnings.extend(warning);
    let contents = Contents {
        tree: tree.view(),
        triangles: &triangles,
        geometries: &geometries,
        order: None,
        meta: Some(&meta),
        flags,
        producer: &producer,
    };
    let fingerprint = OutputFile::create(path)?.commit_with(|out| bvh::write(out, &contents))?;
    let bytes = std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let line = TreeLine::new(path.display().to_string(), bytes, producer, tree.view());
    let header = Header {
        fingerprint,
        embree_version: Scene::version(),
        deterministic: true,
        producer: concat!("embree-trace ", env!("CARGO_PKG_VERSION")).to_owned(),
    };
    Ok((line, header))
}

fn start_recorder(
    path: &Path,
    out: File,
    header: &Header,
    compress: bool,
    threads: usize,
) -> Result<Recorder, Failure> {
    let codec = if compress { Codec::Compressed } else { Codec::Raw };
    Recorder::start(out, header, codec, threads).map_err(|error| named(path, &error))
}

/// A recorder's error, which knows no path, with its path.
fn named(path: &Path, error: &RecordError) -> Failure {
    Failure::new(format!("{}: {error}", path.display()))
}
