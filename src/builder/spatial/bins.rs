//! Candidates of a split of space: planes at equal distances across a node's box, on all three axes, and what lies on either side
//! of each when the triangles that cross it are cut (Stich, Friedrich and Dietrich 2009, section 4.2).
//!
//! A reference enters in the bin that holds its lower bound and exits in that of its upper one; sums of entries from the left and of exits
//! from the right count the references of every candidate. A reference that spans several bins is chopped: its
//! triangle is followed from plane to plane. The boxes of those parts only compare candidates, so they are computed in single
//! precision; what a chosen plane really makes of a triangle, [`crate::builder::clip`] says.

use crate::builder::binned::Planes;
use crate::builder::cost::Weight;
use crate::builder::reference::Reference;
use crate::geometry::Triangle;
use crate::geometry::padded::PaddedAabb;
use crate::probability::{Cuts, Probability, Scores};
use glam::Vec4;

/// Divides a node's box into bins.
#[derive(Clone, Copy, Debug)]
pub struct Grid {
    lower: Vec4,
    upper: Vec4,
    /// Bins per length; 0 on an axis that has no candidates.
    scale: Vec4,
    /// Length of a bin.
    width: Vec4,
    last: Vec4,
}

impl Grid {
    pub fn new(bounds: &PaddedAabb, bins: usize) -> Grid {
        let extent = bounds.upper - bounds.lower;
        let scale = Vec4::splat(bins as f32) / extent;
        let width = extent / bins as f32;
        // Neither flat, nor so thin or so wide that numbers overflow.
        let usable = extent.cmplt(Vec4::INFINITY) & scale.cmplt(Vec4::INFINITY);
        let scale = Vec4::select(usable, scale, Vec4::ZERO);
        Grid { lower: bounds.lower, upper: bounds.upper, scale, width, last: Vec4::splat((bins - 1) as f32) }
    }

    fn usable(&self, axis: usize) -> bool {
        self.scale[axis] > 0.0
    }

    /// The first and the last bin that a reference reaches, on each axis. One that only touches a plane is not beyond it.
    #[inline(always)]
    pub fn span(&self, bounds: &PaddedAabb) -> ([usize; 3], [usize; 3]) {
        let number = |v: Vec4| [v.x, v.y, v.z].map(|x| x as i32 as usize);
        let first = number(((bounds.lower - self.lower) * self.scale).min(self.last));
        // From the other end, so that a bound on a plane counts to the bin before.
        let after = number(((self.upper - bounds.upper) * self.scale).min(self.last));
        let last = self.last.x as i32 as usize;
        let exit = [0, 1, 2].map(|axis| (last - after[axis]).max(first[axis]));
        (first, exit)
    }

    /// Where bin `bin` begins.
    #[inline(always)]
    pub fn plane(&self, axis: usize, bin: usize) -> f32 {
        self.lower[axis] + bin as f32 * self.width[axis]
    }
}

/// A plane and what it would leave on its sides.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    pub axis: usize,
    /// The first bin on the right.
    pub bin: usize,
    pub cost: f32,
    pub counts: [usize; 2],
    pub bounds: [PaddedAabb; 2],
}

/// Boxes of what lies in each of up to `N` bins of each axis, and how many references begin and end there.
#[derive(Clone)]
pub struct Histogram<const N: usize> {
    bounds: [[PaddedAabb; N]; 3],
    entries: [[u32; N]; 3],
    exits: [[u32; N]; 3],
}

impl<const N: usize> Histogram<N> {
    pub fn empty() -> Self {
        Histogram { bounds: [[PaddedAabb::EMPTY; N]; 3], entries: [[0; N]; 3], exits: [[0; N]; 3] }
    }

    pub fn add_all(&mut self, references: &[Reference], triangles: &[Triangle], grid: &Grid) {
        let usable = [0, 1, 2].map(|axis| grid.usable(axis));
        for reference in references {
            let bounds = reference.bounds();
            let (first, last) = grid.span(&bounds);
            for axis in 0..3 {
                let (entry, exit) = (first[axis] & (N - 1), last[axis] & (N - 1));
                self.entries[axis][entry] += 1;
                self.exits[axis][exit] += 1;
                if entry == exit {
                    self.bounds[axis][entry] = self.bounds[axis][entry].union(&bounds);
                } else if usable[axis] {
                    let triangle = &triangles[reference.triangle() as usize];
                    let bins = &mut self.bounds[axis][entry..=exit];
                    match axis {
                        0 => chop::<0>(triangle, &bounds, entry, bins, grid),
                        1 => chop::<1>(triangle, &bounds, entry, bins, grid),
                        _ => chop::<2>(triangle, &bounds, entry, bins, grid),
                    }
                }
            }
        }
    }

    pub fn merge(&mut self, other: &Self) {
        for axis in 0..3 {
            for bin in 0..N {
                self.bounds[axis][bin] = self.bounds[axis][bin].union(&other.bounds[axis][bin]);
                self.entries[axis][bin] += other.entries[axis][bin];
                self.exits[axis][bin] += other.exits[axis][bin];
            }
        }
    }

    /// The candidate of least cost among those that need at most `room` more references than the `total` there are.
    pub fn best<P: Probability, W: Weight>(
        &self,
        [total, room]: [usize; 2],
        grid: &Grid,
        probability: &P,
        state: &P::State,
        weight: &W,
    ) -> Option<Candidate> {
        let cuts = [0, 1, 2].map(|axis| {
            // An axis without extent has no candidates.
            let bins = if grid.usable(axis) { N } else { 1 };
            Planes {
                bounds: &self.bounds[axis][..bins],
                entries: &self.entries[axis][..bins],
                exits: &self.exits[axis][..bins],
            }
        });
        let mut probabilities = [[[0.0; N]; 2]; 3];
        let mut scores = probabilities.each_mut().map(|[left, right]| Scores { left, right });
        for (cuts, scores) in cuts.iter().zip(&mut scores) {
            let Scores { left, right } = std::mem::replace(scores, Scores { left: &mut [], right: &mut [] });
            *scores = Scores { left: &mut left[..cuts.candidates()], right: &mut right[..cuts.candidates()] };
        }
        probability.score(state, weight.free(), &cuts, &mut scores);
        let mut best: Option<Candidate> = None;
        for (axis, scores) in scores.iter().enumerate() {
            let (mut left, mut right) = (0, total);
            for (candidate, (left_score, right_score)) in scores.left.iter().zip(&*scores.right).enumerate() {
                left += self.entries[axis][candidate] as usize;
                right -= self.exits[axis][candidate] as usize;
                if left == 0 || right == 0 || left + right > total + room {
                    continue;
                }
                let cost = weight.of(left) * left_score + weight.of(right) * right_score;
                if best.is_none_or(|best| cost < best.cost) {
                    let bounds = [PaddedAabb::EMPTY; 2];
                    best = Some(Candidate { axis, bin: candidate + 1, cost, counts: [left, right], bounds });
                }
            }
        }
        let mut best = best?;
        let around = |bins: &[PaddedAabb]| bins.iter().fold(PaddedAabb::EMPTY, |sum, bin| sum.union(bin));
        let (left, right) = self.bounds[best.axis].split_at(best.bin);
        best.bounds = [around(left), around(right)];
        Some(best)
    }
}

/// Adds the parts of a triangle to the boxes of the bins that its reference spans on axis `AXIS`, the first of which is number `first`.
#[inline]
fn chop<const AXIS: usize>(
    triangle: &Triangle,
    reference: &PaddedAabb,
    first: usize,
    bins: &mut [PaddedAabb],
    grid: &Grid,
) {
    let [mut a, mut b, mut c] = triangle.0.map(|vertex| vertex.extend(0.0));
    // Ordered along the axis.
    let order = |low: &mut Vec4, high: &mut Vec4| {
        if low[AXIS] > high[AXIS] {
            std::mem::swap(low, high);
        }
    };
    order(&mut a, &mut b);
    order(&mut b, &mut c);
    order(&mut a, &mut b);
    let [a_at, b_at, c_at] = [a[AXIS], b[AXIS], c[AXIS]];
    // Where a plane meets the edge from a to c, and the one from a to b or from b to c.
    let inverse = |length: f32| if length > 0.0 { 1.0 / length } else { 0.0 };
    let long = (c - a) * inverse(c_at - a_at);
    let rising = (b - a) * inverse(b_at - a_at);
    let falling = (c - b) * inverse(c_at - b_at);
    let section = |at: f32| {
        let at = at.clamp(a_at, c_at);
        let on_long = a + long * (at - a_at);
        let other = if at < b_at { a + rising * (at - a_at) } else { b + falling * (at - b_at) };
        PaddedAabb { lower: on_long.min(other), upper: on_long.max(other) }
    };
    let mut from = reference.lower[AXIS];
    let mut section_from = section(from);
    let last = bins.len() - 1;
    for (index, bin) in bins.iter_mut().enumerate() {
        let to = if index == last { reference.upper[AXIS] } else { grid.plane(AXIS, first + index + 1) };
        let section_to = section(to);
        let mut part = section_from.union(&section_to);
        if from <= b_at && b_at <= to {
            part = part.grown(b);
        }
        // Never outside the reference, and never inside out.
        let lower = part.lower.max(reference.lower).min(reference.upper);
        let upper = part.upper.min(reference.upper).max(lower);
        *bin = bin.union(&PaddedAabb { lower, upper });
        (from, section_from) = (to, section_to);
    }
}
