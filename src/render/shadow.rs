//! Direct light: a camera ray and one shadow ray, to a light or, where there is one, to the sky.

use crate::format::rays::Purpose;
use crate::geometry::Vec3;
use crate::render::path::{BEFORE_LIGHT, camera_hits};
use crate::render::queries::{MAX_PACKET, RayQueries, query};
use crate::render::scenery::Scenery;
use crate::render::surface::Surface;
use crate::render::tiles::{PixelSample, first_dimension};
use std::f32::consts::PI;

/// Radiance along the samples' camera rays; `radiance` has one element a sample.
pub fn trace<Q: RayQueries>(
    scenery: &Scenery,
    samples: &[PixelSample],
    queries: &mut Q,
    radiance: &mut [Vec3],
) {
    let mut hits = [None; MAX_PACKET];
    camera_hits(scenery, samples, queries, &mut hits, |_, _| ());
    let (mut asked, mut brings) = (Vec::with_capacity(MAX_PACKET), Vec::with_capacity(MAX_PACKET));
    for (index, (sample, hit)) in samples.iter().zip(&hits).enumerate() {
        let ray = scenery.camera.ray(sample.x, sample.y);
        let Some(met) = hit else {
            radiance[index] = scenery.lights.background(ray.direction);
            continue;
        };
        let appearance = scenery.appearance(met.part);
        radiance[index] = appearance.emission;
        // What mirrors show is not computed here: they look matt.
        let reflectance = appearance.diffuse + appearance.specular;
        let surface = scenery.surface(&ray, met);
        if let Some((direction, distance, irradiance)) = incoming(scenery, sample, &surface) {
            let ray = surface.ray(direction, distance * BEFORE_LIGHT);
            asked.push(query(ray, sample.path, 1, Purpose::Shadow));
            brings.push((index, reflectance / PI * irradiance));
        }
    }
    let mut occluded = [false; MAX_PACKET];
    match &asked[..] {
        [] => {}
        [one] => occluded[0] = queries.occluded(one),
        several => queries.occluded_packet(several, &mut occluded[..several.len()]),
    }
    for ((index, light), _) in brings.iter().zip(&occluded).filter(|(_, occluded)| !**occluded) {
        radiance[*index] += *light;
    }
}

/// A direction from which light may come, how far its source is, and the irradiance if nothing is in the way.
fn incoming(scenery: &Scenery, sample: &PixelSample, surface: &Surface) -> Option<(Vec3, f32, Vec3)> {
    let dimension = first_dimension(1);
    let mut choice = sample.sampler.single(dimension);
    let square = sample.sampler.pair(dimension + 1);
    let mut probability = 1.0;
    if scenery.lights.has_sky() {
        probability = 0.5;
        if choice < 0.5 {
            let direction = surface.cosine_direction(square);
            // Density cos/π: the cosine of the irradiance cancels.
            let irradiance = scenery.lights.background(direction) * PI / probability;
            return Some((direction, f32::INFINITY, irradiance));
        }
        choice = 2.0 * choice - 1.0;
    }
    let light = scenery.lights.sample(surface.origin, choice, square)?;
    let cosine = surface.normal.dot(light.direction);
    (cosine > 0.0).then_some((
        light.direction,
        light.distance,
        light.radiance * cosine / (light.density * probability),
    ))
}
