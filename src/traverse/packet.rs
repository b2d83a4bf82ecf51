//! Packets: up to 256 queries of one kind that follow a tree together.
//!
//! A packet's rays are tested against boxes and triangles eight at a time (an *octet*, `bundle`); where many octets are active, the rules of
//! Wald, Boulos and Shirley spare most of that (`descend`, `frustum`). Rays that run in different directions along some axis go apart,
//! and few that remain alone go singly. Answers are those of single rays, bit for bit.

mod bundle;
mod descend;
mod frustum;
mod watch;

pub use watch::{Decisions, PacketCounts, PacketObserver, Rule};

use super::candidates::Candidates;
use super::child_order::{ByRule, OcclusionOrder};
use super::form::Faces;
use super::simd::{self, Machine};
use super::{Hit, Prepared, Traversal};
use crate::geometry::Ray;
use bundle::{Bundle, LANES, OCTETS};
use descend::Agenda;

/// Most queries of a packet.
pub const MOST: usize = OCTETS * LANES;

/// What one thread keeps from packet to packet.
#[derive(Debug, Default)]
pub struct PacketScratch {
    bundle: Bundle,
    agenda: Agenda,
}

/// What a packet is asked for.
struct Task<'a, C, O> {
    traversal: Traversal,
    order: ByRule<'a>,
    rays: &'a [Ray],
    candidates: &'a [C],
    observer: &'a mut O,
    scratch: &'a mut PacketScratch,
    answers: &'a mut [Option<Hit>],
}

impl Prepared {
    /// What [`Self::closest_hit`] says of each of `rays`, of which there may be [`MOST`]; `candidates` and `answers` are as many.
    pub fn closest_hits<C: Candidates>(
        &self,
        traversal: Traversal,
        rays: &[Ray],
        candidates: &[C],
        observer: &mut impl PacketObserver,
        scratch: &mut PacketScratch,
        answers: &mut [Option<Hit>],
    ) {
        let order = ByRule::new(&OcclusionOrder::Nearest, rays);
        self.packet::<false, C, _>(Task { traversal, order, rays, candidates, observer, scratch, answers });
    }

    /// What [`Self::occluder_in`] says of each of `rays`, as [`Self::closest_hits`], but for which of several occluders it names. A
    /// random order is drawn for the packet. In RayOrder the order plays no part.
    #[allow(clippy::too_many_arguments)] // As many as the single query has, and the answers.
    pub fn occluders<C: Candidates>(
        &self,
        traversal: Traversal,
        order: &OcclusionOrder,
        rays: &[Ray],
        candidates: &[C],
        observer: &mut impl PacketObserver,
        scratch: &mut PacketScratch,
        answers: &mut [Option<Hit>],
    ) {
        let order = ByRule::new(order, rays);
        self.packet::<true, C, _>(Task { traversal, order, rays, candidates, observer, scratch, answers });
    }

    fn packet<const ANY: bool, C: Candidates, O: PacketObserver>(&self, task: Task<C, O>) {
        let count = task.rays.len();
        assert!(count <= MOST && task.candidates.len() == count && task.answers.len() == count);
        #[cfg(target_arch = "x86_64")]
        if self.fused {
            // SAFETY: the processor has both features, or `fused` would be false.
            return unsafe { self.packet_fused::<ANY, C, O>(task) };
        }
        self.packet_on::<ANY, simd::Any, C, O>(task);
    }

    /// `packet_on`, compiled for processors with AVX2 and fused multiply-add: the same bits, sooner.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn packet_fused<const ANY: bool, C: Candidates, O: PacketObserver>(&self, task: Task<C, O>) {
        self.packet_on::<ANY, simd::Avx2, C, O>(task);
    }

    #[inline(always)]
    fn packet_on<const ANY: bool, M: Machine, C: Candidates, O: PacketObserver>(&self, task: Task<C, O>) {
        let Task { traversal, order, rays, candidates, observer, scratch, answers } = task;
        let PacketScratch { bundle, agenda } = scratch;
        answers.fill(None);
        let mut ways = bundle.prepare::<M::Eight>(rays);
        let only = ways.is_power_of_two();
        while ways != 0 {
            bundle.take(ways.trailing_zeros() as usize, only);
            ways &= ways - 1;
            let bounds = [self.root_bounds.lower, self.root_bounds.upper];
            let faces = Faces::new(|axis, side| bounds[side][axis], &bundle.near_face);
            let (root, blocks) = (self.root, &self.blocks);
            macro_rules! run {
                ($front_to_back:literal) => {
                    with_form!(self, form => descend::run::<ANY, $front_to_back, M, _, C>(
                        form, root, faces, &order, blocks, bundle, candidates, observer, agenda,
                    ))
                };
            }
            match traversal {
                Traversal::Odf => run!(false),
                Traversal::RayOrder => run!(true),
            }
            bundle.answer(answers);
        }
    }
}
