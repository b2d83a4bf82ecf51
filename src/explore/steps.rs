//! One query, step by step, as the real traversal goes: what is tested, what is put off, what is taken up again and what is culled.
//!
//! An observer of the kernels ([`Observer`]) writes down each step; nothing is traversed here. Boxes of one node, and triangles of one block,
//! are tested at once by the machine; a step is a node, or a triangle.
//!
//! What waits: depth first, a stack; in ray order, a queue sorted by where boxes are entered. Either is made anew for any step from the steps
//! before it ([`Steps::state_at`]).

use super::price::Price;
use super::queries::Asked;
use crate::format::rays::{NO_DEPTH, NO_PATH, NO_TRIANGLE, Record, kind};
use crate::geometry::{Ray, Vec3};
use crate::replay::query::Query;
use crate::traverse::{Counts, Hit, Link, Observer, PreparedRay, PreparedTriangle, Scratch, Traversal};
use crate::tree::TreeView;

/// A subtree that waits to be opened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waiting {
    /// Where the ray enters its box.
    pub entry: f32,
    pub node: u32,
}

/// A child whose box was tested.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tested {
    pub node: u32,
    /// Where the ray enters the box; none when it does not within its interval as it then is.
    pub entry: Option<f32>,
}

/// What happens in a step.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The root's box is tested; it is followed when it is entered.
    Root { entry: Option<f32> },
    /// An inner node is visited, and the boxes of its children are tested.
    Visit {
        node: u32,
        /// In the order of the file.
        children: Vec<Tested>,
        /// The child that is followed at once, depth first.
        followed: Option<u32>,
        /// Those that were put off, in the order in which they came to wait: the last is taken up first.
        pushed: Vec<Waiting>,
    },
    /// A leaf is opened.
    Leaf { node: u32 },
    /// A triangle is tested.
    Triangle {
        leaf: u32,
        triangle: u32,
        /// Where it is hit, when that is the best hit so far. A hit behind the interval's end counts as none.
        hit: Option<f32>,
    },
    /// What waited is taken up: it is followed.
    Taken(Waiting),
    /// What waited begins behind the interval's end, and is dropped. In ray order so does all else that waits: that is the end.
    Culled(Waiting),
}

/// A step, and how things are after it.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    pub event: Event,
    /// End of the interval: the best hit so far, else the ray's.
    pub end: f32,
    /// Nanoseconds so far; a block of triangles counts with its first.
    pub cost: f64,
    /// Visits, leaves, blocks and tests so far.
    pub counts: Counts,
}

/// The traversal of one query.
#[derive(Clone, Debug)]
pub struct Steps {
    pub traversal: Traversal,
    /// The first is the root's.
    pub steps: Vec<Step>,
    pub answer: Option<Hit>,
}

/// The record of a query that nobody recorded: from a click into space. It sees every triangle.
pub fn question(ray: Ray, occlusion: bool) -> Record {
    Record {
        origin: ray.origin,
        tnear: ray.tnear,
        direction: ray.direction,
        tfar: ray.tfar,
        time: 0.0,
        mask: u32::MAX,
        t: f32::INFINITY,
        triangle: NO_TRIANGLE,
        u: 0.0,
        v: 0.0,
        path: NO_PATH,
        kind: if occlusion { kind::OCCLUSION } else { kind::CLOSEST_HIT },
        depth: NO_DEPTH,
        flags: 0,
        purpose: 0,
    }
}

impl Steps {
    /// Follows `query` through `tree`, which is the one that is asked.
    pub fn of(asked: &Asked, tree: TreeView, query: &Query) -> Steps {
        let ray = PreparedRay::new(&query.ray);
        let mut recorder = Recorder {
            root: ray.entry(&tree.nodes[0].bounds(), ray.tfar),
            tree,
            steps: Vec::new(),
            node: 0,
            end: ray.tfar,
            hits: Vec::new(),
            price: asked.price,
            occlusion: query.record.is_occlusion(),
            counts: Counts::default(),
        };
        let answer = asked.ask(query, &mut recorder, &mut Scratch::default());
        Steps { traversal: asked.traversal, steps: recorder.steps, answer }
    }

    /// What waits after step number `step`: the one that is taken up next comes first.
    pub fn state_at(&self, step: usize) -> Vec<Waiting> {
        let mut waiting: Vec<Waiting> = Vec::new();
        for step in self.steps.iter().take(step + 1) {
            match &step.event {
                Event::Visit { pushed, .. } if self.traversal == Traversal::Odf => waiting.extend(pushed),
                Event::Visit { pushed, .. } => {
                    for &link in pushed {
                        let place = waiting.partition_point(|other| other.entry >= link.entry);
                        waiting.insert(place, link);
                    }
                }
                Event::Taken(_) | Event::Culled(_) => {
                    waiting.pop();
                }
                _ => {}
            }
        }
        waiting.reverse();
        waiting
    }

    /// Where the ray is in step number `step`: where it enters the box in question, or hits the triangle; none where it does neither.
    pub fn point_at(&self, query: &Query, step: usize) -> Option<Vec3> {
        let t = match &self.steps.get(step)?.event {
            Event::Root { entry } => *entry,
            Event::Visit { children, .. } => {
                children.iter().filter_map(|child| child.entry).min_by(f32::total_cmp)
            }
            Event::Triangle { hit, .. } => *hit,
            Event::Taken(waiting) | Event::Culled(waiting) => Some(waiting.entry),
            Event::Leaf { .. } => None,
        };
        t.map(|t| query.ray.at(t))
    }
}

/// Writes down what a traversal does.
struct Recorder<'t> {
    tree: TreeView<'t>,
    /// Where the root's box is entered.
    root: Option<f32>,
    steps: Vec<Step>,
    /// The node that is open.
    node: u32,
    end: f32,
    /// Hits among the triangles that are being tested.
    hits: Vec<Hit>,
    price: Price,
    occlusion: bool,
    counts: Counts,
}

impl Recorder<'_> {
    fn step(&mut self, event: Event) {
        let Recorder { end, counts, price, occlusion, .. } = *self;
        self.steps.push(Step { event, end, cost: price.cost(occlusion, 1, counts), counts });
    }
}

impl From<&Link> for Waiting {
    fn from(link: &Link) -> Waiting {
        Waiting { entry: link.entry, node: link.node }
    }
}

impl Observer for Recorder<'_> {
    fn root(&mut self) {
        self.counts.root();
        self.step(Event::Root { entry: self.root });
    }

    fn inner(&mut self, node: &Link) {
        self.counts.inner(node);
        self.node = node.node;
    }

    fn waiting(&mut self, followed: Option<&Link>, waiting: &[Link]) {
        // A node waits once at most, so its children that wait have just come.
        let range = self.tree.nodes[self.node as usize].range();
        let own = |link: &&Link| range.contains(&(link.node as usize));
        let pushed: Vec<Waiting> = waiting.iter().filter(own).map(Waiting::from).collect();
        let entered = |node: usize| {
            let known = pushed.iter().copied().chain(followed.map(Waiting::from));
            known.into_iter().find(|link| link.node as usize == node).map(|link| link.entry)
        };
        let children = range.clone().map(|node| Tested { node: node as u32, entry: entered(node) }).collect();
        let followed = followed.map(|link| link.node);
        self.step(Event::Visit { node: self.node, children, followed, pushed });
    }

    fn popped(&mut self, link: &Link, followed: bool) {
        self.step(if followed { Event::Taken(link.into()) } else { Event::Culled(link.into()) });
    }

    fn leaf(&mut self, leaf: &Link) {
        self.counts.leaf(leaf);
        self.node = leaf.node;
        self.step(Event::Leaf { node: leaf.node });
    }

    fn hit(&mut self, hit: Hit) {
        self.hits.push(hit);
    }

    fn primitives(&mut self, triangles: impl ExactSizeIterator<Item = PreparedTriangle>) {
        self.counts.block_tests += 1;
        for PreparedTriangle { index, .. } in triangles {
            self.counts.primitive_tests += 1;
            let hit = self.hits.iter().find(|hit| hit.triangle == index).map(|hit| hit.t);
            self.end = hit.unwrap_or(self.end);
            self.step(Event::Triangle { leaf: self.node, triangle: index, hit });
        }
        self.hits.clear();
    }
}
