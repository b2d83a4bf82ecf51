//! The paper's figures: parses arguments, calls [`embree_trace::experiment`], writes CSV, SVG and PNG.

use clap::{Args, Parser, Subcommand};
use embree_trace::cli::{self, Failure, Outcome};
use embree_trace::experiment::shape::Shape;
use embree_trace::experiment::trace::Trace;
use embree_trace::experiment::{self, ExperimentError, Settings};
use embree_trace::files::{FileError, MappedFile, OutputFile};
use embree_trace::format::bvh::Bvh;
use embree_trace::format::rays::Rays;
use embree_trace::progress::Progress;
use embree_trace::report::plot::Figure;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const EXAMPLES: &str = "\
Examples:
  bvh-experiment shapes --quick
  bvh-experiment shapes --optimize
  bvh-experiment blend --out figures --trials 10 --seed 1
  bvh-experiment shapes --save traces
  bvh-experiment optimum --scenes 1000 --triangles 10
  bvh-experiment alpha casts.bvh
  bvh-experiment sampling built.bvh --rays casts.rays --queries 1000000
  bvh-experiment scenes recordings
  bvh-experiment animation frames

A SCENE is a .bvh; its queries are the .rays of the same name, unless --rays says otherwise.";

/// The experiments of "Building Better BVHs by Using Ray Distributions" (2011), as CSV, SVG and PNG
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Arguments {
    #[command(subcommand)]
    experiment: Experiment,
}

#[derive(Subcommand)]
enum Experiment {
    /// Trees with full ray information against SAH, on sphere, plane, hemisphere and tube, over focus
    Shapes(Shapes),
    /// Rays and area blended by weight, on the sphere
    Blend(Generated),
    /// T_R over the exponent of the count (the powerplant figure) on any recorded scene
    Alpha(Scene),
    /// Visits of each inner node by RayOrder and by ODF
    Traversal(Scene),
    /// How well static predictors tell the cost of a subtree
    StaticCost(Scene),
    /// Trees from the queries of 16×16 to 256×256 pixels, counted on all queries
    Sampling(Sampling),
    /// Every recorded scene in a folder × every builder: a table
    Scenes(Scenes),
    /// Refitting, rotating and rebuilding from frame to frame of a moving scene (embree-trace FRAMES… --savetrace DIR)
    Animation(Scenes),
    /// Every heuristic and optimiser against the best of all trees, on random scenes of a few triangles
    Optimum(Optimum),
}

#[derive(Args)]
struct Common {
    /// Directory for the results; it is made if missing
    #[arg(long, value_name = "DIR", default_value = "experiments")]
    out: PathBuf,
    /// Fewer points, for a first look
    #[arg(long)]
    quick: bool,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

#[derive(Args)]
struct Generated {
    #[command(flatten)]
    common: Common,
    /// Random repetitions of each point
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    trials: u64,
    /// Also write the first trials' geometry and rays there, as .bvh and .rays
    #[arg(long, value_name = "DIR")]
    save: Option<PathBuf>,
}

#[derive(Args)]
struct Shapes {
    #[command(flatten)]
    generated: Generated,
    /// Also trees from all rays that are optimised on them
    #[arg(long)]
    optimize: bool,
}

#[derive(Args)]
struct Optimum {
    #[command(flatten)]
    common: Common,
    /// Random scenes: 1000, or 50 when quick
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    scenes: Option<u64>,
    /// Triangles of a scene, 2 to 14
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(2..=experiment::optimum::MAX_TRIANGLES as u64))]
    triangles: u64,
}

#[derive(Args)]
struct Traced {
    #[command(flatten)]
    common: Common,
    /// About how many queries to take: those of whole pixels, drawn by --seed
    #[arg(long, default_value_t = 262_144, value_parser = clap::value_parser!(u64).range(1..))]
    queries: u64,
    /// The queries of this scene; without this, of the one that the tree is of, when the recording
    /// holds several
    #[arg(long = "scene", value_name = "N")]
    number: Option<u16>,
}

#[derive(Args)]
struct Scene {
    /// A .bvh file
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// The queries, if not in the .rays of the same name
    #[arg(long, value_name = "RAYS")]
    rays: Option<PathBuf>,
    #[command(flatten)]
    traced: Traced,
}

#[derive(Args)]
struct Sampling {
    #[command(flatten)]
    scene: Scene,
    /// Random samples of each size
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=1000))]
    trials: u64,
}

#[derive(Args)]
struct Scenes {
    /// A folder with .bvh files and a .rays of the same name for each
    #[arg(value_name = "DIR")]
    directory: PathBuf,
    #[command(flatten)]
    traced: Traced,
}

fn main() -> ExitCode {
    let arguments: Arguments = cli::parse("bvh-experiment", std::env::args_os());
    cli::run("bvh-experiment", || run(&arguments.experiment))
}

fn run(experiment: &Experiment) -> Result<Outcome, Failure> {
    match experiment {
        Experiment::Shapes(Shapes { generated: options, optimize }) => {
            let settings = options.settings();
            let rows = experiment::shapes::run(&settings, *optimize)?;
            options.save(&Shape::ALL, &settings)?;
            write!(std::io::stdout(), "{}", experiment::shapes::markdown(&rows))?;
            let csv = |out: &mut dyn Write| experiment::write_csv(&rows, out);
            options.common.write("shapes", csv, experiment::shapes::figure(&rows))
        }
        Experiment::Blend(options) => {
            let settings = options.settings();
            let rows = experiment::blend::run(&settings)?;
            options.save(&[Shape::Sphere], &settings)?;
            let csv = |out: &mut dyn Write| experiment::write_csv(&rows, out);
            options.common.write("blend", csv, experiment::blend::figure(&rows))
        }
        Experiment::Alpha(scene) => {
            let rows = scene.traced.with(&scene.scene, scene.rays(), |_, trace| {
                experiment::alpha::run(trace, &scene.traced.settings(1))
            })?;
            let csv = |out: &mut dyn Write| experiment::alpha::write_csv(&rows, out);
            scene.traced.common.write("alpha", csv, experiment::alpha::figure(&rows, &scene.name()))
        }
        Experiment::Traversal(scene) => {
            let rows = scene
                .traced
                .with(&scene.scene, scene.rays(), |_, trace| experiment::traversal::run(trace))?;
            let csv = |out: &mut dyn Write| experiment::traversal::write_csv(&rows, out);
            scene.traced.common.write("traversal", csv, experiment::traversal::figure(&rows, &scene.name()))
        }
        Experiment::StaticCost(scene) => {
            let rows = scene
                .traced
                .with(&scene.scene, scene.rays(), |_, trace| experiment::static_cost::run(trace))?;
            let common = &scene.traced.common;
            let csv = |out: &mut dyn Write| experiment::static_cost::write_csv(&rows, out);
            let siblings = experiment::static_cost::siblings(&rows, &scene.name());
            let figures = [
                ("static-cost", experiment::static_cost::scatter(&rows, &scene.name())),
                ("static-cost-siblings", siblings),
            ];
            common.write_all("static-cost", csv, &figures)
        }
        Experiment::Sampling(Sampling { scene, trials }) => {
            let rows = scene.traced.with(&scene.scene, scene.rays(), |_, trace| {
                experiment::sampling::run(trace, &scene.traced.settings(*trials))
            })?;
            let csv = |out: &mut dyn Write| experiment::sampling::write_csv(&rows, out);
            scene.traced.common.write("sampling", csv, experiment::sampling::figure(&rows, &scene.name()))
        }
        Experiment::Scenes(options) => {
            let mut rows = Vec::new();
            for path in recordings(&options.directory)? {
                let name = name(&path);
                rows.extend(options.traced.with(&path, path.with_extension("rays"), |bvh, trace| {
                    experiment::scenes::run(&name, bvh.tree, trace, &options.traced.settings(1))
                })?);
            }
            write!(std::io::stdout(), "{}", experiment::scenes::markdown(&rows))?;
            let csv = |out: &mut dyn Write| experiment::scenes::write_csv(&rows, out);
            options.traced.common.write("scenes", csv, experiment::scenes::figure(&rows))
        }
        Experiment::Animation(options) => {
            let paths = recordings(&options.directory)?;
            if paths.len() < 2 {
                let what =
                    "one frame alone does not move; record several with embree-trace FRAMES… --savetrace DIR";
                return Err(Failure::new(format!("{}: {what}", options.directory.display())));
            }
            let progress = Progress::new("frames", experiment::animation::steps(paths.len()));
            let load = |frame: usize| {
                let path = &paths[frame];
                options.traced.with(path, path.with_extension("rays"), |_, trace| Ok(trace.clone()))
            };
            let rows = experiment::animation::run(paths.len(), load, &options.traced.settings(1), &progress);
            drop(progress);
            let rows = rows?;
            write!(std::io::stdout(), "{}", experiment::animation::markdown(&rows))?;
            let csv = |out: &mut dyn Write| experiment::animation::write_csv(&rows, out);
            let figure = experiment::animation::figure(&rows, &name(&options.directory));
            options.traced.common.write("animation", csv, figure)
        }
        Experiment::Optimum(Optimum { common, scenes, triangles }) => {
            let trials = scenes.unwrap_or(if common.quick { 50 } else { 1000 });
            let settings = Settings { quick: common.quick, seed: common.seed, trials };
            let rows = experiment::optimum::run(&settings, *triangles as usize)?;
            write!(std::io::stdout(), "{}", experiment::optimum::markdown(&rows))?;
            let csv = |out: &mut dyn Write| experiment::optimum::write_csv(&rows, out);
            common.write("optimum", csv, experiment::optimum::figure(&rows, *triangles as usize))
        }
    }
}

/// What figures call a scene: its file without folder and extension.
fn name(path: &Path) -> String {
    path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// The .bvh files of a folder that have a .rays, by name.
fn recordings(directory: &Path) -> Result<Vec<PathBuf>, Failure> {
    let read = || -> std::io::Result<Vec<PathBuf>> {
        std::fs::read_dir(directory)?.map(|entry| entry.map(|entry| entry.path())).collect()
    };
    let mut paths = read().map_err(|error| FileError::new(directory, "list", error))?;
    paths
        .retain(|path| path.extension().is_some_and(|e| e == "bvh") && path.with_extension("rays").is_file());
    paths.sort();
    if paths.is_empty() {
        let what = "no .bvh with a .rays of the same name; record scenes there with embree-trace --savetrace";
        return Err(Failure::new(format!("{}: {what}", directory.display())));
    }
    Ok(paths)
}

impl Scene {
    fn rays(&self) -> PathBuf {
        self.rays.clone().unwrap_or_else(|| self.scene.with_extension("rays"))
    }

    fn name(&self) -> String {
        name(&self.scene)
    }
}

impl Traced {
    fn settings(&self, trials: u64) -> Settings {
        Settings { quick: self.common.quick, seed: self.common.seed, trials }
    }

    /// Maps both files and runs `work` on what they hold.
    fn with<T>(
        &self,
        bvh_path: &Path,
        rays_path: PathBuf,
        work: impl FnOnce(&Bvh, &Trace) -> Result<T, ExperimentError>,
    ) -> Result<T, Failure> {
        let (bvh_file, rays_file) = (MappedFile::open(bvh_path)?, MappedFile::open(&rays_path)?);
        let bvh = Bvh::parse(&bvh_file).map_err(|error| Failure::in_file(bvh_path, error))?;
        let rays = Rays::parse(&rays_file).map_err(|error| Failure::in_file(&rays_path, error))?;
        let queries = if self.common.quick { self.queries.min(32_768) } else { self.queries };
        let trace = Trace::new(&bvh, &rays, self.number, queries, self.common.seed)
            .map_err(|error| Failure::in_file(&rays_path, error))?;
        work(&bvh, &trace).map_err(|error| Failure::in_file(&rays_path, error))
    }
}

impl Generated {
    fn settings(&self) -> Settings {
        Settings { quick: self.common.quick, seed: self.common.seed, trials: self.trials }
    }

    fn save(&self, shapes: &[Shape], settings: &Settings) -> Result<(), ExperimentError> {
        let Some(directory) = &self.save else { return Ok(()) };
        make_directory(directory)?;
        experiment::save::first_trials(shapes, settings, directory)
    }
}

impl Common {
    /// Writes `name`.csv, .svg and .png, and says where they are.
    fn write(
        &self,
        name: &'static str,
        csv: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
        figure: Figure,
    ) -> Result<Outcome, Failure> {
        self.write_all(name, csv, &[(name, figure)])
    }

    /// Writes `name`.csv and every figure; says where they are when all are there (a pipe may be closed early).
    fn write_all(
        &self,
        name: &str,
        csv: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
        figures: &[(&str, Figure)],
    ) -> Result<Outcome, Failure> {
        make_directory(&self.out)?;
        let path = self.out.join(format!("{name}.csv"));
        OutputFile::create(&path)?.commit_with(csv)?;
        let mut written = format!("{}\n", path.display());
        for (name, figure) in figures {
            figure.write(&self.out, name)?;
            for extension in ["svg", "png"] {
                let path = self.out.join(format!("{name}.{extension}"));
                written += &format!("{}\n", path.display());
            }
        }
        write!(std::io::stdout(), "{written}")?;
        Ok(Outcome::Good)
    }
}

fn make_directory(path: &Path) -> Result<(), FileError> {
    std::fs::create_dir_all(path).map_err(|error| FileError::new(path, "create", error))
}
