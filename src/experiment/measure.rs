//! What a tree costs on rays, counted twice: by a RayOrder traversal, and by overlapping boxes.

use crate::builder::reference::References;
use crate::builder::{BuildError, Config, build_with};
use crate::geometry::{Ray, Triangle};
use crate::optimize::measure::{AreaMeasure, Estimate, RayMeasure};
use crate::optimize::{self, OptimizeError};
use crate::probability::area::Area;
use crate::probability::rays::{Measure, RaySet, Rays};
use crate::progress::Progress;
use crate::traverse::{All, Counts, Overlap, Prepared, PreparedRay, Scratch, Traversal};
use crate::tree::Tree;
use thiserror::Error;

/// What rays cost on a tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cost {
    pub rays: u64,
    /// *BVH cost* of the paper's figures: box tests of a RayOrder traversal.
    pub box_tests: u64,
    /// Σ P_R(b) over inner nodes b.
    pub t_r: u64,
}

/// The two counts contradict each other: a defect of this program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "{box_tests} box tests were counted, but {rays} rays + 2 × T_R of {t_r} are expected: please report this"
)]
pub struct IdentityError {
    rays: u64,
    box_tests: u64,
    t_r: u64,
}

/// Ends each ray at its closest hit.
pub fn end_at_hits(tree: &Tree, triangles: &[Triangle], rays: &[Ray]) -> Vec<Ray> {
    let prepared = Prepared::new(tree.view(), triangles, &[]);
    let mut scratch = Scratch::default();
    let mut end = |ray: &Ray| {
        let hit = prepared.closest_hit(Traversal::Odf, &PreparedRay::new(ray), &All, &mut (), &mut scratch);
        Ray { tfar: hit.map_or(ray.tfar, |hit| hit.t), ..*ray }
    };
    rays.iter().map(&mut end).collect()
}

/// The cost of closest-hit queries `rays`, whose effective segments are `segments`, on a binary tree.
///
/// # Errors
/// When box tests are not rays + 2 T_R.
pub fn cost(
    tree: &Tree,
    triangles: &[Triangle],
    rays: &[Ray],
    segments: &[Ray],
) -> Result<Cost, IdentityError> {
    let prepared = Prepared::new(tree.view(), triangles, &[]);
    let (mut scratch, mut counts, mut overlap) = (Scratch::default(), Counts::default(), Overlap::default());
    for (ray, segment) in rays.iter().zip(segments) {
        let ray = PreparedRay::new(ray);
        prepared.closest_hit(Traversal::RayOrder, &ray, &All, &mut counts, &mut scratch);
        prepared.overlap(&ray, segment.tfar, &mut overlap, &mut scratch);
    }
    let cost = Cost { rays: rays.len() as u64, box_tests: counts.box_tests, t_r: overlap.inner };
    if cost.box_tests != cost.rays + 2 * cost.t_r {
        let Cost { rays, box_tests, t_r } = cost;
        return Err(IdentityError { rays, box_tests, t_r });
    }
    Ok(cost)
}

/// A SAH tree.
///
/// # Errors
/// See [`build_with`].
pub fn area_tree(triangles: &[Triangle], config: &Config) -> Result<Tree, BuildError> {
    let references = References::of(triangles);
    let area = Area::of_scene(&references.bounds);
    build_with(references, &area, config, &Progress::hidden())
}

/// A tree from rays.
///
/// # Errors
/// See [`build_with`].
pub fn ray_tree(
    triangles: &[Triangle],
    set: &RaySet,
    measure: impl Measure,
    config: &Config,
) -> Result<Tree, BuildError> {
    let references = References::of(triangles);
    let rays = Rays::new(set, &references.bounds, measure);
    build_with(references, &rays, config, &Progress::hidden())
}

/// Optimises a tree by area, with the default stages: the control of every claim about rays.
///
/// # Errors
/// See [`optimize::run`].
pub fn optimize_by_area(tree: &mut Tree, triangles: &[Triangle]) -> Result<(), OptimizeError> {
    let measure = AreaMeasure::new(&References::of(triangles).bounds);
    optimize::run(tree, &measure, &optimize::Config::default(), &Progress::hidden()).map(drop)
}

/// Optimises a tree by effective segments.
///
/// # Errors
/// See [`optimize::run`].
pub fn optimize_by_rays(
    tree: &mut Tree,
    triangles: &[Triangle],
    segments: &[Ray],
    estimate: Estimate,
    config: &optimize::Config,
) -> Result<(), OptimizeError> {
    let measure = RayMeasure::new(segments, estimate, &References::of(triangles).bounds);
    optimize::run(tree, &measure, config, &Progress::hidden()).map(drop)
}
