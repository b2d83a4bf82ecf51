//! Path tracing with next event estimation (Kajiya 1986; Veach and Guibas 1995 for the weights).
//!
//! At every surface one shadow ray goes to a light, and one ray goes on: a mirror reflection or a diffuse one, by their
//! reflectances. Light that either way can find is weighed by the balance heuristic. There is no Russian roulette: a path ends at its
//! depth, in the open, or on black.
//!
//! A packet's paths walk in step, so that their camera rays and their first shadow rays can be asked together; paths of
//! one go the same way, query by query.

use crate::embree::Query;
use crate::format::rays::Purpose;
use crate::geometry::{Ray, Vec3};
use crate::render::queries::{MAX_PACKET, RayQueries, query};
use crate::render::scenery::Scenery;
use crate::render::shapes::Met;
use crate::render::surface::Surface;
use crate::render::tiles::{PixelSample, first_dimension};
use std::f32::consts::PI;

/// Shadow rays end this share of the way before the light, so as not to meet it.
pub(super) const BEFORE_LIGHT: f32 = 1.0 - 1.0 / 8192.0;

/// A path under way.
#[derive(Clone, Copy)]
struct Walk {
    alive: bool,
    ray: Ray,
    /// What the ray met, once it has arrived; no matter when the walk has ended.
    surface: Option<Surface>,
    throughput: Vec3,
    /// Density per solid angle with which the ray's direction was chosen; infinite for camera and mirror rays.
    density: f32,
}

/// Radiance along the samples' camera rays; `radiance` has one element a sample.
pub fn trace<Q: RayQueries>(
    scenery: &Scenery,
    max_depth: u8,
    samples: &[PixelSample],
    queries: &mut Q,
    radiance: &mut [Vec3],
) {
    let count = samples.len().min(MAX_PACKET);
    let walk =
        Walk { alive: true, ray: UNASKED.ray, surface: None, throughput: Vec3::ONE, density: f32::INFINITY };
    let (mut walks, mut hits) = ([walk; MAX_PACKET], [None; MAX_PACKET]);
    camera_hits(scenery, samples, queries, &mut hits, |index, ray| walks[index].ray = ray);
    let walks = &mut walks[..count];
    for ((walk, met), radiance) in walks.iter_mut().zip(&hits).zip(radiance.iter_mut()) {
        *radiance = arrive(scenery, walk, met.as_ref());
    }
    for depth in 1..=max_depth {
        if !walks.iter().any(|walk| walk.alive) {
            break;
        }
        // What a shadow ray would bring, and who asks.
        let mut shadows = [UNASKED; MAX_PACKET];
        let mut brings = [(0, Vec3::ZERO); MAX_PACKET];
        let mut asked = 0;
        for (index, walk) in walks.iter_mut().enumerate() {
            let Some(surface) = walk.surface.filter(|_| walk.alive) else { continue };
            if let Some((ray, light)) = light_ray(scenery, &samples[index], walk, &surface, depth) {
                shadows[asked] = query(ray, samples[index].path, depth, Purpose::Shadow);
                brings[asked] = (index, light);
                asked += 1;
            }
        }
        let mut occluded = [false; MAX_PACKET];
        if asked > 1 && depth == 1 {
            queries.occluded_packet(&shadows[..asked], &mut occluded[..asked]);
        } else {
            for (query, occluded) in shadows[..asked].iter().zip(&mut occluded) {
                *occluded = queries.occluded(query);
            }
        }
        for (&(index, light), _) in brings[..asked].iter().zip(&occluded).filter(|(_, occluded)| !**occluded)
        {
            radiance[index] += light;
        }
        for (index, walk) in walks.iter_mut().enumerate().filter(|(_, walk)| walk.alive) {
            let purpose = bounce(scenery, &samples[index], walk, depth);
            if walk.alive {
                let met = queries.closest_hit(&query(walk.ray, samples[index].path, depth, purpose));
                radiance[index] += arrive(scenery, walk, met.as_ref());
            }
        }
    }
    for radiance in radiance {
        if !radiance.is_finite() {
            *radiance = Vec3::ZERO;
        }
    }
}

const UNASKED: Query = Query {
    ray: Ray { origin: Vec3::ZERO, tnear: 0.0, direction: Vec3::ZERO, tfar: 0.0 },
    time: 0.0,
    mask: 0,
    path: 0,
    depth: 0,
    purpose: Purpose::Unknown,
    coherent: false,
};

/// The camera rays of a group and what they hit: one packet, or a single query.
pub(super) fn camera_hits<Q: RayQueries>(
    scenery: &Scenery,
    samples: &[PixelSample],
    queries: &mut Q,
    hits: &mut [Option<Met>; MAX_PACKET],
    mut keep: impl FnMut(usize, Ray),
) {
    let mut asked = [UNASKED; MAX_PACKET];
    let count = samples.len().min(MAX_PACKET);
    for (index, sample) in samples[..count].iter().enumerate() {
        let ray = scenery.camera.ray(sample.x, sample.y);
        keep(index, ray);
        asked[index] = query(ray, sample.path, 0, Purpose::Camera);
    }
    if count == 1 {
        hits[0] = queries.closest_hit(&asked[0]);
    } else {
        queries.closest_hits(&asked[..count], &mut hits[..count]);
    }
}

/// Takes a walk to what its ray met. Returns the light that the ray brings by itself: the
/// background's, or what the surface emits. Ends the walk where nothing scatters.
fn arrive(scenery: &Scenery, walk: &mut Walk, met: Option<&Met>) -> Vec3 {
    let Some(met) = met else {
        walk.alive = false;
        return walk.throughput * scenery.lights.background(walk.ray.direction);
    };
    let surface = scenery.surface(&walk.ray, met);
    walk.surface = Some(surface);
    let appearance = scenery.appearance(surface.part);
    walk.alive = appearance.scatters();
    if appearance.emission == Vec3::ZERO {
        return Vec3::ZERO;
    }
    let mut weight = 1.0;
    if walk.density.is_finite() {
        // Directions have length 1, so t is the distance.
        let cosine = surface.normal.dot(walk.ray.direction).abs();
        let by_light = scenery.lights.emitter_density(appearance.emission, surface.distance, cosine);
        weight = walk.density / (walk.density + by_light);
    }
    walk.throughput * appearance.emission * weight
}

/// The shadow ray of a surface, and the light that arrives if nothing is in its way.
fn light_ray(
    scenery: &Scenery,
    sample: &PixelSample,
    walk: &Walk,
    surface: &Surface,
    depth: u8,
) -> Option<(Ray, Vec3)> {
    let appearance = scenery.appearance(surface.part);
    if appearance.diffuse == Vec3::ZERO {
        return None;
    }
    let dimension = first_dimension(depth);
    let light = scenery.lights.sample(
        surface.origin,
        sample.sampler.single(dimension),
        sample.sampler.pair(dimension + 1),
    )?;
    let cosine = surface.normal.dot(light.direction);
    if cosine <= 0.0 {
        return None;
    }
    let by_bounce = if light.can_be_hit { (1.0 - appearance.specular_share) * cosine / PI } else { 0.0 };
    let reflected = appearance.diffuse / PI * cosine;
    let brings = walk.throughput * reflected * light.radiance / (light.density + by_bounce);
    Some((surface.ray(light.direction, light.distance * BEFORE_LIGHT), brings))
}

/// Sends a walk on from the surface that it hit.
fn bounce(scenery: &Scenery, sample: &PixelSample, walk: &mut Walk, depth: u8) -> Purpose {
    let Some(surface) = walk.surface else {
        walk.alive = false;
        return Purpose::Unknown;
    };
    let appearance = scenery.appearance(surface.part);
    let dimension = first_dimension(depth) + 2;
    let share = appearance.specular_share;
    let is_mirror = share > 0.0 && sample.sampler.single(dimension) < share;
    let direction = if is_mirror {
        walk.throughput *= appearance.specular / share;
        walk.density = f32::INFINITY;
        surface.mirror_direction(walk.ray.direction)
    } else {
        walk.throughput *= appearance.diffuse / (1.0 - share);
        let direction = surface.cosine_direction(sample.sampler.pair(dimension + 1));
        walk.density = (1.0 - share) * surface.normal.dot(direction).max(0.0) / PI;
        direction
    };
    walk.alive = walk.throughput.max_element() > 0.0;
    walk.ray = surface.ray(direction, f32::INFINITY);
    if is_mirror { Purpose::Specular } else { Purpose::Diffuse }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Material;
    use crate::render::job::{Job, tests::job};
    use crate::render::testing::{cube, emitter, image, mean, mesh, quad};

    /// In a closed box whose walls emit E and reflect ρ, every ray sees E (1 + ρ + ρ² + …), cut off after `max_depth` terms.
    #[test]
    fn furnace_has_the_analytic_radiance() {
        for (reflectance, max_depth, packet) in [(0.5, 1, 1), (0.5, 4, 1), (0.8, 3, 4), (0.0, 4, 1)] {
            let mesh = mesh(&[(&cube(2.0), emitter(1.5, reflectance))]);
            let job = Job { samples: 64, max_depth, packet, ..job() };
            let (pixels, _) = image(&mesh, &job, Vec3::new(1.0, 1.0, 0.3), Vec3::new(1.1, 0.9, 2.0));
            let expected: f32 = (0..=max_depth).map(|n| 1.5 * reflectance.powi(i32::from(n))).sum();
            let found = mean(&pixels);
            assert!((found / expected - 1.0).abs() < 0.01, "{reflectance} {max_depth}: {found}, {expected}");
        }
    }

    /// The same with walls that are half mirrors.
    #[test]
    fn mirrors_keep_energy() {
        let material = Material { specular: Vec3::splat(0.3), ..emitter(1.0, 0.3) };
        let mesh = mesh(&[(&cube(2.0), material)]);
        let job = Job { samples: 64, max_depth: 3, ..job() };
        let (pixels, queries) = image(&mesh, &job, Vec3::new(1.0, 1.0, 0.3), Vec3::new(1.1, 0.9, 2.0));
        let expected = 1.0 + 0.6 + 0.36 + 0.216;
        assert!((mean(&pixels) / expected - 1.0).abs() < 0.01, "{}", mean(&pixels));
        let count = |purpose| queries.asked.iter().filter(|(query, _)| query.purpose == purpose).count();
        let ratio = count(Purpose::Specular) as f32 / count(Purpose::Diffuse) as f32;
        assert!((0.9..1.1).contains(&ratio), "{ratio}");
    }

    /// A small lamp over a floor: radiance = ρ/π · E · A cos² / d².
    #[test]
    fn small_light_matches_the_form_factor() {
        let side = 0.02;
        let lamp = quad(Vec3::new(-side / 2.0, 2.0, -side / 2.0), Vec3::X * side, Vec3::Z * side);
        let floor = quad(Vec3::new(-9.0, 0.0, -9.0), Vec3::X * 18.0, Vec3::Z * 18.0);
        let matt = Material { diffuse: Vec3::splat(0.7), ..Material::default() };
        let mesh = mesh(&[(&[floor], matt), (&[lamp], emitter(1000.0, 0.0))]);
        // Looks at the point (1, 0, 0): d² = 5, both cosines 2/√5.
        let job = Job { width: 1, height: 1, samples: 64, max_depth: 2, ..job() };
        let mut queries = crate::render::testing::BruteForce::new(&mesh);
        let wishes = crate::render::scenery::Wishes {
            eye_and_target: Some((Vec3::new(1.0, 3.0, 3.0), Vec3::new(1.0, 0.0, 0.0))),
            up: Some(Vec3::Y),
            fov_degrees: Some(0.1),
        };
        let scenery = Scenery::new(&mesh, mesh.triangles(), &mut queries, &wishes, [1, 1]).unwrap();
        let mut pixels = Vec::new();
        let tile = crate::render::tiles::Tiles::new(&job).tile(0);
        crate::render::workers::trace_tile(&scenery, &job, &tile, &mut queries, &mut pixels);
        let expected = 0.7 / PI * 1000.0 * side * side * (4.0 / 5.0) / 5.0;
        assert!((pixels[0].y / expected - 1.0).abs() < 5e-3, "{} {expected}", pixels[0].y);
    }

    /// Depth counts surfaces met before; camera rays alone are coherent; nothing goes deeper than asked; packets ask the same.
    #[test]
    fn queries_say_what_they_are_for() {
        let mesh = mesh(&[(&cube(2.0), emitter(1.0, 0.5))]);
        let ask = |packet| {
            let job = Job { samples: 1, max_depth: 3, packet, ..job() };
            image(&mesh, &job, Vec3::new(1.0, 1.0, 0.3), Vec3::new(1.1, 0.9, 2.0))
        };
        let (pixels, queries) = ask(1);
        for (query, is_occlusion) in &queries.asked {
            assert_eq!(query.purpose == Purpose::Camera, query.depth == 0);
            assert_eq!(query.coherent, query.depth == 0);
            assert_eq!(query.purpose == Purpose::Shadow, *is_occlusion);
            assert!(query.depth <= 3 && query.path < 64);
        }
        let count = |purpose| queries.asked.iter().filter(|(query, _)| query.purpose == purpose).count();
        assert_eq!((count(Purpose::Camera), count(Purpose::Diffuse)), (64, 64 * 3));
        // A light on the wall itself is not asked for: a sixth of them.
        assert!((140..190).contains(&count(Purpose::Shadow)), "{}", count(Purpose::Shadow));
        for packet in [4, 8, 16] {
            let (same, others) = ask(packet);
            let key = |(query, occlusion): &(Query, bool)| {
                (query.path, query.depth, *occlusion, query.ray.direction.to_array().map(f32::to_bits))
            };
            let sorted = |mut asked: Vec<(Query, bool)>| {
                asked.sort_by_key(key);
                asked
            };
            assert_eq!(sorted(queries.asked.clone()), sorted(others.asked));
            assert_eq!(pixels, same);
        }
    }
}
