//! What is said at the end of a run, for people and for machines.

use crate::format::rays::{Purpose, Totals};
use crate::plant::PlantedLine;
use crate::render::camera::View;
use crate::render::job::Job;
use crate::render::lights::Lights;
use crate::render::queries::{Count, Tally};
use crate::tree::TreeView;
use crate::tree::statistics::{Statistics, sah_cost};
use serde::Serialize;
use std::fmt;

/// Everything that is said at the end of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    pub scene: String,
    pub triangles: u64,
    pub parts: u64,
    pub integrator: &'static str,
    pub width: u32,
    pub height: u32,
    pub samples: u32,
    pub threads: usize,
    /// As `--camera` takes it.
    pub camera: String,
    pub fov_degrees: f32,
    pub lights: &'static str,
    pub queries: Vec<QueryLine>,
    pub refused: u64,
    pub seconds: Seconds,
    pub queries_per_second: f64,
    /// The tree that was traversed in place of Embree's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub planted: Option<PlantedLine>,
    pub tree: Option<TreeLine>,
    pub rays: Option<RaysLine>,
    /// Of a sequence: each frame; everything else is then of the first frame, or the sum over all.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub frames: Vec<FrameLine>,
    pub image: Option<String>,
    pub warnings: Vec<String>,
}

/// Queries of one kind and purpose.
#[derive(Clone, Debug, Serialize)]
pub struct QueryLine {
    pub kind: &'static str,
    pub purpose: &'static str,
    pub queries: u64,
    pub hits: u64,
}

/// Where the time went.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Seconds {
    /// Reading the scene file.
    pub read: f64,
    /// Embree's build, or commit of other vertices.
    pub build: f64,
    /// Reading Embree's tree and writing the `.bvh`.
    pub tree: f64,
    /// Choosing camera and lights.
    pub frame: f64,
    /// Asking, shading, recording.
    pub render: f64,
}

impl Seconds {
    pub fn add(&mut self, other: &Seconds) {
        self.read += other.read;
        self.build += other.build;
        self.tree += other.tree;
        self.frame += other.frame;
        self.render += other.render;
    }
}

/// One frame of a sequence.
#[derive(Clone, Debug, Serialize)]
pub struct FrameLine {
    /// From 0.
    pub number: u64,
    pub file: String,
    /// How frames behind the first are committed.
    pub commit: &'static str,
    pub tree: TreeLine,
    /// The tree that was traversed in place of Embree's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub planted: Option<PlantedLine>,
    pub rays: RaysLine,
    /// `build` is the commit, and planting.
    pub seconds: Seconds,
    /// About the tree; it is among those of the summary, too.
    #[serde(skip)]
    pub warning: Option<String>,
}

/// The tree that was written.
#[derive(Clone, Debug, Serialize)]
pub struct TreeLine {
    pub path: String,
    pub bytes: u64,
    pub producer: String,
    pub nodes: u64,
    pub leaves: u64,
    pub depth: u64,
    pub max_children: u64,
    pub max_leaf: u64,
    pub sah_cost: f64,
}

impl TreeLine {
    pub fn new(path: String, bytes: u64, producer: String, tree: TreeView) -> TreeLine {
        let statistics = Statistics::of(tree);
        TreeLine {
            path,
            bytes,
            producer,
            nodes: statistics.nodes as u64,
            leaves: statistics.leaves as u64,
            depth: statistics.depth as u64,
            max_children: statistics.max_children as u64,
            max_leaf: statistics.max_leaf as u64,
            sah_cost: sah_cost(tree, 1.0, 1.0),
        }
    }
}

/// The recording that was written.
#[derive(Clone, Debug, Serialize)]
pub struct RaysLine {
    pub path: String,
    pub bytes: u64,
    pub chunks: u64,
    pub records: u64,
}

impl RaysLine {
    pub fn new(path: String, totals: &Totals) -> RaysLine {
        RaysLine { path, bytes: totals.bytes, chunks: totals.chunks, records: totals.records }
    }
}

/// The lines of a tally that are not empty.
pub fn query_lines(tally: &Tally) -> Vec<QueryLine> {
    let mut lines = Vec::new();
    for (kind, counts) in [("closest_hit", &tally.closest_hit), ("occlusion", &tally.occlusion)] {
        for purpose in Purpose::ALL {
            let Count { queries, hits } = counts[purpose as usize];
            if queries > 0 {
                lines.push(QueryLine { kind, purpose: purpose.name(), queries, hits });
            }
        }
    }
    lines
}

/// A view as `--camera` takes it.
pub fn camera_option(view: &View) -> String {
    let triple = |v: crate::geometry::Vec3| format!("{},{},{}", v.x, v.y, v.z);
    format!("{}/{}/{}", triple(view.eye), triple(view.target), triple(view.up))
}

/// What lights the scene, in a word or three.
pub fn lights_name(lights: &Lights) -> &'static str {
    match (lights.has_emitters(), lights.has_panel()) {
        (true, _) => "emitters",
        (false, true) => "sky, sun and panel",
        (false, false) => "sky and sun",
    }
}

impl Summary {
    /// A summary of a run of `job`, with the fields that others fill left empty.
    pub fn new(job: &Job) -> Summary {
        Summary {
            scene: String::new(),
            triangles: 0,
            parts: 0,
            integrator: job.integrator.name(),
            width: job.width,
            height: job.height,
            samples: job.samples,
            threads: job.threads,
            camera: String::new(),
            fov_degrees: 0.0,
            lights: "",
            queries: Vec::new(),
            refused: 0,
            seconds: Seconds::default(),
            queries_per_second: 0.0,
            planted: None,
            tree: None,
            rays: None,
            frames: Vec::new(),
            image: None,
            warnings: Vec::new(),
        }
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let more = match self.frames.len() {
            0 | 1 => String::new(),
            count => format!(" and {} more frames", count - 1),
        };
        writeln!(f, "scene    {}{more}: {} triangles in {} parts", self.scene, self.triangles, self.parts)?;
        writeln!(f, "camera   {} --fov {}", self.camera, self.fov_degrees)?;
        writeln!(f, "lights   {}", self.lights)?;
        let Seconds { read, build, tree, frame, render } = self.seconds;
        writeln!(
            f,
            "image    {} x {}, {} samples per pixel, {}, {} thread{}",
            self.width,
            self.height,
            self.samples,
            self.integrator,
            self.threads,
            if self.threads == 1 { "" } else { "s" }
        )?;
        writeln!(f, "{:<9}{:<12} {:<9} {:>14} {:>8}", "queries", "kind", "purpose", "number", "hit")?;
        let mut total = Count::default();
        for line in &self.queries {
            let QueryLine { kind, purpose, queries, hits } = line;
            let kind = kind.replace('_', " ");
            writeln!(f, "{:<9}{kind:<12} {purpose:<9} {queries:>14} {:>7.2}%", "", percent(*hits, *queries))?;
            total.add(Count { queries: *queries, hits: *hits });
        }
        let Count { queries, hits } = total;
        writeln!(f, "{:<9}{:<22} {queries:>14} {:>7.2}%", "", "all", percent(hits, queries))?;
        if self.refused > 0 {
            writeln!(
                f,
                "refused  {} queries that Embree cannot take (not finite, or huge); answered as misses, not recorded",
                self.refused
            )?;
        }
        writeln!(f, "rate     {:.3} million queries/s", self.queries_per_second / 1e6)?;
        writeln!(
            f,
            "seconds  read {read:.3}, build {build:.3}, tree {tree:.3}, camera {frame:.3}, render {render:.3}"
        )?;
        if let Some(planted) = &self.planted {
            let PlantedLine { path, nodes, blocks, width, seconds, .. } = planted;
            writeln!(
                f,
                "planted  {path}: {nodes} nodes of up to {width} children, {blocks} blocks, in {seconds:.3} s"
            )?;
        }
        if let Some(tree) = &self.tree {
            let TreeLine { path, bytes, producer, nodes, leaves, depth, max_children, max_leaf, sah_cost } =
                tree;
            writeln!(f, "tree     {path}: {bytes} bytes, {producer}")?;
            writeln!(
                f,
                "{:<9}{nodes} nodes, {leaves} leaves of at most {max_leaf}, {max_children} wide, depth {depth}, SAH cost {sah_cost:.2}",
                ""
            )?;
        }
        if let Some(RaysLine { path, bytes, chunks, records }) = &self.rays {
            writeln!(f, "rays     {path}: {bytes} bytes, {records} queries in {chunks} chunks")?;
        }
        self.write_frames(f)?;
        if let Some(image) = &self.image {
            writeln!(f, "picture  {image}")?;
        }
        Ok(())
    }
}

impl Summary {
    /// A line a frame, under a line about all trees.
    fn write_frames(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Some(first) = self.frames.first() else { return Ok(()) };
        writeln!(f, "trees    {}, commit {}", first.tree.producer, first.commit)?;
        let planted: Vec<&PlantedLine> =
            self.frames.iter().filter_map(|frame| frame.planted.as_ref()).collect();
        if let Some(PlantedLine { path, .. }) = planted.first() {
            let seconds: f64 = planted.iter().map(|line| line.seconds).sum();
            writeln!(
                f,
                "planted  {path} and what follows it, in {} of {} frames, in {seconds:.3} s",
                planted.len(),
                self.frames.len()
            )?;
        }
        writeln!(
            f,
            "{:<9}{:>6} {:>12} {:>10} {:>9} {:>9} {:>9}  recording",
            "frames", "number", "queries", "nodes", "SAH cost", "commit s", "render s"
        )?;
        for FrameLine { number, file, tree, rays, seconds, .. } in &self.frames {
            writeln!(
                f,
                "{:<9}{number:>6} {:>12} {:>10} {:>9.2} {:>9.4} {:>9.3}  {} of {file}",
                "", rays.records, tree.nodes, tree.sah_cost, seconds.build, seconds.render, rays.path
            )?;
        }
        Ok(())
    }
}

fn percent(part: u64, whole: u64) -> f64 {
    if whole == 0 { 0.0 } else { 100.0 * part as f64 / whole as f64 }
}
