//! Rays and area blended: P = w · (rays on the child / rays on the node) + (1 - w) · (area of the child / area of the
//! node). With no ray on the node, the ray share counts as 1 (paper, section 5.3).

use super::rays::Measure;
use thiserror::Error;

/// The weight of the ray share: 0 is the surface area heuristic, 1 full ray information.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blend {
    weight: f32,
}

/// A weight that is not from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("weight is {0}: it must be a number from 0 (area) to 1 (rays)")]
pub struct WeightError(pub f64);

impl Blend {
    /// # Errors
    /// When `weight` is not from 0 to 1.
    pub fn new(weight: f64) -> Result<Blend, WeightError> {
        if (0.0..=1.0).contains(&weight) {
            Ok(Blend { weight: weight as f32 })
        } else {
            Err(WeightError(weight))
        }
    }
}

/// P = `per_ray` · rays + `constant` + `per_area` · area of the box / area of the node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Terms {
    per_ray: f32,
    constant: f32,
    per_area: f32,
}

impl Measure for Blend {
    type Terms = Terms;

    fn terms(&self, rays: usize) -> Terms {
        let per_area = 1.0 - self.weight;
        match rays {
            0 => Terms { per_ray: 0.0, constant: self.weight, per_area },
            _ => Terms { per_ray: self.weight / rays as f32, constant: 0.0, per_area },
        }
    }

    #[inline(always)]
    fn value(&self, terms: &Terms, rays: f32, area: f32) -> f32 {
        terms.per_ray * rays + (terms.constant + terms.per_area * area)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_out_of_range_are_refused_in_one_line() {
        for weight in [-0.1, 1.0001, f64::NAN, f64::INFINITY] {
            let error = Blend::new(weight).unwrap_err().to_string();
            assert!(error.contains("from 0 (area) to 1 (rays)") && !error.contains('\n'), "{error}");
        }
    }

    #[test]
    fn terms_are_the_formulas() {
        let blend = Blend::new(0.25).unwrap();
        assert_eq!(blend.terms(10), Terms { per_ray: 0.025, constant: 0.0, per_area: 0.75 });
        assert_eq!(blend.terms(0), Terms { per_ray: 0.0, constant: 0.25, per_area: 0.75 });
    }
}
