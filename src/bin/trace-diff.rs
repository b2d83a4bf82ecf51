//! `trace-diff`: whether two traces or two trees hold the same.

use clap::Parser;
use embree_trace::cli::{self, Failure, Outcome, TextOrJson};
use embree_trace::compare::image_size;
use embree_trace::diff::{self, DiffError, Options, Tolerance, Trees};
use embree_trace::files::MappedFile;
use embree_trace::format::bvh::Bvh;
use embree_trace::progress::Progress;
use embree_trace::replay::pixels::ImageSize;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

/// Compare two traces (.rays) or two trees (.bvh): how many differences, where, and the first
#[derive(Parser)]
#[command(
    version,
    after_help = "\
Examples:
  trace-diff golden.rays casts.rays                     is the renderer still asking the same?
  trace-diff golden.rays casts.rays --tolerance 1e-4    the same up to rounding, on another CPU
  trace-diff golden.rays casts.rays --tolerance 1e-5 --exact-queries --tree golden.bvh
                                                        the same queries, bit for bit, with the same answers up to rounding
  trace-diff one.rays two.rays --any-order              did both runs ask the same, on several threads?
  trace-diff old.bvh new.bvh --format json

Traces are compared in file order, whatever their chunks, codecs, threads and producer. What only one of them has is found by
pixel, depth, kind and purpose, and by its ray, and what follows is compared with what belongs to it. The scene fingerprint
counts where both files know it and no tolerance is given for queries; Embree's version is only noted.
Two triangles at one t are a tie: with a tolerance it is counted apart, and no difference; without one, another triangle is one.
Trees are compared node by node, in file order: structure, boxes, primitives, triangles, geometries.

Exit codes:
  0  equal
  1  different
  2  a file is missing, damaged, of another kind or scene, or without queries, or wrong usage"
)]
struct Arguments {
    /// The file that is right
    a: PathBuf,
    /// The file to compare with it
    b: PathBuf,
    /// Let floats differ by this much, relative to the larger one (to the vector's largest component; to 1 for barycentrics);
    /// without it, every bit counts
    #[arg(long, value_name = "REL", value_parser = parse_tolerance)]
    tolerance: Option<f32>,
    /// The tolerance is for answers only: what is asked must be the same, bit for bit
    #[arg(long, requires = "tolerance")]
    exact_queries: bool,
    /// The .bvh of A, of B, or of both, which tells a tie from another hit; may be given twice, once for each
    #[arg(long, value_name = "BVH")]
    tree: Vec<PathBuf>,
    /// Compare the queries as sets, in which one may be several times: recordings of several threads
    #[arg(long)]
    any_order: bool,
    /// Size of the traced image, which says which pixel a query serves; without it, what the tree's META says
    #[arg(long, value_name = "WxH")]
    image: Option<ImageSize>,
    /// How to print
    #[arg(long, value_enum, default_value = "text")]
    format: TextOrJson,
}

fn parse_tolerance(text: &str) -> Result<f32, String> {
    let tolerance = text.parse::<f32>().ok().filter(|value| (0.0..1.0).contains(value));
    tolerance.ok_or_else(|| "give a number from 0 up to 1, such as 1e-4".to_string())
}

fn main() -> ExitCode {
    let arguments: Arguments = cli::parse("trace-diff", std::env::args_os());
    cli::run("trace-diff", || run(&arguments))
}

fn run(arguments: &Arguments) -> Result<Outcome, Failure> {
    let a = MappedFile::open(&arguments.a)?;
    let b = MappedFile::open(&arguments.b)?;
    let in_file = |error| match error {
        DiffError::A(error) => Failure::in_file(&arguments.a, error),
        DiffError::B(error) => Failure::in_file(&arguments.b, error),
        error => Failure::from(error),
    };
    if arguments.tree.len() > 2 {
        return Err(Failure::new("--tree is given more than twice: give the tree of A and that of B"));
    }
    let maps = arguments.tree.iter().map(|path| MappedFile::open(path)).collect::<Result<Vec<_>, _>>()?;
    let parsed = maps.iter().zip(&arguments.tree);
    let parsed = parsed.map(|(map, path)| Bvh::parse(map).map_err(|error| Failure::in_file(path, error)));
    let trees: Vec<Bvh> = parsed.collect::<Result<_, _>>()?;
    let assigned = if trees.is_empty() {
        Trees::default()
    } else {
        let headers = diff::headers(&a, &b).map_err(in_file)?;
        Trees::assign(&trees, &headers)?
    };

    let answers = arguments.tolerance.map_or(Tolerance::Exact, Tolerance::Relative);
    let questions = if arguments.exact_queries { Tolerance::Exact } else { answers };
    let image = arguments.image.or_else(|| trees.iter().find_map(image_size));
    let options = Options { questions, answers, any_order: arguments.any_order, trees: assigned, image };
    let progress = Progress::new("comparing", a.len() as u64 / 64);
    let report = diff::compare(&a, &b, &options, &progress).map_err(in_file)?;
    drop(progress);
    let mut out = io::stdout().lock();
    match arguments.format {
        TextOrJson::Text => write!(out, "{report}")?,
        TextOrJson::Json => {
            let mut object = serde_json::to_value(&report)?;
            object["equal"] = report.is_equal().into();
            writeln!(out, "{object}")?;
        }
    }
    Ok(if report.is_equal() { Outcome::Good } else { Outcome::Failed })
}
