//! What a traversal needs of a tree's memory layout. A new layout is a new implementation; the algorithms stay as they are.

use super::ray::PreparedRay;
use super::simd::Machine;
use crate::tree::LEAF_BIT;

/// What is below a node: [`Link::first`] and [`Link::count`].
#[derive(Clone, Copy, Debug)]
#[repr(C, align(8))]
pub struct Below {
    pub first: u32,
    pub count: u32,
}

impl Below {
    /// A leaf without triangles.
    pub(super) const NOTHING: Below = Below { first: 0, count: LEAF_BIT };

    #[inline(always)]
    pub(super) fn is_leaf(self) -> bool {
        self.count & LEAF_BIT != 0
    }
}

/// A subtree that the ray overlaps, and where to find what is below.
#[derive(Clone, Copy, Debug)]
pub struct Link {
    /// Where the ray enters its box.
    pub entry: f32,
    /// Index of its node in the file.
    pub node: u32,
    /// Leaf: the first slot of its triangles. Inner: wherever the form keeps its children.
    pub first: u32,
    /// Leaf: [`LEAF_BIT`] and the number of triangles. Inner: the number of children.
    pub count: u32,
}

impl Link {
    pub(super) const NOWHERE: Link = Link { entry: f32::INFINITY, node: 0, first: 0, count: LEAF_BIT };

    /// The link to `node`, whose box is entered at `entry` and whose children or triangles are at `first`.
    #[inline(always)]
    pub(super) fn to(node: u32, Below { first, count }: Below, entry: f32) -> Link {
        Link { entry, node, first, count }
    }

    #[inline(always)]
    pub fn is_leaf(&self) -> bool {
        self.count & LEAF_BIT != 0
    }

    /// Slots of a leaf's triangles.
    #[inline(always)]
    pub fn triangles(&self) -> std::ops::Range<usize> {
        let first = self.first as usize;
        first..first + (self.count & !LEAF_BIT) as usize
    }
}

/// Room for entries that wait, kept from query to query, so that nothing is allocated while one runs.
#[derive(Debug, Default)]
pub struct Room(Vec<Link>);

impl Room {
    /// An empty stack for `capacity` entries.
    #[inline]
    pub(super) fn stack(&mut self, capacity: usize) -> Stack<'_> {
        if self.0.len() < capacity {
            self.0.resize(capacity, Link::NOWHERE);
        }
        Stack { links: &mut self.0, top: 0 }
    }
}

/// Entries that wait.
#[derive(Debug)]
pub struct Stack<'a> {
    links: &'a mut [Link],
    top: usize,
}

impl Stack<'_> {
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

    /// Pushes `link`, below those above `since` that are entered no later.
    #[inline(always)]
    pub fn insert(&mut self, since: usize, link: Link) {
        let mut place = self.top;
        while place > since && self.links[place - 1].entry <= link.entry {
            self.links[place] = self.links[place - 1];
            place -= 1;
        }
        self.links[place] = link;
        self.top += 1;
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

    /// All entries, the top one last.
    #[inline(always)]
    pub fn all(&self) -> &[Link] {
        // Without a bounds check that could panic, nothing is left of this where no observer looks.
        self.links.get(..self.top).unwrap_or_default()
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

/// A tree's inner nodes in memory, and how a ray is tested against the children of one on a kind of processor.
pub trait Form<M: Machine> {
    /// What a query computes once for all its tests.
    type Ray: Copy;

    fn ray(ray: &PreparedRay) -> Self::Ray;

    /// Where what is below an inner node begins in memory.
    fn address(&self, parent: &Link) -> *const u8;

    /// Calls `found` with each child of the inner node `parent` that the ray overlaps within [tnear, `tfar`].
    fn each(&self, parent: &Link, ray: &Self::Ray, tfar: f32, found: impl FnMut(Link));

    /// The child entered first, if any is overlapped; the others go onto the stack, the last of them first. `found` is called with
    /// each, as soon as it is known.
    fn nearest(
        &self,
        parent: &Link,
        ray: &Self::Ray,
        tfar: f32,
        found: impl Fn(&Link),
        stack: &mut Stack,
    ) -> Option<Link>;

    /// Pushes what is below each child of `parent` that the ray overlaps onto `stack`, which holds `top` entries: the first of the file on top;
    /// with `OUTSIDE`, those that it enters after its start above the others. How many entries there are then.
    fn push_all<const OUTSIDE: bool>(
        &self,
        parent: &Link,
        ray: &Self::Ray,
        tfar: f32,
        stack: &mut [Below],
        top: usize,
    ) -> usize;

    /// As [`Self::nearest`], in the order of the file.
    fn first(
        &self,
        parent: &Link,
        ray: &Self::Ray,
        tfar: f32,
        found: impl Fn(&Link),
        stack: &mut Stack,
    ) -> Option<Link>;
}

/// The children of an inner node one by one, as packets ask for them.
pub trait Children {
    /// A child, whose entry is not known, and its box. `near_face`: by axis, 1 when the upper face is the near one.
    fn child(&self, parent: &Link, number: usize, near_face: &[usize; 3]) -> (Link, Faces);
}

/// The faces of a box as rays that run the same way along each axis meet them, by axis.
#[derive(Clone, Copy, Debug)]
pub struct Faces {
    pub near: [f32; 3],
    pub far: [f32; 3],
}

impl Faces {
    #[inline(always)]
    pub(super) fn new(faces: impl Fn(usize, usize) -> f32, near_face: &[usize; 3]) -> Faces {
        Faces {
            near: std::array::from_fn(|axis| faces(axis, near_face[axis] & 1)),
            far: std::array::from_fn(|axis| faces(axis, near_face[axis] & 1 ^ 1)),
        }
    }
}
