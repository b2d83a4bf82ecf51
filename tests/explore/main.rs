//! What the window shows of a tree and of recorded queries, against what replay counts and against loops over everything.

#[path = "../compare_support/mod.rs"]
mod compare_support;
mod rays;
mod shares;
mod steps;
mod walk;
mod work;

use compare_support::files::{geometries, rays_bytes, records};
use compare_support::*;
use embree_trace::cost;
use embree_trace::explore::price::Price;
use embree_trace::explore::queries::{Asked, Source};
use embree_trace::format::rays::{Rays, Record, Reject};
use embree_trace::geometry::Triangle;
use embree_trace::replay::query::Choice;
use embree_trace::replay::tally::Costs;
use embree_trace::traverse::{Counts, OcclusionOrder, Prepared, Traversal};
use embree_trace::tree::Tree;

const COSTS: Costs = Costs { c_i: 0.6, c_p: 1.0 };

/// A scene and what was recorded of it.
struct Scene {
    triangles: Vec<Triangle>,
    records: Vec<Record>,
    rejects: Vec<Reject>,
    bytes: Vec<u8>,
}

impl Scene {
    fn new(queries: usize, chunk: usize) -> Scene {
        let triangles = soup(240, 0.3, &mut Random(5));
        let (records, rejects) = records(&triangles, queries, 11);
        let bytes = rays_bytes(1, &records, &rejects, chunk);
        Scene { triangles, records, rejects, bytes }
    }

    fn rays(&self) -> Rays<'_> {
        Rays::parse(&self.bytes).expect("a valid file")
    }

    fn prepared(&self, tree: &Tree) -> Prepared {
        Prepared::new(tree.view(), &self.triangles, &geometries(&self.triangles))
    }

    /// Binary and wide, with small and large leaves.
    fn trees(&self) -> Vec<Tree> {
        let random = &mut Random(7);
        [(2, 1), (2, 4), (4, 1), (8, 3), (13, 2)]
            .map(|(width, leaf)| random_tree(&self.triangles, width, leaf, random))
            .into()
    }
}

fn choice(filter: &str) -> Choice {
    Choice { scene: 0, filter: filter.parse().expect(filter), held_out: None, sample: None }
}

fn source<'a>(rays: &'a Rays<'a>, filter: &str, limit: u64) -> Source<'a> {
    Source { rays, choice: choice(filter), limit }
}

fn asked<'a>(tree: &Tree, prepared: &'a Prepared, traversal: Traversal) -> Asked<'a> {
    Asked { prepared, traversal, order: &OcclusionOrder::Nearest, price: price(tree) }
}

fn price(tree: &Tree) -> Price {
    Price::of(tree.view(), &cost::Costs::default())
}

/// Nanoseconds of one query, by hand from the constants of src/cost.rs.
fn nanoseconds(occlusion: bool, counts: &Counts) -> f64 {
    let [leaf, block] = if occlusion { [6.2, 2.9] } else { [7.7, 2.0] };
    6.1 * counts.node_visits as f64 + leaf * counts.leaf_visits as f64 + block * counts.block_tests as f64
}
