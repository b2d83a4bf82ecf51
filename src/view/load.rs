//! From files to what a window shows: trees and a recording, opened and prepared on a thread of their own while the window says so.
//!
//! Files stay mapped until the process ends: everything in a viewer borrows from them, on many threads, and a process shows one set of files.

use crate::compare::{Candidate, CompareError, check_scenes, image_size};
use crate::cost::Costs;
use crate::explore::price::Price;
use crate::explore::queries::Asked;
use crate::explore::walk::Walk;
use crate::files::{FileError, MappedFile};
use crate::format::bvh::Bvh;
use crate::format::rays::{Purpose, Rays};
use crate::format::{FileKind, FormatError};
use crate::geometry::{Aabb, Ray, Triangle};
use crate::render::camera::{Camera, View};
use crate::render::framing::{Axes, Framing, Seen, Sight, guess_up, main_bounds};
use crate::replay::pixels::ImageSize;
use crate::traverse::{All, OcclusionOrder, OrderError, Prepared, PreparedRay, Scratch, Traversal};
use crate::tree::collapse::{Config, collapse};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use thiserror::Error;

/// Binary trees are collapsed for casting up to this many nodes: beyond it, that takes longer than it saves.
const COLLAPSED: usize = 1 << 22;
/// Records of a recording's start that are looked at for its camera.
const CAMERA_CHUNKS: usize = 4;

/// Why files cannot be shown.
#[derive(Debug, Error)]
pub enum LoadError {
    #[error(transparent)]
    File(#[from] FileError),
    #[error("{path}: {source}")]
    Format { path: String, source: FormatError },
    #[error("{path}: {source}")]
    Order { path: String, source: OrderError },
    #[error(transparent)]
    Scene(#[from] CompareError),
    #[error("{0}")]
    Files(&'static str),
}

/// A tree, ready to be asked.
#[derive(Debug)]
pub struct OpenTree {
    pub path: PathBuf,
    pub bvh: Bvh<'static>,
    pub walk: Walk<'static>,
    /// The tree itself: what is measured and walked through.
    pub prepared: Prepared,
    pub order: OcclusionOrder,
    pub price: Price,
    /// A wider one over the same triangles, for pictures, once it is there.
    caster: OnceLock<Prepared>,
}

impl OpenTree {
    /// How it is asked when its work is counted.
    pub fn asked(&self, traversal: Traversal) -> Asked<'_> {
        Asked { prepared: &self.prepared, traversal, order: &self.order, price: self.price }
    }

    /// The tree that pictures are cast through.
    pub fn caster(&self) -> &Prepared {
        self.caster.get().unwrap_or(&self.prepared)
    }

    pub fn triangles(&self) -> &'static [Triangle] {
        self.bvh.triangles
    }

    /// The file's name without its ending.
    pub fn name(&self) -> String {
        name(&self.path)
    }

    fn open(path: &Path) -> Result<OpenTree, LoadError> {
        let label = path.display().to_string();
        let format = |source| LoadError::Format { path: label.clone(), source };
        let bvh = Bvh::parse(mapped(path)?).map_err(format)?;
        let walk = Walk::new(bvh.tree, bvh.triangles.len());
        let order = OcclusionOrder::new(None, bvh.tree, bvh.order);
        let order = order.map_err(|source| LoadError::Order { path: label.clone(), source })?;
        let prepared = Prepared::new(bvh.tree, bvh.triangles, bvh.geometries);
        let price = Price::of(bvh.tree, &Costs::default());
        Ok(OpenTree { path: path.to_owned(), bvh, walk, prepared, order, price, caster: OnceLock::new() })
    }

    /// Makes the tree for pictures: a binary one is collapsed to eight children a node, others are good as they are.
    pub fn widen(&self) {
        let tree = self.bvh.tree;
        if !self.prepared.is_binary() || tree.nodes.len() > COLLAPSED {
            return;
        }
        let area = |node: usize| f64::from(tree.nodes[node].bounds().area());
        if let Ok(wide) = collapse(tree, area, &Config::vector(8)) {
            // Another thread may have been first with the same.
            let _ = self.caster.set(Prepared::new(wide.view(), self.bvh.triangles, self.bvh.geometries));
        }
    }
}

impl Sight for &OpenTree {
    fn first(&mut self, ray: &Ray) -> Option<Seen> {
        let mut scratch = Scratch::default();
        let ray = PreparedRay::new(ray);
        let hit = self.caster().closest_hit(Traversal::Odf, &ray, &All, &mut (), &mut scratch)?;
        let normal = self.triangles()[hit.triangle as usize].scaled_normal();
        Some(Seen { t: hit.t, triangle: hit.triangle, normal })
    }
}

/// A recording.
#[derive(Debug)]
pub struct Recording {
    pub path: PathBuf,
    pub rays: Rays<'static>,
    /// Number of the scene that the trees are of.
    pub scene: u16,
    /// Size of the traced image, when a tree says it.
    pub image: Option<ImageSize>,
    /// Where its camera stood, when its camera queries say so.
    pub view: Option<View>,
}

/// Everything that a window shows.
#[derive(Debug)]
pub struct Opened {
    /// One or two, over the same triangles.
    pub trees: Vec<Arc<OpenTree>>,
    pub recording: Option<Arc<Recording>>,
    /// Nearly everything: stray triangles far away are left out.
    pub bounds: Aabb,
    pub start: View,
    pub up: Axes,
    /// What a user should know of the files.
    pub warnings: Vec<String>,
}

fn name(path: &Path) -> String {
    path.file_stem().map_or_else(|| path.display().to_string(), |stem| stem.to_string_lossy().into_owned())
}

fn mapped(path: &Path) -> Result<&'static MappedFile, LoadError> {
    Ok(Box::leak(Box::new(MappedFile::open(path)?)))
}

impl Opened {
    /// Opens one or two trees and perhaps a recording, in any order; tells `stage` what it is doing. `image` is the size of the recorded image
    /// where it is not what a tree says, `scene` the scene of the recording where that is asked
    /// for.
    ///
    /// # Errors
    /// When a file cannot be read or is damaged, or files are not of one scene.
    pub fn open(
        paths: &[PathBuf],
        image: Option<ImageSize>,
        scene: Option<u16>,
        stage: &dyn Fn(String),
    ) -> Result<Opened, LoadError> {
        let (mut trees, mut recordings) = (Vec::new(), Vec::new());
        for path in paths {
            stage(format!("reading {}", path.display()));
            match FileKind::of(mapped(path)?) {
                Some(FileKind::Rays) => recordings.push(path),
                // What is neither is refused as a tree: the error says what was found.
                _ => trees.push(Arc::new(OpenTree::open(path)?)),
            }
        }
        if trees.is_empty() || trees.len() > 2 || recordings.len() > 1 {
            return Err(LoadError::Files(
                "expected one or two trees (.bvh) and at most one recording (.rays)",
            ));
        }
        let mut warnings = Vec::new();
        let candidates: Vec<Candidate> = trees
            .iter()
            .map(|tree| Candidate { path: tree.path.display().to_string(), bvh: &tree.bvh })
            .collect();
        let recording = match recordings.first() {
            None => {
                same_scene(&candidates)?;
                None
            }
            Some(path) => {
                let label = path.display().to_string();
                let rays = Rays::parse(mapped(path)?);
                let rays = rays.map_err(|source| LoadError::Format { path: label.clone(), source })?;
                let (scene, warning) = check_scenes(&candidates, &label, &rays, scene)?;
                warnings.extend(warning);
                if let Some(recovery) = &rays.recovery {
                    let (queries, lost) = (recovery.queries, recovery.lost_bytes);
                    warnings
                        .push(format!("recording cut off: {queries} queries recovered, {lost} bytes lost"));
                }
                let image = image.or_else(|| trees.iter().find_map(|tree| image_size(&tree.bvh)));
                let view = image.and_then(|image| recorded_view(&rays, scene, image));
                Some(Arc::new(Recording { path: path.to_path_buf(), rays, scene, image, view }))
            }
        };
        stage("choosing a view".to_owned());
        let first = &trees[0];
        let bounds = main_bounds(first.triangles());
        let up = guess_up(first.triangles(), &bounds);
        let recorded = recording.as_ref().and_then(|recording| recording.view);
        let start = recorded
            .unwrap_or_else(|| Framing::new(&mut &**first, first.triangles(), bounds, up).view(None, 1.5));
        let start = aimed(&mut &**first, upright(start, &up), bounds.extent().length());
        Ok(Opened { trees, recording, bounds, start, up, warnings })
    }

    /// Length of the scene's diagonal.
    pub fn size(&self) -> f32 {
        self.bounds.extent().length().max(f32::MIN_POSITIVE)
    }

    /// The tree of a pane; the last one when there are fewer.
    pub fn tree(&self, number: usize) -> &Arc<OpenTree> {
        &self.trees[number.min(self.trees.len() - 1)]
    }
}

/// Trees without a recording have to be of one scene, too.
fn same_scene(trees: &[Candidate]) -> Result<(), LoadError> {
    match trees {
        [first, second] if first.bvh.header.fingerprint != second.bvh.header.fingerprint => {
            let (path, found) = (second.path.clone(), second.bvh.header.fingerprint);
            let (other, expected) = (first.path.clone(), first.bvh.header.fingerprint);
            Err(CompareError::OtherScene { path, found, other, expected }.into())
        }
        _ => Ok(()),
    }
}

/// The view with the scene's own up, unless it looks along it: then one orbits around what is vertical.
fn upright(view: View, axes: &Axes) -> View {
    let forward = (view.target - view.eye).normalize_or_zero();
    let tilted = view.up.normalize_or_zero().dot(axes.up) < 0.5;
    if tilted || forward.dot(axes.up).abs() > 0.98 { view } else { View { up: axes.up, ..view } }
}

/// The view with its target at the surface in the middle of the image, or half a diagonal away: what one orbits around.
fn aimed(sight: &mut impl Sight, view: View, size: f32) -> View {
    let direction = (view.target - view.eye).normalize_or(crate::geometry::Vec3::NEG_Z);
    let ray = Ray { origin: view.eye, tnear: 0.0, direction, tfar: f32::INFINITY };
    let distance = sight.first(&ray).map_or(0.5 * size, |seen| seen.t);
    View { target: view.eye + direction * distance.max(1e-3 * size), ..view }
}

/// The pinhole camera of a recording's camera queries, fitted to which pixel each of them serves; `None` when they have no common origin,
/// or too few pixels are there.
fn recorded_view(rays: &Rays, scene: u16, image: ImageSize) -> Option<View> {
    let own = |&number: &usize| rays.chunks()[number].info.scene == scene;
    let chunks: Vec<usize> = (0..rays.chunks().len()).filter(own).collect();
    let step = chunks.len().div_ceil(CAMERA_CHUNKS).max(1);
    let mut samples = Vec::new();
    for &number in chunks.iter().step_by(step) {
        let chunk = rays.chunk(number).ok()?;
        let camera = |record: &&crate::format::rays::Record| record.purpose == Purpose::Camera as u8;
        let taken = chunk.records.iter().filter(camera).filter_map(|record| {
            let (x, y) = image.pixel(record.path)?;
            Some(([x as f32 + 0.5, y as f32 + 0.5], record.ray()))
        });
        samples.extend(taken.step_by(7));
    }
    Camera::fitted(&samples, image.width, image.height)
}
