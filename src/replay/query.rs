//! Recorded queries as they are asked again: which of them, with what ray, among which triangles.

use super::select::{Filter, Portion, Sample};
use crate::format::FormatError;
use crate::format::rays::{Chunk, Rays, Record};
use crate::geometry::Ray;
use crate::traverse::{Hit, Observer, OcclusionOrder, Prepared, PreparedRay, Recorded, Scratch, Traversal};
use std::ops::Range;

/// Which queries of a file.
#[derive(Clone, Debug)]
pub struct Choice {
    /// Only queries of this scene number ([`crate::format::rays::ChunkInfo::scene`]).
    pub scene: u16,
    pub filter: Filter,
    /// Leave out the queries that this portion trains with.
    pub held_out: Option<Portion>,
    /// Only so many, spread over the file; before the filter.
    pub sample: Option<u64>,
}

/// A chosen query.
#[derive(Clone, Copy, Debug)]
pub struct Query<'a> {
    /// Of the query in the file.
    pub number: u64,
    pub record: &'a Record,
    pub ray: Ray,
    pub candidates: Recorded<'a>,
}

impl Choice {
    /// The sample of a file of so many queries; `None` when all of them are wanted.
    pub fn sample_of(&self, queries: u64) -> Option<Sample> {
        self.sample.and_then(|size| Sample::new(size, queries))
    }

    /// The chosen ones among the records `range` of `chunk`, whose first record has the number `start` in the file.
    pub fn within<'c>(
        &self,
        chunk: &'c Chunk,
        start: u64,
        range: Range<usize>,
        sample: Option<Sample>,
    ) -> Vec<Query<'c>> {
        if chunk.info.scene != self.scene {
            return Vec::new();
        }
        let whole = start + range.start as u64..start + range.end as u64;
        let query = |number| self.query(chunk, start, number);
        match sample {
            None => whole.filter_map(query).collect(),
            Some(sample) => sample.within(whole).filter_map(query).collect(),
        }
    }

    /// Query `number` of the file, in `chunk`, whose first record has the number `start`, if it is chosen; whatever the sample.
    pub fn query<'c>(&self, chunk: &'c Chunk, start: u64, number: u64) -> Option<Query<'c>> {
        let index = (number - start) as usize;
        let record = &chunk.records[index];
        let trained = |portion: &Portion| portion.trains(record, number);
        if !self.filter.accepts(record) || self.held_out.as_ref().is_some_and(trained) {
            return None;
        }
        let rejects = chunk.rejects_of(index);
        Some(Query {
            number,
            record,
            ray: record.ray_among_triangles(),
            candidates: Recorded { mask: record.mask, rejects },
        })
    }

    /// Calls `visit` with the chosen queries of `rays`, a chunk's at a time, in the order of the file.
    ///
    /// # Errors
    /// When a chunk is damaged.
    pub fn for_each_chunk(&self, rays: &Rays, mut visit: impl FnMut(&[Query])) -> Result<(), FormatError> {
        let sample = self.sample_of(rays.query_count());
        let mut start = 0;
        for number in 0..rays.chunks().len() {
            let chunk = rays.chunk(number)?;
            visit(&self.within(&chunk, start, 0..chunk.records.len(), sample));
            start += chunk.records.len() as u64;
        }
        Ok(())
    }
}

impl Query<'_> {
    /// Where the effective segment ends when `hit` is the answer. That of an occlusion query is the whole interval, although an
    /// occluded one may be answered before its end.
    #[inline]
    pub fn end(&self, hit: Option<Hit>) -> f32 {
        match hit {
            Some(hit) if !self.record.is_occlusion() => hit.t,
            _ => self.ray.tfar,
        }
    }

    /// Asks `prepared`; `order` is for depth-first occlusion queries.
    #[inline]
    pub fn ask(
        &self,
        prepared: &Prepared,
        traversal: Traversal,
        order: &OcclusionOrder,
        observer: &mut impl Observer,
        scratch: &mut Scratch,
    ) -> Option<Hit> {
        let ray = PreparedRay::new(&self.ray);
        let candidates = &self.candidates;
        match (self.record.is_occlusion(), traversal) {
            (false, _) => prepared.closest_hit(traversal, &ray, candidates, observer, scratch),
            (true, Traversal::RayOrder) => prepared.occluder(traversal, &ray, candidates, observer, scratch),
            (true, Traversal::Odf) => prepared.occluder_in(order, &ray, candidates, observer, scratch),
        }
    }
}
