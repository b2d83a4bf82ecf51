//! One packet through a tree, depth first or front to back.
//!
//! What waits is a node with the octets that may enter it. Whether they enter a child is decided by the rules of Wald, Boulos and Shirley, "Ray
//! Tracing Deformable Scenes Using Dynamic Bounding Volume Hierarchies" (2007), see [`Walk::enter`].

use super::super::blocks::Blocks;
use super::super::candidates::Candidates;
use super::super::child_order::ChildOrder;
use super::super::form::{Children, Faces, Link};
use super::super::leaf;
use super::super::simd::{Eight, LaneMask, Machine};
use super::bundle::{Bundle, LANES, OCTETS, Splat};
use super::frustum::Frustum;
use super::watch::{PacketObserver, Rule};

/// Active octets from which on the rules that spare testing them are tried; fewer are tested at once.
const RULES_FROM: u32 = 4;

/// A node that waits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Waiting {
    /// Its entry is where the first ray known to enter does.
    link: Link,
    faces: Faces,
    /// The octets that may enter it, as bits.
    octets: u32,
}

/// Puts a node behind all those above `since` that come first.
#[inline(always)]
fn insert(
    agenda: &mut Vec<Waiting>,
    since: usize,
    waiting: Waiting,
    comes_first: impl Fn(&Link, &Link) -> bool,
) {
    let mut place = agenda.len();
    agenda.push(waiting);
    while place > since && !comes_first(&waiting.link, &agenda[place - 1].link) {
        agenda[place] = agenda[place - 1];
        place -= 1;
    }
    agenda[place] = waiting;
}

/// Takes the lowest octet of a set.
#[inline(always)]
fn next(octets: &mut u32) -> usize {
    let octet = octets.trailing_zeros() as usize % OCTETS;
    *octets &= *octets - 1;
    octet
}

/// An octet in a leaf.
#[derive(Clone, Copy, Debug)]
struct Inside {
    octet: usize,
    /// The rays that enter the leaf's box, as bits, and where.
    lanes: u32,
    entries: [f32; LANES],
}

/// What waits, and room for it from packet to packet.
#[derive(Debug, Default)]
pub(super) struct Agenda {
    waiting: Vec<Waiting>,
    inside: Vec<Inside>,
}

/// A packet on its way.
struct Walk<'a, O> {
    bundle: &'a mut Bundle,
    observer: &'a mut O,
    /// Of all rays; without use where they are few.
    frustum: Frustum,
    inside: &'a mut Vec<Inside>,
}

impl<O: PacketObserver> Walk<'_, O> {
    #[inline(always)]
    fn test<V: Eight>(&mut self, octet: usize, faces: &Faces) -> (V::Mask, V) {
        if O::LISTENS {
            self.observer.boxes(self.bundle.queries_of(octet));
        }
        self.bundle.octets[octet].enter::<V>(faces)
    }

    /// Those of `octets` that may enter the box, and where the first ray known to does.
    ///
    /// Early hit: the first octet enters, so all may. Early miss: by interval arithmetic none can. Else all are tested.
    #[inline(always)]
    fn enter<V: Eight>(&mut self, faces: &Faces, octets: u32) -> (u32, f32) {
        let nowhere = V::splat(f32::INFINITY);
        let mut rest = octets;
        if octets.count_ones() >= RULES_FROM {
            let (mask, entry) = self.test::<V>(next(&mut rest), faces);
            if mask.bits() != 0 {
                self.observer.decided(Rule::EarlyHit);
                return (octets, V::select(mask, entry, nowhere).least());
            }
            if self.frustum.misses(faces, self.bundle.end::<V>(octets)) {
                self.observer.decided(Rule::EarlyMiss);
                return (0, f32::INFINITY);
            }
        }
        let (mut entered, mut first) = (0, nowhere);
        while rest != 0 {
            let octet = next(&mut rest);
            let (mask, entry) = self.test::<V>(octet, faces);
            entered |= u32::from(mask.bits() != 0) << octet;
            first = V::select(mask, entry, nowhere).min_or(first);
        }
        self.observer.decided(Rule::Rays);
        (entered, first.least())
    }

    /// Tells that an inner node is visited.
    #[inline(always)]
    fn visit(&mut self, mut octets: u32) {
        while O::LISTENS && octets != 0 {
            self.observer.inner(self.bundle.queries_of(next(&mut octets)));
        }
    }

    /// Tests the triangles of a leaf.
    #[inline(always)]
    fn leaf<const ANY: bool, V: Eight, C: Candidates>(
        &mut self,
        leaf: &Waiting,
        blocks: &Blocks,
        candidates: &[C],
    ) {
        self.inside.clear();
        let mut rest = leaf.octets;
        while rest != 0 {
            let octet = next(&mut rest);
            let (mask, entry) = self.test::<V>(octet, &leaf.faces);
            let lanes = mask.bits();
            if lanes != 0 {
                self.inside.push(Inside { octet, lanes, entries: entry.to_array() });
            }
        }
        if self.inside.is_empty() {
            return;
        }
        for slot in leaf.link.triangles() {
            let triangle = blocks.triangle(slot);
            let splat = Splat::<V>::new(&triangle.vertices);
            for Inside { octet, lanes, entries } in &*self.inside {
                let near_face = self.bundle.near_face;
                let rays = &mut self.bundle.octets[*octet];
                let (mask, distances) = rays.hits::<V>(&splat, &near_face);
                let mut mask = mask & lanes;
                while mask != 0 {
                    let lane = mask.trailing_zeros() as usize % LANES;
                    mask &= mask - 1;
                    let mut best = rays.best(lane);
                    let candidates = &candidates[self.bundle.queries[octet * LANES + lane] as usize];
                    if leaf::hit(&triangle, distances[lane], entries[lane], candidates, &mut best) {
                        rays.keep::<ANY>(lane, &best);
                    }
                }
                if O::LISTENS {
                    let mut lanes = *lanes;
                    while lanes != 0 {
                        let lane = lanes.trailing_zeros() as usize % LANES;
                        lanes &= lanes - 1;
                        self.observer.primitive(self.bundle.queries[octet * LANES + lane]);
                    }
                }
            }
        }
    }
}

/// Follows `root`. With `ANY` any hit of a ray is an answer, else the closest. `FRONT_TO_BACK`: what is entered first is visited first, else
/// children are visited in `order`, before what waits already.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // One call site; a struct would only rename them.
pub(super) fn run<const ANY: bool, const FRONT_TO_BACK: bool, M: Machine, F: Children, C: Candidates>(
    form: &F,
    root: Link,
    root_faces: Faces,
    order: &impl ChildOrder,
    blocks: &Blocks,
    bundle: &mut Bundle,
    candidates: &[C],
    observer: &mut impl PacketObserver,
    Agenda { waiting, inside }: &mut Agenda,
) {
    let near_face = bundle.near_face;
    let all = bundle.all();
    let frustum = Frustum::new::<M::Eight>(if all.count_ones() < RULES_FROM { &[] } else { bundle.in_use() });
    let mut walk = Walk { bundle, observer, frustum, inside };
    let mut current = Waiting { link: root, faces: root_faces, octets: all };
    (current.octets, current.link.entry) = walk.enter::<M::Eight>(&current.faces, all);
    if current.octets == 0 {
        return;
    }
    waiting.clear();
    loop {
        let before = waiting.len();
        if current.link.is_leaf() {
            walk.leaf::<ANY, M::Eight, C>(&current, blocks, candidates);
        } else {
            walk.visit(current.octets);
            for number in 0..current.link.count as usize {
                let (mut link, faces) = form.child(&current.link, number, &near_face);
                let (octets, entry) = walk.enter::<M::Eight>(&faces, current.octets);
                if octets != 0 {
                    link.entry = entry;
                    let child = Waiting { link, faces, octets };
                    insert(waiting, if FRONT_TO_BACK { 0 } else { before }, child, |a, b| {
                        if FRONT_TO_BACK { a.entry <= b.entry } else { order.precedes(&current.link, a, b) }
                    });
                }
            }
        }
        let fresh = !FRONT_TO_BACK && waiting.len() > before;
        loop {
            let Some(next) = waiting.pop() else { return };
            current = next;
            if fresh || current.link.is_leaf() {
                break;
            }
            current.octets = walk.enter::<M::Eight>(&current.faces, current.octets).0;
            if current.octets != 0 {
                break;
            }
        }
    }
}
