//! `trace-diff`: whether two traces or two trees hold the same.

use clap::Parser;
use embree_trace::cli::{self, Failure, Outcome, TextOrJson};
use embree_trace::diff::{DiffError, Tolerance, compare};
use embree_trace::files::MappedFile;
use embree_trace::progress::Progress;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

/// Compare two traces (.rays) or two trees (.bvh): the number of differences, and the first
#[derive(Parser)]
#[command(
    version,
    after_help = "\
Examples:
  trace-diff golden.rays casts.rays                     is the renderer still asking the same?
  trace-diff golden.rays casts.rays --tolerance 1e-4    the same up to rounding, on another CPU
  trace-diff old.bvh new.bvh --format json

Traces are compared query by query, in file order, whatever their chunks, codecs, threads and producer. The scene fingerprint
counts where both files know it and no tolerance is given; Embree's version is only noted.
Trees are compared node by node, in file order: structure, boxes, primitives, triangles, geometries.

Exit codes:
  0  equal
  1  different
  2  a file is missing, damaged or of another kind, or wrong usage"
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
    cli::run("trace-diff", || {
        let a = MappedFile::open(&arguments.a)?;
        let b = MappedFile::open(&arguments.b)?;
        let tolerance = arguments.tolerance.map_or(Tolerance::Exact, Tolerance::Relative);
        let progress = Progress::new("comparing", a.len().min(b.len()) as u64 / 64);
        let report = compare(&a, &b, tolerance, &progress).map_err(|error| match error {
            DiffError::A(error) => Failure::in_file(&arguments.a, error),
            DiffError::B(error) => Failure::in_file(&arguments.b, error),
            DiffError::Kinds(..) => Failure::from(error),
        })?;
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
    })
}
