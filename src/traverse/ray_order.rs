//! RayOrder (the paper's algorithm 2): strictly front to back, with a priority queue. No node is opened that begins
//! behind the answer, so the inner nodes visited are exactly those whose boxes the effective segment overlaps.
//!
//! The paper pushes hit primitives onto the queue and ends when one is popped. Only the closest of them can ever be
//! popped, so it is kept beside the queue, and the loop ends when nothing that waits begins before it. At equal
//! distance boxes go first: one of them may hold an equal hit.

use super::candidates::Candidates;
use super::form::{Form, Link};
use super::leaf::{self, Best};
use super::observer::Observer;
use super::ray::PreparedRay;
use super::triangle::PreparedTriangle;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// A subtree that waits; the greatest is the one entered first, of equals the one first in the file.
#[derive(Clone, Copy, Debug)]
struct Pending(Link);

impl Ord for Pending {
    fn cmp(&self, other: &Pending) -> Ordering {
        other.0.entry.total_cmp(&self.0.entry).then(other.0.node.cmp(&self.0.node))
    }
}

impl PartialOrd for Pending {
    fn partial_cmp(&self, other: &Pending) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Pending {
    fn eq(&self, other: &Pending) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Pending {}

/// What waits. Keeps its room from query to query.
#[derive(Debug, Default)]
pub(super) struct Queue(BinaryHeap<Pending>);

/// Follows `root`, whose box the ray overlaps. With `ANY` the first hit found is the answer, else the closest.
#[inline(always)]
pub(super) fn run<const ANY: bool, F: Form>(
    form: &F,
    root: Link,
    triangles: &[PreparedTriangle],
    ray: &PreparedRay,
    candidates: &impl Candidates,
    observer: &mut impl Observer,
    Queue(queue): &mut Queue,
) -> Best {
    let form_ray = F::ray(ray);
    let mut best = Best::end_of(ray);
    let mut current = root;
    queue.clear();
    loop {
        if current.is_leaf() {
            if leaf::test::<ANY>(&current, triangles, ray, candidates, observer, &mut best) {
                return best;
            }
        } else {
            observer.inner(&current);
            form.each(&current, &form_ray, best.t, |child| queue.push(Pending(child)));
        }
        match queue.pop() {
            Some(Pending(next)) if next.entry <= best.t => current = next,
            _ => return best,
        }
    }
}
