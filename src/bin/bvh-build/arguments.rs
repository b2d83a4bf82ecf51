//! What the command line says, as the library's configurations.

use clap::{Parser, ValueEnum};
use embree_trace::builder::{Config, Count, Splits};
use embree_trace::cli::{self, Failure, TextOrJson};
use embree_trace::cost::Costs;
use embree_trace::optimize::{Stage, annealing, insertion, reinsertion, rotations, treelets};
use embree_trace::recipe::finish::{self, Shape};
use embree_trace::recipe::{Heuristic, Recipe, best};
use embree_trace::replay::select::{Filter, Portion};
use embree_trace::training::Selection;
use embree_trace::tree::TreeView;
use embree_trace::update::policy::Method;
use std::path::PathBuf;
use std::time::Duration;

/// Rebuild the tree of a .bvh from its triangles.
///
/// With nothing but files, the tree has as many children a node as the input's, and is the best for the machine that is found in
/// --budget seconds: recipes are tried whole and judged by what the finished tree costs recorded queries, or without --rays by area.
/// With --splits, --heuristic sah|rdh|blend, --optimize and the like, or from a binary tree, it is what they say: a binary tree,
/// greedy from the top, with surface area or recorded rays as the probability that a box is hit.
///
/// The output is the same, byte for byte, for any number of threads, where time does not end the trials.
#[derive(Parser)]
#[command(
    version,
    after_help = "\
Examples:
  bvh-build embBuilt.bvh ours.bvh --rays embCasts.rays       the best tree for these rays that it finds in 30 s
  bvh-build embBuilt.bvh ours.bvh --rays embCasts.rays --train 0.1 --budget 300   and from a tenth of the pixels, for longer
  bvh-build embBuilt.bvh camera.bvh --rays embCasts.rays --filter purpose=camera   the best for camera rays alone
  bvh-build embBuilt.bvh control.bvh --rays embCasts.rays --area-only   the control: area, with the same effort, judged by the rays
  bvh-build embBuilt.bvh ours.bvh                            the best from area, without any ray
  bvh-build embBuilt.bvh ours.bvh --splits binned            a binary tree: binned SAH, one triangle a leaf
  bvh-build embBuilt.bvh ours.bvh --splits sweep             every possible cut: slower, better
  bvh-build embBuilt.bvh ours.bvh --splits sweep --alpha 0.88
  bvh-build embBuilt.bvh ours.bvh --splits spatial --optimize reinsertion   the lowest SAH cost
  bvh-build embBuilt.bvh ours.bvh --splits binned --max-leaf 8   leaves of up to 8 where that lowers the SAH cost
  bvh-build embBuilt.bvh ours.bvh --rays embCasts.rays --heuristic auto --width 2   the best binary tree, by box and triangle tests
  bvh-build embBuilt.bvh ours.bvh --rays embCasts.rays --heuristic blend    a binary tree for these rays: blend 0.95
  bvh-build embBuilt.bvh ours.bvh --rays embCasts.rays --splits sweep --optimize rotations
  bvh-build embBuilt.bvh ours.bvh --rays embCasts.rays --train 0.1 --order   and an order for its occlusion queries
  bvh-build embBuilt.bvh ours.bvh --rays embCasts.rays --filter kind=closest --train 0.1
  bvh-build embBuilt.bvh ours.bvh --splits sweep --width 8 --max-leaf 8    up to eight children a node
  bvh-build embBuilt.bvh same.bvh --binary                                 Embree's own tree, made binary
  mpirun -n 4 bvh-build --mpi embBuilt.bvh ours.bvh --rays embCasts.rays --train-limit 1000000000
  bvh-build 0001.bvh next.bvh --update rotate ours.bvh --limit 1.2         ours, of 0000.bvh, for the next frame

Exit codes: 0 good, 2 bad input or usage."
)]
pub struct Arguments {
    /// The .bvh whose triangles to build over
    pub input: PathBuf,
    /// The .bvh to write
    pub output: PathBuf,
    /// Candidates at each node: binned (the default; min(32, 4 + n/20) bins an axis), binned:N, sweep, or spatial (binned, and planes that cut
    /// triangles)
    #[arg(long, value_name = "KIND")]
    pub splits: Option<Splits>,
    /// Cuts no triangle, so that each stands in one leaf: for a program whose filters must see it once. The best tree
    /// (--heuristic auto) cuts without being asked to
    #[arg(long)]
    pub no_splits: bool,
    /// With --splits spatial: most references that may be added, as a share of the triangles
    #[arg(long, value_name = "SHARE", allow_negative_numbers = true)]
    pub max_duplication: Option<f64>,
    /// With --splits spatial: cut only where the best other split's children overlap in more than this share of the root's area
    #[arg(long, value_name = "SHARE", allow_negative_numbers = true)]
    pub overlap: Option<f64>,
    /// Exponent of the count in a side's cost, count^ALPHA · P; 1 by default
    #[arg(long, value_name = "ALPHA", allow_negative_numbers = true)]
    pub alpha: Option<f64>,
    /// The count in a side's cost: n-1, n or log-n; without this, n with --splits spatial, which adds leaves, and n-1 else
    #[arg(long, value_name = "COUNT")]
    pub count: Option<Count>,
    /// Most triangles in a leaf; 1 by default, 16 with more than two children a node. Above 1, subtrees become leaves where that does not
    /// raise the cost
    #[arg(long, value_name = "N")]
    pub max_leaf: Option<usize>,
    /// Cost of a box test, for the SAH cost that is printed and for leaves
    #[arg(long, default_value_t = 1.0, value_name = "COST", allow_negative_numbers = true)]
    pub ci: f64,
    /// Cost of a triangle test, for the same
    #[arg(long, default_value_t = 1.0, value_name = "COST", allow_negative_numbers = true)]
    pub cp: f64,
    /// A recording of the scene: its queries are the rays that the tree is for
    #[arg(long, value_name = "RAYS")]
    pub rays: Option<PathBuf>,
    /// How likely a box is hit: its area, the queries that overlap it, or both; without this, auto, or for a binary tree blend where there
    /// are rays
    #[arg(long, value_enum)]
    pub heuristic: Option<Kind>,
    /// Weight of the rays in a blend: 0 is area, 1 is rays; 0.95 by default
    #[arg(long, value_name = "W", allow_negative_numbers = true)]
    pub weight: Option<f64>,
    /// Added to every count of rays (rdh), so that a box without rays still has a cost
    #[arg(long, default_value_t = 0.0, value_name = "RAYS", allow_negative_numbers = true)]
    pub floor: f64,
    /// Train with these queries only, and judge by them: a tree for one purpose. Written as for
    /// bvh-compare: purpose=camera+diffuse,depth=1..
    #[arg(long, default_value = "", hide_default_value = true)]
    pub filter: Filter,
    /// Train with the queries of this share of the pixels; bvh-compare --held-out counts on the others
    #[arg(long, default_value_t = 1.0, value_name = "FRACTION", value_parser = share)]
    pub train: f64,
    /// Train with at most this many queries, evenly chosen
    #[arg(long, default_value_t = 1 << 20, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1 << 31))]
    pub train_limit: u64,
    /// The queries of this scene; without this, of the one that the tree is of, when the recording
    /// holds several
    #[arg(long, value_name = "N")]
    pub scene: Option<u16>,
    /// Optimisers to run after the build, in this order, with the same heuristic
    #[arg(long, value_enum, value_delimiter = ',', value_name = "NAMES")]
    pub optimize: Vec<Optimizer>,
    /// Sweeps of annealing, rounds of insertion, batches of reinsertion; 0 is the default of each
    #[arg(long, default_value_t = 0, value_name = "N")]
    pub iterations: u32,
    /// Optimisers stop after so many seconds from the start of the build, and auto tries no more (30 by default). What they reach in a time
    /// differs from run to run: without it, the same input gives the same tree
    #[arg(long, value_name = "SECONDS", value_parser = cli::seconds, allow_negative_numbers = true)]
    pub budget: Option<Duration>,
    /// Try trees from surface area alone, as many and for as long, and let the queries only choose
    /// between them: the control that says what a tree owes to the rays
    #[arg(long, requires = "rays", conflicts_with_all = ["binary", "update", "mpi"])]
    pub area_only: bool,
    /// Try at most N recipes, however much time is left: with time enough, the same tree on every
    /// machine
    #[arg(long, value_name = "N", value_parser = trials, conflicts_with_all = ["binary", "update", "mpi"])]
    pub trials: Option<usize>,
    /// Choose a traversal order for the occlusion queries of every node from the recorded ones, and store it (section ORDR);
    /// says what they cost in every order, on the training queries and on the others
    #[arg(long, requires = "rays")]
    pub order: bool,
    /// Build with one triangle a leaf, collapse to at most N children a node and --max-leaf triangles a leaf, and optimise that: for the
    /// machine, by area or, where there are any, by the training queries
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(2..=8))]
    pub width: Option<u8>,
    /// What visits, leaves and blocks cost on a machine, in nanoseconds: {"costs": [{"width": 8, "kind": "closest_hit", "visit": 6.1,
    /// "leaf": 7.7, "block": 2.0}, …]}; without this, constants that are the same everywhere
    #[arg(long, value_name = "FILE")]
    pub costs: Option<PathBuf>,
    /// Do not build: make the tree of the input binary, with one triangle a leaf
    #[arg(long, conflicts_with_all = ["rays", "heuristic", "optimize", "width"])]
    pub binary: bool,
    /// Do not build: bring the tree of the frame before, PREVIOUS, to the triangles of the input, which are the same faces moved. METHOD is refit,
    /// rotate, rotate-by-rays or rebuild; --rays is then a recording of PREVIOUS
    #[arg(long, num_args = 2, value_names = ["METHOD", "PREVIOUS"], conflicts_with_all = ["binary", "width", "order", "optimize"])]
    pub update: Option<Vec<String>>,
    /// With --update: rebuild when a ray of --rays, or without it a random one, has become FACTOR times as expensive since the last build
    #[arg(long, value_name = "FACTOR", requires = "update", value_parser = factor)]
    pub limit: Option<f64>,
    /// Seed of --train and of the optimisers
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Threads to build with; 0 is one per processor
    #[arg(long, default_value_t = 0, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=1024))]
    pub threads: u16,
    /// Share the training queries with the other processes that mpirun started, each of which counts its own with one thread; the first
    /// writes the tree that one process would build
    #[arg(long, requires = "rays", conflicts_with_all = ["optimize", "order", "width", "update", "binary", "threads"])]
    pub mpi: bool,
    /// How to print what was built
    #[arg(long, value_enum, default_value_t = TextOrJson::Text)]
    pub format: TextOrJson,
}

/// Of the rays in a blend, where nothing else is asked for.
const WEIGHT: f64 = 0.95;

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    /// Surface area
    Sah,
    /// Number of queries whose effective segments overlap the box
    Rdh,
    /// --weight · rays + (1 - weight) · area
    Blend,
    /// Whichever costs the queries least that a quarter of the training pixels were set apart for: chooses splits, leaves, weight, costs of a
    /// side and optimisers within --budget, and area alone where rays do not help. A binary tree is judged by its box and triangle tests,
    /// a wider one by what it costs the machine
    Auto,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Optimizer {
    /// Children and grandchildren exchanged while it pays (Kensler 2008)
    Rotations,
    /// The same with simulated annealing (Kensler 2008)
    Annealing,
    /// Inefficient nodes inserted anew (Bittner et al. 2013)
    Insertion,
    /// Every subtree to its best place, in parallel (Meister and Bittner 2018)
    Reinsertion,
    /// One batch of that over the likeliest twentieth: most of the gain for little of the time
    QuickReinsertion,
    /// Batches of it over all nodes until hardly anything moves: another hundredth, for several times the time
    PatientReinsertion,
    /// The best tree over the seven largest subtrees below each node (Karras and Aila 2013)
    Treelets,
}

/// The tree of the frame before, and what is to become of it.
pub struct Follow {
    pub method: Method,
    pub previous: PathBuf,
}

fn factor(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(factor) if factor >= 1.0 && factor.is_finite() => Ok(factor),
        _ => Err("expected a number of at least 1".into()),
    }
}

fn trials(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|&number| number > 0).ok_or("expected a number of at least 1".into())
}

fn share(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(share) if share > 0.0 && share <= 1.0 => Ok(share),
        _ => Err("expected a number above 0 and at most 1".into()),
    }
}

impl Arguments {
    pub fn recipe(&self) -> Recipe {
        let kind = self.heuristic.unwrap_or(if self.rays.is_some() { Kind::Blend } else { Kind::Sah });
        let heuristic = match kind {
            // Area alone is the first that it tries.
            Kind::Sah | Kind::Auto => Heuristic::Sah,
            Kind::Rdh => Heuristic::Rdh { floor: self.floor },
            Kind::Blend => Heuristic::Blend { weight: self.weight.unwrap_or(WEIGHT) },
        };
        let mut splits = self.splits.unwrap_or(Config::default().splits);
        if let Splits::Spatial(options) = &mut splits {
            options.max_duplication = self.max_duplication.unwrap_or(options.max_duplication);
            options.overlap = self.overlap.unwrap_or(options.overlap);
        }
        let builder = Config {
            splits,
            alpha: self.alpha.unwrap_or(1.0),
            count: self.count.unwrap_or(splits.count()),
            // Collapsing merges leaves itself, and better where it has the choice.
            max_leaf: if self.width.is_some() { 1 } else { self.max_leaf.unwrap_or(1) },
            c_i: self.ci,
            c_p: self.cp,
        };
        let stages = self.optimize.iter().map(|&name| self.stage(name)).collect();
        Recipe { heuristic, builder, stages, budget: self.budget }
    }

    fn stage(&self, optimizer: Optimizer) -> Stage {
        let seed = self.seed;
        let or = |default: usize| if self.iterations == 0 { default } else { self.iterations as usize };
        match optimizer {
            Optimizer::Rotations => Stage::Rotations(rotations::Config::default()),
            Optimizer::Annealing => {
                let default = annealing::Config::default();
                Stage::Annealing(annealing::Config { iterations: or(default.iterations), seed, ..default })
            }
            Optimizer::Insertion => {
                let default = insertion::Config::default();
                Stage::Insertion(insertion::Config { rounds: or(default.rounds), seed, ..default })
            }
            Optimizer::QuickReinsertion => Stage::Reinsertion(reinsertion::Config::QUICK),
            Optimizer::PatientReinsertion => Stage::Reinsertion(reinsertion::Config::PATIENT),
            Optimizer::Treelets => Stage::Treelets(treelets::Config::default()),
            Optimizer::Reinsertion => {
                let default = reinsertion::Config::default();
                Stage::Reinsertion(reinsertion::Config { batches: or(default.batches), ..default })
            }
        }
    }

    /// Which tree to bring to this frame, and how.
    pub fn follow(&self) -> Result<Option<Follow>, Failure> {
        let Some([name, previous]) = self.update.as_deref() else { return Ok(None) };
        let Some(method) = Method::ALL.into_iter().find(|method| method.name() == name) else {
            let names = Method::ALL.map(Method::name).join(", ");
            return Err(Failure::new(format!("--update {name}: expected one of {names}")));
        };
        Ok(Some(Follow { method, previous: previous.into() }))
    }

    /// Which queries of the recording the tree is made from.
    pub fn selection(&self) -> Selection {
        Selection {
            scene: self.scene,
            filter: self.filter.clone(),
            portion: Portion { share: self.train, seed: self.seed },
            most: self.train_limit as usize,
        }
    }

    /// What a tree of `width` may look like, and what things cost.
    pub fn shape(&self, width: usize) -> Result<Shape, Failure> {
        let costs = self.costs.as_deref().map_or(Ok(Costs::default()), cli::costs)?;
        let max_leaf = self.max_leaf.unwrap_or(if width > 2 { finish::MAX_LEAF } else { 1 });
        let shape = Shape { width, max_leaf, costs };
        shape.check()?;
        Ok(shape)
    }

    pub fn is_auto(&self) -> bool {
        self.heuristic == Some(Kind::Auto)
    }

    /// Whether something is said that only a recipe followed by name has.
    fn names_recipe(&self) -> bool {
        let named = self.splits.is_some()
            || self.alpha.is_some()
            || self.count.is_some()
            || self.weight.is_some()
            || self.max_duplication.is_some()
            || self.overlap.is_some()
            || self.floor != 0.0
            || self.order
            || self.heuristic.is_some_and(|kind| kind != Kind::Auto);
        (named && !self.is_auto()) || !self.optimize.is_empty() || self.mpi || self.binary
    }

    /// Whether the best tree for the machine is wanted, and of how many children a node: where nothing else is asked for, as many as
    /// the input has. A binary tree is made in the ways of the paper.
    pub fn best_width(&self, input: TreeView) -> Option<usize> {
        let width = self.width.map_or_else(|| best::width_of(input), usize::from);
        (!self.names_recipe() && width > 2).then_some(width)
    }
}
