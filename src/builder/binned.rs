//! Binned candidates: planes at equal distances between the centroids' bounds, on all three axes (Wald, "On fast
//! Construction of SAH-based Bounding Volume Hierarchies", 2007).
//!
//! One pass puts each reference of a node into one bin per axis; boxes and counts of bins, accumulated from both ends,
//! describe every candidate. A second pass moves the references to the other of two arrays, left ones first, both
//! sides in order, and bounds the centroids of each. Large nodes do both passes in blocks on several threads;
//! as minima, maxima and counts are exact and the order is kept, the result is the same.

use super::cost::Weight;
use super::recursion::{NodeReferences, Split};
use super::reference::Reference;
use super::{Bins, MAX_BINS};
use crate::geometry::padded::PaddedAabb;
use crate::probability::{Cuts, Probability, Scores, Side};
use glam::{BVec4A, Vec4};
use rayon::prelude::*;

/// Nodes with more references are binned and divided by several threads.
pub(super) const PARALLEL: usize = 1 << 16;
/// References that a thread takes at a time there.
pub(super) const BLOCK: usize = 1 << 13;

/// The references of a node, and where they are moved when they are divided.
pub struct BinnedReferences<'a> {
    pub(super) list: &'a mut [Reference],
    pub(super) spare: &'a mut [Reference],
    /// Bounds of the centroids.
    pub(super) centroids: PaddedAabb,
    pub(super) half_unit: f32,
    pub(super) bins: Bins,
}

/// A candidate: references whose bin on `axis` is below `bin` go left.
#[derive(Clone, Copy, Debug)]
pub enum Plane {
    Bin {
        axis: usize,
        bin: usize,
    },
    /// The first half of the current order goes left.
    Middle,
}

/// Maps centroids to bins: (centroid - lower) · scale, cut off at the last.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    lower: Vec4,
    scale: Vec4,
    last: Vec4,
    half_unit: f32,
}

impl Grid {
    pub(super) fn new(centroids: &PaddedAabb, bins: usize, half_unit: f32) -> Grid {
        let extent = centroids.upper - centroids.lower;
        // An axis that is flat, or so thin that the quotient overflows, has everything in bin 0: no candidate.
        let usable = extent.cmpgt(Vec4::splat(MIN_EXTENT));
        let scale = Vec4::select(usable, Vec4::splat(bins as f32) / extent, Vec4::ZERO);
        Grid { lower: centroids.lower, scale, last: Vec4::splat((bins - 1) as f32), half_unit }
    }

    /// Where a centroid is on each axis, in bins.
    #[inline(always)]
    fn position(&self, centroid: Vec4) -> Vec4 {
        (centroid - self.lower) * self.scale
    }

    /// The bin of a reference on each axis.
    #[inline(always)]
    fn bins(&self, centroid: Vec4) -> [usize; 3] {
        let position = self.position(centroid).min(self.last);
        [position.x, position.y, position.z].map(|at| {
            // SAFETY: `at` is a number from 0 to 255: the centroid lies within the bounds that the grid was made from,
            // which are finite, the scale is finite, and the last bin limits the product.
            unsafe { at.to_int_unchecked::<i32>() as usize }
        })
    }
}

/// Thinner centroid bounds are flat. Centroids are scaled so that a scene's are about 1.
const MIN_EXTENT: f32 = 1e-30;

/// Boxes and counts of up to `N` bins on each axis; `N` is a power of two.
#[derive(Clone)]
struct Histogram<const N: usize> {
    bounds: [[PaddedAabb; N]; 3],
    counts: [[u32; N]; 3],
}

impl<const N: usize> Histogram<N> {
    fn empty() -> Self {
        Histogram { bounds: [[PaddedAabb::EMPTY; N]; 3], counts: [[0; N]; 3] }
    }

    fn add_all(&mut self, references: &[Reference], grid: &Grid) {
        for reference in references {
            let bounds = reference.bounds();
            let bins = grid.bins(reference.centroid(grid.half_unit));
            for (axis, bin) in bins.into_iter().enumerate() {
                // Changes nothing, but shows the compiler that no check is needed.
                let bin = bin & (N - 1);
                self.bounds[axis][bin] = self.bounds[axis][bin].union(&bounds);
                self.counts[axis][bin] += 1;
            }
        }
    }

    fn merge(&mut self, other: &Self) {
        for axis in 0..3 {
            for bin in 0..N {
                self.bounds[axis][bin] = self.bounds[axis][bin].union(&other.bounds[axis][bin]);
                self.counts[axis][bin] += other.counts[axis][bin];
            }
        }
    }

    /// The candidate of least cost, and that cost.
    fn best<P: Probability, W: Weight>(
        &self,
        bins: usize,
        total: usize,
        grid: &Grid,
        probability: &P,
        state: &P::State,
        weight: &W,
    ) -> Option<(Split<Plane>, f32)> {
        let cuts = [0, 1, 2].map(|axis| {
            // An axis without extent has no candidates.
            let bins = if grid.scale[axis] == 0.0 { 1 } else { bins };
            let counts = &self.counts[axis][..bins];
            Planes { bounds: &self.bounds[axis][..bins], entries: counts, exits: counts }
        });
        let mut probabilities = [[[0.0; N]; 2]; 3];
        let mut scores = probabilities.each_mut().map(|[left, right]| Scores { left, right });
        for (cuts, scores) in cuts.iter().zip(&mut scores) {
            let Scores { left, right } = std::mem::replace(scores, Scores { left: &mut [], right: &mut [] });
            *scores = Scores { left: &mut left[..cuts.candidates()], right: &mut right[..cuts.candidates()] };
        }
        probability.score(state, weight.free(), &cuts, &mut scores);
        let mut least = f32::INFINITY;
        let mut best = None;
        for (axis, scores) in scores.iter().enumerate() {
            let mut left_count = 0;
            for (candidate, (left, right)) in scores.left.iter().zip(&*scores.right).enumerate() {
                left_count += self.counts[axis][candidate] as usize;
                let right_count = total - left_count;
                if left_count == 0 || right_count == 0 {
                    continue;
                }
                let cost = weight.of(left_count) * left + weight.of(right_count) * right;
                if cost < least {
                    least = cost;
                    best = Some((axis, candidate, left_count));
                }
            }
        }
        let (axis, candidate, left_count) = best?;
        let around = |bins: &[PaddedAabb]| bins.iter().fold(PaddedAabb::EMPTY, |sum, bin| sum.union(bin));
        let split = Split {
            plane: Plane::Bin { axis, bin: candidate + 1 },
            left: Side { primitives: left_count, bounds: around(&self.bounds[axis][..=candidate]) },
            right: Side {
                primitives: total - left_count,
                bounds: around(&self.bounds[axis][candidate + 1..bins]),
            },
        };
        Some((split, least))
    }
}

/// The candidates of one axis: candidate i puts bins 0..=i left and i + 1.. right.
pub(super) struct Planes<'a> {
    pub bounds: &'a [PaddedAabb],
    /// How many references begin in each bin, and how many end: the same where each is in one.
    pub entries: &'a [u32],
    pub exits: &'a [u32],
}

impl Cuts for Planes<'_> {
    #[inline(always)]
    fn candidates(&self) -> usize {
        self.bounds.len() - 1
    }

    #[inline(always)]
    fn left(&self) -> impl Iterator<Item = Side> {
        let candidates = self.candidates();
        self.bounds[..candidates].iter().zip(&self.entries[..candidates]).scan(EMPTY, grow)
    }

    #[inline(always)]
    fn right(&self) -> impl Iterator<Item = Side> {
        self.bounds[1..].iter().zip(&self.exits[1..]).rev().scan(EMPTY, grow)
    }
}

const EMPTY: Side = Side { primitives: 0, bounds: PaddedAabb::EMPTY };

/// Adds a bin to a side.
#[inline(always)]
fn grow(side: &mut Side, (bounds, &count): (&PaddedAabb, &u32)) -> Option<Side> {
    *side = Side { primitives: side.primitives + count as usize, bounds: side.bounds.union(bounds) };
    Some(*side)
}

/// Bounds of the centroids of references.
pub(super) fn centroid_bounds(references: &[Reference], half_unit: f32) -> PaddedAabb {
    references.iter().fold(PaddedAabb::EMPTY, |sum, r| sum.grown(r.centroid(half_unit)))
}

/// Bounds of the references themselves.
fn bounds(references: &[Reference]) -> PaddedAabb {
    references.iter().fold(PaddedAabb::EMPTY, |sum, r| sum.union(&r.bounds()))
}

impl<'a> BinnedReferences<'a> {
    /// `spare` has the length of `list`.
    pub fn new(list: &'a mut [Reference], spare: &'a mut [Reference], half_unit: f32, bins: Bins) -> Self {
        let centroids = list
            .par_chunks(BLOCK)
            .map(|block| centroid_bounds(block, half_unit))
            .reduce(|| PaddedAabb::EMPTY, |a, b| a.union(&b));
        BinnedReferences { list, spare, centroids, half_unit, bins }
    }

    /// The candidate of least cost, and that cost.
    pub(super) fn cheapest<P: Probability, W: Weight>(
        &self,
        probability: &P,
        state: &P::State,
        weight: &W,
    ) -> Option<(Split<Plane>, f32)> {
        // The capacity is a constant so that the many small nodes do not pay for 32 bins.
        match self.bins.of(self.list.len()) {
            bins @ 0..=4 => self.find::<4, _, _>(bins, probability, state, weight),
            bins @ 5..=8 => self.find::<8, _, _>(bins, probability, state, weight),
            bins @ 9..=32 => self.find::<32, _, _>(bins, probability, state, weight),
            bins => self.find::<MAX_BINS, _, _>(bins, probability, state, weight),
        }
    }

    fn find<const N: usize, P: Probability, W: Weight>(
        &self,
        bins: usize,
        probability: &P,
        state: &P::State,
        weight: &W,
    ) -> Option<(Split<Plane>, f32)> {
        let grid = Grid::new(&self.centroids, bins, self.half_unit);
        let mut histogram = Histogram::<N>::empty();
        if self.list.len() < PARALLEL {
            histogram.add_all(self.list, &grid);
        } else {
            let blocks = self.list.par_chunks(BLOCK).map(|block| {
                let mut histogram = Histogram::<N>::empty();
                histogram.add_all(block, &grid);
                histogram
            });
            histogram = blocks.reduce(Histogram::empty, |mut a, b| {
                a.merge(&b);
                a
            });
        }
        histogram.best(bins, self.list.len(), &grid, probability, state, weight)
    }
}

impl NodeReferences for BinnedReferences<'_> {
    type Plane = Plane;

    fn len(&self) -> usize {
        self.list.len()
    }

    fn best_split<P: Probability, W: Weight>(
        &mut self,
        probability: &P,
        state: &P::State,
        weight: &W,
    ) -> Option<Split<Plane>> {
        if let [left, right] = &*self.list {
            // Nothing to choose, and a third of all inner nodes.
            let side = |reference: &Reference| Side { primitives: 1, bounds: reference.bounds() };
            return Some(Split { plane: Plane::Middle, left: side(left), right: side(right) });
        }
        self.cheapest(probability, state, weight).map(|(split, _)| split)
    }

    /// Halves along the widest axis of the centroids, or of the list's order when they are all in one place.
    fn halves(&mut self) -> Split<Plane> {
        let middle = self.list.len() / 2;
        let extent = (self.centroids.upper - self.centroids.lower).truncate();
        let axis = extent.max_position();
        if extent[axis] > 0.0 {
            let half_unit = self.half_unit;
            self.list.select_nth_unstable_by(middle, |a, b| {
                let at = |reference: &Reference| reference.centroid(half_unit)[axis];
                at(a).total_cmp(&at(b)).then(a.triangle().cmp(&b.triangle()))
            });
        }
        let side = |part: &[Reference]| Side { primitives: part.len(), bounds: bounds(part) };
        let (left, right) = self.list.split_at(middle);
        Split { plane: Plane::Middle, left: side(left), right: side(right) }
    }

    fn divide(self, split: &Split<Plane>) -> (Self, Self) {
        let BinnedReferences { list, spare, centroids, half_unit, bins } = self;
        let left_count = split.left.primitives;
        let child = |list, spare, centroids| BinnedReferences { list, spare, centroids, half_unit, bins };
        match split.plane {
            Plane::Bin { axis, bin } => {
                let grid = Grid::new(&centroids, bins.of(list.len()), half_unit);
                let [left, right] = if list.len() < PARALLEL {
                    divide_block(
                        list,
                        &grid,
                        axis,
                        bin,
                        |reference, goes_right, before_left, before_right| {
                            let to = if goes_right { left_count + before_right } else { before_left };
                            spare[to] = *reference;
                        },
                    )
                } else {
                    let (left, right) = spare.split_at_mut(left_count);
                    divide_blocks(list, left, right, &grid, axis, bin)
                };
                let (old_left, old_right) = list.split_at_mut(left_count);
                let (new_left, new_right) = spare.split_at_mut(left_count);
                (child(new_left, old_left, left), child(new_right, old_right, right))
            }
            Plane::Middle => {
                let (left, right) = list.split_at_mut(left_count);
                let (spare_left, spare_right) = spare.split_at_mut(left_count);
                let left_centroids = centroid_bounds(left, half_unit);
                let right_centroids = centroid_bounds(right, half_unit);
                (child(left, spare_left, left_centroids), child(right, spare_right, right_centroids))
            }
        }
    }

    fn triangles(&self, out: &mut [u32]) {
        for (out, reference) in out.iter_mut().zip(self.list.iter()) {
            *out = reference.triangle();
        }
    }
}

/// Divides references, in order, and returns the bounds of both sides' centroids. `store` is given each reference,
/// whether it goes right, and how many went to the left and to the right before it.
#[inline(always)]
pub(super) fn divide_block(
    references: &[Reference],
    grid: &Grid,
    axis: usize,
    bin: usize,
    mut store: impl FnMut(&Reference, bool, usize, usize),
) -> [PaddedAabb; 2] {
    // No branch depends on the side: it would be mispredicted half of the time. A lane that is above the threshold
    // on an axis other than the chosen one is ruled out by an infinite threshold there.
    let mut threshold = Vec4::INFINITY;
    threshold[axis] = bin as f32;
    let [mut left, mut right] = [PaddedAabb::EMPTY; 2];
    let (mut left_count, mut right_count) = (0, 0);
    for reference in references {
        let centroid = reference.centroid(grid.half_unit);
        let goes_right = grid.position(centroid).cmpge(threshold).bitmask() != 0;
        store(reference, goes_right, left_count, right_count);
        left_count += !goes_right as usize;
        right_count += goes_right as usize;
        let is_right = BVec4A::splat(goes_right);
        let select = |identity: f32, on_right: bool| {
            let identity = Vec4::splat(identity);
            if on_right {
                Vec4::select(is_right, centroid, identity)
            } else {
                Vec4::select(is_right, identity, centroid)
            }
        };
        left.lower = left.lower.min(select(f32::INFINITY, false));
        left.upper = left.upper.max(select(f32::NEG_INFINITY, false));
        right.lower = right.lower.min(select(f32::INFINITY, true));
        right.upper = right.upper.max(select(f32::NEG_INFINITY, true));
    }
    [left, right]
}

/// [`divide_block`] on several threads: a first pass counts, so that each block knows where its references go.
pub(super) fn divide_blocks(
    references: &[Reference],
    mut left: &mut [Reference],
    mut right: &mut [Reference],
    grid: &Grid,
    axis: usize,
    bin: usize,
) -> [PaddedAabb; 2] {
    let is_left = |r: &&Reference| grid.position(r.centroid(grid.half_unit))[axis] < bin as f32;
    let left_counts: Vec<usize> =
        references.par_chunks(BLOCK).map(|block| block.iter().filter(is_left).count()).collect();
    let mut blocks = Vec::with_capacity(left_counts.len());
    for (block, &count) in references.chunks(BLOCK).zip(&left_counts) {
        let (left_here, left_later) = left.split_at_mut(count);
        let (right_here, right_later) = right.split_at_mut(block.len() - count);
        (left, right) = (left_later, right_later);
        blocks.push((block, left_here, right_here));
    }
    blocks
        .into_par_iter()
        .map(|(block, left, right)| {
            divide_block(block, grid, axis, bin, |reference, goes_right, before_left, before_right| {
                *if goes_right { &mut right[before_right] } else { &mut left[before_left] } = *reference;
            })
        })
        .reduce(|| [PaddedAabb::EMPTY; 2], |a, b| [a[0].union(&b[0]), a[1].union(&b[1])])
}
