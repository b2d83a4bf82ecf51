//! What trees cost the queries that judge them: counted by the real traversal, depth first, in the order in which it will be asked.

use crate::cost::counter::{BATCH, Counter};
use crate::cost::{ByKind, Cost, Costs};
use crate::format::bvh::Geometry;
use crate::geometry::Triangle;
use crate::training::queries::Query;
use crate::traverse::{OcclusionOrder, Prepared, Recorded};
use crate::tree::TreeView;
use rayon::prelude::*;

/// The scene that trees are made for.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    pub triangles: &'a [Triangle],
    pub geometries: &'a [Geometry],
}

/// What `queries` cost in `tree`, asked on the threads of the current rayon pool; occlusion in the order `order`. Misses of a cache as large as a
/// processor's second level are part of it: a tree that saves visits by cutting triangles takes more memory.
pub fn judge(
    scene: Scene,
    tree: TreeView,
    order: &OcclusionOrder,
    queries: &[&Query],
    costs: &Costs,
) -> Cost {
    let prepared = Prepared::new(tree, scene.triangles, scene.geometries);
    let widest = tree.nodes.iter().filter(|node| !node.is_leaf()).map(|node| node.len()).max();
    let part = |queries: &[&Query]| {
        let mut counter = Counter::new(&prepared, tree, order);
        let mut counted = ByKind::default();
        for query in queries {
            let candidates = Recorded { mask: query.mask, rejects: &query.rejects };
            *counted.of(query.is_occlusion) += counter.ask(&query.ray, query.is_occlusion, &candidates);
        }
        counted
    };
    let add = |mut a: ByKind, b: ByKind| {
        a += b;
        a
    };
    let counted = queries.par_chunks(BATCH).map(part).reduce(ByKind::default, add);
    costs.per_query(widest.unwrap_or(2), &counted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Ray, Vec3};
    use crate::tree::{Node, Tree};

    /// A node over two leaves: one block of four triangles, and two blocks of five.
    #[test]
    fn what_is_read_again_is_no_miss() {
        let triangle =
            |x: f32| Triangle([Vec3::new(x, 0.0, 0.0), Vec3::new(x, 4.0, 0.0), Vec3::new(x, 0.0, 4.0)]);
        let triangles: Vec<Triangle> = (0..9u8).map(|x| triangle(x.into())).collect();
        let bounds = |range: &[Triangle]| {
            range.iter().map(Triangle::bounds).reduce(|a, b| a.union(&b)).expect("one at least")
        };
        let tree = Tree {
            nodes: vec![
                Node::inner(bounds(&triangles), 1, 2),
                Node::leaf(bounds(&triangles[..4]), 0, 4),
                Node::leaf(bounds(&triangles[4..]), 4, 5),
            ],
            primitives: (0..9).collect(),
        };
        // Occluded by the first triangle, or by none.
        let query = |y: f32| {
            let ray =
                Ray { origin: Vec3::new(-1.0, y, 1.0), direction: Vec3::X, tnear: 0.0, tfar: f32::INFINITY };
            Query {
                ray,
                segment: ray,
                is_occlusion: true,
                mask: u32::MAX,
                rejects: Box::default(),
                judges: true,
            }
        };
        let scene = Scene { triangles: &triangles, geometries: &[] };
        let entry =
            r#"{"width": 2, "kind": "occlusion", "visit": 1, "leaf": 10, "block": 100, "miss": 10000}"#;
        let costs = Costs::parse(&format!(r#"{{"costs": [{entry}]}}"#)).expect("costs");
        let cost = |queries: &[Query]| {
            let queries: Vec<&Query> = queries.iter().collect();
            let cost = judge(scene, tree.view(), &OcclusionOrder::First, &queries, &costs);
            assert_eq!((cost.closest_hit, cost.all), (None, cost.occlusion));
            cost.occlusion.expect("asked")
        };
        // A line of the node, three of the block; the second and third time only the visit, the leaf and the block.
        let hit = [query(1.0), query(1.0), query(1.0)];
        let [once, thrice] = [1, 3].map(|count| cost(&hit[..count]));
        assert_eq!(once, 111.0 + 40_000.0);
        assert!((thrice - (111.0 + 40_000.0 / 3.0)).abs() < 1e-9, "{thrice}");
        // Past the triangles but not past the boxes: both leaves, three blocks.
        assert_eq!(cost(&[query(3.5)]), 321.0 + 100_000.0);
    }
}
