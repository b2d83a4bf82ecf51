//! One packet through a tree, depth first or front to back.
//!
//! What waits is a node with the octets that may enter it. Whether they enter a child is decided by the rules of Wald, Boulos and Shirley, "Ray
//! Tracing Deformable Scenes Using Dynamic Bounding Volume Hierarchies" (2007), see [`Walk::enter`]. A packet of which few rays are left in
//! many octets is regrouped for the subtree (Boulos, Wald and Benthin, "Adaptive Ray Packet Reordering", 2008), and two rays or one go alone.

use super::super::candidates::Candidates;
use super::super::child_order::{ByRule, ChildOrder};
use super::super::form::{Children, Faces, Link, Room};
use super::super::leaf;
use super::super::observer::Counts;
use super::super::simd::{Eight, LaneMask};
use super::super::{Prepared, Traversal};
use super::bundle::{Bundles, LANES, OCTETS, Splat};
use super::watch::{PacketObserver, Rule};

/// Active octets from which on the rules that spare testing them are tried; fewer are tested at once.
const RULES_FROM: u32 = 4;

/// Rays that go on alone when no others enter a node.
const FEW: u32 = 2;

/// A packet is regrouped when fewer than one lane in so many of its active octets enters a node.
const SPARSE: u32 = 3;

/// A node that waits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Waiting {
    /// Its entry is where the first ray known to enter does.
    link: Link,
    faces: Faces,
    /// The octets that may enter it, as bits.
    octets: u32,
    /// How many rays enter it; `u32::MAX` when that is not known.
    rays: u32,
}

/// What is known of who enters a box.
struct Entered {
    octets: u32,
    rays: u32,
    entry: f32,
}

/// An octet in a leaf.
#[derive(Clone, Copy, Debug)]
struct Inside {
    octet: usize,
    /// The rays that enter the leaf's box, as bits, and where.
    lanes: u32,
    entries: [f32; LANES],
}

/// Room for what a packet needs on its way, kept from packet to packet.
#[derive(Debug, Default)]
pub(super) struct Agenda {
    /// The next one last.
    waiting: Vec<Waiting>,
    inside: Vec<Inside>,
    /// How many nodes waited when the packet was regrouped, each time.
    regrouped: Vec<usize>,
    room: Room,
}

/// Puts a node behind all those above `since` that come first.
#[inline(always)]
fn insert(
    waiting: &mut Vec<Waiting>,
    since: usize,
    node: Waiting,
    comes_first: impl Fn(&Link, &Link) -> bool,
) {
    let mut place = waiting.len();
    waiting.push(node);
    while place > since && !comes_first(&node.link, &waiting[place - 1].link) {
        waiting[place] = waiting[place - 1];
        place -= 1;
    }
    waiting[place] = node;
}

/// Takes the lowest bit of a set.
#[inline(always)]
pub(super) fn next<const N: usize>(bits: &mut u32) -> usize {
    let bit = bits.trailing_zeros() as usize % N;
    *bits &= *bits - 1;
    bit
}

/// A packet on its way.
struct Walk<'a, C, O> {
    prepared: &'a Prepared,
    order: &'a ByRule<'a>,
    candidates: &'a [C],
    /// The packet's rays; behind them those that were regrouped, each time.
    bundles: &'a mut Bundles,
    inside: &'a mut Vec<Inside>,
    observer: &'a mut O,
}

impl<C: Candidates, O: PacketObserver> Walk<'_, C, O> {
    #[inline(always)]
    fn test<V: Eight>(&mut self, octet: usize, faces: &Faces) -> (V::Mask, V) {
        let bundle = self.bundles.current();
        if O::LISTENS {
            self.observer.boxes(bundle.queries_of(octet));
        }
        bundle.octets[octet].enter::<V>(faces)
    }

    /// Those of `octets` that may enter the box, and where the first ray known to does.
    ///
    /// Early hit: the first octet enters, and the last, so all may. (As published the first is enough. Where rays go apart that takes along
    /// too many that do not enter: asking the last one too is never slower, and for diffuse rays a tenth faster.) Early miss: by interval
    /// arithmetic none can. Else all are tested.
    #[inline(always)]
    fn enter<V: Eight>(&mut self, faces: &Faces, octets: u32) -> Entered {
        let nowhere = V::splat(f32::INFINITY);
        let mut rule = Rule::Few;
        if octets.count_ones() >= RULES_FROM {
            rule = Rule::Rays;
            let (mask, entry) = self.test::<V>(octets.trailing_zeros() as usize % OCTETS, faces);
            if mask.bits() == 0 {
                let bundle = self.bundles.current();
                let end = bundle.end::<V>();
                if bundle.frustum.misses(faces, end) {
                    self.observer.decided(Rule::EarlyMiss);
                    return Entered { octets: 0, rays: 0, entry: f32::INFINITY };
                }
            } else if self.test::<V>(octets.ilog2() as usize % OCTETS, faces).0.bits() != 0 {
                self.observer.decided(Rule::EarlyHit);
                return Entered { octets, rays: u32::MAX, entry: V::select(mask, entry, nowhere).least() };
            }
        }
        let (mut entered, mut rays, mut first) = (0, 0, nowhere);
        let mut rest = octets;
        while rest != 0 {
            let octet = next::<OCTETS>(&mut rest);
            let (mask, entry) = self.test::<V>(octet, faces);
            let lanes = mask.bits();
            entered |= u32::from(lanes != 0) << octet;
            rays += lanes.count_ones();
            first = V::select(mask, entry, nowhere).min_or(first);
        }
        self.observer.decided(rule);
        Entered { octets: entered, rays, entry: first.least() }
    }

    /// Tells that an inner node is visited.
    #[inline(always)]
    fn visit(&mut self, mut octets: u32) {
        while O::LISTENS && octets != 0 {
            self.observer.inner(self.bundles.current().queries_of(next::<OCTETS>(&mut octets)));
        }
    }

    /// The rays that enter a node go on one by one.
    #[inline(always)]
    fn alone<const ANY: bool, V: Eight>(&mut self, node: &Waiting, room: &mut Room) {
        let mut octets = node.octets;
        while octets != 0 {
            let octet = next::<OCTETS>(&mut octets);
            let (mask, entry) = self.test::<V>(octet, &node.faces);
            let (mut lanes, entries) = (mask.bits(), entry.to_array());
            while lanes != 0 {
                let lane = next::<LANES>(&mut lanes);
                let from = Link { entry: entries[lane], ..node.link };
                let bundle = self.bundles.current();
                let query = bundle.queries[octet * LANES + lane];
                let candidates = &self.candidates[query as usize];
                let rays = &mut bundle.octets[octet];
                let (ray, before) = (rays.ray(lane), rays.best(lane));
                let best = if O::LISTENS {
                    let counts = &mut Counts::default();
                    let best = self
                        .prepared
                        .resume::<ANY, _>(self.order, from, &ray, candidates, counts, before, room);
                    self.observer.alone(query, counts);
                    best
                } else {
                    self.prepared.resume::<ANY, _>(self.order, from, &ray, candidates, &mut (), before, room)
                };
                if best.triangle != before.triangle || best.t != before.t {
                    rays.keep::<ANY>(lane, &best);
                }
            }
        }
    }

    /// Tests the triangles of a leaf.
    #[inline(always)]
    fn leaf<const ANY: bool, V: Eight>(&mut self, leaf: &Waiting) {
        self.inside.clear();
        let mut octets = leaf.octets;
        while octets != 0 {
            let octet = next::<OCTETS>(&mut octets);
            let (mask, entry) = self.test::<V>(octet, &leaf.faces);
            let lanes = mask.bits();
            if lanes != 0 {
                self.inside.push(Inside { octet, lanes, entries: entry.to_array() });
            }
        }
        if self.inside.is_empty() {
            return;
        }
        let bundle = self.bundles.current();
        for slot in leaf.link.triangles() {
            let triangle = self.prepared.blocks.triangle(slot);
            let splat = Splat::<V>::new(&triangle.vertices);
            for Inside { octet, lanes, entries } in &*self.inside {
                let rays = &mut bundle.octets[*octet];
                let (mask, distances) = rays.hits::<V>(&splat, &bundle.near_face);
                let mut hit = mask & lanes;
                while hit != 0 {
                    let lane = next::<LANES>(&mut hit);
                    let mut best = rays.best(lane);
                    let candidates = &self.candidates[bundle.queries[octet * LANES + lane] as usize];
                    if leaf::hit(&triangle, distances[lane], entries[lane], candidates, &mut best) {
                        rays.keep::<ANY>(lane, &best);
                        bundle.hits += 1;
                    }
                }
                let mut lanes = *lanes;
                while O::LISTENS && lanes != 0 {
                    let lane = next::<LANES>(&mut lanes);
                    self.observer.primitive(bundle.queries[octet * LANES + lane]);
                }
            }
        }
    }

    /// Puts the rays that enter a node side by side, into as few octets as they need. What is found of them is put back when the subtree is done.
    #[inline(always)]
    fn regroup<V: Eight>(&mut self, node: &mut Waiting) {
        let (from, to) = self.bundles.next();
        to.clear(from.near_face);
        let mut octets = node.octets;
        while octets != 0 {
            let octet = next::<OCTETS>(&mut octets);
            let (mask, _) = from.octets[octet].enter::<V>(&node.faces);
            if O::LISTENS {
                self.observer.boxes(from.queries_of(octet));
            }
            let mut lanes = mask.bits();
            while lanes != 0 {
                let lane = next::<LANES>(&mut lanes);
                to.push(&from.octets[octet], lane, from.queries[octet * LANES + lane]);
                to.places.push((octet * LANES + lane) as u32);
            }
        }
        node.octets = to.all();
        to.bound::<V>(RULES_FROM);
    }
}

/// Follows the tree from its root, whose inner nodes are `form`. With `ANY` any hit of a ray is an answer, else the closest. In RayOrder what is
/// entered first is visited first, else children are visited in `order`, before what waits already.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // One call site; a struct would only rename them.
pub(super) fn run<const ANY: bool, V: Eight, C: Candidates>(
    prepared: &Prepared,
    form: &impl Children,
    traversal: Traversal,
    order: &ByRule,
    bundles: &mut Bundles,
    candidates: &[C],
    observer: &mut impl PacketObserver,
    Agenda { waiting, inside, regrouped, room }: &mut Agenda,
) {
    let front_to_back = traversal == Traversal::RayOrder;
    let first = bundles.current();
    first.bound::<V>(RULES_FROM);
    let (near_face, all) = (first.near_face, first.all());
    let bounds = [prepared.root_bounds.lower, prepared.root_bounds.upper];
    let faces = Faces::new(|axis, side| bounds[side][axis], &near_face);
    let mut walk = Walk { prepared, order, candidates, bundles, inside, observer };
    let Entered { octets, rays, entry } = walk.enter::<V>(&faces, all);
    if octets == 0 {
        return;
    }
    let mut current = Waiting { link: Link { entry, ..prepared.root }, faces, octets, rays };
    waiting.clear();
    loop {
        let before = waiting.len();
        if current.rays <= FEW {
            walk.alone::<ANY, V>(&current, room);
        } else if current.link.is_leaf() {
            walk.leaf::<ANY, V>(&current);
        } else {
            let active = current.octets.count_ones();
            if !front_to_back && active > 1 && current.rays.saturating_mul(SPARSE) <= active * LANES as u32 {
                walk.regroup::<V>(&mut current);
                regrouped.push(before);
            }
            walk.visit(current.octets);
            for number in 0..current.link.count as usize {
                let (mut link, faces) = form.child(&current.link, number, &near_face);
                let Entered { octets, rays, entry } = walk.enter::<V>(&faces, current.octets);
                if octets != 0 {
                    link.entry = entry;
                    let child = Waiting { link, faces, octets, rays };
                    insert(waiting, if front_to_back { 0 } else { before }, child, |a, b| {
                        if front_to_back { a.entry <= b.entry } else { order.precedes(&current.link, a, b) }
                    });
                }
            }
        }
        let fresh = !front_to_back && waiting.len() > before;
        loop {
            while regrouped.last() == Some(&waiting.len()) {
                walk.bundles.put_back();
                regrouped.pop();
            }
            let Some(next) = waiting.pop() else { return };
            current = next;
            if fresh || (current.link.is_leaf() && current.rays > FEW) {
                break;
            }
            let Entered { octets, rays, entry } = walk.enter::<V>(&current.faces, current.octets);
            (current.octets, current.rays, current.link.entry) = (octets, rays, entry);
            if octets != 0 {
                break;
            }
        }
    }
}
