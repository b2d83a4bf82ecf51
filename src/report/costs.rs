//! Fitted costs as the file that `--costs` reads, with what a reader wants to know of where they are from.

use super::circumstances::Circumstances;
use crate::compare::explained::Fitted;
use crate::compare::fit::{Estimate, Fit};
use crate::compare::timing::Follower;
use crate::cost::{Constants, WIDTHS};
use serde::Serialize;
use std::collections::BTreeMap;

/// A file of costs.
pub struct CostsFile {
    pub json: String,
    /// One line: what was fitted, and what kept its default.
    pub said: String,
}

#[derive(Serialize)]
struct Whole<'a> {
    fitted: Origin<'a>,
    costs: Vec<Entry>,
}

/// Where the costs are from.
#[derive(Serialize)]
struct Origin<'a> {
    follower: &'static str,
    /// Which of Embree's.
    #[serde(skip_serializing_if = "Option::is_none")]
    kernels: Option<&'a str>,
    machine: &'a str,
    when: &'a str,
    program: &'a str,
    /// What keeps its default.
    default: Vec<String>,
}

/// An entry as [`crate::cost::Costs::parse`] reads it, in nanoseconds, and what it does not read.
#[derive(Serialize)]
struct Entry {
    width: usize,
    /// Of which trees these are; null of all widths together.
    fitted_to_width: Option<usize>,
    kind: &'static str,
    query: f64,
    visit: f64,
    leaf: f64,
    block: f64,
    miss: f64,
    standard_errors: BTreeMap<&'static str, f64>,
    /// Whether leaf and block could not be told apart, and are parted as in the default.
    leaf_and_block_together: bool,
    r_squared: f64,
    trees: usize,
    groups: usize,
}

/// The costs of Embree's kernels where any could be fitted, else of our traversal. `kernels` says which of Embree's.
///
/// # Errors
/// One line, when no width and kind could be fitted.
pub fn render(
    fits: &[Fitted],
    kernels: Option<&str>,
    circumstances: &Circumstances,
) -> Result<CostsFile, String> {
    let all = || WIDTHS.into_iter().flat_map(|width| [(width, false), (width, true)]);
    let entries = |follower: Follower| -> Vec<Entry> {
        let entry = |(width, is_occlusion)| {
            let fitted = chosen(fits, follower, width, is_occlusion)?;
            let fit = fitted.fit.as_ref()?;
            Some(Entry::of(width, fitted, fit, fit.constants()?))
        };
        all().filter_map(entry).collect()
    };
    let found = [Follower::Embree, Follower::Ours].map(|follower| (follower, entries(follower)));
    let (follower, costs) = found.into_iter().find(|(_, entries)| !entries.is_empty()).ok_or(
        "no costs can be fitted: for no width and kind do the trees tell visits and leaves apart; compare more trees that differ, or more queries",
    )?;
    let is_listed = |(width, is_occlusion): &(usize, bool)| {
        costs.iter().any(|entry| (entry.width, entry.kind) == (*width, kind_key(*is_occlusion)))
    };
    let named = |(width, kind): (usize, bool)| format!("{width} wide, {}", kind_key(kind).replace('_', " "));
    let kept: Vec<String> = all().filter(|it| !is_listed(it)).map(named).collect();
    let fitted: Vec<String> = all().filter(is_listed).map(named).collect();
    let of = match follower {
        Follower::Embree => "Embree's kernels",
        Follower::Ours => "our traversal",
    };
    let mut said = format!("costs of {of}, fitted: {}", fitted.join("; "));
    if !kept.is_empty() {
        said += &format!(". As by default, because these trees do not tell: {}", kept.join("; "));
    }
    let whole = Whole {
        fitted: Origin {
            follower: follower.key(),
            kernels: kernels.filter(|_| follower == Follower::Embree),
            machine: &circumstances.machine,
            when: &circumstances.when,
            program: &circumstances.program,
            default: kept,
        },
        costs,
    };
    let json = serde_json::to_string_pretty(&whole).map_err(|error| error.to_string())? + "\n";
    Ok(CostsFile { json, said })
}

/// What the constants of a width and kind are taken from. Embree's kernels follow trees of all widths in the same nodes, and trees of several widths tell visits from leaves:
/// theirs are those of all widths that were measured. Ours have code for each width.
fn chosen(fits: &[Fitted], follower: Follower, width: usize, is_occlusion: bool) -> Option<&Fitted> {
    let of_kind = || fits.iter().filter(move |it| (it.follower, it.is_occlusion) == (follower, is_occlusion));
    let of_all = || of_kind().find(|it| it.width.is_none());
    match follower {
        Follower::Embree => of_all().or_else(|| of_kind().next()),
        Follower::Ours => {
            let tells =
                |it: &&Fitted| it.width == Some(width) && it.fit.as_ref().and_then(Fit::constants).is_some();
            of_kind().find(tells).or_else(of_all)
        }
    }
}

impl Entry {
    fn of(width: usize, fitted: &Fitted, fit: &Fit, constants: Constants) -> Entry {
        let Constants { query, visit, leaf, block, miss } = constants;
        let errors = estimates(fit).into_iter().filter_map(|(name, it)| Some((name, it?.error)));
        Entry {
            width,
            fitted_to_width: fitted.width,
            kind: kind_key(fitted.is_occlusion),
            query,
            visit,
            leaf,
            block,
            miss,
            standard_errors: errors.collect(),
            leaf_and_block_together: fit.is_joined,
            r_squared: fit.r_squared,
            trees: fitted.trees,
            groups: fit.samples,
        }
    }
}

/// What was fitted, by the name that it has in files.
pub(crate) fn estimates(fit: &Fit) -> [(&'static str, Option<Estimate>); 5] {
    let &Fit { query, visit, leaf, block, miss, .. } = fit;
    [("query", query), ("visit", visit), ("leaf", leaf), ("block", block), ("miss", miss)]
}

/// The key of a kind.
pub(crate) fn kind_key(is_occlusion: bool) -> &'static str {
    if is_occlusion { "occlusion" } else { "closest_hit" }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cost::Costs;

    fn fit(leaf: f64) -> Fit {
        let estimate = |value: f64| Some(Estimate { value, error: 0.5 });
        Fit {
            query: estimate(40.0),
            visit: estimate(6.5),
            leaf: estimate(leaf),
            block: estimate(1.25),
            miss: None,
            is_joined: false,
            r_squared: 0.9,
            samples: 700,
        }
    }

    fn fitted(follower: Follower, width: Option<usize>, leaf: f64) -> Fitted {
        Fitted { follower, width, is_occlusion: true, trees: 7, fit: Some(fit(leaf)) }
    }

    #[test]
    fn what_is_written_is_what_costs_are_read_from() {
        let fits = [
            fitted(Follower::Ours, Some(8), 3.0),
            fitted(Follower::Ours, Some(4), 0.0),
            fitted(Follower::Ours, None, 5.0),
            fitted(Follower::Embree, Some(8), 9.0),
            fitted(Follower::Embree, None, 4.0),
        ];
        let file = render(&fits, Some("Embree 3.13.5, avx2"), &Circumstances::default()).unwrap();
        let costs = Costs::parse(&file.json).unwrap();
        let expected = Constants { query: 40.0, visit: 6.5, leaf: 4.0, block: 1.25, miss: 0.0 };
        for width in WIDTHS {
            assert_eq!(*costs.of(width, true), expected, "Embree's are the same in every width");
            // What was not measured is as by default, and both the file and the line say so.
            assert_eq!(costs.of(width, false), Costs::default().of(width, false));
            assert!(file.said.contains(&format!("{width} wide, closest hit")) && !file.said.contains('\n'));
        }
        let json: serde_json::Value = serde_json::from_str(&file.json).unwrap();
        assert_eq!(json["fitted"]["kernels"], "Embree 3.13.5, avx2");
        assert_eq!(json["fitted"]["default"].as_array().map(Vec::len), Some(3));
        assert_eq!(json["costs"][0]["standard_errors"]["leaf"], 0.5);

        // Of ours where Embree's tell nothing: each width's own, or what all widths tell together.
        let ours = render(&fits[..3], None, &Circumstances::default()).unwrap();
        let costs = Costs::parse(&ours.json).unwrap();
        assert_eq!([8, 4, 2].map(|width| costs.of(width, true).leaf), [3.0, 5.0, 5.0]);
        let one = render(&fits[3..4], None, &Circumstances::default()).unwrap();
        assert_eq!(Costs::parse(&one.json).unwrap().of(2, true).leaf, 9.0);
        // Nothing at all is an error in one line.
        for nothing in [&fits[1..2], &[]] {
            assert!(render(nothing, None, &Circumstances::default()).is_err_and(|line| !line.contains('\n')));
        }
    }
}
