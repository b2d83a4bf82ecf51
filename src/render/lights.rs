//! Where light comes from: emitting triangles when the scene has any, otherwise a sky, a sun and, indoors, a panel under
//! the ceiling.
//!
//! Emitters, sun and panel are sampled with shadow rays; the sky is found by bounces that leave the scene. Only emitters can
//! also be met by a bounce: the path integrator weighs the two ways against each other ([`Lights::emitter_density`]).

use crate::geometry::{DVec3, Triangle, Vec3};
use crate::mesh::Mesh;
use crate::render::film::luminance;
use crate::render::surface::Appearance;
use std::f32::consts::TAU;

/// Cosine of the half angle of the sun's disc: 1 degree, four times the real one, for shadows that show as soft.
const SUN_COSINE: f32 = 0.999_847_7;
/// Irradiance of the sun on a surface that faces it; the sky above gives about 2.
const SUN_IRRADIANCE: Vec3 = Vec3::new(5.0, 4.6, 4.0);
const ZENITH: Vec3 = Vec3::new(0.35, 0.55, 0.95);
const HORIZON: Vec3 = Vec3::new(0.85, 0.90, 0.95);
const GROUND: Vec3 = Vec3::new(0.30, 0.28, 0.25);
const PANEL_RADIANCE: Vec3 = Vec3::new(12.0, 11.4, 10.2);
/// Share of shadow rays that go to the sun where there is also a panel: it shines in only through windows.
const SUN_SHARE_INDOORS: f32 = 0.125;

/// The direction of length 1 from `from` to `to`, and how far that is.
fn towards(to: DVec3, from: Vec3) -> (Vec3, f32) {
    let way = to - from.as_dvec3();
    let distance = way.length();
    ((way / distance).as_vec3(), distance as f32)
}

/// A rectangle that shines to the side of `edges[0]` × `edges[1]`. Rays do not meet it: it is no part of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Panel {
    pub corner: Vec3,
    pub edges: [Vec3; 2],
}

/// A gradient from the zenith to the horizon, and another colour below; and the sun in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sky {
    /// Length 1.
    pub up: Vec3,
    /// Towards the sun, length 1.
    pub sun: Vec3,
}

impl Sky {
    /// Radiance from a direction, without the sun.
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let height = direction.dot(self.up).clamp(-1.0, 1.0);
        if height < 0.0 {
            // Falls off fast below the horizon, without an edge.
            return GROUND + (HORIZON - GROUND) * (1.0 + height).powi(16);
        }
        ZENITH + (HORIZON - ZENITH) * (1.0 - height).powi(3)
    }
}

/// A direction in which light may come, and how much.
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Length 1.
    pub direction: Vec3,
    /// Infinite for the sun.
    pub distance: f32,
    pub radiance: Vec3,
    /// Density per solid angle with which [`Lights::sample`] chooses this direction.
    pub density: f32,
    /// Whether a bounce can find the same light.
    pub can_be_hit: bool,
}

/// All lights of a scene.
#[derive(Clone, Debug, Default)]
pub struct Lights {
    emitters: Vec<Emitter>,
    /// Sum of power over the emitters up to and including each.
    cumulative: Vec<f64>,
    sky: Option<Sky>,
    panel: Option<Panel>,
}

#[derive(Clone, Copy, Debug)]
struct Emitter {
    triangle: Triangle,
    emission: Vec3,
}

impl Lights {
    /// The emitting triangles of a mesh; no lights at all when no part emits. `triangles` are the mesh's, in its order.
    pub fn from_emission(mesh: &Mesh, triangles: &[Triangle], appearances: &[Appearance]) -> Lights {
        let mut lights = Lights::default();
        let mut power = 0.0;
        let mut rest = triangles;
        for (part, appearance) in mesh.parts.iter().zip(appearances) {
            let count = part.triangle_count();
            let (own, behind) = rest.split_at(count.min(rest.len()));
            rest = behind;
            if appearance.emission == Vec3::ZERO {
                continue;
            }
            for &triangle in own {
                let area = 0.5 * f64::from(triangle.scaled_normal().length());
                let share = area * f64::from(luminance(appearance.emission));
                if share.is_finite() && share > 0.0 {
                    power += share;
                    lights.emitters.push(Emitter { triangle, emission: appearance.emission });
                    lights.cumulative.push(power);
                }
            }
        }
        lights
    }

    /// A sky with its sun, and a panel where there is a ceiling.
    pub fn from_sky(sky: Sky, panel: Option<Panel>) -> Lights {
        Lights { sky: Some(sky), panel, ..Lights::default() }
    }

    /// Whether the scene brings its own light.
    pub fn has_emitters(&self) -> bool {
        !self.emitters.is_empty()
    }

    pub fn has_panel(&self) -> bool {
        self.panel.is_some()
    }

    pub fn has_sky(&self) -> bool {
        self.sky.is_some()
    }

    /// What comes from outside the scene.
    pub fn background(&self, direction: Vec3) -> Vec3 {
        self.sky.map_or(Vec3::ZERO, |sky| sky.radiance(direction))
    }

    /// Chooses an emitter by power, or sun and panel by fixed shares, and a point on it. `None` when it shines away from `point`.
    pub fn sample(&self, point: Vec3, choice: f32, [u, v]: [f32; 2]) -> Option<LightSample> {
        if let Some(&power) = self.cumulative.last() {
            let wanted = f64::from(choice) * power;
            let index = self.cumulative.partition_point(|&c| c <= wanted).min(self.emitters.len() - 1);
            let Emitter { triangle: Triangle([a, b, c]), emission } = self.emitters[index];
            let [a, b, c] = [a, b, c].map(|vertex| vertex.as_dvec3());
            let (u, v) = (f64::from(u), f64::from(v));
            // Uniform over the triangle (Turk 1990). In double precision: far from the origin, single
            // precision would move the point off the triangle.
            let root = u.sqrt();
            let on_light = a + (b - a) * (root * (1.0 - v)) + (c - a) * (root * v);
            let (direction, distance) = towards(on_light, point);
            let normal = (b - a).cross(c - a).normalize_or_zero().as_vec3();
            let cosine = normal.dot(direction).abs();
            let density = self.emitter_density(emission, distance, cosine);
            let usable = distance > 0.0 && density.is_finite() && density > 0.0;
            return usable.then_some(LightSample {
                direction,
                distance,
                radiance: emission,
                density,
                can_be_hit: true,
            });
        }
        let sun_share = match (self.sky, self.panel) {
            (Some(_), Some(_)) => SUN_SHARE_INDOORS,
            (Some(_), None) => 1.0,
            (None, _) => 0.0,
        };
        if choice < sun_share {
            let sun = self.sky?.sun;
            // Uniform over the disc.
            let cosine = 1.0 - u * (1.0 - SUN_COSINE);
            let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
            let (tangent, bitangent) = sun.any_orthonormal_pair();
            let (sin, cos) = libm::sincosf(TAU * v);
            let solid_angle = TAU * (1.0 - SUN_COSINE);
            return Some(LightSample {
                direction: (sun * cosine + tangent * (sine * cos) + bitangent * (sine * sin)).normalize(),
                distance: f32::INFINITY,
                radiance: SUN_IRRADIANCE / solid_angle,
                density: sun_share / solid_angle,
                can_be_hit: false,
            });
        }
        let panel = self.panel?;
        let [across, along] = panel.edges.map(|edge| edge.as_dvec3());
        let on_light = panel.corner.as_dvec3() + across * f64::from(u) + along * f64::from(v);
        let (direction, distance) = towards(on_light, point);
        let scaled_normal = panel.edges[0].cross(panel.edges[1]);
        let area = scaled_normal.length();
        let cosine = -direction.dot(scaled_normal) / area;
        let density = (1.0 - sun_share) * distance * distance / (cosine * area);
        (distance > 0.0 && cosine > 0.0 && density.is_finite()).then_some(LightSample {
            direction,
            distance,
            radiance: PANEL_RADIANCE,
            density,
            can_be_hit: false,
        })
    }

    /// The density per solid angle with which [`Self::sample`] chooses a point of an emitter, seen from `distance` under an
    /// angle of this cosine: emitters are chosen by power and points by area, so only the emission matters.
    pub fn emitter_density(&self, emission: Vec3, distance: f32, cosine: f32) -> f32 {
        let power = self.cumulative.last().copied().unwrap_or(f64::INFINITY);
        (f64::from(luminance(emission)) / power) as f32 * distance * distance / cosine
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{Faces, Material, Part};

    /// Two parallel squares of edge 1 and 2, the second twice as bright: powers 1 and 8.
    fn squares() -> (Mesh, Lights) {
        let square = |edge: f32, z: f32| {
            [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[x, y]| Vec3::new(x * edge, y * edge, z))
        };
        let part = |first: u32, material, faces, corners: &[u32]| Part {
            name: String::new(),
            material,
            faces,
            indices: corners.iter().map(|c| c + first).collect(),
        };
        let material = |emission| Material { emission: Vec3::splat(emission), ..Material::default() };
        let mesh = Mesh {
            vertices: [square(1.0, 0.0), square(2.0, 1.0), square(9.0, 2.0)].concat(),
            parts: vec![
                part(0, 0, Faces::Triangles, &[0, 1, 2, 0, 2, 3]),
                part(4, 1, Faces::Quads, &[0, 1, 2, 3]),
                part(8, 2, Faces::Quads, &[0, 1, 2, 3]),
            ],
            materials: vec![material(1.0), material(2.0), material(0.0)],
        };
        let lights = Lights::from_emission(&mesh, &mesh.triangles(), &Appearance::of_parts(&mesh));
        (mesh, lights)
    }

    #[test]
    fn emitters_are_chosen_by_power() {
        let (_, lights) = squares();
        assert!(lights.has_emitters());
        let mut large = 0;
        for i in 0..900 {
            let sample =
                lights.sample(Vec3::new(0.3, 0.3, 5.0), (i as f32 + 0.5) / 900.0, [0.5, 0.5]).unwrap();
            large += u32::from(sample.radiance.x == 2.0);
        }
        assert_eq!(large, 800);
    }

    /// Σ radiance/density · cos is the irradiance: for a parallel square of edge a at distance d, above its centre, a closed
    /// form exists (view factor of a differential element to a rectangle; Howell, configuration B-3, four corners).
    #[test]
    fn irradiance_matches_the_form_factor() {
        let mut mesh = squares().0;
        mesh.parts.truncate(1);
        let lights = Lights::from_emission(&mesh, &mesh.triangles(), &Appearance::of_parts(&mesh));
        let point = Vec3::new(0.5, 0.5, -1.0);
        let steps = 64;
        let mut sum = 0.0;
        for k in 0..2 * steps * steps {
            let (side, i) = (k % 2, k / 2);
            let [u, v] = [(i % steps) as f32 + 0.5, (i / steps) as f32 + 0.5].map(|x| x / steps as f32);
            let sample = lights.sample(point, side as f32 * 0.5 + 0.25, [u, v]).unwrap();
            sum += f64::from(sample.radiance.x * sample.direction.z / sample.density);
        }
        let irradiance = sum / f64::from(2 * steps * steps);
        let x: f64 = 0.5;
        let corner =
            2.0 * x / (1.0 + x * x).sqrt() * (x / (1.0 + x * x).sqrt()).atan() / std::f64::consts::TAU;
        let expected = std::f64::consts::PI * 4.0 * corner;
        assert!((irradiance / expected - 1.0).abs() < 2e-3, "{irradiance} {expected}");
    }

    #[test]
    fn panel_shines_one_way_and_sun_from_afar() {
        let sky = Sky { up: Vec3::Y, sun: Vec3::new(0.0, 0.8, 0.6) };
        let panel = Panel { corner: Vec3::new(0.0, 3.0, 0.0), edges: [Vec3::X, Vec3::Z] };
        let lights = Lights::from_sky(sky, Some(panel));
        assert!(lights.has_panel() && !lights.has_emitters());
        let below = lights.sample(Vec3::new(0.5, 1.0, 0.5), 0.9, [0.5, 0.5]).unwrap();
        assert!((below.direction - Vec3::Y).length() < 1e-6 && below.distance == 2.0);
        // At the centre: 2² / (cos 1 · area 1), chosen seven times in eight.
        assert!((below.density - 3.5).abs() < 1e-5, "{}", below.density);
        assert!(lights.sample(Vec3::new(0.5, 9.0, 0.5), 0.9, [0.5, 0.5]).is_none());
        let sun = lights.sample(Vec3::ZERO, 0.1, [0.999, 0.3]).unwrap();
        assert!(sun.distance == f32::INFINITY && sun.direction.dot(sky.sun) > SUN_COSINE - 1e-6);
        assert!((sun.radiance / sun.density * SUN_SHARE_INDOORS - SUN_IRRADIANCE).length() < 1e-4);
        assert!(Lights::default().sample(Vec3::ZERO, 0.5, [0.5, 0.5]).is_none());
    }

    #[test]
    fn sky_is_continuous_and_bright_above() {
        let sky = Sky { up: Vec3::Z, sun: Vec3::Z };
        let at = |degrees: f32| {
            sky.radiance(Vec3::new(degrees.to_radians().cos(), 0.0, degrees.to_radians().sin()))
        };
        assert!((at(0.01) - at(-0.01)).length() < 0.01);
        assert_eq!(at(90.0), ZENITH);
        assert!((at(-60.0) - GROUND).length() < 0.01);
    }
}
