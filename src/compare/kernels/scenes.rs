//! The scenes: one of medium quality, in which each tree is planted, and one of high quality. Which
//! tree queries traverse is one store, so they can be asked in turn.

use super::super::timing::clock;
use super::super::{Candidate, CompareError, Recording};
use super::{Answers, AnswersOnTrees, Kernels, Planting, Wanted, told};
use crate::embree::{self, Arrays, EmbreeError, Isa, Planted, Quality, Scene, Settings, TreeSource, whole};
use crate::format::bvh::{Bvh, flag};
use crate::format::rays::NO_TRIANGLE;
use crate::progress::Progress;
use crate::replay::Mismatch;
use crate::replay::check::{Judge, Verdict};
use crate::replay::query::{Choice, Query};
use crate::traverse::{Hit, Masks};
use rayon::prelude::*;
use std::hint::black_box;
use std::mem::take;

/// Queries that a thread asks at a time.
const PIECE: usize = 1024;

/// Everything that can be asked, by number: Embree on its own trees, then on each tree of the
/// comparison.
pub struct EmbreeScenes {
    kernels: Kernels,
    medium: Scene,
    high: Option<Scene>,
    /// By tree, in the scene of medium quality.
    planted: Vec<Option<Planted>>,
}

impl EmbreeScenes {
    /// Builds Embree's trees over the triangles of the first tree's file, and plants all that can be.
    /// The trees have passed [`Bvh::verify`].
    ///
    /// # Errors
    /// Why Embree has no such scene.
    pub fn of(trees: &[Candidate], wanted: Wanted) -> Result<EmbreeScenes, String> {
        let first = trees[0].bvh;
        let mut settings = Settings {
            isa: wanted.isa.and_then(Isa::from_name),
            robust: wanted.robust,
            threads: rayon::current_num_threads(),
            ..Settings::default()
        };
        settings.suit(bytemuck::cast_slice(first.triangles));
        let geometries = whole(first.geometries, first.triangles.len());
        let scene = |settings: &Settings| {
            let scene = Scene::of_file(first.triangles, &geometries, settings);
            scene.map_err(|error| error.to_string())
        };
        let mut medium = scene(&settings)?;
        let producer = medium.tree(TreeSource::Live).map_err(|error| error.to_string())?.producer;
        // Robust scenes have no spatial splits: their tree would be the same.
        let high = (!settings.robust)
            .then(|| scene(&Settings { quality: Quality::High, ..settings.clone() }))
            .transpose()?;
        let mut planted = Vec::with_capacity(trees.len());
        let mut plantings = Vec::with_capacity(trees.len());
        for tree in trees {
            let found = plant(&mut medium, tree.bvh);
            let planting =
                |&Planted { nodes, blocks, bytes, .. }: &Planted| Planting { nodes, blocks, bytes };
            plantings.push(found.as_ref().map(planting).map_err(String::clone));
            planted.push(found.ok());
        }
        let (named, structure) = told(&producer);
        // Embree names some kernels by the least instruction set that they need.
        let isa = wanted.isa.map_or_else(|| named.clone(), str::to_owned);
        let own = [Quality::Medium].into_iter().chain(high.as_ref().map(|_| Quality::High));
        let kernels = Kernels {
            version: Scene::version(),
            isa,
            structure,
            named,
            robust: settings.robust,
            is_flattened: first.header.flags & flag::FLATTENED != 0,
            own: own.map(Quality::name).collect(),
            trees: plantings,
        };
        Ok(EmbreeScenes { kernels, medium, high, planted })
    }

    pub fn kernels(&self) -> &Kernels {
        &self.kernels
    }

    /// The scene to ask for what stands at `number`; `None` when that tree is not planted.
    fn chosen(&mut self, number: usize) -> Option<&Scene> {
        let tree = match number.checked_sub(self.kernels.own.len()) {
            None if number > 0 => return self.high.as_ref(),
            None => None,
            Some(tree) => Some(self.planted[tree].as_ref()?),
        };
        self.medium.choose(tree).ok()?;
        Some(&self.medium)
    }

    /// Seconds of each of `runs`, asked one by one on this thread; `None` when what stands at `number`
    /// cannot be asked.
    pub fn round<'a, Run: Iterator<Item = Query<'a>>>(
        &mut self,
        number: usize,
        runs: impl Iterator<Item = Run>,
    ) -> Option<Vec<f64>> {
        let mut intersector = self.chosen(number)?.intersector().ok()?;
        let mut asked = Vec::new();
        let seconds = |run: Run| {
            asked.clear();
            asked.extend(run.map(|query| (query.record.is_occlusion(), question(&query))));
            let start = clock::thread_seconds();
            for (is_occlusion, query) in &asked {
                if *is_occlusion {
                    black_box(intersector.occluded(query));
                } else {
                    black_box(intersector.closest_hit(query));
                }
            }
            clock::thread_seconds() - start
        };
        Some(runs.map(seconds).collect())
    }

    /// Asks all chosen queries on Embree's own tree and on each that is planted, one by one and in
    /// packets, on rayon's threads, and judges the answers. Advances `progress` by every query of the
    /// recording.
    ///
    /// # Errors
    /// When the recording is damaged, or Embree has no memory.
    pub fn answers(
        &mut self,
        trees: &[Candidate],
        recording: &Recording,
        choice: &Choice,
        progress: &Progress,
    ) -> Result<AnswersOnTrees, CompareError> {
        let Recording { path, rays, scene, .. } = recording;
        let damaged = |source| CompareError::File { path: path.clone(), source };
        let failed = |error: EmbreeError| CompareError::Embree(error.to_string());
        let choice = Choice { scene: *scene, ..choice.clone() };
        let sample = choice.sample_of(rays.query_count());
        let judges: Vec<Judge> = trees.iter().map(|tree| judge(tree.bvh)).collect();
        let mut sum = AnswersOnTrees { own: Answers::default(), trees: vec![None; trees.len()] };
        for (number, &start) in rays.first_queries().iter().enumerate() {
            let chunk = rays.chunk(number).map_err(damaged)?;
            let queries = choice.within(&chunk, start, 0..chunk.records.len(), sample);
            let Some(scene) = self.chosen(0) else { continue };
            let own = ask(scene, &queries).map_err(failed)?;
            sum.own = take(&mut sum.own).merge(judged(&queries, &own, &own, &judges[0]));
            for (tree, sum) in sum.trees.iter_mut().enumerate() {
                let Some(scene) = self.chosen(self.kernels.own.len() + tree) else { continue };
                let found = ask(scene, &queries).map_err(failed)?;
                let answers = judged(&queries, &own, &found, &judges[tree]);
                *sum = Some(sum.take().unwrap_or_default().merge(answers));
            }
            progress.advance(chunk.records.len() as u64);
        }
        Ok(sum)
    }
}

/// Plants a tree, or says why not.
fn plant(scene: &mut Scene, bvh: &Bvh) -> Result<Planted, String> {
    let geometries = whole(bvh.geometries, bvh.triangles.len());
    let arrays = Arrays { geometries: &geometries, ..Arrays::from(bvh) };
    scene.plant(arrays).map_err(|error| error.to_string())
}

fn judge<'a>(bvh: &'a Bvh) -> Judge<'a> {
    Judge {
        tree: bvh.tree,
        triangles: bvh.triangles,
        masks: Masks::new(bvh.geometries),
        flattened: bvh.header.flags & flag::FLATTENED != 0,
    }
}

fn question(query: &Query) -> embree::Query {
    embree::Query { mask: query.record.mask, ..embree::Query::new(query.ray) }
}

/// What Embree says to one query. An occlusion has no triangle and no t.
#[derive(Clone, Copy, Default)]
struct Answer {
    singly: Option<Hit>,
    in_packet: Option<Hit>,
    /// Embree would end the process at such a ray.
    is_refused: bool,
}

const OCCLUDED: Hit = Hit { t: 0.0, triangle: NO_TRIANGLE };

/// The answers of the tree that the scene traverses now.
fn ask(scene: &Scene, queries: &[Query]) -> Result<Vec<Answer>, EmbreeError> {
    let pieces: Vec<Vec<Answer>> =
        queries.par_chunks(PIECE).map(|piece| ask_piece(scene, piece)).collect::<Result<_, _>>()?;
    Ok(pieces.concat())
}

fn ask_piece(scene: &Scene, queries: &[Query]) -> Result<Vec<Answer>, EmbreeError> {
    let mut intersector = scene.intersector()?;
    let found = |hit: embree::Hit| Hit { t: hit.t, triangle: hit.triangle };
    let mut answers = vec![Answer::default(); queries.len()];
    // By kind: numbers of queries, and these.
    let mut packets: [(Vec<usize>, Vec<embree::Query>); 2] = Default::default();
    for (number, (query, answer)) in queries.iter().zip(&mut answers).enumerate() {
        let is_occlusion = query.record.is_occlusion();
        let asked = question(query);
        let refused = intersector.refused();
        answer.singly = if is_occlusion {
            intersector.occluded(&asked).then_some(OCCLUDED)
        } else {
            intersector.closest_hit(&asked).map(found)
        };
        answer.is_refused = intersector.refused() > refused;
        let (numbers, asking) = &mut packets[usize::from(is_occlusion)];
        numbers.push(number);
        asking.push(asked);
    }
    let [(closest, closest_queries), (occlusion, occlusion_queries)] = packets;
    let mut hits = vec![None; closest.len()];
    intersector.closest_hits(&closest_queries, &mut hits);
    let mut occluded = vec![false; occlusion.len()];
    intersector.occluded_packet(&occlusion_queries, &mut occluded);
    for (number, hit) in closest.into_iter().zip(hits) {
        answers[number].in_packet = hit.map(found);
    }
    for (number, occluded) in occlusion.into_iter().zip(occluded) {
        answers[number].in_packet = occluded.then_some(OCCLUDED);
    }
    Ok(answers)
}

/// The answers `found` beside the recorded ones and those on Embree's own tree.
fn judged(queries: &[Query], own: &[Answer], found: &[Answer], judge: &Judge) -> Answers {
    let pieces = queries.par_chunks(PIECE).zip(own.par_chunks(PIECE)).zip(found.par_chunks(PIECE));
    let sum = |((queries, own), found): ((&[Query], &[Answer]), &[Answer])| {
        let mut sum = Answers { queries: queries.len() as u64, ..Answers::default() };
        for ((query, own), found) in queries.iter().zip(own).zip(found) {
            let record = query.record;
            let is_filtered = !query.candidates.rejects.is_empty();
            let verdict = if is_filtered || found.is_refused {
                Verdict::Unchecked
            } else {
                judge.judge(record, &query.ray, found.singly, &query.candidates)
            };
            let mismatch = Mismatch { query: query.number, record: *record, found: found.singly };
            sum.count(verdict, mismatch);
            sum.differing += u64::from(found.singly.is_some() != record.is_hit());
            let distance = |hit: Option<Hit>| hit.map(|hit| hit.t);
            sum.singly.count(distance(own.singly), distance(found.singly));
            sum.in_packets.count(distance(own.in_packet), distance(found.in_packet));
        }
        sum
    };
    pieces.map(sum).reduce(Answers::default, Answers::merge)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builder;
    use crate::format::bvh::{self, Contents, Geometry};
    use crate::geometry::Triangle;
    use crate::mesh::generate;
    use crate::tree::Tree;

    fn file(triangles: &[Triangle], geometries: &[Geometry], tree: &Tree) -> Vec<u8> {
        let mut bytes = Vec::new();
        let contents = Contents {
            tree: tree.view(),
            triangles,
            geometries,
            order: None,
            meta: None,
            flags: 0,
            producer: "a test",
        };
        bvh::write(&mut bytes, &contents).unwrap();
        bytes
    }

    /// What is asked in a round, and what Embree has in memory then.
    #[test]
    fn each_is_asked_on_the_tree_that_it_stands_for() {
        let mesh = generate::quads(6);
        let (triangles, geometries) = (mesh.triangles(), mesh.geometries(u32::MAX));
        let triangles_only: Vec<Geometry> = geometries
            .iter()
            .map(|geometry| Geometry { kind: bvh::geometry_kind::TRIANGLES, ..*geometry })
            .collect();
        let built = |splits| {
            let config = builder::Config::of(splits);
            builder::build(&triangles, &config, &Progress::hidden()).unwrap()
        };
        let trees = [built(builder::Splits::Sweep), {
            // The same triangles in an order that no builder would choose.
            let mut worse = built(builder::Splits::Sweep);
            worse.primitives.reverse();
            let mut boxes = vec![crate::geometry::Aabb::EMPTY; worse.nodes.len()];
            for index in (0..worse.nodes.len()).rev() {
                let node = worse.nodes[index];
                boxes[index] = node.range().fold(crate::geometry::Aabb::EMPTY, |all, below| {
                    let leaf = || triangles[worse.primitives[below] as usize].bounds();
                    all.union(&if node.is_leaf() { leaf() } else { boxes[below] })
                });
            }
            for (node, bounds) in worse.nodes.iter_mut().zip(boxes) {
                (node.lower, node.upper) = (bounds.lower, bounds.upper);
            }
            worse
        }];
        assert!(trees[0] != trees[1]);
        let files = trees.each_ref().map(|tree| file(&triangles, &triangles_only, tree));
        let bvhs = files.each_ref().map(|bytes| Bvh::parse(bytes).unwrap());
        assert!(bvhs.iter().all(|bvh| bvh.verify().is_ok()));
        let candidates: Vec<Candidate> =
            bvhs.iter().map(|bvh| Candidate { path: String::new(), bvh }).collect();
        let mut scenes = EmbreeScenes::of(&candidates, Wanted::default()).unwrap();
        assert!(scenes.kernels().trees.iter().all(Result::is_ok), "{:?}", scenes.kernels());
        let own = scenes.kernels().own.len();
        assert_eq!(own, 2);
        let no_queries = std::iter::empty::<std::iter::Empty<Query>>;
        // In turn, as in the rounds of a measurement.
        for _ in 0..2 {
            for (number, tree) in trees.iter().enumerate() {
                assert!(scenes.round(own + number, no_queries()).is_some());
                let live = scenes.medium.tree(TreeSource::Live).unwrap();
                assert!(live.tree == *tree && live.producer.starts_with("planted in"), "{}", live.producer);
            }
            assert!(scenes.round(0, no_queries()).is_some());
            let live = scenes.medium.tree(TreeSource::Live).unwrap();
            assert!(!trees.contains(&live.tree) && live.producer.starts_with("embree"), "{}", live.producer);
            let high = scenes.high.as_ref().map(std::ptr::from_ref);
            assert_eq!(scenes.chosen(1).map(std::ptr::from_ref), high);
        }
    }
}
