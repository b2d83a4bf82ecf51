//! What a person asks who looks at a tree and at recorded queries: the logic under `bvh-view`, without window or graphics card.
//!
//! # Map
//!
//! | module | question |
//! |---|---|
//! | [`walk`] | where am I in the tree, and where can I go |
//! | [`queries`] | which of the recorded queries take part, and how they are shared among threads |
//! | [`count`] | how often each node was opened and each triangle tested |
//! | [`shares`] | what part of all that is spent in a node and below it |
//!
//! Data flows so: [`queries`] hands recorded queries to an observer of the real traversal ([`count`]); what it counted is
//! summed along the tree ([`shares`]). Sums are of integers, so the number of threads changes nothing.

pub mod count;
pub mod queries;
pub mod shares;
pub mod walk;
