//! From a file and its training queries to the file with the best tree, as `bvh-build` writes it and others plant it.

use super::{Chosen, Config, Input, choose};
use crate::cost::Cost;
use crate::format::bvh::{self, Bvh, Contents, flag};
use crate::progress::Progress;
use crate::recipe::RecipeError;
use crate::recipe::judge::Scene;
use crate::replay::scene;
use crate::training::queries::Query;
use crate::traverse::child_order::rule;
use serde_json::{Value, json};
use std::io::{self, Write};

/// The best tree that was found, and what its file says beside it.
#[derive(Clone, Debug)]
pub struct Built {
    pub chosen: Chosen,
    /// Section `ORDR`: children stand in the order in which they are to be visited.
    pub order: Vec<u8>,
    /// Section `META`: whoever builds adds what only he knows.
    pub meta: Value,
    /// Of the header.
    pub flags: u32,
}

/// Chooses the best tree for `queries`, those of a recording of `input` that train ([`crate::training::queries::read`]), on the threads of the
/// current rayon pool. Without queries it is the best from area alone. `progress` counts [`super::TRIALS`].
///
/// # Errors
/// When a number of `config` is out of range.
pub fn build(
    input: &Bvh,
    queries: &[Query],
    config: &Config,
    progress: &Progress,
) -> Result<Built, RecipeError> {
    let scene = Scene { triangles: input.triangles, geometries: input.geometries };
    let chosen = choose(scene, Input::of(input), queries, config, progress)?;
    let mut meta = json!({
        "auto": chosen.report(), "width": config.shape.width, "max_leaf": config.shape.max_leaf,
        "budget": config.budget.as_secs_f64(), "area_only": config.area_only,
    });
    // Where the image's size is known, it stays known.
    scene::inherit(&mut meta, input, &["image"]);
    let splits = if chosen.is_cut { flag::SPATIAL_SPLITS } else { 0 };
    Ok(Built {
        order: vec![rule::FIRST; chosen.tree.nodes.len()],
        meta,
        flags: input.header.flags & flag::FLATTENED | splits,
        chosen,
    })
}

impl Built {
    /// Writes the file; `input` is the one that it was built from.
    ///
    /// # Errors
    /// What `out` says.
    pub fn write(&self, input: &Bvh, out: impl Write) -> io::Result<u64> {
        let meta = self.meta.to_string();
        let contents = Contents {
            tree: self.chosen.tree.view(),
            triangles: input.triangles,
            geometries: input.geometries,
            order: Some(&self.order),
            meta: Some(&meta),
            flags: self.flags,
            producer: "bvh-build auto",
        };
        bvh::write(out, &contents)
    }
}

impl Chosen {
    /// What was tried and what it gains, for `META` and JSON: nothing that differs between two runs that had the time.
    pub fn report(&self) -> Value {
        let trials: Vec<Value> = self
            .trials
            .iter()
            .map(|trial| json!({ "plan": trial.plan.meta(), "cost": trial.cost }))
            .collect();
        let cost = |cost: &Cost| json!({ "all": cost.all, "closest_hit": cost.closest_hit, "occlusion": cost.occlusion });
        let [choosing, confirming] = self.judges;
        json!({
            "judges": choosing, "confirming": confirming, "winner": self.winner, "plan": self.plan.meta(), "trials": trials,
            "cost": { "input": cost(&self.before), "area": cost(&self.area), "tree": cost(&self.after) },
        })
    }
}
