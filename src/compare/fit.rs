//! What a test costs, fitted rather than assumed, and how well measures of trees rank them.
//!
//! Least squares over groups of queries, each of which has counts and a measured time: time = queries · a + node visits · b +
//! box tests · c_I + primitive tests · c_P. In a binary tree every visit is two box tests, so that b and c_I cannot be told apart; then b
//! takes both. Nothing costs less than nothing: where two counts nearly rise and fall together, as visits and box tests of a wide tree do, plain least squares would
//! say so of one of them, to the benefit of the other. There are few columns, so the best fit without such costs is found by trying every choice of them.

/// One group of queries under one tree: its size, counts and time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Observation {
    pub queries: u64,
    pub node_visits: u64,
    pub box_tests: u64,
    pub primitive_tests: u64,
    pub seconds: f64,
}

/// A fitted cost and its standard error, in the unit of the times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    pub value: f64,
    pub error: f64,
}

/// What was fitted. A cost is `None` when the observations cannot tell it from the ones before it, or fit best without it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    pub query: Option<Estimate>,
    pub node_visit: Option<Estimate>,
    pub primitive_test: Option<Estimate>,
    pub box_test: Option<Estimate>,
    /// Share of the variance of the time per query that the fit explains.
    pub r_squared: f64,
    pub observations: usize,
}

const COLUMNS: usize = 4;
/// A column is dropped when less than this share of it is not explained by those before it.
const INDEPENDENT: f64 = 1e-7;

impl Fit {
    /// Fits time per query, each group weighted by its queries. `None` when there are too few groups, or all are alike.
    pub fn of(observations: &[Observation]) -> Option<Fit> {
        let usable: Vec<&Observation> = observations.iter().filter(|o| o.queries > 0).collect();
        // Rows scaled so that plain least squares over them is the weighted one over means.
        let rows: Vec<([f64; COLUMNS], f64)> = usable
            .iter()
            .map(|o| {
                let weight = (o.queries as f64).sqrt();
                let counts = [o.queries, o.node_visits, o.primitive_tests, o.box_tests];
                (counts.map(|count| count as f64 / weight), o.seconds / weight)
            })
            .collect();
        let scale: [f64; COLUMNS] =
            std::array::from_fn(|column| rows.iter().map(|(x, _)| x[column] * x[column]).sum::<f64>().sqrt());
        let told_apart = independent(&rows, &scale);
        let freedom = |columns: usize| rows.len().checked_sub(columns).filter(|freedom| *freedom > 0);
        freedom(told_apart.len())?;
        let choices = (1..1 << told_apart.len()).filter_map(|choice: u32| {
            let numbered = told_apart.iter().enumerate();
            let kept: Vec<usize> =
                numbered.filter(|(place, _)| choice >> place & 1 == 1).map(|(_, &column)| column).collect();
            let (solution, inverse) = solve(&rows, &scale, &kept)?;
            if solution.iter().any(|&value| value < 0.0) {
                return None;
            }
            let estimate_of = |x: &[f64; COLUMNS]| -> f64 {
                kept.iter().zip(&solution).map(|(&column, value)| x[column] * value).sum()
            };
            let residual: f64 = rows.iter().map(|(x, y)| (y - estimate_of(x)).powi(2)).sum();
            Some((residual, kept, solution, inverse))
        });
        let (residual, kept, solution, inverse) = choices.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let freedom = freedom(kept.len())? as f64;
        let queries: f64 = usable.iter().map(|o| o.queries as f64).sum();
        let mean = usable.iter().map(|o| o.seconds).sum::<f64>() / queries;
        let total: f64 =
            usable.iter().map(|o| o.queries as f64 * (o.seconds / o.queries as f64 - mean).powi(2)).sum();
        if total <= 0.0 {
            return None;
        }
        let variance = residual / freedom;
        let estimate = |column: usize| {
            let place = kept.iter().position(|&other| other == column)?;
            let error = (variance * inverse[place][place]).max(0.0).sqrt() / scale[column];
            Some(Estimate { value: solution[place], error })
        };
        Some(Fit {
            query: estimate(0),
            node_visit: estimate(1),
            primitive_test: estimate(2),
            box_test: estimate(3),
            r_squared: 1.0 - residual / total,
            observations: rows.len(),
        })
    }

    /// What a box test costs: as fitted, or half a visit where each visit is two of them.
    pub fn c_i(&self) -> Option<f64> {
        self.box_test
            .or(self.node_visit.map(|visit| Estimate { value: visit.value / 2.0, ..visit }))
            .map(|c| c.value)
    }

    /// c_P / c_I as fitted.
    pub fn ratio(&self) -> Option<f64> {
        Some(self.primitive_test?.value / self.c_i()?)
    }
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

/// Kendall's τ_b of two measures of the same things: 1 when they rank them alike, -1 when in reverse; ties count for
/// neither (Kendall 1945). `None` when either ranks nothing.
pub fn kendall(a: &[f64], b: &[f64]) -> Option<f64> {
    let (mut agreement, mut untied_a, mut untied_b) = (0.0, 0.0, 0.0);
    let order = |x: f64, y: f64| (x > y) as i32 - (x < y) as i32;
    for i in 0..a.len().min(b.len()) {
        for j in 0..i {
            let (of_a, of_b) = (order(a[i], a[j]), order(b[i], b[j]));
            agreement += f64::from(of_a * of_b);
            untied_a += f64::from(of_a * of_a);
            untied_b += f64::from(of_b * of_b);
        }
    }
    (untied_a > 0.0 && untied_b > 0.0).then(|| agreement / f64::sqrt(untied_a * untied_b))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Groups whose time follows the costs exactly, but for `noise` that averages out.
    fn observations(wide: bool, noise: f64) -> Vec<Observation> {
        (1..200u64)
            .map(|n| {
                let queries = 100 + n * 37 % 500;
                let node_visits = queries * (10 + n * 13 % 17);
                let children = if wide { node_visits * (20 + n * 7 % 11) / 8 } else { 2 * node_visits };
                let box_tests = queries + children;
                let primitive_tests = queries * (1 + n * 29 % 7);
                let seconds = 30.0 * queries as f64
                    + 5.0 * node_visits as f64
                    + 1.5 * box_tests as f64
                    + 4.0 * primitive_tests as f64;
                let wobble = if n % 2 == 0 { 1.0 + noise } else { 1.0 - noise };
                Observation { queries, node_visits, box_tests, primitive_tests, seconds: seconds * wobble }
            })
            .collect()
    }

    fn near(estimate: Option<Estimate>, value: f64, within: f64) -> bool {
        estimate.is_some_and(|estimate| (estimate.value - value).abs() <= within)
    }

    #[test]
    fn exact_costs_are_found() {
        let fit = Fit::of(&observations(true, 0.0)).expect("a fit");
        assert!(near(fit.query, 30.0, 1e-6) && near(fit.node_visit, 5.0, 1e-6), "{fit:?}");
        assert!(near(fit.box_test, 1.5, 1e-6) && near(fit.primitive_test, 4.0, 1e-6), "{fit:?}");
        assert!(fit.r_squared > 1.0 - 1e-9 && fit.observations == 199);
    }

    #[test]
    fn a_visit_of_a_binary_tree_takes_its_box_tests() {
        let fit = Fit::of(&observations(false, 0.0)).expect("a fit");
        // 5 + 2 · 1.5 a visit; the root's box test goes to the query.
        assert_eq!(fit.box_test, None);
        assert!(near(fit.node_visit, 8.0, 1e-6) && near(fit.query, 31.5, 1e-6), "{fit:?}");
        assert!(fit.c_i().is_some_and(|c_i| (c_i - 4.0).abs() < 1e-6));
    }

    #[test]
    fn noise_shows_in_errors_and_r_squared() {
        let fit = Fit::of(&observations(false, 0.05)).expect("a fit");
        let error = fit.node_visit.map_or(0.0, |visit| visit.error);
        assert!(error > 0.01 && near(fit.node_visit, 8.0, 4.0 * error), "{fit:?}");
        assert!((0.9..0.999).contains(&fit.r_squared), "{fit:?}");
    }

    #[test]
    fn nothing_costs_less_than_nothing() {
        // Box tests nearly follow visits, and the time follows both and a wobble.
        let observations: Vec<Observation> = (1..100u64)
            .map(|n| {
                let node_visits = 1000 + n * 37 % 500;
                let box_tests = 8 * node_visits + n % 3;
                let seconds = 3.0 * node_visits as f64 - 20.0 * (n % 3) as f64 + (n * 7 % 5) as f64;
                Observation { queries: 100, node_visits, box_tests, primitive_tests: n % 11, seconds }
            })
            .collect();
        let fit = Fit::of(&observations).expect("a fit");
        let costs = [fit.query, fit.node_visit, fit.box_test, fit.primitive_test];
        assert!(costs.iter().flatten().all(|cost| cost.value >= 0.0), "{fit:?}");
        assert!(fit.r_squared > 0.99, "{fit:?}");
        // No mixture of costs that are not negative is nearer: each of a fine grid is tried.
        let residual = |[a, b, c, d]: [f64; 4]| -> f64 {
            let of = |o: &Observation| {
                let estimate = a * o.queries as f64
                    + b * o.node_visits as f64
                    + c * o.box_tests as f64
                    + d * o.primitive_tests as f64;
                (o.seconds - estimate).powi(2)
            };
            observations.iter().map(of).sum()
        };
        let found = costs.map(|cost| cost.map_or(0.0, |cost| cost.value));
        for mask in 0..81 {
            let nudged: [f64; 4] = std::array::from_fn(|column| {
                let step = [-0.01, 0.0, 0.01][mask / 3usize.pow(column as u32) % 3];
                (found[column] + step).max(0.0)
            });
            assert!(residual(nudged) >= residual(found) * (1.0 - 1e-9), "{nudged:?} beats {found:?}");
        }
    }

    #[test]
    fn too_little_gives_no_fit() {
        assert_eq!(Fit::of(&[]), None);
        assert_eq!(Fit::of(&observations(true, 0.0)[..3]), None);
        assert_eq!(Fit::of(&[observations(true, 0.0)[0]; 9]), None, "all alike");
    }

    #[test]
    fn tau_is_kendalls() {
        assert_eq!(kendall(&[1.0, 2.0, 3.0], &[10.0, 20.0, 30.0]), Some(1.0));
        assert_eq!(kendall(&[1.0, 2.0, 3.0], &[3.0, 2.0, 1.0]), Some(-1.0));
        assert_eq!(kendall(&[1.0, 1.0], &[1.0, 2.0]), None);
        // The example of scipy.stats.kendalltau's documentation: -0.4714045207910316.
        let tau = kendall(&[12.0, 2.0, 1.0, 12.0, 2.0], &[1.0, 4.0, 7.0, 1.0, 0.0]).expect("a rank");
        assert!((tau + 0.4714045207910316).abs() < 1e-12, "{tau}");
    }
}
