//! RayOrder (the paper's algorithm 2): strictly front to back, with a priority queue. No node is opened that begins
//! behind the answer, so the inner nodes visited are exactly those whose boxes the effective segment overlaps.
//!
//! The paper pushes hit primitives onto the queue and ends when one is popped. Only the closest of them can ever be
//! popped, so it is kept beside the queue, and the loop ends when nothing that waits begins before it. At equal
//! distance boxes go first: one of them may hold an equal hit.

use super::blocks::{BlockRay, Blocks};
use super::candidates::Candidates;
use super::form::{Form, Link};
use super::leaf::{self, Best};
use super::observer::Observer;
use super::ray::PreparedRay;
use super::simd::Machine;

/// What waits, sorted: what is entered first is at the end, of equals the last that came, so that where all boxes begin at once
/// the order is depth first and few wait. Keeps its room from query to query.
///
/// Mostly a new subtree's place is near the end: it is found in fewer steps than a heap takes.
#[derive(Debug, Default)]
pub(super) struct Queue(Vec<Link>);

impl Queue {
    #[inline(always)]
    fn push(&mut self, link: Link) {
        let mut place = self.0.len();
        self.0.push(link);
        while place > 0 && link.entry > self.0[place - 1].entry {
            self.0[place] = self.0[place - 1];
            place -= 1;
        }
        self.0[place] = link;
    }
}

/// Follows `root`, whose box the ray overlaps. With `ANY` the first hit found is the answer, else the closest.
#[inline(always)]
pub(super) fn run<const ANY: bool, M: Machine, F: Form<M>>(
    form: &F,
    root: Link,
    blocks: &Blocks,
    ray: &PreparedRay,
    candidates: &impl Candidates,
    observer: &mut impl Observer,
    queue: &mut Queue,
) -> Best {
    let (form_ray, block_ray) = (F::ray(ray), BlockRay::new(ray));
    let mut best = Best::end_of(ray);
    let mut current = root;
    queue.0.clear();
    loop {
        if current.is_leaf() {
            if leaf::test::<ANY, M>(&current, blocks, ray, &block_ray, candidates, observer, &mut best) {
                return best;
            }
        } else {
            observer.inner(&current);
            form.each(&current, &form_ray, best.t, |child| queue.push(child));
            observer.waiting(None, &queue.0);
        }
        let Some(next) = queue.0.pop() else { return best };
        let followed = next.entry <= best.t;
        observer.popped(&next, followed);
        if !followed {
            return best;
        }
        current = next;
    }
}
