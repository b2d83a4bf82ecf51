//! Camera rays only, shaded as if a lamp stood beside the camera.

use crate::geometry::Vec3;
use crate::render::path::camera_hits;
use crate::render::queries::{MAX_PACKET, RayQueries};
use crate::render::scenery::Scenery;
use crate::render::tiles::PixelSample;

/// Radiance along the samples' camera rays; `radiance` has one element a sample.
pub fn trace<Q: RayQueries>(
    scenery: &Scenery,
    samples: &[PixelSample],
    queries: &mut Q,
    radiance: &mut [Vec3],
) {
    let mut hits = [None; MAX_PACKET];
    camera_hits(scenery, samples, queries, &mut hits, |_, _| ());
    for ((sample, hit), radiance) in samples.iter().zip(&hits).zip(radiance) {
        let ray = scenery.camera.ray(sample.x, sample.y);
        *radiance = match hit {
            None => scenery.lights.background(ray.direction),
            Some(met) => {
                let appearance = scenery.appearance(met.part);
                let facing = -scenery.surface(&ray, met).normal.dot(ray.direction);
                appearance.emission + (appearance.diffuse + appearance.specular) * facing
            }
        };
    }
}
