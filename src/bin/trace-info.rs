//! `trace-info`: shows what is in `.rays` and `.bvh` files.

use clap::Parser;
use embree_trace::cli::{self, Failure, Outcome, TextOrJson};
use embree_trace::files::MappedFile;
use embree_trace::inspect::Summary;
use embree_trace::progress::Progress;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Show what is in recorded queries (.rays) and trees (.bvh): header, counts, hit rates, histograms
#[derive(Parser)]
#[command(
    version,
    after_help = "\
Examples:
  trace-info casts.rays built.bvh          what is in both
  trace-info casts.rays --verify           all checks of the format, for a script
  trace-info casts.rays --format json | jq .by_purpose.shadow.hit_rate

Every file is read whole, and all its checksums, indices and sizes are checked. A .rays whose recording was cut off
is shown up to its last whole chunk. JSON is one object per file, on a line of its own.

Exit codes:
  0  good; also a cut-off .rays, without --verify
  1  --verify was given, and a .rays is cut off
  2  a file is missing, damaged or of another kind (the files behind it are still shown), or wrong usage"
)]
struct Arguments {
    /// Files to show, of either kind
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Check also what costs more: that boxes hold what is below them, that every triangle is in a leaf, that results and
    /// sequence numbers agree, that nothing was cut off
    #[arg(long)]
    verify: bool,
    /// How to print
    #[arg(long, value_enum, default_value = "text")]
    format: TextOrJson,
}

fn main() -> ExitCode {
    let arguments: Arguments = cli::parse("trace-info", std::env::args_os());
    cli::run("trace-info", || {
        let mut out = BufWriter::new(io::stdout().lock());
        let mut outcome = Outcome::Good;
        let mut failures = Vec::new();
        for path in &arguments.files {
            match read(path, arguments.verify) {
                Ok(summary) => {
                    if arguments.verify && summary.is_cut_off() {
                        outcome = Outcome::Failed;
                    }
                    print(&mut out, path, &summary, arguments.format)?;
                }
                Err(failure) => failures.push(failure),
            }
        }
        out.flush()?;
        if failures.is_empty() { Ok(outcome) } else { Err(Failure::new(failures.join("; "))) }
    })
}

fn read(path: &Path, verify: bool) -> Result<Summary, String> {
    let file = MappedFile::open(path).map_err(|error| error.to_string())?;
    // Queries are the unit; a record is 64 bytes unless it is compressed, so this is about right.
    let progress = Progress::new("reading", file.len() as u64 / 64);
    Summary::of(&file, verify, &progress).map_err(|error| format!("{}: {error}", path.display()))
}

fn print(out: &mut impl Write, path: &Path, summary: &Summary, format: TextOrJson) -> io::Result<()> {
    match format {
        TextOrJson::Text => writeln!(out, "{}: {summary}", path.display()),
        TextOrJson::Json => {
            let mut object = serde_json::to_value(summary)?;
            object["path"] = path.display().to_string().into();
            writeln!(out, "{object}")
        }
    }
}
