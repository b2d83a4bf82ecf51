//! A committed scene and the scenes that it instances -> one tree over triangles in world space.
//!
//! The tree is the top-level one with each instance leaf replaced by the instanced tree ([`graft`]), under transformed boxes
//! ([`transform`]). What moves is where it is at its first time step: Embree has it in trees of nodes that move, which are not read,
//! so it stands in a binned tree of ours beside Embree's. Where a tree of the program's could not be read, a binned one of
//! ours over everything is built instead. The report says which.

mod graft;
mod transform;

use super::capture::{Capture, Kind, Part};
use crate::builder::{self, BuildError};
use crate::format::bvh::{Geometry, NO_INSTANCE, flag, geometry_flag, geometry_kind};
use crate::geometry::Triangle;
use crate::progress::Progress;
use crate::tree::Tree;
use graft::{Graft, join};
use thiserror::Error;
use transform::Transform;

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
    /// Geometries that move; those of instances count for each.
    pub moving: usize,
    /// What is not as it was in the program.
    pub warnings: Vec<String>,
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
    let geometries = geometries(top, &placed);

    let moves = |geometry: &&Geometry| geometry.flags & geometry_flag::MOVING != 0;
    let moving: Vec<u32> = geometries
        .iter()
        .filter(moves)
        .flat_map(|geometry| geometry.first_triangle..geometry.first_triangle + geometry.triangle_count)
        .collect();

    let used = || placed.iter().filter(|placed| placed.part.triangle_count > 0);
    let doubt =
        std::iter::once(top).chain(used().map(|placed| placed.of)).find(|capture| !capture.has_tree());
    let mut flags = if placed.is_empty() { 0 } else { flag::FLATTENED };
    let (tree, producer) = match doubt {
        None => {
            if top.splits || used().any(|placed| placed.of.splits) {
                flags |= flag::SPATIAL_SPLITS;
            }
            let still = Graft::new(top, &placed).run();
            if moving.is_empty() {
                flags |= flag::LIVE;
                (still, top.producer.clone())
            } else {
                let first_step: Vec<Triangle> =
                    moving.iter().map(|&triangle| triangles[triangle as usize]).collect();
                (join(still, binned(&first_step)?, &moving), format!("binned + {}", top.producer))
            }
        }
        Some(doubtful) => {
            warnings.push(format!(
                "Embree's live tree cannot be read ({}); a binned tree of ours is used instead",
                doubtful.doubt
            ));
            (binned(&triangles)?, "bvh-build binned".to_owned())
        }
    };
    let moving = geometries.iter().filter(moves).count();
    Ok(Flattened { tree, triangles, geometries, producer, flags, instances: placed.len(), moving, warnings })
}

fn binned(triangles: &[Triangle]) -> Result<Tree, BuildError> {
    builder::build(triangles, &builder::Config::default(), &Progress::hidden())
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
fn geometries(top: &Capture, placed: &[Placed]) -> Vec<Geometry> {
    let geometry = |instance: u32, part: &Part, first: u32, masks: [u32; 2], moving: bool| {
        let kind = match part.kind {
            Kind::Triangles => geometry_kind::TRIANGLES,
            Kind::Quads => geometry_kind::QUADS,
            Kind::Instance { .. } | Kind::Other { .. } => return None,
        };
        let (geometry, triangle_count) = (part.geometry, part.triangle_count);
        // A query needs a bit of both masks. One mask says that when one of them holds the other.
        let [own, instances] = masks;
        let (mask, instance_mask, two) = match own & instances {
            both if both == own || both == instances => (both, 0, 0),
            _ => (own, instances, geometry_flag::INSTANCE_MASK),
        };
        let flags = two | if moving { geometry_flag::MOVING } else { 0 };
        Some(Geometry {
            instance,
            geometry,
            first_triangle: first,
            triangle_count,
            mask,
            kind,
            flags,
            instance_mask,
        })
    };
    let mut geometries = Vec::new();
    let mut instances = placed.iter();
    for part in &top.parts {
        if !matches!(part.kind, Kind::Instance { .. }) {
            let masks = [part.mask, u32::MAX];
            geometries.extend(geometry(NO_INSTANCE, part, part.first_triangle, masks, part.moving));
            continue;
        }
        let of = instances.next().expect("one for each instance, in their order").of;
        for inner in &of.parts {
            let first = part.first_triangle + inner.first_triangle;
            let moving = part.moving || inner.moving;
            geometries.extend(geometry(part.geometry, inner, first, [inner.mask, part.mask], moving));
        }
    }
    geometries
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::bvh::{self, Bvh, Contents};
    use crate::geometry::{Aabb, Vec3};
    use crate::record::program::capture::INSTANCE;
    use crate::tree::Node;

    fn triangle(x: f32, y: f32, z: f32) -> Triangle {
        Triangle([Vec3::new(x, y, z), Vec3::new(x + 0.7, y, z + 0.1), Vec3::new(x, y + 0.9, z)])
    }

    fn part(geometry: u32, kind: Kind, mask: u32, first_triangle: u32, triangle_count: u32) -> Part {
        Part { geometry, kind, moving: false, mask, first_triangle, triangle_count }
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
                part(2, Kind::Other { geometry_type: 120 }, 1, 4, 0),
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
            [(0, 4, 0, u32::MAX), (0, 7, 1, 6), (NO_INSTANCE, 1, 3, 1), (3, 4, 4, 0xA), (3, 7, 5, 6)]
        );
        assert!(found.warnings.is_empty());
    }

    /// A query sees what both masks let it see, whichever they are; and where one mask says that,
    /// there is one.
    #[test]
    fn masks_of_instance_and_geometry() {
        for (own, instances) in (0..8).flat_map(|own| (0..8).map(move |instances| (own, instances))) {
            let (mut top, mut child) = (top(), instanced());
            (child.parts[0].mask, top.parts[0].mask) = (own, instances);
            let found = flatten(&top, |_| Some(&child), 7).unwrap().geometries[0];
            for query in 0..8 {
                let seen = found.masks().iter().all(|mask| query & mask != 0);
                assert_eq!(seen, query & own != 0 && query & instances != 0, "{own} {instances} {query}");
            }
            let one =
                (0..8).any(|mask| (0..8).all(|q| (q & mask != 0) == (q & own != 0 && q & instances != 0)));
            assert_eq!(found.flags & geometry_flag::INSTANCE_MASK == 0, one);
            assert!(!one || found.instance_mask == 0);
        }
    }

    #[test]
    fn without_a_tree_one_is_built() {
        let (top, mut child) = (top(), instanced());
        (child.nodes, child.primitives) = (Vec::new(), Vec::new());
        child.doubt = "a node is odd".to_owned();
        let found = flatten(&top, |_| Some(&child), 7).unwrap();
        verified(&found);
        assert!(found.warnings[0].contains("a node is odd"));
        assert_eq!((found.flags, found.tree.primitives.len()), (flag::FLATTENED, 7));
    }

    /// A moving instance is in no leaf of Embree's tree, nor are moving triangles of an instanced scene: they are in ours.
    #[test]
    fn what_moves_has_a_tree_beside() {
        let (mut top, mut child) = (top(), instanced());
        top.parts[3].moving = true;
        top.primitives = vec![3, INSTANCE];
        top.nodes[2] = Node::leaf(top.nodes[2].bounds(), 1, 1);
        child.parts[0].moving = true;
        (child.nodes, child.primitives) = (vec![Node::leaf(child.nodes[0].bounds(), 0, 2)], vec![2, 1]);
        let found = flatten(&top, |_| Some(&child), 7).unwrap();
        verified(&found);
        let moving: Vec<_> = found.geometries.iter().map(|g| (g.first_triangle, g.flags)).collect();
        // The last one has a mask beside its instance's, too.
        let both = geometry_flag::MOVING | geometry_flag::INSTANCE_MASK;
        assert_eq!(moving, [(0, 1), (1, 0), (3, 0), (4, 1), (5, both)]);
        assert_eq!((found.moving, found.flags), (3, flag::FLATTENED));
        assert_eq!(found.producer, "binned + embree");
        // Embree's leaves first, then ours.
        assert_eq!(found.tree.primitives[..3], [3, 2, 1]);
        let mut ours = found.tree.primitives[3..].to_vec();
        ours.sort();
        assert_eq!(ours, [0, 4, 5, 6]);

        // Where nothing stands still, there is only ours.
        top.parts[0].moving = true;
        top.parts[1].moving = true;
        (top.nodes, top.primitives) = (vec![Node::leaf(Aabb::EMPTY, 0, 0)], Vec::new());
        let found = flatten(&top, |_| Some(&child), 7).unwrap();
        verified(&found);
        assert_eq!(found.tree.primitives.len(), 7);
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
