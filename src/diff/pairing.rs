//! A piece of A and a piece of B in which queries differ: which of them are one, which are missing and which were added.
//!
//! Queries of one pixel are paired with each other, in order, by depth, kind and purpose, and by how alike they are (the
//! alignment of Needleman and Wunsch 1970). In a pixel with many queries, rays that both files have once hold the
//! alignment first, as in patience diff; what is left between two of them is short. At last, queries without a partner
//! whose rays are the same bits are one, wherever they are: they changed their pixel, depth, kind or purpose.

use super::query::{Judge, Query, question_hash, ray_hash};
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::hash::Hash;

/// Pairs that an alignment looks at, at most; beyond, it looks no farther than [`NEAR`].
const MOST_CELLS: usize = 1 << 14;

/// How far the next query that is in both files is looked for in a long alignment.
const NEAR: usize = 24;

/// What became of a query, by its index in the piece of A or of B.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Event {
    Pair(usize, usize),
    Missing(usize),
    Added(usize),
}

impl Event {
    /// By place; where a query is missing it is told before one that stands there instead.
    fn order(self) -> (usize, u8) {
        match self {
            Event::Missing(place) => (place, 0),
            Event::Pair(place, _) => (place, 1),
            Event::Added(place) => (place, 2),
        }
    }
}

/// What became of every query of both pieces, in their order.
pub(super) fn pair_up(judge: &Judge, a: &[Query], b: &[Query]) -> Vec<Event> {
    let mut paths: BTreeMap<u32, [Vec<usize>; 2]> = BTreeMap::new();
    for (side, queries) in [a, b].into_iter().enumerate() {
        for (place, query) in queries.iter().enumerate() {
            paths.entry(query.record.path).or_default()[side].push(place);
        }
    }
    let mut pairing = Pairing { judge, a, b, pairs: Vec::new() };
    for [of_a, of_b] in paths.values() {
        pairing.pair_path(of_a, of_b);
    }
    let mut events: Vec<Event> = pairing.pairs.iter().map(|&(a, b)| Event::Pair(a, b)).collect();

    let mut alone = [vec![true; a.len()], vec![true; b.len()]];
    for &(a, b) in &pairing.pairs {
        (alone[0][a], alone[1][b]) = (false, false);
    }
    let [alone_a, alone_b] = alone
        .map(|alone| alone.iter().enumerate().filter_map(|(i, &is)| is.then_some(i)).collect::<Vec<_>>());
    let mut rays: HashMap<u64, VecDeque<usize>> = queues(&alone_b, |place| ray_hash(b[place].record));
    let mut found = vec![false; b.len()];
    for place in alone_a {
        match rays.get_mut(&ray_hash(a[place].record)).and_then(VecDeque::pop_front) {
            Some(partner) => {
                found[partner] = true;
                events.push(Event::Pair(place, partner));
            }
            None => events.push(Event::Missing(place)),
        }
    }
    events.extend(alone_b.into_iter().filter(|&place| !found[place]).map(Event::Added));
    events.sort_by_key(|event| event.order());
    events
}

/// Places by a property of theirs, in order.
fn queues<K: Hash + Eq>(places: &[usize], property: impl Fn(usize) -> K) -> HashMap<K, VecDeque<usize>> {
    let mut queues: HashMap<K, VecDeque<usize>> = HashMap::new();
    for &place in places {
        queues.entry(property(place)).or_default().push_back(place);
    }
    queues
}

struct Pairing<'p, 'o> {
    judge: &'p Judge<'o>,
    a: &'p [Query<'p>],
    b: &'p [Query<'p>],
    pairs: Vec<(usize, usize)>,
}

impl Pairing<'_, '_> {
    fn agree(&self, a: usize, b: usize) -> bool {
        self.judge.agree(&self.a[a], &self.b[b])
    }

    /// The queries of one pixel, as places in both pieces.
    fn pair_path(&mut self, mut a: &[usize], mut b: &[usize]) {
        while let (Some((&first_a, rest_a)), Some((&first_b, rest_b))) = (a.split_first(), b.split_first())
            && self.agree(first_a, first_b)
        {
            self.pairs.push((first_a, first_b));
            (a, b) = (rest_a, rest_b);
        }
        while let (Some((&last_a, rest_a)), Some((&last_b, rest_b))) = (a.split_last(), b.split_last())
            && self.agree(last_a, last_b)
        {
            self.pairs.push((last_a, last_b));
            (a, b) = (rest_a, rest_b);
        }
        if a.len() * b.len() <= MOST_CELLS {
            return self.align(a, b);
        }
        let hash = |queries: &[Query], places: &[usize]| -> Vec<u64> {
            places.iter().map(|&place| question_hash(queries[place].record)).collect()
        };
        let (mut from_a, mut from_b) = (0, 0);
        let anchors = common_in_order(&hash(self.a, a), &hash(self.b, b));
        for (anchor_a, anchor_b) in anchors.into_iter().chain([(a.len(), b.len())]) {
            self.pair_gap(&a[from_a..anchor_a], &b[from_b..anchor_b]);
            if anchor_a < a.len() {
                self.pairs.push((a[anchor_a], b[anchor_b]));
            }
            (from_a, from_b) = (anchor_a + 1, anchor_b + 1);
        }
    }

    fn pair_gap(&mut self, a: &[usize], b: &[usize]) {
        if a.len() * b.len() <= MOST_CELLS {
            return self.align(a, b);
        }
        let (mut a, mut b) = (a, b);
        while !a.is_empty() && !b.is_empty() {
            let same = |(i, j): (usize, usize)| match (a.get(i), b.get(j)) {
                (Some(&one), Some(&other)) => self.judge.same_question(&self.a[one], &self.b[other]),
                _ => false,
            };
            let (i, j) = match same((0, 0)) {
                true => (1, 1),
                false => shifts(NEAR).find(|&shift| same(shift)).unwrap_or((NEAR, NEAR)),
            };
            let (i, j) = (i.min(a.len()), j.min(b.len()));
            self.align(&a[..i], &b[..j]);
            (a, b) = (&a[i..], &b[j..]);
        }
    }

    /// The pairs in order with the greatest sum of likenesses.
    fn align(&mut self, a: &[usize], b: &[usize]) {
        if a.is_empty() || b.is_empty() {
            return;
        }
        let width = b.len() + 1;
        // best[i · width + j]: the greatest sum of what is behind the first i of a and the first j of b.
        let mut best = vec![0u32; (a.len() + 1) * width];
        let mut likeness = vec![0u32; a.len() * b.len()];
        for i in (0..a.len()).rev() {
            for j in (0..b.len()).rev() {
                let like = self.judge.likeness(&self.a[a[i]], &self.b[b[j]]);
                likeness[i * b.len() + j] = like;
                let paired = if like > 0 { best[(i + 1) * width + j + 1] + like } else { 0 };
                best[i * width + j] = paired.max(best[(i + 1) * width + j]).max(best[i * width + j + 1]);
            }
        }
        let (mut i, mut j) = (0, 0);
        while i < a.len() && j < b.len() {
            let (here, like) = (best[i * width + j], likeness[i * b.len() + j]);
            if like > 0 && here == best[(i + 1) * width + j + 1] + like {
                self.pairs.push((a[i], b[j]));
                (i, j) = (i + 1, j + 1);
            } else if here == best[(i + 1) * width + j] {
                i += 1;
            } else {
                j += 1;
            }
        }
    }
}

/// Where two pieces may go on together, nearest first: by the longer way, and then by the difference of both.
pub(super) fn shifts(reach: usize) -> impl Iterator<Item = (usize, usize)> {
    let at = |longer: usize| {
        let unequal = (0..longer).rev().flat_map(move |shorter| [(longer, shorter), (shorter, longer)]);
        std::iter::once((longer, longer)).chain(unequal)
    };
    (1..reach).flat_map(at)
}

/// Places of values that both lists have once, as many as stand in the same order in both.
pub(super) fn common_in_order(a: &[u64], b: &[u64]) -> Vec<(usize, usize)> {
    let once = |values: &[u64]| {
        let mut places: HashMap<u64, Option<usize>> = HashMap::with_capacity(values.len());
        for (place, &value) in values.iter().enumerate() {
            places.entry(value).and_modify(|place| *place = None).or_insert(Some(place));
        }
        places
    };
    let (in_a, in_b) = (once(a), once(b));
    let partner = |(place, value): (usize, &u64)| {
        in_a[value]?;
        Some((place, in_b.get(value).copied().flatten()?))
    };
    let common: Vec<(usize, usize)> = a.iter().enumerate().filter_map(partner).collect();
    longest_rising(&common)
}

/// The longest part of the pairs whose second numbers rise, as their first ones do.
fn longest_rising(pairs: &[(usize, usize)]) -> Vec<(usize, usize)> {
    // Of every length the part that ends lowest, by the index of its last pair.
    let mut ends: Vec<usize> = Vec::new();
    let mut before: Vec<Option<usize>> = Vec::with_capacity(pairs.len());
    for (index, &(_, second)) in pairs.iter().enumerate() {
        let length = ends.partition_point(|&end| pairs[end].1 < second);
        before.push(length.checked_sub(1).map(|shorter| ends[shorter]));
        if length == ends.len() {
            ends.push(index);
        } else {
            ends[length] = index;
        }
    }
    let chain = std::iter::successors(ends.last().copied(), |&index| before[index]);
    let mut rising: Vec<(usize, usize)> = chain.map(|index| pairs[index]).collect();
    rising.reverse();
    rising
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn common_values_keep_their_order() {
        // 5 moved from the front to the back, 2 stands twice: neither holds the alignment.
        let found = common_in_order(&[5, 1, 2, 3, 2, 4], &[1, 2, 3, 9, 4, 5]);
        assert_eq!(found, [(1, 0), (3, 2), (5, 4)]);
        assert_eq!(common_in_order(&[], &[1]), []);
    }

    #[test]
    fn the_nearest_shift_comes_first() {
        let found: Vec<_> = shifts(3).collect();
        assert_eq!(found, [(1, 1), (1, 0), (0, 1), (2, 2), (2, 1), (1, 2), (2, 0), (0, 2)]);
    }
}
