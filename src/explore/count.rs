//! What the real traversal does, node by node and triangle by triangle: recorded queries are asked again, and an observer counts.
//!
//! Everything that [`super::shares`], [`super::heat`] and [`super::versus`] say follows from these counts, so a recording is
//! asked once for all of them.

use super::queries::{Asked, Sampled, Source};
use super::walk::Walk;
use crate::format::FormatError;
use crate::progress::Progress;
use crate::traverse::{Link, Observer, Overlapped, PreparedRay, PreparedTriangle, Scratch};
use crate::zeroed::zeroed_vec;
use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

/// Most queries that are counted: numbers per node have 32 bits.
const MOST: u64 = 1 << 28;

/// Of a node. 32 bytes, as there may be many.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct NodeCount {
    /// Queries whose effective segment overlaps the box: P_R.
    pub overlapped: u32,
    /// Queries that opened it: tested the boxes of its children, or its triangles.
    pub opened: u32,
    /// Of `opened`, those that asked for occlusion.
    pub occlusions: u32,
    /// Of `block_tests`, those of such queries; where they are more than fit here, as many as fit.
    pub occlusion_block_tests: u32,
    /// Of a leaf: tests of its triangles. A leaf that has an occluder may be left before its end.
    pub primitive_tests: u64,
    /// Of a leaf: tests of its blocks of up to four triangles.
    pub block_tests: u64,
}

/// Of a triangle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct TriangleCount {
    pub tests: u32,
    /// Queries that it is the answer of: the closest hit, or the occluder that was found.
    pub hits: u32,
}

/// What was counted over one tree.
#[derive(Clone, Debug)]
pub struct Counted {
    /// By node of the file.
    pub nodes: Vec<NodeCount>,
    /// By triangle.
    pub triangles: Vec<TriangleCount>,
    /// Queries that were asked. Each tested the root's box, which is no node's child.
    pub queries: u64,
    /// Of those, queries that hit something.
    pub hits: u64,
    /// And queries that asked for occlusion.
    pub occlusions: u64,
    pub sampled: Sampled,
}

impl Counted {
    /// Of a tree that no query was asked of.
    pub fn nothing(walk: &Walk) -> Counted {
        Counted {
            nodes: zeroed_vec(walk.tree().nodes.len()),
            triangles: zeroed_vec(walk.places().triangle_count()),
            queries: 0,
            hits: 0,
            occlusions: 0,
            sampled: Sampled::default(),
        }
    }

    /// Asks the queries of `source`, at most 2²⁸ of them, on rayon's threads, each of which has counts of its own.
    ///
    /// # Errors
    /// When a chunk is damaged.
    pub fn of(
        walk: &Walk,
        asked: &Asked,
        source: &Source,
        progress: &Progress,
    ) -> Result<Counted, FormatError> {
        let source = Source { limit: source.limit.min(MOST), ..source.clone() };
        let new = || (Counted::nothing(walk), Scratch::default());
        let (gathered, sampled) = source.gather(progress, new, |(counted, scratch), query| {
            let occlusion = query.record.is_occlusion();
            let mut watch = Watch { counted, occlusion, leaf: 0 };
            let hit = asked.ask(query, &mut watch, scratch);
            asked.prepared.overlap(&PreparedRay::new(&query.ray), query.end(hit), &mut watch, scratch);
            counted.queries += 1;
            counted.occlusions += u64::from(occlusion);
            if let Some(hit) = hit {
                counted.hits += 1;
                counted.triangles[hit.triangle as usize].hits += 1;
            }
        })?;
        let sum = gathered.into_iter().map(|(counted, _)| counted).reduce(Counted::merge);
        Ok(Counted { sampled, ..sum.unwrap_or_else(|| Counted::nothing(walk)) })
    }

    fn merge(mut self, other: Counted) -> Counted {
        self.nodes.par_iter_mut().zip(&other.nodes).for_each(|(sum, count)| {
            sum.overlapped += count.overlapped;
            sum.opened += count.opened;
            sum.occlusions += count.occlusions;
            sum.occlusion_block_tests = sum.occlusion_block_tests.saturating_add(count.occlusion_block_tests);
            sum.primitive_tests += count.primitive_tests;
            sum.block_tests += count.block_tests;
        });
        self.triangles.par_iter_mut().zip(&other.triangles).for_each(|(sum, count)| {
            sum.tests = sum.tests.saturating_add(count.tests);
            sum.hits += count.hits;
        });
        self.queries += other.queries;
        self.hits += other.hits;
        self.occlusions += other.occlusions;
        self
    }
}

/// Counts one query.
struct Watch<'c> {
    counted: &'c mut Counted,
    /// Whether the query asks for occlusion.
    occlusion: bool,
    /// The leaf that is open.
    leaf: usize,
}

impl Watch<'_> {
    #[inline]
    fn open(&mut self, node: u32) {
        let count = &mut self.counted.nodes[node as usize];
        count.opened += 1;
        count.occlusions += u32::from(self.occlusion);
    }
}

impl Observer for Watch<'_> {
    #[inline]
    fn inner(&mut self, node: &Link) {
        self.open(node.node);
    }

    #[inline]
    fn leaf(&mut self, leaf: &Link) {
        self.leaf = leaf.node as usize;
        self.open(leaf.node);
    }

    #[inline]
    fn primitives(&mut self, triangles: impl ExactSizeIterator<Item = PreparedTriangle>) {
        let count = &mut self.counted.nodes[self.leaf];
        count.primitive_tests += triangles.len() as u64;
        count.block_tests += 1;
        let occlusion = u32::from(self.occlusion);
        count.occlusion_block_tests = count.occlusion_block_tests.saturating_add(occlusion);
        for triangle in triangles {
            // A triangle that stands in many leaves is tested more than once a query.
            let tests = &mut self.counted.triangles[triangle.index as usize].tests;
            *tests = tests.saturating_add(1);
        }
    }
}

impl Overlapped for Watch<'_> {
    #[inline]
    fn inner(&mut self, node: &Link) {
        self.counted.nodes[node.node as usize].overlapped += 1;
    }

    #[inline]
    fn leaf(&mut self, leaf: &Link) {
        self.counted.nodes[leaf.node as usize].overlapped += 1;
    }
}
