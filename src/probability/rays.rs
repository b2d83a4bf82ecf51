//! P_R: how many recorded queries overlap a box (Bittner and Havran, "RDH: ray distribution heuristics for construction
//! of spatial data structures", 2009; paper, sections 2.4 and 5).
//!
//! A [`RaySet`] holds the effective segments, ready for box tests. [`Rays`] is the [`Probability`]: each node's state is
//! the list of rays that overlap its box (`listed`), handed down and thinned at each split; candidates are counted by `nested`
//! and the list is divided by `thin`; both test boxes with `block`. Where several processes have the rays, each counts its own,
//! and the counts are added up.
//! What P makes of a count is a [`Measure`]: [`Count`] here, [`super::blend::Blend`] or
//! [`super::shrunk::Shrunk`].
//!
//! At nodes with very many rays an even part of them is counted: it says as well which candidate is the best. The lists are
//! always complete.
//!
//! Counts are whole numbers, so neither their order nor the number of threads or processes can change a tree.

mod block;
mod listed;
mod nested;
mod segment;
mod thin;

use super::area::Area;
use super::{Cuts, Probability, Scores, Side};
use crate::format::rays::Record;
use crate::geometry::Ray;
use crate::geometry::padded::PaddedAabb;
use crate::ranks::{Alone, Ranks};
use listed::Listed;
use nested::{Nested, SEQUENCES, with_nested};
use rayon::prelude::*;
use segment::Packed;
use std::fmt::Debug;

/// Recorded rays over their effective segments: the training set of a tree.
#[derive(Clone, Debug, Default)]
pub struct RaySet {
    segments: Vec<Packed>,
}

impl RaySet {
    /// The effective segments of recorded queries. Segments that overlap no box at all are left out.
    pub fn of_records<'a>(records: impl IntoIterator<Item = &'a Record>) -> RaySet {
        RaySet::of_rays(records.into_iter().map(Record::effective_segment))
    }

    /// Rays over [tnear, tfar]. Those that overlap no box at all are left out.
    pub fn of_rays(rays: impl IntoIterator<Item = Ray>) -> RaySet {
        let mut segments: Vec<Packed> = rays.into_iter().filter_map(|ray| Packed::new(&ray)).collect();
        // More could not be numbered; as a sample, the first are as good as any.
        segments.truncate(u32::MAX as usize);
        RaySet { segments }
    }

    pub fn len(&self) -> usize {
        self.segments.len()
    }

    pub fn is_empty(&self) -> bool {
        self.segments.is_empty()
    }
}

/// A way to turn counts into P.
pub trait Measure: Sync {
    /// What is the same for all boxes inside a node.
    type Terms: Copy + Debug + Send + Sync;

    /// The terms for the boxes inside a node that `rays` rays overlap.
    fn terms(&self, rays: usize) -> Self::Terms;

    /// P of a box that `rays` rays overlap, a whole number or an estimate, and that has the share `area` of its node's surface
    /// (0 when that has none).
    fn value(&self, terms: &Self::Terms, rays: f32, area: f32) -> f32;

    /// The most rays that are counted at a node; of more, an even part.
    fn most_counted(&self) -> usize {
        MOST_COUNTED
    }
}

/// See [`Measure::most_counted`]. Enough to estimate a share of a half within 0.8%.
const MOST_COUNTED: usize = 1 << 12;

/// P_R itself, with a floor for boxes without rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Count {
    /// Added to every count (the paper's powerplant figure uses 10).
    pub floor: f32,
    /// Rays' worth of area: this times the box's share of its node's area is added. It decides between candidates
    /// that as many rays overlap, and makes nodes without any ray those of a SAH tree.
    pub area: f32,
}

impl Count {
    /// The count and nothing else, as in the paper's figure 1: of candidates that as many rays overlap, the first is taken.
    /// All rays are counted at every node.
    pub const PLAIN: Count = Count { floor: 0.0, area: 0.0 };
}

impl Default for Count {
    /// No floor, and area only where the rays leave a tie (less than any ray, unless there are a thousand primitives
    /// for each).
    fn default() -> Count {
        Count { floor: 0.0, area: 1.0 / 1024.0 }
    }
}

impl Measure for Count {
    type Terms = ();

    fn terms(&self, _rays: usize) {}

    #[inline(always)]
    fn value(&self, _terms: &(), rays: f32, area: f32) -> f32 {
        rays + (self.floor + self.area * area)
    }

    fn most_counted(&self) -> usize {
        if *self == Count::PLAIN { usize::MAX } else { MOST_COUNTED }
    }
}

/// A probability from recorded rays.
#[derive(Clone)]
pub struct Rays<'a, M> {
    set: &'a RaySet,
    area: Area,
    measure: M,
    ranks: &'a dyn Ranks,
}

impl<'a, M: Measure> Rays<'a, M> {
    /// The measure for boxes inside `scene`.
    pub fn new(set: &'a RaySet, scene: &PaddedAabb, measure: M) -> Rays<'a, M> {
        Rays::shared(set, scene, measure, &Alone)
    }

    /// The same where each of `ranks` has a part of the rays: the sets one after another, in the order of ranks, are the whole.
    ///
    /// A question is a call that all ranks make together, so they have to build the same tree in the same order: with one thread each.
    pub fn shared(set: &'a RaySet, scene: &PaddedAabb, measure: M, ranks: &'a dyn Ranks) -> Rays<'a, M> {
        Rays { set, area: Area::of_scene(scene), measure, ranks }
    }

    fn state(&self, rays: Listed, bounds: &PaddedAabb) -> NodeRays<M::Terms> {
        let area = self.area.of(bounds);
        // A node without area (a point, a line) has boxes without area.
        let per_area = if area > 0.0 { 1.0 / area } else { 0.0 };
        NodeRays { terms: self.measure.terms(rays.all()), rays, per_area }
    }
}

/// The rays that overlap a node.
#[derive(Debug)]
pub struct NodeRays<T> {
    rays: Listed,
    terms: T,
    /// 1 / area of the node, or 0.
    per_area: f32,
}

impl<T> NodeRays<T> {
    /// How many there are, on all ranks.
    pub fn count(&self) -> usize {
        self.rays.all()
    }
}

impl<M: Measure> Probability for Rays<'_, M> {
    type State = NodeRays<M::Terms>;

    fn root(&self, bounds: &PaddedAabb) -> NodeRays<M::Terms> {
        let all = 0..self.set.len() as u32;
        let segments = &self.set.segments;
        let rays =
            all.into_par_iter().filter(|&ray| segments[ray as usize].segment().overlaps(bounds)).collect();
        let [rays] = Listed::share([rays], segments, self.ranks);
        self.state(rays, bounds)
    }

    fn node(&self, state: &Self::State, bounds: &PaddedAabb) -> f32 {
        let area = self.area.of(bounds) * state.per_area;
        self.measure.value(&state.terms, state.rays.all() as f32, area)
    }

    fn score<C: Cuts>(&self, state: &Self::State, free: usize, cuts: &[C], scores: &mut [Scores]) {
        let NodeRays { rays, terms, per_area } = state;
        let area = |side: &Side| self.area.of(&side.bounds) * per_area;
        if rays.all() == 0 {
            for (cuts, scores) in cuts.iter().zip(scores) {
                let left = scores.left.iter_mut().zip(cuts.left());
                let right = scores.right.iter_mut().rev().zip(cuts.right());
                left.for_each(|(score, side)| *score = self.measure.value(terms, 0.0, area(&side)));
                right.for_each(|(score, side)| *score = self.measure.value(terms, 0.0, area(&side)));
            }
            return;
        }
        // Of more rays than are counted, an even part.
        let most = self.measure.most_counted();
        let part = (rays.all() > most).then(|| rays.even_part(most));
        let (counted, worth) = match &part {
            Some(part) => (&part[..], (rays.all() as f64 / most as f64) as f32),
            None => (&rays.own[..], 1.0),
        };
        let segments = rays.segments(&self.set.segments);
        for (cuts, scores) in cuts.chunks(SEQUENCES / 2).zip(scores.chunks_mut(SEQUENCES / 2)) {
            with_nested(|nested: &mut Nested| {
                nested.start(cuts.iter().map(|cuts| 2 * cuts.candidates()).sum());
                for (cuts, scores) in cuts.iter().zip(&mut *scores) {
                    // A box is seen once: its area waits where its P will be.
                    let (mut left, mut right) = (scores.left.iter_mut(), scores.right.iter_mut().rev());
                    let note = |score: Option<&mut f32>, side: &Side| {
                        if let Some(score) = score {
                            *score = area(side);
                        }
                    };
                    nested.add(cuts.left(), free, |side| note(left.next(), side));
                    nested.add(cuts.right(), free, |side| note(right.next(), side));
                }
                let counts = nested.count(segments, counted);
                let sides = scores
                    .iter_mut()
                    .flat_map(|scores| scores.left.iter_mut().chain(scores.right.iter_mut().rev()));
                let value = |(score, count): (&mut f32, f32)| {
                    *score = self.measure.value(terms, worth * count, *score);
                };
                if rays.is_shared {
                    let mut sums: Vec<u64> = counts.map(u64::from).collect();
                    self.ranks.sum(&mut sums);
                    sides.zip(sums.into_iter().map(|count| count as f32)).for_each(value);
                } else {
                    sides.zip(counts.map(|count| count as f32)).for_each(value);
                }
            });
        }
    }

    fn split(&self, state: Self::State, children: [Option<&PaddedAabb>; 2]) -> [Self::State; 2] {
        let boxes = children.map(|bounds| bounds.unwrap_or(&PaddedAabb::EMPTY));
        let rays = &state.rays;
        let [left, right] = if rays.all() == 0 || children == [None; 2] {
            [0; 2].map(|_| Listed::alone(Vec::new()))
        } else {
            let divided = thin::divide(rays.segments(&self.set.segments), &rays.own, boxes);
            rays.children(divided, &self.set.segments, self.ranks)
        };
        [self.state(left, boxes[0]), self.state(right, boxes[1])]
    }
}
