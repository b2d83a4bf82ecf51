//! What trees cost the queries that judge them: counted by the real traversal, depth first, in the order in which it will be asked.

use crate::cost::{Costs, Counted};
use crate::format::bvh::Geometry;
use crate::geometry::Triangle;
use crate::training::queries::Query;
use crate::traverse::{OcclusionOrder, Prepared, PreparedRay, Recorded, Scratch, Traversal};
use crate::tree::TreeView;
use rayon::prelude::*;

/// The scene that trees are made for.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    pub triangles: &'a [Triangle],
    pub geometries: &'a [Geometry],
}

/// Counts of queries over one tree, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Judged {
    pub closest_hit: Counted,
    pub occlusion: Counted,
    /// Most children of a node of the tree.
    pub width: usize,
}

/// Nanoseconds of a query; `None` of a kind that was not asked.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    pub all: Option<f64>,
    pub closest_hit: Option<f64>,
    pub occlusion: Option<f64>,
}

impl Judged {
    /// What a query costs.
    pub fn cost(&self, costs: &Costs) -> Cost {
        let (closest_hit, occlusion) = (&self.closest_hit, &self.occlusion);
        let sums = [costs.of(self.width, false).of(closest_hit), costs.of(self.width, true).of(occlusion)];
        let each = |sum: f64, queries: u64| (queries > 0).then(|| sum / queries as f64);
        Cost {
            all: each(sums[0] + sums[1], closest_hit.queries + occlusion.queries),
            closest_hit: each(sums[0], closest_hit.queries),
            occlusion: each(sums[1], occlusion.queries),
        }
    }
}

/// Asks `queries` of `tree`, on the threads of the current rayon pool; occlusion in the order `order`.
pub fn judge(scene: Scene, tree: TreeView, order: &OcclusionOrder, queries: &[&Query]) -> Judged {
    let prepared = Prepared::new(tree, scene.triangles, scene.geometries);
    let widest = tree.nodes.iter().filter(|node| !node.is_leaf()).map(|node| node.len()).max();
    let part = |queries: &[&Query]| {
        let (mut judged, mut scratch) = (Judged::default(), Scratch::default());
        for query in queries {
            let ray = PreparedRay::new(&query.ray);
            let candidates = Recorded { mask: query.mask, rejects: &query.rejects };
            let scratch = &mut scratch;
            if query.is_occlusion {
                let Counted { queries, counts, .. } = &mut judged.occlusion;
                *queries += 1;
                prepared.occluder_in(order, &ray, &candidates, counts, scratch);
            } else {
                let Counted { queries, counts, .. } = &mut judged.closest_hit;
                *queries += 1;
                prepared.closest_hit(Traversal::Odf, &ray, &candidates, counts, scratch);
            }
        }
        judged
    };
    let add = |mut a: Judged, b: Judged| {
        a.closest_hit += b.closest_hit;
        a.occlusion += b.occlusion;
        a
    };
    let judged = queries.par_chunks(1 << 10).map(part).reduce(Judged::default, add);
    Judged { width: widest.unwrap_or(2), ..judged }
}
