//! Generated geometry and rays as a trace: a `.bvh` and a `.rays` that every other tool takes.

use super::measure::area_tree;
use super::shape::{Setup, Shape};
use super::{ExperimentError, Settings, foci, shapes};
use crate::builder::Config;
use crate::files::{self, FileError, OutputFile};
use crate::format::bvh::{self, Contents, Geometry, NO_INSTANCE};
use crate::format::rays::{
    self, ChunkInfo, Codec, Header, MAX_CHUNK_RECORDS, NO_DEPTH, NO_TRIANGLE, Purpose, RaysWriter, Record,
};
use crate::geometry::{Ray, Triangle};
use crate::traverse::{All, Prepared, PreparedRay, Scratch, Traversal};
use crate::tree::Tree;
use std::path::Path;

const PRODUCER: &str = "bvh-experiment";

/// Writes the first trial of `shapes` at focus 0, 0.2, …, 1: `DIRECTORY/sphere-0.2.bvh` and `.rays`, and so on, with the
/// SAH tree.
///
/// # Errors
/// When a file cannot be written.
pub fn first_trials(chosen: &[Shape], settings: &Settings, directory: &Path) -> Result<(), ExperimentError> {
    for &shape in chosen {
        for focus in foci(&Settings { quick: true, ..*settings }) {
            let (Setup { triangles, .. }, rays) = shapes::setup(shape, focus, 0, settings.seed);
            let tree = area_tree(&triangles, &Config::default())?;
            let name = format!("{}-{focus}", shape.name());
            trace(&tree, &triangles, &rays, &directory.join(name))?;
        }
    }
    Ok(())
}

/// Writes `path`.bvh and `path`.rays.
fn trace(tree: &Tree, triangles: &[Triangle], rays: &[Ray], path: &Path) -> Result<(), FileError> {
    let geometry = Geometry {
        instance: NO_INSTANCE,
        geometry: 0,
        first_triangle: 0,
        triangle_count: triangles.len() as u32,
        mask: u32::MAX,
        kind: 0,
        flags: 0,
        instance_mask: 0,
    };
    let contents = Contents {
        tree: tree.view(),
        triangles,
        geometries: &[geometry],
        order: None,
        meta: None,
        flags: 0,
        producer: PRODUCER,
    };
    // Names hold a point already, as in sphere-0.2, so the extension is appended, not set.
    let with = |extension| {
        path.with_file_name(format!("{}{extension}", path.file_name().unwrap_or_default().display()))
    };
    let fingerprint = OutputFile::create(&with(".bvh"))?.commit_with(|out| bvh::write(out, &contents))?;

    let rays_path = with(".rays");
    let header = Header { fingerprint, embree_version: 0, deterministic: true, producer: PRODUCER.into() };
    let records = records(tree, triangles, rays);
    let write = || {
        let mut writer = RaysWriter::new(files::create(&rays_path)?, &header).map_err(WriteError::Io)?;
        for (chunk, records) in records.chunks(MAX_CHUNK_RECORDS).enumerate() {
            let sequence = (chunk * MAX_CHUNK_RECORDS) as u64;
            let info = ChunkInfo { scene: 0, thread: 0, sequence };
            writer.write_chunk(&info, records, &[], Codec::Raw).map_err(WriteError::Io)?;
        }
        writer.finish().map_err(WriteError::Io)?;
        Ok(())
    };
    write().map_err(|error| match error {
        WriteError::Io(error) => FileError::new(&rays_path, "write", error),
        WriteError::File(error) => error,
    })
}

enum WriteError {
    Io(std::io::Error),
    File(FileError),
}

impl From<FileError> for WriteError {
    fn from(error: FileError) -> WriteError {
        WriteError::File(error)
    }
}

/// Closest-hit queries with their answers.
fn records(tree: &Tree, triangles: &[Triangle], rays: &[Ray]) -> Vec<Record> {
    let prepared = Prepared::new(tree.view(), triangles, &[]);
    let mut scratch = Scratch::default();
    // Rays are drawn one by one: each stands for a pixel of its own when they are parted.
    let record = |(path, ray): (u32, &Ray)| {
        let hit = prepared.closest_hit(Traversal::Odf, &PreparedRay::new(ray), &All, &mut (), &mut scratch);
        // A reader gets weights of the corners that say where on the triangle the hit is.
        let (u, v) =
            hit.map_or((0.0, 0.0), |hit| barycentric(&triangles[hit.triangle as usize], ray.at(hit.t)));
        Record {
            origin: ray.origin,
            tnear: ray.tnear,
            direction: ray.direction,
            tfar: ray.tfar,
            time: 0.0,
            mask: u32::MAX,
            t: hit.map_or(f32::INFINITY, |hit| hit.t),
            triangle: hit.map_or(NO_TRIANGLE, |hit| hit.triangle),
            u,
            v,
            path,
            kind: rays::kind::CLOSEST_HIT,
            depth: NO_DEPTH,
            flags: if hit.is_some() { rays::flag::HIT } else { 0 },
            purpose: Purpose::Unknown as u8,
        }
    };
    (0..).zip(rays).map(record).collect()
}

/// Weights of the second and third corner at a point of the triangle's plane.
fn barycentric(triangle: &Triangle, point: crate::geometry::Vec3) -> (f32, f32) {
    let [a, b, c] = triangle.0;
    let normal = triangle.scaled_normal();
    let scale = 1.0 / normal.length_squared();
    let u = (point - a).cross(c - a).dot(normal) * scale;
    let v = (b - a).cross(point - a).dot(normal) * scale;
    (u.clamp(0.0, 1.0), v.clamp(0.0, 1.0))
}
