//! Runs a job: threads take tile after tile, each asks its own intersector, and the film gets what they found.

use crate::embree::{EmbreeError, Hit, Intersector, Query, Scene, Stop};
use crate::geometry::Vec3;
use crate::progress::Progress;
use crate::record::Recorder;
use crate::render::film::Film;
use crate::render::job::{Integrator, Job};
use crate::render::queries::{Counting, MAX_PACKET, RayQueries, Tally};
use crate::render::scenery::Scenery;
use crate::render::shapes::Met;
use crate::render::tiles::{PixelSample, Tile, Tiles};
use crate::render::{ao, path, primary, shadow};
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicU64, Ordering};

/// What integrators may know of an answer.
fn met(hit: Hit) -> Met {
    Met { triangle: hit.triangle, part: hit.part }
}

impl RayQueries for Intersector<'_> {
    #[inline]
    fn closest_hit(&mut self, query: &Query) -> Option<Met> {
        Intersector::closest_hit(self, query).map(met)
    }

    #[inline]
    fn occluded(&mut self, query: &Query) -> bool {
        Intersector::occluded(self, query)
    }

    fn closest_hits(&mut self, queries: &[Query], hits: &mut [Option<Met>]) {
        let mut answers = [None; MAX_PACKET];
        for (queries, hits) in queries.chunks(MAX_PACKET).zip(hits.chunks_mut(MAX_PACKET)) {
            let answers = &mut answers[..queries.len()];
            Intersector::closest_hits(self, queries, answers);
            for (hit, answer) in hits.iter_mut().zip(answers) {
                *hit = answer.map(met);
            }
        }
    }

    fn occluded_packet(&mut self, queries: &[Query], occluded: &mut [bool]) {
        Intersector::occluded_packet(self, queries, occluded);
    }
}

/// What a job gave.
#[derive(Clone, Debug)]
pub struct Rendered {
    pub film: Film,
    pub tally: Tally,
    /// Queries that would have ended the process in Embree; answered as misses, and not recorded.
    pub refused: u64,
}

/// Renders, and records every query when there is a recorder; when that fails, tiles are missing, and
/// [`Recorder::finish`] says why. Film, tally and recording do not depend on the number of threads.
///
/// # Errors
/// When Embree has no memory for an intersector.
pub fn render(
    scene: &Scene,
    scenery: &Scenery,
    job: &Job,
    recorder: Option<&Recorder>,
    progress: &Progress,
) -> Result<Rendered, EmbreeError> {
    let tiles = Tiles::new(job);
    let next = AtomicU64::new(0);
    let shared =
        Mutex::new(Rendered { film: Film::new(job.width, job.height), tally: Tally::default(), refused: 0 });
    let work = || -> Result<(), EmbreeError> {
        let mut pixels = Vec::new();
        loop {
            // Units have to be opened in rising order: number and opening are one step.
            let (index, mut unit) = {
                let _opening = shared.lock().unwrap_or_else(PoisonError::into_inner);
                let index = next.fetch_add(1, Ordering::Relaxed);
                if index >= tiles.len() || recorder.is_some_and(Recorder::has_failed) {
                    return Ok(());
                }
                (index, recorder.map(|recorder| recorder.unit(index)))
            };
            let tile = tiles.tile(index);
            let mut intersector = match &mut unit {
                Some(unit) => scene.recording_intersector(unit)?,
                None => scene.intersector()?,
            };
            let mut counting = Counting { queries: &mut intersector, tally: Tally::default() };
            trace_tile(scenery, job, &tile, &mut counting, &mut pixels);
            let tally = counting.tally;
            // Why the sink stopped, its recorder knows; the loop asks it before the next tile.
            let _: Result<(), Stop> = intersector.flush();
            let refused = intersector.refused();
            drop(intersector);
            // The unit's last chunk may have to wait for its turn: not while holding the lock.
            drop(unit);
            let mut shared = shared.lock().unwrap_or_else(PoisonError::into_inner);
            shared.film.place(&tile, &pixels);
            shared.tally.add(&tally);
            shared.refused += refused;
            drop(shared);
            progress.advance(1);
        }
    };
    std::thread::scope(|scope| {
        let others: Vec<_> = (1..job.threads).map(|_| scope.spawn(work)).collect();
        let mut outcome = work();
        for other in others {
            match other.join() {
                Ok(theirs) => outcome = outcome.and(theirs),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        outcome
    })?;
    Ok(shared.into_inner().unwrap_or_else(PoisonError::into_inner))
}

/// All samples of a tile; `pixels` becomes the mean radiance of each of its pixels.
pub fn trace_tile<Q: RayQueries>(
    scenery: &Scenery,
    job: &Job,
    tile: &Tile,
    queries: &mut Q,
    pixels: &mut Vec<Vec3>,
) {
    pixels.clear();
    pixels.resize(tile.width as usize * tile.height as usize, Vec3::ZERO);
    let share = 1.0 / job.samples as f32;
    tile.for_each_group(job, |indices, samples| {
        let mut radiance = [Vec3::ZERO; MAX_PACKET];
        let radiance = &mut radiance[..samples.len()];
        trace_group(scenery, job, samples, queries, radiance);
        for (&index, radiance) in indices.iter().zip(radiance) {
            pixels[index] += *radiance * share;
        }
    });
}

fn trace_group<Q: RayQueries>(
    scenery: &Scenery,
    job: &Job,
    samples: &[PixelSample],
    queries: &mut Q,
    radiance: &mut [Vec3],
) {
    match job.integrator {
        Integrator::Path => path::trace(scenery, job.max_depth, samples, queries, radiance),
        Integrator::Ao => ao::trace(scenery, job.ao_rays, samples, queries, radiance),
        Integrator::Primary => primary::trace(scenery, samples, queries, radiance),
        Integrator::Shadow => shadow::trace(scenery, samples, queries, radiance),
    }
}
