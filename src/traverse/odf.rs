//! Ordered depth first (the paper's algorithm 1): the nearer child first (for occlusion, whichever a [`ChildOrder`] says), the others on a stack with the distance at
//! which they are entered, and culled again when popped if a hit has been found before them.

use super::candidates::Candidates;
use super::child_order::ChildOrder;
use super::form::{Form, Link, Stack};
use super::leaf::{self, Best};
use super::observer::Observer;
use super::ray::PreparedRay;
use super::triangle::PreparedTriangle;

/// Follows `root`, whose box the ray overlaps. With `ANY` any hit is an answer, else the closest.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // One call site; a struct would only rename them.
pub(super) fn run<const ANY: bool, F: Form>(
    form: &F,
    root: Link,
    order: &impl ChildOrder,
    triangles: &[PreparedTriangle],
    ray: &PreparedRay,
    candidates: &impl Candidates,
    observer: &mut impl Observer,
    stack: &mut Stack,
) -> Best {
    let form_ray = F::ray(ray);
    let mut best = Best::end_of(ray);
    let mut current = root;
    loop {
        let next = if current.is_leaf() {
            if leaf::test::<ANY>(&current, triangles, ray, candidates, observer, &mut best) {
                return best;
            }
            None
        } else {
            observer.inner(&current);
            order.enter(form, &current, &form_ray, best.t, stack)
        };
        current = match next {
            Some(child) => child,
            None => loop {
                match stack.pop() {
                    None => return best,
                    Some(waiting) if waiting.entry <= best.t => break waiting,
                    Some(_) => {}
                }
            },
        };
    }
}
