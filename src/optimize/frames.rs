//! One tree for a whole animation: T-SAH (Bittner and Meister, "T-SAH: Animation Optimized Bounding Volume Hierarchies", 2015), and the
//! same with recorded rays.
//!
//! A node takes up a box in each of N frames, and its P is the mean of what each frame's own measure says of its box: areas for T-SAH, rays
//! recorded in that frame for the other form. Every optimiser of this module works on such nodes as on any other, so a tree that is
//! refitted from frame to frame costs as little as it can over all of them. What is written is the tree with the boxes of the first frame.

use super::measure::Measure;
use crate::geometry::Triangle;
use crate::geometry::padded::PaddedAabb;

/// P over N frames.
pub struct Frames<'a, M, const N: usize> {
    /// A measure for each frame.
    measures: [M; N],
    /// `TRIS` of each frame; the same faces in the same order.
    triangles: [&'a [Triangle]; N],
}

impl<'a, M, const N: usize> Frames<'a, M, N> {
    /// `triangles` are those of as many frames as there are measures, and the tree's are those of the first.
    pub fn new(measures: [M; N], triangles: [&'a [Triangle]; N]) -> Frames<'a, M, N> {
        Frames { measures, triangles }
    }
}

impl<M: Measure<Bounds = PaddedAabb>, const N: usize> Measure for Frames<'_, M, N> {
    type Bounds = [PaddedAabb; N];
    /// A list for each frame.
    type List = Vec<M::List>;

    const BATCH: usize = M::BATCH / N;

    /// Leaves hold whole triangles: parts that spatial splits cut off know nothing of other frames.
    fn leaf(&self, _bounds: PaddedAabb, primitives: &[u32]) -> [PaddedAabb; N] {
        self.triangles.map(|triangles| {
            let boxes = primitives.iter().map(|&index| triangles[index as usize].bounds().into());
            boxes.fold(PaddedAabb::EMPTY, |sum, bounds: PaddedAabb| sum.union(&bounds))
        })
    }

    fn one(bounds: &[PaddedAabb; N]) -> PaddedAabb {
        bounds[0]
    }

    fn whole(&self) -> Vec<M::List> {
        self.measures.iter().map(M::whole).collect()
    }

    fn within(&self, outer: &Vec<M::List>, bounds: &[PaddedAabb; N]) -> Vec<M::List> {
        let frames = self.measures.iter().zip(outer).zip(bounds);
        frames.map(|((measure, outer), bounds)| measure.within(outer, bounds)).collect()
    }

    fn value(&self, bounds: &[PaddedAabb; N], list: &Vec<M::List>) -> f64 {
        // A leaf's list is empty; so is that of each of its frames.
        let none = M::List::default();
        let frames = self.measures.iter().zip(bounds).enumerate();
        let values =
            frames.map(|(frame, (measure, bounds))| measure.value(bounds, list.get(frame).unwrap_or(&none)));
        values.sum::<f64>() / N as f64
    }

    fn values<const K: usize>(&self, outer: &Vec<M::List>, boxes: &[[PaddedAabb; N]; K]) -> [f64; K] {
        let mut sums = [0.0; K];
        for (frame, (measure, outer)) in self.measures.iter().zip(outer).enumerate() {
            let values = measure.values(outer, &boxes.map(|bounds| bounds[frame]));
            sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
        }
        sums.map(|sum| sum / N as f64)
    }

    fn value_below(
        &self,
        outer: &Vec<M::List>,
        bounds: &[PaddedAabb; N],
        limit: f64,
        work: &mut u64,
    ) -> Option<f64> {
        // No P is below 0, so each frame may take what the ones before it have left.
        let mut left = limit * N as f64;
        for ((measure, outer), bounds) in self.measures.iter().zip(outer).zip(bounds) {
            left -= measure.value_below(outer, bounds, left, work)?;
        }
        let value = limit - left / N as f64;
        (value < limit).then_some(value)
    }

    fn can_be_below(
        &self,
        (bounds, list): (&[PaddedAabb; N], &Vec<M::List>),
        moved: &Vec<M::List>,
        union: &[PaddedAabb; N],
        limit: f64,
        work: &mut u64,
    ) -> bool {
        let all = limit * N as f64;
        (0..N).all(|frame| {
            let node = (&bounds[frame], &list[frame]);
            self.measures[frame].can_be_below(node, &moved[frame], &union[frame], all, work)
        })
    }

    fn work(&self, list: &Vec<M::List>) -> u64 {
        self.measures.iter().zip(list).map(|(measure, list)| measure.work(list)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::super::checks::{assert_consistent, poor_tree, rays, triangles};
    use super::super::measure::{AreaMeasure, Estimate, RayMeasure};
    use super::super::working::Working;
    use super::super::{Config, Stage, insertion, reinsertion, rotations, run, treelets};
    use super::*;
    use crate::geometry::{Aabb, Vec3};
    use crate::progress::Progress;
    use crate::tree::Tree;
    use crate::tree::statistics::sah_cost;
    use crate::update::Moving;

    /// Three frames: triangles as they come, mirrored in groups, and spread out.
    fn frames() -> [Vec<Triangle>; 3] {
        let first = triangles(300, 5);
        let moved = |change: fn(usize, Vec3) -> Vec3| {
            let change =
                |(index, triangle): (usize, &Triangle)| Triangle(triangle.0.map(|v| change(index, v)));
            first.iter().enumerate().map(change).collect::<Vec<_>>()
        };
        let mirrored = moved(|index, v| if index % 2 == 0 { v } else { Vec3::new(2.0 - v.x, v.y, v.z) });
        let spread = moved(|index, v| v + Vec3::X * (index % 7) as f32);
        [first, mirrored, spread]
    }

    fn scene(triangles: &[Triangle]) -> PaddedAabb {
        triangles.iter().fold(Aabb::EMPTY, |sum, t| sum.union(&t.bounds())).into()
    }

    /// T over the frames, counted by refitting to each.
    fn mean_cost(tree: &Tree, frames: &[Vec<Triangle>; 3]) -> f64 {
        let cost = |triangles: &Vec<Triangle>| {
            let mut moving = Moving::new(tree.view()).unwrap();
            moving.refit(triangles);
            sah_cost(moving.tree().view(), 1.0, 0.0) / 2.0
        };
        frames.iter().map(cost).sum::<f64>() / 3.0
    }

    #[test]
    fn every_optimiser_lowers_the_mean_cost_over_the_frames() {
        let frames = frames();
        let measure = Frames::new(
            frames.each_ref().map(|t| AreaMeasure::new(&scene(t))),
            frames.each_ref().map(|t| &t[..]),
        );
        let stages = [
            Stage::Rotations(rotations::Config::default()),
            Stage::Insertion(insertion::Config::default()),
            Stage::Reinsertion(reinsertion::Config::default()),
            Stage::Treelets(treelets::Config::default()),
        ];
        for stage in stages {
            let mut tree = poor_tree(&frames[0]);
            let before = mean_cost(&tree, &frames);
            let config = Config { stages: vec![stage], deadline: None };
            let report = run(&mut tree, &measure, &config, &Progress::hidden()).unwrap();
            let after = mean_cost(&tree, &frames);
            // The report's T and the one counted by refitting are sums of the same areas.
            assert!((report.before / before - 1.0).abs() < 1e-4, "{} {before}", report.before);
            assert!((report.after / after - 1.0).abs() < 1e-4, "{} {after}", report.after);
            assert!(after < 0.9 * before, "{}: {after} {before}", stage.name());
        }
    }

    #[test]
    fn one_tree_for_all_frames_costs_less_over_them_than_one_made_for_the_first() {
        let frames = frames();
        let config = Config::default();
        let [mut first, mut all] = [poor_tree(&frames[0]), poor_tree(&frames[0])];
        run(&mut first, &AreaMeasure::new(&scene(&frames[0])), &config, &Progress::hidden()).unwrap();
        let measure = Frames::new(
            frames.each_ref().map(|t| AreaMeasure::new(&scene(t))),
            frames.each_ref().map(|t| &t[..]),
        );
        run(&mut all, &measure, &config, &Progress::hidden()).unwrap();
        let [first, all] = [first, all].map(|tree| mean_cost(&tree, &frames));
        assert!(all < 0.9 * first, "{all} {first}");
    }

    #[test]
    fn lists_and_values_hold_after_moves_with_rays_of_each_frame() {
        let frames = frames();
        let rays = [1, 2, 3].map(|seed| rays(200, seed));
        let mut number = 0;
        let measures = frames.each_ref().map(|triangles| {
            number += 1;
            RayMeasure::new(&rays[number - 1], Estimate::Blend { weight: 0.5 }, &scene(triangles))
        });
        let measure = Frames::new(measures, frames.each_ref().map(|t| &t[..]));
        let tree = poor_tree(&frames[0]);
        let mut working = Working::new(&tree, &measure);
        let before = working.cost();
        reinsertion::reinsert(&mut working, &reinsertion::Config::default());
        assert_consistent(&working);
        assert!(working.cost() < 0.95 * before);
    }
}
