//! What a traversal needs of a tree's memory layout. A new layout (packets, 8 lanes) is a new implementation; the
//! algorithms stay as they are.

use super::ray::PreparedRay;
use crate::tree::LEAF_BIT;

/// A subtree that the ray overlaps, and where to find what is below.
#[derive(Clone, Copy, Debug)]
pub struct Link {
    /// Where the ray enters its box.
    pub entry: f32,
    /// Index of its node in the file.
    pub node: u32,
    /// Leaf: first of its prepared triangles. Inner: wherever the form keeps its children.
    pub first: u32,
    /// Leaf: [`LEAF_BIT`] and the number of triangles. Inner: the number of children.
    pub count: u32,
}

impl Link {
    pub(super) const NOWHERE: Link = Link { entry: f32::INFINITY, node: 0, first: 0, count: LEAF_BIT };

    #[inline(always)]
    pub fn is_leaf(&self) -> bool {
        self.count & LEAF_BIT != 0
    }

    /// Prepared triangles of a leaf.
    #[inline(always)]
    pub fn triangles(&self) -> std::ops::Range<usize> {
        let first = self.first as usize;
        first..first + (self.count & !LEAF_BIT) as usize
    }
}

/// Entries that wait. Its room is fixed per tree, so nothing is allocated while a query runs.
#[derive(Debug, Default)]
pub struct Stack {
    links: Vec<Link>,
    top: usize,
}

impl Stack {
    /// Makes room for `capacity` entries and forgets what was there.
    #[inline]
    pub(super) fn start(&mut self, capacity: usize) {
        if self.links.len() < capacity {
            self.links.resize(capacity, Link::NOWHERE);
        }
        self.top = 0;
    }

    #[inline(always)]
    pub fn push(&mut self, link: Link) {
        self.push_if(link, true);
    }

    /// Writes in any case and keeps it only `if_so`: no branch to mispredict.
    #[inline(always)]
    pub fn push_if(&mut self, link: Link, if_so: bool) {
        self.links[self.top] = link;
        self.top += if_so as usize;
    }

    #[inline(always)]
    pub fn pop(&mut self) -> Option<Link> {
        self.top = self.top.checked_sub(1)?;
        Some(self.links[self.top])
    }

    /// The entries pushed since the stack held `since`.
    #[inline(always)]
    pub fn above(&mut self, since: usize) -> &mut [Link] {
        &mut self.links[since..self.top]
    }

    #[inline(always)]
    pub fn len(&self) -> usize {
        self.top
    }

    #[inline(always)]
    pub fn is_empty(&self) -> bool {
        self.top == 0
    }
}

/// A tree's inner nodes in memory, and how a ray is tested against the children of one.
pub trait Form {
    /// What a query computes once for all its tests.
    type Ray: Copy;

    fn ray(ray: &PreparedRay) -> Self::Ray;

    /// Calls `found` with each child of the inner node `parent` that the ray overlaps within [tnear, `tfar`].
    fn each(&self, parent: &Link, ray: &Self::Ray, tfar: f32, found: impl FnMut(Link));

    /// The child entered first, if any is overlapped; the others go onto the stack, the last of them first.
    fn nearest(&self, parent: &Link, ray: &Self::Ray, tfar: f32, stack: &mut Stack) -> Option<Link>;
}
