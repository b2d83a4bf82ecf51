//! The paper's figures: parses arguments, calls [`embree_trace::experiment`], writes CSV, SVG and PNG.

use clap::{Args, Parser, Subcommand};
use embree_trace::cli::{self, Failure, Outcome};
use embree_trace::experiment::shape::Shape;
use embree_trace::experiment::{self, ExperimentError, Settings};
use embree_trace::files::{FileError, OutputFile};
use embree_trace::report::plot::Figure;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const EXAMPLES: &str = "\
Examples:
  bvh-experiment shapes --quick
  bvh-experiment blend --out figures --trials 10 --seed 1
  bvh-experiment shapes --save traces";

/// The experiments of \"Building Better BVHs by Using Ray Distributions\" (2011), as CSV, SVG and PNG
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Arguments {
    #[command(subcommand)]
    experiment: Experiment,
}

#[derive(Subcommand)]
enum Experiment {
    /// Trees with full ray information against SAH, on sphere, plane, hemisphere and tube, over focus
    Shapes(Generated),
    /// Rays and area blended by weight, on the sphere
    Blend(Generated),
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

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    cli::run("bvh-experiment", || run(&arguments.experiment))
}

fn run(experiment: &Experiment) -> Result<Outcome, Failure> {
    match experiment {
        Experiment::Shapes(options) => {
            let settings = options.settings();
            let rows = experiment::shapes::run(&settings)?;
            options.save(&Shape::ALL, &settings)?;
            let csv = |out: &mut OutputFile| experiment::write_csv(&rows, out);
            options.common.write("shapes", csv, &experiment::shapes::figure(&rows))
        }
        Experiment::Blend(options) => {
            let settings = options.settings();
            let rows = experiment::blend::run(&settings)?;
            options.save(&[Shape::Sphere], &settings)?;
            let csv = |out: &mut OutputFile| experiment::write_csv(&rows, out);
            options.common.write("blend", csv, &experiment::blend::figure(&rows))
        }
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
    /// Writes NAME.csv, NAME.svg and NAME.png, and says where they are.
    fn write(
        &self,
        name: &str,
        csv: impl FnOnce(&mut OutputFile) -> std::io::Result<()>,
        figure: &Figure,
    ) -> Result<Outcome, Failure> {
        make_directory(&self.out)?;
        let path = self.out.join(format!("{name}.csv"));
        let mut file = OutputFile::create(&path)?;
        csv(&mut file).map_err(|error| file.write_error(error))?;
        file.commit()?;
        figure.write(&self.out, name)?;
        let at = |extension: &str| self.out.join(format!("{name}.{extension}")).display().to_string();
        writeln!(std::io::stdout(), "{}\n{}\n{}", at("csv"), at("svg"), at("png"))?;
        Ok(Outcome::Good)
    }
}

fn make_directory(path: &Path) -> Result<(), FileError> {
    std::fs::create_dir_all(path).map_err(|error| FileError::new(path, "create", error))
}
