//! Full sweep: every way to cut the centroids' order, on all three axes (MacDonald and Booth 1990; with one sort for the
//! whole build, Wald and Havran 2006).
//!
//! The references are sorted once per axis. A node is a range of each of the three columns; dividing it cuts the
//! column of the chosen axis, and divides the others by a flag per triangle, which keeps their order. So a level
//! costs O(n), the build O(n · depth). Equal centroids are ordered by triangle, so that a sweep can divide them too.

use super::cost::Weight;
use super::recursion::{NodeReferences, Split};
use super::reference::Reference;
use crate::geometry::padded::PaddedAabb;
use crate::probability::{Cuts, Probability, Scores, Side};
use crate::zeroed::zeroed_vec;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Nodes with more references are swept and divided by several threads, one per axis.
const PARALLEL: usize = 1 << 13;

/// The memory of a sweep build.
pub struct Columns {
    axes: [Column; 3],
    goes_right: Vec<AtomicBool>,
}

struct Column {
    sorted: Vec<Reference>,
    spare: Vec<Reference>,
}

/// A range of the references in the order of one axis, and as much memory to divide them into. Until then, that
/// memory holds the probabilities of candidates.
struct Range<'a> {
    sorted: &'a mut [Reference],
    spare: &'a mut [Reference],
}

/// The references of a node in three orders.
pub struct SweepReferences<'a> {
    axes: [Range<'a>; 3],
    /// By triangle: on which side of the split that is being carried out. Nodes touch only their own triangles'.
    goes_right: &'a [AtomicBool],
}

/// A candidate: the first references in the order of `axis` go left.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    axis: usize,
}

impl Columns {
    /// All references.
    pub fn references(&mut self) -> SweepReferences<'_> {
        SweepReferences {
            axes: self
                .axes
                .each_mut()
                .map(|column| Range { sorted: &mut column.sorted, spare: &mut column.spare }),
            goes_right: &self.goes_right,
        }
    }
}

impl SweepReferences<'_> {
    /// Sorts references on each axis.
    pub fn columns(list: Vec<Reference>, half_unit: f32) -> Columns {
        let largest = list.par_iter().map(|r| r.triangle()).max().unwrap_or(0) as usize;
        let axes = [0, 1, 2].map(|axis| {
            let mut order: Vec<(u64, u32)> = list
                .par_iter()
                .enumerate()
                .map(|(index, reference)| {
                    let centroid = ordered_bits(reference.centroid(half_unit)[axis]);
                    ((centroid as u64) << 32 | reference.triangle() as u64, index as u32)
                })
                .collect();
            order.par_sort_unstable();
            Column {
                sorted: order.par_iter().map(|&(_, index)| list[index as usize]).collect(),
                spare: zeroed_vec(list.len()),
            }
        });
        Columns { axes, goes_right: (0..=largest).map(|_| AtomicBool::new(false)).collect() }
    }
}

/// Maps a number to an integer that is ordered like it.
fn ordered_bits(value: f32) -> u32 {
    let bits = value.to_bits();
    if bits >> 31 == 1 { !bits } else { bits | 1 << 31 }
}

/// The candidates of one axis: candidate i leaves i + 1 references left.
struct Places<'a>(&'a [Reference]);

impl Cuts for Places<'_> {
    #[inline(always)]
    fn candidates(&self) -> usize {
        self.0.len() - 1
    }

    #[inline(always)]
    fn left(&self) -> impl Iterator<Item = Side> {
        self.0[..self.candidates()].iter().scan(EMPTY, grow)
    }

    #[inline(always)]
    fn right(&self) -> impl Iterator<Item = Side> {
        self.0[1..].iter().rev().scan(EMPTY, grow)
    }
}

const EMPTY: Side = Side { primitives: 0, bounds: PaddedAabb::EMPTY };

/// Adds a reference to a side.
#[inline(always)]
fn grow(side: &mut Side, reference: &Reference) -> Option<Side> {
    *side = Side { primitives: side.primitives + 1, bounds: side.bounds.union(&reference.bounds()) };
    Some(*side)
}

/// Candidate of one axis.
#[derive(Clone, Copy)]
struct Candidate {
    cost: f32,
    left_count: usize,
}

/// The cheapest candidate of one axis; of equals the first.
fn best<W: Weight>(scores: &Scores, weight: &W) -> Option<Candidate> {
    let count = scores.left.len() + 1;
    let mut best: Option<Candidate> = None;
    let mut least = f32::INFINITY;
    for (index, (&left, &right)) in scores.left.iter().zip(&*scores.right).enumerate() {
        let cost = weight.of(index + 1) * left + weight.of(count - index - 1) * right;
        if cost < least {
            least = cost;
            best = Some(Candidate { cost, left_count: index + 1 });
        }
    }
    best
}

impl Range<'_> {
    /// The candidates, and memory for what they score: 8 numbers fit in that of each reference.
    fn candidates(&mut self) -> (Places<'_>, Scores<'_>) {
        let candidates = self.sorted.len() - 1;
        let numbers: &mut [f32] = bytemuck::cast_slice_mut(self.spare);
        let (left, right) = numbers[..2 * candidates].split_at_mut(candidates);
        (Places(self.sorted), Scores { left, right })
    }

    fn bounds(&self, range: std::ops::Range<usize>) -> PaddedAabb {
        self.sorted[range].iter().fold(PaddedAabb::EMPTY, |sum, r| sum.union(&r.bounds()))
    }

    /// Moves references to the spare memory, those that go right behind the others.
    fn divide(&mut self, left_count: usize, goes_right: &[AtomicBool]) {
        let mut next = [0, left_count];
        for reference in self.sorted.iter() {
            let side = goes_right[reference.triangle() as usize].load(Ordering::Relaxed) as usize;
            self.spare[next[side]] = *reference;
            next[side] += 1;
        }
        std::mem::swap(&mut self.sorted, &mut self.spare);
    }
}

/// Runs one task per axis, on several threads when there is much to do.
fn on_axes<A: Send, T: Send>(parallel: bool, axes: [A; 3], task: impl Fn(A) -> T + Sync) -> [T; 3] {
    if parallel {
        let [x, y, z] = axes;
        let (x, (y, z)) = rayon::join(|| task(x), || rayon::join(|| task(y), || task(z)));
        [x, y, z]
    } else {
        axes.map(task)
    }
}

impl NodeReferences for SweepReferences<'_> {
    type Plane = Plane;

    fn len(&self) -> usize {
        self.axes[0].sorted.len()
    }

    fn best_split<P: Probability, W: Weight>(
        &mut self,
        probability: &P,
        state: &P::State,
        weight: &W,
    ) -> Option<Split<Plane>> {
        let count = self.len();
        if count == 2 {
            // Nothing to choose, and a third of all inner nodes.
            let side = |index: usize| Side { primitives: 1, bounds: self.axes[0].sorted[index].bounds() };
            return Some(Split { plane: Plane { axis: 0 }, left: side(0), right: side(1) });
        }
        let free = weight.free();
        let candidates = if count > PARALLEL {
            on_axes(true, self.axes.each_mut(), |range| {
                let (places, scores) = range.candidates();
                let mut scores = [scores];
                probability.score(state, free, &[places], &mut scores);
                best(&scores[0], weight)
            })
        } else {
            let [x, y, z] = self.axes.each_mut().map(Range::candidates);
            let (places, mut scores) = ([x.0, y.0, z.0], [x.1, y.1, z.1]);
            probability.score(state, free, &places, &mut scores);
            scores.map(|scores| best(&scores, weight))
        };
        let mut best: Option<(usize, Candidate)> = None;
        for (axis, candidate) in candidates.into_iter().enumerate() {
            if let Some(candidate) = candidate
                && best.is_none_or(|(_, best)| candidate.cost < best.cost)
            {
                best = Some((axis, candidate));
            }
        }
        let (axis, Candidate { left_count, .. }) = best?;
        let side = |range: std::ops::Range<usize>| Side {
            primitives: range.len(),
            bounds: self.axes[axis].bounds(range),
        };
        Some(Split { plane: Plane { axis }, left: side(0..left_count), right: side(left_count..count) })
    }

    /// Halves of the order on the axis where the centroids are widest apart.
    fn halves(&mut self) -> Split<Plane> {
        let count = self.len();
        let middle = count / 2;
        let spread = |range: &Range| {
            let centre = |r: &Reference| r.centroid(0.5);
            (centre(&range.sorted[count - 1]) - centre(&range.sorted[0])).to_array()
        };
        let mut axis = 0;
        for other in 1..3 {
            if spread(&self.axes[other])[other] > spread(&self.axes[axis])[axis] {
                axis = other;
            }
        }
        let side = |range: std::ops::Range<usize>| Side {
            primitives: range.len(),
            bounds: self.axes[axis].bounds(range),
        };
        Split { plane: Plane { axis }, left: side(0..middle), right: side(middle..count) }
    }

    fn divide(mut self, split: &Split<Plane>) -> (Self, Self) {
        let left_count = split.left.primitives;
        let chosen = split.plane.axis;
        for (index, reference) in self.axes[chosen].sorted.iter().enumerate() {
            self.goes_right[reference.triangle() as usize].store(index >= left_count, Ordering::Relaxed);
        }
        let goes_right = self.goes_right;
        let parallel = self.len() > PARALLEL;
        let mut axis = 0;
        let tasks = self.axes.each_mut().map(|range| {
            axis += 1;
            (axis - 1, range)
        });
        on_axes(parallel, tasks, |(axis, range)| {
            if axis != chosen {
                range.divide(left_count, goes_right);
            }
        });
        let halves = self.axes.map(|Range { sorted, spare }| {
            let (left, right) = sorted.split_at_mut(left_count);
            let (spare_left, spare_right) = spare.split_at_mut(left_count);
            (Range { sorted: left, spare: spare_left }, Range { sorted: right, spare: spare_right })
        });
        let [(x_left, x_right), (y_left, y_right), (z_left, z_right)] = halves;
        (
            SweepReferences { axes: [x_left, y_left, z_left], goes_right },
            SweepReferences { axes: [x_right, y_right, z_right], goes_right },
        )
    }

    fn triangles(&self, out: &mut [u32]) {
        for (out, reference) in out.iter_mut().zip(self.axes[0].sorted.iter()) {
            *out = reference.triangle();
        }
    }
}
