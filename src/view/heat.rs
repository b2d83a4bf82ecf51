//! Values of triangles and pixels as colours, with scales that a few extremes do not spoil.

use super::layers::SurfaceColor;
use super::paint::{ColorMap, Rgba, difference};
use super::shared::Legend;
use crate::explore::heat::per_triangle;
use crate::explore::shares::Shares;
use crate::explore::walk::Walk;

/// Scales end where so much of what is not zero is below.
const HIGH: f64 = 0.999;
/// And begin, being logarithmic, where so much is.
const LOW: f64 = 0.02;

/// The value below which a share of the positive ones lies; `None` when there are none.
fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut positive: Vec<f64> = values.iter().copied().filter(|&value| value > 0.0).collect();
    let index = (positive.len().checked_sub(1)? as f64 * share) as usize;
    Some(*positive.select_nth_unstable_by(index, f64::total_cmp).1)
}

/// A scale of magnitudes for values that spread over many.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    low: f64,
    high: f64,
}

impl Scale {
    /// Of these values; `None` when none is positive.
    pub fn of(values: &[f64]) -> Option<Scale> {
        let (low, high) = (quantile(values, LOW)?, quantile(values, HIGH)?);
        Some(Scale { low, high: if high > low { high } else { 2.0 * low } })
    }

    /// 0 to 1; 0 for what is not positive.
    pub fn share(&self, value: f64) -> f64 {
        if value <= 0.0 {
            return 0.0;
        }
        ((value / self.low).ln() / (self.high / self.low).ln()).clamp(0.0, 1.0)
    }

    pub fn legend(&self, title: &str, map: ColorMap) -> Legend {
        let [low, high] = [self.low, self.high].map(short);
        Legend::Scale { title: format!("{title} (log)"), low, high: format!("{high} or more"), map }
    }
}

/// A number in three digits or so.
pub fn short(value: f64) -> String {
    match value.abs() {
        size if size >= 1e6 => format!("{:.1}M", value / 1e6),
        size if size >= 1e4 => format!("{:.0}k", value / 1e3),
        size if size >= 100.0 => format!("{value:.0}"),
        size if size >= 1.0 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}

/// The value of each triangle that a colouring is about, and what it is called.
fn values(color: SurfaceColor, walk: &Walk, shares: &Shares) -> Option<(&'static str, Vec<f64>)> {
    let counts = &shares.counted.triangles;
    match color {
        SurfaceColor::Cost => Some(("cost per triangle, ns of all queries", per_triangle(walk, shares))),
        SurfaceColor::Tests => {
            Some(("primitive tests per triangle", counts.iter().map(|count| count.tests.into()).collect()))
        }
        SurfaceColor::Hits => {
            Some(("queries that end at a triangle", counts.iter().map(|count| count.hits.into()).collect()))
        }
        SurfaceColor::Plain | SurfaceColor::Subtree | SurfaceColor::Difference => None,
    }
}

/// Colours of triangles by what was counted; those with nothing stay aside.
pub fn triangles(
    color: SurfaceColor,
    walk: &Walk,
    shares: &Shares,
    map: ColorMap,
) -> Option<(Vec<Rgba>, Legend)> {
    let (title, values) = values(color, walk, shares)?;
    let scale = Scale::of(&values)?;
    let paint = |&value: &f64| if value > 0.0 { map.color(scale.share(value)) } else { [0; 4] };
    Some((values.iter().map(paint).collect(), scale.legend(title, map)))
}

/// Colours by how much more of all cost a triangle has in the first tree (orange) than in the second (blue).
pub fn differences([first, second]: [(&Walk, &Shares); 2]) -> (Vec<Rgba>, Legend) {
    let parts = [first, second].map(|(walk, shares)| {
        let mut costs = per_triangle(walk, shares);
        let total: f64 = costs.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        costs.iter_mut().for_each(|cost| *cost /= total);
        costs
    });
    let differences: Vec<f64> = parts[0].iter().zip(&parts[1]).map(|(a, b)| a - b).collect();
    let (_, colors) = differences_of(&differences);
    let legend = Legend::Difference {
        title: "share of the cost: which tree's is larger".to_owned(),
        low: "right tree".to_owned(),
        high: "left tree".to_owned(),
    };
    (colors, legend)
}

/// Colours of differences from blue (below 0) over white to orange, and the size from which they are as strong as can be.
pub fn differences_of(differences: &[f64]) -> (f64, Vec<Rgba>) {
    let sizes: Vec<f64> = differences.iter().map(|value| value.abs()).collect();
    let high = quantile(&sizes, 0.99).unwrap_or(1.0);
    // Small ones are to be seen all the same.
    let strength = |value: f64| value.signum() * (value.abs() / high).min(1.0).sqrt();
    (high, differences.iter().map(|&value| difference(strength(value))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_are_of_magnitudes_and_leave_extremes_out() {
        let values: Vec<f64> = (0..=10_000).map(f64::from).chain([1e12]).collect();
        let scale = Scale::of(&values).unwrap();
        assert!(
            (9_000.0..=10_000.0).contains(&scale.high) && (150.0..250.0).contains(&scale.low),
            "{scale:?}"
        );
        assert_eq!((scale.share(0.0), scale.share(1.0), scale.share(1e12)), (0.0, 0.0, 1.0));
        let middle = scale.share((scale.low * scale.high).sqrt());
        assert!((middle - 0.5).abs() < 1e-9);
        assert_eq!(Scale::of(&[0.0, -1.0]), None);
        assert_eq!(Scale::of(&[3.0]).unwrap().share(3.0), 0.0);
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(
            [0.0, 0.123, 7.25, 123.4, 12_345.0, 2_500_000.0].map(short),
            ["0.00", "0.12", "7.2", "123", "12k", "2.5M"]
        );
    }
}
