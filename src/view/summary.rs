//! What a window shows, for machines.

use super::load::OpenTree;
use super::shared::Shared;
use crate::geometry::Vec3;
use serde::Serialize;
use std::sync::Arc;

/// A tree that was opened.
#[derive(Debug, Serialize)]
pub struct TreeSummary {
    pub path: String,
    pub triangles: usize,
    pub nodes: usize,
    /// Levels; a lone root has one.
    pub depth: usize,
    /// The node that the window shows.
    pub node: u32,
    /// Nanoseconds that a query is expected to take, when a recording is there, and that relative
    /// to the first tree.
    pub cost: Option<f64>,
    pub cost_ratio: Option<f64>,
    /// Γ per query on average, and relative to the first tree; that only between trees of one
    /// width.
    pub gamma: Option<f64>,
    pub gamma_ratio: Option<f64>,
}

/// A recording that was opened.
#[derive(Debug, Serialize)]
pub struct RecordingSummary {
    pub path: String,
    pub queries: u64,
    /// Queries that the numbers in the window count.
    pub counted: u64,
}

/// Everything.
#[derive(Debug, Serialize)]
pub struct Summary {
    pub trees: Vec<TreeSummary>,
    pub recording: Option<RecordingSummary>,
    pub traversal: &'static str,
    pub eye: [f32; 3],
    pub target: [f32; 3],
    pub up: [f32; 3],
    pub fov_degrees: f32,
    pub warnings: Vec<String>,
}

impl Summary {
    pub fn of(shared: &Shared) -> Summary {
        let opened = &shared.opened;
        let tree = |(number, tree): (usize, &Arc<OpenTree>)| TreeSummary {
            path: tree.path.display().to_string(),
            triangles: tree.triangles().len(),
            nodes: tree.bvh.tree.nodes.len(),
            depth: tree.bvh.statistics.depth,
            node: shared.cursors[number].node(),
            cost: shared.cost(number),
            cost_ratio: shared.cost_ratio(number),
            gamma: shared.results[number].shares.as_ref().map(|shares| shares.mean_gamma()),
            gamma_ratio: shared.gamma_ratio(number),
        };
        let counted = shared.results.iter().filter_map(|results| results.shares.as_ref());
        let recording = opened.recording.as_ref().map(|recording| RecordingSummary {
            path: recording.path.display().to_string(),
            queries: recording.rays.query_count(),
            counted: counted.map(|shares| shares.counted.queries).min().unwrap_or(0),
        });
        let view = shared.camera.view;
        let array = |v: Vec3| v.to_array();
        Summary {
            trees: opened.trees.iter().enumerate().map(tree).collect(),
            recording,
            traversal: shared.traversal.key(),
            eye: array(view.eye),
            target: array(view.target),
            up: array(view.up),
            fov_degrees: view.fov_degrees,
            warnings: opened.warnings.clone(),
        }
    }
}
