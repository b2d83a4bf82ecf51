//! Training queries: which of a recording's queries a tree is built from, as effective segments.
//!
//! Data flows so: [`crate::format::rays::Rays`] → the queries that a [`Selection`] takes → [`Ray`]s for
//! [`crate::recipe::Recipe::make`]. The queries that it leaves are for `bvh-compare --held-out`.

pub mod occlusions;
pub mod queries;

use crate::format::FormatError;
use crate::format::bvh::Bvh;
use crate::format::rays::Rays;
use crate::geometry::Ray;
use crate::ranks::{RankFailed, Ranks, Share, even_part, gather_all};
use crate::replay::scene::{SceneError, Scenes};
use crate::replay::select::{Filter, Portion};
use thiserror::Error;

/// Which queries train.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Number of the scene; without it, the one that the tree is of ([`Scenes::of_trees`]).
    pub scene: Option<u16>,
    pub filter: Filter,
    pub portion: Portion,
    /// No more than this: of more, an even part in the file's order.
    pub most: usize,
}

/// Why a recording cannot train a tree.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum TrainingError {
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error("there is no query to train with: the recording is empty")]
    Empty,
    #[error("no query is left to train with: the scene has {0}; widen --filter or --train")]
    NoQueries(u64),
    #[error(transparent)]
    Format(#[from] FormatError),
    #[error("{0}")]
    Rank(#[from] RankFailed),
}

impl Selection {
    /// The number of the scene whose queries are taken.
    fn scene_of(&self, rays: &Rays, bvh: &Bvh) -> Result<u16, SceneError> {
        Scenes::of(rays).of_trees(&[bvh], self.scene)
    }

    /// The effective segments of the chosen queries, in the order of the file. Each of `ranks` gets a part of them: the parts one after
    /// another, in the order of ranks, are what one process would get.
    ///
    /// # Errors
    /// When the recording is of another scene than `bvh`, a chunk is damaged, no query is left, or another rank fails.
    pub fn read(&self, rays: &Rays, bvh: &Bvh, ranks: &dyn Ranks) -> Result<Segments, TrainingError> {
        let scene = self.scene_of(rays, bvh)?;
        let firsts = rays.first_queries();
        let chosen = rays.map_chunks_of(Share::of(ranks).piece(rays.chunks().len()), |index, chunk| {
            if chunk.info.scene != scene {
                return Vec::new();
            }
            let numbered = chunk.records.iter().zip(firsts[index]..);
            let taken = numbered.filter(|(record, number)| {
                self.filter.accepts(record) && self.portion.trains(record, *number)
            });
            taken.map(|(record, _)| record.effective_segment()).collect::<Vec<Ray>>()
        })?;
        let own: Vec<Ray> = chosen.concat();
        let lengths = gather_all(ranks, own.len())?;
        let (before, all) = (lengths[..ranks.rank()].iter().sum(), lengths.iter().sum());
        if all == 0 {
            return Err(none_left(rays, scene));
        }
        Ok(Segments { own: even_part(&own, before, all, self.most), all: all.min(self.most) })
    }
}

/// Why nothing is left of a scene's queries.
fn none_left(rays: &Rays, scene: u16) -> TrainingError {
    let own = rays.chunks().iter().filter(|chunk| chunk.info.scene == scene);
    match own.map(|chunk| u64::from(chunk.records)).sum() {
        0 => TrainingError::Empty,
        queries => TrainingError::NoQueries(queries),
    }
}

/// Training queries as effective segments.
#[derive(Clone, Debug, Default)]
pub struct Segments {
    /// Those of this rank.
    pub own: Vec<Ray>,
    /// How many all ranks have.
    pub all: usize,
}

/// Leaves an even part of at most `most`.
fn thin<T>(queries: &mut Vec<T>, most: usize) {
    let count = queries.len();
    if count <= most {
        return;
    }
    let mut place = 0;
    // One is kept wherever the running share of `most` reaches a new whole number.
    queries.retain(|_| {
        let share = |place: usize| place as u128 * most as u128 / count as u128;
        place += 1;
        share(place) > share(place - 1)
    });
}

/// At most `most` of `all`, evenly chosen.
pub(crate) fn even<T: Clone>(all: &[T], most: usize) -> Vec<T> {
    even_part(all, 0, all.len(), most)
}
