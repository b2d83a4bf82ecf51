//! `embree-trace`: renders a scene with Embree, or runs a program that does, and records every ray query with its result.

mod record;
mod run;
mod tune;

use clap::{Parser, ValueEnum};
use embree_trace::cli::{self, Failure, Outcome, TextOrJson};
use embree_trace::embree::{Commit, Isa, Quality, Scene, Settings, TreeSource};
use embree_trace::files::{FileError, OutputFile};
use embree_trace::format::rays::Codec;
use embree_trace::geometry::Vec3;
use embree_trace::mesh;
use embree_trace::mesh::obj::Options;
use embree_trace::plant::{self, plant_file};
use embree_trace::progress::Progress;
use embree_trace::render::camera::parse_view;
use embree_trace::render::film::ImageKind;
use embree_trace::render::frames::Sequence;
use embree_trace::render::job::Limits;
use embree_trace::render::pair::Pair;
use embree_trace::render::scenery::{Scenery, Wishes};
use embree_trace::render::summary::{Summary, camera_option, lights_name, query_lines};
use embree_trace::render::tiles::Tiles;
use embree_trace::render::workers::{Rendered, render};
use embree_trace::render::{Integrator, Job};
use std::ffi::OsString;
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
  The same tree and the same queries on every x86-64 CPU, as golden files need them:
    embree-trace box.obj --isa sse42 --size 64x64 --spp 1 --savetrace box.rays box.bvh
  Only a picture, or nothing but the time it takes:
    embree-trace bunny.ply --integrator ao --spp 16 --output bunny.png
    embree-trace bunny.ply --integrator ao --spp 16

  Trace a tree of our own in place of Embree's, and record it, too:
    embree-trace sponza.obj --tree ours.bvh --savetrace casts.rays planted.bvh

  Record a moving mesh, a pair of files a frame; Embree refits its tree from frame to frame, or builds anew:
    embree-trace walk_*.obj --savetrace walk
    embree-trace walk_*.obj --commit rebuild --savetrace rebuilt
    bvh-compare walk/0007.bvh rebuilt/0007.bvh walk/0007.rays
    embree-trace walk_*.obj --tree ours.bvh --savetrace planted

  Let a program that uses Embree render on a tree of our own (see embree-trace run --help):
    embree-trace run --tree ours.bvh -- pathtracer -c scene.ecs -o out.ppm

  All of it at once: how much faster does it render on trees made from its rays (see embree-trace tune --help)?
    embree-trace tune --output out.ppm -- pathtracer -c scene.ecs -o out.ppm

  Record a program that uses Embree (see embree-trace record --help):
    embree-trace record --savetrace casts.rays built.bvh -- blender -b scene.blend -f 1

Exit codes: 0 good, 2 bad input or usage.";

/// Renders a scene with Embree and records every ray query with its result, and the tree that answered.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Arguments {
    /// OBJ or PLY file; may be compressed (.zst). Several are frames of one moving mesh, with the same faces
    #[arg(required = true)]
    scene: Vec<PathBuf>,
    /// Records the queries to RAYS and the tree to BVH (one dash will do, too), or several scenes to the directory DIR:
    /// 0000.rays, 0000.bvh, …; without it, only renders
    #[arg(long, num_args = 1..=2, value_names = ["RAYS|DIR", "BVH"])]
    savetrace: Option<Vec<PathBuf>>,
    /// How Embree commits the vertices of every scene but the first: it refits its tree (the default), or rebuilds it
    #[arg(long, value_enum, requires = "savetrace")]
    commit: Option<CommitChoice>,
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
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=Limits::SAMPLES as i64))]
    spp: u32,
    /// How often a path is scattered at most: also the largest depth of a query
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u8).range(1..=Limits::DEPTH as i64))]
    max_depth: u8,
    /// Ambient occlusion rays per camera ray
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=Limits::AO_RAYS as i64))]
    ao_rays: u32,
    /// Another number gives other random numbers
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Threads that build and render; all CPUs when absent. Does not change a byte of the output
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=Limits::THREADS as i64))]
    threads: Option<u16>,
    /// Camera rays and first shadow rays asked at once: 1, 4, 8 or 16
    #[arg(long, value_name = "N", default_value_t = 1)]
    packet: usize,
    /// Instruction set of Embree's kernels: sse2, sse42, avx, avx2, avx512; the CPU's best when absent
    #[arg(long, value_parser = isa)]
    isa: Option<Isa>,
    /// How long Embree takes for its tree: low, medium or high (spatial splits)
    #[arg(long, default_value = "medium", value_parser = quality)]
    quality: Quality,
    /// Embree's scene flags: robust (watertight; set where a scene stands far from the origin), compact (less memory)
    #[arg(long, value_enum, value_delimiter = ',')]
    flags: Vec<SceneFlag>,
    /// Embree's structure by name, such as bvh4.triangle4v or qbvh8.triangle4
    #[arg(long, value_name = "NAME")]
    tri_accel: Option<String>,
    /// Plants the tree of a .bvh of this scene: Embree's kernels traverse it in place of their own.
    /// What is no tree for this scene is left out, with a warning. With frames, the tree of the
    /// first one, which then follows, or a directory with a tree for each: 0000.bvh, 0001.bvh, …
    #[arg(long, value_name = "BVH|DIR")]
    tree: Option<PathBuf>,
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

impl TreeChoice {
    fn source(self) -> TreeSource {
        match self {
            TreeChoice::Live => TreeSource::Live,
            TreeChoice::Builder => TreeSource::Builder,
        }
    }
}

#[derive(Clone, Copy, Default, ValueEnum)]
enum CommitChoice {
    #[default]
    Refit,
    Rebuild,
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
        Some("run") => return run::main(arguments),
        Some("tune") => return tune::main(arguments),
        Some("render") => drop(arguments.remove(1)),
        _ => {}
    }
    let words = arguments.into_iter().map(spelled);
    let arguments: Arguments = cli::parse_beside("embree-trace", words, |command| {
        command.subcommand(record::command()).subcommand(run::command()).subcommand(tune::command())
    });
    cli::run("embree-trace", || run(&arguments))
}

/// Where recordings go.
enum Trace<'a> {
    Nowhere,
    /// Of one scene.
    Pair(&'a Path, &'a Path),
    /// Of frames.
    Directory(&'a Path),
}

impl<'a> Trace<'a> {
    fn of(arguments: &'a Arguments) -> Result<Trace<'a>, Failure> {
        let targets = arguments.savetrace.as_deref().unwrap_or_default();
        // `--savetrace DIR` in front of the frames would take the first of them as its second value, and write over it.
        if let Some(scene) = targets.iter().find(|target| is_scene_name(target)) {
            return Err(Failure::new(format!(
                "{}: --savetrace would write a recording over a scene; frames stand in front of it, or write --savetrace=DIR",
                scene.display()
            )));
        }
        match (arguments.scene.len(), targets) {
            (1, [rays, bvh]) if rays == bvh => {
                Err(Failure::new(format!("{}: given for both the rays and the tree", rays.display())))
            }
            (1, []) => Ok(Trace::Nowhere),
            (1, [rays, bvh]) => Ok(Trace::Pair(rays, bvh)),
            (1, [directory, ..]) => Err(Failure::new(format!(
                "{}: the recording of one scene needs two files, --savetrace RAYS BVH; a directory is for several frames",
                directory.display()
            ))),
            (_, [directory]) => Ok(Trace::Directory(directory)),
            (count, _) => Err(Failure::new(format!(
                "{count} scenes are frames of a sequence: record them with --savetrace DIR"
            ))),
        }
    }
}

/// Whether a path has the name of a scene rather than of a recording.
fn is_scene_name(path: &Path) -> bool {
    let name = path.to_string_lossy().to_lowercase();
    let name = name.strip_suffix(".zst").unwrap_or(&name);
    name.ends_with(".obj") || name.ends_with(".ply")
}

/// The arguments, checked.
struct Plan<'a> {
    job: Job,
    settings: Settings,
    wishes: Wishes,
    trace: Trace<'a>,
    image: Option<(&'a Path, ImageKind)>,
}

fn plan(arguments: &Arguments) -> Result<Plan<'_>, Failure> {
    let (width, height) = Job::parse_size(&arguments.size)?;
    let cpus = || std::thread::available_parallelism().map_or(1, |n| n.get().min(Limits::THREADS));
    let job = Job {
        width,
        height,
        samples: arguments.spp,
        seed: arguments.seed,
        integrator: arguments.integrator,
        max_depth: arguments.max_depth,
        ao_rays: arguments.ao_rays,
        threads: arguments.threads.map_or_else(cpus, usize::from),
        packet: arguments.packet,
    }
    .validated()?;
    let trace = Trace::of(arguments)?;
    let commit = match (&trace, arguments.commit) {
        (Trace::Directory(_), commit) => match commit.unwrap_or_default() {
            CommitChoice::Refit => Commit::Refit,
            CommitChoice::Rebuild => Commit::Rebuild,
        },
        (_, None) => Commit::Once,
        (_, Some(_)) => {
            return Err(Failure::new("--commit is for the frames of a sequence: there is one scene"));
        }
    };
    let settings = Settings {
        isa: arguments.isa,
        threads: job.threads,
        quality: arguments.quality,
        robust: arguments.flags.contains(&SceneFlag::Robust),
        compact: arguments.flags.contains(&SceneFlag::Compact),
        tri_accel: arguments.tri_accel.clone(),
        commit,
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
    let image = match arguments.output.as_deref() {
        Some(path) if arguments.scene.len() > 1 => {
            return Err(Failure::new(format!(
                "{}: a picture is made of one scene, not of frames",
                path.display()
            )));
        }
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
    let plan = plan(arguments)?;
    let summary = match plan.trace {
        Trace::Directory(directory) => record_frames(arguments, &plan, directory)?,
        _ => trace_one(arguments, plan)?,
    };
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

fn warn(summary: &Summary) {
    for warning in &summary.warnings {
        eprintln!("embree-trace: warning: {warning}");
    }
}

fn codec(arguments: &Arguments) -> Codec {
    if arguments.compress { Codec::Compressed } else { Codec::Raw }
}

fn record_frames(arguments: &Arguments, plan: &Plan, directory: &Path) -> Result<Summary, Failure> {
    let summary = Sequence {
        files: &arguments.scene,
        directory,
        options: Options { quads: arguments.quads, ..Options::default() },
        settings: &plan.settings,
        job: plan.job,
        wishes: plan.wishes,
        source: arguments.bvh.source(),
        codec: codec(arguments),
        trees: arguments.tree.as_deref(),
    }
    .record()?;
    warn(&summary);
    Ok(summary)
}

fn trace_one(arguments: &Arguments, plan: Plan) -> Result<Summary, Failure> {
    let Plan { job, mut settings, wishes, trace, image } = plan;
    let [path] = &arguments.scene[..] else { return Err(Failure::new("expected one scene")) };
    let mut summary = Summary::new(&job);
    summary.scene = path.display().to_string();
    let mut clock = Instant::now();
    let mut lap = || std::mem::replace(&mut clock, Instant::now()).elapsed().as_secs_f64();

    let (mesh, warnings) = mesh::read_with(path, &Options { quads: arguments.quads, ..Options::default() })?;
    summary.warnings.extend(warnings.to_string().lines().map(str::to_owned));
    summary.warnings.extend(settings.suit(&mesh.vertices));
    (summary.triangles, summary.parts) = (mesh.triangle_count() as u64, mesh.parts.len() as u64);
    summary.seconds.read = lap();

    // A path that cannot be written is known before the work, and the work's result never lost for it.
    let image =
        image.map(|(path, kind)| Ok::<_, FileError>((path, kind, OutputFile::create(path)?))).transpose()?;
    let mut scene = Scene::new(&mesh, &settings)?;
    if let Some(path) = &arguments.tree {
        match plant_file(&mut scene, path)? {
            plant::Outcome::Planted(line) => summary.planted = Some(line),
            plant::Outcome::LeftOut(warning) => summary.warnings.push(warning),
        }
    }
    let (triangles, _) = scene.triangles();
    summary.seconds.build = lap();

    let size = [job.width, job.height];
    let scenery = Scenery::new(&mesh, triangles, &mut scene.intersector()?, &wishes, size)?;
    (summary.camera, summary.fov_degrees) = (camera_option(&scenery.view), scenery.view.fov_degrees);
    summary.lights = lights_name(&scenery.lights);
    summary.seconds.frame = lap();
    drop(mesh);

    let pair = match trace {
        Trace::Pair(rays, bvh) => {
            Some(Pair { rays, bvh, codec: codec(arguments), source: arguments.bvh.source() })
        }
        _ => None,
    };
    let mut recorder = None;
    if let Some(pair) = &pair {
        // Records name pixels by y * width + x; with the size, tools that see only the files can draw them.
        let started = pair.start(&scene, &serde_json::json!({ "image": size }), job.threads)?;
        summary.warnings.extend(started.warning);
        (summary.tree, recorder) = (Some(started.tree), Some(started.recorder));
        summary.seconds.tree = lap();
    }
    warn(&summary);

    let progress = Progress::new("rendering", Tiles::new(&job).len());
    let Rendered { film, tally, refused, .. } = render(&scene, &scenery, &job, recorder.as_ref(), &progress)?;
    drop(progress);
    if let (Some(recorder), Some(pair)) = (recorder, &pair) {
        summary.rays = Some(pair.finish(recorder)?);
    }
    summary.seconds.render = lap();
    summary.queries_per_second = tally.total().queries as f64 / summary.seconds.render;
    (summary.queries, summary.refused) = (query_lines(&tally), refused);

    if let Some((path, kind, file)) = image {
        let bytes = film.encode(kind)?;
        file.commit_with(|out| out.write_all(&bytes))?;
        summary.image = Some(path.display().to_string());
    }
    Ok(summary)
}
