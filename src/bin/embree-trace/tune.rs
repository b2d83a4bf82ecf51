//! `embree-trace tune`: makes a program faster that somebody else wrote.

use clap::{Command, CommandFactory, Parser};
use embree_trace::cli::{self, Failure, Outcome, TextOrJson};
use embree_trace::record::program::Program;
use embree_trace::tune::{self, Options};
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

const EXAMPLES: &str = "\
Examples:
  How much faster a scene renders on trees made from its rays, and whether the picture stays the same:
    embree-trace tune --output out.ppm -- pathtracer -c scene.ecs -o out.ppm
  A scene of Blender's, with more time for its trees and more rounds:
    embree-trace tune --budget 120 --rounds 7 --output frame0001.png -- blender -b scene.blend -o '//frame####' -f 1
  Then, with the trees that paid:
    embree-trace run --trees trees -- blender -b scene.blend -a

The program is run 2 + 2 x ROUNDS times, and must ask the same each time: once to count what it asks, once to record a part of
it, and then on Embree's own trees and on planted ones in turn. What it says goes to TREES/tune/said.txt; the recording, the
files that it wrote and this report stay there, too. Times are medians over the rounds, and planted over plain within a round,
with the least and the greatest.

Exit codes: 0 good, also when no tree pays; 1 when planted trees change a file that is named with --output; 2 on bad input or usage.";

/// Makes a program faster that uses Embree 3.13.5: records what it asks, builds a tree for each of its scenes, and measures it on
/// Embree's trees and on planted ones.
#[derive(Parser)]
#[command(name = "embree-trace tune", version, after_help = EXAMPLES)]
struct Arguments {
    /// Where trees go that pay, one for each scene; made when it is not there
    #[arg(long, value_name = "DIR", default_value = "trees")]
    trees: PathBuf,
    /// Records about so many queries, an even part of the program's paths
    #[arg(long, value_name = "N", default_value_t = 1_000_000, value_parser = clap::value_parser!(u64).range(1..))]
    queries: u64,
    /// Time for building all trees
    #[arg(long, value_name = "SECONDS", default_value = "60", value_parser = cli::seconds)]
    budget: Duration,
    /// How often the program runs on Embree's trees, and on ours
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// A file that the program writes in each run, compared between them: pictures by pixel; may be given again
    #[arg(long, value_name = "FILE")]
    output: Vec<PathBuf>,
    /// Pixels of a picture that planted trees may change, as where two triangles lie at one distance
    #[arg(long, value_name = "N", default_value_t = 0)]
    allow_pixels: u64,
    /// Cuts no triangle: for a program whose filters must see each once. So it is where filters refuse hits
    #[arg(long)]
    no_splits: bool,
    /// How the report is printed
    #[arg(long, value_enum, default_value = "text")]
    format: TextOrJson,
    /// Program and its arguments
    #[arg(required = true, trailing_var_arg = true, allow_hyphen_values = true, value_name = "PROGRAM")]
    program: Vec<OsString>,
}

/// As a subcommand of `embree-trace`, for its man page and completions.
pub fn command() -> Command {
    Arguments::command().name("tune")
}

/// `words` are those of the command line, with `tune` as the second.
pub fn main(mut words: Vec<OsString>) -> ExitCode {
    words.remove(1);
    let arguments = cli::parse("embree-trace tune", words);
    cli::run("embree-trace tune", || run(arguments))
}

fn run(arguments: Arguments) -> Result<Outcome, Failure> {
    let program =
        Program::from_words(arguments.program).ok_or_else(|| Failure::new("no program is given"))?;
    let report = tune::tune(&Options {
        program,
        trees: arguments.trees,
        queries: arguments.queries,
        budget: arguments.budget,
        rounds: arguments.rounds,
        outputs: arguments.output,
        cuts: !arguments.no_splits,
    })?;
    match arguments.format {
        TextOrJson::Text => {
            print!("{report}");
            for warning in &report.warnings {
                eprintln!("embree-trace tune: warning: {warning}");
            }
        }
        TextOrJson::Json => {
            println!("{}", serde_json::to_string_pretty(&report).map_err(std::io::Error::from)?)
        }
    }
    Ok(if report.is_changed(arguments.allow_pixels) { Outcome::Failed } else { Outcome::Good })
}
