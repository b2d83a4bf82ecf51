//! Which scene of a recording a tree is of: one rule for all that take a tree and queries.
//!
//! A recording of another program may hold several scenes: each chunk has the number of its own,
//! and a tree that was recorded has it in `META` (`recorded.number`), which trees that are built
//! from it inherit. Queries of another scene than the tree's have other answers.

use crate::format::bvh::Bvh;
use crate::format::rays::Rays;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use thiserror::Error;

/// What a recording says of its scenes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Scenes {
    /// Of the only tree; 0 when it is unknown, or when there are several.
    pub fingerprint: u64,
    /// Numbers of those that were asked something.
    pub numbers: BTreeSet<u16>,
}

/// Why trees and a recording do not belong together.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum SceneError {
    #[error(
        "the queries are of scene {rays:016x}, the tree is of scene {tree:016x}: give the two files of one recording"
    )]
    Other { rays: u64, tree: u64 },
    #[error("the trees are of scenes {0} and {1} of their recording: give trees of one scene")]
    Trees(u16, u16),
    #[error(
        "--scene {asked}: the tree is of scene {own} of the recording; leave out --scene, or give the tree of that scene"
    )]
    Asked { asked: u16, own: u16 },
    #[error("the tree is of scene {own}, and the recording has queries of {}: give the two files of one recording", list(.held))]
    Absent { own: u16, held: BTreeSet<u16> },
    #[error("--scene {asked}: the recording has queries of {}", list(.held))]
    AskedAbsent { asked: u16, held: BTreeSet<u16> },
    #[error("the recording has queries of {}, and the tree does not say of which it is: add --scene N", list(.0))]
    Several(BTreeSet<u16>),
}

fn list(scenes: &BTreeSet<u16>) -> String {
    let numbers: Vec<String> = scenes.iter().take(8).map(u16::to_string).collect();
    let more = if scenes.len() > numbers.len() { ", …" } else { "" };
    format!("scene{} {}{more}", if scenes.len() == 1 { "" } else { "s" }, numbers.join(", "))
}

impl Scenes {
    pub fn of(rays: &Rays) -> Scenes {
        let asked = rays.chunks().iter().filter(|chunk| chunk.records > 0);
        Scenes {
            fingerprint: rays.header.fingerprint,
            numbers: asked.map(|chunk| chunk.info.scene).collect(),
        }
    }

    /// The number of the scene that the trees are of. It is the one that is `asked` for, else the
    /// one that they name, else the only one; these must not contradict each other.
    ///
    /// # Errors
    /// When the trees are of another scene, or of several, or nobody says of which.
    pub fn of_trees(&self, trees: &[&Bvh], asked: Option<u16>) -> Result<u16, SceneError> {
        let known = trees.iter().map(|bvh| bvh.header.fingerprint);
        if let Some(tree) = known.into_iter().find(|&tree| ![0, tree].contains(&self.fingerprint)) {
            return Err(SceneError::Other { rays: self.fingerprint, tree });
        }
        let mut own = None;
        for named in trees.iter().filter_map(|bvh| named(bvh)) {
            match own {
                Some(other) if other != named => return Err(SceneError::Trees(other, named)),
                _ => own = Some(named),
            }
        }
        let only = (self.numbers.len() == 1).then(|| self.numbers.first().copied()).flatten();
        // A recording of one scene that is known to be the trees' is right, whatever number the
        // scene had in another recording.
        if self.fingerprint != 0 {
            own = only.or(own);
        }
        match (asked, own) {
            (Some(asked), Some(own)) if asked != own => Err(SceneError::Asked { asked, own }),
            (Some(asked), _) if self.lacks(asked) => {
                Err(SceneError::AskedAbsent { asked, held: self.numbers.clone() })
            }
            (None, Some(own)) if self.lacks(own) => {
                Err(SceneError::Absent { own, held: self.numbers.clone() })
            }
            (None, None) if self.numbers.len() > 1 => Err(SceneError::Several(self.numbers.clone())),
            _ => Ok(asked.or(own).or(only).unwrap_or(0)),
        }
    }

    /// Whether there are queries, and none of them is of that scene.
    fn lacks(&self, scene: u16) -> bool {
        !self.numbers.is_empty() && !self.numbers.contains(&scene)
    }
}

/// The number of the scene in the recording that a tree comes from, where `META` has it.
pub fn named(bvh: &Bvh) -> Option<u16> {
    let meta: Value = serde_json::from_str(bvh.meta?).ok()?;
    u16::try_from(meta.get("recorded")?.get("number")?.as_u64()?).ok()
}

/// Puts into the `META` of a tree what stays true of one over the same triangles: values of `keys`,
/// and which scene of a recording it is.
pub fn inherit(meta: &mut Value, from: &Bvh, keys: &[&str]) {
    let recorded: Value = from.meta.and_then(|meta| serde_json::from_str(meta).ok()).unwrap_or_default();
    for &key in keys {
        if let Some(value) = recorded.get(key) {
            meta[key] = value.clone();
        }
    }
    if let Some(number) = named(from) {
        meta["recorded"] = json!({ "number": number });
    }
}
