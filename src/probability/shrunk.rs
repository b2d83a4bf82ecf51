//! Counts shrunk towards area: what to make of a box that few rays were to be expected on.
//!
//! R rays overlap a node. If they were spread as area says, a box with the share x of its surface would expect m = R x of
//! them, and k came. How much is k to be believed? Think of the rate at which rays meet the box as Gamma distributed
//! around m with a relative variance of 1/s: the mean of what is then known about it is m (k + s)/(m + s) (the mean of
//! the posterior of a Poisson process). Where m is large, the count decides; where it is small, the area. Unlike
//! [`super::blend::Blend`], there is no weight to be tuned for a scene and a number of rays.

use super::rays::Measure;
use thiserror::Error;

/// P = x (k + s)/(R x + s).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shrunk {
    strength: f32,
}

/// A strength that is not a positive number.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("strength is {0}: it must be a finite number above 0")]
pub struct StrengthError(pub f64);

impl Shrunk {
    /// `strength` is s: as many rays as area is worth.
    ///
    /// # Errors
    /// When it is not a finite number above 0, also as `f32`.
    pub fn new(strength: f64) -> Result<Shrunk, StrengthError> {
        let given = strength as f32;
        if given.is_finite() && given > 0.0 {
            Ok(Shrunk { strength: given })
        } else {
            Err(StrengthError(strength))
        }
    }
}

impl Measure for Shrunk {
    /// R.
    type Terms = f32;

    fn terms(&self, rays: usize) -> f32 {
        rays as f32
    }

    #[inline(always)]
    fn value(&self, node_rays: &f32, rays: f32, area: f32) -> f32 {
        area * (rays + self.strength) / (node_rays * area + self.strength)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn area_decides_without_rays_and_counts_with_many() {
        let shrunk = Shrunk::new(1.0).unwrap();
        assert_eq!(shrunk.value(&shrunk.terms(0), 0.0, 0.25), 0.25);
        let terms = shrunk.terms(1_000_000);
        assert!((shrunk.value(&terms, 400_000.0, 0.5) - 0.4).abs() < 1e-4);
        // The node itself is certain, and P grows with both.
        assert_eq!(shrunk.value(&terms, 1e6, 1.0), 1.0);
        let terms = shrunk.terms(10);
        let p = |rays, area| shrunk.value(&terms, rays, area);
        assert!(p(3.0, 0.1) < p(4.0, 0.1) && p(3.0, 0.1) < p(3.0, 0.2));
    }

    #[test]
    fn strengths_out_of_range_are_refused_in_one_line() {
        for strength in [0.0, -1.0, 1e-60, f64::NAN, f64::INFINITY] {
            let error = Shrunk::new(strength).unwrap_err().to_string();
            assert!(error.contains("above 0") && !error.contains('\n'), "{error}");
        }
    }
}
