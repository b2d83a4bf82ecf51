//! Embree's own trees and traversal, one query a call: `rtcIntersect1` and `rtcOccluded1` behind our wrapper.

use super::Caster;
use embree_trace::embree::{Intersector, Quality, Query, Scene, Settings};
use embree_trace::format::rays::Record;
use embree_trace::geometry::Triangle;
use embree_trace::mesh::{Faces, Material, Mesh, Part};

/// The same triangles at two qualities: Embree's default, and with spatial splits.
pub struct EmbreeScenes([(&'static str, Scene); 2]);

impl EmbreeScenes {
    pub fn new(triangles: &[Triangle]) -> EmbreeScenes {
        let part = Part {
            name: String::new(),
            material: 0,
            faces: Faces::Triangles,
            indices: (0..3 * triangles.len() as u32).collect(),
        };
        let mesh = Mesh {
            vertices: triangles.iter().flat_map(|triangle| triangle.0).collect(),
            parts: vec![part],
            materials: vec![Material::default()],
        };
        let scene = |quality| {
            Scene::new(&mesh, &Settings { quality, ..Settings::default() })
                .expect("a scene that Embree can build")
        };
        EmbreeScenes([("Embree medium", scene(Quality::Medium)), ("Embree high", scene(Quality::High))])
    }

    pub fn casters(&self) -> impl Iterator<Item = (&'static str, EmbreeCaster<'_>)> {
        self.0.iter().map(|(name, scene)| (*name, EmbreeCaster::new(scene)))
    }

    /// Embree's default.
    pub fn medium(&self) -> &Scene {
        &self.0[0].1
    }
}

pub struct EmbreeCaster<'a>(Intersector<'a>);

impl EmbreeCaster<'_> {
    pub fn new(scene: &Scene) -> EmbreeCaster<'_> {
        EmbreeCaster(scene.intersector().expect("an intersector"))
    }
}

impl Caster for EmbreeCaster<'_> {
    fn closest(&mut self, record: &Record) -> f32 {
        self.0.closest_hit(&Query::new(record.ray())).map_or(f32::INFINITY, |hit| hit.t)
    }

    fn occluded(&mut self, record: &Record) -> bool {
        self.0.occluded(&Query::new(record.ray()))
    }
}
