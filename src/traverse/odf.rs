//! Ordered depth first (the paper's algorithm 1): the nearer child first (for occlusion, whichever a [`ChildOrder`] says), the others on a stack with the distance at
//! which they are entered, and culled again when popped if a hit has been found before them.

use super::blocks::{BlockRay, Blocks};
use super::candidates::Candidates;
use super::child_order::ChildOrder;
use super::form::{Form, Link, Stack};
use super::leaf::{self, Best};
use super::observer::Observer;
use super::ray::PreparedRay;
use super::simd::{Machine, prefetch};

/// Follows `root`, whose box the ray overlaps no later than `best`, which is what is known already. With `ANY` any hit is an answer, else the
/// closest.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // One call site; a struct would only rename them.
pub(super) fn run<const ANY: bool, M: Machine, F: Form<M>>(
    form: &F,
    root: Link,
    order: &impl ChildOrder,
    blocks: &Blocks,
    ray: &PreparedRay,
    candidates: &impl Candidates,
    observer: &mut impl Observer,
    mut best: Best,
    mut stack: Stack,
) -> Best {
    let (form_ray, block_ray) = (F::ray(ray), BlockRay::new(ray));
    let mut current = root;
    let fetch = |link: &Link| {
        let leaf = blocks.address(link.first as usize);
        let inner = form.address(link);
        prefetch(if link.is_leaf() { leaf } else { inner });
    };
    loop {
        if !current.is_leaf() {
            observer.inner(&current);
            let child = order.enter::<M, F>(form, &current, &form_ray, best.t, fetch, &mut stack);
            observer.waiting(child.as_ref(), stack.all());
            if let Some(child) = child {
                current = child;
                continue;
            }
        } else if leaf::test::<ANY, M>(&current, blocks, ray, &block_ray, candidates, observer, &mut best) {
            return best;
        }
        current = loop {
            match stack.pop() {
                None => return best,
                Some(waiting) => {
                    let followed = waiting.entry <= best.t;
                    observer.popped(&waiting, followed);
                    if followed {
                        break waiting;
                    }
                }
            }
        };
    }
}
