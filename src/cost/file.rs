//! Costs as JSON, as `bvh-compare --fit-costs` writes them and `--costs FILE` reads them:
//!
//! `{"costs": [{"width": 8, "kind": "closest_hit", "query": 30.1, "visit": 6.1, "leaf": 7.7, "block": 2.0, "miss": 25.0}, …]}`
//!
//! in nanoseconds. `query` and `miss` may be left out, and other keys stand beside them unread. A width and kind that is not listed keeps its default.

use super::{Constants, Costs, WIDTHS};
use serde::Deserialize;
use thiserror::Error;

/// Why a file of costs cannot be used.
#[derive(Debug, Error)]
pub enum CostsError {
    #[error("not a file of costs as bvh-compare --fit-costs writes it: {0}")]
    Json(#[from] serde_json::Error),
    #[error("there is no entry in \"costs\": give at least one width and kind")]
    Nothing,
    #[error("costs[{entry}] has width {width}: 2, 4 and 8 have costs")]
    Width { entry: usize, width: usize },
    #[error("costs[{entry}].{name} is {value}: {expected}")]
    Value { entry: usize, name: &'static str, value: f64, expected: &'static str },
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum Kind {
    ClosestHit,
    Occlusion,
}

#[derive(Deserialize)]
struct Entry {
    width: usize,
    kind: Kind,
    #[serde(default)]
    query: f64,
    visit: f64,
    leaf: f64,
    block: f64,
    #[serde(default)]
    miss: f64,
}

#[derive(Deserialize)]
struct File {
    costs: Vec<Entry>,
}

/// No machine takes longer for anything, in nanoseconds; with more, sums could overflow.
const MOST: f64 = 1e9;

impl Costs {
    /// Reads costs from JSON.
    ///
    /// # Errors
    /// When it is not such a file, or a cost is no number that a tree can be chosen by.
    pub fn parse(json: &str) -> Result<Costs, CostsError> {
        let file: File = serde_json::from_str(json)?;
        let mut costs = Costs::default();
        if file.costs.is_empty() {
            return Err(CostsError::Nothing);
        }
        for (entry, Entry { width, kind, query, visit, leaf, block, miss }) in
            file.costs.into_iter().enumerate()
        {
            let place =
                WIDTHS.iter().position(|&known| known == width).ok_or(CostsError::Width { entry, width })?;
            for (name, value) in [("visit", visit), ("leaf", leaf), ("block", block)] {
                if !(value > 0.0 && value <= MOST) {
                    let expected = "expected nanoseconds, above 0 and at most a second";
                    return Err(CostsError::Value { entry, name, value, expected });
                }
            }
            for (name, value) in [("query", query), ("miss", miss)] {
                if !(0.0..=MOST).contains(&value) {
                    let expected = "expected nanoseconds, not negative and at most a second";
                    return Err(CostsError::Value { entry, name, value, expected });
                }
            }
            let of_kind = match kind {
                Kind::ClosestHit => &mut costs.closest_hit,
                Kind::Occlusion => &mut costs.occlusion,
            };
            of_kind[place] = Constants { query, visit, leaf, block, miss };
        }
        Ok(costs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_out_keeps_its_default() {
        let text = r#"{"fitted": true, "costs": [{"width": 8, "kind": "occlusion", "visit": 5, "leaf": 4.5, "block": 2, "r_squared": 1}]}"#;
        let costs = Costs::parse(text).unwrap();
        let expected = Constants { query: 0.0, visit: 5.0, leaf: 4.5, block: 2.0, miss: 0.0 };
        assert_eq!(*costs.of(8, true), expected);
        assert_eq!(costs.of(8, false), Costs::default().of(8, false));
        assert_eq!(costs.of(4, true), Costs::default().of(4, true));
    }

    #[test]
    fn what_no_tree_can_be_chosen_by_is_refused_in_one_line() {
        let entry = |width: usize, visit: &str, query: &str| {
            format!(
                r#"{{"costs": [{{"width": {width}, "kind": "closest_hit", "query": {query}, "visit": {visit}, "leaf": 1, "block": 1}}]}}"#
            )
        };
        for (text, message) in [
            (entry(8, "0", "1"), "costs[0].visit is 0: expected nanoseconds, above 0"),
            (entry(8, "-2", "1"), "costs[0].visit is -2"),
            (entry(8, "1e300", "1"), "costs[0].visit is 1"),
            (entry(8, "1", "-1"), "costs[0].query is -1: expected nanoseconds, not negative"),
            (entry(3, "1", "1"), "costs[0] has width 3"),
            (entry(8, "NaN", "1"), "not a file of costs"),
            (entry(8, "null", "1"), "not a file of costs"),
            (r#"{"costs": []}"#.to_owned(), "there is no entry"),
            ("[]".to_owned(), "not a file of costs"),
            (String::new(), "not a file of costs"),
        ] {
            let error = Costs::parse(&text).unwrap_err().to_string();
            assert!(error.starts_with(message) && !error.contains('\n'), "{error}, expected {message}");
        }
    }
}
