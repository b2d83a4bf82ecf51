//! The cheapest wide tree that keeps a binary hierarchy over parts, by dynamic programming from the bottom up: as
//! [`crate::tree::collapse`], over parts that are leaves or finished subtrees, with their boxes kept.
//!
//! Of each join, the least cost of what is below as a forest of at most 1, 2, … trees is known. One tree is a leaf, where all parts are leaves
//! and few enough, or a node over a forest; a forest is one of the first side beside one of the second. A part that is an inner node may be
//! dissolved into its children.

use super::working::{Below, Node, Prices, Reference, unite};
use crate::geometry::padded::PaddedAabb;
use crate::tree::collapse::MAX_WIDTH;

/// A node of the hierarchy. Those below stand before it.
#[derive(Clone, Copy, Debug)]
pub struct Join {
    pub bounds: PaddedAabb,
    pub p: f64,
    pub below: Sides,
}

#[derive(Clone, Copy, Debug)]
pub enum Sides {
    /// A part, by its number.
    Part(usize),
    /// Two joins, by their places.
    Pair(usize, usize),
}

/// What is chosen for one join: entry `i` is about at most `i + 1` trees.
#[derive(Clone, Copy, Debug)]
struct Choice {
    cost: [f64; MAX_WIDTH],
    /// How many of the trees go to the first side; 0 where fewer trees are no worse.
    first: [u8; MAX_WIDTH],
    /// Of the forest below the node that one tree is.
    below: u8,
    /// Whether one tree is a leaf.
    leaf: bool,
    /// References below, with doubles, where all parts are leaves; [`TOO_MANY`] else.
    references: usize,
}

/// References of what cannot become one leaf.
const TOO_MANY: usize = usize::MAX;

/// What is chosen for a hierarchy.
pub struct Forest<'a> {
    joins: &'a [Join],
    choices: Vec<Choice>,
    prices: &'a Prices,
}

impl<'a> Forest<'a> {
    /// The last of `joins` is the root.
    pub fn new(joins: &'a [Join], parts: &[&Node], prices: &'a Prices) -> Forest<'a> {
        let mut choices: Vec<Choice> = Vec::with_capacity(joins.len());
        let mut found = Vec::new();
        for (place, join) in joins.iter().enumerate() {
            let choice = match join.below {
                Sides::Part(part) => of_part(parts[part], prices),
                Sides::Pair(a, b) => {
                    let mut choice = of_pair(join, &choices[a], &choices[b], prices);
                    if choice.references <= 2 * prices.max_leaf {
                        found.clear();
                        gather(joins, place, parts, &mut found);
                        found.sort_unstable();
                        found.dedup();
                        if found.len() <= prices.max_leaf {
                            let leaf = prices.of_leaf(join.p, found.len());
                            if leaf <= choice.cost[0] {
                                (choice.cost[0], choice.leaf) = (leaf, true);
                            }
                        }
                    }
                    never_worse(&mut choice);
                    choice
                }
            };
            choices.push(choice);
        }
        Forest { joins, choices, prices }
    }

    /// Of the whole as one tree.
    pub fn cost(&self) -> f64 {
        self.choices.last().map_or(0.0, |choice| choice.cost[0])
    }

    /// The tree. `parts` are those it was chosen for; each is used once.
    pub fn tree(&self, parts: Vec<Node>) -> Option<Node> {
        let mut parts: Vec<Option<Node>> = parts.into_iter().map(Some).collect();
        self.one(self.joins.len().checked_sub(1)?, &mut parts)
    }

    fn one(&self, place: usize, parts: &mut [Option<Node>]) -> Option<Node> {
        let join = &self.joins[place];
        if let Sides::Part(part) = join.below {
            return parts[part].take();
        }
        if self.choices[place].leaf {
            let mut references = Vec::new();
            self.take_references(place, parts, &mut references);
            return Some(Node::leaf(join.bounds, join.p, references, self.prices));
        }
        let mut roots = Vec::new();
        self.below(place, &mut roots);
        let mut children = Vec::with_capacity(self.prices.width);
        for (root, dissolved) in roots {
            match self.one(root, parts) {
                Some(Node { below: Below::Inner(below), .. }) if dissolved => children.extend(below),
                child => children.extend(child),
            }
        }
        Some(Node::inner(join.bounds, join.p, children, self.prices))
    }

    fn take_references(&self, place: usize, parts: &mut [Option<Node>], found: &mut Vec<Reference>) {
        match self.joins[place].below {
            Sides::Part(part) => {
                if let Some(Node { below: Below::Leaf(references), .. }) = parts[part].take() {
                    unite(found, &references);
                }
            }
            Sides::Pair(a, b) => {
                self.take_references(a, parts, found);
                self.take_references(b, parts, found);
            }
        }
    }

    /// The roots of the forest below the node at `place`, and which of them are dissolved.
    fn below(&self, place: usize, roots: &mut Vec<(usize, bool)>) {
        self.divide(place, self.prices.width, self.choices[place].below, roots);
    }

    fn divide(&self, place: usize, trees: usize, of_first: u8, roots: &mut Vec<(usize, bool)>) {
        if let Sides::Pair(a, b) = self.joins[place].below {
            let of_first = usize::from(of_first);
            self.forest(a, of_first, roots);
            self.forest(b, trees - of_first, roots);
        }
    }

    fn forest(&self, place: usize, mut trees: usize, roots: &mut Vec<(usize, bool)>) {
        let choice = &self.choices[place];
        while trees > 1 && choice.first[trees - 1] == 0 {
            trees -= 1;
        }
        if trees == 1 {
            roots.push((place, false));
        } else if let Sides::Part(_) = self.joins[place].below {
            roots.push((place, true));
        } else {
            self.divide(place, trees, choice.first[trees - 1], roots);
        }
    }
}

fn of_part(part: &Node, prices: &Prices) -> Choice {
    let mut choice = Choice {
        cost: [part.cost; MAX_WIDTH],
        first: [0; MAX_WIDTH],
        below: 0,
        leaf: part.is_leaf(),
        references: if part.is_leaf() { part.references().len() } else { TOO_MANY },
    };
    let children = part.children().len();
    // Room for all of its children makes it superfluous.
    if (2..=prices.width).contains(&children) {
        choice.cost[children - 1] = part.cost - part.p * prices.visit;
        choice.first[children - 1] = 1;
        never_worse(&mut choice);
    }
    choice
}

fn of_pair(join: &Join, a: &Choice, b: &Choice, prices: &Prices) -> Choice {
    // The cheapest forest of exactly up to `trees` trees that takes some from both sides.
    let forest = |trees: usize| {
        let mut best = (f64::INFINITY, 1u8);
        for of_first in 1..trees {
            let cost = a.cost[of_first - 1] + b.cost[trees - of_first - 1];
            if cost < best.0 {
                best = (cost, of_first as u8);
            }
        }
        best
    };
    let (below, of_first) = forest(prices.width);
    let mut choice = Choice {
        cost: [f64::INFINITY; MAX_WIDTH],
        first: [0; MAX_WIDTH],
        below: of_first,
        leaf: false,
        references: a.references.saturating_add(b.references),
    };
    choice.cost[0] = join.p * prices.visit + below;
    for trees in 2..=prices.width {
        (choice.cost[trees - 1], choice.first[trees - 1]) = forest(trees);
    }
    choice
}

/// More trees are allowed, not demanded.
fn never_worse(choice: &mut Choice) {
    for trees in 1..MAX_WIDTH {
        if choice.first[trees] == 0 || choice.cost[trees] >= choice.cost[trees - 1] {
            (choice.cost[trees], choice.first[trees]) = (choice.cost[trees - 1], 0);
        }
    }
}

/// Adds the triangles below, with doubles.
fn gather(joins: &[Join], place: usize, parts: &[&Node], found: &mut Vec<u32>) {
    match joins[place].below {
        Sides::Part(part) => {
            found.extend(parts[part].references().iter().map(|reference| reference.triangle));
        }
        Sides::Pair(a, b) => {
            gather(joins, a, parts, found);
            gather(joins, b, parts, found);
        }
    }
}
