//! A path-traced recording of a scene, from its own camera or from another, in files that vanish with it.

use embree_trace::embree::{Scene, Settings, TreeSource};
use embree_trace::files::MappedFile;
use embree_trace::format::bvh::{self, Bvh};
use embree_trace::format::rays::{Codec, Header, Rays};
use embree_trace::geometry::{Aabb, Vec3};
use embree_trace::mesh::Mesh;
use embree_trace::progress::Progress;
use embree_trace::record::Recorder;
use embree_trace::render::camera::View;
use embree_trace::render::scenery::{Scenery, Wishes};
use embree_trace::render::workers::render;
use embree_trace::render::{Integrator, Job};
use std::error::Error;
use std::fs::File;
use tempfile::TempDir;

/// The pair of files that `embree-trace --savetrace` writes, mapped.
pub struct Recording {
    bvh: MappedFile,
    rays: MappedFile,
    /// Where the camera stood.
    pub view: View,
    _folder: TempDir,
}

impl Recording {
    /// Renders with one sample a pixel, depth 4, and whatever of the camera `wishes` leaves open chosen as `embree-trace` does.
    pub fn new(mesh: &Mesh, size: [u32; 2], wishes: &Wishes) -> Result<Recording, Box<dyn Error>> {
        let scene = Scene::new(mesh, &Settings::default())?;
        let (triangles, _) = scene.triangles();
        let scenery = Scenery::new(mesh, triangles, &mut scene.intersector()?, wishes, size)?;
        let folder = tempfile::tempdir()?;
        let [bvh_path, rays_path] = ["built.bvh", "casts.rays"].map(|name| folder.path().join(name));
        let built = scene.tree(TreeSource::Live)?;
        let fingerprint = bvh::write(File::create(&bvh_path)?, &built.contents())?;
        let job = Job {
            width: size[0],
            height: size[1],
            samples: 1,
            seed: 0,
            integrator: Integrator::Path,
            max_depth: 4,
            ao_rays: 1,
            threads: rayon::current_num_threads(),
            packet: 1,
        };
        let header = Header {
            fingerprint,
            embree_version: Scene::version(),
            deterministic: true,
            producer: "bench".into(),
        };
        let recorder = Recorder::start(File::create(&rays_path)?, &header, Codec::Raw, job.threads)?;
        render(&scene, &scenery, &job, Some(&recorder), &Progress::hidden())?;
        recorder.finish()?;
        let (bvh, rays) = (MappedFile::open(&bvh_path)?, MappedFile::open(&rays_path)?);
        Ok(Recording { bvh, rays, view: scenery.view, _folder: folder })
    }

    pub fn bvh(&self) -> Bvh<'_> {
        Bvh::parse(&self.bvh).expect("a file that was just written")
    }

    pub fn rays(&self) -> Rays<'_> {
        Rays::parse(&self.rays).expect("a file that was just written")
    }

    /// Another camera of the same scene. One outside goes a quarter of a circle around what it looks at. One inside goes half of the way to
    /// what it looks at and turns by a right angle: what it saw is out of its sight.
    pub fn other_view(&self, bounds: &Aabb) -> Wishes {
        let View { eye, target, up, fov_degrees } = self.view;
        let up = up.normalize();
        let quarter = |v: Vec3| {
            let along = up * up.dot(v);
            along + up.cross(v)
        };
        let is_inside = eye.cmpge(bounds.lower).all() && eye.cmple(bounds.upper).all();
        let sight = target - eye;
        let (eye, target) = if is_inside {
            let eye = eye + 0.5 * sight;
            (eye, eye + quarter(sight))
        } else {
            (target - quarter(sight), target)
        };
        Wishes { eye_and_target: Some((eye, target)), up: Some(up), fov_degrees: Some(fov_degrees) }
    }
}
