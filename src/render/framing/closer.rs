//! A view of a part, where a whole scene is too small or too scattered in its own bounds to be
//! seen: a long row, groups far apart, a needle.
//!
//! The bounds are halved, and the half with more area is kept, until a view of what is left shows
//! something. A triangle that is left alone is approached.

use super::{Framing, LEAST_COVERED, Sight};
use crate::geometry::{Aabb, Triangle, Vec3};
use crate::render::camera::View;

/// How often bounds are halved: one of a billion triangles is found, and approached.
const HALVINGS: usize = 48;
/// More triangles than this are represented by every so many-th.
const SAMPLES: usize = 1 << 16;

impl<Q: Sight> Framing<'_, Q> {
    /// A view that shows at least [`LEAST_COVERED`], or the one that shows most: `best` is the
    /// share that hits in the view of all, and that view.
    pub(super) fn closer(&mut self, best: (f32, View), fov_degrees: f32, aspect: f32) -> View {
        let step = self.triangles.len().div_ceil(SAMPLES).max(1);
        let has_area = |triangle: &&Triangle| triangle.has_area();
        let mut left: Vec<Triangle> = self.triangles.iter().step_by(step).filter(has_area).copied().collect();
        let (mut best, mut bounds) = (best, self.bounds);
        for _ in 0..HALVINGS {
            match left[..] {
                [] => break,
                [alone] => bounds = around(alone.centroid(), 0.5 * bounds.extent()),
                _ => {
                    left = heavier_half(left);
                    let all = left.iter().fold(Aabb::EMPTY, |all, t| all.union(&t.bounds()));
                    bounds = bounds.intersection(&all);
                }
            }
            let (covered, view) = self.around(&bounds, fov_degrees, aspect);
            if covered > best.0 {
                best = (covered, view);
            }
            if covered >= LEAST_COVERED {
                break;
            }
        }
        best.1
    }
}

fn around(centre: Vec3, extent: Vec3) -> Aabb {
    Aabb { lower: centre - 0.5 * extent, upper: centre + 0.5 * extent }
}

/// Of several triangles, parted at the widest gap between centroids along the longest axis, or in
/// the middle where there is none, the half with more area.
fn heavier_half(mut triangles: Vec<Triangle>) -> Vec<Triangle> {
    let point = |bounds: Aabb, triangle: &Triangle| bounds.grown(triangle.centroid());
    let extent = triangles.iter().fold(Aabb::EMPTY, point).extent();
    let axis = extent.max_position();
    triangles.sort_by(|a, b| a.centroid()[axis].total_cmp(&b.centroid()[axis]));
    let gap = |place: &usize| triangles[*place].centroid()[axis] - triangles[place - 1].centroid()[axis];
    let widest = (1..triangles.len()).max_by(|a, b| gap(a).total_cmp(&gap(b))).unwrap_or(1);
    let middle = triangles.len() / 2;
    let place = if gap(&widest) > 0.1 * extent[axis] { widest } else { middle };
    let upper = triangles.split_off(place);
    let sum = |part: &[Triangle]| part.iter().map(Triangle::double_area).sum::<f64>();
    if sum(&upper) > sum(&triangles) { upper } else { triangles }
}
