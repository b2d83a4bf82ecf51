//! Ambient occlusion: how much of the hemisphere over a surface is free up to a distance (Zhukov, Iones and Kronin 1998).

use crate::format::rays::Purpose;
use crate::geometry::Vec3;
use crate::render::path::camera_hits;
use crate::render::queries::{MAX_PACKET, RayQueries, query};
use crate::render::scenery::Scenery;
use crate::render::tiles::{PixelSample, first_dimension};

/// Free share of the hemisphere at each sample, cosine-weighted, by `rays` rays; `radiance` has one element a sample.
pub fn trace<Q: RayQueries>(
    scenery: &Scenery,
    rays: u32,
    samples: &[PixelSample],
    queries: &mut Q,
    radiance: &mut [Vec3],
) {
    let mut hits = [None; MAX_PACKET];
    let mut surfaces = Vec::with_capacity(MAX_PACKET);
    camera_hits(scenery, samples, queries, &mut hits, |_, _| ());
    for (index, (sample, hit)) in samples.iter().zip(&hits).enumerate() {
        let ray = scenery.camera.ray(sample.x, sample.y);
        radiance[index] = Vec3::ZERO;
        match hit {
            None => radiance[index] = Vec3::ONE,
            Some(met) => surfaces.push((index, scenery.surface(&ray, met))),
        }
    }
    let (mut asked, mut occluded) = (Vec::with_capacity(MAX_PACKET), [false; MAX_PACKET]);
    for number in 0..rays {
        asked.clear();
        asked.extend(surfaces.iter().map(|(index, surface)| {
            let sample = &samples[*index];
            let direction = surface.cosine_direction(sample.sampler.pair(first_dimension(1) + number));
            let ray = surface.ray(direction, scenery.ao_distance);
            query(ray, sample.path, 1, Purpose::AmbientOcclusion)
        }));
        match &asked[..] {
            [] => break,
            [one] => occluded[0] = queries.occluded(one),
            several => queries.occluded_packet(several, &mut occluded[..several.len()]),
        }
        for ((index, _), occluded) in surfaces.iter().zip(&occluded) {
            radiance[*index] += Vec3::splat(if *occluded { 0.0 } else { 1.0 / rays as f32 });
        }
    }
}
