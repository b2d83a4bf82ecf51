//! What a split is taken to cost: (|L|-1)^α · P(L) + (|R|-1)^α · P(R), or with |L|^α or (ln |L|)^α (paper, sections 2.4 and 4).

use super::{Config, Count};

/// The factor of a side that holds a number of primitives.
pub trait Weight: Sync {
    fn of(&self, primitives: usize) -> f32;

    /// A side of up to so many primitives, and at least one, costs nothing, whatever its probability.
    fn free(&self) -> usize;
}

/// α = 1: the number itself, or less one; not its logarithm.
#[derive(Clone, Copy, Debug)]
pub struct Linear {
    less: usize,
}

impl Linear {
    pub fn new(count: Count) -> Linear {
        Linear { less: (count == Count::MinusOne) as usize }
    }
}

impl Weight for Linear {
    #[inline(always)]
    fn of(&self, primitives: usize) -> f32 {
        // Signed: that conversion is one instruction. The sum of two sides' weights is what counts, so an empty
        // side's -1 never matters: empty sides are no candidates.
        (primitives as i32).wrapping_sub(self.less as i32) as f32
    }

    #[inline(always)]
    fn free(&self) -> usize {
        self.less
    }
}

/// Any other α, and logarithms: looked up, because a sweep asks for every number up to its size at every node.
#[derive(Clone, Debug)]
pub struct Power {
    table: Vec<f32>,
}

impl Power {
    /// Powers for up to `primitives`.
    pub fn new(config: &Config, primitives: usize) -> Power {
        let size = |n: usize| match config.count {
            Count::MinusOne => n.saturating_sub(1) as f64,
            Count::All => n as f64,
            Count::Log => libm::log(n.max(1) as f64),
        };
        let power = |n: usize| size(n).powf(config.alpha) as f32;
        Power { table: (0..=primitives).map(power).collect() }
    }
}

impl Weight for Power {
    #[inline(always)]
    fn of(&self, primitives: usize) -> f32 {
        self.table[primitives]
    }

    fn free(&self) -> usize {
        // 0 to the power of 0 is 1.
        (self.table.get(1) == Some(&0.0)) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_the_papers() {
        for (alpha, count, expected) in [
            (1.0, Count::MinusOne, [0.0, 1.0, 9.0]),
            (1.0, Count::All, [1.0, 2.0, 10.0]),
            (0.5, Count::MinusOne, [0.0, 1.0, 3.0]),
            (2.0, Count::All, [1.0, 4.0, 100.0]),
            (0.0, Count::MinusOne, [1.0, 1.0, 1.0]),
            (1.0, Count::Log, [0.0, std::f32::consts::LN_2, std::f32::consts::LN_10]),
        ] {
            let config = Config { alpha, count, ..Config::default() };
            let power = Power::new(&config, 10);
            assert_eq!([1, 2, 10].map(|n| power.of(n)), expected);
            assert_eq!(power.free(), (expected[0] == 0.0) as usize);
            if alpha == 1.0 && count != Count::Log {
                assert_eq!([1, 2, 10].map(|n| Linear::new(count).of(n)), expected);
                assert_eq!(Linear::new(count).free(), power.free());
            }
        }
    }
}
