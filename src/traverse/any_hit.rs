//! Occlusion queries, depth first, in the orders that ask for nothing but where in the file a child stands and whether the ray starts in it.
//! No children are compared, so all that a ray overlaps are pushed at once, what waits is only a place to go on, and nothing is culled.

use super::blocks::{BlockRay, Blocks};
use super::candidates::Candidates;
use super::form::{Below, Form, Link};
use super::leaf::{self, Best};
use super::observer::Observer;
use super::ray::PreparedRay;
use super::simd::Machine;

/// Where to go on, kept from query to query.
#[derive(Debug, Default)]
pub(super) struct Waiting(Vec<Below>);

impl Waiting {
    /// Room for `capacity` entries.
    #[inline(always)]
    pub fn room(&mut self, capacity: usize) -> &mut [Below] {
        if self.0.len() < capacity {
            self.0.resize(capacity, Below::NOTHING);
        }
        &mut self.0
    }
}

/// Follows what is below the root, whose box the ray overlaps, to any hit. Of a node's children, the first of the file first; with `OUTSIDE`,
/// those that the ray enters after its start before the others. `observer` hears no numbers of nodes.
#[inline(always)]
pub(super) fn run<const OUTSIDE: bool, M: Machine, F: Form<M>>(
    form: &F,
    root: Below,
    blocks: &Blocks,
    ray: &PreparedRay,
    candidates: &impl Candidates,
    observer: &mut impl Observer,
    stack: &mut [Below],
) -> Best {
    let (form_ray, block_ray) = (F::ray(ray), BlockRay::new(ray));
    let mut best = Best::end_of(ray);
    stack[0] = root;
    let mut top = 1;
    while top > 0 {
        top -= 1;
        // Where a box is entered matters to the distance of a hit, and of an occluder no one asks for that.
        let current = Link::to(0, stack[top], f32::NEG_INFINITY);
        if !current.is_leaf() {
            observer.inner(&current);
            top = form.push_all::<OUTSIDE>(&current, &form_ray, ray.tfar, stack, top);
        } else if leaf::test::<true, M>(&current, blocks, ray, &block_ray, candidates, observer, &mut best) {
            return best;
        }
    }
    best
}
