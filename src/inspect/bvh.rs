//! The summary of a `.bvh`: header, sections, what the tree looks like, geometries, how it was built.

use super::histogram::{Bin, Histogram, by_number};
use super::text::{self, grouped};
use crate::format::FormatError;
use crate::format::bvh::{Bvh, NO_INSTANCE, Verified, flag, geometry_flag, geometry_kind};
use crate::geometry::Aabb;
use crate::tree::statistics::sah_cost;
use serde::Serialize;
use std::fmt::{self, Formatter};

/// Geometries that the text shows; JSON has them all.
const SHOWN_GEOMETRIES: usize = 16;
/// Leaves of at least this many primitives share a row of the histogram.
const LARGE_LEAF: usize = 64;
/// Costs of a box test and of a primitive test in the SAH cost that is shown.
const COSTS: (f64, f64) = (1.0, 1.0);

/// An entry of the section table.
#[derive(Clone, Debug, Serialize)]
pub struct Section {
    pub tag: String,
    pub element_bytes: u32,
    pub offset: u64,
    pub count: u64,
    pub bytes: u64,
    /// 16 hexadecimal digits.
    pub checksum: String,
}

/// A geometry of the scene.
#[derive(Clone, Debug, Serialize)]
pub struct Geometry {
    /// Absent when it is not instanced.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instance: Option<u32>,
    pub geometry: u32,
    pub kind: &'static str,
    pub first_triangle: u32,
    pub triangle_count: u32,
    pub mask: u32,
    /// The mask of its instance, where a query needs a bit of each; absent where the one mask says
    /// all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instance_mask: Option<u32>,
}

/// Everything that is shown of a `.bvh`.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// 16 hexadecimal digits.
    pub fingerprint: String,
    pub producer: String,
    pub file_bytes: u64,
    pub flags: Vec<&'static str>,
    pub lower: [f32; 3],
    pub upper: [f32; 3],
    pub sections: Vec<Section>,
    pub nodes: usize,
    pub inner_nodes: usize,
    pub leaves: usize,
    pub depth: usize,
    /// As the header has it: the width of the tree.
    pub width: u32,
    /// The most children that a node has.
    pub max_children: usize,
    pub max_leaf: usize,
    pub mean_children: f64,
    pub mean_leaf: f64,
    /// Entries of leaves, more than the triangles when some stand in several leaves.
    pub primitives: usize,
    pub triangles: usize,
    pub triangles_not_finite: usize,
    pub triangles_without_area: usize,
    /// With the costs of a box test and of a primitive test both 1.
    pub sah_cost: f64,
    pub has_order: bool,
    pub geometries: Vec<Geometry>,
    /// The JSON of `META`, or its text where that is not JSON.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub meta: Option<serde_json::Value>,
    /// What the checks of `--verify` counted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub verified: Option<VerifiedCounts>,
    pub histograms: Vec<Histogram>,
}

/// [`Verified`], for JSON.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct VerifiedCounts {
    pub duplicates: usize,
    pub not_finite: usize,
}

impl Summary {
    /// Reads and counts a whole file.
    ///
    /// # Errors
    /// When the file is damaged; with `verify` also when [`Bvh::verify`] fails.
    pub fn of(bytes: &[u8], verify: bool) -> Result<Summary, FormatError> {
        let bvh = Bvh::parse(bytes)?;
        let verified = if verify { Some(bvh.verify()?) } else { None };
        Ok(Summary::new(&bvh, bytes.len() as u64, verified))
    }

    fn new(bvh: &Bvh, file_bytes: u64, verified: Option<Verified>) -> Summary {
        let statistics = bvh.statistics;
        let inner_nodes = statistics.nodes - statistics.leaves;
        let Aabb { lower, upper } = bvh.header.bounds;
        let mean = |sum: usize, count: usize| if count == 0 { 0.0 } else { sum as f64 / count as f64 };
        let finite = bvh.triangles.iter().filter(|triangle| triangle.is_finite()).count();
        let no_area = |triangle: &&crate::geometry::Triangle| {
            triangle.is_finite() && triangle.scaled_normal().length_squared() == 0.0
        };
        Summary {
            fingerprint: format!("{:016x}", bvh.header.fingerprint),
            producer: bvh.header.producer.clone(),
            file_bytes,
            flags: flag_names(bvh.header.flags),
            lower: lower.to_array(),
            upper: upper.to_array(),
            sections: sections(bvh),
            nodes: statistics.nodes,
            inner_nodes,
            leaves: statistics.leaves,
            depth: statistics.depth,
            width: bvh.header.max_children,
            max_children: statistics.max_children,
            max_leaf: statistics.max_leaf,
            // Every node but the root is one inner node's child.
            mean_children: mean(statistics.nodes - 1, inner_nodes),
            mean_leaf: mean(bvh.tree.primitives.len(), statistics.leaves),
            primitives: bvh.tree.primitives.len(),
            triangles: bvh.triangles.len(),
            triangles_not_finite: bvh.triangles.len() - finite,
            triangles_without_area: bvh.triangles.iter().filter(no_area).count(),
            sah_cost: sah_cost(bvh.tree, COSTS.0, COSTS.1),
            has_order: bvh.order.is_some(),
            geometries: bvh.geometries.iter().map(geometry).collect(),
            meta: bvh.meta.map(|meta| serde_json::from_str(meta).unwrap_or_else(|_| meta.into())),
            verified: verified
                .map(|Verified { duplicates, not_finite }| VerifiedCounts { duplicates, not_finite }),
            histograms: histograms(bvh),
        }
    }
}

fn flag_names(flags: u32) -> Vec<&'static str> {
    let names = [
        (flag::SPATIAL_SPLITS, "spatial splits"),
        (flag::FLATTENED, "instances flattened"),
        (flag::LIVE, "Embree's live memory"),
        (flag::BUILDER, "rtcBuildBVH"),
    ];
    names.iter().filter(|(bit, _)| flags & bit != 0).map(|(_, name)| *name).collect()
}

fn sections(bvh: &Bvh) -> Vec<Section> {
    let section = |section: &crate::format::bvh::Section| Section {
        tag: section.tag.escape_ascii().to_string(),
        element_bytes: section.element_bytes,
        offset: section.offset,
        count: section.count,
        bytes: section.bytes(),
        checksum: format!("{:016x}", section.checksum),
    };
    bvh.sections.iter().map(section).collect()
}

fn geometry(geometry: &crate::format::bvh::Geometry) -> Geometry {
    let (quads, moving) =
        (geometry.kind == geometry_kind::QUADS, geometry.flags & geometry_flag::MOVING != 0);
    Geometry {
        instance: Some(geometry.instance).filter(|&instance| instance != NO_INSTANCE),
        geometry: geometry.geometry,
        kind: match (quads, moving) {
            (false, false) => "triangles",
            (true, false) => "quads",
            (false, true) => "moving triangles",
            (true, true) => "moving quads",
        },
        first_triangle: geometry.first_triangle,
        triangle_count: geometry.triangle_count,
        mask: geometry.mask,
        instance_mask: (geometry.flags & geometry_flag::INSTANCE_MASK != 0).then_some(geometry.instance_mask),
    }
}

fn histograms(bvh: &Bvh) -> Vec<Histogram> {
    let mut leaf_sizes = [0; LARGE_LEAF + 1];
    let mut children = vec![0; bvh.statistics.max_children.min(LARGE_LEAF) + 1];
    let mut leaf_depths = vec![0; bvh.statistics.depth + 1];
    let mut level = vec![1u32; bvh.tree.nodes.len()];
    for (index, node) in bvh.tree.nodes.iter().enumerate() {
        if node.is_leaf() {
            leaf_sizes[node.len().min(LARGE_LEAF)] += 1;
            leaf_depths[level[index] as usize] += 1;
            continue;
        }
        children[node.len().min(LARGE_LEAF)] += 1;
        for child in node.range() {
            level[child] = level[index] + 1;
        }
    }
    let mut sizes = by_number("primitives per leaf", &leaf_sizes[..LARGE_LEAF], 0);
    if leaf_sizes[LARGE_LEAF] > 0 {
        sizes.bins.push(Bin::named(format!("{LARGE_LEAF} and more"), leaf_sizes[LARGE_LEAF]));
    }
    let mut all = vec![
        sizes,
        by_number("depth of leaves", &leaf_depths, 0),
        by_number("children per inner node", &children, 0),
    ];
    if let Some(order) = bvh.order {
        let names = ["nearest first", "first child first", "last child first", "farthest first"];
        let count = |value: usize| order.iter().filter(|&&order| usize::from(order) == value).count() as u64;
        let bins = names.iter().enumerate().map(|(value, name)| Bin::named(*name, count(value))).collect();
        all.push(Histogram { name: "traversal order for occlusion, nodes", bins });
    }
    all
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        let number = |count: usize| grouped(count as u64);
        writeln!(f, "tree with its triangles (.bvh version 1)")?;
        text::line(f, "producer", &self.producer)?;
        text::line(f, "scene fingerprint", &self.fingerprint)?;
        text::line(
            f,
            "flags",
            if self.flags.is_empty() { "none".to_string() } else { self.flags.join(", ") },
        )?;
        text::line(f, "file", text::bytes(self.file_bytes))?;
        if let Some(VerifiedCounts { duplicates, not_finite }) = self.verified {
            let (again, unheld) = (number(duplicates), number(not_finite));
            text::line(
                f,
                "verified",
                format!("boxes, leaves and META; {again} duplicates, {unheld} triangles in no leaf"),
            )?;
        }
        text::line(f, "bounds", format!("{:?} to {:?}", self.lower, self.upper))?;
        let (inner, leaves) = (number(self.inner_nodes), number(self.leaves));
        text::line(f, "nodes", format!("{} ({inner} inner, {leaves} leaves)", number(self.nodes)))?;
        let (width, mean) = (self.width, self.mean_children);
        text::line(
            f,
            "children",
            format!("at most {}, {mean:.2} on average ({width} wide)", self.max_children),
        )?;
        text::line(
            f,
            "primitives per leaf",
            format!("at most {}, {:.2} on average", number(self.max_leaf), self.mean_leaf),
        )?;
        text::line(f, "depth", number(self.depth))?;
        text::line(f, "primitives", number(self.primitives))?;
        let (odd, flat) = (number(self.triangles_not_finite), number(self.triangles_without_area));
        text::line(
            f,
            "triangles",
            format!("{} ({odd} not finite, {flat} without area)", number(self.triangles)),
        )?;
        text::line(f, "SAH cost", format!("{:.4} (c_I = c_P = 1)", self.sah_cost))?;
        if let Some(meta) = &self.meta {
            text::line(f, "built with", meta)?;
        }

        writeln!(
            f,
            "\n  {:<8}{:>15} {:>8} {:>15} {:>15}  checksum",
            "section", "elements", "each", "bytes", "offset"
        )?;
        for section in &self.sections {
            let Section { tag, element_bytes, offset, count, bytes, checksum } = section;
            let (count, bytes, offset) = (grouped(*count), grouped(*bytes), grouped(*offset));
            writeln!(f, "  {tag:<8}{count:>15} {element_bytes:>8} {bytes:>15} {offset:>15}  {checksum}")?;
        }

        writeln!(
            f,
            "\n  {:<10}{:>10} {:>10} {:>15} {:>15} {:>10}",
            "geometry", "instance", "kind", "first triangle", "triangles", "mask"
        )?;
        for geometry in self.geometries.iter().take(SHOWN_GEOMETRIES) {
            let instance = geometry.instance.map_or("-".to_string(), |instance| instance.to_string());
            let (first, count) =
                (grouped(geometry.first_triangle.into()), grouped(geometry.triangle_count.into()));
            let (number, kind, mask) = (geometry.geometry, geometry.kind, geometry.mask);
            write!(f, "  {number:<10}{instance:>10} {kind:>10} {first:>15} {count:>15} {mask:#10x}")?;
            match geometry.instance_mask {
                Some(instances) => writeln!(f, ", of its instance {instances:#x}")?,
                None => writeln!(f)?,
            }
        }
        if self.geometries.len() > SHOWN_GEOMETRIES {
            writeln!(f, "  … and {} more", self.geometries.len() - SHOWN_GEOMETRIES)?;
        }
        self.histograms.iter().try_for_each(|histogram| text::histogram(f, histogram))
    }
}
