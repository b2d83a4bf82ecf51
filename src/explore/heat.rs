//! Where work goes in the scene, not in the tree: per triangle, and per pixel of the recorded image.
//!
//! A node is visited for the sake of all that is below, and a leaf's triangles are tested together,
//! so what is spent at a node is laid out evenly over the places below it. So the costs of all
//! triangles add up to that of all queries, and two trees over the same triangles can be compared
//! triangle by triangle, however different they are ([`super::versus`]).

use super::queries::{Asked, Sampled, Source};
use super::shares::Shares;
use super::walk::Walk;
use crate::format::FormatError;
use crate::progress::Progress;
use crate::replay::pixels::{ImageSize, Pixels};
use crate::replay::tally::Costs;
use crate::traverse::{Counts, Scratch};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Nanoseconds of each triangle: its part of what all queries spend at its leaf and above. A
/// triangle in several leaves has a part in each.
pub fn per_triangle(walk: &Walk, shares: &Shares) -> Vec<f64> {
    let (nodes, places) = (walk.tree().nodes, walk.places());
    // What each place below a node has to bear of what is spent at it and above.
    let mut burdens = vec![0.0; nodes.len()];
    let mut costs = vec![0.0; places.triangle_count()];
    for (index, node) in nodes.iter().enumerate() {
        let below = places.below(index);
        let burden = burdens[index] + shares.own_cost(walk, index as u32) / below.len().max(1) as f64;
        if node.is_leaf() {
            below.for_each(|place| costs[places.triangles()[place] as usize] += burden);
        } else {
            burdens[node.range()].fill(burden);
        }
    }
    costs
}

/// What the queries of each pixel of the image that was traced take, row by row.
#[derive(Clone, Debug)]
pub struct PixelWork {
    pub size: ImageSize,
    /// In nanoseconds.
    pub costs: Vec<f64>,
    /// Γ.
    pub gammas: Vec<f64>,
    pub sampled: Sampled,
}

/// Parts of a nanosecond in which pixels are summed: integers, so that threads change nothing.
const PARTS: f64 = 1024.0;

/// Asks the queries of `source`, and sums what they take by pixel; `costs` are those of Γ.
///
/// # Errors
/// When a chunk is damaged.
pub fn per_pixel(
    asked: &Asked,
    source: &Source,
    size: ImageSize,
    costs: &Costs,
    progress: &Progress,
) -> Result<PixelWork, FormatError> {
    let pixels = Pixels::new(size);
    let pixel_count = size.width as usize * size.height as usize;
    let parts: Vec<AtomicU64> = (0..pixel_count).map(|_| AtomicU64::new(0)).collect();
    let (_, sampled) = source.gather(progress, Scratch::default, |scratch, query| {
        let mut counts = Counts::default();
        asked.ask(query, &mut counts, scratch);
        pixels.add(query.record.path, &counts);
        if let Some(sum) = parts.get(query.record.path as usize) {
            let cost = asked.price.cost(query.record.is_occlusion(), 1, counts);
            sum.fetch_add((PARTS * cost).round() as u64, Relaxed);
        }
    })?;
    let nanoseconds = parts.into_iter().map(|sum| sum.into_inner() as f64 / PARTS);
    Ok(PixelWork { size, costs: nanoseconds.collect(), gammas: pixels.costs(costs), sampled })
}
