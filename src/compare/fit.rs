//! What a visit, a leaf, a block and a miss take, fitted to measured times rather than assumed, and how well measures of trees rank them.
//!
//! Weighted least squares over groups of queries, each asked of some trees: time = query + visit · node visits + leaf · leaf visits + block ·
//! blocks + miss · misses, in nanoseconds per query ([`crate::cost`] prices the same). What is to be known is how *trees* differ. Groups differ in more
//! than their counts: a visit of incoherent queries takes longer. So where groups were asked of several trees, each has a time of its own that no tree changes,
//! and only differences between trees for the same queries decide (fixed effects); `query` is the mean of those times. With one tree, groups are
//! compared with each other. Every group counts by its queries and relative to its own time, so that slow queries, or a slow scene, have no more say than others.
//!
//! Nothing costs less than nothing: where two counts nearly rise and fall together, plain least squares would say so of one of them, to the benefit of the other.
//! There are few columns, so the best fit without such costs is found by trying every choice of them.

use crate::cost::{Constants, Counted};
use std::collections::BTreeMap;

/// A group of queries under one tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The same number for the same queries.
    pub group: usize,
    pub counted: Counted,
    pub seconds: f64,
}

/// A fitted cost and its standard error, in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    pub value: f64,
    pub error: f64,
}

/// What was fitted, in nanoseconds. A cost is `None` when the samples cannot tell it from the ones before it, or fit best without it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    pub query: Option<Estimate>,
    pub visit: Option<Estimate>,
    pub leaf: Option<Estimate>,
    pub block: Option<Estimate>,
    pub miss: Option<Estimate>,
    /// Whether leaves and blocks could not be told apart, as where every leaf is one block: then they have the ratio that is known.
    pub is_joined: bool,
    /// Share of the variance that the fit explains: of that between trees for the same queries, or of that between groups where there is one tree.
    pub r_squared: f64,
    pub samples: usize,
}

/// A query, a visit, a leaf, a block, a miss.
const COLUMNS: usize = 5;
const QUERY: usize = 0;
const LEAF: usize = 2;
const BLOCK: usize = 3;

/// A column is dropped when less than this share of it is not explained by those before it.
const INDEPENDENT: f64 = 1e-7;

/// A sample per query, relative to the time of its group; its weight is in all numbers.
struct Row {
    group: usize,
    x: [f64; COLUMNS],
    y: f64,
}

impl Fit {
    /// `None` when there are too few samples, or all are alike. Where leaves and blocks rise and fall so much together that the one or the other would cost
    /// nothing, both are fitted in the ratio that they have in `known`.
    pub fn of(samples: &[Sample], known: &Constants) -> Option<Fit> {
        let mut rows = rows(samples);
        let apart = Fit::of_rows(&rows)?;
        if apart.leaf.is_some() && apart.block.is_some() {
            return Some(apart);
        }
        for row in &mut rows {
            row.x[LEAF] = known.leaf * row.x[LEAF] + known.block * row.x[BLOCK];
            row.x[BLOCK] = 0.0;
        }
        let fit = Fit::of_rows(&rows)?;
        let part = |share: f64| {
            fit.leaf.map(|both| Estimate { value: share * both.value, error: share * both.error })
        };
        Some(Fit { leaf: part(known.leaf), block: part(known.block), is_joined: true, ..fit })
    }

    fn of_rows(rows: &[Row]) -> Option<Fit> {
        let mut groups: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        rows.iter().enumerate().for_each(|(place, row)| groups.entry(row.group).or_default().push(place));
        let several = groups.values().any(|places| places.len() > 1);
        let (deviations, absorbed) = if several {
            from_means(rows, &groups)
        } else {
            (rows.iter().map(|row| (row.x, row.y)).collect(), 0)
        };
        let scale: [f64; COLUMNS] = std::array::from_fn(|column| {
            deviations.iter().map(|(x, _)| x[column] * x[column]).sum::<f64>().sqrt()
        });
        let told_apart = independent(&deviations, &scale);
        let freedom =
            |columns: usize| deviations.len().checked_sub(absorbed + columns).filter(|freedom| *freedom > 0);
        freedom(COLUMNS)?;
        let choices = (1..1u32 << told_apart.len()).filter_map(|choice| {
            let numbered = told_apart.iter().enumerate();
            let kept: Vec<usize> =
                numbered.filter(|(place, _)| choice >> place & 1 == 1).map(|(_, &column)| column).collect();
            let (solution, inverse) = solve(&deviations, &scale, &kept)?;
            if solution.iter().any(|&value| value < 0.0) {
                return None;
            }
            let expected = |x: &[f64; COLUMNS]| -> f64 {
                kept.iter().zip(&solution).map(|(&column, value)| x[column] * value).sum()
            };
            let residual: f64 = deviations.iter().map(|(x, y)| (y - expected(x)).powi(2)).sum();
            Some((residual, kept, solution, inverse))
        });
        let (residual, kept, solution, inverse) = choices.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let total = variation(&deviations);
        if total <= 0.0 {
            return None;
        }
        let variance = residual / freedom(kept.len())? as f64;
        let estimate = |column: usize| {
            let place = kept.iter().position(|&other| other == column)?;
            let error = (variance * inverse[place][place]).max(0.0).sqrt() / scale[column];
            Some(Estimate { value: solution[place], error })
        };
        let own = || {
            let costs: [f64; COLUMNS] =
                std::array::from_fn(|column| estimate(column).map_or(0.0, |it| it.value));
            mean_of_groups(rows, &groups, &costs)
        };
        Some(Fit {
            query: if several { own() } else { estimate(QUERY) },
            visit: estimate(1),
            leaf: estimate(LEAF),
            block: estimate(BLOCK),
            miss: estimate(4),
            is_joined: false,
            r_squared: 1.0 - residual / total,
            samples: rows.len(),
        })
    }

    /// The constants, where a tree can be chosen by them: a visit, a leaf and a block each cost something.
    pub fn constants(&self) -> Option<Constants> {
        let value = |estimate: Option<Estimate>| estimate.map(|it| it.value).filter(|value| *value > 0.0);
        Some(Constants {
            query: value(self.query).unwrap_or(0.0),
            visit: value(self.visit)?,
            leaf: value(self.leaf)?,
            block: value(self.block)?,
            miss: value(self.miss).unwrap_or(0.0),
        })
    }
}

/// Nanoseconds and counts per query.
fn rows(samples: &[Sample]) -> Vec<Row> {
    let usable =
        |sample: &&Sample| sample.counted.queries > 0 && sample.seconds > 0.0 && sample.seconds.is_finite();
    let ns = |sample: &Sample| sample.seconds * 1e9 / sample.counted.queries as f64;
    let mut sums: BTreeMap<usize, (f64, f64)> = BTreeMap::new();
    for sample in samples.iter().filter(usable) {
        let (sum, count) = sums.entry(sample.group).or_default();
        *sum += ns(sample);
        *count += 1.0;
    }
    let row = |sample: &Sample| {
        let Counted { queries, counts, misses } = sample.counted;
        let (sum, count) = sums[&sample.group];
        let weight = (queries as f64).sqrt() * count / sum;
        let counts = [queries, counts.node_visits, counts.leaf_visits, counts.block_tests, misses];
        let x = counts.map(|count| count as f64 / queries as f64 * weight);
        Row { group: sample.group, x, y: ns(sample) * weight }
    };
    samples.iter().filter(usable).map(row).collect()
}

/// Rows less the mean of their group, and how many means that were; groups of one say nothing.
fn from_means(rows: &[Row], groups: &BTreeMap<usize, Vec<usize>>) -> (Vec<([f64; COLUMNS], f64)>, usize) {
    let several = || groups.values().filter(|places| places.len() > 1);
    let mut deviations = Vec::with_capacity(rows.len());
    for places in several() {
        let mean = |of: &dyn Fn(&Row) -> f64| {
            places.iter().map(|&place| of(&rows[place])).sum::<f64>() / places.len() as f64
        };
        let means: [f64; COLUMNS] = std::array::from_fn(|column| mean(&|row| row.x[column]));
        let time = mean(&|row| row.y);
        let less = |&place: &usize| {
            // All queries of a group are the same in every tree, but for the last bits of a mean.
            let x = std::array::from_fn(|column| {
                if column == QUERY { 0.0 } else { rows[place].x[column] - means[column] }
            });
            (x, rows[place].y - time)
        };
        deviations.extend(places.iter().map(less));
    }
    (deviations, several().count())
}

/// The time of a query that no tree changes, in the mean of all groups; `None` when it comes out below zero.
fn mean_of_groups(
    rows: &[Row],
    groups: &BTreeMap<usize, Vec<usize>>,
    costs: &[f64; COLUMNS],
) -> Option<Estimate> {
    let rest = |row: &Row| row.y - row.x.iter().zip(costs).map(|(count, cost)| count * cost).sum::<f64>();
    let own = |places: &Vec<usize>| {
        let weight = rows[places[0]].x[QUERY];
        (
            weight * weight,
            places.iter().map(|&place| rest(&rows[place])).sum::<f64>() / places.len() as f64 / weight,
        )
    };
    let all: Vec<(f64, f64)> = groups.values().map(own).collect();
    let weights: f64 = all.iter().map(|(weight, _)| weight).sum();
    let value = all.iter().map(|(weight, own)| weight * own).sum::<f64>() / weights;
    let spread: f64 = all.iter().map(|(weight, own)| (weight * (own - value)).powi(2)).sum();
    (value >= 0.0).then(|| Estimate { value, error: spread.sqrt() / weights })
}

/// The sum of squares about the mean that a query alone explains, or about zero where that has gone.
fn variation(rows: &[([f64; COLUMNS], f64)]) -> f64 {
    let weights: f64 = rows.iter().map(|(x, _)| x[QUERY] * x[QUERY]).sum();
    let mean =
        if weights > 0.0 { rows.iter().map(|(x, y)| x[QUERY] * y).sum::<f64>() / weights } else { 0.0 };
    rows.iter().map(|(x, y)| (y - mean * x[QUERY]).powi(2)).sum()
}

/// Columns that those before them do not explain (modified Gram-Schmidt).
fn independent(rows: &[([f64; COLUMNS], f64)], scale: &[f64; COLUMNS]) -> Vec<usize> {
    let mut basis: Vec<Vec<f64>> = Vec::new();
    let mut kept = Vec::new();
    for column in 0..COLUMNS {
        if scale[column] == 0.0 {
            continue;
        }
        let mut vector: Vec<f64> = rows.iter().map(|(x, _)| x[column] / scale[column]).collect();
        for known in &basis {
            let along: f64 = known.iter().zip(&vector).map(|(a, b)| a * b).sum();
            vector.iter_mut().zip(known).for_each(|(value, known)| *value -= along * known);
        }
        let length = vector.iter().map(|value| value * value).sum::<f64>().sqrt();
        if length > INDEPENDENT {
            vector.iter_mut().for_each(|value| *value /= length);
            basis.push(vector);
            kept.push(column);
        }
    }
    kept
}

/// Coefficients of the kept columns, and the inverse of their scaled normal matrix (Gauss and Jordan, with pivots).
fn solve(
    rows: &[([f64; COLUMNS], f64)],
    scale: &[f64; COLUMNS],
    kept: &[usize],
) -> Option<(Vec<f64>, Vec<Vec<f64>>)> {
    let count = kept.len();
    // The normal matrix, beside it the unit matrix.
    let mut matrix = vec![vec![0.0; 2 * count]; count];
    let mut right = vec![0.0; count];
    for (x, y) in rows {
        let scaled: Vec<f64> = kept.iter().map(|&column| x[column] / scale[column]).collect();
        for i in 0..count {
            right[i] += scaled[i] * y;
            for j in 0..count {
                matrix[i][j] += scaled[i] * scaled[j];
            }
        }
    }
    for (i, row) in matrix.iter_mut().enumerate() {
        row[count + i] = 1.0;
    }
    for column in 0..count {
        let pivot =
            (column..count).max_by(|&a, &b| matrix[a][column].abs().total_cmp(&matrix[b][column].abs()))?;
        if matrix[pivot][column] == 0.0 {
            return None;
        }
        matrix.swap(column, pivot);
        let head = matrix[column].clone();
        matrix[column].iter_mut().for_each(|value| *value /= head[column]);
        let unit = matrix[column].clone();
        for (_, row) in matrix.iter_mut().enumerate().filter(|(row, _)| *row != column) {
            let factor = row[column];
            row.iter_mut().zip(&unit).for_each(|(value, unit)| *value -= factor * unit);
        }
    }
    let inverse: Vec<Vec<f64>> = matrix.into_iter().map(|row| row[count..].to_vec()).collect();
    let solution = inverse
        .iter()
        .zip(kept)
        .map(|(row, &column)| row.iter().zip(&right).map(|(a, b)| a * b).sum::<f64>() / scale[column])
        .collect();
    Some((solution, inverse))
}

/// Times that differ by less than this share rank nothing: that is what measuring twice differs by.
pub const APART: f64 = 0.02;

/// Kendall's τ_b of a measure and the times of the same trees, over pairs of them whose times are [`APART`], and how many pairs those are: 1 when the measure ranks them as
/// the clock does, -1 in reverse; what it holds for equal counts for neither (Kendall 1945). `None` when it, or the clock, ranks nothing.
pub fn kendall(measure: &[f64], times: &[f64]) -> (Option<f64>, usize) {
    let (mut agreement, mut told_apart, mut pairs) = (0, 0, 0);
    let order = |x: f64, y: f64| i32::from(x > y) - i32::from(x < y);
    for i in 0..measure.len().min(times.len()) {
        for j in 0..i {
            if (times[i] - times[j]).abs() <= APART * times[i].min(times[j]) {
                continue;
            }
            let by_measure = order(measure[i], measure[j]);
            agreement += by_measure * order(times[i], times[j]);
            told_apart += by_measure.abs();
            pairs += 1;
        }
    }
    let tau = || f64::from(agreement) / (f64::from(told_apart) * pairs as f64).sqrt();
    ((told_apart > 0).then(tau), pairs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::mixed;
    use crate::traverse::Counts;

    const TRUTH: Constants = Constants { query: 30.0, visit: 5.0, leaf: 7.0, block: 2.0, miss: 20.0 };

    /// Groups of queries under some trees, whose time follows the costs exactly, but for a `noise` that averages out. What queries take of their own
    /// differs from group to group around that of the costs.
    fn samples(trees: usize, noise: f64) -> Vec<Sample> {
        let mut samples = Vec::new();
        for group in 0..60 {
            for tree in 0..trees {
                let draw = |column: u64, range: u64| mixed((group * 64 + tree) as u64 * 8 + column) % range;
                let queries = 100 + group as u64 * 37 % 500;
                let leaves = 2 + draw(1, 5);
                let counts = Counts {
                    node_visits: queries * (10 + draw(0, 17)),
                    leaf_visits: queries * leaves,
                    block_tests: queries * (leaves + draw(2, 4)),
                    ..Counts::default()
                };
                let counted = Counted { queries, counts, misses: queries * draw(3, 4) };
                let own = if trees > 1 { 10.0 * (group % 3) as f64 - 10.0 } else { 0.0 };
                let wobble = if draw(4, 2) == 0 { 1.0 + noise } else { 1.0 - noise };
                let seconds = 1e-9 * (TRUTH.of(&counted) + own * queries as f64) * wobble;
                samples.push(Sample { group, counted, seconds });
            }
        }
        samples
    }

    fn costs(fit: &Fit) -> [Option<Estimate>; COLUMNS] {
        [fit.query, fit.visit, fit.leaf, fit.block, fit.miss]
    }

    fn truth() -> [f64; COLUMNS] {
        [TRUTH.query, TRUTH.visit, TRUTH.leaf, TRUTH.block, TRUTH.miss]
    }

    #[test]
    fn exact_costs_are_found_over_one_tree_and_over_several() {
        for trees in [1, 2, 7] {
            let fit = Fit::of(&samples(trees, 0.0), &TRUTH).expect("a fit");
            // Queries of their own groups differ, and their mean is weighted by what groups take.
            for (column, (cost, value)) in costs(&fit).into_iter().zip(truth()).enumerate() {
                let within = if column == QUERY && trees > 1 { 3.0 } else { 1e-6 };
                assert!(
                    cost.is_some_and(|it| (it.value - value).abs() < within),
                    "{trees}, {column}: {fit:?}"
                );
            }
            assert!(fit.r_squared > 1.0 - 1e-9 && fit.samples == 60 * trees && !fit.is_joined);
            let constants = fit.constants().expect("all of them");
            assert!((constants.leaf - 7.0).abs() < 1e-6 && (constants.miss - 20.0).abs() < 1e-6);
        }
    }

    #[test]
    fn what_groups_take_of_their_own_says_nothing_of_trees() {
        // Groups with more visits are slower for another reason, and trees differ by the truth.
        let mut samples = samples(6, 0.0);
        for sample in &mut samples {
            let queries = sample.counted.queries;
            sample.counted.counts.node_visits += queries * sample.group as u64;
            sample.seconds += 1e-9 * queries as f64 * (5.0 + 40.0) * sample.group as f64;
        }
        let fit = Fit::of(&samples, &TRUTH).expect("a fit");
        assert!(fit.visit.is_some_and(|visit| (visit.value - 5.0).abs() < 1e-6), "{fit:?}");
    }

    #[test]
    fn noise_shows_in_errors_and_r_squared() {
        let fit = Fit::of(&samples(6, 0.1), &TRUTH).expect("a fit");
        for (cost, value) in costs(&fit).into_iter().zip(truth()).skip(1) {
            let Estimate { value: found, error } = cost.expect("a cost");
            assert!(error > 0.05 && (found - value).abs() < 4.0 * error, "{value}: {fit:?}");
        }
        assert!((0.5..0.999).contains(&fit.r_squared), "{fit:?}");
    }

    #[test]
    fn nothing_costs_less_than_nothing() {
        // Leaves nearly follow visits, and the time follows both and a wobble.
        let samples: Vec<Sample> = (1..100u64)
            .map(|n| {
                let node_visits = 1000 + n * 37 % 500;
                let leaf_visits = 8 * node_visits + n % 3;
                let block_tests = n % 11;
                let counts = Counts { node_visits, leaf_visits, block_tests, ..Counts::default() };
                let seconds = 1e-9 * (3.0 * node_visits as f64 - 20.0 * (n % 3) as f64 + (n * 7 % 5) as f64);
                Sample { group: n as usize, counted: Counted { queries: 100, counts, misses: 0 }, seconds }
            })
            .collect();
        let fit = Fit::of_rows(&rows(&samples)).expect("a fit");
        assert!(costs(&fit).iter().flatten().all(|cost| cost.value >= 0.0), "{fit:?}");
        assert!(fit.r_squared > 0.99, "{fit:?}");
        // No mixture of costs that are not negative is nearer: each of a grid around it is tried.
        let residual = |costs: [f64; COLUMNS]| -> f64 {
            let of = |sample: &Sample| {
                let [query, visit, leaf, block, miss] = costs;
                let expected = Constants { query, visit, leaf, block, miss }.of(&sample.counted);
                (1.0 - expected / (sample.seconds * 1e9)).powi(2)
            };
            samples.iter().map(of).sum()
        };
        let found = costs(&fit).map(|cost| cost.map_or(0.0, |cost| cost.value));
        for mask in 0..81 {
            let nudged: [f64; COLUMNS] = std::array::from_fn(|column| {
                let step = [-0.01, 0.0, 0.01][mask / 3usize.pow(column.min(3) as u32) % 3];
                (found[column] + step).max(0.0)
            });
            assert!(residual(nudged) >= residual(found) * (1.0 - 1e-9), "{nudged:?} beats {found:?}");
        }
    }

    #[test]
    fn leaves_and_blocks_that_cannot_be_told_apart_have_the_ratio_that_is_known() {
        let mut samples = samples(5, 0.0);
        for sample in &mut samples {
            sample.counted.counts.block_tests = sample.counted.counts.leaf_visits;
            sample.seconds = 1e-9 * TRUTH.of(&sample.counted);
        }
        let fit = Fit::of(&samples, &Constants { leaf: 2.0, block: 1.0, ..TRUTH }).expect("a fit");
        let constants = fit.constants().expect("all of them");
        assert!(fit.is_joined && fit.r_squared > 1.0 - 1e-9, "{fit:?}");
        assert!((constants.leaf - 6.0).abs() < 1e-6 && (constants.block - 3.0).abs() < 1e-6, "{constants:?}");
        // What costs nothing chooses no tree.
        assert_eq!(Fit { visit: None, ..fit }.constants(), None);
    }

    #[test]
    fn too_little_gives_no_fit() {
        let some = samples(1, 0.0);
        assert_eq!(Fit::of(&[], &TRUTH), None);
        assert_eq!(Fit::of(&some[..5], &TRUTH), None);
        assert_eq!(Fit::of(&[some[0]; 9], &TRUTH), None, "all alike");
        let none = |seconds| Sample { seconds, ..some[0] };
        assert_eq!(Fit::of(&[none(0.0), none(f64::NAN), none(f64::INFINITY)], &TRUTH), None);
    }

    #[test]
    fn tau_is_kendalls_of_trees_whose_times_differ() {
        assert_eq!(kendall(&[1.0, 2.0, 3.0], &[10.0, 20.0, 30.0]), (Some(1.0), 3));
        assert_eq!(kendall(&[1.0, 2.0, 3.0], &[3.0, 2.0, 1.0]), (Some(-1.0), 3));
        assert_eq!(kendall(&[1.0, 1.0], &[1.0, 2.0]), (None, 1));
        // Two of these times are the same within 2%, whatever the measure says of them.
        assert_eq!(kendall(&[2.0, 1.0, 3.0], &[1.0, 1.019, 2.0]), (Some(1.0), 2));
        assert_eq!(kendall(&[2.0, 1.0, 3.0], &[1.0, 1.021, 2.0]), (Some(1.0 / 3.0), 3));
        // The example of scipy.stats.kendalltau's documentation: -0.4714045207910316.
        let (tau, pairs) = kendall(&[12.0, 2.0, 1.0, 12.0, 2.0], &[1.0, 4.0, 7.0, 1.0, 0.0]);
        assert!(tau.is_some_and(|tau| (tau + 0.4714045207910316).abs() < 1e-12) && pairs == 9, "{tau:?}");
    }
}
