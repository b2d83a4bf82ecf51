//! Training queries, whole: with the masks and rejects that decide what they hit. [`crate::recipe::auto`] judges trees by them.

use super::{Selection, TrainingError, none_left, thin};
use crate::format::bvh::Bvh;
use crate::format::rays::{Rays, Reject};
use crate::geometry::Ray;
use crate::replay::select::Portion;

/// A query, and on which side of a second parting it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Query {
    /// As it is asked again; see [`crate::format::rays::Record::ray_among_triangles`].
    pub ray: Ray,
    /// Its effective segment.
    pub segment: Ray,
    pub is_occlusion: bool,
    /// A geometry is seen when it shares a bit.
    pub mask: u32,
    /// Triangles that the recorded program refused; their `record` has no meaning here.
    pub rejects: Box<[Reject]>,
    /// Judges trees, and is no part of what they are fitted to. All queries of a pixel are on one side.
    pub judges: bool,
}

/// Share of the pixels whose queries judge.
const JUDGES: f64 = 0.25;

/// The training queries of `selection`, in the order of the file; of more than its limit, an even part.
///
/// # Errors
/// When the recording is of another scene than `bvh`, a chunk is damaged, or no query is left.
pub fn read(selection: &Selection, rays: &Rays, bvh: &Bvh) -> Result<Vec<Query>, TrainingError> {
    let scene = selection.scene_of(rays, bvh)?;
    let firsts = rays.first_queries();
    // Another seed than that of the first parting, which all of these queries are on one side of.
    let judging = Portion { share: JUDGES, seed: !selection.portion.seed };
    let found = rays.map_chunks(|index, chunk| {
        let mut found = Vec::new();
        if chunk.info.scene != scene {
            return found;
        }
        for (place, record) in chunk.records.iter().enumerate() {
            let number = firsts[index] + place as u64;
            if selection.filter.accepts(record) && selection.portion.trains(record, number) {
                found.push(Query {
                    ray: record.ray_among_triangles(),
                    segment: record.effective_segment(),
                    is_occlusion: record.is_occlusion(),
                    mask: record.mask,
                    rejects: chunk.rejects_of(place).into(),
                    judges: judging.trains(record, number),
                });
            }
        }
        found
    })?;
    let mut all: Vec<Query> = found.concat();
    if all.is_empty() {
        return Err(none_left(rays, scene));
    }
    thin(&mut all, selection.most);
    Ok(all)
}
