//! Several processes that do the work of one: what each takes, how results come together, and how all learn that one has failed.
//!
//! The work is the same program with the same arguments in every process, a *rank*. Each takes its share of a recording's chunks
//! ([`Share`]); what it found goes up a tree of ranks, merged on the way, and the whole comes down to all ([`merge_all`]). So every rank
//! goes on with the same numbers, and only the first prints.
//!
//! A rank that fails says so in the same way ([`tell_failure`]) in place of its next result: the others learn it when they wait for that
//! result, and none waits for ever.
//!
//! [`Alone`] is the one rank of an ordinary process and costs nothing; `world::World` (feature `mpi`) is a job of Open MPI or any other
//! MPI. Nothing else knows how messages travel.

#[cfg(test)]
pub(crate) mod crew;
#[cfg(feature = "mpi")]
mod world;

#[cfg(feature = "mpi")]
pub use world::World;

use serde::Serialize;
use serde::de::DeserializeOwned;
use std::ops::Range;
use thiserror::Error;

/// The processes of a job, as one of them sees them.
///
/// All ranks make the same calls in the same order, one at a time, whatever threads make them.
pub trait Ranks: Sync {
    /// Which of them this is, from 0.
    fn rank(&self) -> usize;

    /// How many there are.
    fn count(&self) -> usize;

    /// Hands a message to another rank.
    fn send(&self, to: usize, message: &[u8]);

    /// Waits for a message of another rank.
    fn receive(&self, from: usize) -> Vec<u8>;

    /// Adds up `values`, place by place, over all ranks. All have the same number of them; each gets the sums.
    fn sum(&self, values: &mut [u64]);

    /// Gives the messages of all ranks, which may differ in length, in the order of ranks, to each.
    fn exchange(&self, message: &[u8]) -> Vec<Vec<u8>>;
}

/// The only rank.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl Ranks for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn count(&self) -> usize {
        1
    }

    fn send(&self, to: usize, _message: &[u8]) {
        unreachable!("there is no rank {to}")
    }

    fn receive(&self, from: usize) -> Vec<u8> {
        unreachable!("there is no rank {from}")
    }

    fn sum(&self, _values: &mut [u64]) {}

    fn exchange(&self, message: &[u8]) -> Vec<Vec<u8>> {
        vec![message.to_vec()]
    }
}

/// Why there are no ranks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum StartError {
    #[error("--mpi: this command was built without MPI; build it with cargo build --release --features mpi")]
    NotBuilt,
    #[error("--mpi: MPI could not be started, or lets only the thread that started it call it")]
    Refused,
}

/// The ranks of this process: those of the MPI job where `mpi` asks for it. MPI ends when they are dropped.
///
/// # Errors
/// When there is no MPI.
pub fn start(mpi: bool) -> Result<Box<dyn Ranks>, StartError> {
    if !mpi {
        return Ok(Box::new(Alone));
    }
    #[cfg(feature = "mpi")]
    return Ok(Box::new(World::start().ok_or(StartError::Refused)?));
    #[cfg(not(feature = "mpi"))]
    Err(StartError::NotBuilt)
}

/// Which part of a list of chunks a rank takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Share {
    rank: usize,
    count: usize,
}

impl Share {
    /// Everything.
    pub const WHOLE: Share = Share { rank: 0, count: 1 };

    pub fn of(ranks: &dyn Ranks) -> Share {
        Share { rank: ranks.rank(), count: ranks.count() }
    }

    /// In turn, for work whose cost differs from place to place in a recording.
    pub fn in_turn(self, chunks: usize) -> impl Iterator<Item = usize> {
        (self.rank..chunks).step_by(self.count)
    }

    /// One piece, for work that must keep the order of the file.
    pub fn piece(self, chunks: usize) -> Range<usize> {
        let place = |rank: usize| (rank as u128 * chunks as u128 / self.count as u128) as usize;
        place(self.rank)..place(self.rank + 1)
    }
}

/// What a rank has of an even part, of at most `most`, of a list of `all` elements. `own` is its piece, with `before` elements before it.
pub fn even_part<T: Clone>(own: &[T], before: usize, all: usize, most: usize) -> Vec<T> {
    if all <= most {
        return own.to_vec();
    }
    if most == 0 {
        return Vec::new();
    }
    let divided = |a: usize, b: usize, by: usize| match (a as u64).checked_mul(b as u64) {
        Some(product) => (product / by as u64) as usize,
        None => (a as u128 * b as u128 / by as u128) as usize,
    };
    // Where the element with this number in the part stands, and the first number whose place is not before `at`.
    let place = |number: usize| divided(number, all, most);
    let first = |at: usize| {
        let number = divided(at, most, all);
        if place(number) < at { number + 1 } else { number }
    };
    (first(before)..first(before + own.len())).map(|number| own[place(number) - before].clone()).collect()
}

/// Another rank has failed, and this one's work is for nothing.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("rank {rank}: {line}")]
pub struct RankFailed {
    pub rank: usize,
    /// What it said.
    pub line: String,
}

/// First byte of a message: a result follows.
const RESULT: u8 = 0;
/// First byte of a message: a [`RankFailed`] follows, as JSON of rank and line.
const FAILURE: u8 = 1;

/// Merges what all ranks have; each gets the whole. `merge` must not care for the order.
///
/// # Errors
/// When a rank fails instead.
pub fn merge_all<T, M>(ranks: &dyn Ranks, own: T, merge: M) -> Result<T, RankFailed>
where
    T: Serialize + DeserializeOwned,
    M: Fn(T, T) -> T,
{
    if ranks.count() == 1 {
        return Ok(own);
    }
    let unreadable = |error: postcard::Error| RankFailed {
        rank: ranks.rank(),
        line: format!(
            "a message between ranks cannot be read ({error}): start the same program on all of them"
        ),
    };
    let mut merged = Ok(own);
    let whole = up_and_down(
        ranks,
        &mut merged,
        |merged, message| {
            let own = std::mem::replace(merged, Err(unreadable(postcard::Error::WontImplement)));
            *merged = match (own, opened(message)) {
                (Ok(own), Ok(other)) => {
                    postcard::from_bytes(other).map(|other| merge(own, other)).map_err(unreadable)
                }
                (Err(own), Err(other)) => Err(if other.rank < own.rank { other } else { own }),
                (Err(failed), _) | (_, Err(failed)) => Err(failed),
            };
        },
        |merged| match merged {
            Ok(merged) => postcard::to_extend(merged, vec![RESULT]).unwrap_or_else(|error| {
                sealed(&RankFailed {
                    rank: ranks.rank(),
                    line: format!("its result cannot be sent: {error}"),
                })
            }),
            Err(failed) => sealed(failed),
        },
    );
    match opened(&whole) {
        Ok(whole) => postcard::from_bytes(whole).map_err(unreadable),
        Err(failed) => Err(failed),
    }
}

/// Every rank's value, in the order of ranks, to each.
///
/// # Errors
/// When a rank fails instead.
pub fn gather_all<T>(ranks: &dyn Ranks, own: T) -> Result<Vec<T>, RankFailed>
where
    T: Serialize + DeserializeOwned,
{
    let mut all = merge_all(ranks, vec![(ranks.rank(), own)], |mut all, more| {
        all.extend(more);
        all
    })?;
    all.sort_by_key(|(rank, _)| *rank);
    Ok(all.into_iter().map(|(_, value)| value).collect())
}

/// Tells all ranks, in place of this one's next result, that it has none. Returns the failure of the lowest rank that failed now.
pub fn tell_failure(ranks: &dyn Ranks, line: &str) -> RankFailed {
    let mut failed = RankFailed { rank: ranks.rank(), line: line.to_owned() };
    if ranks.count() == 1 {
        return failed;
    }
    let own = failed.clone();
    let whole = up_and_down(
        ranks,
        &mut failed,
        |failed, message| {
            if let Err(other) = opened(message)
                && other.rank < failed.rank
            {
                *failed = other;
            }
        },
        sealed,
    );
    opened(&whole).err().unwrap_or(own)
}

/// Messages go up a binomial tree to rank 0, each rank adding those of its children to what it has, and the last comes down to all.
fn up_and_down<A>(
    ranks: &dyn Ranks,
    gathered: &mut A,
    add: impl Fn(&mut A, &[u8]),
    message: impl Fn(&A) -> Vec<u8>,
) -> Vec<u8> {
    let (rank, count) = (ranks.rank(), ranks.count());
    let steps = (0..usize::BITS).map(|bit| 1usize << bit);
    // The lowest bit of a rank says when it hands over; rank 0 never does.
    let mut children = Vec::new();
    let mut parent = None;
    for step in steps.take_while(|&step| step < count) {
        if rank & step != 0 {
            parent = Some(rank - step);
            break;
        }
        if rank + step < count {
            children.push(rank + step);
        }
    }
    for &child in &children {
        add(gathered, &ranks.receive(child));
    }
    let own = message(gathered);
    let whole = match parent {
        Some(parent) => {
            ranks.send(parent, &own);
            ranks.receive(parent)
        }
        None => own,
    };
    for &child in children.iter().rev() {
        ranks.send(child, &whole);
    }
    whole
}

/// A message's content.
fn opened(message: &[u8]) -> Result<&[u8], RankFailed> {
    match message.split_first() {
        Some((&RESULT, content)) => Ok(content),
        Some((&FAILURE, content)) if let Ok((rank, line)) = postcard::from_bytes(content) => {
            Err(RankFailed { rank, line })
        }
        _ => Err(RankFailed { rank: usize::MAX, line: "a message between ranks is damaged".to_owned() }),
    }
}

/// A failure as a message.
fn sealed(failed: &RankFailed) -> Vec<u8> {
    let content = (failed.rank, &failed.line);
    // Bytes are added to a vector: that does not fail.
    postcard::to_extend(&content, vec![FAILURE]).unwrap_or_else(|_| vec![FAILURE])
}

#[cfg(test)]
mod tests {
    use super::crew::on_ranks;
    use super::*;

    #[test]
    fn every_rank_gets_the_whole() {
        for count in 1..=9 {
            let results = on_ranks(count, |ranks| {
                let own = ranks.rank() as u64 + 1;
                let sum = merge_all(ranks, own, |a, b| a + b).unwrap();
                let all = gather_all(ranks, format!("rank {}", ranks.rank())).unwrap();
                (sum, all)
            });
            let all: Vec<String> = (0..count).map(|rank| format!("rank {rank}")).collect();
            let sum = (count * (count + 1) / 2) as u64;
            assert_eq!(results, vec![(sum, all); count]);
        }
    }

    #[test]
    fn all_learn_of_the_lowest_rank_that_fails() {
        for count in 2..=7 {
            for first in 0..count {
                let failed = on_ranks(count, |ranks| {
                    // This one and every second one after it fail.
                    let rank = ranks.rank();
                    if rank >= first && (rank - first).is_multiple_of(2) {
                        tell_failure(ranks, &format!("no disk {rank}"))
                    } else {
                        merge_all(ranks, 1u64, |a, b| a + b).unwrap_err()
                    }
                });
                let expected = RankFailed { rank: first, line: format!("no disk {first}") };
                assert_eq!(failed, vec![expected; count]);
            }
        }
    }

    #[test]
    fn shares_are_everything_once() {
        for (count, chunks) in [(1, 0), (1, 7), (3, 2), (4, 17), (5, 100)] {
            let shares: Vec<Share> = (0..count).map(|rank| Share { rank, count }).collect();
            let mut in_turn: Vec<usize> = shares.iter().flat_map(|share| share.in_turn(chunks)).collect();
            in_turn.sort();
            let pieces: Vec<usize> = shares.iter().flat_map(|share| share.piece(chunks)).collect();
            let all: Vec<usize> = (0..chunks).collect();
            assert_eq!((&in_turn, &pieces), (&all, &all));
            assert!(shares.iter().all(|share| share.piece(chunks).len() <= chunks.div_ceil(count)));
        }
    }

    #[test]
    fn pieces_of_even_parts_are_the_even_part() {
        for (all, most) in [(10, 10), (10, 3), (1000, 999), (1000, 7), (7, 1), (3, 5)] {
            let list: Vec<usize> = (0..all).collect();
            let kept = all.min(most);
            assert!(even_part(&list, 0, all, 0).is_empty());
            let whole: Vec<usize> = (0..kept).map(|number| number * all / kept).collect();
            assert_eq!(even_part(&list, 0, all, most), whole);
            for cut in 0..=all {
                let (a, b) = list.split_at(cut);
                assert_eq!([even_part(a, 0, all, most), even_part(b, cut, all, most)].concat(), whole);
            }
        }
        // Beyond 64 bits in between.
        let all = 1 << 40;
        assert_eq!(even_part(&[1, 2, 3, 4], all - 4, all, all / 2), [1, 3]);
    }

    #[test]
    fn sums_and_exchanges_are_those_of_all() {
        let results = on_ranks(3, |ranks| {
            let rank = ranks.rank();
            let mut values = [rank as u64, 10, 1 << 40];
            ranks.sum(&mut values);
            (values, ranks.exchange(&vec![rank as u8; rank]))
        });
        assert_eq!(results, vec![([3, 30, 3 << 40], vec![vec![], vec![1], vec![2, 2]]); 3]);
    }
}
