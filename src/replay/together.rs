//! Consecutive queries of one kind asked as a packet.

use super::query::Query;
use crate::geometry::Ray;
use crate::traverse::packet::MOST;
use crate::traverse::{Hit, OcclusionOrder, PacketObserver, PacketScratch, Prepared, Recorded, Traversal};

/// What a thread needs for packets, kept from one to the next.
#[derive(Debug)]
pub struct Together<'a> {
    rays: Vec<Ray>,
    candidates: Vec<Recorded<'a>>,
    scratch: PacketScratch,
}

impl Default for Together<'_> {
    fn default() -> Self {
        Together {
            rays: Vec::with_capacity(MOST),
            candidates: Vec::with_capacity(MOST),
            scratch: PacketScratch::default(),
        }
    }
}

impl<'a> Together<'a> {
    /// Asks `prepared` queries of one kind, [`MOST`] at most; `order` is for depth-first occlusion queries. Returns an answer for each.
    pub fn ask<'q>(
        &mut self,
        queries: impl Iterator<Item = Query<'a>> + Clone,
        prepared: &Prepared,
        traversal: Traversal,
        order: &OcclusionOrder,
        observer: &mut impl PacketObserver,
        answers: &'q mut [Option<Hit>; MOST],
    ) -> &'q [Option<Hit>] {
        self.rays.clear();
        self.candidates.clear();
        self.rays.extend(queries.clone().map(|query| query.ray));
        self.candidates.extend(queries.clone().map(|query| query.candidates));
        let occlusion = queries.clone().next().is_some_and(|query| query.record.is_occlusion());
        let (rays, candidates, scratch) = (&self.rays, &self.candidates, &mut self.scratch);
        let answers = &mut answers[..rays.len()];
        if occlusion {
            prepared.occluders(traversal, order, rays, candidates, observer, scratch, answers);
        } else {
            prepared.closest_hits(traversal, rays, candidates, observer, scratch, answers);
        }
        answers
    }
}
