//! A Cornell box, two trees over it, and a recording: camera rays, a bounce and a shadow ray each, answered by a loop over all triangles.

use super::compare_support::exact;
use embree_trace::builder::{Bins, Config, Splits, build};
use embree_trace::format::bvh::{self, Contents, Geometry, NO_INSTANCE, fingerprint};
use embree_trace::format::rays::{
    ChunkInfo, Codec, Header, NO_TRIANGLE, Purpose, RaysWriter, Record, flag, kind,
};
use embree_trace::geometry::{Ray, Triangle, Vec3};
use embree_trace::mesh::generate::cornell_box;
use embree_trace::progress::Progress;
use embree_trace::render::camera::{Camera, View};
use embree_trace::tree::collapse::{self, collapse};
use embree_trace::view::offscreen::Offscreen;
use embree_trace::view::wishes::Wishes;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Of the recorded image.
pub const IMAGE: [u32; 2] = [48, 48];

/// Corner and side of a square of pixels that cost more than others in `hot.rays`.
pub const HOT: [u32; 2] = [31, 12];
pub const HOT_SIDE: u32 = 4;

/// Longer than any picture here takes, on the slowest machine.
pub const PATIENCE: Duration = Duration::from_secs(300);

/// Where the recording's camera stands: it sees the whole box through its open front.
pub fn view() -> View {
    View {
        eye: Vec3::new(2.75, 2.75, -8.0),
        target: Vec3::new(2.75, 2.75, 0.0),
        up: Vec3::Y,
        fov_degrees: 39.0,
    }
}

/// The files of the room.
pub struct Room {
    pub directory: tempfile::TempDir,
    pub triangles: Vec<Triangle>,
}

impl Room {
    pub fn new() -> Room {
        let triangles = cornell_box().triangles();
        let room = Room { directory: tempfile::tempdir().expect("a directory"), triangles };
        room.tree("sweep.bvh", Splits::Sweep, 2);
        room.tree("binned.bvh", Splits::Binned { bins: Bins::Fixed(4) }, 2);
        room.tree("wide.bvh", Splits::Sweep, 8);
        room.write("casts.rays", &room.recording(0));
        room.write("hot.rays", &room.recording(50));
        room
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    pub fn paths(&self, names: &[&str]) -> Vec<PathBuf> {
        names.iter().map(|name| self.path(name)).collect()
    }

    pub fn write(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.path(name), bytes).expect("writing a test file");
    }

    fn tree(&self, name: &str, splits: Splits, width: usize) {
        let tree = build(&self.triangles, &Config::of(splits), &Progress::hidden()).expect("a tree");
        let area = |node: usize| f64::from(tree.nodes[node].bounds().area());
        let tree = match width {
            2 => tree.clone(),
            _ => collapse(tree.view(), area, &collapse::Config::vector(width)).expect("a wide tree"),
        };
        let geometry = Geometry {
            instance: NO_INSTANCE,
            geometry: 0,
            first_triangle: 0,
            triangle_count: self.triangles.len() as u32,
            mask: u32::MAX,
            kind: 0,
            flags: 0,
            instance_mask: 0,
        };
        let meta = format!("{{\"image\":[{},{}]}}", IMAGE[0], IMAGE[1]);
        let contents = Contents {
            tree: tree.view(),
            triangles: &self.triangles,
            geometries: &[geometry],
            order: None,
            meta: Some(&meta),
            flags: 0,
            producer: "a test",
        };
        let mut bytes = Vec::new();
        bvh::write(&mut bytes, &contents).expect("writing to memory");
        self.write(name, &bytes);
    }

    /// Triangle and distance of the nearest hit, by asking all triangles.
    pub fn nearest(&self, ray: &Ray) -> Option<(u32, f32)> {
        let hits = self.triangles.iter().enumerate().filter_map(|(index, triangle)| {
            let hit = exact(ray, triangle)?;
            let inside = hit.margin >= 0.0 && hit.t > f64::from(ray.tnear) && hit.t <= f64::from(ray.tfar);
            inside.then_some((index as u32, hit.t as f32))
        });
        hits.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The recording; camera queries in the square at [`HOT`] come `again` so many times.
    fn recording(&self, again: usize) -> Vec<u8> {
        let [width, height] = IMAGE;
        let camera = Camera::new(&view(), width, height).expect("a camera");
        let light = Vec3::new(2.75, 5.4, 2.75);
        let mut records = Vec::new();
        for path in 0..width * height {
            let ray = camera.ray((path % width) as f32 + 0.5, (path / width) as f32 + 0.5);
            let Some((triangle, t)) = self.nearest(&ray) else {
                records.push(record(&ray, None, Purpose::Camera, path, 0));
                continue;
            };
            records.push(record(&ray, Some((triangle, t)), Purpose::Camera, path, 0));
            let normal = self.triangles[triangle as usize].scaled_normal().normalize();
            let normal = if normal.dot(ray.direction) > 0.0 { -normal } else { normal };
            let origin = ray.at(t) + 1e-4 * normal;
            let shadow = Ray { origin, tnear: 0.0, direction: light - origin, tfar: 0.999 };
            records.push(record(&shadow, self.nearest(&shadow), Purpose::Shadow, path, 1));
            // A mirror bounce is as good as any, and the same each time.
            let direction = ray.direction - 2.0 * ray.direction.dot(normal) * normal;
            let bounce = Ray { origin, tnear: 0.0, direction, tfar: f32::INFINITY };
            records.push(record(&bounce, self.nearest(&bounce), Purpose::Diffuse, path, 1));
        }
        let near = |place: u32, corner: u32| (corner..corner + HOT_SIDE).contains(&place);
        let is_hot = |record: &&Record| {
            near(record.path % width, HOT[0]) && near(record.path / width, HOT[1]) && record.depth == 0
        };
        let hot: Vec<Record> = records.iter().filter(is_hot).copied().collect();
        (0..again).for_each(|_| records.extend(&hot));
        let header = Header {
            fingerprint: fingerprint(&self.triangles),
            embree_version: 0,
            deterministic: true,
            producer: "a test".to_owned(),
        };
        let mut writer = RaysWriter::new(Vec::new(), &header).expect("writing to memory");
        for (number, part) in records.chunks(1500).enumerate() {
            let info = ChunkInfo { scene: 0, thread: 0, sequence: 1500 * number as u64 };
            writer.write_chunk(&info, part, &[], Codec::Raw).expect("writing to memory");
        }
        writer.finish().expect("writing to memory").0
    }
}

fn record(ray: &Ray, hit: Option<(u32, f32)>, purpose: Purpose, path: u32, depth: u8) -> Record {
    let occlusion = purpose == Purpose::Shadow;
    let t = match (occlusion, hit) {
        (true, Some(_)) => f32::NEG_INFINITY,
        (false, Some((_, t))) => t,
        (_, None) => f32::INFINITY,
    };
    Record {
        origin: ray.origin,
        tnear: ray.tnear,
        direction: ray.direction,
        tfar: ray.tfar,
        time: 0.0,
        mask: u32::MAX,
        t,
        triangle: hit.filter(|_| !occlusion).map_or(NO_TRIANGLE, |(triangle, _)| triangle),
        u: 0.0,
        v: 0.0,
        path,
        kind: if occlusion { kind::OCCLUSION } else { kind::CLOSEST_HIT },
        depth,
        flags: hit.map_or(0, |_| flag::HIT),
        purpose: purpose as u8,
    }
}

/// Files in a window of `size` that has come to rest.
pub fn shown(files: Vec<PathBuf>, wishes: Wishes, size: [u32; 2]) -> Offscreen {
    let mut offscreen = Offscreen::new(files, wishes, size)
        .expect("a graphics device: tools/setup --viewer installs one in software");
    offscreen.settle(PATIENCE).expect("a picture");
    offscreen
}

/// Where reference pictures are.
pub fn references() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/view/references")
}
