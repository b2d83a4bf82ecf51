//! Records a sequence: frames of one moving mesh, seen by one camera, each into a pair of files of its own.
//!
//! The first frame makes the scene, and chooses camera and lights; each other one gives its vertices to the same scene of
//! Embree, which refits its tree or builds anew. Every frame is then recorded as a single scene is, with the same random
//! numbers, so that two frames differ in what moved only. Trees that are planted are planted anew
//! after each commit.

use crate::embree::{EmbreeError, Scene, Settings, TreeSource};
use crate::files::{self, FileError};
use crate::format::rays::Codec;
use crate::mesh::frames::{FrameError, Pattern};
use crate::mesh::{self, MeshError, Warnings, obj};
use crate::plant::{self, PlantError, PlantedLine};
use crate::progress::Progress;
use crate::render::Job;
use crate::render::camera::CameraError;
use crate::render::pair::{Pair, PairError, Started};
use crate::render::queries::Tally;
use crate::render::scenery::{Scenery, Wishes};
use crate::render::summary::{FrameLine, Seconds, Summary, camera_option, lights_name, query_lines};
use crate::render::tiles::Tiles;
use crate::render::workers::{Rendered, render};
use std::path::{Path, PathBuf};
use std::time::Instant;
use thiserror::Error;

/// What to record.
#[derive(Clone, Debug)]
pub struct Sequence<'a> {
    /// The frames, in their order; at least one.
    pub files: &'a [PathBuf],
    /// Made when it is not there; gets `0000.rays`, `0000.bvh`, `0001.rays`, …
    pub directory: &'a Path,
    pub options: obj::Options,
    /// With the commit of frames behind the first.
    pub settings: &'a Settings,
    pub job: Job,
    pub wishes: Wishes,
    pub source: TreeSource,
    pub codec: Codec,
    /// Trees to be planted, as [`plant::Frames`] takes them.
    pub trees: Option<&'a Path>,
}

/// Why a sequence ended early. The frames before are recorded.
#[derive(Debug, Error)]
pub enum SequenceError {
    #[error("a sequence has at least one frame")]
    NoFrames,
    #[error(transparent)]
    Mesh(#[from] MeshError),
    #[error(transparent)]
    Frame(#[from] FrameError),
    #[error(transparent)]
    File(#[from] FileError),
    #[error(transparent)]
    Embree(#[from] EmbreeError),
    #[error(transparent)]
    Camera(#[from] CameraError),
    #[error(transparent)]
    Pair(#[from] PairError),
    #[error(transparent)]
    Plant(#[from] PlantError),
}

impl Sequence<'_> {
    /// Records all frames.
    ///
    /// # Errors
    /// What is wrong with the first frame that cannot be read, or is none of the same mesh, or cannot be recorded; files
    /// that are not there, and a directory that is not empty, are known before anything is recorded.
    pub fn record(&self) -> Result<Summary, SequenceError> {
        let first = self.files.first().ok_or(SequenceError::NoFrames)?;
        for file in self.files {
            files::check_readable(file)?;
        }
        let mut clock = Clock::start();
        let (mesh, warnings) = mesh::read_with(first, &self.options)?;
        let mut seconds = Seconds { read: clock.lap(), ..Seconds::default() };
        let mut summary = Summary::new(&self.job);
        summary.scene = first.display().to_string();
        (summary.triangles, summary.parts) = (mesh.triangle_count() as u64, mesh.parts.len() as u64);
        let mut heard = Heard::default();
        heard.add(first, &warnings, &mut summary.warnings);

        files::create_empty_directory(self.directory)?;
        let mut settings = self.settings.clone();
        summary.warnings.extend(settings.suit(&mesh.vertices));
        let mut scene = Scene::new(&mesh, &settings)?;
        let mut plants = Plants { trees: self.trees.map(plant::Frames::new), heard: None };
        let mut planted = plants.plant(&mut scene, 0, self.digits(), &mut summary.warnings)?;
        seconds.build = clock.lap();
        let (triangles, _) = scene.triangles();
        let size = [self.job.width, self.job.height];
        let mut scenery = Scenery::new(&mesh, triangles, &mut scene.intersector()?, &self.wishes, size)?;
        (summary.camera, summary.fov_degrees) = (camera_option(&scenery.view), scenery.view.fov_degrees);
        summary.lights = lights_name(&scenery.lights);
        seconds.frame = clock.lap();

        let pattern = Pattern::of(mesh);
        let progress = Progress::new("recording", Tiles::new(&self.job).len() * self.files.len() as u64);
        let mut tally = Tally::default();
        for (number, file) in self.files.iter().enumerate() {
            if number > 0 {
                clock = Clock::start();
                let (vertices, warnings) = pattern.read(file, &self.options)?;
                heard.add(file, &warnings, &mut summary.warnings);
                seconds = Seconds { read: clock.lap(), ..Seconds::default() };
                scene.update(&vertices)?;
                scenery.shapes.replace(scene.triangles().0);
                planted = plants.plant(&mut scene, number, self.digits(), &mut summary.warnings)?;
                seconds.build = clock.lap();
            }
            let (mut line, rendered) =
                self.record_frame(number, file, &scene, &scenery, seconds, &progress)?;
            line.planted = planted.take();
            summary.warnings.extend(line.warning.iter().map(|line| format!("{}: {line}", file.display())));
            summary.seconds.add(&line.seconds);
            summary.frames.push(line);
            tally.add(&rendered.tally);
            summary.refused += rendered.refused;
        }
        summary.queries = query_lines(&tally);
        summary.queries_per_second = tally.total().queries as f64 / summary.seconds.render;
        Ok(summary)
    }

    /// As many digits as the last frame needs: the order of the names is that of the frames.
    fn digits(&self) -> usize {
        (self.files.len() - 1).to_string().len().max(4)
    }

    /// Records the scene as it is committed now. `seconds` are those spent on the frame so far.
    fn record_frame(
        &self,
        number: usize,
        file: &Path,
        scene: &Scene,
        scenery: &Scenery,
        mut seconds: Seconds,
        progress: &Progress,
    ) -> Result<(FrameLine, Rendered), SequenceError> {
        let mut clock = Clock::start();
        let (of, digits) = (self.files.len(), self.digits());
        let path = |ending: &str| self.directory.join(format!("{number:0digits$}.{ending}"));
        let (rays, bvh) = (path("rays"), path("bvh"));
        let pair = Pair { rays: &rays, bvh: &bvh, codec: self.codec, source: self.source };
        let commit = self.settings.commit.name();
        let file = file.display().to_string();
        let meta = serde_json::json!({
            "image": [self.job.width, self.job.height],
            "frame": { "number": number, "of": of, "file": file, "commit": commit },
        });
        let Started { recorder, tree, warning } = pair.start(scene, &meta, self.job.threads)?;
        seconds.tree = clock.lap();
        let rendered = render(scene, scenery, &self.job, Some(&recorder), progress)?;
        let rays = pair.finish(recorder)?;
        seconds.render = clock.lap();
        let line =
            FrameLine { number: number as u64, file, commit, tree, planted: None, rays, seconds, warning };
        Ok((line, rendered))
    }
}

/// What is planted in the frames.
struct Plants<'a> {
    trees: Option<plant::Frames<'a>>,
    /// Why the last one was left out: the same of each frame is worth one mention.
    heard: Option<String>,
}

impl Plants<'_> {
    fn plant(
        &mut self,
        scene: &mut Scene,
        number: usize,
        digits: usize,
        warnings: &mut Vec<String>,
    ) -> Result<Option<PlantedLine>, PlantError> {
        let Some(trees) = &mut self.trees else { return Ok(None) };
        match trees.plant(scene, number, digits)? {
            plant::Outcome::Planted(line) => Ok(Some(line)),
            plant::Outcome::LeftOut(warning) => {
                if self.heard.as_ref() != Some(&warning) {
                    warnings.push(format!("frame {number}: {warning}"));
                    self.heard = Some(warning);
                }
                Ok(None)
            }
        }
    }
}

/// Time from lap to lap.
struct Clock(Instant);

impl Clock {
    fn start() -> Clock {
        Clock(Instant::now())
    }

    /// Seconds since the last lap.
    fn lap(&mut self) -> f64 {
        std::mem::replace(&mut self.0, Instant::now()).elapsed().as_secs_f64()
    }
}

/// What readers said of the frames: the same of each is worth one mention.
#[derive(Default)]
struct Heard(Option<String>);

impl Heard {
    fn add(&mut self, file: &Path, warnings: &Warnings, lines: &mut Vec<String>) {
        let text = warnings.to_string();
        if self.0.as_ref() != Some(&text) {
            lines.extend(text.lines().map(|line| format!("{}: {line}", file.display())));
            self.0 = Some(text);
        }
    }
}
