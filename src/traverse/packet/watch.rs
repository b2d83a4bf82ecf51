//! Who watches a packet: what each ray was tested for, and which rule decided.

use super::super::observer::Counts;
use serde::{Deserialize, Serialize};

/// How it was decided whether a packet enters a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Rule {
    /// The first and the last active octet enter it: all follow, untested.
    EarlyHit,
    /// Interval arithmetic says that no ray enters it.
    EarlyMiss,
    /// Neither rule could tell, and all active octets were tested.
    Rays,
    /// So few octets are active that they were tested at once.
    Few,
}

/// Told of each step of a packet; queries are named by their number in it. `()` ignores all of it, and nothing is computed for it.
pub trait PacketObserver {
    /// Whether any of the following is listened to.
    const LISTENS: bool = true;

    /// It was decided whether the packet enters a box.
    #[inline(always)]
    fn decided(&mut self, _rule: Rule) {}

    /// The rays of one octet were tested against a box.
    #[inline(always)]
    fn boxes(&mut self, _queries: &[u32]) {}

    /// An inner node is visited by the rays of an octet: for all that is known each may enter its children.
    #[inline(always)]
    fn inner(&mut self, _queries: &[u32]) {}

    /// A ray that enters a leaf is tested against a triangle of it.
    #[inline(always)]
    fn primitive(&mut self, _query: u32) {}

    /// A ray went on alone, at this cost.
    #[inline(always)]
    fn alone(&mut self, _query: u32, _counts: &Counts) {}
}

impl PacketObserver for () {
    const LISTENS: bool = false;
}

/// Boxes by the rule that decided whether a packet enters them; summed over packets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Decisions {
    pub early_hits: u64,
    pub early_misses: u64,
    pub by_rays: u64,
    /// Without asking for a rule: few octets were active.
    pub few: u64,
    /// Octets tested against a box, for any of these, and against the boxes of leaves.
    pub octets: u64,
}

/// Counts of each query of a packet: box tests that an octet with it was in, visits of its octets, and its own primitive tests.
pub struct PacketCounts<'a> {
    pub queries: &'a mut [Counts],
    pub decisions: &'a mut Decisions,
}

impl PacketObserver for PacketCounts<'_> {
    fn decided(&mut self, rule: Rule) {
        match rule {
            Rule::EarlyHit => self.decisions.early_hits += 1,
            Rule::EarlyMiss => self.decisions.early_misses += 1,
            Rule::Rays => self.decisions.by_rays += 1,
            Rule::Few => self.decisions.few += 1,
        }
    }

    fn boxes(&mut self, queries: &[u32]) {
        self.decisions.octets += 1;
        queries.iter().for_each(|&query| self.queries[query as usize].box_tests += 1);
    }

    fn inner(&mut self, queries: &[u32]) {
        queries.iter().for_each(|&query| self.queries[query as usize].node_visits += 1);
    }

    fn primitive(&mut self, query: u32) {
        self.queries[query as usize].primitive_tests += 1;
    }

    fn alone(&mut self, query: u32, counts: &Counts) {
        self.queries[query as usize] += *counts;
    }
}

impl Decisions {
    /// Boxes for which it was decided whether a packet enters them.
    pub fn total(&self) -> u64 {
        self.early_hits + self.early_misses + self.by_rays + self.few
    }
}

impl std::ops::AddAssign for Decisions {
    fn add_assign(&mut self, other: Decisions) {
        self.early_hits += other.early_hits;
        self.early_misses += other.early_misses;
        self.by_rays += other.by_rays;
        self.few += other.few;
        self.octets += other.octets;
    }
}
