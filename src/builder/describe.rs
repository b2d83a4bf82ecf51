//! A configuration in words: as options are typed, as a `.bvh` names its producer, and as its `META` section has it.
//!
//! Nothing here may differ between two runs on the same input: no times, no paths, no number of threads.

use super::{Bins, Config, Count, MAX_BINS, Splits, spatial};
use serde_json::{Value, json};
use std::fmt;
use std::str::FromStr;

impl FromStr for Splits {
    type Err = String;

    /// `sweep`, `spatial` (with the default options), `binned` (adaptive) or `binned:N`.
    fn from_str(text: &str) -> Result<Splits, String> {
        let bins = match text.split_once(':') {
            None if text == "sweep" => return Ok(Splits::Sweep),
            None if text == "spatial" => return Ok(Splits::Spatial(spatial::Options::default())),
            None if text == "binned" => Bins::Adaptive,
            Some(("binned", bins)) => match bins.parse() {
                Ok(bins) if (2..=MAX_BINS).contains(&bins) => Bins::Fixed(bins),
                _ => return Err(format!("expected 2 to {MAX_BINS} bins")),
            },
            _ => return Err("expected binned, binned:N, sweep or spatial".into()),
        };
        Ok(Splits::Binned { bins })
    }
}

impl fmt::Display for Splits {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Splits::Sweep => write!(f, "sweep"),
            Splits::Spatial(_) => write!(f, "spatial"),
            Splits::Binned { bins: Bins::Adaptive } => write!(f, "binned"),
            Splits::Binned { bins: Bins::Fixed(bins) } => write!(f, "binned:{bins}"),
        }
    }
}

impl FromStr for Count {
    type Err = String;

    /// `n-1`, `n` or `log-n`.
    fn from_str(text: &str) -> Result<Count, String> {
        match text {
            "n-1" => Ok(Count::MinusOne),
            "n" => Ok(Count::All),
            "log-n" => Ok(Count::Log),
            _ => Err("expected n-1, n or log-n".into()),
        }
    }
}

impl fmt::Display for Count {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Count::MinusOne => "n-1",
            Count::All => "n",
            Count::Log => "log-n",
        })
    }
}

impl Config {
    /// The producer of a `.bvh`, at most 48 bytes for any ordinary α: `bvh-build sah sweep alpha=1`.
    pub fn producer(&self, heuristic: &str) -> String {
        format!("bvh-build {heuristic} {} alpha={}", self.splits, self.alpha)
    }

    /// The `META` section.
    pub fn meta(&self, heuristic: &str) -> Value {
        let mut meta = json!({
            "heuristic": heuristic,
            "splits": self.splits.to_string(),
            "alpha": self.alpha,
            "count": self.count.to_string(),
            "max_leaf": self.max_leaf,
        });
        if let Splits::Spatial(spatial::Options { max_duplication, overlap }) = self.splits {
            meta["max_duplication"] = max_duplication.into();
            meta["overlap"] = overlap.into();
        }
        if self.max_leaf > 1 {
            meta["c_i"] = self.c_i.into();
            meta["c_p"] = self.c_p.into();
        }
        meta
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splits_and_counts_are_read_as_they_are_shown() {
        for text in ["sweep", "spatial", "binned", "binned:2", "binned:256"] {
            assert_eq!(text.parse::<Splits>().map(|splits| splits.to_string()), Ok(text.into()));
        }
        for text in [
            "",
            "binned:",
            "binned:1",
            "binned:257",
            "binned:-3",
            "sweep:4",
            "spatial:4",
            "Sweep",
            "binned:2:3",
        ] {
            assert!(text.parse::<Splits>().is_err(), "{text}");
        }
        for text in ["n", "n-1", "log-n"] {
            assert_eq!(text.parse::<Count>().map(|count| count.to_string()), Ok(text.into()));
        }
        assert!("m".parse::<Count>().is_err());
    }

    #[test]
    fn the_producer_fits_its_field() {
        let config =
            Config { splits: Splits::Binned { bins: Bins::Fixed(256) }, alpha: 0.123, ..Config::default() };
        assert_eq!(config.producer("sah"), "bvh-build sah binned:256 alpha=0.123");
        assert!(config.producer("blend").len() <= 48);
    }
}
