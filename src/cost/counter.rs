//! Counts of queries that are asked of one tree one after the other, depth first, misses of a simulated cache included: what is judged when a tree
//! is chosen, and what times are explained by.

use super::Counted;
use super::cache::{Cache, Cached, Layout, SECOND_LEVEL};
use crate::geometry::Ray;
use crate::traverse::{Candidates, OcclusionOrder, Prepared, PreparedRay, Scratch, Traversal};
use crate::tree::TreeView;

/// Queries that ask one cache, which is empty before the first of them: so parts of a list can be counted apart.
pub const BATCH: usize = 1 << 13;

/// Asks a tree.
pub struct Counter<'a> {
    prepared: &'a Prepared,
    order: &'a OcclusionOrder,
    layout: Layout,
    cache: Cache,
    scratch: Scratch,
    /// Queries that the cache has seen.
    asked: usize,
}

impl<'a> Counter<'a> {
    /// `prepared` is made of `tree`; occlusion is asked in the order `order`.
    pub fn new(prepared: &'a Prepared, tree: TreeView, order: &'a OcclusionOrder) -> Counter<'a> {
        let cache = Cache::new(SECOND_LEVEL);
        Counter { prepared, order, layout: Layout::of(tree), cache, scratch: Scratch::default(), asked: 0 }
    }

    /// Asks one query, and says what it took.
    pub fn ask(&mut self, ray: &Ray, is_occlusion: bool, candidates: &impl Candidates) -> Counted {
        if self.asked == BATCH {
            (self.cache, self.asked) = (Cache::new(SECOND_LEVEL), 0);
        }
        self.asked += 1;
        let ray = PreparedRay::new(ray);
        let before = self.cache.misses();
        let mut counted = Counted { queries: 1, ..Counted::default() };
        let observer = &mut Cached::new(&mut counted.counts, &mut self.cache, self.layout);
        if is_occlusion {
            self.prepared.occluder_in(self.order, &ray, candidates, observer, &mut self.scratch);
        } else {
            self.prepared.closest_hit(Traversal::Odf, &ray, candidates, observer, &mut self.scratch);
        }
        counted.misses = self.cache.misses() - before;
        counted
    }
}
