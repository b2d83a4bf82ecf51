//! P(box): how likely a query is to overlap a box. The seam that this project is about (paper, section 2.4).
//!
//! Every builder is generic over a [`Probability`] and sees rays only through it. [`area::Area`] is the surface area
//! heuristic's; recorded rays are another implementation.
//!
//! Data flows with the recursion: [`Probability::root`] makes the state of the root, the builder asks for all candidate
//! boxes of a node in a few calls of [`Probability::nested`], then hands the state down with [`Probability::split`].
//! A state holds what makes the next question cheap: nothing for area, the rays that overlap the node for rays (a ray
//! that misses a node's box misses all boxes below it).

pub mod area;
pub mod blend;
pub mod rays;

use crate::geometry::padded::PaddedAabb;

/// A measure of boxes, proportional to the probability that a query overlaps them. Only ratios matter.
///
/// Implementations must not depend on the number of threads, nor on how often they were asked.
pub trait Probability: Sync {
    /// What is known about one node of the tree that is being built.
    type State: Send + Sync;

    /// The state of the root, whose box is `bounds`.
    fn root(&self, bounds: &PaddedAabb) -> Self::State;

    /// P of the node itself, in the same measure as [`Self::nested`].
    fn node(&self, state: &Self::State, bounds: &PaddedAabb) -> f32;

    /// Writes P of each of `boxes` into `out`, which has their number. The boxes lie inside the node's, and each
    /// contains the one before; leading ones may be empty (lower above upper) and then get any value.
    ///
    /// Because they are nested, what overlaps one box overlaps all later ones: an implementation that tests rays finds
    /// the first overlapped box of each ray by binary search and sums a histogram, instead of testing rays × boxes.
    /// It may collect the boxes first; an implementation that needs each box once consumes them as they are made.
    fn nested(&self, state: &Self::State, boxes: impl Iterator<Item = PaddedAabb>, out: &mut [f32]);

    /// The states of both children, whose boxes may overlap.
    fn split(&self, state: Self::State, left: &PaddedAabb, right: &PaddedAabb) -> (Self::State, Self::State);
}
