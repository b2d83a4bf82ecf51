//! A committed scene and the scenes that it instances -> one tree over triangles in world space.
//!
//! The tree is the top-level one with each instance leaf replaced by the instanced tree. Boxes are transformed in double
//! precision and rounded outward, vertices in the same order of operations and rounded to the nearest: so a box holds what it
//! held before. Where a tree of the program's could not be read, a binned one of ours is built instead, and the report says so.

use super::capture::{Capture, INSTANCE, Kind, Part};
use crate::builder::{self, BuildError};
use crate::format::bvh::{Geometry, NO_INSTANCE, flag, geometry_kind};
use crate::geometry::{Aabb, Triangle, Vec3};
use crate::progress::Progress;
use crate::tree::{Node, Tree};
use std::collections::HashMap;
use thiserror::Error;

/// Why a scene has no `.bvh`.
#[derive(Debug, Error)]
pub enum FlattenError {
    #[error(
        "it has {found} triangles once its {instances} instances are flattened, more than --max-triangles {limit}"
    )]
    TooLarge { found: u32, instances: usize, limit: u32 },
    #[error("instance {0} is of a scene that is not known")]
    Unknown(u32),
    #[error("instance {0} is of a scene that has another number of triangles than when it was committed")]
    Changed(u32),
    #[error("instance {0} is of a scene with instances of its own")]
    Nested(u32),
    #[error("{0}")]
    Build(#[from] BuildError),
}

/// What goes into a `.bvh`.
#[derive(Debug)]
pub struct Flattened {
    pub tree: Tree,
    pub triangles: Vec<Triangle>,
    pub geometries: Vec<Geometry>,
    pub producer: String,
    /// Bits of [`flag`].
    pub flags: u32,
    pub instances: usize,
    /// What is not as it was in the program.
    pub warnings: Vec<String>,
}

/// 3 x 4, row by row, in double precision.
#[derive(Clone, Copy)]
struct Transform([[f64; 4]; 3]);

impl Transform {
    fn new(rows: &[[f32; 4]; 3]) -> Transform {
        Transform(rows.map(|row| row.map(f64::from)))
    }

    fn point(&self, point: Vec3) -> Vec3 {
        let p = point.as_dvec3();
        Vec3::from(self.0.map(|[x, y, z, w]| (x * p.x + y * p.y + z * p.z + w) as f32))
    }

    fn triangle(&self, triangle: &Triangle) -> Triangle {
        Triangle(triangle.0.map(|vertex| self.point(vertex)))
    }

    /// Around the transformed box. Every operation keeps order, so a box inside of another stays inside.
    fn bounds(&self, bounds: &Aabb) -> Aabb {
        let (low, high) = (bounds.lower.as_dvec3(), bounds.upper.as_dvec3());
        let corner = |pick: fn(f64, f64) -> f64, round: fn(f64) -> f32| {
            Vec3::from(self.0.map(|[x, y, z, w]| {
                let term = |factor: f64, low: f64, high: f64| pick(factor * low, factor * high);
                round(term(x, low.x, high.x) + term(y, low.y, high.y) + term(z, low.z, high.z) + w)
            }))
        };
        Aabb { lower: corner(f64::min, round_down), upper: corner(f64::max, round_up) }
    }
}

/// The largest number of single precision that is not above.
fn round_down(value: f64) -> f32 {
    let nearest = value as f32;
    if f64::from(nearest) > value { nearest.next_down() } else { nearest }
}

fn round_up(value: f64) -> f32 {
    -round_down(-value)
}

/// An instance and what it is of.
struct Placed<'a> {
    part: &'a Part,
    of: &'a Capture,
    transform: Transform,
}

/// Puts a scene together. `captured` finds the captures that are instanced; `limit` is for the number of triangles.
///
/// # Errors
/// When the scene is too large, or an instance is not what it was committed with.
pub fn flatten<'a>(
    top: &'a Capture,
    captured: impl Fn(u32) -> Option<&'a Capture>,
    limit: u32,
) -> Result<Flattened, FlattenError> {
    let mut placed = Vec::new();
    for part in &top.parts {
        if let Kind::Instance { capture, transform } = &part.kind {
            let of = captured(*capture).ok_or(FlattenError::Unknown(part.geometry))?;
            if of.flattened_count != part.triangle_count {
                return Err(FlattenError::Changed(part.geometry));
            }
            if of.parts.iter().any(|part| matches!(part.kind, Kind::Instance { .. })) {
                return Err(FlattenError::Nested(part.geometry));
            }
            placed.push(Placed { part, of, transform: Transform::new(transform) });
        }
    }
    if top.flattened_count > limit {
        return Err(FlattenError::TooLarge { found: top.flattened_count, instances: placed.len(), limit });
    }
    let mut warnings = Vec::new();
    let triangles = triangles(top, &placed);
    let geometries = geometries(top, &placed, &mut warnings);

    let used = || placed.iter().filter(|placed| placed.part.triangle_count > 0);
    let doubt =
        std::iter::once(top).chain(used().map(|placed| placed.of)).find(|capture| !capture.has_tree());
    let mut flags = if placed.is_empty() { 0 } else { flag::FLATTENED };
    let (tree, producer) = match doubt {
        None => {
            flags |= flag::LIVE;
            if top.splits || used().any(|placed| placed.of.splits) {
                flags |= flag::SPATIAL_SPLITS;
            }
            (Graft::new(top, &placed).run(), top.producer.clone())
        }
        Some(doubtful) => {
            warnings.push(format!(
                "Embree's live tree cannot be read ({}); a binned tree of ours is used instead",
                doubtful.doubt
            ));
            let tree = builder::build(&triangles, &builder::Config::default(), &Progress::hidden())?;
            (tree, "bvh-build binned".to_owned())
        }
    };
    Ok(Flattened { tree, triangles, geometries, producer, flags, instances: placed.len(), warnings })
}

/// The elements of `TRIS`.
fn triangles(top: &Capture, placed: &[Placed]) -> Vec<Triangle> {
    let mut triangles = Vec::with_capacity(top.flattened_count as usize);
    let mut own = top.triangles.iter();
    let mut instances = placed.iter();
    for part in &top.parts {
        match part.kind {
            Kind::Triangles | Kind::Quads => {
                triangles.extend(own.by_ref().take(part.triangle_count as usize));
            }
            Kind::Instance { .. } => {
                let placed = instances.next().expect("one for each instance, in their order");
                triangles.extend(placed.of.triangles.iter().map(|t| placed.transform.triangle(t)));
            }
            Kind::Other { .. } => {}
        }
    }
    triangles
}

/// The elements of `GEOM`.
fn geometries(top: &Capture, placed: &[Placed], warnings: &mut Vec<String>) -> Vec<Geometry> {
    let geometry = |instance: u32, part: &Part, first: u32, mask: u32| {
        let kind = match part.kind {
            Kind::Triangles => geometry_kind::TRIANGLES,
            Kind::Quads => geometry_kind::QUADS,
            Kind::Instance { .. } | Kind::Other { .. } => return None,
        };
        let (geometry, triangle_count) = (part.geometry, part.triangle_count);
        Some(Geometry {
            instance,
            geometry,
            first_triangle: first,
            triangle_count,
            mask,
            kind,
            reserved: [0; 2],
        })
    };
    let mut geometries = Vec::new();
    let mut instances = placed.iter();
    let mut masks_mixed = 0;
    for part in &top.parts {
        if !matches!(part.kind, Kind::Instance { .. }) {
            geometries.extend(geometry(NO_INSTANCE, part, part.first_triangle, part.mask));
            continue;
        }
        let of = instances.next().expect("one for each instance, in their order").of;
        for inner in &of.parts {
            // A query needs a bit of both masks. One mask says that when one of them holds the other.
            let mask = part.mask & inner.mask;
            if mask != part.mask && mask != inner.mask {
                masks_mixed += 1;
            }
            let first = part.first_triangle + inner.first_triangle;
            geometries.extend(geometry(part.geometry, inner, first, mask));
        }
    }
    if masks_mixed > 0 {
        warnings.push(format!(
            "{masks_mixed} instanced geometries have a mask of their own beside their instance's; a replay takes the bits that both have"
        ));
    }
    geometries
}

/// The top-level tree with the instanced ones in it.
struct Graft<'a> {
    top: &'a Capture,
    placed: &'a [Placed<'a>],
    /// Numbers of instances by their geomID.
    numbers: HashMap<u32, usize>,
    tree: Tree,
}

/// A node of one of the trees that is still to be copied, to node `to`.
struct Pending {
    /// Which instance's tree; `None` for the top-level one.
    instance: Option<usize>,
    from: usize,
    to: usize,
}

impl<'a> Graft<'a> {
    fn new(top: &'a Capture, placed: &'a [Placed<'a>]) -> Graft<'a> {
        let numbers =
            placed.iter().enumerate().map(|(number, placed)| (placed.part.geometry, number)).collect();
        Graft { top, placed, numbers, tree: Tree::default() }
    }

    fn run(mut self) -> Tree {
        self.tree.nodes.push(Node::leaf(Aabb::EMPTY, 0, 0));
        let mut pending = vec![Pending { instance: None, from: 0, to: 0 }];
        while let Some(next) = pending.pop() {
            self.copy(&next, &mut pending);
        }
        self.hold();
        self.tree
    }

    /// Adds `count` children to node `parent`, to be filled; returns the first.
    fn children(&mut self, parent: usize, bounds: Aabb, count: usize) -> usize {
        let first = self.tree.nodes.len();
        self.tree.nodes[parent] = Node::inner(bounds, first as u32, count as u32);
        self.tree.nodes.resize(first + count, Node::leaf(Aabb::EMPTY, 0, 0));
        first
    }

    fn copy(&mut self, next: &Pending, pending: &mut Vec<Pending>) {
        let placed = next.instance.map(|index| &self.placed[index]);
        let source = placed.map_or(self.top, |placed| placed.of);
        let node = source.nodes[next.from];
        let bounds = match placed {
            Some(placed) if !node.bounds().is_empty() => placed.transform.bounds(&node.bounds()),
            _ => node.bounds(),
        };
        if !node.is_leaf() {
            let first = self.children(next.to, bounds, node.len());
            let instance = next.instance;
            // Backwards, so that the first child is copied first and lies next to its parent.
            pending.extend(node.range().enumerate().rev().map(|(child, from)| Pending {
                instance,
                from,
                to: first + child,
            }));
            return;
        }
        let entries = &source.primitives[node.range()];
        if placed.is_none() && entries.iter().any(|entry| entry & INSTANCE != 0) {
            return self.copy_instances(entries, bounds, next.to, pending);
        }
        let offset = placed.map_or(0, |placed| placed.part.first_triangle);
        let first = self.tree.primitives.len() as u32;
        self.tree.primitives.extend(entries.iter().map(|entry| entry + offset));
        self.tree.nodes[next.to] = Node::leaf(bounds, first, node.len() as u32);
    }

    /// A leaf of instances: the roots of their trees are its children, or, when it has only one, that root is the leaf.
    fn copy_instances(&mut self, entries: &[u32], bounds: Aabb, to: usize, pending: &mut Vec<Pending>) {
        let instances: Vec<usize> = entries
            .iter()
            .filter_map(|entry| self.numbers.get(&(entry & !INSTANCE)).copied())
            .filter(|&index| self.placed[index].part.triangle_count > 0)
            .collect();
        match instances[..] {
            [] => self.tree.nodes[to] = Node::leaf(bounds, self.tree.primitives.len() as u32, 0),
            [only] => pending.push(Pending { instance: Some(only), from: 0, to }),
            _ => {
                let first = self.children(to, bounds, instances.len());
                pending.extend(instances.iter().enumerate().rev().map(|(child, &index)| Pending {
                    instance: Some(index),
                    from: 0,
                    to: first + child,
                }));
            }
        }
    }

    /// Lets every box hold its children's: Embree's transformed boxes and ours are not rounded alike.
    fn hold(&mut self) {
        for index in (0..self.tree.nodes.len()).rev() {
            let node = self.tree.nodes[index];
            if node.is_leaf() {
                continue;
            }
            let all = self.tree.nodes[node.range()]
                .iter()
                .fold(node.bounds(), |all, child| all.union(&child.bounds()));
            (self.tree.nodes[index].lower, self.tree.nodes[index].upper) = (all.lower, all.upper);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::bvh::{self, Bvh, Contents};

    fn triangle(x: f32, y: f32, z: f32) -> Triangle {
        Triangle([Vec3::new(x, y, z), Vec3::new(x + 0.7, y, z + 0.1), Vec3::new(x, y + 0.9, z)])
    }

    fn part(geometry: u32, kind: Kind, mask: u32, first_triangle: u32, triangle_count: u32) -> Part {
        Part { geometry, kind, mask, first_triangle, triangle_count }
    }

    fn capture(
        parts: Vec<Part>,
        triangles: Vec<Triangle>,
        nodes: Vec<Node>,
        primitives: Vec<u32>,
    ) -> Capture {
        let flattened_count = parts.iter().map(|part| part.triangle_count).sum();
        Capture {
            scene: 0,
            commit: 0,
            parts,
            nodes,
            primitives,
            triangles,
            flattened_count,
            splits: false,
            others: 0,
            producer: "embree".to_owned(),
            doubt: String::new(),
        }
    }

    /// Three triangles of two geometries, in two leaves.
    fn instanced() -> Capture {
        let triangles = vec![triangle(0.3, 0.1, 1.7), triangle(2.1, 3.3, 0.4), triangle(-5.7, 1.1, 0.9)];
        let bounds: Vec<Aabb> = triangles.iter().map(Triangle::bounds).collect();
        let pair = bounds[0].union(&bounds[2]);
        capture(
            vec![part(4, Kind::Triangles, u32::MAX, 0, 1), part(7, Kind::Quads, 6, 1, 2)],
            triangles,
            vec![
                Node::inner(pair.union(&bounds[1]), 1, 2),
                Node::leaf(pair, 0, 2),
                Node::leaf(bounds[1], 2, 1),
            ],
            vec![2, 0, 1],
        )
    }

    const TRANSFORM: [[f32; 4]; 3] = [[0.3, -0.8, 0.1, 5.3], [0.7, 0.2, -0.4, -3.1], [-0.1, 0.9, 1.3, 0.7]];

    fn instance(geometry: u32, mask: u32, first: u32) -> Part {
        part(geometry, Kind::Instance { capture: 9, transform: TRANSFORM }, mask, first, 3)
    }

    /// A triangle, and two instances in one leaf.
    fn top() -> Capture {
        let own = triangle(9.0, 9.0, 9.0);
        let everywhere = Aabb { lower: Vec3::splat(-1.0), upper: Vec3::splat(1.0) };
        capture(
            vec![
                instance(0, u32::MAX, 0),
                part(1, Kind::Triangles, 1, 3, 1),
                part(2, Kind::Other { geometry_type: 120, moving: false }, 1, 4, 0),
                instance(3, 0xA, 4),
            ],
            vec![own],
            // The instances' box is too small on purpose: Embree rounds its own.
            vec![
                Node::inner(everywhere.union(&own.bounds()), 1, 2),
                Node::leaf(own.bounds(), 0, 1),
                Node::leaf(everywhere, 1, 2),
            ],
            vec![3, INSTANCE, INSTANCE | 3],
        )
    }

    /// Writes and reads back, so that every rule of the format is checked.
    fn verified(flattened: &Flattened) {
        let contents = Contents {
            tree: flattened.tree.view(),
            triangles: &flattened.triangles,
            geometries: &flattened.geometries,
            order: None,
            meta: None,
            flags: flattened.flags,
            producer: &flattened.producer,
        };
        let mut file = Vec::new();
        bvh::write(&mut file, &contents).unwrap();
        Bvh::parse(&file).unwrap().verify().unwrap();
    }

    #[test]
    fn instances_are_in_world_space() {
        let (top, child) = (top(), instanced());
        let found = flatten(&top, |number| (number == 9).then_some(&child), 7).unwrap();
        verified(&found);
        assert_eq!((found.instances, found.triangles.len(), found.tree.primitives.len()), (2, 7, 7));
        assert_eq!(found.flags, flag::FLATTENED | flag::LIVE);
        assert_eq!(found.triangles[3], top.triangles[0]);
        assert_eq!(found.triangles[0..3], found.triangles[4..7]);
        // Against the matrix, written out.
        let [a, ..] = child.triangles[0].0;
        let x = TRANSFORM[0][0] * a.x + TRANSFORM[0][1] * a.y + TRANSFORM[0][2] * a.z + TRANSFORM[0][3];
        assert!((found.triangles[0].0[0].x - x).abs() < 1e-5);
        let geometries: Vec<_> =
            found.geometries.iter().map(|g| (g.instance, g.geometry, g.first_triangle, g.mask)).collect();
        assert_eq!(
            geometries,
            [(0, 4, 0, u32::MAX), (0, 7, 1, 6), (NO_INSTANCE, 1, 3, 1), (3, 4, 4, 0xA), (3, 7, 5, 2)]
        );
        // 0xA and 6 do not hold one another.
        assert_eq!(found.warnings.len(), 1);
    }

    #[test]
    fn a_transformed_box_holds_what_it_held() {
        let mut random = crate::random::Random::new(7);
        let mut number = || (random.unit() - 0.5) * 200.0;
        for _ in 0..2000 {
            let mut row = || [number() / 30.0, number() / 30.0, number() / 30.0, number()];
            let transform = Transform::new(&[row(), row(), row()]);
            let triangle = Triangle([(); 3].map(|()| Vec3::new(number(), number(), number())));
            let outer = triangle.bounds().grown(Vec3::new(number(), number(), number()));
            let moved = transform.bounds(&triangle.bounds());
            assert!(moved.contains(&transform.triangle(&triangle).bounds()));
            assert!(transform.bounds(&outer).contains(&moved));
        }
    }

    #[test]
    fn without_a_tree_one_is_built() {
        let (top, mut child) = (top(), instanced());
        (child.nodes, child.primitives) = (Vec::new(), Vec::new());
        child.doubt = "a node is odd".to_owned();
        let found = flatten(&top, |_| Some(&child), 7).unwrap();
        verified(&found);
        assert!(found.warnings[1].contains("a node is odd"));
        assert_eq!((found.flags, found.tree.primitives.len()), (flag::FLATTENED, 7));
    }

    #[test]
    fn what_cannot_be_flattened() {
        let (top, child) = (top(), instanced());
        let fails =
            |captured: Option<&Capture>, limit| flatten(&top, |_| captured, limit).unwrap_err().to_string();
        assert!(fails(Some(&child), 6).contains("7 triangles once its 2 instances are flattened"));
        assert!(fails(None, 7).contains("instance 0 is of a scene that is not known"));
        assert!(
            fails(Some(&top), 7).contains("instance 0 is of a scene that has another number of triangles")
        );
        let mut nested = instanced();
        nested.parts.push(part(8, Kind::Instance { capture: 1, transform: TRANSFORM }, 1, 3, 0));
        assert!(fails(Some(&nested), 7).contains("instances of its own"));
    }
}
