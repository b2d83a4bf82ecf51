//! Splits of space: a triangle that crosses a plane may go to both sides, each time with a smaller box (Stich, Friedrich and
//! Dietrich, "Spatial Splits in Bounding Volume Hierarchies", 2009).
//!
//! A node's references are first binned as in [`super::binned`]. Where the children of the best such split overlap by enough, planes
//! across the node's box are tried too (`bins`); the cheaper kind of split is taken. A reference that a chosen
//! plane crosses is cut by [`super::clip`], or put on one side as a whole where that is cheaper.
//!
//! # Room
//! Every node owns more places than it has references. A split of space takes places for its duplicates, and what is
//! left is divided in proportion to references times area of both sides: that much is at stake in each. So subtrees know
//! nothing of each other, and the tree is the same for any number of threads.

mod bins;

use super::binned::{
    BLOCK, BinnedReferences, Grid as ObjectGrid, PARALLEL, Plane as ObjectPlane, centroid_bounds,
    divide_block, divide_blocks,
};
use super::clip::fragments;
use super::cost::Weight;
use super::recursion::{NodeReferences, Split};
use super::reference::{Reference, centroid};
use super::{Bins, BuildError, MAX_TRIANGLES};
use crate::geometry::padded::PaddedAabb;
use crate::geometry::{Aabb, Triangle};
use crate::probability::area::Area;
use crate::probability::{Probability, Side};
use bins::{Candidate, Grid, Histogram};
use rayon::prelude::*;

/// How freely triangles are cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Most references that may be added, as a share of the triangles. 0 to 15.
    pub max_duplication: f64,
    /// Splits of space are tried where the children of the best other split overlap in a box of more than this share of the
    /// root's area (Stich's alpha).
    pub overlap: f64,
}

impl Default for Options {
    fn default() -> Options {
        Options { max_duplication: 1.0, overlap: 1e-5 }
    }
}

impl Options {
    pub(super) fn check(&self) -> Result<(), BuildError> {
        if !(0.0..=15.0).contains(&self.max_duplication) {
            return Err(BuildError::Duplication(self.max_duplication));
        }
        if !(self.overlap.is_finite() && self.overlap >= 0.0) {
            return Err(BuildError::Overlap(self.overlap));
        }
        Ok(())
    }

    /// Most references that a tree over `primitives` can have.
    pub fn capacity(&self, primitives: usize) -> usize {
        let room = (primitives as f64 * self.max_duplication) as usize;
        (primitives + room).min(primitives.max(MAX_TRIANGLES))
    }
}

/// What all nodes share.
pub struct Scene<'a> {
    triangles: &'a [Triangle],
    area: Area,
    half_unit: f32,
    /// Overlaps of less area are left alone.
    least_overlap: f32,
}

impl<'a> Scene<'a> {
    pub fn new(
        triangles: &'a [Triangle],
        bounds: &PaddedAabb,
        half_unit: f32,
        options: &Options,
    ) -> Scene<'a> {
        let area = Area::of_scene(bounds);
        let least_overlap = (f64::from(area.of(bounds)) * options.overlap) as f32;
        Scene { triangles, area, half_unit, least_overlap }
    }
}

/// The references of a node: the first of its places in `list`.
pub struct SpatialReferences<'a> {
    list: &'a mut [Reference],
    count: usize,
    /// As many places, for when they are divided.
    spare: &'a mut [Reference],
    bounds: PaddedAabb,
    centroids: PaddedAabb,
    scene: &'a Scene<'a>,
}

/// How a node is divided.
#[derive(Clone, Copy, Debug)]
pub enum Plane {
    /// No triangle is cut.
    Object(ObjectPlane),
    Space(Candidate),
}

/// Nodes with fewer references are not worth cutting: what one more inner node costs is not won back.
const LEAST_REFERENCES: usize = 4;

/// Overlaps of less than this share of the node's own area are left alone too: most would be tried in vain.
const LEAST_SHARE: f32 = 0.15;

impl<'a> SpatialReferences<'a> {
    /// The first `count` places of `list` hold references, within `bounds`; `spare` has the length of `list`.
    pub fn new(
        list: &'a mut [Reference],
        count: usize,
        spare: &'a mut [Reference],
        bounds: PaddedAabb,
        scene: &'a Scene<'a>,
    ) -> SpatialReferences<'a> {
        let centroids = list[..count]
            .par_chunks(BLOCK)
            .map(|block| centroid_bounds(block, scene.half_unit))
            .reduce(|| PaddedAabb::EMPTY, |a, b| a.union(&b));
        SpatialReferences { list, count, spare, bounds, centroids, scene }
    }

    fn room(&self) -> usize {
        self.list.len() - self.count
    }

    /// The same references for the algorithm that cuts none.
    fn as_binned(&mut self) -> BinnedReferences<'_> {
        BinnedReferences {
            list: &mut self.list[..self.count],
            spare: &mut self.spare[..self.count],
            centroids: self.centroids,
            half_unit: self.scene.half_unit,
            bins: Bins::Adaptive,
        }
    }

    /// The cheapest plane that cuts triangles.
    fn best_in_space<const N: usize, P: Probability, W: Weight>(
        &self,
        probability: &P,
        state: &P::State,
        weight: &W,
    ) -> Option<Candidate> {
        let grid = Grid::new(&self.bounds, N);
        let references = &self.list[..self.count];
        let binned = |references: &[Reference]| {
            let mut histogram = Histogram::<N>::empty();
            histogram.add_all(references, self.scene.triangles, &grid);
            histogram
        };
        let histogram = if self.count < PARALLEL {
            binned(references)
        } else {
            references.par_chunks(BLOCK).map(binned).reduce(Histogram::empty, |mut a, b| {
                a.merge(&b);
                a
            })
        };
        histogram.best([self.count, self.room()], &grid, probability, state, weight)
    }

    /// How many places the left side gets.
    fn places(&self, split: &Split<Plane>) -> usize {
        let room = self.list.len() - split.left.primitives - split.right.primitives;
        // What has too few references to be cut has no use for room.
        let stake = |side: &Side| {
            let count = (side.primitives + 1).saturating_sub(LEAST_REFERENCES) as f64;
            count * f64::from(self.scene.area.of(&side.bounds))
        };
        let (left, right) = (stake(&split.left), stake(&split.right));
        let share = if left + right > 0.0 { (left / (left + right)).clamp(0.0, 1.0) } else { 0.5 };
        split.left.primitives + (room as f64 * share) as usize
    }

    /// Both sides after their references were moved to the spare places, the right ones from place `middle`.
    fn moved(self, middle: usize, [left, right]: [Part; 2]) -> (Self, Self) {
        let (list, spare, scene) = (self.list, self.spare, self.scene);
        let (left_list, right_list) = spare.split_at_mut(middle);
        let (left_spare, right_spare) = list.split_at_mut(middle);
        let child = |list, spare, Part { count, bounds, centroids }| SpatialReferences {
            list,
            count,
            spare,
            bounds,
            centroids,
            scene,
        };
        (child(left_list, left_spare, left), child(right_list, right_spare, right))
    }

    fn divide_objects(self, split: &Split<Plane>, plane: ObjectPlane) -> (Self, Self) {
        let [left, right] = [&split.left, &split.right];
        let middle = self.places(split);
        let part = |side: &Side, centroids| Part { count: side.primitives, bounds: side.bounds, centroids };
        let references = &self.list[..self.count];
        let (left_out, right_out) = self.spare.split_at_mut(middle);
        let centroids = match plane {
            ObjectPlane::Bin { axis, bin } => {
                let grid =
                    ObjectGrid::new(&self.centroids, Bins::Adaptive.of(self.count), self.scene.half_unit);
                if self.count < PARALLEL {
                    divide_block(
                        references,
                        &grid,
                        axis,
                        bin,
                        |reference, goes_right, before_left, before_right| {
                            *if goes_right {
                                &mut right_out[before_right]
                            } else {
                                &mut left_out[before_left]
                            } = *reference;
                        },
                    )
                } else {
                    let (left_out, right_out) =
                        (&mut left_out[..left.primitives], &mut right_out[..right.primitives]);
                    divide_blocks(references, left_out, right_out, &grid, axis, bin)
                }
            }
            ObjectPlane::Middle => {
                let (left_in, right_in) = references.split_at(left.primitives);
                left_out[..left_in.len()].copy_from_slice(left_in);
                right_out[..right_in.len()].copy_from_slice(right_in);
                [left_in, right_in].map(|part| centroid_bounds(part, self.scene.half_unit))
            }
        };
        let parts = [part(left, centroids[0]), part(right, centroids[1])];
        self.moved(middle, parts)
    }

    fn divide_space(mut self, split: &Split<Plane>, plane: &Candidate) -> (Self, Self) {
        let middle = self.places(split);
        let Some(parts) = self.cut(plane, middle) else {
            // No reference would be left on one side.
            let split = self.halves();
            return self.divide(&split);
        };
        self.moved(middle, parts)
    }

    /// Moves references to the spare places, the right ones from place `middle`. None when a side would get none.
    fn cut(&mut self, plane: &Candidate, middle: usize) -> Option<[Part; 2]> {
        let &Candidate { axis, bin, counts, bounds, .. } = plane;
        let scene = self.scene;
        let grid = Grid::new(&self.bounds, bins_of(self.count));
        let references = &self.list[..self.count];
        let (left_out, right_out) = self.spare.split_at_mut(middle);
        let mut sides = [Filled::new(left_out, scene), Filled::new(right_out, scene)];
        let mut crossing = Vec::with_capacity(counts[0] + counts[1] - references.len());
        for reference in references {
            let (first, last) = grid.span(&reference.bounds());
            if last[axis] < bin {
                sides[0].push(*reference);
            } else if first[axis] >= bin {
                sides[1].push(*reference);
            } else {
                crossing.push(*reference);
            }
        }
        // Now each is where it is cheapest, the boxes of the sides being what they have become.
        let [mut left_count, mut right_count] = counts;
        let [mut left_bounds, mut right_bounds] = bounds;
        let at = grid.plane(axis, bin);
        for reference in crossing {
            let bounds = reference.bounds();
            let (left_with, right_with) = (left_bounds.union(&bounds), right_bounds.union(&bounds));
            let [left_area, right_area, left_grown, right_grown] =
                [&left_bounds, &right_bounds, &left_with, &right_with].map(|bounds| scene.area.of(bounds));
            let [left_number, right_number] = [left_count as f32 - 1.0, right_count as f32 - 1.0];
            let both = left_area * left_number + right_area * right_number;
            let left_only = left_grown * left_number + right_area * (right_number - 1.0);
            let right_only = left_area * (left_number - 1.0) + right_grown * right_number;
            if right_count > 1 && left_only <= both && left_only <= right_only {
                sides[0].push(reference);
                left_bounds = left_with;
                right_count -= 1;
            } else if left_count > 1 && right_only <= both {
                sides[1].push(reference);
                right_bounds = right_with;
                left_count -= 1;
            } else {
                let triangle = reference.triangle();
                let parts = fragments(&scene.triangles[triangle as usize], &bounds, axis, at);
                match parts.map(|part| part.is_empty()) {
                    [false, false] => {
                        sides[0].push(Reference::new(parts[0], triangle));
                        sides[1].push(Reference::new(parts[1], triangle));
                    }
                    [true, false] => {
                        sides[1].push(Reference::new(parts[1], triangle));
                        left_count -= 1;
                    }
                    [false, true] => {
                        sides[0].push(Reference::new(parts[0], triangle));
                        right_count -= 1;
                    }
                    // Cannot be, but a reference is never lost.
                    [true, true] => sides[0].push(reference),
                }
            }
        }
        let parts = sides.map(|side| side.part);
        parts.iter().all(|part| part.count > 0).then_some(parts)
    }
}

/// References that one side got.
#[derive(Clone, Copy)]
struct Part {
    count: usize,
    bounds: PaddedAabb,
    centroids: PaddedAabb,
}

/// Places that fill with references.
struct Filled<'a> {
    places: &'a mut [Reference],
    part: Part,
    half_unit: f32,
}

impl<'a> Filled<'a> {
    fn new(places: &'a mut [Reference], scene: &Scene) -> Filled<'a> {
        let part = Part { count: 0, bounds: PaddedAabb::EMPTY, centroids: PaddedAabb::EMPTY };
        Filled { places, part, half_unit: scene.half_unit }
    }

    #[inline(always)]
    fn push(&mut self, reference: Reference) {
        let bounds = reference.bounds();
        self.places[self.part.count] = reference;
        self.part.count += 1;
        self.part.bounds = self.part.bounds.union(&bounds);
        self.part.centroids = self.part.centroids.grown(centroid(&bounds, self.half_unit));
    }
}

/// Number of bins for a node of `count` references: one of those that [`SpatialReferences::best_split`] has code for.
fn bins_of(count: usize) -> usize {
    match count {
        0..16 => 4,
        16..128 => 8,
        128..512 => 16,
        _ => 32,
    }
}

impl NodeReferences for SpatialReferences<'_> {
    type Plane = Plane;

    fn len(&self) -> usize {
        self.count
    }

    fn capacity(&self) -> usize {
        self.list.len()
    }

    fn best_split<P: Probability, W: Weight>(
        &mut self,
        probability: &P,
        state: &P::State,
        weight: &W,
    ) -> Option<Split<Plane>> {
        let as_object = |split: Split<ObjectPlane>| Split {
            plane: Plane::Object(split.plane),
            left: split.left,
            right: split.right,
        };
        if self.count < LEAST_REFERENCES {
            return self.as_binned().best_split(probability, state, weight).map(as_object);
        }
        let object = self.as_binned().cheapest(probability, state, weight);
        let least_cost = object.as_ref().map_or(f32::INFINITY, |(_, cost)| *cost);
        let worth_trying = object.as_ref().is_none_or(|(split, _)| {
            let (left, right) = (&split.left.bounds, &split.right.bounds);
            let shared =
                PaddedAabb { lower: left.lower.max(right.lower), upper: left.upper.min(right.upper) };
            let least = self.scene.least_overlap.max(LEAST_SHARE * self.scene.area.of(&self.bounds));
            shared.lower.cmple(shared.upper).all() && self.scene.area.of(&shared) > least
        });
        let space = if !worth_trying || self.room() == 0 {
            None
        } else {
            match bins_of(self.count) {
                4 => self.best_in_space::<4, _, _>(probability, state, weight),
                8 => self.best_in_space::<8, _, _>(probability, state, weight),
                16 => self.best_in_space::<16, _, _>(probability, state, weight),
                _ => self.best_in_space::<32, _, _>(probability, state, weight),
            }
        };
        match space {
            Some(candidate) if candidate.cost < least_cost => {
                let side =
                    |side: usize| Side { primitives: candidate.counts[side], bounds: candidate.bounds[side] };
                Some(Split { plane: Plane::Space(candidate), left: side(0), right: side(1) })
            }
            _ => object.map(|(split, _)| as_object(split)),
        }
    }

    fn halves(&mut self) -> Split<Plane> {
        let Split { plane, left, right } = self.as_binned().halves();
        Split { plane: Plane::Object(plane), left, right }
    }

    fn divide(self, split: &Split<Plane>) -> (Self, Self) {
        match split.plane {
            Plane::Object(plane) => self.divide_objects(split, plane),
            Plane::Space(candidate) => self.divide_space(split, &candidate),
        }
    }

    fn bounds(&self, _promised: &PaddedAabb) -> PaddedAabb {
        self.bounds
    }

    fn triangles(&self, out: &mut [u32]) {
        for (out, reference) in out.iter_mut().zip(self.list.iter()) {
            *out = reference.triangle();
        }
    }
}

/// Room in `list` for the references that splits may add.
pub fn with_room(mut list: Vec<Reference>, options: &Options) -> Vec<Reference> {
    let capacity = options.capacity(list.len());
    list.resize(capacity, Reference::new(Aabb::EMPTY, 0));
    list
}
