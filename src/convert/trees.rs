//! Trees: ours to and from those of 2011, to arrays of NumPy, and to OBJ.

use super::boxes::{Style, write_boxes, write_triangles};
use super::numbering::Numbering;
use super::{ConvertError, Kind, Losses, bvh_2011, npy};
use crate::format::bvh::{self, Bvh, Contents, flag};
use crate::tree::binary::binary;
use clap::ValueEnum;
use serde_json::json;
use std::io::Write;
use std::ops::RangeInclusive;

/// What of a tree is written where a format holds one thing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Part {
    /// The nodes (.npy)
    Nodes,
    /// The triangles that leaves list (.npy)
    Primitives,
    /// The triangles (.npy, .obj)
    Triangles,
    /// The boxes of nodes (.obj)
    Boxes,
}

impl Part {
    /// What is written of it, in a summary.
    fn unit(self) -> &'static str {
        match self {
            Part::Nodes => "nodes",
            Part::Primitives => "primitives",
            Part::Triangles => "triangles",
            Part::Boxes => "boxes",
        }
    }
}

/// What a caller may choose.
#[derive(Clone, Debug)]
pub struct Options {
    /// Without one: nodes in an array, boxes in an OBJ.
    pub part: Option<Part>,
    /// Levels of the boxes.
    pub levels: RangeInclusive<u32>,
    pub style: Style,
}

/// What was written.
#[derive(Clone, Debug, Default)]
pub struct Converted {
    pub unit: &'static str,
    pub count: u64,
    pub losses: Losses,
    /// What may be wrong with the result, a line each.
    pub warnings: Vec<String>,
}

/// dtypes as NumPy prints them.
const NODE: &str = "[('lower', '<f4', (3,)), ('first', '<u4'), ('upper', '<f4', (3,)), ('count', '<u4')]";
const PRIMITIVE: &str = "'<u4'";
const TRIANGLE: &str = "'<f4'";

/// Writes one of our trees. For a file of 2011, `numbering` says how its scene file numbers triangles; without one, they keep the numbers of `TRIS`.
///
/// # Errors
/// When the output cannot hold it, or cannot be written.
pub fn from_ours(
    bvh: &Bvh,
    to: Kind,
    numbering: Option<&Numbering>,
    options: &Options,
    out: &mut dyn Write,
) -> Result<Converted, ConvertError> {
    let mut losses = Losses::default();
    let default = if to == Kind::Obj { Part::Boxes } else { Part::Nodes };
    let part = options.part.unwrap_or(default);
    let count = match (to, part) {
        (Kind::Bvh2011, _) => return to_2011(bvh, numbering, out),
        (Kind::Obj, Part::Boxes) => {
            let (count, left_out) = write_boxes(out, bvh.tree, &options.levels, options.style)?;
            losses = left_out;
            count
        }
        (Kind::Obj, Part::Triangles) => {
            let (count, lost) = write_triangles(out, bvh)?;
            losses = lost;
            count
        }
        (Kind::Npy, Part::Nodes) => array(out, NODE, "", bvh.tree.nodes)?,
        (Kind::Npy, Part::Primitives) => array(out, PRIMITIVE, "", bvh.tree.primitives)?,
        (Kind::Npy, Part::Triangles) => array(out, TRIANGLE, " 3, 3", bvh.triangles)?,
        (Kind::Obj | Kind::Npy, part) => return Err(ConvertError::Part { part: part.unit(), to: to.name() }),
        _ => return Err(ConvertError::Pair { from: Kind::Bvh.name(), to: to.name() }),
    };
    Ok(Converted { unit: part.unit(), count, losses, warnings: Vec::new() })
}

/// Writes an array; `inner` are its dimensions behind the first.
fn array<T: bytemuck::Pod>(
    out: &mut dyn Write,
    dtype: &str,
    inner: &str,
    elements: &[T],
) -> std::io::Result<u64> {
    out.write_all(&npy::header(dtype, &format!("({},{inner})", elements.len())))?;
    out.write_all(bytemuck::cast_slice(elements))?;
    Ok(elements.len() as u64)
}

fn to_2011(bvh: &Bvh, numbering: Option<&Numbering>, out: &mut dyn Write) -> Result<Converted, ConvertError> {
    let mut losses = Losses::default();
    let mut warnings = Vec::new();
    let binary = (!bvh_2011::is_binary(bvh.tree)).then(|| binary(bvh.tree, bvh.triangles));
    let mut order = bvh.order;
    if let Some(binary) = &binary {
        let (wide, now) = (bvh.tree.nodes.len(), binary.nodes.len());
        warnings.push(format!(
            "made binary, with one triangle a leaf: the format has no wider nodes ({wide} nodes became {now})"
        ));
        // An order is one of the children that a node had.
        losses.lose(
            "order for occlusion queries of a node",
            order.take().map_or(0, |order| order.len() as u64),
        );
    }
    let tree = binary.as_ref().map_or(bvh.tree, |binary| binary.view());
    let contents = Contents {
        tree,
        triangles: bvh.triangles,
        geometries: bvh.geometries,
        order,
        meta: bvh.meta,
        flags: bvh.header.flags,
        producer: &bvh.header.producer,
    };
    let undecided = match numbering {
        Some(numbering) => bvh_2011::write(out, &contents, |triangle| numbering.in_file[triangle as usize])?,
        None => bvh_2011::write(out, &contents, |triangle| triangle)?,
    };
    losses.lose("order of a node, farthest first", undecided);
    losses.lose("META", bvh.meta.is_some().into());
    losses.lose(
        "mask of a geometry",
        bvh.geometries.iter().filter(|geometry| geometry.masks() != [u32::MAX; 2]).count() as u64,
    );
    if numbering.is_none() {
        losses.lose("triangle: only its number in TRIS is written", bvh.triangles.len() as u64);
    }
    Ok(Converted { unit: "nodes", count: tree.nodes.len() as u64, losses, warnings })
}

/// Writes a tree of 2011, over the triangles of its scene, as one of ours.
///
/// # Errors
/// When the input is damaged or names triangles that the scene has not, or the output cannot be written.
pub fn from_2011(
    bytes: &[u8],
    numbering: &Numbering,
    out: &mut dyn Write,
) -> Result<Converted, ConvertError> {
    let mut read = bvh_2011::read(bytes, &numbering.listed())?;
    let in_tree = numbering.in_tree();
    read.tree.primitives.iter_mut().for_each(|primitive| *primitive = in_tree[*primitive as usize]);
    let meta = json!({"converted_from": "RayVisualizer (2011)"}).to_string();
    let contents = Contents {
        tree: read.tree.view(),
        triangles: &numbering.triangles,
        geometries: &numbering.geometries,
        order: read.order.as_deref(),
        meta: Some(&meta),
        flags: if read.duplicates { flag::SPATIAL_SPLITS } else { 0 },
        producer: "RayVisualizer, converted",
    };
    bvh::write(out, &contents)?;

    let mut losses = Losses::default();
    losses.lose("probability of a branch other than 0, 0.5 and 1", read.rounded);
    let mut warnings = Vec::new();
    if read.apart > 0 {
        warnings.push(format!(
            "the boxes of {} leaves do not touch all of their triangles: is this the scene that the tree was built for?",
            read.apart
        ));
    }
    let mut in_leaf = vec![false; numbering.triangles.len()];
    read.tree.primitives.iter().for_each(|&primitive| in_leaf[primitive as usize] = true);
    let missing = in_leaf
        .iter()
        .zip(&numbering.triangles)
        .filter(|(in_leaf, triangle)| !**in_leaf && triangle.is_finite());
    match missing.count() {
        0 => {}
        count => warnings.push(format!(
            "{count} triangles are in no leaf: is this the scene that the tree was built for?"
        )),
    }
    Ok(Converted { unit: "nodes", count: read.tree.nodes.len() as u64, losses, warnings })
}
