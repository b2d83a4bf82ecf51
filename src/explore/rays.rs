//! Recorded queries to draw: a choice of their segments, and everything that was asked for one pixel.

use super::queries::{Asked, Sampled, Source};
use crate::format::FormatError;
use crate::format::rays::{NO_PATH, Purpose, Rays, Record, Reject};
use crate::geometry::{Aabb, Ray, Vec3};
use crate::progress::Progress;
use crate::replay::query::{Choice, Query};
use crate::training::even;
use crate::traverse::{Counts, Recorded, Scratch};
use rayon::prelude::*;
use std::ops::RangeInclusive;

/// A query that is kept after its chunk is gone.
#[derive(Clone, Debug, PartialEq)]
pub struct Kept {
    /// Of the query in the file.
    pub number: u64,
    pub record: Record,
    /// As it is asked again.
    pub ray: Ray,
    pub rejects: Box<[Reject]>,
}

impl From<&Query<'_>> for Kept {
    fn from(query: &Query) -> Kept {
        let Query { number, record, ray, candidates } = query;
        Kept { number: *number, record: **record, ray: *ray, rejects: candidates.rejects.into() }
    }
}

impl From<Record> for Kept {
    /// A query that stands in no file, such as [`super::steps::question`].
    fn from(record: Record) -> Kept {
        Kept { number: u64::MAX, record, ray: record.ray(), rejects: Box::default() }
    }
}

impl Kept {
    pub fn query(&self) -> Query<'_> {
        let candidates = Recorded { mask: self.record.mask, rejects: &self.rejects };
        Query { number: self.number, record: &self.record, ray: self.ray, candidates }
    }

    /// Where the ray ends that a closest-hit query found something with.
    pub fn hit_point(&self) -> Option<Vec3> {
        let is_closest = self.record.is_hit() && !self.record.is_occlusion();
        is_closest.then(|| self.record.ray().at(self.record.t))
    }
}

/// Query `number` of the file; none when there are fewer, or it is not of the scene that is chosen.
///
/// # Errors
/// When its chunk is damaged.
pub fn fetch(rays: &Rays, choice: &Choice, number: u64) -> Result<Option<Kept>, FormatError> {
    let firsts = rays.first_queries();
    let Some(index) = firsts.partition_point(|&first| first <= number).checked_sub(1) else {
        return Ok(None);
    };
    let chunk = rays.chunk(index)?;
    if number - firsts[index] >= chunk.records.len() as u64 || chunk.info.scene != choice.scene {
        return Ok(None);
    }
    Ok(choice.query(&chunk, firsts[index], number).as_ref().map(Kept::from))
}

/// Which segments are wanted, beside what the [`Source`]'s filter says of purpose, kind, depth and pixel.
#[derive(Clone, Debug)]
pub struct Wanted<'a> {
    /// Only those that hit something, or only those that do not.
    pub hit: Option<bool>,
    /// Only those whose cost over this tree, in nanoseconds, is within the range; without, queries
    /// are not asked, and have no cost.
    pub cost: Option<(Asked<'a>, RangeInclusive<f64>)>,
    /// One of so many, at least 1: spread over the file, not in step with its rows.
    pub every: u64,
    /// At most so many.
    pub most: usize,
}

/// An effective segment, as recorded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Of the query in the file.
    pub query: u64,
    pub from: Vec3,
    pub to: Vec3,
    pub purpose: Purpose,
    pub depth: u8,
    pub is_occlusion: bool,
    pub hit: bool,
    /// Whether it goes on behind `to`, which then lies beyond the scene.
    pub goes_on: bool,
    /// In nanoseconds; NaN when it was not asked for.
    pub cost: f32,
}

impl Segment {
    /// Of a record in a scene within `bounds`; none for a ray without a place or an interval.
    pub fn of(number: u64, record: &Record, bounds: &Aabb) -> Option<Segment> {
        let ray = record.effective_segment();
        let length = ray.direction.length();
        // Far enough to have left the scene, from wherever it comes.
        let reach = ray.origin.distance(bounds.center()) + 0.5 * bounds.extent().length();
        let beyond = if bounds.is_empty() { f32::MAX } else { reach / length };
        let end = ray.tfar.min(beyond.max(ray.tnear));
        let (from, to) = (ray.at(ray.tnear), ray.at(end));
        (from.is_finite() && to.is_finite() && ray.tnear <= end).then_some(Segment {
            query: number,
            from,
            to,
            purpose: Purpose::from_byte(record.purpose),
            depth: record.depth,
            is_occlusion: record.is_occlusion(),
            hit: record.is_hit(),
            goes_on: ray.tfar > end,
            cost: f32::NAN,
        })
    }
}

/// Segments to draw, and of how many.
#[derive(Clone, Debug)]
pub struct Segments {
    /// In the order of the file.
    pub list: Vec<Segment>,
    /// How many fit what is wanted, of those that were looked at; `list` has no more than was allowed.
    pub matched: u64,
    pub sampled: Sampled,
}

/// The segments of `source` that are `wanted`; `bounds` are the scene's.
///
/// # Errors
/// When a chunk is damaged.
pub fn segments(
    source: &Source,
    wanted: &Wanted,
    bounds: &Aabb,
    progress: &Progress,
) -> Result<Segments, FormatError> {
    let limit = source.limit.min(source.rays.query_count().div_ceil(wanted.every.max(1)));
    let source = Source { limit, ..source.clone() };
    let new = || (Vec::new(), Scratch::default());
    let (gathered, sampled) = source.gather(progress, new, |(list, scratch), query| {
        if wanted.hit.is_some_and(|hit| hit != query.record.is_hit()) {
            return;
        }
        let Some(mut segment) = Segment::of(query.number, query.record, bounds) else { return };
        if let Some((asked, range)) = &wanted.cost {
            let mut counts = Counts::default();
            asked.ask(query, &mut counts, scratch);
            let cost = asked.price.cost(query.record.is_occlusion(), 1, counts);
            if !range.contains(&cost) {
                return;
            }
            segment.cost = cost as f32;
        }
        list.push(segment);
    })?;
    let mut list: Vec<Segment> = gathered.into_iter().flat_map(|(list, _)| list).collect();
    list.sort_unstable_by_key(|segment| segment.query);
    Ok(Segments { matched: list.len() as u64, list: even(&list, wanted.most), sampled })
}

/// Pixels that share an entry of a [`PixelIndex`].
const BLOCK: u32 = 64;

/// Which chunks have queries of which pixels, so that those of one are found without reading all. Takes a few kilobytes a chunk.
#[derive(Clone, Debug)]
pub struct PixelIndex {
    /// Of each chunk, its blocks of pixels, ascending.
    blocks: Vec<Box<[u32]>>,
}

impl PixelIndex {
    /// Reads the whole recording once; `progress` advances by every query. Stopped, it knows only of what was read.
    ///
    /// # Errors
    /// When a chunk is damaged.
    pub fn of(rays: &Rays, progress: &Progress) -> Result<PixelIndex, FormatError> {
        let blocks = (0..rays.chunks().len()).into_par_iter().map(|index| {
            if progress.is_stopped() {
                return Ok(Box::default());
            }
            let chunk = rays.chunk(index)?;
            let known = chunk.records.iter().filter(|record| record.path != NO_PATH);
            let mut blocks: Vec<u32> = known.map(|record| record.path / BLOCK).collect();
            blocks.dedup();
            blocks.sort_unstable();
            blocks.dedup();
            progress.advance(chunk.records.len() as u64);
            Ok(blocks.into_boxed_slice())
        });
        Ok(PixelIndex { blocks: blocks.collect::<Result<_, FormatError>>()? })
    }

    /// The queries of pixel `path`, y * width + x, that `choice` takes, as they were asked: thread by thread, in order.
    ///
    /// # Errors
    /// When a chunk is damaged.
    pub fn queries(&self, rays: &Rays, choice: &Choice, path: u32) -> Result<Vec<Kept>, FormatError> {
        let firsts = rays.first_queries();
        let has = |index: &usize| self.blocks[*index].binary_search(&(path / BLOCK)).is_ok();
        let mut found = Vec::new();
        for index in (0..self.blocks.len().min(firsts.len())).filter(has) {
            let chunk = rays.chunk(index)?;
            if chunk.info.scene != choice.scene {
                continue;
            }
            for (place, _) in chunk.records.iter().enumerate().filter(|(_, record)| record.path == path) {
                if let Some(query) = choice.query(&chunk, firsts[index], firsts[index] + place as u64) {
                    found.push((chunk.info.thread, chunk.info.sequence + place as u64, Kept::from(&query)));
                }
            }
        }
        found.sort_by_key(|(thread, sequence, _)| (*thread, *sequence));
        Ok(found.into_iter().map(|(.., kept)| kept).collect())
    }
}

/// A query may begin this far from the hit that it comes from, relative to the size of the coordinates and the way to it: programs move origins
/// off the surface.
const OFFSET: f32 = 1e-3;

/// For each of a pixel's queries, in the order in which they were asked, the one that it comes from: the closest-hit query one bounce before, earlier
/// in the list, whose hit it begins nearest to. None for camera rays, and where no hit is near.
pub fn origins(queries: &[Kept]) -> Vec<Option<usize>> {
    let comes_from = |(place, query): (usize, &Kept)| {
        let near = |(index, other): (usize, &Kept)| {
            let point = other
                .hit_point()
                .filter(|_| other.record.depth.checked_add(1) == Some(query.record.depth))?;
            let distance = point.distance(query.record.origin);
            let scale = point.abs().max_element() + point.distance(other.record.origin);
            (distance <= OFFSET * scale).then_some((index, distance))
        };
        let all = queries[..place].iter().enumerate().filter_map(near);
        all.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(index, _)| index)
    };
    queries.iter().enumerate().map(comes_from).collect()
}
