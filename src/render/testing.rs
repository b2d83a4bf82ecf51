//! What tests of integrators stand on: answers by brute force in double precision, and scenes whose radiance is known.

use crate::embree::Query;
use crate::geometry::{DVec3, Triangle, Vec3};
use crate::mesh::{Faces, Material, Mesh, Part};
use crate::render::job::Job;
use crate::render::queries::RayQueries;
use crate::render::scenery::{Scenery, Wishes};
use crate::render::shapes::Met;
use crate::render::tiles::Tiles;
use crate::render::workers::trace_tile;

/// Tests every triangle (Möller and Trumbore 1997), and keeps what it was asked.
pub struct BruteForce {
    triangles: Vec<(u32, Triangle)>,
    pub asked: Vec<(Query, bool)>,
}

impl BruteForce {
    pub fn new(mesh: &Mesh) -> BruteForce {
        let mut triangles = mesh.triangles().into_iter();
        let mut of_parts = Vec::new();
        for (number, part) in mesh.parts.iter().enumerate() {
            let count = part.triangle_count();
            of_parts.extend(triangles.by_ref().take(count).map(|t| (number as u32, t)));
        }
        BruteForce { triangles: of_parts, asked: Vec::new() }
    }

    fn nearest(&self, query: &Query) -> Option<Met> {
        let ray = query.ray;
        let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let (mut best, mut limit) = (None, f64::from(ray.tfar));
        for (number, &(part, triangle)) in self.triangles.iter().enumerate() {
            let [a, b, c] = triangle.0.map(|v| v.as_dvec3());
            let (e1, e2): (DVec3, DVec3) = (b - a, c - a);
            let p = direction.cross(e2);
            let determinant = e1.dot(p);
            let s = origin - a;
            let u = s.dot(p) / determinant;
            let q = s.cross(e1);
            let (v, t) = (direction.dot(q) / determinant, e2.dot(q) / determinant);
            let inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0;
            let within = t >= f64::from(ray.tnear) && t <= limit;
            if determinant != 0.0 && inside && within {
                best = Some(Met { triangle: number as u32, part });
                limit = t;
            }
        }
        best
    }
}

impl RayQueries for BruteForce {
    fn closest_hit(&mut self, query: &Query) -> Option<Met> {
        let hit = self.nearest(query);
        self.asked.push((*query, false));
        hit
    }

    fn occluded(&mut self, query: &Query) -> bool {
        self.asked.push((*query, true));
        self.nearest(query).is_some()
    }
}

/// A mesh of one part per list of quads, each with its material.
pub fn mesh(parts: &[(&[[Vec3; 4]], Material)]) -> Mesh {
    let mut mesh = Mesh::default();
    for (quads, material) in parts {
        let first = mesh.vertices.len() as u32;
        mesh.vertices.extend(quads.iter().flatten());
        let indices = (first..mesh.vertices.len() as u32).collect();
        let material_index = mesh.materials.len() as u32;
        mesh.materials.push(material.clone());
        let part = Part { name: String::new(), material: material_index, faces: Faces::Quads, indices };
        mesh.parts.push(part);
    }
    mesh
}

/// A rectangle at `corner` with the edges `a` and `b`.
pub fn quad(corner: Vec3, a: Vec3, b: Vec3) -> [Vec3; 4] {
    [corner, corner + a, corner + a + b, corner + b]
}

/// The six sides of the cube from 0 to `edge`.
pub fn cube(edge: f32) -> Vec<[Vec3; 4]> {
    let [x, y, z] = Vec3::AXES.map(|axis| axis * edge);
    vec![
        quad(Vec3::ZERO, x, y),
        quad(z, x, y),
        quad(Vec3::ZERO, y, z),
        quad(x, y, z),
        quad(Vec3::ZERO, z, x),
        quad(y, z, x),
    ]
}

pub fn emitter(radiance: f32, reflectance: f32) -> Material {
    let (emission, diffuse) = (Vec3::splat(radiance), Vec3::splat(reflectance));
    Material { emission, diffuse, ..Material::default() }
}

/// Renders a mesh by brute force from `eye` to `target`: the pixels, and what was asked.
pub fn image(mesh: &Mesh, job: &Job, eye: Vec3, target: Vec3) -> (Vec<Vec3>, BruteForce) {
    let mut queries = BruteForce::new(mesh);
    let wishes = Wishes { eye_and_target: Some((eye, target)), fov_degrees: Some(30.0), up: Some(Vec3::Y) };
    let scenery =
        Scenery::new(mesh, mesh.triangles(), &mut queries, &wishes, [job.width, job.height]).unwrap();
    queries.asked.clear();
    let (mut all, mut pixels) = (Vec::new(), Vec::new());
    let tiles = Tiles::new(job);
    for index in 0..tiles.len() {
        trace_tile(&scenery, job, &tiles.tile(index), &mut queries, &mut pixels);
        all.extend_from_slice(&pixels);
    }
    (all, queries)
}

pub fn mean(pixels: &[Vec3]) -> f32 {
    pixels.iter().map(|p| p.y).sum::<f32>() / pixels.len() as f32
}
