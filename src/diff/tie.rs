//! Whether two triangles are hit at one t, decided in double precision where the trees are known.

use super::query::Query;
use crate::format::bvh::{Bvh, flag as tree_flag};
use crate::format::rays::{Header, NO_TRIANGLE, flag};
use crate::replay::exact::tie;
use std::cell::Cell;

/// The trees of two recordings, as far as they are known.
#[derive(Clone, Copy, Debug, Default)]
pub struct Trees<'a> {
    pub a: Option<&'a Bvh<'a>>,
    pub b: Option<&'a Bvh<'a>>,
}

/// Why trees are not those of the recordings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TreesError {
    #[error(
        "the tree is of another scene than both recordings: its fingerprint is {found:016x}, expected {a:016x} or {b:016x}; \
         give the .bvh that was recorded with A or B"
    )]
    OtherScene { found: u64, a: u64, b: u64 },
    #[error("both trees are of the scene of {0}: give one for each recording")]
    Twice(&'static str),
    #[error(
        "{side} was not recorded with this tree: query {query} hit triangle {triangle}, and the tree has {triangles}; \
         give the .bvh that was recorded with {side}"
    )]
    NoTriangle { side: &'static str, query: u64, triangle: u32, triangles: u64 },
}

impl<'a> Trees<'a> {
    /// Finds out whose trees these are by their fingerprints: a recording of several scenes has none and takes what is left,
    /// and a single tree is both recordings' where their fingerprints allow it.
    ///
    /// # Errors
    /// When a tree is of neither, or two are of one.
    ///
    /// # Panics
    /// When there are more than two trees.
    pub fn assign(trees: &'a [Bvh<'a>], headers: &[Header; 2]) -> Result<Trees<'a>, TreesError> {
        assert!(trees.len() <= 2);
        let [a, b] = [headers[0].fingerprint, headers[1].fingerprint];
        let fits = |tree: &Bvh, known: u64| known == 0 || known == tree.header.fingerprint;
        for tree in trees {
            if !fits(tree, a) && !fits(tree, b) {
                return Err(TreesError::OtherScene { found: tree.header.fingerprint, a, b });
            }
        }
        match trees {
            [first, second] if fits(first, a) && fits(second, b) => {
                Ok(Trees { a: Some(first), b: Some(second) })
            }
            [first, second] if fits(first, b) && fits(second, a) => {
                Ok(Trees { a: Some(second), b: Some(first) })
            }
            [first, _] => Err(TreesError::Twice(if fits(first, a) { "A" } else { "B" })),
            _ => {
                let only = trees.first();
                Ok(Trees { a: only.filter(|tree| fits(tree, a)), b: only.filter(|tree| fits(tree, b)) })
            }
        }
    }

    pub fn is_empty(&self) -> bool {
        self.a.is_none() && self.b.is_none()
    }
}

/// Decides ties.
pub(super) struct Ties<'a> {
    trees: Trees<'a>,
    /// A hit of a triangle that its tree does not have.
    wrong: Cell<Option<TreesError>>,
}

impl<'a> Ties<'a> {
    pub(super) fn new(trees: Trees<'a>) -> Ties<'a> {
        Ties { trees, wrong: Cell::new(None) }
    }

    /// Whether the triangles that two answers name are hit at one t by every tree that is known. The recorded t are equal within the
    /// tolerance already, which is all that can be said without a tree, of scenes beyond the first, and of what moves.
    pub(super) fn are_at_one_t(&self, a: &Query, b: &Query) -> bool {
        let judged = |query: &Query| query.scene == 0 && query.record.flags & flag::UNDECIDED == 0;
        if !judged(a) || !judged(b) {
            return true;
        }
        let sides = [("A", self.trees.a, a, b), ("B", self.trees.b, b, a)];
        sides.into_iter().all(|(side, tree, own, other)| {
            tree.is_none_or(|tree| {
                let index = own.record.triangle;
                let Some(triangle) = tree.triangles.get(index as usize) else {
                    if index != NO_TRIANGLE {
                        let (query, triangles) = (own.number, tree.triangles.len() as u64);
                        let wrong = TreesError::NoTriangle { side, query, triangle: index, triangles };
                        self.wrong.set(Some(wrong));
                    }
                    return false;
                };
                // The scene of the other recording may have more triangles.
                let Some(second) = tree.triangles.get(other.record.triangle as usize) else { return false };
                let ray = own.record.ray();
                let flattened = tree.header.flags & tree_flag::FLATTENED != 0;
                tie(&ray, triangle, second, flattened)
            })
        })
    }

    pub(super) fn finish(self) -> Result<(), TreesError> {
        self.wrong.take().map_or(Ok(()), Err)
    }
}
