//! What integrators ask: the seam between them and Embree, so that tests can answer by brute force.

use crate::embree::Query;
use crate::format::rays::{NO_PATH, Purpose};
use crate::geometry::Ray;
use crate::render::framing::{Seen, Sight};
use crate::render::shapes::{Met, Shapes};

/// Queries that can be asked at once.
pub const MAX_PACKET: usize = 16;

/// Queries of one thread.
pub trait RayQueries {
    /// The nearest hit of a ray, if any.
    fn closest_hit(&mut self, query: &Query) -> Option<Met>;

    /// Whether anything lies in the interval of a ray.
    fn occluded(&mut self, query: &Query) -> bool;

    /// [`Self::closest_hit`] of up to 16 queries at once; `hits` has as many elements.
    fn closest_hits(&mut self, queries: &[Query], hits: &mut [Option<Met>]) {
        for (query, hit) in queries.iter().zip(hits) {
            *hit = self.closest_hit(query);
        }
    }

    /// [`Self::occluded`] of up to 16 queries at once; `occluded` has as many elements.
    fn occluded_packet(&mut self, queries: &[Query], occluded: &mut [bool]) {
        for (query, occluded) in queries.iter().zip(occluded) {
            *occluded = self.occluded(query);
        }
    }
}

/// Looks around by queries.
pub struct Looking<'a, Q> {
    pub queries: &'a mut Q,
    /// Of the scene that is asked.
    pub shapes: &'a Shapes,
}

impl<Q: RayQueries> Sight for Looking<'_, Q> {
    fn first(&mut self, ray: &Ray) -> Option<Seen> {
        let met = self.queries.closest_hit(&query(*ray, NO_PATH, 0, Purpose::Unknown))?;
        let (triangle, meeting) = self.shapes.meeting(ray, &met);
        let normal = self.shapes.triangles()[triangle as usize].scaled_normal();
        Some(Seen { t: meeting.t as f32, triangle, normal })
    }
}

/// A query of ours: at time 0, seeing everything. Camera rays are the coherent ones.
pub fn query(ray: Ray, path: u32, depth: u8, purpose: Purpose) -> Query {
    Query { ray, time: 0.0, mask: u32::MAX, path, depth, purpose, coherent: purpose == Purpose::Camera }
}

/// Queries by purpose, as [`Purpose`] is numbered: how many, and how many hit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    pub closest_hit: [Count; Purpose::ALL.len()],
    pub occlusion: [Count; Purpose::ALL.len()],
}

/// Queries of one kind and purpose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count {
    pub queries: u64,
    pub hits: u64,
}

impl Count {
    pub fn add(&mut self, other: Count) {
        self.queries += other.queries;
        self.hits += other.hits;
    }

    fn one(&mut self, hit: bool) {
        self.add(Count { queries: 1, hits: u64::from(hit) });
    }
}

impl Tally {
    pub fn add(&mut self, other: &Tally) {
        let pairs = |a: &mut [Count; 6], b: &[Count; 6]| a.iter_mut().zip(b).for_each(|(a, b)| a.add(*b));
        pairs(&mut self.closest_hit, &other.closest_hit);
        pairs(&mut self.occlusion, &other.occlusion);
    }

    /// All queries of both kinds.
    pub fn total(&self) -> Count {
        let mut total = Count::default();
        self.closest_hit.iter().chain(&self.occlusion).for_each(|count| total.add(*count));
        total
    }
}

/// Passes queries on and counts them.
pub struct Counting<'a, Q> {
    pub queries: &'a mut Q,
    pub tally: Tally,
}

impl<Q: RayQueries> RayQueries for Counting<'_, Q> {
    fn closest_hit(&mut self, query: &Query) -> Option<Met> {
        let hit = self.queries.closest_hit(query);
        self.tally.closest_hit[query.purpose as usize].one(hit.is_some());
        hit
    }

    fn occluded(&mut self, query: &Query) -> bool {
        let occluded = self.queries.occluded(query);
        self.tally.occlusion[query.purpose as usize].one(occluded);
        occluded
    }

    fn closest_hits(&mut self, queries: &[Query], hits: &mut [Option<Met>]) {
        self.queries.closest_hits(queries, hits);
        for (query, hit) in queries.iter().zip(hits) {
            self.tally.closest_hit[query.purpose as usize].one(hit.is_some());
        }
    }

    fn occluded_packet(&mut self, queries: &[Query], occluded: &mut [bool]) {
        self.queries.occluded_packet(queries, occluded);
        for (query, &occluded) in queries.iter().zip(&*occluded) {
            self.tally.occlusion[query.purpose as usize].one(occluded);
        }
    }
}
