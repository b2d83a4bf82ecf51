//! Two recordings as multisets of queries: what several threads asked, in whichever order.
//!
//! 1. Every query falls into one of [`BUCKETS`] by the bits of its ray; sums of hashes say which buckets are the same in both files.
//!    Those of two recordings of one run are, bit by bit, and one pass was all.
//! 2. The queries of the other buckets are sorted, a part of the buckets at a time, and those that agree go.
//! 3. What is left is read once more, sorted by pixel, depth, kind, purpose and ray, and [paired](super::pairing).
//!
//! Memory is bounded: by [`MOST_SORTED`] in the second step and [`MOST_LEFT`] in the third.

use super::path_set::PathSet;
use super::query::{COUNTED_FLAGS, Kept, Query, key, question_hash};
use super::reader::query;
use super::tally::Tally;
use super::{DiffError, FormatError, Tolerance};
use crate::format::rays::{Chunk, NO_PATH, Rays, Record, flag};
use crate::progress::Progress;
use std::cmp::Ordering;
use std::hash::Hasher;
use twox_hash::XxHash3_64;

const BUCKETS: usize = 1 << 16;

/// Queries of both files that are sorted at a time, 40 bytes each.
const MOST_SORTED: u64 = 6 << 20;

/// Queries of one file without an equal in the other that are paired; more of them are only counted.
const MOST_LEFT: usize = 1 << 20;

/// Compares every query of two files.
///
/// # Errors
/// When a chunk is damaged.
pub(super) fn compare(a: &Rays, b: &Rays, tally: &mut Tally, progress: &Progress) -> Result<(), DiffError> {
    let summed_a = sum(a, progress).map_err(DiffError::A)?;
    let summed_b = sum(b, &Progress::hidden()).map_err(DiffError::B)?;
    tally.see(summed_a.paths);
    tally.see(summed_b.paths);
    let differing: Vec<bool> =
        summed_a.buckets.iter().zip(&summed_b.buckets).map(|(one, other)| one != other).collect();
    let counts = summed_a.buckets.iter().zip(&summed_b.buckets).map(|(one, other)| one.count + other.count);
    let mut left = [Left::default(), Left::default()];
    for part in parts(&differing, &counts.collect::<Vec<u64>>()) {
        let chosen = |digest: &Digest| {
            let bucket = digest.bucket();
            part.buckets.contains(&bucket) && differing[bucket] && digest.whole % part.of == part.number
        };
        let sorted_a = sorted(a, chosen).map_err(DiffError::A)?;
        let sorted_b = sorted(b, chosen).map_err(DiffError::B)?;
        cancel(&sorted_a, &sorted_b, tally.answers(), &mut left);
    }
    let [left_a, left_b] = left;
    tally.only_counted(left_a.beyond, left_b.beyond);
    let kept_a = fetch(a, left_a.numbers).map_err(DiffError::A)?;
    let kept_b = fetch(b, left_b.numbers).map_err(DiffError::B)?;
    tally.pair_up(&kept_a, &kept_b);
    Ok(())
}

/// What a query is sorted by: hashes of what was asked, and the answer.
#[derive(Clone, Copy, Debug)]
struct Digest {
    /// Of the ray and of why it was asked.
    question: u64,
    /// Of all that counts.
    whole: u64,
    /// Of what is neither in `question` nor in the answer.
    rest: u32,
    triangle: u32,
    t: f32,
    u: f32,
    v: f32,
}

/// A digest, and the number of its query.
#[derive(Clone, Copy, Debug)]
struct Numbered {
    question: u64,
    number: u64,
    rest: u32,
    triangle: u32,
    t: f32,
    u: f32,
    v: f32,
}

impl Digest {
    fn new(query: &Query) -> Digest {
        let Record { tnear, tfar, time, mask, t, triangle, u, v, flags, .. } = *query.record;
        let mut hasher = XxHash3_64::new();
        hasher.write(bytemuck::bytes_of(&[tnear, tfar, time]));
        hasher.write(bytemuck::bytes_of(&mask));
        hasher.write(bytemuck::bytes_of(&query.scene));
        hasher.write(&[flags & (COUNTED_FLAGS | flag::HIT)]);
        query.rejects.iter().for_each(|reject| hasher.write(&reject.triangle.to_le_bytes()));
        let rest = hasher.finish();
        let question = question_hash(query.record);
        let mut hasher = XxHash3_64::with_seed(rest);
        hasher.write(&question.to_le_bytes());
        hasher.write(bytemuck::bytes_of(&[t.to_bits(), triangle, u.to_bits(), v.to_bits()]));
        Digest { question, whole: hasher.finish(), rest: rest as u32, triangle, t, u, v }
    }

    fn bucket(&self) -> usize {
        (self.question >> 48) as usize
    }

    fn numbered(self, number: u64) -> Numbered {
        let Digest { question, rest, triangle, t, u, v, .. } = self;
        Numbered { question, number, rest, triangle, t, u, v }
    }
}

impl Numbered {
    /// Rays in any order, then answers by their size: so those that are nearly equal stand at one place in both files.
    fn order(&self, other: &Numbered) -> Ordering {
        let integers = |of: &Numbered| (of.question, of.rest, of.triangle);
        let floats = [(self.t, other.t), (self.u, other.u), (self.v, other.v)];
        let by_floats = || floats.into_iter().map(|(a, b)| a.total_cmp(&b)).find(|order| order.is_ne());
        integers(self).cmp(&integers(other)).then_with(|| by_floats().unwrap_or(Ordering::Equal))
    }

    fn agrees(&self, other: &Numbered, answers: Tolerance) -> bool {
        (self.question, self.rest, self.triangle) == (other.question, other.rest, other.triangle)
            && answers.equal(self.t, other.t, 0.0)
            && answers.equal(self.u, other.u, 1.0)
            && answers.equal(self.v, other.v, 1.0)
    }
}

/// What does not depend on the order of a bucket's queries. Two sums of 64 bits: that other queries have both is as good as impossible.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Sums {
    count: u64,
    sum: u64,
    /// Of another hash.
    mixed: u64,
}

struct Summed {
    buckets: Vec<Sums>,
    paths: PathSet,
}

fn sum(rays: &Rays, progress: &Progress) -> Result<Summed, FormatError> {
    let none = || Summed { buckets: vec![Sums::default(); BUCKETS], paths: PathSet::default() };
    let add = |summed: &mut Summed, _, chunk: Chunk| {
        let mut last = NO_PATH;
        for place in 0..chunk.records.len() {
            let query = query(&chunk, place, 0);
            let digest = Digest::new(&query);
            let sums = &mut summed.buckets[digest.bucket()];
            sums.count += 1;
            sums.sum = sums.sum.wrapping_add(digest.whole);
            let mixed = (digest.whole ^ digest.whole >> 29).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            sums.mixed = sums.mixed.wrapping_add(mixed ^ mixed >> 32);
            if query.record.path != last && query.record.path != NO_PATH {
                last = query.record.path;
                summed.paths.insert(last);
            }
        }
        progress.advance(chunk.records.len() as u64);
    };
    let merge = |mut one: Summed, other: Summed| {
        for (sums, more) in one.buckets.iter_mut().zip(&other.buckets) {
            sums.count += more.count;
            sums.sum = sums.sum.wrapping_add(more.sum);
            sums.mixed = sums.mixed.wrapping_add(more.mixed);
        }
        one.paths.unite(other.paths);
        one
    };
    rays.fold_chunks(none, add, merge)
}

/// What is sorted at a time: some buckets, or a part of one that is too large (of a ray that is asked very often), parted by all that
/// counts.
struct Part {
    buckets: std::ops::Range<usize>,
    number: u64,
    of: u64,
}

fn parts(differing: &[bool], counts: &[u64]) -> Vec<Part> {
    let mut parts: Vec<Part> = Vec::new();
    let mut room = 0;
    for bucket in (0..BUCKETS).filter(|&bucket| differing[bucket]) {
        let count = counts[bucket];
        match parts.last_mut().filter(|_| count <= room) {
            Some(part) => part.buckets.end = bucket + 1,
            None => {
                let of = count.div_ceil(MOST_SORTED).max(1);
                let buckets = bucket..bucket + 1;
                parts.extend((0..of).map(|number| Part { buckets: buckets.clone(), number, of }));
                room = if of == 1 { MOST_SORTED } else { 0 };
            }
        }
        room = room.saturating_sub(count);
    }
    parts
}

fn sorted(rays: &Rays, chosen: impl Fn(&Digest) -> bool + Sync) -> Result<Vec<Numbered>, FormatError> {
    let first = rays.first_queries();
    let add = |numbered: &mut Vec<Numbered>, index: usize, chunk: Chunk| {
        let digests = (0..chunk.records.len()).map(|place| (place, Digest::new(&query(&chunk, place, 0))));
        let chosen = digests.filter(|(_, digest)| chosen(digest));
        numbered.extend(chosen.map(|(place, digest)| digest.numbered(first[index] + place as u64)));
    };
    let merge = |mut one: Vec<Numbered>, mut other: Vec<Numbered>| {
        one.append(&mut other);
        one
    };
    let mut numbered = rays.fold_chunks(Vec::new, add, merge)?;
    // Numbers make the order one whatever the threads.
    let order = |a: &Numbered, b: &Numbered| a.order(b).then(a.number.cmp(&b.number));
    rayon::slice::ParallelSliceMut::par_sort_unstable_by(&mut numbered[..], order);
    Ok(numbered)
}

/// Queries of one file without an equal in the other.
#[derive(Default)]
struct Left {
    numbers: Vec<u64>,
    /// How many there are beyond [`MOST_LEFT`].
    beyond: u64,
}

impl Left {
    fn add(&mut self, number: u64) {
        if self.numbers.len() < MOST_LEFT {
            self.numbers.push(number);
        } else {
            self.beyond += 1;
        }
    }
}

/// Goes through both in order, and leaves those that do not agree.
fn cancel(mut a: &[Numbered], mut b: &[Numbered], answers: Tolerance, left: &mut [Left; 2]) {
    while let (Some((first_a, rest_a)), Some((first_b, rest_b))) = (a.split_first(), b.split_first()) {
        if first_a.agrees(first_b, answers) {
            (a, b) = (rest_a, rest_b);
        } else if first_a.order(first_b).is_lt() {
            left[0].add(first_a.number);
            a = rest_a;
        } else {
            left[1].add(first_b.number);
            b = rest_b;
        }
    }
    a.iter().for_each(|numbered| left[0].add(numbered.number));
    b.iter().for_each(|numbered| left[1].add(numbered.number));
}

/// The queries of these numbers, sorted so that those that are nearly equal stand at one place in both files.
fn fetch(rays: &Rays, mut numbers: Vec<u64>) -> Result<Vec<Kept>, FormatError> {
    numbers.sort_unstable();
    let first = rays.first_queries();
    let add = |kept: &mut Vec<Kept>, index: usize, chunk: Chunk| {
        let (start, end) = (first[index], first[index] + chunk.records.len() as u64);
        let within = numbers.partition_point(|&n| n < start)..numbers.partition_point(|&n| n < end);
        kept.extend(numbers[within].iter().map(|&number| {
            let Query { number, scene, record, rejects } = query(&chunk, (number - start) as usize, number);
            Kept { number, scene, record: *record, rejects: rejects.into() }
        }));
    };
    let merge = |mut one: Vec<Kept>, mut other: Vec<Kept>| {
        one.append(&mut other);
        one
    };
    if numbers.is_empty() {
        return Ok(Vec::new());
    }
    let mut kept = rays.fold_chunks(Vec::new, add, merge)?;
    let place = |kept: &Kept| (kept.record.path, key(&kept.record));
    kept.sort_by(|a, b| {
        let by_ray = || projection(&a.record).total_cmp(&projection(&b.record));
        place(a).cmp(&place(b)).then_with(by_ray).then(a.number.cmp(&b.number))
    });
    Ok(kept)
}

/// A number that is nearly equal for rays that are, and hardly for others.
fn projection(record: &Record) -> f64 {
    let (origin, direction) = (record.origin.as_dvec3(), record.direction.as_dvec3());
    origin.dot(glam::DVec3::new(0.8227, 0.4513, 0.3461))
        + direction.dot(glam::DVec3::new(0.2871, 0.6389, 0.7137))
}
