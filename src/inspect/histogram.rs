//! Counting values of any magnitude, NaN and infinity included, and showing them in a few bins.

use serde::Serialize;

/// Bins of a log-scale histogram that a terminal shows at most, beside the special ones.
const MAX_BINS: usize = 18;

/// Counts to show: bins in order, empty ones between others included.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Histogram {
    pub name: &'static str,
    pub bins: Vec<Bin>,
}

/// One row of a histogram.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bin {
    pub label: String,
    /// The bin holds from <= value < to; absent for a bin that is no range of finite numbers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub to: Option<f64>,
    pub count: u64,
}

impl Bin {
    /// A bin that is named, not a range.
    pub fn named(label: impl Into<String>, count: u64) -> Bin {
        Bin { label: label.into(), from: None, to: None, count }
    }
}

/// Counts of `f32` values by power of two; zero, negative, infinite and NaN values apart.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PowersOfTwo {
    /// By the biased exponent of a positive value: 0 holds the subnormal ones.
    exponents: [u64; 255],
    zero: u64,
    negative: u64,
    infinite: u64,
    nan: u64,
}

impl Default for PowersOfTwo {
    fn default() -> PowersOfTwo {
        PowersOfTwo { exponents: [0; 255], zero: 0, negative: 0, infinite: 0, nan: 0 }
    }
}

impl PowersOfTwo {
    #[inline]
    pub fn add(&mut self, value: f32) {
        if value > 0.0 && value < f32::INFINITY {
            self.exponents[(value.to_bits() >> 23) as usize] += 1;
        } else if value == 0.0 {
            self.zero += 1;
        } else if value == f32::INFINITY {
            self.infinite += 1;
        } else if value < 0.0 {
            self.negative += 1;
        } else {
            self.nan += 1;
        }
    }

    pub fn merge(&mut self, other: &PowersOfTwo) {
        for (count, more) in self.exponents.iter_mut().zip(&other.exponents) {
            *count += more;
        }
        self.zero += other.zero;
        self.negative += other.negative;
        self.infinite += other.infinite;
        self.nan += other.nan;
    }

    /// The counts in bins of equal width on a log scale, as few powers of two wide as `MAX_BINS` allows.
    pub fn histogram(&self, name: &'static str) -> Histogram {
        let mut bins = Vec::new();
        let special = |bins: &mut Vec<Bin>, label, count| {
            if count > 0 {
                bins.push(Bin::named(label, count));
            }
        };
        special(&mut bins, "NaN", self.nan);
        special(&mut bins, "negative", self.negative);
        special(&mut bins, "0", self.zero);
        let used = |&index: &usize| self.exponents[index] > 0;
        if let (Some(first), Some(last)) = ((0..255).find(used), (0..255).rev().find(used)) {
            let width = (last - first + 1).div_ceil(MAX_BINS);
            for start in (first..=last).step_by(width) {
                let end = (start + width).min(255);
                // Exponent 0 is of the subnormal values, which reach down to zero.
                let power =
                    |exponent: usize| if exponent == 0 { 0.0 } else { (exponent as f64 - 127.0).exp2() };
                let (from, to) = (power(start), power(end));
                let count = self.exponents[start..end].iter().sum();
                bins.push(Bin { label: range(from, to), from: Some(from), to: Some(to), count });
            }
        }
        special(&mut bins, "infinite", self.infinite);
        Histogram { name, bins }
    }
}

fn range(from: f64, to: f64) -> String {
    format!("{} to {}", short(from), short(to))
}

/// A power of two in at most 8 characters.
fn short(value: f64) -> String {
    if value == 0.0 || (1e-3..1e6).contains(&value) {
        format!("{}", round(value))
    } else {
        format!("{value:.1e}")
    }
}

/// Three significant digits for what is small.
fn round(value: f64) -> f64 {
    if value == 0.0 || value >= 1.0 {
        return value;
    }
    let scale = 10f64.powi(2 - value.log10().floor() as i32);
    (value * scale).round() / scale
}

/// Counts by a small number, from `first`; merged into ranges of equal width when they are many.
pub fn by_number(name: &'static str, counts: &[u64], first: usize) -> Histogram {
    let end = counts.iter().rposition(|&count| count > 0).map_or(0, |last| last + 1);
    let counts = &counts[..end];
    let start = counts.iter().position(|&count| count > 0).unwrap_or(0);
    let width = (end - start).div_ceil(2 * MAX_BINS).max(1);
    let bins = counts[start..]
        .chunks(width)
        .enumerate()
        .map(|(index, part)| {
            let from = first + start + index * width;
            let to = from + part.len();
            let label = if part.len() == 1 { from.to_string() } else { format!("{from} to {}", to - 1) };
            Bin { label, from: Some(from as f64), to: Some(to as f64), count: part.iter().sum() }
        })
        .collect();
    Histogram { name, bins }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_has_a_bin_that_holds_it() {
        let values = [0.3f32, 1.0, 1.5, 2.0, 1e30, 1e-40, f32::MAX, f32::MIN_POSITIVE];
        for value in values {
            let mut counts = PowersOfTwo::default();
            values.iter().for_each(|&value| counts.add(value));
            let histogram = counts.histogram("value");
            let value = f64::from(value);
            let holds = |bin: &&Bin| bin.from.unwrap() <= value && value < bin.to.unwrap();
            assert_eq!(histogram.bins.iter().filter(holds).count(), 1, "{value}");
            assert_eq!(histogram.bins.iter().map(|bin| bin.count).sum::<u64>(), values.len() as u64);
            assert!(histogram.bins.len() <= MAX_BINS);
        }
    }

    #[test]
    fn specials_are_counted_apart() {
        let mut counts = PowersOfTwo::default();
        for value in [f32::NAN, -f32::NAN, -1.0, f32::NEG_INFINITY, 0.0, -0.0, f32::INFINITY] {
            counts.add(value);
        }
        let bins: Vec<(String, u64)> =
            counts.histogram("value").bins.into_iter().map(|bin| (bin.label, bin.count)).collect();
        let expected = [("NaN", 2), ("negative", 2), ("0", 2), ("infinite", 1)];
        assert_eq!(bins, expected.map(|(label, count)| (label.to_string(), count)));
    }

    #[test]
    fn merging_is_counting_both() {
        let (mut left, mut right, mut both) =
            (PowersOfTwo::default(), PowersOfTwo::default(), PowersOfTwo::default());
        for value in [1.0, f32::NAN, 7.0] {
            left.add(value);
            both.add(value);
        }
        for value in [0.0, f32::INFINITY, -3.0, 7.5] {
            right.add(value);
            both.add(value);
        }
        left.merge(&right);
        assert_eq!(left, both);
    }

    #[test]
    fn neighbouring_powers_make_readable_ranges() {
        let mut counts = PowersOfTwo::default();
        counts.add(0.3);
        counts.add(1.0);
        let labels: Vec<String> = counts.histogram("value").bins.into_iter().map(|bin| bin.label).collect();
        assert_eq!(labels, ["0.25 to 0.5", "0.5 to 1", "1 to 2"]);
    }

    #[test]
    fn small_numbers_have_a_row_each_and_many_are_merged() {
        let few = by_number("depth", &[0, 5, 0, 2, 0], 0);
        let rows: Vec<(&str, u64)> = few.bins.iter().map(|bin| (bin.label.as_str(), bin.count)).collect();
        assert_eq!(rows, [("1", 5), ("2", 0), ("3", 2)]);
        let many = by_number("depth", &[1; 1000], 0);
        assert!(many.bins.len() <= 2 * MAX_BINS);
        assert_eq!(many.bins.iter().map(|bin| bin.count).sum::<u64>(), 1000);
        assert!(by_number("depth", &[], 0).bins.is_empty());
    }
}
