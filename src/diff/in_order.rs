//! Two recordings side by side, in file order.
//!
//! As long as both agree, their chunks are compared in place. At a query that differs, both are read on into windows until they agree
//! again, at first near by, then by rays that both windows have once; what lies before that place is [paired](super::pairing).
//! Where windows of [`MOST_KEPT`] queries have nothing in common, a few of the rays of both whole files say how they go on.
//! So memory is bounded, and every query is looked at a bounded number of times.

use super::pairing::{common_in_order, shifts};
use super::query::{Judge, Kept, Query, Relation, question_hash};
use super::reader::{Reader, query};
use super::tally::Tally;
use super::{DiffError, FormatError};
use crate::format::rays::{NO_PATH, Rays};
use crate::progress::Progress;
use std::collections::{HashMap, VecDeque};

/// Queries that a window has at least when both files differ.
const LEAST_KEPT: usize = 64;

/// Queries that a window has at most: four of the largest chunks, which are tiles of the image in a recording of ours.
const MOST_KEPT: usize = 1 << 18;

/// How far a place from which on everything agrees is preferred to a nearer one where both only ask the same.
const NEAR: usize = 16;

/// How many queries have to agree there.
const A_WHILE: usize = 8;

/// Rays of a whole file that are looked at to find out how two go on together.
const MOST_SAMPLED: u64 = 1 << 20;

/// Queries that are compared as one block of bytes.
const BLOCK: usize = 64;

/// Compares every query of two files.
///
/// # Errors
/// When a chunk is damaged.
pub(super) fn compare(a: &Rays, b: &Rays, tally: &mut Tally, progress: &Progress) -> Result<(), DiffError> {
    let windows = [VecDeque::new(), VecDeque::new()];
    let readers = (Reader::new(a), Reader::new(b));
    let mut walk = Walk { files: [a, b], readers, windows, ended: [false; 2], common: None, tally, progress };
    while walk.step()? {}
    walk.rest()
}

/// Where the comparison has come to.
struct Walk<'w, 'a, 't, 'o> {
    files: [&'w Rays<'a>; 2],
    readers: (Reader<'w, 'a>, Reader<'w, 'a>),
    windows: [VecDeque<Kept>; 2],
    ended: [bool; 2],
    /// Numbers of queries that a few rays of both whole files are, in A and B, once they were needed.
    common: Option<Vec<(u64, u64)>>,
    tally: &'t mut Tally<'o>,
    progress: &'t Progress,
}

impl Walk<'_, '_, '_, '_> {
    /// Goes to behind the next difference; false when one file has ended.
    fn step(&mut self) -> Result<bool, DiffError> {
        if self.windows.iter().all(VecDeque::is_empty) {
            self.agree_in_place()?;
            self.keep(LEAST_KEPT)?;
        } else {
            self.keep(self.windows[0].len().max(self.windows[1].len()))?;
        }
        self.agree_in_windows();
        if self.windows.iter().all(VecDeque::is_empty) {
            return Ok(!(self.ended[0] && self.ended[1]));
        }
        if self.windows.iter().any(VecDeque::is_empty) {
            // The next step fills the empty one, unless its file has ended.
            let empty = usize::from(self.windows[1].is_empty());
            return Ok(!self.ended[empty]);
        }
        let (of_a, of_b) = self.differing_piece()?;
        self.pair_piece(of_a, of_b);
        Ok(true)
    }

    /// Takes what agrees from the files' chunks, up to the first difference or the end of a file.
    fn agree_in_place(&mut self) -> Result<(), DiffError> {
        loop {
            let (a, b) = (&mut self.readers.0, &mut self.readers.1);
            // Both files decode their next chunk at the same time.
            let (more_a, more_b) = rayon::join(|| a.fill(), || b.fill());
            if !(more_a.map_err(DiffError::A)? && more_b.map_err(DiffError::B)?) {
                return Ok(());
            }
            let length = a.at_hand().min(b.at_hand());
            let agreed = agreement(a, b, length, self.tally);
            a.take(agreed);
            b.take(agreed);
            self.progress.advance(agreed as u64);
            if agreed < length {
                return Ok(());
            }
        }
    }

    /// Reads on until both windows have `count` queries, or what there still is.
    fn keep(&mut self, count: usize) -> Result<(), DiffError> {
        let [a, b] = &mut self.windows;
        let (missing_a, missing_b) = (count.saturating_sub(a.len()), count.saturating_sub(b.len()));
        let (reader_a, reader_b) = (&mut self.readers.0, &mut self.readers.1);
        // For a few queries, waking another thread takes longer than they do.
        let (ended_a, ended_b) = if missing_a.max(missing_b) > 16 * LEAST_KEPT {
            rayon::join(|| reader_a.keep(missing_a, a), || reader_b.keep(missing_b, b))
        } else {
            (reader_a.keep(missing_a, a), reader_b.keep(missing_b, b))
        };
        self.ended[0] |= ended_a.map_err(DiffError::A)?;
        self.ended[1] |= ended_b.map_err(DiffError::B)?;
        self.progress.advance(missing_a as u64);
        Ok(())
    }

    fn agree_in_windows(&mut self) {
        let [a, b] = &mut self.windows;
        while let (Some(front_a), Some(front_b)) = (a.front(), b.front()) {
            let relation = self.tally.judge.compare(&front_a.query(), &front_b.query());
            if matches!(relation, Relation::Changed(_)) {
                return;
            }
            self.tally.relate(&front_a.query(), &front_b.query(), relation);
            a.pop_front();
            b.pop_front();
        }
    }

    /// How much of both windows, whose first queries differ, is to be paired before the files may agree again.
    fn differing_piece(&mut self) -> Result<(usize, usize), DiffError> {
        let mut reach = LEAST_KEPT;
        loop {
            self.keep(reach)?;
            let (whole_a, whole_b) = contiguous(&mut self.windows);
            // An earlier search may have left more.
            let (a, b) = (&whole_a[..whole_a.len().min(reach)], &whole_b[..whole_b.len().min(reach)]);
            let near = (reach == LEAST_KEPT).then(|| near_by(&self.tally.judge, a, b)).flatten();
            if let Some(piece) = near.or_else(|| next_common(a, b)) {
                return Ok(piece);
            }
            let is_all = (a.len(), b.len()) == (whole_a.len(), whole_b.len());
            if is_all && self.ended[0] && self.ended[1] {
                return Ok((a.len(), b.len()));
            }
            if reach >= MOST_KEPT {
                break;
            }
            reach *= 4;
        }
        let (a, b) = contiguous(&mut self.windows);
        if let Some(piece) = whole_paths(a, b) {
            return Ok(piece);
        }
        let (len_a, len_b) = (a.len(), b.len());
        let at = (a[0].number, b[0].number);
        if self.common.is_none() {
            self.common = Some(common_queries(self.files)?);
        }
        // In `common` the numbers of both files rise.
        let common = self.common.as_deref().unwrap_or(&[]);
        let next = common.partition_point(|&(a, b)| a < at.0 || b < at.1 || (a, b) == at);
        Ok(common.get(next).map_or((len_a, len_b), |&(next_a, next_b)| {
            let within = |next: u64, at: u64, len: usize| (next - at).min(len as u64) as usize;
            (within(next_a, at.0, len_a), within(next_b, at.1, len_b))
        }))
    }

    /// Counts the first queries of the windows, which differ as a whole, and drops them.
    fn pair_piece(&mut self, of_a: usize, of_b: usize) {
        let (a, b) = contiguous(&mut self.windows);
        self.tally.pair_up(&a[..of_a], &b[..of_b]);
        self.windows[0].drain(..of_a);
        self.windows[1].drain(..of_b);
    }

    /// What only the longer file has. It is read, too: damage there is no smaller an error.
    fn rest(self) -> Result<(), DiffError> {
        let Walk { readers: (mut a, mut b), windows: [kept_a, kept_b], tally, .. } = self;
        kept_a.iter().for_each(|kept| tally.missing(&kept.query()));
        kept_b.iter().for_each(|kept| tally.added(&kept.query()));
        for_each(&mut a, |query| tally.missing(query)).map_err(DiffError::A)?;
        for_each(&mut b, |query| tally.added(query)).map_err(DiffError::B)
    }
}

fn for_each(reader: &mut Reader, mut visit: impl FnMut(&Query)) -> Result<(), FormatError> {
    while reader.fill()? {
        let (number, count) = (reader.number(), reader.at_hand());
        if let Some((chunk, start)) = reader.chunk() {
            (0..count).for_each(|ahead| visit(&query(chunk, start + ahead, number + ahead as u64)));
        }
        reader.take(count);
    }
    Ok(())
}

fn contiguous(windows: &mut [VecDeque<Kept>; 2]) -> (&[Kept], &[Kept]) {
    let [a, b] = windows;
    (a.make_contiguous(), b.make_contiguous())
}

/// How many of the next `length` queries agree.
fn agreement(a: &Reader, b: &Reader, length: usize, tally: &mut Tally) -> usize {
    let (Some((chunk_a, start_a)), Some((chunk_b, start_b))) = (a.chunk(), b.chunk()) else { return 0 };
    let plain =
        chunk_a.info.scene == chunk_b.info.scene && chunk_a.rejects.is_empty() && chunk_b.rejects.is_empty();
    let mut agreed = 0;
    while agreed < length {
        let block = BLOCK.min(length - agreed);
        let records_a = &chunk_a.records[start_a + agreed..][..block];
        let records_b = &chunk_b.records[start_b + agreed..][..block];
        if plain && bytemuck::cast_slice::<_, u8>(records_a) == bytemuck::cast_slice::<_, u8>(records_b) {
            records_a.iter().for_each(|record| tally.agree(record));
            agreed += block;
            continue;
        }
        for _ in 0..block {
            let query_a = query(chunk_a, start_a + agreed, a.number() + agreed as u64);
            let query_b = query(chunk_b, start_b + agreed, b.number() + agreed as u64);
            match tally.judge.compare(&query_a, &query_b) {
                Relation::Changed(_) => return agreed,
                relation => tally.relate(&query_a, &query_b, relation),
            }
            agreed += 1;
        }
    }
    agreed
}

/// Where two windows go on together within their first queries.
fn near_by(judge: &Judge, a: &[Kept], b: &[Kept]) -> Option<(usize, usize)> {
    let both = |(i, j): (usize, usize)| Some((a.get(i)?.query(), b.get(j)?.query()));
    let same = |shift| both(shift).is_some_and(|(a, b)| judge.same_question(&a, &b));
    let agree = |shift| both(shift).is_some_and(|(a, b)| judge.agree(&a, &b));
    // From here on everything agrees for a while, or up to the common end of both files.
    let for_a_while = |(i, j): (usize, usize)| {
        let ends = |ahead| i + ahead >= a.len() && j + ahead >= b.len();
        (0..A_WHILE).all(|ahead| ends(ahead) || agree((i + ahead, j + ahead)))
    };
    let agreeing = || shifts(NEAR).find(|&shift| for_a_while(shift));
    if same((0, 0)) {
        // One query with another answer; unless the ray is asked again near by, and one of several was dropped.
        let is_repeated = (1..NEAR).any(|shift| same((shift, 0)) || same((0, shift)));
        return is_repeated.then(agreeing).flatten().or(Some((1, 1)));
    }
    agreeing().or_else(|| shifts(LEAST_KEPT).find(|&shift| same(shift)))
}

/// The next query that both windows have once, by the bits of its ray.
fn next_common(a: &[Kept], b: &[Kept]) -> Option<(usize, usize)> {
    let hashes =
        |window: &[Kept]| -> Vec<u64> { window.iter().map(|kept| question_hash(&kept.record)).collect() };
    common_in_order(&hashes(a), &hashes(b)).into_iter().find(|&place| place != (0, 0))
}

/// As much of both windows as ends before one pixel in both, and cuts no other pixel's queries in two.
fn whole_paths(a: &[Kept], b: &[Kept]) -> Option<(usize, usize)> {
    let cuts = |window: &[Kept]| -> HashMap<u32, usize> {
        let last: HashMap<u32, usize> =
            window.iter().enumerate().map(|(place, kept)| (kept.record.path, place)).collect();
        let mut open_until = 0;
        let mut cuts = HashMap::new();
        for (place, kept) in window.iter().enumerate() {
            let path = kept.record.path;
            if place > open_until && path != NO_PATH {
                cuts.insert(path, place);
            }
            open_until = open_until.max(last[&path]);
        }
        cuts
    };
    let (in_a, in_b) = (cuts(a), cuts(b));
    let both = |(path, &place): (&u32, &usize)| Some((place, *in_b.get(path)?));
    in_a.iter().filter_map(both).max()
}

/// Numbers of queries of two whole files that are one, of a few of them.
fn common_queries(files: [&Rays; 2]) -> Result<Vec<(u64, u64)>, DiffError> {
    let most = files[0].query_count().max(files[1].query_count());
    let share = most.div_ceil(MOST_SAMPLED).next_power_of_two();
    let sampled = |rays: &Rays| -> Result<(Vec<u64>, Vec<u64>), FormatError> {
        let first = rays.first_queries();
        let chunks = rays.map_chunks(|index, chunk| {
            let records = chunk.records.iter().enumerate();
            let hashed = records.map(|(place, record)| (question_hash(record), first[index] + place as u64));
            hashed.filter(|(hash, _)| hash % share == 0).collect::<Vec<_>>()
        })?;
        Ok(chunks.into_iter().flatten().unzip())
    };
    let (hashes_a, numbers_a) = sampled(files[0]).map_err(DiffError::A)?;
    let (hashes_b, numbers_b) = sampled(files[1]).map_err(DiffError::B)?;
    let common = common_in_order(&hashes_a, &hashes_b);
    Ok(common.into_iter().map(|(a, b)| (numbers_a[a], numbers_b[b])).collect())
}
