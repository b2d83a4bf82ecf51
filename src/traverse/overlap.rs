//! P_R: which nodes a query's effective segment overlaps. T_R = Σ P_R over inner nodes comes from here, by a pass that
//! knows nothing of traversal orders, hits or culling, so that it can hold them to account.

use super::form::{Form, Link, Stack};
use super::ray::PreparedRay;
use super::simd::Machine;
use serde::{Deserialize, Serialize};

/// Told of every node whose box the segment overlaps.
pub trait Overlapped {
    fn inner(&mut self, node: &Link);
    fn leaf(&mut self, leaf: &Link);
}

/// What a strict front-to-back traversal of one segment needs: the terms of T_R and Γ_R.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Overlap {
    /// Inner nodes overlapped: Σ P_R(b), this query's share of T_R.
    pub inner: u64,
    /// Children of those: Σ P_R(b) × children of b; 2 × `inner` in a binary tree.
    pub children: u64,
    /// Leaves overlapped: Σ P_R(l).
    pub leaves: u64,
    /// Primitives in those: Σ P_R(l) × primitives of l.
    pub primitives: u64,
}

impl Overlapped for Overlap {
    #[inline(always)]
    fn inner(&mut self, node: &Link) {
        self.inner += 1;
        self.children += u64::from(node.count);
    }

    #[inline(always)]
    fn leaf(&mut self, leaf: &Link) {
        self.leaves += 1;
        self.primitives += leaf.triangles().len() as u64;
    }
}

impl std::ops::AddAssign for Overlap {
    fn add_assign(&mut self, other: Overlap) {
        self.inner += other.inner;
        self.children += other.children;
        self.leaves += other.leaves;
        self.primitives += other.primitives;
    }
}

/// How many segments overlap each node, by its index in the file.
pub(super) struct PerNode(pub Vec<u64>);

impl Overlapped for PerNode {
    #[inline(always)]
    fn inner(&mut self, node: &Link) {
        self.0[node.node as usize] += 1;
    }

    #[inline(always)]
    fn leaf(&mut self, leaf: &Link) {
        self.0[leaf.node as usize] += 1;
    }
}

/// Visits every node below and at `root` that the segment [tnear, `tfar`] overlaps. A box that is missed holds none that is overlapped.
#[inline(always)]
pub(super) fn run<M: Machine, F: Form<M>>(
    form: &F,
    root: Link,
    ray: &PreparedRay,
    tfar: f32,
    counter: &mut impl Overlapped,
    mut stack: Stack,
) {
    let form_ray = F::ray(ray);
    stack.push(root);
    while let Some(current) = stack.pop() {
        if current.is_leaf() {
            counter.leaf(&current);
        } else {
            counter.inner(&current);
            form.each(&current, &form_ray, tfar, |child| stack.push(child));
        }
    }
}
