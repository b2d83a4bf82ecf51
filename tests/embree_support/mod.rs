//! Meshes, rays and brute force for the tests of `embree`: everything here is independent of what is tested.
#![allow(dead_code)] // each test program uses its part

use embree_trace::embree::Query;
use embree_trace::geometry::{DVec3, Ray, Triangle, Vec3};
use embree_trace::mesh::{Faces, Material, Mesh, Part};

/// SplitMix64 (Steele, Lea and Flood 2014).
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform in 0..n.
    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }

    /// Uniform in 0..1.
    pub fn unit(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Uniform in the cube -1..1.
    pub fn point(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit()) * 2.0 - Vec3::ONE
    }
}

/// Adds a part of `faces` random faces of the given size to `mesh`.
pub fn add_soup(mesh: &mut Mesh, faces: Faces, count: usize, size: f32, random: &mut Random) {
    if mesh.materials.is_empty() {
        mesh.materials.push(Material::default());
    }
    let mut indices = Vec::new();
    for _ in 0..count {
        let corner = random.point();
        let (along, across) = (random.point() * size, random.point() * size);
        let first = mesh.vertices.len() as u32;
        mesh.vertices.extend([corner, corner + along]);
        if faces == Faces::Quads {
            // A little out of plane: the two triangles of a quad then differ.
            mesh.vertices.push(corner + along + across + random.point() * (0.2 * size));
        }
        mesh.vertices.push(corner + across);
        indices.extend(first..first + faces.corners() as u32);
    }
    let name = format!("part {}", mesh.parts.len());
    mesh.parts.push(Part { name, material: 0, faces, indices });
}

/// One part of random triangles or quads.
pub fn soup(faces: Faces, count: usize, size: f32, seed: u64) -> Mesh {
    let mut mesh = Mesh::default();
    add_soup(&mut mesh, faces, count, size, &mut Random(seed));
    mesh
}

/// A wavy height field of `side` x `side` cells with shared vertices.
pub fn grid(faces: Faces, side: u32) -> Mesh {
    let mut mesh = Mesh { materials: vec![Material::default()], ..Mesh::default() };
    let at = |x: u32, z: u32| z * (side + 1) + x;
    for z in 0..=side {
        for x in 0..=side {
            let (fx, fz) = (x as f32 / side as f32 * 2.0 - 1.0, z as f32 / side as f32 * 2.0 - 1.0);
            mesh.vertices.push(Vec3::new(fx, 0.2 * (7.0 * fx).sin() * (5.0 * fz).cos(), fz));
        }
    }
    let mut indices = Vec::new();
    for z in 0..side {
        for x in 0..side {
            let [a, b, c, d] = [at(x, z), at(x + 1, z), at(x + 1, z + 1), at(x, z + 1)];
            match faces {
                Faces::Quads => indices.extend([a, b, c, d]),
                Faces::Triangles => indices.extend([a, b, d, c, d, b]),
            }
        }
    }
    mesh.parts.push(Part { name: "grid".into(), material: 0, faces, indices });
    mesh
}

/// Random rays from around the unit cube through it, some with a bounded interval.
pub fn queries(count: usize, seed: u64) -> Vec<Query> {
    let random = &mut Random(seed);
    (0..count)
        .map(|_| {
            let (origin, target) = (random.point() * 2.0, random.point());
            let direction = (target - origin) * (0.1 + 3.0 * random.unit());
            let (tnear, tfar) = match random.below(4) {
                0 => (0.3 * random.unit(), 0.3 + 2.0 * random.unit()),
                _ => (0.0, f32::INFINITY),
            };
            Query::new(Ray { origin, tnear, direction, tfar })
        })
        .collect()
}

/// What double precision knows of a ray and a triangle.
#[derive(Clone, Copy, Debug)]
pub struct Crossing {
    pub t: f64,
    pub u: f64,
    pub v: f64,
    /// How far inside the triangle, in barycentrics: negative outside.
    pub inside: f64,
}

/// The crossing of the ray's line with the triangle's plane; `None` when there is none.
pub fn crossing(ray: &Ray, triangle: &Triangle) -> Option<Crossing> {
    let [a, b, c] = triangle.0.map(Vec3::as_dvec3);
    let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let (ab, ac) = (b - a, c - a);
    let p = direction.cross(ac);
    let determinant = ab.dot(p);
    if determinant.abs() <= 1e-12 * ab.length() * p.length() || !determinant.is_finite() {
        return None;
    }
    let s: DVec3 = origin - a;
    let q = s.cross(ab);
    let (u, v, t) = (s.dot(p) / determinant, direction.dot(q) / determinant, ac.dot(q) / determinant);
    Some(Crossing { t, u, v, inside: u.min(v).min(1.0 - u - v) })
}

/// Brute force: the nearest crossing within the interval, of all triangles, that is inside by at least `margin`.
pub fn nearest(ray: &Ray, triangles: &[Triangle], margin: f64) -> Option<(usize, Crossing)> {
    let mut best: Option<(usize, Crossing)> = None;
    for (index, triangle) in triangles.iter().enumerate() {
        if let Some(found) = crossing(ray, triangle)
            && found.inside >= margin
            && found.t >= ray.tnear as f64
            && found.t <= ray.tfar as f64
            && best.is_none_or(|(_, best)| found.t < best.t)
        {
            best = Some((index, found));
        }
    }
    best
}
