//! The experiments of "Building Better BVHs by Using Ray Distributions" (Feltman 2011), one figure a file.
//!
//! Each file has `run`, which makes rows, and `figure`, which draws them; [`crate::report::plot`] writes the SVG and the
//! PNG. `shapes`, `blend` and `optimum` make their own geometry and rays; the others take a trace (a `.bvh` with its `.rays`).

pub mod alpha;
pub mod animation;
pub mod blend;
pub mod measure;
pub mod optimum;
pub mod published;
pub mod sampling;
pub mod save;
pub mod scenes;
pub mod shape;
pub mod shapes;
pub mod static_cost;
pub mod trace;
pub mod traversal;

use crate::builder::BuildError;
use crate::builder::exhaustive::ExhaustiveError;
use crate::files::FileError;
use crate::optimize::OptimizeError;
use crate::probability::blend::WeightError;
use crate::probability::shrunk::StrengthError;
use crate::recipe::RecipeError;
use crate::replay::select::NEIGHBOURS;
use crate::tree::TreeView;
use crate::update::UpdateError;
use crate::update::policy::PolicyError;
use measure::{Cost, IdentityError};
use std::io::{self, Write};
use thiserror::Error;
use trace::TraceError;

/// What all experiments take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Fewer points, for a first look.
    pub quick: bool,
    pub seed: u64,
    /// Random repetitions of each point.
    pub trials: u64,
}

/// Why an experiment has no result.
#[derive(Debug, Error)]
pub enum ExperimentError {
    #[error(transparent)]
    Build(#[from] BuildError),
    #[error(
        "{found} pixels are too few: at least {least} are needed; record a larger image (where pixels are not known, {NEIGHBOURS} \
         queries in a row count as one)"
    )]
    TooFew { found: usize, least: usize },
    #[error(
        "the {queries} queries are of {pixels} pixels (where these are not known, {NEIGHBOURS} queries in a row count as one), \
         which --seed {seed} does not part into {}% to build from and the others to count on: all are to {side}; record a \
         larger image, or try another --seed",
        100.0 * share
    )]
    OneSided { queries: usize, pixels: usize, share: f64, seed: u64, side: &'static str },
    #[error(transparent)]
    Trace(#[from] TraceError),
    #[error(transparent)]
    Optimize(#[from] OptimizeError),
    #[error(transparent)]
    Update(#[from] UpdateError),
    #[error("frame {0}: {1}")]
    Frame(usize, UpdateError),
    #[error(transparent)]
    Policy(#[from] PolicyError),
    #[error(transparent)]
    Recipe(#[from] RecipeError),
    #[error(transparent)]
    Exhaustive(#[from] ExhaustiveError),
    #[error(transparent)]
    Strength(#[from] StrengthError),
    #[error(transparent)]
    Weight(#[from] WeightError),
    #[error(transparent)]
    File(#[from] FileError),
    #[error(transparent)]
    Identity(#[from] IdentityError),
}

/// One tree on one set of generated rays.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    pub experiment: &'static str,
    pub focus: f64,
    pub trial: u64,
    /// 0 is SAH, 1 full ray information.
    pub weight: f64,
    pub cost: Cost,
}

/// Writes rows as CSV: `experiment,focus,trial,weight,bvh_cost,rays,t_r`.
///
/// # Errors
/// What `out` says.
pub fn write_csv(rows: &[Row], out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "experiment,focus,trial,weight,bvh_cost,rays,t_r")?;
    for Row { experiment, focus, trial, weight, cost } in rows {
        let Cost { rays, box_tests, t_r } = cost;
        writeln!(out, "{experiment},{focus},{trial},{weight},{box_tests},{rays},{t_r}")?;
    }
    Ok(())
}

/// 0, 0.02, …, 1; when quick 0, 0.2, …, 1.
pub fn foci(settings: &Settings) -> Vec<f64> {
    let steps = if settings.quick { 5 } else { 50 };
    (0..=steps).map(|step| f64::from(step) / f64::from(steps)).collect()
}

/// The level of each node; the root's is 1.
fn levels(tree: TreeView) -> Vec<u32> {
    tree.levels().into_iter().map(|level| level + 1).collect()
}

/// Mean of the values at one x, and its standard error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    pub x: f64,
    pub mean: f64,
    /// Standard deviation / √n; 0 for a single value.
    pub error: f64,
}

/// Values grouped by x, in rising order.
pub fn summary(values: impl Iterator<Item = (f64, f64)>) -> Vec<Point> {
    let mut values: Vec<(f64, f64)> = values.collect();
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let point = |group: &[(f64, f64)]| {
        let n = group.len() as f64;
        let mean = group.iter().map(|v| v.1).sum::<f64>() / n;
        let squares = group.iter().map(|v| (v.1 - mean).powi(2)).sum::<f64>();
        let error = if group.len() > 1 { (squares / (n - 1.0) / n).sqrt() } else { 0.0 };
        Point { x: group[0].0, mean, error }
    };
    values.chunk_by(|a, b| a.0 == b.0).map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summaries_are_means_with_standard_errors() {
        let points = summary([(1.0, 5.0), (0.0, 2.0), (0.0, 4.0), (0.0, 6.0)].into_iter());
        assert_eq!(points[0].x, 0.0);
        assert_eq!(points[0].mean, 4.0);
        assert!((points[0].error - (4.0f64 / 3.0).sqrt()).abs() < 1e-12);
        assert_eq!(points[1], Point { x: 1.0, mean: 5.0, error: 0.0 });
    }

    #[test]
    fn the_csv_has_the_promised_columns() {
        let cost = Cost { rays: 3, box_tests: 13, t_r: 5 };
        let row = Row { experiment: "sphere", focus: 0.02, trial: 7, weight: 1.0, cost };
        let mut out = Vec::new();
        write_csv(&[row], &mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        assert_eq!(text, "experiment,focus,trial,weight,bvh_cost,rays,t_r\nsphere,0.02,7,1,13,3,5\n");
    }

    #[test]
    fn foci_are_exact_decimals() {
        let all = foci(&Settings { quick: false, seed: 0, trials: 1 });
        assert_eq!((all.len(), all[0], all[10], all[35], all[50]), (51, 0.0, 0.2, 0.7, 1.0));
        assert_eq!(foci(&Settings { quick: true, seed: 0, trials: 1 }), published::FOCI);
    }
}
