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
use super::child_order::{ByRule, NearestFirst, OcclusionOrder};
use super::form::{Link, Room};
use super::leaf::Best;
use super::observer::Observer;
use super::ray::PreparedRay;
use super::simd::{self, Machine};
use super::{Hit, Prepared, Traversal, odf};
use crate::geometry::Ray;
use bundle::{Bundles, LANES, OCTETS};
use descend::Agenda;

/// Most queries of a packet.
pub const MOST: usize = OCTETS * LANES;

/// What one thread keeps from packet to packet.
#[derive(Debug, Default)]
pub struct PacketScratch {
    bundles: Bundles,
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
            // SAFETY: the processor has these features, or `fused` would be false.
            return unsafe { self.packet_fused::<ANY, C, O>(task) };
        }
        self.packet_on::<ANY, simd::Any, C, O>(task);
    }

    /// `packet_on`, compiled for processors with AVX2 and fused multiply-add: the same bits, sooner.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn packet_fused<const ANY: bool, C: Candidates, O: PacketObserver>(&self, task: Task<C, O>) {
        self.packet_on::<ANY, simd::Avx2, C, O>(task);
    }

    #[inline(always)]
    fn packet_on<const ANY: bool, M: Machine, C: Candidates, O: PacketObserver>(&self, task: Task<C, O>) {
        let Task { traversal, order, rays, candidates, observer, scratch, answers } = task;
        let PacketScratch { bundles, agenda } = scratch;
        answers.fill(None);
        let mut ways = bundles.prepare::<M::Eight>(rays);
        let only = ways.is_power_of_two();
        while ways != 0 {
            bundles.take(ways.trailing_zeros() as usize, only);
            ways &= ways - 1;
            with_form!(self, form => descend::run::<ANY, M::Eight, C>(
                self, form, traversal, &order, bundles, candidates, observer, agenda,
            ));
            bundles.current().answer(answers);
        }
    }

    /// Where a ray of a packet goes on alone: follows `from`, whose box it enters no later than `best`, which is what is known already.
    #[allow(clippy::too_many_arguments)] // As many as the traversal has.
    fn resume<const ANY: bool, O: Observer>(
        &self,
        order: &ByRule,
        from: Link,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        observer: &mut O,
        best: Best,
        room: &mut Room,
    ) -> Best {
        #[cfg(target_arch = "x86_64")]
        if self.fused {
            // SAFETY: the processor has both features, or `fused` would be false.
            return unsafe {
                self.resume_fused::<ANY, O>(order, from, ray, candidates, observer, best, room)
            };
        }
        self.resume_on::<ANY, simd::Any, O>(order, from, ray, candidates, observer, best, room)
    }

    /// `resume_on`, compiled for processors with AVX2 and fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    #[allow(clippy::too_many_arguments)]
    fn resume_fused<const ANY: bool, O: Observer>(
        &self,
        order: &ByRule,
        from: Link,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        observer: &mut O,
        best: Best,
        room: &mut Room,
    ) -> Best {
        self.resume_on::<ANY, simd::Avx2, O>(order, from, ray, candidates, observer, best, room)
    }

    #[inline(always)]
    #[allow(clippy::too_many_arguments)]
    fn resume_on<const ANY: bool, M: Machine, O: Observer>(
        &self,
        order: &ByRule,
        from: Link,
        ray: &PreparedRay,
        candidates: &impl Candidates,
        observer: &mut O,
        best: Best,
        room: &mut Room,
    ) -> Best {
        let (blocks, stack) = (&self.blocks, room.stack(self.stack_size));
        macro_rules! run {
            ($order:expr) => {
                with_form!(self, form => odf::run::<ANY, M, _>(
                    form, from, $order, blocks, ray, candidates, observer, best, stack,
                ))
            };
        }
        // The nearest first has a shortcut.
        if ANY && !order.is_nearest() { run!(order) } else { run!(&NearestFirst) }
    }
}
