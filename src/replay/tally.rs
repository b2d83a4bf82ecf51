//! Sums over queries: costs, their distribution, and how the answers compare. Sums of integers, so their order, and with it the
//! number of threads, changes nothing.

use super::check::Verdict;
use crate::cost::ByKind;
use crate::format::rays::{Purpose, Record, kind};
use crate::traverse::{Counts, Decisions, Overlap};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How often each value occurred: exactly below 2048, to within 1/1024 above. Grows as needed, to 24,576 places at most.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Histogram {
    places: Vec<u64>,
    count: u64,
}

/// Places per power of two above the exact ones.
const STEPS: u64 = 1024;

impl Histogram {
    /// Counts `value`; above 2³² as 2³².
    pub fn add(&mut self, value: u64) {
        let place = Self::place(value.min(1 << 32));
        if place >= self.places.len() {
            self.places.resize(place + 1, 0);
        }
        self.places[place] += 1;
        self.count += 1;
    }

    fn place(value: u64) -> usize {
        // The 11 leading bits, and how far they had to be shifted.
        let shift = (64 - value.leading_zeros()).saturating_sub(11);
        (u64::from(shift) * STEPS + (value >> shift)) as usize
    }

    /// The smallest value counted at a place.
    fn value(place: usize) -> u64 {
        let place = place as u64;
        let shift = (place / STEPS).saturating_sub(1);
        (place - shift * STEPS) << shift
    }

    /// Every value counted and how often, ascending; above 2048 the smallest of those that share a place.
    pub fn entries(&self) -> impl Iterator<Item = (u64, u64)> {
        let counted = self.places.iter().enumerate().filter(|(_, count)| **count > 0);
        counted.map(|(place, &count)| (Self::value(place), count))
    }

    /// The smallest value that at least `fraction` of the counted values do not exceed; 0 when none was counted.
    pub fn quantile(&self, fraction: f64) -> u64 {
        let rank = ((fraction * self.count as f64).ceil() as u64).max(1);
        let mut below = 0;
        for (place, &count) in self.places.iter().enumerate() {
            below += count;
            if below >= rank {
                return Self::value(place);
            }
        }
        0
    }

    fn merge(&mut self, other: &Histogram) {
        if self.places.len() < other.places.len() {
            self.places.resize(other.places.len(), 0);
        }
        for (sum, count) in self.places.iter_mut().zip(&other.places) {
            *sum += count;
        }
        self.count += other.count;
    }
}

/// Weights of Γ and of the SAH cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Costs {
    /// Of a box test.
    pub c_i: f64,
    /// Of a primitive test.
    pub c_p: f64,
}

impl Costs {
    /// Γ as measured: `c_i` · box tests + `c_p` · primitive tests.
    pub fn gamma(&self, counts: &Counts) -> f64 {
        self.c_i * counts.box_tests as f64 + self.c_p * counts.primitive_tests as f64
    }

    /// Γ_R of a tree: what strictly front-to-back traversal of every effective segment costs,
    /// `c_i` · (queries + Σ P_R(b) · children of b) + `c_p` · Σ P_R(l) · primitives of l.
    ///
    /// The paper's section 2.3 with the root's box test added, and for any number of children and primitives.
    pub fn expected(&self, queries: u64, overlap: &Overlap) -> f64 {
        self.c_i * (queries + overlap.children) as f64 + self.c_p * overlap.primitives as f64
    }
}

/// Units of [`Tally::gamma`]'s histogram in a Γ of 1.
pub const GAMMA_UNITS: f64 = 16.0;

/// Everything that is known of a group of queries.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Tally {
    pub queries: u64,
    /// Queries that hit something, or were occluded.
    pub hits: u64,
    pub counts: Counts,
    /// The same by kind.
    pub by_kind: ByKind,
    pub box_tests: Histogram,
    pub node_visits: Histogram,
    pub primitive_tests: Histogram,
    /// Γ of each query, in units of 1 / [`GAMMA_UNITS`].
    pub gamma: Histogram,
    pub mismatches: u64,
    pub borderline: u64,
    /// Answers that triangles cannot decide: the recorded program hit something else.
    pub unchecked: u64,
    /// Answers that cannot be judged, because what was hit moves.
    pub moving: u64,
    /// Terms of T_R and Γ_R; zero when they were not asked for.
    pub overlap: Overlap,
    /// Σ over queries of the square of the leaves overlapped.
    pub leaves_squared: u128,
    /// How packets decided; zero when queries went alone.
    pub packets: Decisions,
    /// Traversal only, counting included; summed over threads.
    pub seconds: f64,
}

/// One replayed query.
#[derive(Clone, Copy, Debug)]
pub struct Replayed {
    pub hit: bool,
    pub counts: Counts,
    pub verdict: Verdict,
    pub overlap: Overlap,
    /// In units of 1 / [`GAMMA_UNITS`].
    pub gamma: u64,
}

impl Tally {
    /// Leaf count variability (Aila, Karras and Laine 2013, section 5): the standard deviation of the number of leaves
    /// that a query's effective segment overlaps. Theirs is over the rays that they traced, ours over the recorded ones.
    pub fn leaf_count_variability(&self) -> f64 {
        let count = self.queries.max(1) as f64;
        let mean = self.overlap.leaves as f64 / count;
        (self.leaves_squared as f64 / count - mean * mean).max(0.0).sqrt()
    }

    pub fn add(&mut self, query: &Replayed) {
        self.queries += 1;
        self.hits += query.hit as u64;
        self.counts += query.counts;
        self.box_tests.add(query.counts.box_tests);
        self.node_visits.add(query.counts.node_visits);
        self.primitive_tests.add(query.counts.primitive_tests);
        self.gamma.add(query.gamma);
        match query.verdict {
            Verdict::Agrees => {}
            Verdict::Borderline => self.borderline += 1,
            Verdict::Mismatch => self.mismatches += 1,
            Verdict::Unchecked => self.unchecked += 1,
            Verdict::Moving => self.moving += 1,
        }
        self.overlap += query.overlap;
        self.leaves_squared += u128::from(query.overlap.leaves).pow(2);
    }

    pub fn merge(&mut self, other: &Tally) {
        self.queries += other.queries;
        self.hits += other.hits;
        self.counts += other.counts;
        self.by_kind += other.by_kind;
        self.box_tests.merge(&other.box_tests);
        self.node_visits.merge(&other.node_visits);
        self.primitive_tests.merge(&other.primitive_tests);
        self.gamma.merge(&other.gamma);
        self.mismatches += other.mismatches;
        self.borderline += other.borderline;
        self.unchecked += other.unchecked;
        self.moving += other.moving;
        self.overlap += other.overlap;
        self.leaves_squared += other.leaves_squared;
        self.packets += other.packets;
        self.seconds += other.seconds;
    }
}

/// In which of the groups a query falls: (kind, depth, purpose), as bytes of its record.
pub type Cell = (u8, u8, Purpose);

/// The cell of a record.
pub fn cell(record: &Record) -> Cell {
    (record.kind, record.depth, Purpose::from_byte(record.purpose))
}

/// Tallies of all queries, and by each of the ways to group them.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Tallies {
    pub total: Tally,
    pub by_kind: BTreeMap<u8, Tally>,
    pub by_depth: BTreeMap<u8, Tally>,
    pub by_purpose: BTreeMap<Purpose, Tally>,
}

impl Tallies {
    /// Adds what was found for queries of one cell, how their packets decided, and that they took `seconds`.
    pub fn add(
        &mut self,
        (query_kind, depth, purpose): Cell,
        queries: &[Replayed],
        packets: &Decisions,
        seconds: f64,
    ) {
        for tally in [
            &mut self.total,
            self.by_kind.entry(query_kind).or_default(),
            self.by_depth.entry(depth).or_default(),
            self.by_purpose.entry(purpose).or_default(),
        ] {
            queries.iter().for_each(|query| tally.add(query));
            let of_kind = tally.by_kind.of(query_kind == kind::OCCLUSION);
            of_kind.queries += queries.len() as u64;
            queries.iter().for_each(|query| of_kind.counts += query.counts);
            tally.packets += *packets;
            tally.seconds += seconds;
        }
    }

    pub fn merge(mut self, other: Tallies) -> Tallies {
        fn merge_all<K: Ord>(into: &mut BTreeMap<K, Tally>, from: BTreeMap<K, Tally>) {
            for (key, tally) in from {
                into.entry(key).or_default().merge(&tally);
            }
        }
        self.total.merge(&other.total);
        merge_all(&mut self.by_kind, other.by_kind);
        merge_all(&mut self.by_depth, other.by_depth);
        merge_all(&mut self.by_purpose, other.by_purpose);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_sorted_values() {
        for scale in [1u64, 7, 1_000, 1_000_000] {
            let mut values: Vec<u64> = (0..1000u64).map(|i| (i * 7919 % 1009) * scale).collect();
            let mut histogram = Histogram::default();
            values.iter().for_each(|&value| histogram.add(value));
            values.sort();
            for (fraction, index) in [(0.5, 499), (0.99, 989), (1.0, 999), (0.0, 0), (0.001, 0)] {
                let (exact, found) = (values[index], histogram.quantile(fraction));
                assert!(found <= exact && exact - found <= exact / 1024, "{fraction}: {found} for {exact}");
                assert!(exact >= 2048 || found == exact);
            }
        }
    }

    #[test]
    fn places_follow_each_other() {
        let mut last = 0;
        for value in (0..10_000).chain((14..53).map(|bit| 1 << bit)) {
            let place = Histogram::place(value);
            assert!(Histogram::value(place) <= value);
            if value < 10_000 {
                assert!(place == last || place == last + 1);
                last = place;
            }
        }
        let mut histogram = Histogram::default();
        histogram.add(u64::MAX);
        assert_eq!(histogram.quantile(1.0), 1 << 32);
        assert_eq!(Histogram::default().quantile(0.5), 0);
    }

    #[test]
    fn merging_is_adding() {
        let query = |n: u64| Replayed {
            hit: n.is_multiple_of(2),
            counts: Counts {
                box_tests: n,
                node_visits: n / 2,
                primitive_tests: 3,
                leaf_visits: 2,
                block_tests: 1,
            },
            verdict: [
                Verdict::Agrees,
                Verdict::Borderline,
                Verdict::Mismatch,
                Verdict::Unchecked,
                Verdict::Moving,
            ][n as usize % 5],
            overlap: Overlap { inner: n, children: 2 * n, leaves: n, primitives: 1 },
            gamma: 16 * n,
        };
        let cells = [(0, 0, Purpose::Camera), (1, 1, Purpose::Shadow)];
        let mut whole = Tallies::default();
        let (mut one, mut two) = (Tallies::default(), Tallies::default());
        for n in 0..100 {
            let cell = cells[n as usize % 2];
            let packets = Decisions { early_hits: n, early_misses: 1, by_rays: 2, few: n, octets: 3 * n };
            whole.add(cell, &[query(n)], &packets, 0.5);
            if n < 33 { &mut one } else { &mut two }.add(cell, &[query(n)], &packets, 0.5);
        }
        let merged = one.merge(two);
        assert_eq!(format!("{merged:?}"), format!("{whole:?}"));
        assert_eq!(merged.total.queries, 100);
        assert_eq!(merged.total.counts.box_tests, 4950);
        let Tally { mismatches, borderline, unchecked, moving, .. } = merged.total;
        assert_eq!((mismatches, borderline, unchecked, moving), (20, 20, 20, 20));
        assert_eq!(merged.by_purpose[&Purpose::Shadow].queries, 50);
        assert_eq!(merged.total.packets.early_hits, 4950);
        assert_eq!(merged.total.seconds, 50.0);
        // Of 0, 1, … 99.
        let deviation = ((100.0f64 * 100.0 - 1.0) / 12.0).sqrt();
        assert!((merged.total.leaf_count_variability() - deviation).abs() < 1e-9);
        assert_eq!(merged.total.gamma.entries().nth(3), Some((48, 1)));
    }
}
