//! What a recording of a program brought, as text or JSON: the scenes, what was kept, what was not and why.

use super::capture::{Capture, Kind};
use super::exchange::Counters;
use super::trees::Planting;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;

/// Geometries without triangles, by kind: their queries and hits are kept, and flagged.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(transparent)]
pub struct LeftOut(pub BTreeMap<&'static str, u32>);

impl LeftOut {
    /// Counts those of a scene, and those of its instances as often as they are instanced.
    pub fn of<'a>(top: &'a Capture, captured: impl Fn(u32) -> Option<&'a Capture>) -> LeftOut {
        let mut kinds = BTreeMap::new();
        let mut count = |capture: &Capture| {
            for part in &capture.parts {
                if let Kind::Other { geometry_type } = part.kind {
                    *kinds.entry(kind_name(geometry_type)).or_insert(0) += 1;
                }
            }
        };
        count(top);
        for part in &top.parts {
            if let Kind::Instance { capture, .. } = part.kind
                && let Some(instanced) = captured(capture)
            {
                count(instanced);
            }
        }
        LeftOut(kinds)
    }
}

/// The name of an `RTCGeometryType`.
fn kind_name(geometry_type: u32) -> &'static str {
    match geometry_type {
        121 => "instances of scenes that were not committed",
        122 => "instance arrays",
        2 => "grids",
        8 => "subdivision surfaces",
        15..=71 => "curves and points",
        120 => "user geometries",
        _ => "other geometries",
    }
}

/// One committed scene that was asked something.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SceneLine {
    /// As in the chunks of the `.rays`.
    pub number: u32,
    /// Which of the program's scenes, and its how many-th commit, from 0.
    pub scene: u32,
    pub commit: u32,
    pub queries: u64,
    pub rejects: u64,
    /// Of its tree; `None` without one.
    pub path: Option<String>,
    pub producer: String,
    pub triangles: u64,
    pub instances: u64,
    /// Geometries that move, in the tree as they are at their first time step.
    pub moving: u64,
    pub nodes: u64,
    pub left_out: LeftOut,
    pub warnings: Vec<String>,
}

/// What a recording brought.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// How the program ended: its exit code, or 128 and the signal.
    pub status: i32,
    pub rays: String,
    pub bytes: u64,
    /// Queries that arrived, and those that are in the file.
    pub seen: u64,
    pub records: u64,
    pub rejects: u64,
    pub threads: u32,
    pub processes: u32,
    pub scenes: Vec<SceneLine>,
    /// What was planted; `None` when nothing was to be.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub planting: Option<Planting>,
    pub warnings: Vec<String>,
}

impl Report {
    /// Adds what the counters tell of things that are missing.
    pub fn warn(&mut self, counters: &Counters) {
        let Counters { unrecorded, unnumbered, lost_rejects, interrupted, foreign, .. } = *counters;
        let mut warn = |holds: bool, text: String| {
            if holds {
                self.warnings.push(text);
            }
        };
        warn(
            unrecorded > 0,
            format!(
                "{unrecorded} queries are not recorded: more living threads had asked at a time, or more \
                 rays at once, than there is room for"
            ),
        );
        warn(
            unnumbered > 0,
            format!("{unnumbered} calls are not recorded: their scene could not be captured"),
        );
        warn(
            lost_rejects > 0,
            format!(
                "{lost_rejects} rejects of filters are not recorded: a replay may hit what they rejected"
            ),
        );
        warn(
            interrupted > 0,
            format!(
                "{interrupted} closest-hit queries were ended elsewhere than at their hit, by the program's own \
                 filters or geometries: the hit is recorded where it was found, and not judged, for there \
                 may be closer ones"
            ),
        );
        warn(
            foreign,
            "some calls went to a library that is neither Embree 3 nor Embree 4: they are not recorded"
                .to_owned(),
        );
        if let Some(failure) = &counters.failure {
            self.warnings.push(format!("the recording ended early: {failure}"));
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Report { rays, bytes, seen, records, rejects, threads, processes, .. } = self;
        write!(f, "rays     {rays}: {bytes} bytes, {records} queries")?;
        if records != seen {
            write!(f, " of {seen}")?;
        }
        let plural = |count: u32| if count == 1 { "" } else { "s" };
        writeln!(f, ", {rejects} rejects; {threads} thread{} asked", plural(*threads))?;
        if *processes > 1 {
            writeln!(f, "{:<9}of {processes} processes", "")?;
        }
        for scene in &self.scenes {
            let SceneLine {
                number,
                scene: which,
                commit,
                queries,
                path,
                producer,
                triangles,
                instances,
                moving,
                nodes,
                ..
            } = scene;
            writeln!(f, "scene {number:<2} {queries} queries; the program's scene {which}, commit {commit}")?;
            if let Some(path) = path {
                write!(f, "{:<9}{path}: {producer}, {nodes} nodes over {triangles} triangles", "")?;
                if *instances > 0 {
                    write!(f, ", {instances} instance{} flattened", plural(*instances as u32))?;
                }
                writeln!(f)?;
            }
            if *moving > 0 {
                let plural = if *moving == 1 { "y" } else { "ies" };
                writeln!(
                    f,
                    "{:<9}{moving} moving geometr{plural}: as at the first time step, under a tree of ours; their hits are not judged",
                    ""
                )?;
            }
            for (kind, count) in &scene.left_out.0 {
                writeln!(f, "{:<9}left out of the tree: {count} {kind}", "")?;
            }
        }
        Ok(())
    }
}
