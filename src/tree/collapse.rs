//! Wide trees over the same triangles: a binary tree collapsed to at most `width` children a node.
//!
//! Collapsing is optimal among all trees that keep the given hierarchy, by dynamic programming over the binary tree from
//! the bottom up (Wald, Benthin and Boulos, "Getting Rid of Packets", 2008, pose the problem; Ylitie, Karras and Laine, "Efficient
//! Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", 2017, section 3.1, solve it): for each node, the least cost of its
//! subtree as a forest of at most 1, 2, … `width` trees. One tree is a leaf or a node over a forest; a forest is one of the
//! left child's beside one of the right child's. Leaves are merged by the same programme. What a node costs is its
//! probability times a visit, whatever the probability is: area gives the SAH, counted rays give the ray cost.

use super::{Node, Tree, TreeView};
use thiserror::Error;

/// Most children of a node.
pub const MAX_WIDTH: usize = 8;

/// Up to how many primitives a subtree is looked at for doubles: more are never in one leaf of [`Config::max_leaf`].
const LARGEST_LEAF: usize = 64;

/// How to collapse, and what things cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Most children of a node, 2 to [`MAX_WIDTH`].
    pub width: usize,
    /// Most primitives in a merged leaf, up to 64. Leaves that are larger already stay.
    pub max_leaf: usize,
    /// Cost of visiting an inner node: all its children's boxes together.
    pub node: f64,
    /// Cost of testing a block of primitives.
    pub block: f64,
    /// Primitives that are tested together.
    pub lanes: usize,
}

impl Config {
    /// For trees of `width` as [`crate::traverse`] follows them: one vector operation a node, one a block of four triangles.
    pub fn vector(width: usize) -> Config {
        Config { width, max_leaf: 8, node: 1.0, block: 1.0, lanes: 4 }
    }

    /// Checks the sizes, before any work.
    ///
    /// # Errors
    /// The first that is out of range.
    pub fn check(&self) -> Result<(), CollapseError> {
        if !(2..=MAX_WIDTH).contains(&self.width) {
            return Err(CollapseError::Width(self.width));
        }
        if !(1..=LARGEST_LEAF).contains(&self.max_leaf) {
            return Err(CollapseError::MaxLeaf(self.max_leaf));
        }
        Ok(())
    }
}

/// Why a tree cannot be collapsed.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum CollapseError {
    #[error("node {node} has {children} children: only binary trees can be collapsed")]
    NotBinary { node: usize, children: usize },
    #[error("node {node} has {children} children, more than the {width} that are asked for")]
    TooWide { node: usize, children: usize, width: usize },
    #[error("a width of {0}: from 2 to {MAX_WIDTH} children are possible")]
    Width(usize),
    #[error("a leaf of at most {0} primitives: from 1 to {LARGEST_LEAF} can be merged")]
    MaxLeaf(usize),
}

/// What is chosen for one subtree: entry `i` is about at most `i + 1` trees.
#[derive(Clone, Copy, Debug)]
struct Choice {
    cost: [f64; MAX_WIDTH],
    /// How many of the trees go to the left child; 0 where fewer trees are no worse. For one tree: whether it is an inner
    /// node.
    left: [u8; MAX_WIDTH],
    /// Of the forest below the inner node, which has at most `width` trees.
    below: u8,
    /// Primitives of the subtree, with doubles.
    primitives: u32,
}

/// Collapses a binary tree. `probability` says how likely each node, by its index, is to be visited, in any unit.
///
/// # Errors
/// When an inner node has not two children, or the configuration is out of range.
pub fn collapse(
    tree: TreeView,
    probability: impl Fn(usize) -> f64,
    config: &Config,
) -> Result<Tree, CollapseError> {
    config.check()?;
    let wide = |node: &Node| !node.is_leaf() && node.len() != 2;
    if let Some(node) = tree.nodes.iter().position(wide) {
        return Err(CollapseError::NotBinary { node, children: tree.nodes[node].len() });
    }
    let program = Program { tree, config, choices: choices(tree, probability, config) };
    Ok(program.result())
}

fn choices(tree: TreeView, probability: impl Fn(usize) -> f64, config: &Config) -> Vec<Choice> {
    let none = Choice { cost: [0.0; MAX_WIDTH], left: [0; MAX_WIDTH], below: 0, primitives: 0 };
    let mut choices = vec![none; tree.nodes.len()];
    let mut found = Vec::new();
    // Children stand behind their parents.
    for (index, node) in tree.nodes.iter().enumerate().rev() {
        let probability = probability(index);
        let blocks = |primitives: usize| primitives.div_ceil(config.lanes) as f64;
        if node.is_leaf() {
            choices[index].cost = [probability * config.block * blocks(node.len()); MAX_WIDTH];
            choices[index].primitives = node.len() as u32;
            continue;
        }
        let [left, right] = [choices[node.range().start], choices[node.range().start + 1]];
        let choice = &mut choices[index];
        // The cheapest forest of exactly up to `trees` trees that takes some from both children.
        let forest = |trees: usize| {
            let costs = (1..trees).map(|of_left| left.cost[of_left - 1] + right.cost[trees - of_left - 1]);
            let first = (f64::INFINITY, 1);
            costs
                .zip(1..)
                .fold(first, |best, (cost, of_left)| if cost < best.0 { (cost, of_left) } else { best })
        };
        choice.primitives = left.primitives.saturating_add(right.primitives);
        let (below, of_left) = forest(config.width);
        choice.below = of_left;
        choice.cost[0] = probability * config.node + below;
        choice.left[0] = 1;
        if choice.primitives as usize <= 2 * config.max_leaf {
            found.clear();
            gather(tree, index, &mut found);
            if found.len() <= config.max_leaf {
                let leaf = probability * config.block * blocks(found.len());
                if leaf <= choice.cost[0] {
                    (choice.cost[0], choice.left[0]) = (leaf, 0);
                }
            }
        }
        for trees in 2..=config.width {
            let (cost, of_left) = forest(trees);
            let fewer = choice.cost[trees - 2];
            let better = cost < fewer;
            choice.cost[trees - 1] = if better { cost } else { fewer };
            choice.left[trees - 1] = if better { of_left } else { 0 };
        }
    }
    choices
}

/// Adds the primitives below `node` in the tree's order, each once.
fn gather(tree: TreeView, node: usize, found: &mut Vec<u32>) {
    let node = &tree.nodes[node];
    if !node.is_leaf() {
        node.range().for_each(|child| gather(tree, child, found));
        return;
    }
    for &primitive in &tree.primitives[node.range()] {
        if !found.contains(&primitive) {
            found.push(primitive);
        }
    }
}

struct Program<'a> {
    tree: TreeView<'a>,
    config: &'a Config,
    choices: Vec<Choice>,
}

impl Program<'_> {
    /// The chosen tree, depth first: siblings beside each other, the first one's subtree next.
    fn result(&self) -> Tree {
        let mut result = Tree {
            nodes: vec![self.tree.nodes[0]],
            primitives: Vec::with_capacity(self.tree.primitives.len()),
        };
        let mut open = vec![(0, 0)];
        let (mut roots, mut found) = (Vec::new(), Vec::new());
        while let Some((from, to)) = open.pop() {
            let node = &self.tree.nodes[from];
            let first = result.primitives.len() as u32;
            if node.is_leaf() {
                result.nodes[to] = Node::leaf(node.bounds(), first, node.len() as u32);
                result.primitives.extend_from_slice(&self.tree.primitives[node.range()]);
            } else if self.choices[from].left[0] == 0 {
                found.clear();
                gather(self.tree, from, &mut found);
                result.nodes[to] = Node::leaf(node.bounds(), first, found.len() as u32);
                result.primitives.extend_from_slice(&found);
            } else {
                roots.clear();
                self.divide(from, self.config.width, self.choices[from].below, &mut roots);
                let first = result.nodes.len();
                result.nodes[to] = Node::inner(node.bounds(), first as u32, roots.len() as u32);
                result.nodes.extend(roots.iter().map(|&root| self.tree.nodes[root]));
                open.extend(roots.iter().enumerate().map(|(place, &root)| (root, first + place)).rev());
            }
        }
        result
    }

    /// The roots of the forest of at most `trees` trees below `node`, `of_left` of them in its left child.
    fn divide(&self, node: usize, trees: usize, of_left: u8, roots: &mut Vec<usize>) {
        let [left, right] = [self.tree.nodes[node].range().start, self.tree.nodes[node].range().start + 1];
        let of_left = usize::from(of_left);
        self.forest(left, of_left, roots);
        self.forest(right, trees - of_left, roots);
    }

    fn forest(&self, node: usize, mut trees: usize, roots: &mut Vec<usize>) {
        let choice = &self.choices[node];
        while trees > 1 && choice.left[trees - 1] == 0 {
            trees -= 1;
        }
        if trees == 1 {
            roots.push(node);
        } else {
            self.divide(node, trees, choice.left[trees - 1], roots);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builder::{self, Config as Build};
    use crate::geometry::{Aabb, Triangle, Vec3};
    use crate::progress::Progress;
    use crate::random::Random;
    use crate::tree::binary::binary;
    use crate::tree::statistics::Statistics;
    use std::collections::HashSet;

    fn soup(count: usize, seed: u64) -> Vec<Triangle> {
        let random = &mut Random::new(seed);
        let mut vector = |scale: f64| Vec3::from_array([0; 3].map(|_| (scale * random.signed()) as f32));
        let mut triangle = || {
            let corner = vector(1.0);
            Triangle([corner, corner + vector(0.3), corner + vector(0.3)])
        };
        (0..count).map(|_| triangle()).collect()
    }

    fn built(triangles: &[Triangle]) -> Tree {
        builder::build(triangles, &Build::default(), &Progress::hidden()).unwrap()
    }

    fn areas(tree: &Tree) -> impl Fn(usize) -> f64 {
        |node| f64::from(tree.nodes[node].bounds().area())
    }

    /// What the programme minimises, from the result alone.
    fn cost(tree: &Tree, config: &Config) -> f64 {
        let node = |node: &Node| {
            let own = if node.is_leaf() {
                config.block * node.len().div_ceil(config.lanes) as f64
            } else {
                config.node
            };
            f64::from(node.bounds().area()) * own
        };
        tree.nodes.iter().map(node).sum()
    }

    /// The least cost by trying every set of nodes to leave out and every subtree as a leaf.
    fn least(tree: &Tree, node: usize, config: &Config) -> f64 {
        let this = &tree.nodes[node];
        let area = f64::from(this.bounds().area());
        let mut found = Vec::new();
        gather(tree.view(), node, &mut found);
        let blocks = config.block * found.len().div_ceil(config.lanes) as f64;
        let leaf =
            if this.is_leaf() || found.len() <= config.max_leaf { area * blocks } else { f64::INFINITY };
        if this.is_leaf() {
            return leaf;
        }
        // Every way to open inner nodes below this one until at most `width` subtrees are left.
        fn open(tree: &Tree, roots: &[usize], from: usize, config: &Config) -> f64 {
            let as_is: f64 = roots.iter().map(|&root| least(tree, root, config)).sum();
            let mut best = as_is;
            for place in from..roots.len() {
                let node = &tree.nodes[roots[place]];
                if !node.is_leaf() && roots.len() < config.width {
                    let mut more = roots.to_vec();
                    more.splice(place..=place, node.range());
                    best = best.min(open(tree, &more, place, config));
                }
            }
            best
        }
        let children: Vec<usize> = this.range().collect();
        leaf.min(area * config.node + open(tree, &children, 0, config))
    }

    #[test]
    fn the_cost_is_the_least_of_all() {
        for seed in 0..12 {
            let tree = built(&soup(9, seed));
            for (width, max_leaf, block) in [(2, 4, 1.0), (3, 1, 1.0), (4, 3, 0.4), (8, 8, 0.7), (8, 1, 1.0)]
            {
                let config = Config { width, max_leaf, node: 1.0, block, lanes: 2 };
                let collapsed = collapse(tree.view(), areas(&tree), &config).unwrap();
                let (found, least) = (cost(&collapsed, &config), least(&tree, 0, &config));
                assert!((found - least).abs() <= 1e-6 * least, "{config:?}: {found} instead of {least}");
            }
        }
    }

    #[test]
    fn the_same_primitives_stand_below_boxes_of_the_binary_tree() {
        let triangles = soup(2000, 2);
        let tree = built(&triangles);
        let bits = |node: &Node| bytemuck::cast::<Aabb, [u32; 6]>(node.bounds());
        let boxes: HashSet<[u32; 6]> = tree.nodes.iter().map(bits).collect();
        for width in [2, 4, 8] {
            let collapsed = collapse(tree.view(), areas(&tree), &Config::vector(width)).unwrap();
            let statistics = Statistics::of(collapsed.view());
            assert!(statistics.max_children <= width && statistics.max_leaf <= 8, "{statistics:?}");
            assert!(width == 2 || statistics.max_children > 2);
            let mut primitives = collapsed.primitives.clone();
            primitives.sort_unstable();
            assert!(primitives.iter().copied().eq(0..triangles.len() as u32));
            for (index, node) in collapsed.nodes.iter().enumerate() {
                assert!(boxes.contains(&bits(node)));
                let inside = |bounds: Aabb| node.bounds().contains(&bounds);
                if node.is_leaf() {
                    let below = &collapsed.primitives[node.range()];
                    assert!(below.iter().all(|&index| inside(triangles[index as usize].bounds())));
                } else {
                    assert!(
                        node.range().all(|child| child > index && inside(collapsed.nodes[child].bounds()))
                    );
                }
            }
            let again = binary(collapsed.view(), &triangles);
            let statistics = Statistics::of(again.view());
            assert_eq!((statistics.max_children, statistics.max_leaf), (2, 1));
            assert_eq!(statistics.leaves, triangles.len());
        }
    }

    #[test]
    fn doubles_in_one_leaf_are_dropped() {
        // Two halves of triangle 0 beside each other, as spatial splits leave them.
        let triangles = soup(2, 1);
        let bounds = triangles[0].bounds().union(&triangles[1].bounds());
        let tree = Tree {
            nodes: vec![
                Node::inner(bounds, 1, 2),
                Node::inner(bounds, 3, 2),
                Node::leaf(bounds, 2, 1),
                Node::leaf(bounds, 0, 1),
                Node::leaf(bounds, 1, 1),
            ],
            primitives: vec![0, 1, 0],
        };
        let collapsed = collapse(tree.view(), areas(&tree), &Config::vector(4)).unwrap();
        assert_eq!(collapsed.nodes.len(), 1);
        assert_eq!(collapsed.primitives, [0, 1]);
    }

    #[test]
    fn odd_trees_and_numbers() {
        let empty = Tree { nodes: vec![Node::leaf(Aabb::EMPTY, 0, 0)], primitives: Vec::new() };
        assert_eq!(collapse(empty.view(), areas(&empty), &Config::vector(8)), Ok(empty.clone()));
        let triangles = soup(40, 3);
        let everything = triangles.iter().fold(Aabb::EMPTY, |all, triangle| all.union(&triangle.bounds()));
        let lone = Tree { nodes: vec![Node::leaf(everything, 0, 40)], primitives: (0..40).collect() };
        assert_eq!(collapse(lone.view(), areas(&lone), &Config::vector(8)), Ok(lone.clone()));
        let refused = |config| collapse(lone.view(), areas(&lone), &config).unwrap_err();
        assert_eq!(refused(Config::vector(9)), CollapseError::Width(9));
        assert_eq!(refused(Config { max_leaf: 0, ..Config::vector(4) }), CollapseError::MaxLeaf(0));
        let wide = Tree {
            nodes: vec![Node::inner(everything, 1, 3), lone.nodes[0], lone.nodes[0], lone.nodes[0]],
            ..lone.clone()
        };
        let error = collapse(wide.view(), areas(&wide), &Config::vector(4)).unwrap_err();
        assert_eq!(error, CollapseError::NotBinary { node: 0, children: 3 });
    }
}
