//! P(box): how likely a query is to overlap a box. The seam that this project is about (paper, section 2.4).
//!
//! Every builder is generic over a [`Probability`] and sees rays only through it. [`area::Area`] is the surface area
//! heuristic's; recorded rays are another implementation.
//!
//! Data flows with the recursion: [`Probability::root`] makes the state of the root, the builder asks for the boxes of
//! all candidates of a node in one call of [`Probability::score`], then hands the state down with
//! [`Probability::split`]. A state holds what makes the next question cheap: nothing for area, the rays that overlap the
//! node for rays (a ray that misses a node's box misses all boxes below it).

pub mod area;
pub mod blend;
pub mod rays;
pub mod shrunk;

use crate::geometry::padded::PaddedAabb;

/// One side of a candidate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Side {
    pub primitives: usize,
    /// Box around them; lower above upper when there are none.
    pub bounds: PaddedAabb,
}

/// Candidates of a node that are cuts of one order, so that the left sides grow from each to the next, and the right
/// sides shrink: the planes of an axis, or the places to cut its sorted primitives.
///
/// All boxes lie inside the node's. Because those of a side are nested, what overlaps one overlaps all larger ones:
/// rays need not be tested against every box.
pub trait Cuts: Sync {
    /// How many candidates there are.
    fn candidates(&self) -> usize;

    /// Left sides, from the first candidate to the last: each contains the one before.
    fn left(&self) -> impl Iterator<Item = Side>;

    /// Right sides, from the last candidate to the first: each contains the one before.
    fn right(&self) -> impl Iterator<Item = Side>;
}

/// Where P of the sides of [`Cuts`] goes, both in the order of the candidates.
#[derive(Debug)]
pub struct Scores<'a> {
    pub left: &'a mut [f32],
    pub right: &'a mut [f32],
}

/// A measure of boxes, proportional to the probability that a query overlaps them. Only ratios matter.
///
/// Implementations must not depend on the number of threads, nor on how often they were asked.
pub trait Probability: Sync {
    /// What is known about one node of the tree that is being built.
    type State: Send + Sync;

    /// The state of the root, whose box is `bounds`.
    fn root(&self, bounds: &PaddedAabb) -> Self::State;

    /// P of the node itself, in the same measure as [`Self::score`].
    fn node(&self, state: &Self::State, bounds: &PaddedAabb) -> f32;

    /// Writes P of both sides of all candidates of a node: those of `cuts[i]` to `scores[i]`, which has their number.
    /// A side that holds at most `free` primitives costs nothing whatever its P: it may get any finite value. So may
    /// all sides without primitives.
    fn score<C: Cuts>(&self, state: &Self::State, free: usize, cuts: &[C], scores: &mut [Scores]);

    /// The states of two children with these boxes, which may overlap. Nothing will be asked about a child without a box:
    /// its state may be anything.
    fn split(&self, state: Self::State, children: [Option<&PaddedAabb>; 2]) -> [Self::State; 2];
}
