//! Where work goes in the scene, not in the tree: per triangle, and per pixel of the recorded image.
//!
//! Testing a triangle is its own cost. A node's boxes are tested for the sake of all that is below, so what is spent at a node is laid out
//! evenly over the places below it. So the costs of all triangles add up to Γ of all queries, and two trees over the same triangles can be
//! compared triangle by triangle, however different they are ([`super::versus`]).

use super::queries::{Asked, Sampled, Source};
use super::shares::Shares;
use super::walk::Walk;
use crate::format::FormatError;
use crate::progress::Progress;
use crate::replay::pixels::{ImageSize, Pixels};
use crate::traverse::{Counts, Scratch};

/// Γ of each triangle: its own tests, and its part of the box tests above it. A triangle in several leaves has a part in each.
pub fn per_triangle(walk: &Walk, shares: &Shares) -> Vec<f64> {
    let (nodes, places) = (walk.tree().nodes, walk.places());
    // What each place below a node has to bear of the boxes tested at it and above.
    let mut burdens = vec![0.0; nodes.len()];
    let tests = shares.counted.triangles.iter().map(|triangle| triangle.tests);
    let mut costs: Vec<f64> = tests.map(|tests| shares.costs.c_p * f64::from(tests)).collect();
    for (index, node) in nodes.iter().enumerate() {
        let below = places.below(index);
        let boxes = Counts { primitive_tests: 0, ..shares.own(walk, index as u32) };
        let burden = burdens[index] + shares.costs.gamma(&boxes) / below.len().max(1) as f64;
        if node.is_leaf() {
            below.for_each(|place| costs[places.triangles()[place] as usize] += burden);
        } else {
            burdens[node.range()].fill(burden);
        }
    }
    costs
}

/// Tests per pixel of the image that was traced.
///
/// # Errors
/// When a chunk is damaged.
pub fn per_pixel(
    asked: &Asked,
    source: &Source,
    size: ImageSize,
    progress: &Progress,
) -> Result<(Pixels, Sampled), FormatError> {
    let pixels = Pixels::new(size);
    let (_, sampled) = source.gather(progress, Scratch::default, |scratch, query| {
        let mut counts = Counts::default();
        asked.ask(query, &mut counts, scratch);
        pixels.add(query.record.path, &counts);
    })?;
    Ok((pixels, sampled))
}
