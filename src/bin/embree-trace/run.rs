//! `embree-trace run`: runs a program on trees of ours.

use clap::{Args, Command, CommandFactory, Parser};
use embree_trace::cli::{self, Failure, TextOrJson};
use embree_trace::record::program::Program;
use embree_trace::record::program::run::{self, Options};
use embree_trace::record::program::trees::{Planting, Wanted};
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;

const EXAMPLES: &str = "\
Examples:
  Record a program, build a better tree from what it asked, and let it render with that:
    embree-trace record --savetrace casts.rays built.bvh -- pathtracer -c scene.ecs -o plain.ppm
    bvh-build built.bvh ours.bvh --rays casts.rays --train 0.1
    embree-trace run --tree ours.bvh -- pathtracer -c scene.ecs -o planted.ppm
  Trees of several scenes, or of several programs, in a directory:
    embree-trace run --trees trees/ -- blender -b scene.blend -f 1

Each tree goes into the scenes whose geometries it is of: the same numbers, kinds, triangles and vertices, to the bit. In all other
scenes, and on any doubt, Embree's own tree stays, and a line says so. Nothing stands between a query and Embree; only commits take longer.

SIGTERM and SIGHUP are passed on to the program.

Exit code: the program's own, 128 and the signal when it was ended by one; 2 on bad input or usage.";

/// Runs a program that uses Embree 3.13.5, and plants trees in its scenes: Embree's kernels traverse them in place of their own.
#[derive(Parser)]
#[command(name = "embree-trace run", version, after_help = EXAMPLES)]
struct Arguments {
    #[command(flatten)]
    trees: TreeArguments,
    /// How the summary is printed, on standard error: standard output is the program's
    #[arg(long, value_enum, default_value = "text")]
    format: TextOrJson,
    /// Program and its arguments
    #[arg(required = true, trailing_var_arg = true, allow_hyphen_values = true, value_name = "PROGRAM")]
    program: Vec<OsString>,
}

/// Which trees are planted.
#[derive(Args)]
pub struct TreeArguments {
    /// Plants the tree of this .bvh in the scenes that it is of; may be given again for other scenes
    #[arg(long, value_name = "BVH")]
    tree: Vec<PathBuf>,
    /// Plants the trees of a directory's .bvh files, each in the scenes that it is of
    #[arg(long, value_name = "DIR")]
    trees: Option<PathBuf>,
}

impl TreeArguments {
    pub fn wanted(self) -> Wanted {
        Wanted { trees: self.tree, directory: self.trees }
    }
}

/// As a subcommand of `embree-trace`, for its man page and completions.
pub fn command() -> Command {
    Arguments::command().name("run")
}

/// `words` are those of the command line, with `run` as the second.
pub fn main(mut words: Vec<OsString>) -> ExitCode {
    words.remove(1);
    let arguments = cli::parse("embree-trace run", words);
    cli::run_with_code("embree-trace run", || run(arguments))
}

fn run(arguments: Arguments) -> Result<u8, Failure> {
    let wanted = arguments.trees.wanted();
    if wanted.is_empty() {
        return Err(Failure::new(
            "no tree is given: name one with --tree, or a directory of them with --trees",
        ));
    }
    let program =
        Program::from_words(arguments.program).ok_or_else(|| Failure::new("no program is given"))?;
    let mut report = run::run(&Options { program, wanted })?;
    if report.planting.is_empty() && report.status == 0 {
        report.planting.warnings.push(nothing_planted(report.planting.foreign).to_owned());
    }
    match arguments.format {
        TextOrJson::Text => show("embree-trace run", &report.planting),
        TextOrJson::Json => {
            eprintln!("{}", serde_json::to_string_pretty(&report).map_err(std::io::Error::from)?)
        }
    }
    Ok(u8::try_from(report.status).unwrap_or(u8::MAX))
}

/// Why no scene of a program that ended well was seen.
fn nothing_planted(foreign: bool) -> &'static str {
    if foreign {
        "nothing is planted: the program's Embree is neither libembree3 nor libembree4"
    } else {
        "nothing is planted: the program has committed no scene with triangles to a shared libembree3: it may have none, another version, or one linked into it"
    }
}

/// Prints what became of the scenes.
pub fn show(command: &str, planting: &Planting) {
    eprint!("{planting}");
    for warning in &planting.warnings {
        eprintln!("{command}: warning: {warning}");
    }
}
