//! Leaves of one wide node: joined, cut in two, and single references moved between them, as long as that lowers the cost. What lies far apart in a
//! binary tree stands side by side in a wide one, where no collapse could join it.
//!
//! Beside that, a child whose own children find room is dissolved into them, and a node whose few references are as well tested as a list becomes a leaf.

use super::likelihood::{Bits, Local};
use super::round::{Known, Round, WORTHWHILE};
use super::working::{Below, Node, Prices, Reference, around, unite, united};
use crate::geometry::padded::PaddedAabb;

/// The round that changes leaves.
pub struct Leaves<'a> {
    pub known: Known<'a>,
}

impl Round for Leaves<'_> {
    fn known(&self) -> &Known<'_> {
        &self.known
    }

    fn change(&self, node: &mut Node, list: &[u32]) {
        let Below::Inner(children) = &mut node.below else { return };
        let least_gain = WORTHWHILE * node.cost;
        loop {
            self.dissolve(children);
            if !children.iter().any(Node::is_leaf) {
                return;
            }
            let (leaves, inner): (Vec<Node>, Vec<Node>) = children.drain(..).partition(Node::is_leaf);
            let room = self.known.prices.width.max(leaves.len() + inner.len()) - inner.len();
            let local = self.known.likelihood.local(list, usize::MAX);
            let mut siblings =
                Siblings { local: &local, prices: self.known.prices, least_gain, groups: Vec::new() };
            siblings.groups = leaves.iter().map(|leaf| siblings.group(leaf.references().to_vec())).collect();
            siblings.improve(room);
            let prices = self.known.prices;
            let leaf = |group: Group| Node::leaf(group.bounds, group.p, group.references, prices);
            children.extend(siblings.groups.into_iter().map(leaf));
            children.extend(inner);
            // Room that was made may be enough for the children of a child.
            if self.dissolved(children).is_none() {
                return;
            }
        }
    }

    /// Makes a node whose children are all leaves a leaf, where that is cheaper.
    fn finish(&self, node: &mut Node) {
        let children = node.children();
        let all = children.iter().map(|child| child.references().len()).sum::<usize>();
        if children.iter().any(|child| !child.is_leaf()) || all > 2 * self.known.prices.max_leaf {
            return;
        }
        let mut references = Vec::with_capacity(all);
        children.iter().for_each(|child| unite(&mut references, child.references()));
        let cost = self.known.prices.of_leaf(node.p, references.len());
        if references.len() <= self.known.prices.max_leaf && cost < node.cost - WORTHWHILE * node.cost {
            (node.below, node.cost) = (Below::Leaf(references), cost);
        }
    }
}

impl Leaves<'_> {
    /// The likeliest child whose children find room.
    fn dissolved(&self, children: &[Node]) -> Option<usize> {
        let room = (self.known.prices.width + 1).checked_sub(children.len())?;
        let fits = |(_, child): &(usize, &Node)| !child.is_leaf() && child.children().len() <= room;
        let inner = children.iter().enumerate().filter(fits);
        inner.max_by(|(_, a), (_, b)| a.p.total_cmp(&b.p)).map(|(place, _)| place)
    }

    fn dissolve(&self, children: &mut Vec<Node>) {
        while let Some(place) = self.dissolved(children) {
            if let Below::Inner(below) = children.remove(place).below {
                children.extend(below);
            }
        }
    }
}

/// A leaf with its rays.
#[derive(Clone)]
struct Group {
    references: Vec<Reference>,
    bounds: PaddedAabb,
    bits: Bits,
    p: f64,
    cost: f64,
}

/// The leaves of a node.
struct Siblings<'a> {
    local: &'a Local<'a>,
    prices: &'a Prices,
    least_gain: f64,
    groups: Vec<Group>,
}

impl Siblings<'_> {
    fn group(&self, references: Vec<Reference>) -> Group {
        let bounds = around(&references);
        self.group_of(references, bounds, self.local.bits(&bounds))
    }

    fn group_of(&self, references: Vec<Reference>, bounds: PaddedAabb, bits: Bits) -> Group {
        let p = self.local.p(&bounds, &bits);
        let cost = self.prices.of_leaf(p, references.len());
        Group { references, bounds, bits, p, cost }
    }

    /// Climbs until nothing is cheaper; there may be `room` leaves.
    fn improve(&mut self, room: usize) {
        loop {
            let merged = self.merge();
            let moved = self.relocate(room);
            let cut = self.groups.len() < room && self.cut();
            if !merged && !moved && !cut {
                return;
            }
        }
    }

    /// Joins the pair for which it pays most, as long as there is one.
    fn merge(&mut self) -> bool {
        let mut changed = false;
        loop {
            let mut best: Option<(f64, usize, usize, Group)> = None;
            for b in 1..self.groups.len() {
                for a in 0..b {
                    let least = best.as_ref().map_or(self.least_gain, |(gain, ..)| *gain);
                    if let Some((gain, union)) = self.union(a, b, least) {
                        best = Some((gain, a, b, union));
                    }
                }
            }
            let Some((_, a, b, union)) = best else { return changed };
            self.groups.remove(b);
            self.groups[a] = union;
            changed = true;
        }
    }

    /// Two leaves in one, if that gains more than `least`.
    fn union(&self, a: usize, b: usize, least: f64) -> Option<(f64, Group)> {
        let (one, other) = (&self.groups[a], &self.groups[b]);
        let most = self.prices.max_leaf;
        if one.references.len().max(other.references.len()) > most {
            return None;
        }
        let bounds = one.bounds.union(&other.bounds);
        let count = united(&one.references, &other.references);
        let limit = one.cost + other.cost - least;
        let bound = || self.prices.of_leaf(self.local.least(&bounds, &one.bits, &other.bits), count);
        if count > most || bound() >= limit {
            return None;
        }
        let bits = self.local.around(&bounds, &one.bits, &other.bits);
        let cost = self.prices.of_leaf(self.local.p(&bounds, &bits), count);
        (cost < limit).then(|| {
            let mut references = one.references.clone();
            unite(&mut references, &other.references);
            (one.cost + other.cost - cost, self.group_of(references, bounds, bits))
        })
    }

    /// Moves single references to other leaves, each to the best one, as long as that pays.
    fn relocate(&mut self, room: usize) -> bool {
        let mut changed = false;
        for from in 0..self.groups.len() {
            let mut place = 0;
            while place < self.groups[from].references.len() && self.groups[from].references.len() > 1 {
                if self.move_one(from, place, room) {
                    changed = true;
                } else {
                    place += 1;
                }
            }
        }
        changed
    }

    /// Moves the reference at `place` of a leaf where that pays most.
    fn move_one(&mut self, from: usize, place: usize, room: usize) -> bool {
        let source = &self.groups[from];
        let mut rest = source.references.clone();
        let moved = rest.remove(place);
        let bounds = around(&rest);
        // A box that does not shrink keeps its rays.
        let rest = if bounds == source.bounds {
            self.group_of(rest, bounds, source.bits.clone())
        } else {
            self.group(rest)
        };
        let saved = source.cost - rest.cost;
        if saved <= self.least_gain {
            return false;
        }
        let bits = self.local.bits(&moved.bounds);
        let mut best: Option<(f64, usize, Group)> = None;
        for to in (0..self.groups.len()).filter(|&to| to != from) {
            let target = &self.groups[to];
            let count = united(&target.references, &[moved]);
            if count > self.prices.max_leaf {
                continue;
            }
            let least = best.as_ref().map_or(self.least_gain, |(gain, ..)| *gain);
            let limit = target.cost + saved - least;
            let bounds = target.bounds.union(&moved.bounds);
            if self.prices.of_leaf(self.local.least(&bounds, &target.bits, &bits), count) >= limit {
                continue;
            }
            let around = self.local.around(&bounds, &target.bits, &bits);
            if self.prices.of_leaf(self.local.p(&bounds, &around), count) < limit {
                let mut references = target.references.clone();
                unite(&mut references, &[moved]);
                let group = self.group_of(references, bounds, around);
                best = Some((target.cost + saved - group.cost, to, group));
            }
        }
        if self.groups.len() < room {
            let alone = self.group_of(vec![moved], moved.bounds, bits);
            let gain = saved - alone.cost;
            if gain > best.as_ref().map_or(self.least_gain, |(gain, ..)| *gain) {
                best = Some((gain, self.groups.len(), alone));
            }
        }
        let Some((_, to, group)) = best else { return false };
        self.groups[from] = rest;
        if to == self.groups.len() {
            self.groups.push(group);
        } else {
            self.groups[to] = group;
        }
        true
    }

    /// Cuts the leaf in two for which that pays most.
    fn cut(&mut self) -> bool {
        let mut best: Option<(f64, usize, [Group; 2])> = None;
        for (place, group) in self.groups.iter().enumerate() {
            let least = best.as_ref().map_or(self.least_gain, |(gain, ..)| *gain);
            if let Some((gain, sides)) = self.halves(group, least) {
                best = Some((gain, place, sides));
            }
        }
        let Some((_, place, [one, other])) = best else { return false };
        self.groups[place] = one;
        self.groups.push(other);
        true
    }

    /// The best cut of a leaf's references in the order of their centres along an axis, if it gains more than `least`.
    fn halves(&self, group: &Group, least: f64) -> Option<(f64, [Group; 2])> {
        let count = group.references.len();
        let nothing = vec![0; group.bits.len()];
        let bound = |side: &[Reference], bounds: &PaddedAabb| {
            self.prices.of_leaf(self.local.p(bounds, &nothing), side.len())
        };
        let mut best: Option<(f64, [Group; 2])> = None;
        for axis in 0..3 {
            let mut sorted = group.references.clone();
            let middle = |reference: &Reference| reference.bounds.lower[axis] + reference.bounds.upper[axis];
            sorted.sort_by(|a, b| middle(a).total_cmp(&middle(b)));
            for place in 1..count {
                let least = best.as_ref().map_or(least, |(gain, _)| *gain);
                let [one, other] = [&sorted[..place], &sorted[place..]];
                let boxes = [around(one), around(other)];
                // Nothing is hit less often than its area says.
                if bound(one, &boxes[0]) + bound(other, &boxes[1]) >= group.cost - least {
                    continue;
                }
                let sides = [self.group(one.to_vec()), self.group(other.to_vec())];
                let gain = group.cost - sides[0].cost - sides[1].cost;
                if gain > least {
                    best = Some((gain, sides));
                }
            }
        }
        best
    }
}
