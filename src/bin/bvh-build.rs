//! `bvh-build IN.bvh OUT.bvh`: the same triangles, another tree.

use clap::Parser;
use embree_trace::builder::{self, BuildError, Config, Count, Splits};
use embree_trace::cli::{self, Failure, Outcome, TextOrJson};
use embree_trace::files::{MappedFile, OutputFile};
use embree_trace::format::bvh::{self, Bvh, Contents, flag};
use embree_trace::progress::Progress;
use embree_trace::tree::TreeView;
use embree_trace::tree::statistics::{Statistics, sah_cost};
use serde_json::{Value, json};
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

/// Rebuild the tree of a .bvh from its triangles: a binary tree, greedy from the top.
///
/// The output is the same, byte for byte, for any number of threads.
#[derive(Parser)]
#[command(
    version,
    after_help = "\
Examples:
  bvh-build embBuilt.bvh ours.bvh                            binned SAH, one triangle a leaf
  bvh-build embBuilt.bvh ours.bvh --splits sweep             every possible cut: slower, better
  bvh-build embBuilt.bvh ours.bvh --splits sweep --alpha 0.88
  bvh-build embBuilt.bvh ours.bvh --max-leaf 8               leaves of up to 8 where that lowers the SAH cost

Exit codes: 0 good, 2 bad input or usage."
)]
struct Arguments {
    /// The .bvh whose triangles to build over
    input: PathBuf,
    /// The .bvh to write
    output: PathBuf,
    /// Candidates at each node: binned (min(32, 4 + n/20) bins an axis), binned:N, or sweep
    #[arg(long, default_value = "binned", value_name = "KIND")]
    splits: Splits,
    /// Exponent of the count in a side's cost, count^ALPHA · P
    #[arg(long, default_value_t = 1.0, value_name = "ALPHA", allow_negative_numbers = true)]
    alpha: f64,
    /// The count in a side's cost: n-1 or n
    #[arg(long, default_value = "n-1", value_name = "COUNT")]
    count: Count,
    /// Most triangles in a leaf; above 1, leaves are made where a split would not lower the SAH cost
    #[arg(long, default_value_t = 1, value_name = "N")]
    max_leaf: usize,
    /// Cost of a box test (0.6 is 1.2 for a binary node), for the SAH cost and for leaves
    #[arg(long, default_value_t = 0.6, value_name = "COST", allow_negative_numbers = true)]
    ci: f64,
    /// Cost of a triangle test, for the SAH cost and for leaves
    #[arg(long, default_value_t = 1.0, value_name = "COST", allow_negative_numbers = true)]
    cp: f64,
    /// Threads to build with; 0 is one per processor
    #[arg(long, default_value_t = 0, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=1024))]
    threads: u16,
    /// How to print what was built
    #[arg(long, value_enum, default_value_t = TextOrJson::Text)]
    format: TextOrJson,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    cli::run("bvh-build", || run(&arguments))
}

fn run(arguments: &Arguments) -> Result<Outcome, Failure> {
    let config = Config {
        splits: arguments.splits,
        alpha: arguments.alpha,
        count: arguments.count,
        max_leaf: arguments.max_leaf,
        c_i: arguments.ci,
        c_p: arguments.cp,
    };
    config.check()?;
    let in_input =
        |error: &dyn std::fmt::Display| Failure::new(format!("{}: {error}", arguments.input.display()));
    let bytes = MappedFile::open(&arguments.input)?;
    let before = Bvh::parse(&bytes).map_err(|error| in_input(&error))?;
    let mut output = OutputFile::create(&arguments.output)?;

    let pool = rayon::ThreadPoolBuilder::new().num_threads(arguments.threads.into()).build()?;
    let progress = Progress::new("building", before.triangles.len() as u64);
    let started = Instant::now();
    let tree = pool
        .install(|| builder::build(before.triangles, &config, &progress))
        .map_err(|error: BuildError| in_input(&error))?;
    let seconds = started.elapsed().as_secs_f64();
    drop(progress);

    let contents = Contents {
        tree: tree.view(),
        triangles: before.triangles,
        geometries: before.geometries,
        order: None,
        meta: Some(&config.meta("sah").to_string()),
        flags: before.header.flags & flag::FLATTENED,
        producer: &config.producer("sah"),
    };
    bvh::write(&mut output, &contents).map_err(|error| output.write_error(error))?;
    output.commit()?;

    let report = json!({
        "triangles": before.triangles.len(),
        "left_out": before.triangles.len() - tree.primitives.len(),
        "seconds": seconds,
        "threads": pool.current_num_threads(),
        "build": config.meta("sah"),
        "before": described(before.tree, &config),
        "after": described(tree.view(), &config),
    });
    print(&report, arguments.format)?;
    Ok(Outcome::Good)
}

/// What a tree looks like, in the names of `bvh-compare`.
fn described(tree: TreeView, config: &Config) -> Value {
    let Statistics { nodes, leaves, depth, max_children, max_leaf } = Statistics::of(tree);
    let sah_cost = sah_cost(tree, config.c_i, config.c_p);
    json!({
        "nodes": nodes, "leaves": leaves, "depth": depth, "max_children": max_children, "max_leaf": max_leaf,
        "sah_cost": sah_cost,
    })
}

fn print(report: &Value, format: TextOrJson) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    if format == TextOrJson::Json {
        return writeln!(out, "{report:#}");
    }
    writeln!(
        out,
        "{} triangles in {:.3} s, {} left out (vertices that are not finite)",
        report["triangles"],
        report["seconds"].as_f64().unwrap_or_default(),
        report["left_out"],
    )?;
    writeln!(out, "{:<10}{:>12}{:>12}", "", "before", "after")?;
    for name in ["nodes", "leaves", "depth", "max_children", "max_leaf"] {
        let value = |tree: &str| report[tree][name].to_string();
        writeln!(out, "{:<12}{:>10}{:>12}", name.replace('_', " "), value("before"), value("after"))?;
    }
    let cost = |tree: &str| report[tree]["sah_cost"].as_f64().unwrap_or_default();
    writeln!(out, "{:<12}{:>10.2}{:>12.2}", "SAH cost", cost("before"), cost("after"))
}
