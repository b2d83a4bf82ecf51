//! What a ray met: the point, the side it was met from, and how the surface scatters light.
//!
//! Materials are two-sided, as the winding of scene files cannot be trusted.

use crate::geometry::{Ray, Triangle, Vec3};
use crate::mesh::{Material, Mesh};
use crate::render::film::luminance;
use crate::render::meeting::Meeting;
use std::f32::consts::TAU;

/// A material as integrators use it: it never reflects more than it receives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Appearance {
    /// Radiance that it emits, to both sides.
    pub emission: Vec3,
    pub diffuse: Vec3,
    pub specular: Vec3,
    /// How often a path goes on as a mirror reflection rather than a diffuse one.
    pub specular_share: f32,
}

impl Appearance {
    pub fn of(material: &Material) -> Appearance {
        let clean =
            |v: Vec3| Vec3::from_array(v.to_array().map(|c| if c.is_finite() { c.max(0.0) } else { 0.0 }));
        let (diffuse, specular) = (clean(material.diffuse), clean(material.specular));
        let scale = 1.0 / (diffuse + specular).max_element().max(1.0);
        let (diffuse, specular) = (diffuse * scale, specular * scale);
        let (d, s) = (luminance(diffuse), luminance(specular));
        let specular_share = if s > 0.0 { s / (s + d) } else { 0.0 };
        Appearance { emission: clean(material.emission), diffuse, specular, specular_share }
    }

    /// Whether a path can go on from here.
    pub fn scatters(&self) -> bool {
        self.diffuse != Vec3::ZERO || self.specular != Vec3::ZERO
    }

    /// One per part of the mesh, so that a hit's part finds it.
    pub fn of_parts(mesh: &Mesh) -> Vec<Appearance> {
        let grey = Material::default();
        let material = |index: u32| mesh.materials.get(index as usize).unwrap_or(&grey);
        mesh.parts.iter().map(|part| Appearance::of(material(part.material))).collect()
    }
}

/// Where a ray met a surface.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Index into [`Mesh::parts`].
    pub part: u32,
    /// How far the ray went, in units of the length of its direction.
    pub distance: f32,
    /// Length 1, towards the side that the ray came from.
    pub normal: Vec3,
    /// Where rays that leave on that side start: so far off the surface that they cannot meet it again.
    pub origin: Vec3,
}

impl Surface {
    pub fn new(meeting: &Meeting, triangle: &Triangle, part: u32) -> Surface {
        let origin = meeting.origin(triangle);
        Surface { part, distance: meeting.t as f32, normal: meeting.normal.as_vec3(), origin }
    }

    /// A ray that leaves on the side of the normal and ends at `tfar`.
    ///
    /// Its interval begins at the least number above 0. Where floats are far apart, an origin may
    /// lie in the plane of a wall that it is to pass, and Embree's kernels would not agree: the
    /// robust one counts t = 0 as a hit when tnear is 0, the others do not.
    #[inline]
    pub fn ray(&self, direction: Vec3, tfar: f32) -> Ray {
        Ray { origin: self.origin, tnear: f32::MIN_POSITIVE, direction, tfar }
    }

    /// A direction on the side of the normal, with density cos/π (Malley's method, on concentric squares).
    pub fn cosine_direction(&self, [u, v]: [f32; 2]) -> Vec3 {
        let radius = u.sqrt();
        let (sin, cos) = libm::sincosf(TAU * v);
        let (tangent, bitangent) = self.normal.any_orthonormal_pair();
        // 1 - u is at least 2^-24: the direction never lies in the surface.
        (tangent * (radius * cos) + bitangent * (radius * sin) + self.normal * (1.0 - u).sqrt()).normalize()
    }

    /// The mirror direction of an incoming direction.
    pub fn mirror_direction(&self, incoming: Vec3) -> Vec3 {
        (incoming - 2.0 * incoming.dot(self.normal) * self.normal).normalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn surface() -> (Ray, Surface) {
        let ray = Ray {
            origin: Vec3::new(3.0, 4.0, 100.0),
            tnear: 0.0,
            direction: Vec3::new(0.6, 0.0, -0.8),
            tfar: f32::INFINITY,
        };
        // Its winding says the other side.
        let triangle = Triangle([Vec3::ZERO, Vec3::Y * 100.0, Vec3::X * 100.0]);
        (ray, Surface::new(&Meeting::of(&ray, &triangle), &triangle, 0))
    }

    #[test]
    fn faces_the_ray_and_starts_off_the_surface() {
        let (_, surface) = surface();
        assert_eq!(surface.normal, Vec3::Z);
        // The direction is rounded: 0.6 is not quite 0.6.
        assert!((surface.distance - 125.0).abs() < 1e-4, "{}", surface.distance);
        assert!((surface.origin.truncate() - glam::Vec2::new(78.0, 4.0)).length() < 1e-4);
        assert!(surface.origin.z > 1e-6 && surface.origin.z < 1e-4, "{}", surface.origin);
    }

    #[test]
    fn cosine_directions_have_the_right_mean() {
        // The mean of cos over the density cos/π is 2/3, of the tangential part 0.
        let (_, surface) = surface();
        let mut sum = glam::DVec3::ZERO;
        let steps = 256;
        for i in 0..steps * steps {
            let [u, v] = [(i % steps) as f32 + 0.5, (i / steps) as f32 + 0.5].map(|x| x / steps as f32);
            let direction = surface.cosine_direction([u, v]);
            assert!(direction.dot(surface.normal) > 0.0 && (direction.length() - 1.0).abs() < 1e-5);
            sum += direction.as_dvec3();
        }
        let mean = sum / f64::from(steps * steps);
        assert!((mean - glam::DVec3::new(0.0, 0.0, 2.0 / 3.0)).length() < 1e-3, "{mean}");
    }

    #[test]
    fn mirrors_reflect() {
        let (ray, surface) = surface();
        assert!((surface.mirror_direction(ray.direction) - Vec3::new(0.6, 0.0, 0.8)).length() < 1e-6);
    }

    #[test]
    fn no_material_makes_light() {
        let shiny = Material {
            diffuse: Vec3::splat(0.9),
            specular: Vec3::new(0.9, 0.0, f32::NAN),
            emission: Vec3::new(-1.0, f32::INFINITY, 2.0),
            ..Material::default()
        };
        let appearance = Appearance::of(&shiny);
        assert!((appearance.diffuse + appearance.specular).max_element() <= 1.0 + 1e-6);
        assert_eq!(appearance.emission, Vec3::new(0.0, 0.0, 2.0));
    }
}
