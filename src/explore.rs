//! What a person asks who looks at a tree and at recorded queries: the logic under `bvh-view`, without window or graphics card.
//!
//! # Map
//!
//! | module | question |
//! |---|---|
//! | [`walk`] | where am I in the tree, and where can I go |
//! | [`queries`] | which of the recorded queries take part, and how they are shared among threads |
//! | [`price`] | what a visit, a leaf and a block of triangles cost in a tree |
//! | [`count`] | how often each node was opened and each triangle tested |
//! | [`shares`] | what part of all that is spent in a node and below it |
//! | [`heat`] | and in which triangles and pixels |
//! | [`versus`] | where one tree spends more than another |
//! | [`diagram`] | the tree as an icicle or a sunburst |
//! | [`steps`] | what one query does, step by step |
//! | [`rays`] | which segments to draw; all queries of a pixel |
//! | [`crossing`] | what passes a plane, and how many boxes overlap on it |
//!
//! Data flows so: [`queries`] hands recorded queries to an observer of the real traversal ([`count`]); what it counted is
//! summed along the tree ([`shares`]) and laid out over the triangles ([`heat`]), and that is compared and drawn. Counts are integers, and what is
//! listed is sorted by the queries' numbers, so threads change nothing.

pub mod count;
pub mod crossing;
pub mod diagram;
pub mod heat;
pub mod price;
pub mod queries;
pub mod rays;
pub mod shares;
pub mod steps;
pub mod versus;
pub mod walk;
