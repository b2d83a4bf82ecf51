//! Numbers and rows as a person reads them in a terminal.

use super::histogram::Histogram;
use std::fmt::{self, Formatter};

/// Cells of the longest bar.
const BAR: usize = 36;

/// 1234567 as `1,234,567`.
pub fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// Bytes in the largest binary unit that keeps a digit before the point.
pub fn bytes(number: u64) -> String {
    let units = ["KiB", "MiB", "GiB", "TiB"];
    let mut size = number as f64;
    let mut unit = "bytes";
    for next in units {
        if size < 1024.0 {
            break;
        }
        size /= 1024.0;
        unit = next;
    }
    if unit == "bytes" { format!("{number} bytes") } else { format!("{size:.1} {unit}") }
}

/// `part` of `whole` as a percentage; nothing of nothing is 0.
pub fn percent(part: u64, whole: u64) -> f64 {
    if whole == 0 { 0.0 } else { 100.0 * part as f64 / whole as f64 }
}

/// A line `name  value`.
pub fn line(f: &mut Formatter, name: &str, value: impl fmt::Display) -> fmt::Result {
    writeln!(f, "  {name:<20}{value}")
}

/// A histogram with a bar, a count and a percentage per bin; nothing when nothing was counted.
pub fn histogram(f: &mut Formatter, histogram: &Histogram) -> fmt::Result {
    let total: u64 = histogram.bins.iter().map(|bin| bin.count).sum();
    let largest = histogram.bins.iter().map(|bin| bin.count).max().unwrap_or(0);
    if total == 0 {
        return Ok(());
    }
    writeln!(f, "\n{}", histogram.name)?;
    for bin in &histogram.bins {
        // A bin with one query among millions still shows that it is there.
        let cells = (bin.count as f64 / largest as f64 * BAR as f64).ceil() as usize;
        let (count, share) = (grouped(bin.count), percent(bin.count, total));
        let row = format!("  {:>24} {count:>15} {share:>6.2}%  {}", bin.label, "#".repeat(cells));
        writeln!(f, "{}", row.trim_end())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_grouped_by_three() {
        let cases = [(0, "0"), (999, "999"), (1000, "1,000"), (u64::MAX, "18,446,744,073,709,551,615")];
        for (number, text) in cases {
            assert_eq!(grouped(number), text);
        }
    }

    #[test]
    fn sizes_keep_a_digit_before_the_point() {
        assert_eq!(bytes(1023), "1023 bytes");
        assert_eq!(bytes(1536), "1.5 KiB");
        assert_eq!(bytes(u64::MAX), "16777216.0 TiB");
    }

    #[test]
    fn a_share_of_nothing_is_nothing() {
        assert_eq!(percent(0, 0), 0.0);
        assert_eq!(percent(1, 4), 25.0);
    }
}
