//! The rays on a node, as one rank has them: its own, and where they stand among those of all ranks.
//!
//! All ranks' lists, one after another, are the list that one process would have: in every node, because dividing a list keeps its
//! order. So each rank knows which of its rays are in an even part of all, and sums of counts are the counts of one process.
//!
//! A node that few rays are on is not worth a message for each question: all ranks get its rays, and answer alone, the same.

use super::segment::Packed;
use crate::ranks::{Ranks, even_part};
use std::sync::Arc;

/// Of no more rays than this, on all ranks together, each rank gets all.
pub const GATHERED: usize = 1 << 14;

/// The rays on a node.
#[derive(Debug)]
pub struct Listed {
    /// Numbers of segments, of this rank's set or of `gathered`.
    pub own: Vec<u32>,
    /// Rays of the ranks before this one.
    before: usize,
    all: usize,
    /// Whether other ranks have other rays.
    pub is_shared: bool,
    gathered: Option<Arc<[Packed]>>,
}

impl Listed {
    /// Of one process: its rays are all.
    pub fn alone(own: Vec<u32>) -> Listed {
        Listed { all: own.len(), own, before: 0, is_shared: false, gathered: None }
    }

    /// Those of the children of this node: the rays of each that this rank found, or every rank, where all had the same list.
    pub fn children<const N: usize>(
        &self,
        found: [Vec<u32>; N],
        set: &[Packed],
        ranks: &dyn Ranks,
    ) -> [Listed; N] {
        match &self.gathered {
            Some(segments) => {
                found.map(|own| Listed { gathered: Some(segments.clone()), ..Listed::alone(own) })
            }
            None => Listed::share(found, set, ranks),
        }
    }

    /// Lists that each rank has found its part of.
    pub fn share<const N: usize>(found: [Vec<u32>; N], set: &[Packed], ranks: &dyn Ranks) -> [Listed; N] {
        if ranks.count() == 1 {
            return found.map(Listed::alone);
        }
        let lengths = found.each_ref().map(|own| own.len() as u64);
        let lengths: Vec<Vec<u64>> = ranks
            .exchange(bytemuck::cast_slice(&lengths))
            .iter()
            .map(|of| bytemuck::pod_collect_to_vec(of))
            .collect();
        let sums = |ranks: &[Vec<u64>]| -> [usize; N] {
            std::array::from_fn(|list| ranks.iter().map(|lengths| lengths[list] as usize).sum())
        };
        let (before, all) = (sums(&lengths[..ranks.rank()]), sums(&lengths));
        let is_gathered = all.map(|all| (1..=GATHERED).contains(&all));
        let mut gathered: [Vec<Packed>; N] = std::array::from_fn(|_| Vec::new());
        if is_gathered.contains(&true) {
            let mut own: Vec<Packed> = Vec::new();
            for (list, _) in found.iter().zip(is_gathered).filter(|(_, is_gathered)| *is_gathered) {
                own.extend(list.iter().map(|&ray| set[ray as usize]));
            }
            for (message, lengths) in ranks.exchange(bytemuck::cast_slice(&own)).iter().zip(&lengths) {
                let segments: Vec<Packed> = bytemuck::pod_collect_to_vec(message);
                let mut rest = &segments[..];
                for (list, &length) in lengths.iter().enumerate().filter(|(list, _)| is_gathered[*list]) {
                    let (these, others) = rest.split_at(length as usize);
                    gathered[list].extend_from_slice(these);
                    rest = others;
                }
            }
        }
        let mut list = 0;
        found.map(|own| {
            let number = list;
            list += 1;
            if all[number] == 0 {
                Listed::alone(own)
            } else if is_gathered[number] {
                let segments = std::mem::take(&mut gathered[number]);
                let own = (0..segments.len() as u32).collect();
                Listed { gathered: Some(segments.into()), ..Listed::alone(own) }
            } else {
                Listed { own, before: before[number], all: all[number], is_shared: true, gathered: None }
            }
        })
    }

    /// Rays of all ranks.
    pub fn all(&self) -> usize {
        self.all
    }

    /// What the numbers mean, where `set` is this rank's.
    pub fn segments<'a>(&'a self, set: &'a [Packed]) -> &'a [Packed] {
        self.gathered.as_deref().unwrap_or(set)
    }

    /// This rank's rays of an even part, of `most` rays, of all.
    pub fn even_part(&self, most: usize) -> Vec<u32> {
        even_part(&self.own, self.before, self.all, most)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Count, Measure, RaySet, Rays};
    use crate::builder::reference::References;
    use crate::builder::{Config, Splits, build_with, spatial};
    use crate::geometry::{Ray, Triangle, Vec3};
    use crate::probability::blend::Blend;
    use crate::progress::Progress;
    use crate::random::Random;
    use crate::ranks::crew::on_ranks;
    use crate::tree::Tree;

    fn triangles(count: usize) -> Vec<Triangle> {
        let mut random = Random::new(3);
        let mut point = |size: f32| Vec3::new(random.unit(), random.unit(), random.unit()) * size;
        (0..count)
            .map(|_| {
                let at = point(10.0);
                Triangle([at, at + point(0.5), at + point(0.5)])
            })
            .collect()
    }

    fn rays(count: usize) -> Vec<Ray> {
        let mut random = Random::new(4);
        let mut point = || Vec3::new(random.unit(), random.unit(), random.unit());
        let ray =
            |_| Ray { origin: point() * 10.0, direction: point() - 0.5, tnear: 0.0, tfar: point().x * 20.0 };
        (0..count).map(ray).collect()
    }

    /// The tree of every rank, where each has the rays between two of `cuts`.
    fn trees<M: Measure + Copy>(
        triangles: &[Triangle],
        rays: &[Ray],
        cuts: &[usize],
        measure: M,
        config: &Config,
    ) -> Vec<Tree> {
        on_ranks(cuts.len() - 1, |ranks| {
            let own = &rays[cuts[ranks.rank()]..cuts[ranks.rank() + 1]];
            let set = RaySet::of_rays(own.iter().copied());
            let references = References::of(triangles);
            let probability = Rays::shared(&set, &references.bounds, measure, ranks);
            build_with(references, &probability, config, &Progress::hidden()).unwrap()
        })
    }

    /// Long lists that are summed up, an even part of which is counted, and short ones that all ranks get.
    #[test]
    fn every_rank_builds_the_tree_of_one_process() {
        let (triangles, rays) = (triangles(700), rays(60_000));
        let most = rays.len();
        for splits in [Config::default().splits, Splits::Sweep, Splits::Spatial(spatial::Options::default())]
        {
            let config = Config { max_leaf: 4, ..Config::of(splits) };
            for plain in [true, false] {
                let built = |cuts: &[usize]| {
                    if plain {
                        trees(&triangles, &rays, cuts, Count::PLAIN, &config)
                    } else {
                        trees(&triangles, &rays, cuts, Blend::new(0.9).unwrap(), &config)
                    }
                };
                let one = built(&[0, most]).remove(0);
                assert!(one.nodes.len() > 300);
                for cuts in [&[0, 25_000, most][..], &[0, 0, 1, 59_999, most], &[0, 0, most, most]] {
                    for tree in built(cuts) {
                        assert!(tree == one, "{splits:?} {cuts:?}");
                    }
                }
            }
        }
    }
}
