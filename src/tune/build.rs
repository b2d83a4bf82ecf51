//! From a recording to a tree for each scene that matters, in the directory of trees.

use super::{Options, TuneError};
use crate::cost::Costs;
use crate::files::{MappedFile, OutputFile};
use crate::format::bvh::Bvh;
use crate::format::rays::Rays;
use crate::progress::Progress;
use crate::recipe::best;
use crate::recipe::finish::{MAX_LEAF, Shape};
use crate::record::program::report::{Report, SceneLine};
use crate::replay::select::{Filter, Portion};
use crate::training::Selection;
use crate::training::queries;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Share of the recorded queries below which a scene gets no tree: it could save no more than that.
const LEAST_SHARE: f64 = 0.01;

/// A tree that was built.
#[derive(Clone, Debug, PartialEq)]
pub struct BuiltTree {
    pub path: PathBuf,
    /// Of the scene.
    pub triangles: u64,
    /// Queries that it was built from.
    pub queries: usize,
    /// What a confirming query is expected to cost on it, of what it costs on the recorded tree; `None` without such queries.
    pub expected: Option<f64>,
}

/// What was built, and why scenes have none.
#[derive(Clone, Debug, Default)]
pub struct Built {
    pub trees: Vec<BuiltTree>,
    pub left_out: Vec<String>,
}

/// What trees are built from.
pub struct Building<'a> {
    pub options: &'a Options,
    pub recorded: &'a Report,
    /// Where the recording is.
    pub kept: &'a Path,
}

impl Building<'_> {
    /// Builds a tree for each scene that has enough of the queries and can be planted in. Scenes of the same triangles share one.
    ///
    /// # Errors
    /// When a file cannot be read or written.
    pub fn build(&self) -> Result<Built, TuneError> {
        let rays_path = self.kept.join("casts.rays");
        let bytes = MappedFile::open(&rays_path)?;
        let format_error = |source| TuneError::Format { path: rays_path.clone(), source };
        let rays = Rays::parse(&bytes).map_err(format_error)?;
        let mut built = Built::default();
        let mut done = BTreeSet::new();
        let mut lines: Vec<&SceneLine> = self.recorded.scenes.iter().collect();
        lines.sort_by_key(|line| std::cmp::Reverse(line.queries));
        for line in lines {
            let share = line.queries as f64 / self.recorded.records.max(1) as f64;
            let name = format!("scene {}", line.scene);
            if share < LEAST_SHARE {
                continue;
            }
            let Some(path) = &line.path else {
                built
                    .left_out
                    .push(format!("{name} has no tree that can be read: {}", line.warnings.join("; ")));
                continue;
            };
            if line.instances > 0 {
                built
                    .left_out
                    .push(format!("{name} has instances, and trees are planted in scenes without any"));
                continue;
            }
            if line.triangles == 0 {
                built.left_out.push(format!("{name} has no triangles"));
                continue;
            }
            self.build_scene(Path::new(path), &rays, line, share, &mut done, &mut built)?;
        }
        Ok(built)
    }

    fn build_scene(
        &self,
        path: &Path,
        rays: &Rays,
        line: &SceneLine,
        share: f64,
        done: &mut BTreeSet<u64>,
        built: &mut Built,
    ) -> Result<(), TuneError> {
        let bytes = MappedFile::open(path)?;
        let format_error = |source| TuneError::Format { path: path.to_owned(), source };
        let bvh = Bvh::parse(&bytes).map_err(format_error)?;
        if !done.insert(bvh.header.fingerprint) {
            return Ok(());
        }
        let selection = Selection {
            scene: u16::try_from(line.number).ok(),
            filter: Filter::default(),
            portion: Portion { share: 1.0, seed: 0 },
            most: usize::try_from(self.options.queries).unwrap_or(usize::MAX),
        };
        let training_error = |source| TuneError::Training { path: path.to_owned(), source };
        let queries = queries::read(&selection, rays, &bvh).map_err(training_error)?;
        let shape = Shape { width: best::width_of(bvh.tree), max_leaf: MAX_LEAF, costs: Costs::default() };
        let config = best::Config {
            shape,
            budget: Duration::try_from_secs_f64(self.options.budget.as_secs_f64() * share)
                .unwrap_or(self.options.budget),
            trials: usize::MAX,
            area_only: false,
            // A filter that counts what it sees must see a triangle once.
            cuts: self.options.cuts && line.rejects == 0,
        };
        let recipe_error = |source| TuneError::Recipe { path: path.to_owned(), source };
        let tree = best::build(&bvh, &queries, &config, &Progress::hidden()).map_err(recipe_error)?;
        let to = self.options.trees.join(format!("{:016x}.bvh", bvh.header.fingerprint));
        OutputFile::create(&to)?.commit_with(|out| tree.write(&bvh, out))?;
        let [before, after] = [tree.chosen.before.all, tree.chosen.after.all];
        built.trees.push(BuiltTree {
            path: to,
            triangles: bvh.triangles.len() as u64,
            queries: queries.len(),
            expected: before.zip(after).map(|(before, after)| after / before),
        });
        Ok(())
    }
}
