//! Which triangles a query may hit: masks, and what the recorded program's filter refused.

use super::triangle::PreparedTriangle;
use crate::format::rays::Reject;

/// Asked of every triangle that the ray hits, before the hit counts.
pub trait Candidates {
    fn accepts(&self, triangle: &PreparedTriangle) -> bool;
}

/// Every triangle may be hit.
#[derive(Clone, Copy, Debug)]
pub struct All;

impl Candidates for All {
    #[inline(always)]
    fn accepts(&self, _triangle: &PreparedTriangle) -> bool {
        true
    }
}

/// A recorded query's view of the scene.
#[derive(Clone, Copy, Debug)]
pub struct Recorded<'a> {
    /// A geometry is seen when it shares a bit.
    pub mask: u32,
    /// Rejects of this record only.
    pub rejects: &'a [Reject],
}

impl Candidates for Recorded<'_> {
    #[inline(always)]
    fn accepts(&self, triangle: &PreparedTriangle) -> bool {
        // Programs reject a candidate or two per query, so a plain search is the fast one.
        self.mask & triangle.mask != 0
            && self.mask & triangle.instance_mask != 0
            && self.rejects.iter().all(|reject| reject.triangle != triangle.index)
    }
}
