//! What trees from recorded rays cost rays that they have not seen, beside every other tree: `cargo bench --bench held_out -- SCENE…`.
//!
//! Each scene (`.obj`, `.ply`, also `.zst`) is path-traced and recorded. The queries of a tenth of the pixels train; queries of the others are counted:
//! box and primitive tests, depth first, nearest first. The same parting as `bvh-build --train 0.1` and `bvh-compare --held-out 0.1` make.
//!
//! - *Control*: of the trees from area alone (spatial splits and full sweep, as built and with the same optimisers and leaves for the same
//!   time), the one that costs the held-out queries least. That choice is the judges' own: the control could not be stronger.
//! - *Other camera*: auto, trained on a recording of the same scene from elsewhere.
//! - *A tree a purpose*: camera queries in auto's tree for camera queries, shadow queries in its tree for shadow queries with their order, the others in its tree for all.
//! - *Limit*: the recipe that auto chose, trained on the very queries that are counted. It bounds this recipe, not all trees.
//!
//! Prints Markdown tables; progress goes to standard error. Environment: SIZE=WIDTHxHEIGHT of the picture; BUDGET, seconds for each auto, control and
//! limit (by default 15, 30 above 300,000 and 90 above 2,000,000 triangles); SAMPLE, queries of the recording of which the held-out ones are counted;
//! FIGURE, a folder for held-out.svg and .png; KEEP, a folder
//! for what was measured of each scene, so that a run that was broken off goes on where it was: scenes that are there are not measured again.

mod held_out_tables;
mod peers;
mod recorded;

use embree_trace::builder::{self, Splits, spatial};
use embree_trace::embree::{Quality, Scene, Settings, TreeSource};
use embree_trace::format::bvh::Bvh;
use embree_trace::format::rays::{Purpose, Rays};
use embree_trace::geometry::Ray;
use embree_trace::mesh::{self, Mesh};
use embree_trace::optimize::{Stage, order, reinsertion, rotations, treelets};
use embree_trace::progress::Progress;
use embree_trace::recipe::{Heuristic, Recipe, auto};
use embree_trace::render::Job;
use embree_trace::render::scenery::Wishes;
use embree_trace::replay::check::Judge;
use embree_trace::replay::query::Choice;
use embree_trace::replay::select::{Filter, Portion};
use embree_trace::replay::tally::{Costs, Tally};
use embree_trace::replay::{Options, replay};
use embree_trace::training::{Selection, occlusions, queries};
use embree_trace::traverse::{Masks, OcclusionOrder, Prepared, Traversal};
use embree_trace::tree::{Tree, TreeView};
use held_out_tables::{Kind, Row, SceneResult};
use obvhs::BvhBuildParams;
use peers::Peer;
use recorded::Recording;
use std::error::Error;
use std::path::Path;
use std::time::{Duration, Instant};

/// The parting of `bvh-build --train 0.1`.
const PORTION: Portion = Portion { share: 0.1, seed: 1 };
const SIZE: &str = "768x576";
const SAMPLE: u64 = 400_000;
const MOST_TRAINING: usize = 1 << 20;

fn main() {
    let paths: Vec<String> =
        std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    if paths.is_empty() {
        println!("give scenes: cargo bench --bench held_out -- SCENE…");
    }
    let mut results = Vec::new();
    for path in &paths {
        match kept_or_measured(Path::new(path)) {
            Ok(result) => results.push(result),
            Err(error) => eprintln!("{path}: {error}"),
        }
    }
    held_out_tables::print(&results);
    if let Some(directory) = std::env::var_os("FIGURE")
        && let Err(error) = held_out_tables::chart::write(&results, Path::new(&directory))
    {
        eprintln!("{error}");
    }
}

fn from_environment<T: std::str::FromStr>(name: &str) -> Option<T> {
    std::env::var(name).ok()?.parse().ok()
}

fn budget(triangles: usize) -> Duration {
    let default = match triangles {
        ..300_000 => 15.0,
        300_000..2_000_000 => 30.0,
        _ => 90.0,
    };
    Duration::from_secs_f64(from_environment("BUDGET").unwrap_or(default))
}

/// What KEEP has of a scene, or a measurement.
fn kept_or_measured(path: &Path) -> Result<SceneResult, Box<dyn Error>> {
    let Some(folder) = std::env::var_os("KEEP") else { return measure(path) };
    let kept = Path::new(&folder).join(format!("{}.json", scene_name(path)));
    if kept.exists() {
        return Ok(serde_json::from_slice(&std::fs::read(kept)?)?);
    }
    let result = measure(path)?;
    std::fs::create_dir_all(folder)?;
    std::fs::write(kept, serde_json::to_vec(&result)?)?;
    Ok(result)
}

fn scene_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.split('.').next().unwrap_or_default().to_owned()
}

/// Everything that is counted of one scene.
fn measure(path: &Path) -> Result<SceneResult, Box<dyn Error>> {
    let (mesh, _) = mesh::read(path)?;
    let size = Job::parse_size(&std::env::var("SIZE").unwrap_or_else(|_| SIZE.into()))?;
    let size = [size.0, size.1];
    let recording = Recording::new(&mesh, size, &Wishes::default())?;
    let (bvh, rays) = (recording.bvh(), recording.rays());
    let name = scene_name(path);
    let mut scene = Contest {
        bvh: &bvh,
        rays: &rays,
        budget: budget(bvh.triangles.len()),
        result: SceneResult { name, triangles: bvh.triangles.len(), ..SceneResult::default() },
        started: Instant::now(),
    };
    scene.area()?;
    scene.peers(&mesh)?;
    let other = Recording::new(&mesh, size, &recording.other_view(&bvh.tree.nodes[0].bounds()))?;
    scene.auto(&other)?;
    Ok(scene.result)
}

struct Contest<'a> {
    bvh: &'a Bvh<'a>,
    rays: &'a Rays<'a>,
    budget: Duration,
    result: SceneResult,
    started: Instant,
}

impl Contest<'_> {
    /// Counts a tree, and keeps its row.
    fn judge(
        &mut self,
        kind: Kind,
        name: &str,
        tree: TreeView,
        order: OcclusionOrder,
    ) -> Result<(), Box<dyn Error>> {
        let bvh = self.bvh;
        let prepared = Prepared::new(tree, bvh.triangles, bvh.geometries);
        let masks = Masks::new(bvh.geometries);
        let judge = Judge { tree, triangles: bvh.triangles, masks, flattened: false };
        let options = Options {
            traversal: Traversal::Odf,
            occlusion_order: order,
            choice: held_out(Filter::default()),
            overlap: false,
            costs: Costs { c_i: 1.0, c_p: 1.0 },
            sort: None,
            packet: None,
            profile: None,
            image: None,
        };
        let tallies = replay(&prepared, &judge, self.rays, &options, &Progress::hidden())?.tallies;
        let tests = |tally: &Tally| {
            (tally.counts.box_tests + tally.counts.primitive_tests) as f64 / tally.queries as f64
        };
        let of = |purpose| tallies.by_purpose.get(&purpose).map_or(f64::NAN, tests);
        let shadow = tallies.by_purpose.get(&Purpose::Shadow);
        let row = Row {
            kind,
            name: name.to_owned(),
            all: tests(&tallies.total),
            camera: of(Purpose::Camera),
            diffuse: of(Purpose::Diffuse),
            shadow: of(Purpose::Shadow),
            shadow_visits: shadow
                .map_or(f64::NAN, |tally| tally.counts.node_visits as f64 / tally.queries as f64),
            wrong: tallies.total.mismatches,
        };
        eprintln!("{:>6.0} s  {:<20}{row}", self.started.elapsed().as_secs_f64(), self.result.name);
        self.result.counted = tallies.total.queries;
        let share = |purpose| {
            let queries = tallies.by_purpose.get(&purpose).map_or(0, |tally| tally.queries);
            queries as f64 / tallies.total.queries as f64
        };
        (self.result.camera_share, self.result.shadow_share) =
            (share(Purpose::Camera), share(Purpose::Shadow));
        self.result.rows.push(row);
        Ok(())
    }

    fn plain(&mut self, kind: Kind, name: &str, tree: &Tree) -> Result<(), Box<dyn Error>> {
        self.judge(kind, name, tree.view(), OcclusionOrder::Nearest)
    }

    /// Trees from area alone.
    fn area(&mut self) -> Result<(), Box<dyn Error>> {
        for (name, splits) in [
            ("spatial", Splits::Spatial(spatial::Options::default())),
            (held_out_tables::SWEEP, Splits::Sweep),
        ] {
            let builder =
                builder::Config { max_leaf: auto::MAX_LEAF, c_i: 1.0, ..builder::Config::of(splits) };
            let optimised = vec![
                Stage::Rotations(rotations::Config::default()),
                Stage::Reinsertion(reinsertion::Config::PATIENT),
                Stage::Treelets(treelets::Config::default()),
                Stage::Reinsertion(reinsertion::Config::PATIENT),
            ];
            for (suffix, stages) in [("", Vec::new()), (", optimised", optimised)] {
                let recipe = Recipe { heuristic: Heuristic::Sah, builder, stages, budget: Some(self.budget) };
                let tree = recipe.make(self.bvh.triangles, &[], &Progress::hidden())?.tree;
                self.plain(Kind::Area, &format!("{name}{suffix}"), &tree)?;
                if name == held_out_tables::SWEEP && suffix.is_empty() {
                    self.occlusion(Kind::SweepOrder, "sweep + order", &tree)?;
                }
            }
        }
        Ok(())
    }

    /// What others build.
    fn peers(&mut self, mesh: &Mesh) -> Result<(), Box<dyn Error>> {
        for quality in [Quality::Medium, Quality::High] {
            let scene = Scene::new(mesh, &Settings { quality, ..Settings::default() })?;
            self.plain(Kind::Embree, quality.name(), &scene.tree(TreeSource::Live)?.tree)?;
            if quality == Quality::Medium {
                self.plain(Kind::Embree, "rtcBuildBVH", &scene.tree(TreeSource::Builder)?.tree)?;
            }
        }
        use peers::{bvh_crate::BvhCrate, obvhs_crate::Obvhs, parry_crate::Parry, tinybvh_crate::TinyBvh};
        self.peer("obvhs medium", &Obvhs(BvhBuildParams::medium_build()))?;
        self.peer("obvhs very slow", &Obvhs(BvhBuildParams::very_slow_build()))?;
        self.peer("tinybvh-rs", &TinyBvh { spatial: false })?;
        self.peer("tinybvh-rs spatial", &TinyBvh { spatial: true })?;
        self.peer("bvh", &BvhCrate)?;
        self.peer("parry3d", &Parry)
    }

    fn peer<P: Peer>(&mut self, name: &str, peer: &P) -> Result<(), Box<dyn Error>> {
        let tree = P::tree(&peer.build(&mut P::prepare(self.bvh.triangles)));
        self.plain(Kind::Crate, name, &tree)
    }

    /// Trees from rays: of all queries and of camera and occlusion queries alone, from another camera, and with the counted ones.
    fn auto(&mut self, other: &Recording) -> Result<(), Box<dyn Error>> {
        let chosen = self.chosen(self.rays, Filter::default())?;
        self.result.training = chosen.queries;
        self.result.chosen = short_name(&chosen.recipe);
        let tree = &chosen.made.tree;
        self.plain(Kind::Auto, "auto", tree)?;
        self.occlusion(Kind::AutoOrder, "auto + order", tree)?;
        self.limit(Kind::Limit, "limit", &chosen.recipe, Filter::default())?;

        let camera: Filter = "purpose=camera".parse()?;
        let chosen = self.chosen(self.rays, camera.clone())?;
        self.plain(Kind::Camera, "auto, camera", &chosen.made.tree)?;
        self.limit(Kind::CameraLimit, "limit, camera", &chosen.recipe, camera)?;

        let other_rays = other.rays();
        let chosen = self.chosen(&other_rays, Filter::default())?;
        self.plain(Kind::OtherCamera, "auto, other camera", &chosen.made.tree)?;

        let shadow: Filter = "purpose=shadow".parse()?;
        if self.result.rows.iter().all(|row| row.shadow.is_nan()) {
            return Ok(());
        }
        let chosen = self.chosen(self.rays, shadow)?;
        self.plain(Kind::Shadow, "auto, shadow", &chosen.made.tree)?;
        self.occlusion(Kind::ShadowOrder, "auto, shadow + order", &chosen.made.tree)?;
        self.result.rows.extend(self.result.tree_a_purpose());
        Ok(())
    }

    fn selection(filter: Filter) -> Selection {
        Selection { scene: None, filter, portion: PORTION, most: MOST_TRAINING }
    }

    fn chosen(&self, rays: &Rays, filter: Filter) -> Result<auto::Chosen, Box<dyn Error>> {
        let queries = queries::read(&Self::selection(filter), rays, self.bvh)?;
        let config =
            auto::Config { budget: self.budget, c_i: 1.0, c_p: 1.0, max_leaf: auto::MAX_LEAF, cuts: true };
        let scene = auto::Scene { triangles: self.bvh.triangles, geometries: self.bvh.geometries };
        Ok(auto::choose(scene, &queries, &config)?)
    }

    /// The same recipe, trained on what is counted.
    fn limit(
        &mut self,
        kind: Kind,
        name: &str,
        recipe: &Recipe,
        filter: Filter,
    ) -> Result<(), Box<dyn Error>> {
        let mut segments: Vec<Ray> = Vec::new();
        held_out(filter).for_each_chunk(self.rays, |queries| {
            segments.extend(queries.iter().map(|query| query.record.effective_segment()));
        })?;
        let recipe = Recipe { budget: Some(self.budget), ..recipe.clone() };
        let tree = recipe.make(self.bvh.triangles, &segments, &Progress::hidden())?.tree;
        self.plain(kind, name, &tree)
    }

    /// A tree with the order that its training occlusion queries choose.
    fn occlusion(&mut self, kind: Kind, name: &str, tree: &Tree) -> Result<(), Box<dyn Error>> {
        let queries = occlusions::read(&Self::selection(Filter::default()), self.rays, self.bvh)?.training;
        let prepared = Prepared::new(tree.view(), self.bvh.triangles, self.bvh.geometries);
        let chosen = order::choose(&prepared, tree.nodes.len(), &queries, &order::Config::default());
        self.judge(kind, name, tree.view(), OcclusionOrder::Recorded(chosen.orders))
    }
}

/// The queries that are counted.
fn held_out(filter: Filter) -> Choice {
    let sample = from_environment("SAMPLE").unwrap_or(SAMPLE);
    Choice { scene: 0, filter, held_out: Some(PORTION), sample: Some(sample) }
}

fn short_name(recipe: &Recipe) -> String {
    let heuristic = match recipe.heuristic {
        Heuristic::Sah => "area".to_owned(),
        Heuristic::Rdh { .. } => "rays".to_owned(),
        Heuristic::Blend { weight } => format!("blend {weight}"),
    };
    format!("{heuristic}, {}", recipe.builder.splits)
}
