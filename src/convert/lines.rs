//! Queries as lines of a Wavefront OBJ, for Blender and MeshLab: an object per purpose and result, a line over each effective segment.
//!
//! The lines are kept until the end, so that each object is written once: choose a sample. A ray that met nothing and has no end is drawn as
//! long as the diagonal of everything else.

use super::{ConvertError, Losses, Sink};
use crate::format::rays::{Chunk, Purpose, Record};
use crate::geometry::{Aabb, Ray};
use std::collections::BTreeMap;
use std::io::Write;

/// What makes two queries members of one object: in this order in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Group {
    purpose: Purpose,
    occlusion: bool,
    hit: bool,
}

impl Group {
    fn of(record: &Record) -> Group {
        let purpose = Purpose::from_byte(record.purpose);
        Group { purpose, occlusion: record.is_occlusion(), hit: record.is_hit() }
    }

    fn name(self) -> String {
        let result = match (self.occlusion, self.hit) {
            (false, true) => "hit",
            (false, false) => "miss",
            (true, true) => "blocked",
            (true, false) => "free",
        };
        format!("{}_{result}", self.purpose.name())
    }
}

/// Writes lines.
pub struct LinesSink<W: Write> {
    out: W,
    /// Effective segments; tfar is +inf where there is no end.
    groups: BTreeMap<Group, Vec<Ray>>,
    /// Around everything that has an end.
    bounds: Aabb,
    losses: Losses,
}

impl<W: Write> LinesSink<W> {
    pub fn new(out: W) -> LinesSink<W> {
        LinesSink { out, groups: BTreeMap::new(), bounds: Aabb::EMPTY, losses: Losses::default() }
    }
}

impl<W: Write> Sink for LinesSink<W> {
    fn write(&mut self, chunk: &Chunk) -> Result<(), ConvertError> {
        for record in chunk.records.iter() {
            let mut ray = record.effective_segment();
            // From the origin where the interval starts before it, or nowhere.
            ray.tnear = ray.tnear.max(0.0);
            let start = ray.at(ray.tnear);
            let end = if ray.tfar < f32::INFINITY { ray.at(ray.tfar) } else { start };
            if !start.is_finite() || !end.is_finite() || ray.direction.try_normalize().is_none() {
                self.losses.leave_out("query that is no line: its start, end or direction is not finite", 1);
                continue;
            }
            self.bounds = self.bounds.grown(start).grown(end);
            self.groups.entry(Group::of(record)).or_default().push(ray);
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Losses, ConvertError> {
        let diagonal = self.bounds.extent().length();
        let endless = if diagonal > 0.0 && diagonal.is_finite() { diagonal } else { 1.0 };
        writeln!(self.out, "# Queries, written by embree-trace: a line each, over its effective segment")?;
        let mut vertex = 1_u64;
        for (group, rays) in &self.groups {
            writeln!(self.out, "o {}", group.name())?;
            for ray in rays {
                let start = ray.at(ray.tnear);
                let end = match ray.tfar < f32::INFINITY {
                    true => ray.at(ray.tfar),
                    false => start + endless * ray.direction.normalize_or_zero(),
                };
                for point in [start, end] {
                    writeln!(self.out, "v {} {} {}", point.x, point.y, point.z)?;
                }
                writeln!(self.out, "l {} {}", vertex, vertex + 1)?;
                vertex += 2;
            }
        }
        self.out.flush()?;
        Ok(self.losses)
    }
}
