//! A tree as a diagram: an icicle, in which every node is a block below its parent, as wide as its part of the whole; or the same bent to a sunburst.
//!
//! A tree has millions of nodes and a window a thousand columns: children that would be too narrow to see are drawn as one block, and what is below
//! them is not drawn. So a level has no more blocks than fit, whatever the tree.

use super::shares::{Measure, Shares};
use super::walk::Walk;
use std::f64::consts::TAU;
use std::ops::Range;

/// What a block stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    Node(u32),
    /// `count` children of `parent`, each too narrow.
    Rest {
        parent: u32,
        count: u32,
    },
}

impl Shown {
    /// The node to go to when the block is clicked.
    pub fn node(self) -> u32 {
        match self {
            Shown::Node(node) => node,
            Shown::Rest { parent, .. } => parent,
        }
    }
}

/// A rectangle of the diagram.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    pub shown: Shown,
    /// Level below the diagram's root, which is at 0.
    pub level: usize,
    /// From left to right, in 0..1.
    pub x: Range<f64>,
}

/// How a diagram is laid out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    pub measure: Measure,
    /// The node that takes the whole width.
    pub root: u32,
    /// At most so many levels.
    pub levels: usize,
    /// Least width of a block: a pixel or two, as a part of the whole.
    pub least: f64,
}

/// A tree laid out.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagram {
    /// Level by level, each from left to right.
    pub blocks: Vec<Block>,
    /// Where in `blocks` each level begins, and the end.
    starts: Vec<usize>,
}

impl Diagram {
    /// Children are laid out from their parent's left end, in the order of the file, each as wide as its part. Of costs, the parent's own part stays
    /// free at the right. Without anything to measure, there is nothing but the root.
    pub fn new(walk: &Walk, shares: &Shares, layout: &Layout) -> Diagram {
        let whole = shares.share(walk, layout.measure, layout.root);
        let width = |node: u32| {
            let share = shares.share(walk, layout.measure, node);
            if whole > 0.0 { share / whole } else { 0.0 }
        };
        let mut blocks = vec![Block { shown: Shown::Node(layout.root), level: 0, x: 0.0..1.0 }];
        let mut starts = vec![0, 1];
        for level in 1..layout.levels {
            let start = blocks.len();
            for above in starts[level - 1]..start {
                let Block { shown: Shown::Node(parent), ref x, .. } = blocks[above] else { continue };
                let mut row = Row { level, parent, start: x.start, end: x.end, rest: None };
                for child in walk.children(parent) {
                    let width = width(child);
                    if width >= layout.least {
                        row.close(&mut blocks, layout.least);
                        row.place(&mut blocks, Shown::Node(child), width);
                    } else {
                        row.put_off(width);
                    }
                }
                row.close(&mut blocks, layout.least);
            }
            if blocks.len() == start {
                break;
            }
            starts.push(blocks.len());
        }
        Diagram { blocks, starts }
    }

    /// How many levels are drawn.
    pub fn depth(&self) -> usize {
        self.starts.len() - 1
    }

    /// The blocks of a level, from left to right; none below the last one.
    pub fn row(&self, level: usize) -> &[Block] {
        match self.starts.get(level..level + 2) {
            Some(ends) => &self.blocks[ends[0]..ends[1]],
            None => &[],
        }
    }

    /// The block at a place of a level.
    pub fn hit(&self, x: f64, level: usize) -> Option<&Block> {
        let row = self.row(level);
        let place = row.partition_point(|block| block.x.end <= x);
        row.get(place).filter(|block| block.x.contains(&x))
    }

    /// The block of a node, or the one that it is a part of: the lowest drawn block on its way up.
    pub fn block_of(&self, walk: &Walk, node: u32) -> Option<&Block> {
        let path = walk.path(node);
        let root = path.iter().position(|&node| self.blocks[0].shown == Shown::Node(node))?;
        let mut found = &self.blocks[0];
        for (level, &node) in path[root..].iter().enumerate().skip(1) {
            let inside = |block: &&Block| block.x.start <= found.x.end;
            let row = self.row(level);
            let first = row.partition_point(|block| block.x.start < found.x.start);
            let next = row[first..].iter().take_while(inside).find(|block| block.shown == Shown::Node(node));
            match next {
                Some(block) => found = block,
                None => break,
            }
        }
        Some(found)
    }
}

/// The children of one node, on their way from left to right.
struct Row {
    level: usize,
    parent: u32,
    /// Where the next one begins.
    start: f64,
    /// Where the parent ends.
    end: f64,
    /// Width and number of the narrow ones that have not been placed.
    rest: Option<(f64, u32)>,
}

impl Row {
    fn place(&mut self, blocks: &mut Vec<Block>, shown: Shown, width: f64) {
        // Rounding must not carry a block beyond its parent.
        let end = (self.start + width).min(self.end);
        if end > self.start {
            blocks.push(Block { shown, level: self.level, x: self.start..end });
        }
        self.start = end;
    }

    fn put_off(&mut self, width: f64) {
        let (sum, count) = self.rest.unwrap_or_default();
        self.rest = Some((sum + width, count + 1));
    }

    /// Places the narrow ones since the last wide one as one block; too narrow even together, they are left out.
    fn close(&mut self, blocks: &mut Vec<Block>, least: f64) {
        let Some((width, count)) = self.rest.take() else { return };
        if width >= least {
            self.place(blocks, Shown::Rest { parent: self.parent, count }, width);
        } else {
            self.start += width;
        }
    }
}

/// A sunburst: the diagram bent around its root, which is the disk in the middle. Levels are rings of equal width, and the middle is one ring wide.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sunburst {
    pub depth: usize,
}

impl Sunburst {
    /// Angles in radians, clockwise from the top, and radii from 0 to 1.
    pub fn ring(&self, block: &Block) -> (Range<f64>, Range<f64>) {
        let radius = |level: usize| level as f64 / self.depth.max(1) as f64;
        (TAU * block.x.start..TAU * block.x.end, radius(block.level)..radius(block.level + 1))
    }

    /// The place in the diagram, x and level, of a point: `right` and `up` of the middle, in parts of the radius. None outside.
    pub fn place(&self, right: f64, up: f64) -> Option<(f64, usize)> {
        let level = (right.hypot(up) * self.depth as f64) as usize;
        let turns = right.atan2(up) / TAU;
        (level < self.depth).then_some((if turns < 0.0 { turns + 1.0 } else { turns }, level))
    }
}
