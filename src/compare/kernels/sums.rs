//! Sums over answers: integers, so that neither threads nor their number change them.

use super::{APART, Answers, Differences};
use crate::replay::Mismatch;
use crate::replay::check::Verdict;

impl Answers {
    /// Counts a verdict on the answer to `mismatch.query`, which is of use when it is wrong.
    pub(super) fn count(&mut self, verdict: Verdict, mismatch: Mismatch) {
        match verdict {
            Verdict::Agrees => {}
            Verdict::Borderline => self.borderline += 1,
            Verdict::Unchecked | Verdict::Moving => self.unjudged += 1,
            Verdict::Mismatch => {
                self.mismatches += 1;
                self.mismatch = self.mismatch.or(Some(mismatch));
            }
        }
    }

    /// Adds what was found of later queries of the same recording.
    pub(super) fn merge(self, later: Answers) -> Answers {
        Answers {
            queries: self.queries + later.queries,
            mismatches: self.mismatches + later.mismatches,
            borderline: self.borderline + later.borderline,
            unjudged: self.unjudged + later.unjudged,
            differing: self.differing + later.differing,
            mismatch: self.mismatch.or(later.mismatch),
            singly: self.singly.merge(later.singly),
            in_packets: self.in_packets.merge(later.in_packets),
        }
    }
}

impl Differences {
    /// Of two answers to one query: t of a closest hit, anything where something occludes.
    pub(super) fn count(&mut self, one: Option<f32>, other: Option<f32>) {
        match (one, other) {
            (Some(one), Some(other)) => {
                let greater = f64::from(one.abs().max(other.abs()));
                self.apart += u64::from((f64::from(one) - f64::from(other)).abs() > APART * greater);
            }
            (None, None) => {}
            _ => self.flipped += 1,
        }
    }

    pub(super) fn merge(self, other: Differences) -> Differences {
        Differences { flipped: self.flipped + other.flipped, apart: self.apart + other.apart }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_differ_beyond_a_ten_thousandth_of_their_distance() {
        let of = |one, other| {
            let mut differences = Differences::default();
            differences.count(one, other);
            (differences.flipped, differences.apart)
        };
        assert_eq!(of(None, None), (0, 0));
        assert_eq!(of(Some(1.0), None), (1, 0));
        assert_eq!(of(None, Some(0.0)), (1, 0));
        assert_eq!(of(Some(1000.0), Some(1000.09)), (0, 0));
        assert_eq!(of(Some(1000.0), Some(1000.2)), (0, 1));
        assert_eq!(of(Some(0.0), Some(0.0)), (0, 0));
    }
}
