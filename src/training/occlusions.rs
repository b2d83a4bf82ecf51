//! Recorded occlusion queries, whole: with the masks and rejects that decide which triangles occlude. They choose and judge
//! the order in which occlusion queries visit children ([`crate::optimize::order`]).

use super::{Selection, TrainingError, thin};
use crate::format::bvh::Bvh;
use crate::format::rays::{Rays, Reject};
use crate::geometry::Ray;
use crate::traverse::Recorded;

/// An occlusion query.
#[derive(Clone, Debug, PartialEq)]
pub struct Occlusion {
    pub ray: Ray,
    /// A geometry is seen when it shares a bit.
    pub mask: u32,
    /// Triangles that the recorded program refused; their `record` has no meaning here.
    pub rejects: Box<[Reject]>,
}

impl Occlusion {
    /// Which triangles may occlude it.
    pub fn candidates(&self) -> Recorded<'_> {
        Recorded { mask: self.mask, rejects: &self.rejects }
    }
}

/// The occlusion queries of a recording on both sides of a selection.
#[derive(Clone, Debug, Default)]
pub struct Occlusions {
    pub training: Vec<Occlusion>,
    /// Those that the filter takes and the portion leaves.
    pub held_out: Vec<Occlusion>,
}

/// The occlusion queries that `selection` takes and leaves, in the order of the file; of more than its limit, an even part on
/// either side. Both may be empty.
///
/// # Errors
/// When the recording is of another scene than `bvh`, or a chunk is damaged.
pub fn read(selection: &Selection, rays: &Rays, bvh: &Bvh) -> Result<Occlusions, TrainingError> {
    let scene = selection.scene_of(rays, bvh)?;
    let firsts = rays.first_queries();
    let found = rays.map_chunks(|index, chunk| {
        let mut found = Occlusions::default();
        if chunk.info.scene != scene {
            return found;
        }
        for (place, record) in chunk.records.iter().enumerate() {
            if !record.is_occlusion() || !selection.filter.accepts(record) {
                continue;
            }
            let rejects = chunk.rejects_of(place).into();
            let trains = selection.portion.trains(record, firsts[index] + place as u64);
            let side = if trains { &mut found.training } else { &mut found.held_out };
            side.push(Occlusion { ray: record.ray(), mask: record.mask, rejects });
        }
        found
    })?;
    let mut all = Occlusions::default();
    for chunk in found {
        all.training.extend(chunk.training);
        all.held_out.extend(chunk.held_out);
    }
    thin(&mut all.training, selection.most);
    thin(&mut all.held_out, selection.most);
    Ok(all)
}
