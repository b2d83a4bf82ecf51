//! Misses of a simulated cache: what a tree costs beyond its visits when it does not fit.
//!
//! The cache is set-associative, the least recently used line of a set goes. Lines are those of a tree as it lies in memory for a
//! traversal: 64 bytes for two children, 128 for four, 256 for eight, and three lines of 64 bytes for a block of four triangles, both in the
//! order of the file. So misses depend on the tree, the queries and their order, and on no machine.

use super::WIDTHS;
use crate::traverse::{Counts, Link, Observer, PreparedTriangle};
use crate::tree::TreeView;

/// Bytes of the second level that is simulated where nothing else is asked for.
pub const SECOND_LEVEL: usize = 1 << 20;

/// Bytes of a line.
const LINE: usize = 64;

/// Lines of a set.
const WAYS: usize = 16;

/// Lines of a block of triangles.
const BLOCK_LINES: u32 = 3;

/// Triangles of a block.
const LANES: usize = 4;

/// No line.
const NOTHING: u32 = u32::MAX;

/// A cache, empty at first.
#[derive(Clone, Debug)]
pub struct Cache {
    /// Lines by set, in each the last used first.
    sets: Vec<[u32; WAYS]>,
    misses: u64,
}

impl Cache {
    /// Of about so many bytes: a power of two of sets, at least one.
    pub fn new(bytes: usize) -> Cache {
        let sets = (bytes / (LINE * WAYS)).max(1);
        let sets = if sets.is_power_of_two() { sets } else { sets.next_power_of_two() / 2 };
        Cache { sets: vec![[NOTHING; WAYS]; sets], misses: 0 }
    }

    /// Lines that were read and not there.
    pub fn misses(&self) -> u64 {
        self.misses
    }

    fn read(&mut self, line: u32) {
        let place = line as usize & (self.sets.len() - 1);
        let set = &mut self.sets[place];
        let found = set.iter().position(|&held| held == line);
        self.misses += found.is_none() as u64;
        set[..=found.unwrap_or(WAYS - 1)].rotate_right(1);
        set[0] = line;
    }
}

/// Where things of a tree lie.
#[derive(Clone, Copy, Debug)]
pub struct Layout {
    node_lines: u32,
    /// Line of the first block: behind all nodes.
    blocks: u32,
}

impl Layout {
    pub fn of(tree: TreeView) -> Layout {
        let inner = || tree.nodes.iter().filter(|node| !node.is_leaf());
        let widest = inner().map(|node| node.len()).max().unwrap_or(0);
        let width = WIDTHS.into_iter().find(|&width| widest <= width).unwrap_or(8);
        let node_lines = (width / 2) as u32;
        let groups: usize = inner().map(|node| node.len().div_ceil(width)).sum();
        Layout { node_lines, blocks: (groups as u32).wrapping_mul(node_lines) }
    }
}

/// Counts, and reads a cache beside.
pub struct Cached<'a> {
    pub counts: &'a mut Counts,
    pub cache: &'a mut Cache,
    layout: Layout,
    /// Slot of the next triangle of the leaf that is open.
    slot: usize,
}

impl<'a> Cached<'a> {
    pub fn new(counts: &'a mut Counts, cache: &'a mut Cache, layout: Layout) -> Cached<'a> {
        Cached { counts, cache, layout, slot: 0 }
    }
}

impl Observer for Cached<'_> {
    const NODES: bool = false;

    fn root(&mut self) {
        self.counts.root();
    }

    fn inner(&mut self, node: &Link) {
        self.counts.inner(node);
        let lines = self.layout.node_lines;
        let first = node.first.wrapping_mul(lines);
        (0..lines).for_each(|line| self.cache.read(first.wrapping_add(line)));
    }

    fn leaf(&mut self, leaf: &Link) {
        self.counts.leaf(leaf);
        self.slot = leaf.triangles().start;
    }

    fn primitives(&mut self, triangles: impl ExactSizeIterator<Item = PreparedTriangle>) {
        let first = self.layout.blocks.wrapping_add(((self.slot / LANES) as u32).wrapping_mul(BLOCK_LINES));
        (0..BLOCK_LINES).for_each(|line| self.cache.read(first.wrapping_add(line)));
        self.slot += triangles.len();
        self.counts.primitives(triangles);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_recently_used_line_goes() {
        // Two sets: even lines and odd lines.
        let mut cache = Cache::new(2 * WAYS * LINE);
        let mut misses = |lines: &[u32]| {
            let before = cache.misses();
            lines.iter().for_each(|&line| cache.read(line));
            cache.misses() - before
        };
        let even: Vec<u32> = (0..WAYS as u32).map(|line| 2 * line).collect();
        assert_eq!(misses(&even), WAYS as u64, "each is new");
        assert_eq!(misses(&even), 0, "all of them fit");
        assert_eq!(misses(&[1, 3, 1]), 2, "the other set is empty");
        assert_eq!(misses(&[0, 1000, 0]), 1, "0 was used last, so 2 went");
        assert_eq!(misses(&[2, 4]), 2, "2 took the place of 4");
    }

    #[test]
    fn sizes_are_powers_of_two() {
        for (bytes, sets) in [(0, 1), (1 << 20, 1024), (1_300_000, 1024), (3 << 20, 2048)] {
            assert_eq!(Cache::new(bytes).sets.len(), sets, "{bytes}");
        }
    }
}
