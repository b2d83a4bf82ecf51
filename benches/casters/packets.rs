//! Our traversal of packets, and what stands for any way to cast a list of queries.

use super::Caster;
use embree_trace::format::rays::Record;
use embree_trace::traverse::packet::MOST;
use embree_trace::traverse::{All, Hit, OcclusionOrder, PacketScratch, Prepared, Traversal};

/// Casts all queries, which are of one kind, and counts the answers that are the recorded ones.
pub type Runner<'a> = Box<dyn FnMut(&[Record]) -> usize + 'a>;

/// One query after the other.
pub fn runner<'a>(mut caster: impl Caster + 'a) -> Runner<'a> {
    Box::new(move |records| records.iter().filter(|record| is_right(&mut caster, record)).count())
}

/// Whether `caster` answers as was recorded.
pub fn is_right(caster: &mut impl Caster, record: &Record) -> bool {
    if record.is_occlusion() {
        caster.occluded(record) == record.is_hit()
    } else {
        agrees(record, caster.closest(record))
    }
}

/// Whether a closest hit at `t` is the recorded one.
fn agrees(record: &Record, t: f32) -> bool {
    if record.is_hit() { (t - record.t).abs() <= 1e-3 * record.t } else { t.is_nan() || t >= record.tfar }
}

/// In packets of `size` consecutive queries.
pub fn packets(prepared: &Prepared, traversal: Traversal, size: usize) -> Runner<'_> {
    let mut scratch = PacketScratch::default();
    let (mut rays, mut answers) = (Vec::with_capacity(size), vec![None; size]);
    Box::new(move |records| {
        let mut right = 0;
        for records in records.chunks(size) {
            rays.clear();
            rays.extend(records.iter().map(Record::ray));
            let (candidates, answers) = (&[All; MOST][..records.len()], &mut answers[..records.len()]);
            if records[0].is_occlusion() {
                let order = &OcclusionOrder::Nearest;
                prepared.occluders(traversal, order, &rays, candidates, &mut (), &mut scratch, answers);
                let pairs = records.iter().zip(answers);
                right += pairs.filter(|(record, answer)| answer.is_some() == record.is_hit()).count();
            } else {
                prepared.closest_hits(traversal, &rays, candidates, &mut (), &mut scratch, answers);
                let t = |answer: &Option<Hit>| answer.map_or(f32::INFINITY, |hit| hit.t);
                let pairs = records.iter().zip(answers);
                right += pairs.filter(|(record, answer)| agrees(record, t(answer))).count();
            }
        }
        right
    })
}
