//! `bvh-compare A.bvh B.bvh … RAYS…`: the same recorded queries over several trees.

use clap::{Parser, ValueEnum};
use embree_trace::cli::{self, Failure, Outcome};
use embree_trace::compare::baseline::Baseline;
use embree_trace::compare::explained;
use embree_trace::compare::kernels::{Kernels, Wanted};
use embree_trace::compare::limit::Metric;
use embree_trace::compare::reports::Observed;
use embree_trace::compare::{self, Allowed, Candidate, Comparison, Recording, Settings};
#[cfg(feature = "embree")]
use embree_trace::embree::Isa;
use embree_trace::files::{FileError, MappedFile, OutputFile};
use embree_trace::format::FileKind;
use embree_trace::format::bvh::Bvh;
use embree_trace::format::rays::Rays;
use embree_trace::progress::Progress;
use embree_trace::ranks::Ranks;
use embree_trace::replay::pixels::ImageSize;
use embree_trace::replay::query::Choice;
use embree_trace::replay::select::{Filter, Portion};
use embree_trace::replay::sort::Sort;
use embree_trace::replay::tally::Costs;
use embree_trace::report::circumstances::Circumstances;
use embree_trace::report::costs::{self, CostsFile};
use embree_trace::report::{csv, heatmap, html, json, table};
use embree_trace::traverse::packet::MOST;
use embree_trace::traverse::{OrderName, Traversal};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

const PROGRAM: &str = "bvh-compare";

const EXAMPLES: &str = "\
Examples:
  bvh-compare built.bvh ours.bvh casts.rays
  bvh-compare built.bvh ours.bvh casts.rays --filter purpose=shadow,depth=1.. --format json
  bvh-compare built.bvh ours.bvh casts.rays --sample 100000 --fail-above 1.02
  bvh-compare built.bvh ours.bvh casts.rays --fail-above 1.05 --fail-metric ns --allow-wrong 3
  bvh-compare ours.bvh casts.rays --baseline yesterday.json --fail-above 1.02
  bvh-compare built.bvh ours.bvh casts.rays --held-out 0.1
  bvh-compare built.bvh ours.bvh casts.rays other-camera.rays
  bvh-compare ours.bvh casts.rays --filter kind=occlusion --traversal odf --occlusion-order nearest
  bvh-compare built.bvh ours.bvh casts.rays --heatmap pictures --size 640x480
  bvh-compare built.bvh ours.bvh casts.rays --packet 64 --sort direction --time
  bvh-compare built.bvh ours.bvh casts.rays --html report.html
  bvh-compare built.bvh ours.bvh casts.rays --time --robust
  bvh-compare built.bvh area.bvh *.ours.bvh casts.rays --fit --fit-costs costs.json --rounds 9
  bvh-compare --fit-reports sponza.json bunny.json --fit-costs costs.json
  mpirun -n 4 bvh-compare --mpi built.bvh ours.bvh casts.rays

Filters are conditions joined by commas: purpose=camera+diffuse (unknown, camera, shadow, ao, diffuse,
specular), kind=closest or kind=occlusion, depth=1.. (also 2, 0..3 without 3, 0..=2, unknown), path=0..640.

Exit code 0: every answer is right. 1: a wrong answer (\"failed:\"), or a tree above --fail-above (\"above the limit:\"). 2: bad input.";

/// Replays recorded ray queries over trees, counts what each costs, and checks every answer.
#[derive(Parser)]
#[command(name = PROGRAM, version, after_help = EXAMPLES, override_usage = "bvh-compare [OPTIONS] <BVH>... <RAYS>...")]
struct Arguments {
    /// One or more trees (.bvh), then one or more recordings (.rays) of their scene, each reported apart
    #[arg(required_unless_present = "fit_reports", num_args = 2.., value_names = ["BVH", "RAYS"])]
    files: Vec<PathBuf>,

    /// Orders of traversal; the first one decides --fail-above
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = Traversal::ALL)]
    traversal: Vec<Traversal>,

    /// Order in which depth-first occlusion queries visit the children of a node; without this, what the tree's ORDR section
    /// says where it has one, else last in a tree of more than two children a node, as Embree's kernels go, and nearest in a binary one
    #[arg(long, value_enum, value_name = "ORDER")]
    occlusion_order: Option<OrderName>,

    /// Ask queries in packets of N consecutive ones of a chunk and of one kind, depth and purpose, 16 to 256, not one by one
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(16..=MOST as i64))]
    packet: Option<u16>,

    /// Sort the queries of a chunk and of one kind, depth and purpose before they are asked: by octant of direction, then by
    #[arg(long, value_enum, value_name = "KEY")]
    sort: Option<Sort>,

    /// What a box test costs
    #[arg(long, default_value_t = 1.0, value_parser = cost)]
    ci: f64,

    /// What a primitive test costs
    #[arg(long, default_value_t = 1.0, value_parser = cost)]
    cp: f64,

    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,

    /// Exit with 1 when a tree's cost, under the first traversal, exceeds RATIO times the first tree's
    #[arg(long, value_name = "RATIO", value_parser = cost)]
    fail_above: Option<f64>,

    /// By what --fail-above goes: cost (what visits, leaves and blocks of triangles take), ns (time, which is then measured), visits of nodes,
    /// gamma (box and primitive tests) or sah
    #[arg(long, value_name = "METRIC", default_value = "cost", requires = "fail_above")]
    fail_metric: Metric,

    /// Compare with an earlier report of --format json, also of other geometry or another recording: --fail-above is then about what each
    /// tree was there (by the name of its file, else by its place)
    #[arg(long, value_name = "REPORT")]
    baseline: Option<PathBuf>,

    /// Exit with 0 in spite of up to N wrong answers of each tree: for a recording that cannot be perfect
    #[arg(long, value_name = "N", default_value_t = 0)]
    allow_wrong: u64,

    /// Exit with 1 when more than N answers of a tree are borderline; without this, any number may be
    #[arg(long, value_name = "N")]
    allow_borderline: Option<u64>,

    /// What visits, leaves and blocks cost on a machine, in nanoseconds, as bvh-build --costs reads it; without this, constants that are the same
    /// everywhere
    #[arg(long, value_name = "FILE")]
    costs: Option<PathBuf>,

    /// Replay only N queries, spread over the recording, always the same ones
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    sample: Option<u64>,

    /// Replay only these queries (see below)
    #[arg(long, default_value = "", hide_default_value = true)]
    filter: Filter,

    /// Replay only queries that bvh-build --train FRACTION, with the same --seed, has not seen
    #[arg(long, value_name = "FRACTION", value_parser = share)]
    held_out: Option<f64>,

    /// Seed of --held-out
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Replay the queries of this scene; without this, of the one that the trees are of, when the
    /// recording holds several
    #[arg(long, value_name = "N")]
    scene: Option<u16>,

    /// Threads; 0: as many as there are processors
    #[arg(long, default_value_t = 0, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=1024))]
    threads: u16,

    /// Also count tests by level of the tree, and cache lines; every query is followed once more for it. Not for packets
    #[arg(long)]
    details: bool,

    /// Measure time however long it takes: the same queries without counting on one pinned thread, our traversals and Embree's kernels on each tree,
    /// all in turn; asks Embree as --embree does. Without this, as many of them as 10 seconds are enough for, without Embree's answers
    #[arg(long)]
    time: bool,

    /// Do not measure time: then nothing in the report depends on the machine but the seconds that counting took
    #[arg(long, conflicts_with_all = ["time", "fit", "fit_costs"])]
    no_time: bool,

    /// Also ask Embree's own kernels on each tree, planted in a scene of its triangles, and check what they answer
    #[cfg(feature = "embree")]
    #[arg(long)]
    embree: bool,

    /// Instruction set of Embree's kernels: sse2, sse42, avx, avx2, avx512; without this, the best that the processor has
    #[cfg(feature = "embree")]
    #[arg(long, value_parser = isa)]
    isa: Option<Isa>,

    /// Ask Embree's robust kernels, as Blender's Cycles does; set where a scene stands far from the origin
    #[cfg(feature = "embree")]
    #[arg(long)]
    robust: bool,

    /// Rounds in which time is measured, after one that warms up
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,

    /// Also fit what a visit, a leaf, a block of triangles and a cache miss cost to measured times, by kind and width, of our traversal and of
    /// Embree's kernels, and say how measures rank the trees; measures as --time does
    #[arg(long)]
    fit: bool,

    /// Write the fitted costs to FILE, as --costs of this command and of bvh-build reads it: of Embree's kernels where they follow the trees, else of
    /// our traversal; fits as --fit does
    #[arg(long, value_name = "FILE")]
    fit_costs: Option<PathBuf>,

    /// In place of trees and rays: fit costs to what earlier reports of --fit --format json observed, all scenes together
    #[arg(long, value_name = "REPORT", num_args = 1.., conflicts_with_all = ["files", "mpi", "html", "heatmap"])]
    fit_reports: Vec<PathBuf>,

    /// Write a picture of the cost per pixel for each tree and traversal to DIR
    #[arg(long, value_name = "DIR")]
    heatmap: Option<PathBuf>,

    /// Write a report with tables, charts and heat maps to FILE, one page that needs nothing else; counts as --details does
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,

    /// Size of the traced image, where the trees do not say; one per recording, or one for all
    #[arg(long, value_name = "WxH", value_delimiter = ',')]
    size: Vec<ImageSize>,

    /// Share the recordings' chunks with the other processes that mpirun started; the first prints, the same as one process would
    #[arg(long, conflicts_with_all = ALONE)]
    mpi: bool,
}

/// What one process does by itself.
#[cfg(feature = "embree")]
const ALONE: [&str; 4] = ["time", "fit", "fit_costs", "embree"];
#[cfg(not(feature = "embree"))]
const ALONE: [&str; 3] = ["time", "fit", "fit_costs"];

/// Time that measuring may take where nobody asked for it.
const BUDGET: Duration = Duration::from_secs(10);

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Table,
    Json,
    Csv,
}

fn cost(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(value),
        _ => Err("expected a number, 0 or greater".to_owned()),
    }
}

#[cfg(feature = "embree")]
fn isa(name: &str) -> Result<Isa, String> {
    Isa::from_name(name).ok_or_else(|| format!("expected one of {}", Isa::ALL.map(Isa::name).join(", ")))
}

fn share(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(share) if share > 0.0 && share < 1.0 => Ok(share),
        _ => Err("expected a number between 0 and 1".to_owned()),
    }
}

fn main() -> ExitCode {
    let arguments: Arguments = cli::parse(PROGRAM, std::env::args_os());
    cli::run_on_ranks(PROGRAM, arguments.mpi, arguments.threads.into(), |ranks| run(&arguments, ranks))
}

fn run(arguments: &Arguments, ranks: &dyn Ranks) -> Result<Outcome, Failure> {
    if !arguments.fit_reports.is_empty() {
        return fit_reports(arguments);
    }
    let prints = ranks.rank() == 0;
    let files = arguments.files.iter().map(|path| MappedFile::open(path)).collect::<Result<Vec<_>, _>>()?;
    // The recordings are the last files; the first is a tree and the last a recording, or the error says what they are.
    let recording = |file: &&MappedFile| FileKind::of(file) == Some(FileKind::Rays);
    let recordings = files[1..].iter().rev().take_while(recording).count().max(1);
    let (tree_files, rays_files) = files.split_at(files.len() - recordings);
    let (tree_paths, rays_paths) = arguments.files.split_at(tree_files.len());
    let rays = parse_all(rays_paths, rays_files, Rays::parse)?;
    let trees = parse_all(tree_paths, tree_files, Bvh::parse)?;

    let candidates: Vec<Candidate> = tree_paths
        .iter()
        .zip(&trees)
        .map(|(path, bvh)| Candidate { path: path.display().to_string(), bvh })
        .collect();
    // Sizes help to name pixels, but only pictures cannot do without.
    let said = trees.iter().find_map(compare::image_size);
    let size = |number: usize| arguments.size.get(number).or(arguments.size.last()).copied().or(said);
    let mut recordings = Vec::with_capacity(rays.len());
    for (number, (path, rays)) in rays_paths.iter().zip(&rays).enumerate() {
        let path = path.display().to_string();
        let (scene, warnings) = check(&candidates, &path, rays, arguments.scene)?;
        warnings.iter().filter(|_| prints).for_each(|line| eprintln!("{PROGRAM}: warning: {line}"));
        recordings.push(Recording { path, rays, scene, image: size(number) });
    }
    if arguments.heatmap.is_some() && size(0).is_none() {
        return Err(Failure::new(
            "--heatmap needs the size of the traced image, which no tree says; give --size WxH",
        ));
    }

    let mut traversals = arguments.traversal.clone();
    let mut seen = Vec::new();
    traversals.retain(|traversal| {
        !seen.contains(traversal) && {
            seen.push(*traversal);
            true
        }
    });
    let settings = Settings {
        traversals,
        occlusion_order: arguments.occlusion_order,
        costs: Costs { c_i: arguments.ci, c_p: arguments.cp },
        machine: arguments.costs.as_deref().map_or(Ok(Default::default()), cli::costs)?,
        baseline: arguments.baseline.as_deref().map(baseline).transpose()?,
        allowed: Allowed { wrong: arguments.allow_wrong, borderline: arguments.allow_borderline },
        choice: Choice {
            scene: recordings[0].scene,
            filter: arguments.filter.clone(),
            held_out: arguments.held_out.map(|share| Portion { share, seed: arguments.seed }),
            sample: arguments.sample,
        },
        pixels: arguments.heatmap.is_some() || arguments.html.is_some(),
        sort: arguments.sort,
        packet: arguments.packet.map(usize::from),
        profile: arguments.details || arguments.html.is_some(),
        kernels: arguments.kernels(),
        answers: arguments.asks_embree(),
        rounds: (arguments.is_timed() || arguments.may_be_timed()).then_some(arguments.rounds),
        budget: arguments.may_be_timed().then_some(BUDGET),
        fit: arguments.fits(),
    };
    let queries: u64 = rays.iter().map(Rays::query_count).sum();
    let replays = trees.len() * settings.traversals.len() + usize::from(settings.answers);
    let steps = queries * replays as u64 / ranks.count() as u64;
    let progress = if prints { Progress::new("replaying", steps) } else { Progress::hidden() };
    let comparison = compare::compare(&candidates, &recordings, settings, ranks, &progress)?;
    drop(progress);
    if let Some(Err(why)) = comparison.kernels.as_ref().filter(|_| prints) {
        eprintln!("{PROGRAM}: warning: Embree has no scene of these triangles: {why}");
    }

    if let Some(why) = comparison.left_out.as_ref().filter(|_| prints && arguments.format == Format::Csv) {
        eprintln!("{PROGRAM}: {why}");
    }

    let wrong = comparison.failures();
    let limit = arguments.fail_above.into_iter();
    let above: Vec<String> = limit.flat_map(|limit| comparison.above(arguments.fail_metric, limit)).collect();
    if prints {
        wrong.iter().for_each(|line| eprintln!("{PROGRAM}: failed: {line}"));
        above.iter().for_each(|line| eprintln!("{PROGRAM}: above the limit: {line}"));
        print(arguments, &comparison, &[&wrong[..], &above].concat())?;
    }
    Ok(if wrong.is_empty() && above.is_empty() { Outcome::Good } else { Outcome::Failed })
}

impl Arguments {
    /// Whether times are wanted, for themselves or for what is made of them.
    fn is_timed(&self) -> bool {
        self.time || self.fits() || (self.fail_above.is_some() && self.fail_metric == Metric::Nanoseconds)
    }

    /// Whether they are measured if that takes no longer than [`BUDGET`]. Processes that share queries are not alone on a machine.
    fn may_be_timed(&self) -> bool {
        !(self.is_timed() || self.no_time || self.mpi)
    }

    /// Whether the answers of Embree's kernels are wanted.
    #[cfg(feature = "embree")]
    fn asks_embree(&self) -> bool {
        self.embree || self.is_timed()
    }

    #[cfg(not(feature = "embree"))]
    fn asks_embree(&self) -> bool {
        false
    }

    fn fits(&self) -> bool {
        self.fit || self.fit_costs.is_some()
    }

    /// Which of Embree's kernels to ask, if any.
    #[cfg(feature = "embree")]
    fn kernels(&self) -> Option<Wanted> {
        let wanted = Wanted { isa: self.isa.map(Isa::name), robust: self.robust };
        (self.asks_embree() || self.may_be_timed()).then_some(wanted)
    }

    /// There are none, which is said where they would be timed.
    #[cfg(not(feature = "embree"))]
    fn kernels(&self) -> Option<Wanted> {
        self.may_be_timed().then(Wanted::default)
    }
}

/// Writes all that was asked for.
fn print(arguments: &Arguments, comparison: &Comparison, failures: &[String]) -> Result<(), Failure> {
    if let Some(directory) = &arguments.heatmap {
        write_pictures(directory, comparison)?;
    }
    if let Some(path) = &arguments.html {
        write_page(path, comparison, failures)?;
    }
    if let Some(path) = &arguments.fit_costs {
        let measured =
            comparison.recordings.iter().map(|recording| explained::measured(comparison, recording));
        let kernels = comparison.kernels.as_ref().and_then(|kernels| kernels.as_ref().ok());
        let fits = explained::fitted(&explained::together(measured));
        write_costs(path, &fits, kernels.map(Kernels::name))?;
    }
    let text = match arguments.format {
        Format::Table => table::render(comparison, arguments.details),
        Format::Json => json::render(comparison, failures)? + "\n",
        Format::Csv => csv::render(comparison),
    };
    std::io::stdout().lock().write_all(text.as_bytes())?;
    Ok(())
}

/// Fits costs to what earlier reports observed, all of them together.
fn fit_reports(arguments: &Arguments) -> Result<Outcome, Failure> {
    let (mut measured, mut kernels) = (Vec::new(), None);
    for path in &arguments.fit_reports {
        let bytes = MappedFile::open(path)?;
        let text = std::str::from_utf8(&bytes).map_err(|error| Failure::in_file(path, error))?;
        let observed = Observed::parse(text).map_err(|error| Failure::in_file(path, error))?;
        measured.extend(observed.recordings);
        kernels = kernels.or(observed.kernels);
    }
    let fits = explained::fitted(&explained::together(measured));
    if let Some(path) = &arguments.fit_costs {
        write_costs(path, &fits, kernels)?;
    }
    let text = match arguments.format {
        Format::Table => table::fitted(&fits),
        Format::Json => json::render_fits(&fits)? + "\n",
        Format::Csv => return Err(Failure::new("--fit-reports prints a table or JSON: give --format json")),
    };
    std::io::stdout().lock().write_all(text.as_bytes())?;
    Ok(Outcome::Good)
}

/// Writes fitted costs; a line says which keep their default.
fn write_costs(path: &Path, fits: &[explained::Fitted], kernels: Option<String>) -> Result<(), Failure> {
    let circumstances = Circumstances::of(PROGRAM, std::iter::empty());
    let CostsFile { json, said } =
        costs::render(fits, kernels.as_deref(), &circumstances).map_err(Failure::new)?;
    OutputFile::create(path)?.commit_with(|out| out.write_all(json.as_bytes()))?;
    eprintln!("{PROGRAM}: {}: {said}", path.display());
    Ok(())
}

/// Reads an earlier report.
fn baseline(path: &Path) -> Result<Baseline, Failure> {
    let bytes = MappedFile::open(path)?;
    let text = std::str::from_utf8(&bytes).map_err(|error| Failure::in_file(path, error))?;
    Baseline::parse(text).map_err(|error| Failure::in_file(path, error))
}

/// Reads files of one kind; an error says which file.
fn parse_all<'a, T, E: std::error::Error + 'static>(
    paths: &[PathBuf],
    files: &'a [MappedFile],
    parse: impl Fn(&'a [u8]) -> Result<T, E>,
) -> Result<Vec<T>, Failure> {
    paths
        .iter()
        .zip(files)
        .map(|(path, file)| parse(file).map_err(|error| Failure::in_file(path, error)))
        .collect()
}

/// Refuses a recording of another scene, and returns the number of the trees' own and what there is
/// to warn of.
fn check(
    candidates: &[Candidate],
    path: &str,
    rays: &Rays,
    asked: Option<u16>,
) -> Result<(u16, Vec<String>), Failure> {
    let (scene, warning) = compare::check_scenes(candidates, path, rays, asked)?;
    let mut warnings = Vec::from_iter(warning);
    if let Some(recovery) = &rays.recovery {
        let (queries, lost) = (recovery.queries, recovery.lost_bytes);
        warnings.push(format!(
            "{path}: the recording was cut off; {queries} queries recovered, {lost} bytes lost"
        ));
    }
    Ok((scene, warnings))
}

fn write_page(path: &Path, comparison: &Comparison, failures: &[String]) -> Result<(), Failure> {
    let arguments = std::env::args_os().map(|argument| argument.to_string_lossy().into_owned());
    let page = html::render(comparison, &Circumstances::of(PROGRAM, arguments), failures);
    OutputFile::create(path)?.commit_with(|out| out.write_all(page.as_bytes()))?;
    eprintln!("{PROGRAM}: the report is in {}", path.display());
    Ok(())
}

fn write_pictures(directory: &Path, comparison: &Comparison) -> Result<(), Failure> {
    std::fs::create_dir_all(directory).map_err(|error| FileError::new(directory, "make", error))?;
    for map in heatmap::render(comparison) {
        let path = directory.join(&map.file_name);
        map.picture.save(&path).map_err(|error| Failure::in_file(&path, error))?;
    }
    eprintln!("{PROGRAM}: heat maps are in {}", directory.display());
    Ok(())
}
