//! Ways to put parts together into a binary hierarchy, for [`super::forest`] to collapse.
//!
//! - [`cluster`]: the pair whose union is least likely to be hit becomes one, until one is left (agglomerative: Walter, Bala, Kulkarni and
//!   Pingali, "Fast agglomerative clustering for rendering", 2008, with P in place of area); or the pair whose union is least likely beyond what
//!   its sides are anyway, P(union) - ½ (P(a) + P(b)), which favours pairs that belong together over pairs that are small.
//! - [`sweep`]: from the top, the cut along an axis for which Σ P · nᵅ over both sides is least.
//!
//! Both ask for P of unions only. A union's rays are those of its sides and some of the others, so most pairs are out of the race before a
//! ray has been tested.

use super::forest::{Join, Sides};
use super::likelihood::{Bits, Local};
use crate::geometry::padded::PaddedAabb;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// By what pairs are chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Merit {
    /// P(union).
    Union,
    /// P(union) - ½ (P(a) + P(b)).
    Growth,
}

/// A part or a union of some, with its rays.
#[derive(Clone, Debug)]
pub struct Part {
    pub bounds: PaddedAabb,
    pub p: f64,
    pub bits: Bits,
}

impl Part {
    pub fn new(local: &Local, bounds: PaddedAabb) -> Part {
        let bits = local.bits(&bounds);
        Part { bounds, p: local.p(&bounds, &bits), bits }
    }

    fn union(&self, other: &Part, local: &Local) -> Part {
        let bounds = self.bounds.union(&other.bounds);
        let bits = local.around(&bounds, &self.bits, &other.bits);
        Part { bounds, p: local.p(&bounds, &bits), bits }
    }
}

/// A pair that may become one, and at least how bad that is.
struct Pair {
    key: f64,
    a: usize,
    b: usize,
    /// Known exactly, not only a bound.
    exact: bool,
}

impl Ord for Pair {
    /// The least key is the greatest, so that a heap gives it first; of equals the one that is known, then the pair made first.
    fn cmp(&self, other: &Pair) -> Ordering {
        let places = (other.a, other.b).cmp(&(self.a, self.b));
        other.key.total_cmp(&self.key).then(self.exact.cmp(&other.exact)).then(places)
    }
}

impl PartialOrd for Pair {
    fn partial_cmp(&self, other: &Pair) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Pair {
    fn eq(&self, other: &Pair) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Pair {}

/// Joins of `parts`, the root last; one for each part first, in their order.
pub fn cluster(local: &Local, parts: &[Part], merit: Merit) -> Vec<Join> {
    let mut joins = leaves(parts);
    let mut parts = parts.to_vec();
    let mut alive = vec![true; parts.len()];
    let key = |p: f64, a: &Part, b: &Part| match merit {
        Merit::Union => p,
        Merit::Growth => p - 0.5 * (a.p + b.p),
    };
    let bound = |parts: &[Part], a: usize, b: usize| {
        let (one, other) = (&parts[a], &parts[b]);
        let least = local.least(&one.bounds.union(&other.bounds), &one.bits, &other.bits);
        Pair { key: key(least, one, other), a, b, exact: false }
    };
    let mut heap: BinaryHeap<Pair> = (0..parts.len())
        .flat_map(|b| (0..b).map(move |a| (a, b)))
        .map(|(a, b)| bound(&parts, a, b))
        .collect();
    while let Some(pair) = heap.pop() {
        let Pair { a, b, exact, .. } = pair;
        if !alive[a] || !alive[b] {
            continue;
        }
        let union = parts[a].union(&parts[b], local);
        if !exact {
            let key = key(union.p, &parts[a], &parts[b]);
            let better = heap.peek().is_some_and(|next| next.key < key);
            if better {
                heap.push(Pair { key, exact: true, ..pair });
                continue;
            }
        }
        (alive[a], alive[b]) = (false, false);
        joins.push(Join { bounds: union.bounds, p: union.p, below: Sides::Pair(a, b) });
        let new = parts.len();
        parts.push(union);
        alive.push(true);
        heap.extend((0..new).filter(|&other| alive[other]).map(|other| bound(&parts, other, new)));
    }
    joins
}

/// One join for each part.
fn leaves(parts: &[Part]) -> Vec<Join> {
    let join = |(part, Part { bounds, p, .. }): (usize, &Part)| Join {
        bounds: *bounds,
        p: *p,
        below: Sides::Part(part),
    };
    parts.iter().enumerate().map(join).collect()
}

/// Joins of `parts` as above, cut from the top where Σ P · n^`alpha` is least.
pub fn sweep(local: &Local, parts: &[Part], alpha: f64) -> Vec<Join> {
    let mut joins = leaves(parts);
    let mut all: Vec<usize> = (0..parts.len()).collect();
    let weights: Vec<f64> = (0..=parts.len()).map(|count| (count as f64).powf(alpha)).collect();
    if !all.is_empty() {
        cut(local, parts, &weights, &mut all, &mut joins);
    }
    joins
}

/// Adds the joins of `members`, which may be reordered; returns the place of the last and the rays on it.
fn cut(
    local: &Local,
    parts: &[Part],
    weights: &[f64],
    members: &mut [usize],
    joins: &mut Vec<Join>,
) -> (usize, Part) {
    if let [member] = *members {
        return (member, parts[member].clone());
    }
    let count = members.len();
    let mut best = (f64::INFINITY, 0, count / 2);
    let mut costs = vec![0.0; count];
    for axis in 0..3 {
        sort(parts, members, axis);
        let mut side = parts[members[0]].clone();
        for place in 1..count {
            costs[place] = side.p * weights[place];
            side = side.union(&parts[members[place]], local);
        }
        let mut side = parts[members[count - 1]].clone();
        for place in (1..count).rev() {
            let cost = costs[place] + side.p * weights[count - place];
            if cost < best.0 {
                best = (cost, axis, place);
            }
            side = side.union(&parts[members[place - 1]], local);
        }
    }
    let (_, axis, place) = best;
    sort(parts, members, axis);
    let (left, right) = members.split_at_mut(place);
    let (a, one) = cut(local, parts, weights, left, joins);
    let (b, other) = cut(local, parts, weights, right, joins);
    let union = one.union(&other, local);
    joins.push(Join { bounds: union.bounds, p: union.p, below: Sides::Pair(a, b) });
    (joins.len() - 1, union)
}

fn sort(parts: &[Part], members: &mut [usize], axis: usize) {
    let middle = |part: &Part| part.bounds.lower[axis] + part.bounds.upper[axis];
    members.sort_by(|&a, &b| middle(&parts[a]).total_cmp(&middle(&parts[b])).then(a.cmp(&b)));
}
