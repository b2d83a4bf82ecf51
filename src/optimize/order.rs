//! A traversal order for the occlusion queries of every node of a tree, chosen from recorded ones: the order half of SRDH (Feltman, Lee
//! and Fatahalian, "SRDH: Specializing BVH Construction and Traversal Order Using Representative Shadow Ray Sets", HPG 2012).
//!
//! Data flows so: recorded occlusion queries → their [`Encounter`]s, by one pass over the tree → [`choose`], which tests no box any more →
//! a byte of `ORDR` per node. [`measure`] counts with the real traversal what an order costs, and [`limit`] what no order can beat.
//!
//! A query that is not occluded opens everything that it overlaps in any order, so only occluded ones decide. What one of them costs
//! below a node is exact: the node's own tests, then its children in the node's order up to the first with an occluder, each at the cost
//! of its own order. Two questions are left, and they pull apart: the cost of a node has to be summed over the queries that *reach* it,
//! which depends on the orders above, while what it costs depends on the orders below.
//!
//! 1. From the leaves up, summed over all queries that overlap a node, as if all of them reached it: SRDH's choice.
//! 2. From there, rounds: from the root down, mark the encounters that are reached; from the leaves up, choose again, summed over those
//!    only. While orders above stand still, what a node's change saves is exactly what the tree saves, so no round costs more than
//!    the one before.
//! 3. The same rounds from nearest first everywhere. The cheaper of the two ends is taken: it never costs the training queries more
//!    than nearest first.

use crate::training::occlusions::Occlusion;
use crate::traverse::child_order::rule;
use crate::traverse::encounter::{Encounter, children};
use crate::traverse::{Counts, OcclusionOrder, Prepared, PreparedRay, Scratch, cheapest_proof};
use rayon::prelude::*;

/// What an order is to lower, and how long to try.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// What a box test costs.
    pub c_i: f64,
    /// What a primitive test costs.
    pub c_p: f64,
    /// At most so many rounds from either start.
    pub rounds: usize,
}

impl Default for Config {
    fn default() -> Config {
        Config { c_i: 1.0, c_p: 1.0, rounds: 16 }
    }
}

/// Most encounters that are kept: 40 bytes each. Of queries with more, an even part decides.
const MOST_ENCOUNTERS: usize = 1 << 23;

/// Orders, and what is known of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Chosen {
    /// A byte of [`rule`] per node.
    pub orders: Vec<u8>,
    /// Occluded queries that decided; fewer than there are when they would not fit in memory.
    pub deciding: usize,
    /// Cost below the root of the deciding queries, summed: nearest first everywhere.
    pub nearest: f64,
    /// The same after step 1.
    pub first: f64,
    /// The same for the chosen orders.
    pub cost: f64,
    /// Rounds made from either start, the last one without a change counted too.
    pub rounds: [usize; 2],
}

/// Chooses an order for each of the `nodes` nodes of the tree in `prepared`, on the threads of the current rayon pool.
/// Without an occluded query it is nearest first for all.
pub fn choose(prepared: &Prepared, nodes: usize, queries: &[Occlusion], config: &Config) -> Chosen {
    let table = Table::new(prepared, nodes, queries);
    let mut state = State::new(&table, config);
    let nearest = state.evaluate(&vec![rule::NEAREST; nodes]);

    let mut bottom_up = vec![rule::NEAREST; nodes];
    state.choose(&mut bottom_up, false);
    let first = state.cost();
    let (rounds_up, cost_up) = state.descend(&mut bottom_up, config.rounds);

    let mut from_nearest = vec![rule::NEAREST; nodes];
    state.evaluate(&from_nearest);
    let (rounds_near, cost_near) = state.descend(&mut from_nearest, config.rounds);

    let (orders, cost) = if cost_up <= cost_near { (bottom_up, cost_up) } else { (from_nearest, cost_near) };
    Chosen { orders, deciding: table.starts.len(), nearest, first, cost, rounds: [rounds_up, rounds_near] }
}

/// The encounters of all deciding queries.
struct Table {
    encounters: Vec<Encounter>,
    /// Where each query's begin.
    starts: Vec<usize>,
    /// Places of the encounters of each node that the order matters to: those with two or more children.
    by_node: Vec<u32>,
    /// Where each node's begin in `by_node`; one more than nodes.
    node_starts: Vec<u32>,
}

impl Table {
    fn new(prepared: &Prepared, nodes: usize, queries: &[Occlusion]) -> Table {
        // How many encounters each occluded query has; 0 for others.
        let sizes: Vec<usize> = queries
            .par_iter()
            .map_init(Scratch::default, |scratch, query| {
                let ray = PreparedRay::new(&query.ray);
                let order = &OcclusionOrder::Nearest;
                let hit = prepared.occluder_in(order, &ray, &query.candidates(), &mut (), scratch);
                hit.map_or(0, |_| prepared.overlapped(&ray, scratch))
            })
            .collect();
        let occluded: Vec<usize> = (0..queries.len()).filter(|&index| sizes[index] > 0).collect();
        let mut step = 1;
        let fits = |step: usize| {
            let sum = |sum: usize, &index: &usize| sum.saturating_add(sizes[index]);
            occluded.iter().step_by(step).fold(0, sum) <= MOST_ENCOUNTERS
        };
        while step < occluded.len() && !fits(step) {
            step *= 2;
        }
        let deciding: Vec<usize> =
            if fits(step) { occluded.into_iter().step_by(step).collect() } else { Vec::new() };
        let found: Vec<Vec<Encounter>> = deciding
            .par_iter()
            .map_init(Scratch::default, |scratch, &index| {
                let query = &queries[index];
                let mut found = Vec::with_capacity(sizes[index]);
                let ray = PreparedRay::new(&query.ray);
                prepared.encounters(&ray, &query.candidates(), scratch, &mut found);
                found
            })
            .collect();
        let starts = found
            .iter()
            .scan(0, |next, list| {
                let start = *next;
                *next += list.len();
                Some(start)
            })
            .collect();
        let encounters = found.concat();
        let (by_node, node_starts) = group(&encounters, nodes);
        Table { encounters, starts, by_node, node_starts }
    }

    fn of_node(&self, node: usize) -> &[u32] {
        &self.by_node[self.node_starts[node] as usize..self.node_starts[node + 1] as usize]
    }
}

/// Places of all encounters, sorted by node, and where each node's begin.
fn group(encounters: &[Encounter], nodes: usize) -> (Vec<u32>, Vec<u32>) {
    let mut starts = vec![0u32; nodes + 1];
    for encounter in encounters {
        starts[encounter.node as usize + 1] += 1;
    }
    for node in 0..nodes {
        starts[node + 1] += starts[node];
    }
    let mut next = starts.clone();
    let mut places = vec![0; encounters.len()];
    for (place, encounter) in encounters.iter().enumerate() {
        let slot = &mut next[encounter.node as usize];
        places[*slot as usize] = place as u32;
        *slot += 1;
    }
    (places, starts)
}

/// What the encounters cost under some orders, and which are reached.
struct State<'a> {
    table: &'a Table,
    config: &'a Config,
    /// Of each encounter, with all that is opened below.
    costs: Vec<f64>,
    reached: Vec<bool>,
    /// Children of one encounter, kept for its room.
    places: Vec<usize>,
}

impl<'a> State<'a> {
    fn new(table: &'a Table, config: &'a Config) -> State<'a> {
        let count = table.encounters.len();
        State { table, config, costs: vec![0.0; count], reached: vec![false; count], places: Vec::new() }
    }

    /// Cost of all queries below the root, as last computed.
    fn cost(&self) -> f64 {
        self.table.starts.iter().map(|&start| self.costs[start]).sum()
    }

    /// Computes every encounter's cost under `orders`, and the sum.
    fn evaluate(&mut self, orders: &[u8]) -> f64 {
        for node in (0..orders.len()).rev() {
            self.settle(node, orders[node]);
        }
        self.cost()
    }

    /// Computes the costs of a node's encounters; those below are known.
    fn settle(&mut self, node: usize, order: u8) {
        for &place in self.table.of_node(node) {
            self.costs[place as usize] = self.costs_of(place as usize)[usize::from(order)];
        }
    }

    /// What an encounter costs by each rule.
    fn costs_of(&mut self, place: usize) -> [f64; rule::COUNT] {
        let encounters = &self.table.encounters;
        let own = encounters[place].own();
        let own = self.config.c_i * own.box_tests as f64 + self.config.c_p * own.primitive_tests as f64;
        self.places.clear();
        self.places.extend(children(encounters, place));
        let costs = &self.costs;
        if self.places.len() < 2 {
            return [own + self.places.first().map_or(0.0, |&child| costs[child]); rule::COUNT];
        }
        let until_occluded = |places: &mut dyn Iterator<Item = &usize>| {
            let mut sum = own;
            for &child in places {
                sum += costs[child];
                if encounters[child].occluded {
                    break;
                }
            }
            sum
        };
        let mut sums = [0.0; rule::COUNT];
        sums[usize::from(rule::FIRST)] = until_occluded(&mut self.places.iter());
        sums[usize::from(rule::LAST)] = until_occluded(&mut self.places.iter().rev());
        sort_by_entry(encounters, &mut self.places);
        sums[usize::from(rule::NEAREST)] = until_occluded(&mut self.places.iter());
        sums[usize::from(rule::FARTHEST)] = until_occluded(&mut self.places.iter().rev());
        sums
    }

    /// From the leaves up, gives every node the cheapest rule over its encounters, or over those that are reached; of equals
    /// the one that it has. Costs are those of the new orders afterwards. Whether anything changed.
    fn choose(&mut self, orders: &mut [u8], reached_only: bool) -> bool {
        let mut changed = false;
        for node in (0..orders.len()).rev() {
            let mut sums = [0.0; rule::COUNT];
            for &place in self.table.of_node(node) {
                let place = place as usize;
                if !reached_only || self.reached[place] {
                    let costs = self.costs_of(place);
                    sums.iter_mut().zip(costs).for_each(|(sum, cost)| *sum += cost);
                }
            }
            let mut best = orders[node];
            for order in 0..rule::COUNT as u8 {
                if sums[usize::from(order)] < sums[usize::from(best)] {
                    best = order;
                }
            }
            changed |= best != orders[node];
            orders[node] = best;
            self.settle(node, best);
        }
        changed
    }

    /// Marks what queries open under `orders`.
    fn mark(&mut self, orders: &[u8]) {
        let encounters = &self.table.encounters;
        self.reached.fill(false);
        self.table.starts.iter().for_each(|&start| self.reached[start] = true);
        // Children stand behind their parents.
        for place in 0..encounters.len() {
            if !self.reached[place] {
                continue;
            }
            self.places.clear();
            self.places.extend(children(encounters, place));
            let order = orders[encounters[place].node as usize];
            if order == rule::NEAREST || order == rule::FARTHEST {
                sort_by_entry(encounters, &mut self.places);
            }
            if order == rule::LAST || order == rule::FARTHEST {
                self.places.reverse();
            }
            for &child in &self.places {
                self.reached[child] = true;
                if encounters[child].occluded {
                    break;
                }
            }
        }
    }

    /// Rounds from `orders`, whose costs are known, until nothing changes; how many, and the cost.
    fn descend(&mut self, orders: &mut [u8], most: usize) -> (usize, f64) {
        for round in 0..most {
            self.mark(orders);
            if !self.choose(orders, true) {
                return (round + 1, self.cost());
            }
        }
        (most, self.cost())
    }
}

/// As nearest first visits them: children stand in the order of the file, and the sort keeps that of equals.
fn sort_by_entry(encounters: &[Encounter], places: &mut [usize]) {
    // Distances are finite: a comparison always has an answer. -0 equals 0, as in the traversal.
    places.sort_by(|&a, &b| {
        encounters[a].entry.partial_cmp(&encounters[b].entry).unwrap_or(std::cmp::Ordering::Equal)
    });
}

/// What `queries` cost in the order `order`, counted by the real traversal, depth first.
pub fn measure(prepared: &Prepared, order: &OcclusionOrder, queries: &[Occlusion]) -> Counts {
    sum(queries, |query, scratch| {
        let mut counts = Counts::default();
        let ray = PreparedRay::new(&query.ray);
        prepared.occluder_in(order, &ray, &query.candidates(), &mut counts, scratch);
        counts
    })
}

/// What `queries` would cost if each were told the way to its cheapest proof, see [`cheapest_proof`]: the limit of every order.
pub fn limit(prepared: &Prepared, queries: &[Occlusion]) -> Counts {
    sum(queries, |query, scratch| {
        let mut found = Vec::new();
        let ray = PreparedRay::new(&query.ray);
        prepared.encounters(&ray, &query.candidates(), scratch, &mut found);
        let mut counts = cheapest_proof(&found);
        counts.box_tests += 1;
        counts
    })
}

fn sum(queries: &[Occlusion], cost: impl Fn(&Occlusion, &mut Scratch) -> Counts + Sync) -> Counts {
    let add = |mut a: Counts, b: Counts| {
        a += b;
        a
    };
    queries
        .par_iter()
        .map_init(Scratch::default, |scratch, query| cost(query, scratch))
        .reduce(Counts::default, add)
}
