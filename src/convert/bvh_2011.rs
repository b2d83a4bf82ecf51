//! The tree files of RayVisualizer (2011), read and written.
//!
//! Little-endian words: `i32 267534`, the type `i32 201` (plain) or `202` (each branch carries `f32 p`), the nodes in pre-order, `i32 9215`. A node
//! starts with its id: 0 a branch with bounds, 1 a leaf with bounds, 2 and 3 the same without. Branch: id, p in a 202, bounds if any, left, right.
//! Leaf: id, bounds if any, `i32 n`, n numbers of triangles in the order of the scene file. Bounds: x, y and z, each as min and max. p is how likely
//! an occlusion query is to visit the left child first.
//!
//! Trees may be as deep as they have nodes: both directions keep what waits on a stack of their own.

use crate::format::bvh::Contents;
use crate::format::{FormatError, Problem};
use crate::geometry::{Aabb, Triangle, Vec3};
use crate::traverse::child_order::rule;
use crate::tree::{Node, Tree, TreeView};
use std::io::{self, Write};

/// The word that such a file starts with.
const MAGIC: i32 = 267_534;
/// The word that ends it.
const END: i32 = 9215;
/// Without and with a probability in each branch.
const PLAIN: i32 = 201;
const ORDERED: i32 = 202;
/// Bytes of the smallest node: a leaf of nothing, without bounds.
const SMALLEST: u64 = 8;
/// The probability of no preference.
const EITHER: f32 = 0.5;

/// Whether the first word is that of such a file.
pub fn looks_like(bytes: &[u8]) -> bool {
    bytes.starts_with(&MAGIC.to_le_bytes())
}

/// A tree that was read.
#[derive(Clone, Debug)]
pub struct Read {
    /// With the children of every branch beside each other, in file order otherwise. Primitives are numbers of triangles as they were given.
    pub tree: Tree,
    /// Of a file with probabilities: the likelier child first; nearest first where both are as likely.
    pub order: Option<Vec<u8>>,
    /// Branches whose probability is not 0, 0.5 or 1, so that an order does not keep it.
    pub rounded: u64,
    /// Whether a triangle stands in several leaves.
    pub duplicates: bool,
    /// Leaves whose stated box does not touch one of their triangles: it is another scene's tree.
    pub apart: u64,
}

/// Reads a tree over `triangles`, which are in the order of the scene file.
///
/// # Errors
/// When the bytes are cut off, name a triangle that is not there, or are no such tree.
pub fn read(bytes: &[u8], triangles: &[Triangle]) -> Result<Read, FormatError> {
    let mut words = Words { bytes, at: 0 };
    words.expect("magic of a 2011 tree", MAGIC, "267534")?;
    let ordered = match words.int("type of the tree")? {
        PLAIN => false,
        ORDERED => true,
        other => return Err(FormatError::field(4, "type of the tree", other, "201 or 202")),
    };
    let mut reader = Reader {
        words,
        triangles,
        nodes: vec![Node::leaf(Aabb::EMPTY, 0, 0)],
        order: vec![rule::NEAREST],
        primitives: Vec::new(),
        unbounded: vec![false],
        rounded: 0,
        apart: 0,
    };
    // Slots of nodes that are still to be read, the next one last.
    let mut waiting = vec![0];
    while let Some(slot) = waiting.pop() {
        if let Some(first) = reader.node(slot, ordered)? {
            waiting.extend([first + 1, first]);
        }
        // Otherwise a file of branches alone would make nodes that it cannot fill.
        let (needed, available) = (waiting.len() as u64 * SMALLEST + 4, reader.words.left());
        if needed > available {
            let problem =
                Problem::Truncated { what: "nodes of a 2011 tree", needed: Some(needed), available };
            return Err(FormatError::new(reader.words.at as u64, problem));
        }
    }
    reader.words.expect("end of a 2011 tree", END, "9215 behind the last node")?;
    if reader.words.left() > 0 {
        let found = format!("{} bytes more", reader.words.left());
        return Err(FormatError::field(reader.words.at as u64, "end of a 2011 tree", found, "none"));
    }
    reader.bound();
    let mut seen = vec![false; triangles.len()];
    let duplicates =
        reader.primitives.iter().any(|&triangle| std::mem::replace(&mut seen[triangle as usize], true));
    Ok(Read {
        tree: Tree { nodes: reader.nodes, primitives: reader.primitives },
        order: ordered.then_some(reader.order),
        rounded: reader.rounded,
        duplicates,
        apart: reader.apart,
    })
}

struct Words<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Words<'_> {
    fn left(&self) -> u64 {
        (self.bytes.len() - self.at) as u64
    }

    fn word(&mut self, what: &'static str) -> Result<[u8; 4], FormatError> {
        let available = self.left();
        let word = self.bytes[self.at..].first_chunk::<4>().ok_or_else(|| {
            FormatError::new(self.at as u64, Problem::Truncated { what, needed: Some(4), available })
        })?;
        self.at += 4;
        Ok(*word)
    }

    fn int(&mut self, what: &'static str) -> Result<i32, FormatError> {
        self.word(what).map(i32::from_le_bytes)
    }

    fn float(&mut self, what: &'static str) -> Result<f32, FormatError> {
        self.word(what).map(f32::from_le_bytes)
    }

    fn expect(&mut self, what: &'static str, value: i32, expected: &str) -> Result<(), FormatError> {
        let at = self.at as u64;
        match self.int(what)? {
            found if found == value => Ok(()),
            found => Err(FormatError::field(at, what, found, expected)),
        }
    }
}

struct Reader<'a> {
    words: Words<'a>,
    triangles: &'a [Triangle],
    nodes: Vec<Node>,
    order: Vec<u8>,
    primitives: Vec<u32>,
    /// Nodes whose box the file leaves out.
    unbounded: Vec<bool>,
    rounded: u64,
    apart: u64,
}

impl Reader<'_> {
    /// Reads the next node into its slot. Of a branch, makes two slots beside each other and returns the first.
    fn node(&mut self, slot: usize, ordered: bool) -> Result<Option<usize>, FormatError> {
        let at = self.words.at as u64;
        let id = self.words.int("id of a node")?;
        let (branch, bounded) = match id {
            0 => (true, true),
            1 => (false, true),
            2 => (true, false),
            3 => (false, false),
            other => return Err(FormatError::field(at, "id of a node", other, "0, 1, 2 or 3")),
        };
        if branch && ordered {
            let p = self.words.float("probability of a branch")?;
            self.order[slot] = match p.partial_cmp(&EITHER) {
                Some(std::cmp::Ordering::Greater) => rule::FIRST,
                Some(std::cmp::Ordering::Less) => rule::LAST,
                _ => rule::NEAREST,
            };
            self.rounded += u64::from(p != 0.0 && p != EITHER && p != 1.0);
        }
        let bounds = if bounded { self.bounds()? } else { Aabb::EMPTY };
        self.unbounded[slot] = !bounded;
        if !branch {
            self.nodes[slot] = self.leaf(bounds, bounded)?;
            return Ok(None);
        }
        let first = self.nodes.len();
        if first + 2 > u32::MAX as usize {
            return Err(FormatError::field(at, "nodes of a 2011 tree", first, "less than 2^32"));
        }
        self.nodes[slot] = Node::inner(bounds, first as u32, 2);
        self.nodes.extend([Node::leaf(Aabb::EMPTY, 0, 0); 2]);
        self.order.extend([rule::NEAREST; 2]);
        self.unbounded.extend([false; 2]);
        Ok(Some(first))
    }

    fn bounds(&mut self) -> Result<Aabb, FormatError> {
        let at = self.words.at as u64;
        let mut bounds = Aabb { lower: Vec3::ZERO, upper: Vec3::ZERO };
        for axis in 0..3 {
            bounds.lower[axis] = self.words.float("bounds of a node")?;
            bounds.upper[axis] = self.words.float("bounds of a node")?;
        }
        if bounds.lower.is_nan() || bounds.upper.is_nan() {
            return Err(FormatError::field(at, "bounds of a node", "NaN", "numbers"));
        }
        Ok(bounds)
    }

    fn leaf(&mut self, bounds: Aabb, bounded: bool) -> Result<Node, FormatError> {
        let at = self.words.at as u64;
        let found = self.words.int("number of triangles of a leaf")?;
        let most = self.words.left() / 4;
        let count = u32::try_from(found).ok().filter(|&count| u64::from(count) <= most);
        let Some(count) = count else {
            let expected = format!("0 to {most}, for which there are bytes left");
            return Err(FormatError::field(at, "number of triangles of a leaf", found, expected));
        };
        let first = self.primitives.len();
        if first + count as usize > u32::MAX as usize {
            return Err(FormatError::field(at, "triangles of all leaves", first, "less than 2^32"));
        }
        let mut touches = true;
        for _ in 0..count {
            let at = self.words.at as u64;
            let number = self.words.int("triangle of a leaf")?;
            let triangle = usize::try_from(number).ok().and_then(|index| self.triangles.get(index));
            let Some(triangle) = triangle else {
                let expected = format!("0 up to the {} triangles of the scene", self.triangles.len());
                return Err(FormatError::field(at, "triangle of a leaf", number, expected));
            };
            touches &= !triangle.is_finite() || !triangle.bounds().intersection(&bounds).is_empty();
            self.primitives.push(number as u32);
        }
        self.apart += u64::from(bounded && !touches);
        Ok(Node::leaf(bounds, first as u32, count))
    }

    /// Boxes from below where the file has none: children stand behind their parents.
    fn bound(&mut self) {
        for slot in (0..self.nodes.len()).rev().filter(|&slot| self.unbounded[slot]) {
            let node = self.nodes[slot];
            let bounds = if node.is_leaf() {
                let triangles =
                    self.primitives[node.range()].iter().map(|&index| &self.triangles[index as usize]);
                triangles
                    .filter(|triangle| triangle.is_finite())
                    .fold(Aabb::EMPTY, |all, triangle| all.union(&triangle.bounds()))
            } else {
                self.nodes[node.range()].iter().fold(Aabb::EMPTY, |all, child| all.union(&child.bounds()))
            };
            (self.nodes[slot].lower, self.nodes[slot].upper) = (bounds.lower, bounds.upper);
        }
    }
}

/// Whether every inner node has two children, as the format wants it.
pub fn is_binary(tree: TreeView) -> bool {
    tree.nodes.iter().all(|node| node.is_leaf() || node.len() == 2)
}

/// Writes a binary tree, with bounds in every node. `number` gives a triangle's number in the scene file. With an order, the probability of a branch
/// is 1 where the first child is visited first, 0 where the last is, 0.5 where the ray decides; the number of those is returned.
///
/// # Errors
/// `InvalidInput` when a node has not two children or a number is above what the format holds; else what `out` says.
pub fn write(out: &mut dyn Write, contents: &Contents, number: impl Fn(u32) -> u32) -> io::Result<u64> {
    let invalid = |what: &str| io::Error::new(io::ErrorKind::InvalidInput, what.to_owned());
    let Contents { tree, order, .. } = *contents;
    if !is_binary(tree) {
        return Err(invalid("a node that has not two children"));
    }
    let mut put = |word: [u8; 4]| out.write_all(&word);
    put(MAGIC.to_le_bytes())?;
    put(if order.is_some() { ORDERED } else { PLAIN }.to_le_bytes())?;
    let mut undecided = 0;
    let mut waiting = vec![0];
    while let Some(index) = waiting.pop() {
        let node = &tree.nodes[index];
        put(i32::from(node.is_leaf()).to_le_bytes())?;
        if let Some(order) = order.filter(|_| !node.is_leaf()) {
            let p = match order[index] {
                rule::FIRST => 1.0,
                rule::LAST => 0.0,
                _ => EITHER,
            };
            undecided += u64::from(order[index] == rule::FARTHEST);
            put(f32::to_le_bytes(p))?;
        }
        for axis in 0..3 {
            put(node.lower[axis].to_le_bytes())?;
            put(node.upper[axis].to_le_bytes())?;
        }
        if !node.is_leaf() {
            waiting.extend(node.range().rev());
            continue;
        }
        let count = i32::try_from(node.len()).map_err(|_| invalid("a leaf of 2^31 triangles"))?;
        put(count.to_le_bytes())?;
        for &triangle in &tree.primitives[node.range()] {
            let number = i32::try_from(number(triangle)).map_err(|_| invalid("a triangle above 2^31"))?;
            put(number.to_le_bytes())?;
        }
    }
    put(END.to_le_bytes())?;
    Ok(undecided)
}
