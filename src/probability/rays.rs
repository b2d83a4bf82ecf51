//! P_R: how many recorded queries overlap a box (Bittner and Havran, "RDH: ray distribution heuristics for construction
//! of spatial data structures", 2009; paper, sections 2.4 and 5).
//!
//! A [`RaySet`] holds the effective segments, ready for box tests. [`Rays`] is the [`Probability`]: each node's state is
//! the list of rays that overlap its box, handed down and thinned at each split; candidates are counted by [`nested`].
//! What P makes of a count is a [`Measure`]: [`Count`] here, or [`super::blend::Blend`].
//!
//! Counts are whole numbers, so neither their order nor the number of threads can change a tree.

pub mod nested;
mod segment;

use super::area::Area;
use super::{Cuts, Probability, Scores, Side};
use crate::format::rays::Record;
use crate::geometry::Ray;
use crate::geometry::padded::PaddedAabb;
use nested::{Candidates, with_candidates};
use rayon::prelude::*;
pub use segment::Segment;

/// Nodes with more rays are searched and divided by several threads.
const PARALLEL: usize = 1 << 13;
/// Rays that a thread takes at a time there.
const BLOCK: usize = 1 << 11;

/// Recorded rays over their effective segments: the training set of a tree.
#[derive(Clone, Debug, Default)]
pub struct RaySet {
    segments: Vec<Segment>,
}

impl RaySet {
    /// The effective segments of recorded queries. Segments that overlap no box at all are left out.
    pub fn of_records<'a>(records: impl IntoIterator<Item = &'a Record>) -> RaySet {
        RaySet::of_rays(records.into_iter().map(Record::effective_segment))
    }

    /// Rays over [tnear, tfar]. Those that overlap no box at all are left out.
    pub fn of_rays(rays: impl IntoIterator<Item = Ray>) -> RaySet {
        let mut segments: Vec<Segment> = rays.into_iter().filter_map(|ray| Segment::new(&ray)).collect();
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

/// What P makes of the rays on a box: P = `per_ray` · rays + `constant` + `per_area` · area of the box / area of the node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Terms {
    pub per_ray: f32,
    pub constant: f32,
    pub per_area: f32,
}

/// A way to turn counts into P.
pub trait Measure: Sync {
    /// The terms for the boxes inside a node that `rays` rays overlap.
    fn terms(&self, rays: usize) -> Terms;
}

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
    fn terms(&self, _rays: usize) -> Terms {
        Terms { per_ray: 1.0, constant: self.floor, per_area: self.area }
    }
}

/// A probability from recorded rays.
#[derive(Clone, Debug)]
pub struct Rays<'a, M> {
    set: &'a RaySet,
    area: Area,
    measure: M,
}

impl<'a, M: Measure> Rays<'a, M> {
    /// The measure for boxes inside `scene`.
    pub fn new(set: &'a RaySet, scene: &PaddedAabb, measure: M) -> Rays<'a, M> {
        Rays { set, area: Area::of_scene(scene), measure }
    }

    fn state(&self, rays: Vec<u32>, bounds: &PaddedAabb) -> NodeRays {
        let area = self.area.of(bounds);
        let mut terms = self.measure.terms(rays.len());
        // A node without area (a point, a line) has boxes without area.
        if area > 0.0 {
            terms.per_area /= area;
        } else {
            terms.per_area = 0.0;
        }
        NodeRays { rays, terms }
    }

    fn value(&self, state: &NodeRays, rays: usize, bounds: &PaddedAabb) -> f32 {
        let Terms { per_ray, constant, per_area } = state.terms;
        per_ray * rays as f32 + (constant + per_area * self.area.of(bounds))
    }
}

/// The rays that overlap a node.
#[derive(Debug)]
pub struct NodeRays {
    rays: Vec<u32>,
    /// With `per_area` already divided by the node's area.
    terms: Terms,
}

impl NodeRays {
    /// How many there are.
    pub fn count(&self) -> usize {
        self.rays.len()
    }
}

impl<M: Measure> Probability for Rays<'_, M> {
    type State = NodeRays;

    fn root(&self, bounds: &PaddedAabb) -> NodeRays {
        let all = 0..self.set.len() as u32;
        let segments = &self.set.segments;
        let rays = all.into_par_iter().filter(|&ray| segments[ray as usize].overlaps(bounds)).collect();
        self.state(rays, bounds)
    }

    fn node(&self, state: &NodeRays, bounds: &PaddedAabb) -> f32 {
        self.value(state, state.rays.len(), bounds)
    }

    fn score<C: Cuts>(&self, state: &NodeRays, free: usize, cuts: &[C], scores: &mut [Scores]) {
        for (cuts, scores) in cuts.iter().zip(scores) {
            self.nested(state, free, cuts.left(), scores.left.len(), scores.left.iter_mut());
            self.nested(state, free, cuts.right(), scores.right.len(), scores.right.iter_mut().rev());
        }
    }

    fn split(&self, state: NodeRays, children: [Option<&PaddedAabb>; 2]) -> [NodeRays; 2] {
        let segments = &self.set.segments;
        let rays = &state.rays;
        let side = |bounds: Option<&PaddedAabb>| {
            let bounds = bounds.unwrap_or(&PaddedAabb::EMPTY);
            let on = |ray: u32| segments[ray as usize].overlaps(bounds);
            let kept = if rays.is_empty() {
                Vec::new()
            } else if rays.len() <= PARALLEL {
                thinned(rays, on)
            } else {
                let parts: Vec<Vec<u32>> = rays.par_chunks(BLOCK).map(|block| thinned(block, on)).collect();
                parts.concat()
            };
            self.state(kept, bounds)
        };
        if rays.len() <= PARALLEL {
            children.map(side)
        } else {
            let (left, right) = rayon::join(|| side(children[0]), || side(children[1]));
            [left, right]
        }
    }
}

impl<M: Measure> Rays<'_, M> {
    /// Writes P of `count` nested sides.
    fn nested<'o>(
        &self,
        state: &NodeRays,
        free: usize,
        sides: impl Iterator<Item = Side>,
        count: usize,
        out: impl Iterator<Item = &'o mut f32>,
    ) {
        let Terms { per_ray, constant, per_area } = state.terms;
        let fixed = |bounds: &PaddedAabb| constant + per_area * self.area.of(bounds);
        if state.rays.is_empty() || per_ray == 0.0 {
            for (out, side) in out.zip(sides) {
                *out = fixed(&side.bounds);
            }
            return;
        }
        with_candidates(|candidates: &mut Candidates| {
            candidates.start(count);
            let mut written = Vec::with_capacity(count);
            for (out, side) in out.zip(sides) {
                *out = fixed(&side.bounds);
                candidates.push(if side.primitives <= free { &PaddedAabb::EMPTY } else { &side.bounds });
                written.push(out);
            }
            candidates.finish();
            let counts = candidates.first_overlaps(&self.set.segments, &state.rays);
            // What overlaps a box overlaps all larger ones.
            let mut sum = 0;
            for (out, &first) in written.into_iter().zip(counts) {
                sum += first;
                *out += per_ray * sum as f32;
            }
        });
    }
}

/// The rays for which `keep` holds, without memory for those that are dropped.
fn thinned(rays: &[u32], keep: impl Fn(u32) -> bool) -> Vec<u32> {
    let mut kept = Vec::with_capacity(rays.len());
    kept.extend(rays.iter().copied().filter(|&ray| keep(ray)));
    if kept.len() < rays.len() / 2 {
        kept.shrink_to_fit();
    }
    kept
}
