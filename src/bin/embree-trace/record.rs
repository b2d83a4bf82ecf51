//! `embree-trace record`: runs a program and records what it asks Embree.

use crate::run::{TreeArguments, show};
use clap::{Command, CommandFactory, Parser, ValueEnum};
use embree_trace::cli::{self, Failure, TextOrJson};
use embree_trace::format::rays::Codec;
use embree_trace::record::program::purpose::Rules;
use embree_trace::record::program::select::Selection;
use embree_trace::record::program::{self, Options, Program};
use embree_trace::replay::select::Filter;
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;

const EXAMPLES: &str = "\
Examples:
  Record a program, and look at what it asked:
    embree-trace record --savetrace casts.rays built.bvh -- pathtracer -c scene.ecs -o out.ppm
    trace-info casts.rays
    bvh-compare built.bvh casts.rays
  A tenth of the paths of a Blender scene, compressed:
    embree-trace record --every 10 --compress -- blender -b scene.blend -f 1
  A million queries, behind the first million, of a program that a script starts:
    embree-trace record --skip 1000000 --limit 1000000 -- ./render.sh
  The same with options that stand in the environment:
    EMBREE_TRACE_LIMIT=1000000 EMBREE_TRACE_COMPRESS=true embree-trace record -- ./render.sh

  The same on trees of our own, which are planted in the program's scenes (see embree-trace run --help):
    embree-trace record --tree ours.bvh --savetrace casts.rays planted.bvh -- pathtracer -c scene.ecs -o out.ppm

Each committed scene that is asked something is a scene of the recording, and gets a tree of its own: built.bvh,
built.1.bvh, …; bvh-compare and the others take the queries of the scene that their tree is of.

SIGTERM or SIGHUP ends the recording, which is complete then, and not the program; an interrupt is the program's.

Exit code: the program's own, 128 and the signal when it or the recording was ended by one; 2 when there is no recording.";

/// Runs a program that uses Embree 3 or 4 and records every query that it asks, with its answer, and every tree that it asks.
#[derive(Parser)]
#[command(name = "embree-trace record", version, after_help = EXAMPLES)]
struct Arguments {
    /// Where to: the queries, and the first scene's tree
    #[arg(long, num_args = 2, value_names = ["RAYS", "BVH"], default_values = ["casts.rays", "built.bvh"])]
    savetrace: Vec<PathBuf>,
    /// Compresses the queries, two to four times
    #[arg(long, env = "EMBREE_TRACE_COMPRESS")]
    compress: bool,
    /// Leaves out the first N queries
    #[arg(long, value_name = "N", default_value_t = 0, env = "EMBREE_TRACE_SKIP")]
    skip: u64,
    /// Records at most N queries; the program runs on
    #[arg(long, value_name = "N", env = "EMBREE_TRACE_LIMIT")]
    limit: Option<u64>,
    /// Records one of N paths: a camera query and what its thread asks until the next; or one of N queries, where none is known
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..), env = "EMBREE_TRACE_EVERY")]
    every: u64,
    /// Records only these queries, such as kind=occlusion or purpose=camera+shadow
    #[arg(
        long,
        value_name = "CONDITIONS",
        default_value = "",
        hide_default_value = true,
        env = "EMBREE_TRACE_FILTER"
    )]
    filter: Filter,
    /// How purposes are guessed, which programs do not say; by the program's name when absent
    #[arg(long, value_enum, env = "EMBREE_TRACE_PURPOSES")]
    purposes: Option<Purposes>,
    /// Writes no tree for a scene with more triangles, once its instances are flattened
    #[arg(long, value_name = "N", default_value_t = program::MOST_TRIANGLES, env = "EMBREE_TRACE_MAX_TRIANGLES")]
    max_triangles: u32,
    #[command(flatten)]
    trees: TreeArguments,
    /// How the summary is printed, on standard error: standard output is the program's
    #[arg(long, value_enum, default_value = "text")]
    format: TextOrJson,
    /// Program and its arguments
    #[arg(required = true, trailing_var_arg = true, allow_hyphen_values = true, value_name = "PROGRAM")]
    program: Vec<OsString>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Purposes {
    /// Occlusion queries are shadow rays; closest-hit queries from a thread's first origin are camera rays
    General,
    /// By the masks of Blender's Cycles
    Cycles,
    /// All unknown
    None,
}

/// As a subcommand of `embree-trace`, for its man page and completions.
pub fn command() -> Command {
    Arguments::command().name("record")
}

/// `words` are those of the command line, with `record` as the second.
pub fn main(mut words: Vec<OsString>) -> ExitCode {
    words.remove(1);
    let arguments = cli::parse("embree-trace record", words);
    cli::run_with_code("embree-trace record", || run(arguments))
}

fn run(arguments: Arguments) -> Result<u8, Failure> {
    let Arguments { savetrace, compress, skip, limit, every, filter, max_triangles, .. } = arguments;
    let [rays, bvh] =
        <[PathBuf; 2]>::try_from(savetrace).map_err(|_| Failure::new("--savetrace takes two paths"))?;
    if rays == bvh {
        return Err(Failure::new(format!("{}: given for both the rays and the tree", rays.display())));
    }
    let program =
        Program::from_words(arguments.program).ok_or_else(|| Failure::new("no program is given"))?;
    let report = program::record(&Options {
        program,
        rays,
        bvh,
        codec: if compress { Codec::Compressed } else { Codec::Raw },
        selection: Selection { skip, limit, every, filter },
        rules: arguments.purposes.map(|purposes| match purposes {
            Purposes::General => Rules::General,
            Purposes::Cycles => Rules::Cycles,
            Purposes::None => Rules::None,
        }),
        max_triangles,
        wanted: arguments.trees.wanted(),
    })?;
    match arguments.format {
        TextOrJson::Text => {
            eprint!("{report}");
            if let Some(planting) = &report.planting {
                show("embree-trace record", planting);
            }
            for warning in &report.warnings {
                eprintln!("embree-trace record: warning: {warning}");
            }
        }
        TextOrJson::Json => {
            eprintln!("{}", serde_json::to_string_pretty(&report).map_err(std::io::Error::from)?)
        }
    }
    if report.seen == 0 && report.status == 0 {
        return Err(Failure::new(match report.processes {
            0 => {
                "the program has not called a shared libembree3 or libembree4: it may have none, another version, or one linked into it"
            }
            _ => "the program has called Embree, but asked it nothing",
        }));
    }
    Ok(u8::try_from(report.status).unwrap_or(u8::MAX))
}
