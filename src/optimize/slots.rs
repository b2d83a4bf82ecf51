//! The order of a node's children for occlusion queries, chosen jointly from recorded ones.
//!
//! A query ends at the first occluder, so what a child costs depends on which queries the children before it have stopped. For every node the
//! whole order is chosen at once: of all orders of its (up to eight) children the one that costs the queries least which come to the node, by dynamic
//! programming over the sets of children that have been visited. What a child costs a query is known from the orders below, which queries come
//! from those above. So, as in [`super::order`]: once from the leaves up over all queries that overlap a node, then rounds over those that
//! are reached, each of which is no worse than the one before.
//!
//! **The convention.** The stored order is the order in which children are visited ([`OcclusionOrder::First`]).
//! Embree's kernels visit the last child that is hit first: whoever gives them a tree reverses it.
//!
//! Without an occluded query that says anything, smaller subtrees come first, which is what Embree does.

use crate::cost::Constants;
use crate::training::occlusions::Occlusion;
use crate::traverse::child_order::rule;
use crate::traverse::encounter::{Encounter, children};
use crate::traverse::{OcclusionOrder, Prepared, PreparedRay, Scratch};
use crate::tree::{Node, Tree, TreeView};
use rayon::prelude::*;

/// Most children of a node whose order is chosen.
pub const MOST: usize = 8;

/// Sets of so many children.
const SETS: usize = 1 << MOST;

/// Triangles of a block.
const LANES: u32 = 4;

/// Most encounters that are kept: 32 bytes each. Of queries with more, an even part decides.
const MOST_ENCOUNTERS: usize = 1 << 23;

/// Rounds over the queries that are reached, at most.
const ROUNDS: usize = 8;

/// An order, and what it costs the queries that decided.
#[derive(Clone, Debug, PartialEq)]
pub struct Chosen {
    /// The tree with the children of every node in the order of visits.
    pub tree: Tree,
    /// Occluded queries that decided.
    pub deciding: usize,
    /// Cost of those below the root, in nanoseconds: smaller subtrees first.
    pub by_size: f64,
    /// The same in the chosen order.
    pub cost: f64,
}

/// The tree with the children of every node sorted by the number of primitives below, the fewest first.
pub fn smallest_first(tree: TreeView) -> Tree {
    let below = primitives_below(tree);
    permuted(tree, |node| {
        let mut order: Vec<usize> = tree.nodes[node].range().collect();
        order.sort_by_key(|&child| below[child]);
        order
    })
}

/// The tree with the children of every node in the order in which Embree's kernels visit them for any hit once it is planted: as `ORDR` says
/// where it names an order of the file, elsewhere the fewest primitives first, and of equals the last one.
pub fn as_planted(tree: TreeView, rules: Option<&[u8]>) -> Tree {
    let below = primitives_below(tree);
    permuted(tree, |node| {
        let mut order: Vec<usize> = tree.nodes[node].range().collect();
        match rules.and_then(|rules| rules.get(node)) {
            Some(&rule::FIRST) => {}
            Some(&rule::LAST) => order.reverse(),
            _ => {
                order.reverse();
                order.sort_by_key(|&child| below[child]);
            }
        }
        order
    })
}

/// Primitives in the leaves below each node.
fn primitives_below(tree: TreeView) -> Vec<u64> {
    let mut below = vec![0u64; tree.nodes.len()];
    for (index, node) in tree.nodes.iter().enumerate().rev() {
        below[index] = if node.is_leaf() { node.len() as u64 } else { below[node.range()].iter().sum() };
    }
    below
}

/// Chooses the order of every node's children for `queries` over `tree`, on the threads of the current rayon pool. `prepared` is
/// made of [`smallest_first`] of the tree, and `tree` is that.
pub fn choose(prepared: &Prepared, tree: TreeView, queries: &[Occlusion], constants: &Constants) -> Chosen {
    let table = Table::new(prepared, tree.nodes.len(), queries, constants);
    let identity: Vec<Order> = tree.nodes.iter().map(|_| IDENTITY).collect();
    let mut state =
        State { table: &table, tree, costs: vec![0.0; table.encounters.len()], reached: Vec::new() };
    let by_size = state.evaluate(&identity);
    // From the leaves up, over all queries, and from the order by size: the better end is taken.
    state.reached = vec![true; table.encounters.len()];
    let mut bottom_up = identity.clone();
    state.choose(&mut bottom_up);
    let from_bottom = state.descend(&mut bottom_up);
    let mut from_size = identity;
    state.evaluate(&from_size);
    let from_identity = state.descend(&mut from_size);
    let (orders, cost) =
        if from_bottom <= from_identity { (bottom_up, from_bottom) } else { (from_size, from_identity) };
    let ordered = |node: usize| {
        let (first, count) = (tree.nodes[node].range().start, tree.nodes[node].len());
        let place = |rank: usize| first + orders[node].get(rank).map_or(rank, |&child| child.into());
        (0..count).map(place).collect()
    };
    Chosen { tree: permuted(tree, ordered), deciding: table.starts.len(), by_size, cost }
}

/// The numbers of a node's children, the first to be visited first. Those of a node with more than [`MOST`] stay as they are.
type Order = [u8; MOST];

const IDENTITY: Order = [0, 1, 2, 3, 4, 5, 6, 7];

/// The same tree with other siblings first, in depth-first order; `order` lists the children of an inner node.
fn permuted(tree: TreeView, order: impl Fn(usize) -> Vec<usize>) -> Tree {
    let mut result =
        Tree { nodes: vec![tree.nodes[0]], primitives: Vec::with_capacity(tree.primitives.len()) };
    let mut open = vec![(0, 0)];
    while let Some((from, to)) = open.pop() {
        let node: &Node = &tree.nodes[from];
        if node.is_leaf() {
            result.nodes[to].first = result.primitives.len() as u32;
            result.primitives.extend_from_slice(&tree.primitives[node.range()]);
        } else {
            let children = order(from);
            let first = result.nodes.len();
            result.nodes[to].first = first as u32;
            result.nodes.extend(children.iter().map(|&child| tree.nodes[child]));
            open.extend(children.into_iter().zip(first..first + node.len()).rev());
        }
    }
    result
}

/// The encounters of all deciding queries.
struct Table {
    encounters: Vec<Encounter>,
    /// What each costs itself.
    own: Vec<f64>,
    /// Where each query's begin.
    starts: Vec<usize>,
    /// Places of the encounters of each node, and where they begin; one more than nodes.
    by_node: Vec<u32>,
    node_starts: Vec<u32>,
}

impl Table {
    fn new(prepared: &Prepared, nodes: usize, queries: &[Occlusion], constants: &Constants) -> Table {
        let occluded: Vec<(usize, usize)> = queries
            .par_iter()
            .enumerate()
            .map_init(Scratch::default, |scratch, (index, query)| {
                let ray = PreparedRay::new(&query.ray);
                let order = &OcclusionOrder::Nearest;
                prepared.occluder_in(order, &ray, &query.candidates(), &mut (), scratch)?;
                Some((index, prepared.overlapped(&ray, scratch)))
            })
            .flatten()
            .collect();
        let mut step = 1;
        let fits = |step: usize| {
            let sizes = occluded.iter().step_by(step).map(|&(_, size)| size);
            sizes.fold(0usize, usize::saturating_add) <= MOST_ENCOUNTERS
        };
        while step < occluded.len() && !fits(step) {
            step *= 2;
        }
        let deciding: Vec<(usize, usize)> =
            if fits(step) { occluded.into_iter().step_by(step).collect() } else { Vec::new() };
        let found: Vec<Vec<Encounter>> = deciding
            .par_iter()
            .map_init(Scratch::default, |scratch, &(index, size)| {
                let query = &queries[index];
                let mut found = Vec::with_capacity(size);
                let ray = PreparedRay::new(&query.ray);
                prepared.encounters(&ray, &query.candidates(), scratch, &mut found);
                found
            })
            .collect();
        let ends = found.iter().scan(0, |end, list| {
            let start = *end;
            *end += list.len();
            Some(start)
        });
        let starts = ends.collect();
        let encounters = found.concat();
        let own = |encounter: &Encounter| {
            if encounter.leaf {
                constants.leaf + constants.block * f64::from(encounter.tests.div_ceil(LANES))
            } else {
                constants.visit
            }
        };
        let mut node_starts = vec![0u32; nodes + 1];
        for encounter in &encounters {
            node_starts[encounter.node as usize + 1] += 1;
        }
        for node in 0..nodes {
            node_starts[node + 1] += node_starts[node];
        }
        let mut next = node_starts.clone();
        let mut by_node = vec![0; encounters.len()];
        for (place, encounter) in encounters.iter().enumerate() {
            let slot = &mut next[encounter.node as usize];
            by_node[*slot as usize] = place as u32;
            *slot += 1;
        }
        Table { own: encounters.iter().map(own).collect(), encounters, starts, by_node, node_starts }
    }

    fn of_node(&self, node: usize) -> &[u32] {
        &self.by_node[self.node_starts[node] as usize..self.node_starts[node + 1] as usize]
    }
}

/// What the encounters cost under some orders, and which are reached.
struct State<'a> {
    table: &'a Table,
    tree: TreeView<'a>,
    /// Of each encounter, with all that is opened below.
    costs: Vec<f64>,
    reached: Vec<bool>,
}

impl State<'_> {
    fn cost(&self) -> f64 {
        self.table.starts.iter().map(|&start| self.costs[start]).sum()
    }

    /// Computes every encounter's cost under `orders`, and the sum.
    fn evaluate(&mut self, orders: &[Order]) -> f64 {
        for node in (0..orders.len()).rev() {
            self.settle(node, &orders[node]);
        }
        self.cost()
    }

    /// The place of the encounter of each child that a query overlaps, by the child's number.
    fn children(&self, place: usize, found: &mut [Option<usize>; MOST]) -> bool {
        let encounters = &self.table.encounters;
        let first = self.tree.nodes[encounters[place].node as usize].first;
        *found = [None; MOST];
        for child in children(encounters, place) {
            match found.get_mut((encounters[child].node - first) as usize) {
                Some(slot) => *slot = Some(child),
                None => return false,
            }
        }
        true
    }

    /// Computes the costs of a node's encounters; those below are known.
    fn settle(&mut self, node: usize, order: &Order) {
        let mut found = [None; MOST];
        for &place in self.table.of_node(node) {
            let place = place as usize;
            let mut cost = self.table.own[place];
            if self.children(place, &mut found) {
                for child in order.iter().filter_map(|&number| found[usize::from(number)]) {
                    cost += self.costs[child];
                    if self.table.encounters[child].occluded {
                        break;
                    }
                }
            } else {
                for child in children(&self.table.encounters, place) {
                    cost += self.costs[child];
                    if self.table.encounters[child].occluded {
                        break;
                    }
                }
            }
            self.costs[place] = cost;
        }
    }

    /// From the leaves up, gives every node the cheapest order over its encounters that are reached; of equals the one that it has. Whether
    /// anything changed.
    fn choose(&mut self, orders: &mut [Order]) -> bool {
        let mut changed = false;
        let mut found = [None; MOST];
        for (node, order) in orders.iter_mut().enumerate().rev() {
            let count = self.tree.nodes[node].len();
            if self.tree.nodes[node].is_leaf() || count > MOST {
                self.settle(node, order);
                continue;
            }
            // What each child costs the queries that a set of children would stop.
            let mut costs = vec![[0.0; MOST]; 1 << count];
            for &place in self.table.of_node(node) {
                let place = place as usize;
                if !self.reached[place] || !self.children(place, &mut found) {
                    continue;
                }
                let stopping = |(number, child): (usize, &Option<usize>)| {
                    child.is_some_and(|child| self.table.encounters[child].occluded) as usize * (1 << number)
                };
                let set: usize = found.iter().enumerate().map(stopping).sum();
                for (sum, child) in costs[set].iter_mut().zip(&found) {
                    *sum += child.map_or(0.0, |child| self.costs[child]);
                }
            }
            let best = cheapest(&mut costs, count, order);
            changed |= best != *order;
            *order = best;
            self.settle(node, &best);
        }
        changed
    }

    /// Marks what queries open under `orders`.
    fn mark(&mut self, orders: &[Order]) {
        self.reached.clear();
        self.reached.resize(self.table.encounters.len(), false);
        for &start in &self.table.starts {
            self.reached[start] = true;
        }
        let mut found = [None; MOST];
        // Children stand behind their parents.
        for place in 0..self.table.encounters.len() {
            if !self.reached[place] {
                continue;
            }
            let node = self.table.encounters[place].node as usize;
            let known = self.children(place, &mut found);
            let reached = &mut self.reached;
            let mut visit = |child: usize| {
                reached[child] = true;
                !self.table.encounters[child].occluded
            };
            if known {
                orders[node].iter().filter_map(|&number| found[usize::from(number)]).all(&mut visit);
            } else {
                children(&self.table.encounters, place).all(&mut visit);
            }
        }
    }

    /// Rounds from `orders`, whose costs are known, until nothing changes; the cost then.
    fn descend(&mut self, orders: &mut [Order]) -> f64 {
        for _ in 0..ROUNDS {
            self.mark(orders);
            if !self.choose(orders) {
                break;
            }
        }
        self.cost()
    }
}

/// The order of `count` children that costs least, `order` if it is as good. `costs` has by set of children what each child costs the queries for which
/// just that set holds an occluder; it is used up.
fn cheapest(costs: &mut [[f64; MOST]], count: usize, order: &Order) -> Order {
    // Summed over subsets: of a set, the queries that only children in it would stop.
    for child in 0..count {
        for set in 0..costs.len() {
            if set >> child & 1 == 1 {
                let without = costs[set ^ 1 << child];
                costs[set].iter_mut().zip(without).for_each(|(sum, more)| *sum += more);
            }
        }
    }
    let all = costs.len() - 1;
    // A child that comes after `visited` is met by the queries that only others would stop.
    let next = |visited: usize, child: usize| costs[all ^ visited][child];
    let mut least = [f64::INFINITY; SETS];
    let mut last = [0u8; SETS];
    least[0] = 0.0;
    for visited in 0..all {
        for child in (0..count).filter(|child| visited >> child & 1 == 0) {
            let (cost, then) = (least[visited] + next(visited, child), visited | 1 << child);
            if cost < least[then] {
                (least[then], last[then]) = (cost, child as u8);
            }
        }
    }
    let mut present = (0, 0.0);
    for &child in &order[..count] {
        present.1 += next(present.0, child.into());
        present.0 |= 1 << child;
    }
    if present.1 <= least[all] {
        return *order;
    }
    let mut best = IDENTITY;
    let mut set = all;
    for place in (0..count).rev() {
        best[place] = last[set];
        set ^= 1 << last[set];
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Aabb, Triangle, Vec3};
    use crate::optimize::checks::{poor_tree, rays, triangles};
    use crate::traverse::{All, Counts};
    use crate::tree::collapse::{Config, collapse};

    const CONSTANTS: Constants = Constants { query: 0.0, visit: 3.0, leaf: 2.0, block: 1.0, miss: 0.0 };

    fn occlusions(count: usize, seed: u64) -> Vec<Occlusion> {
        let occlusion = |ray| Occlusion { ray, mask: u32::MAX, rejects: Box::default() };
        rays(count, seed).into_iter().map(occlusion).collect()
    }

    fn wide(triangles: &[Triangle], max_leaf: usize) -> Tree {
        let tree = poor_tree(triangles);
        let area = |node: usize| f64::from(tree.nodes[node].bounds().area());
        let config = Config { max_leaf, ..Config::vector(8) };
        collapse(tree.view(), area, &config).unwrap()
    }

    /// What occluded queries cost in the order of the file, as the real traversal counts.
    fn counted(tree: &Tree, triangles: &[Triangle], queries: &[Occlusion]) -> f64 {
        let prepared = Prepared::new(tree.view(), triangles, &[]);
        let mut scratch = Scratch::default();
        let mut sum = 0.0;
        for query in queries {
            let mut counts = Counts::default();
            let ray = PreparedRay::new(&query.ray);
            let order = &OcclusionOrder::First;
            if prepared.occluder_in(order, &ray, &All, &mut counts, &mut scratch).is_some() {
                sum += CONSTANTS.visit * counts.node_visits as f64
                    + CONSTANTS.leaf * counts.leaf_visits as f64
                    + CONSTANTS.block * counts.block_tests as f64;
            }
        }
        sum
    }

    fn choose_for(tree: &Tree, triangles: &[Triangle], queries: &[Occlusion]) -> (Tree, Chosen) {
        let by_size = smallest_first(tree.view());
        let prepared = Prepared::new(by_size.view(), triangles, &[]);
        let chosen = choose(&prepared, by_size.view(), queries, &CONSTANTS);
        (by_size, chosen)
    }

    /// Three leaves of two, one and two primitives: what is asked first is what `plant_blocks.cpp` puts into the last slot.
    #[test]
    fn planted_children_are_asked_from_the_last_slot_on() {
        let bounds = Aabb { lower: Vec3::ZERO, upper: Vec3::ONE };
        let nodes = vec![
            Node::inner(bounds, 1, 3),
            Node::leaf(bounds, 0, 2),
            Node::leaf(bounds, 2, 1),
            Node::leaf(bounds, 3, 2),
        ];
        let tree = Tree { nodes, primitives: (0..5).collect() };
        let asked = |rules: Option<&[u8]>| as_planted(tree.view(), rules).primitives;
        let [forwards, backwards] = [rule::FIRST, rule::LAST].map(|rule| [rule; 4]);
        assert_eq!(asked(Some(&forwards)), [0, 1, 2, 3, 4]);
        assert_eq!(asked(Some(&backwards)), [3, 4, 2, 0, 1]);
        for by_size in [None, Some(&[rule::NEAREST; 4][..])] {
            assert_eq!(asked(by_size), [2, 3, 4, 0, 1]);
        }
    }

    fn permutations(of: usize) -> Vec<Vec<usize>> {
        if of == 0 {
            return vec![Vec::new()];
        }
        let insert = |shorter: Vec<usize>| {
            (0..of).map(move |place| {
                let mut longer = shorter.clone();
                longer.insert(place, of - 1);
                longer
            })
        };
        permutations(of - 1).into_iter().flat_map(insert).collect()
    }

    #[test]
    fn the_order_of_one_node_is_the_best_of_all() {
        for seed in 0..8 {
            let triangles = triangles(6, seed);
            let tree = wide(&triangles, 1);
            assert_eq!(tree.nodes.len(), 7, "one node over six leaves");
            let queries = occlusions(400, seed);
            let (_, chosen) = choose_for(&tree, &triangles, &queries);
            let orders = permutations(6);
            assert_eq!(orders.len(), 720);
            let costs = orders.iter().map(|order| {
                let children = order.iter().map(|child| 1 + child).collect::<Vec<_>>();
                let other = permuted(tree.view(), |_| children.clone());
                counted(&other, &triangles, &queries)
            });
            let least = costs.fold(f64::INFINITY, f64::min);
            assert_eq!(counted(&chosen.tree, &triangles, &queries), least);
            assert_eq!(chosen.cost, least);
        }
    }

    #[test]
    fn no_order_costs_more_than_that_by_size_and_the_sum_is_what_is_counted() {
        for (count, max_leaf) in [(500, 1), (500, 4), (3000, 4)] {
            let triangles = triangles(count, 3);
            let tree = wide(&triangles, max_leaf);
            let queries = occlusions(1000, 5);
            let (by_size, chosen) = choose_for(&tree, &triangles, &queries);
            assert!(chosen.deciding > 300);
            let before = counted(&by_size, &triangles, &queries);
            assert!((before - chosen.by_size).abs() < 1e-6 * before, "{before} {}", chosen.by_size);
            let after = counted(&chosen.tree, &triangles, &queries);
            assert!((after - chosen.cost).abs() < 1e-6 * after, "{after} {}", chosen.cost);
            assert!(after < 0.98 * before, "{after} {before}");
            // The same nodes, in other places.
            let boxes = |tree: &Tree| {
                let key = |node: &Node| (bytemuck::cast::<Aabb, [u32; 6]>(node.bounds()), node.count);
                let mut boxes: Vec<_> = tree.nodes.iter().map(key).collect();
                boxes.sort_unstable();
                boxes
            };
            assert_eq!(boxes(&chosen.tree), boxes(&tree));
        }
    }

    #[test]
    fn threads_change_nothing() {
        let triangles = triangles(800, 4);
        let tree = wide(&triangles, 4);
        let queries = occlusions(2000, 6);
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| choose_for(&tree, &triangles, &queries))
        };
        assert!(on(1) == on(3));
    }

    #[test]
    fn without_occlusions_smaller_subtrees_come_first() {
        let triangles = triangles(100, 2);
        let tree = wide(&triangles, 4);
        let away: Vec<Occlusion> = occlusions(50, 1)
            .into_iter()
            .map(|query| Occlusion { ray: crate::geometry::Ray { tfar: 0.0, ..query.ray }, ..query })
            .collect();
        for queries in [&[][..], &away] {
            let (by_size, chosen) = choose_for(&tree, &triangles, queries);
            assert_eq!((chosen.deciding, chosen.cost), (0, 0.0));
            assert_eq!(chosen.tree, by_size);
        }
        let below = |tree: &Tree, node: usize| {
            fn count(tree: &Tree, node: usize) -> usize {
                let node = &tree.nodes[node];
                if node.is_leaf() { node.len() } else { node.range().map(|child| count(tree, child)).sum() }
            }
            count(tree, node)
        };
        let by_size = smallest_first(tree.view());
        for node in by_size.nodes.iter().filter(|node| !node.is_leaf()) {
            assert!(node.range().is_sorted_by_key(|child| below(&by_size, child)));
        }
        for count in 0..3 {
            let triangles = crate::optimize::checks::triangles(count, 1);
            let tree = crate::builder::build(
                &triangles,
                &crate::builder::Config::default(),
                &crate::progress::Progress::hidden(),
            );
            let tree = tree.unwrap();
            assert_eq!(
                choose_for(&tree, &triangles, &occlusions(20, 1)).1.tree.nodes.len(),
                tree.nodes.len()
            );
        }
    }
}
