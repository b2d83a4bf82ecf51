//! Embree as a contender: a scene of the tree's triangles, asked one query at a time through the shim, as a renderer of ours asks.

use super::{EmbreeTime, Queries, Time, clock};
use crate::embree::{self, Intersector, Settings};
use crate::format::bvh::Bvh;
use crate::mesh::{Faces, Material, Mesh, Part};
use crate::replay::query::Query;
use std::hint::black_box;

/// All triangles of a `.bvh` as one geometry, under Embree's defaults.
pub struct Scene(embree::Scene);

impl Scene {
    /// `None` when Embree refuses it; then the comparison goes on without.
    pub fn of(bvh: &Bvh) -> Option<Scene> {
        let vertices: Vec<_> = bvh.triangles.iter().flat_map(|triangle| triangle.0).collect();
        let part = Part {
            name: String::new(),
            material: 0,
            faces: Faces::Triangles,
            indices: (0..u32::try_from(vertices.len()).ok()?).collect(),
        };
        let mesh = Mesh { vertices, parts: vec![part], materials: vec![Material::default()] };
        embree::Scene::new(&mesh, &Settings::default()).ok().map(Scene)
    }

    /// Seconds of each run.
    pub fn round(&self, queries: &Queries) -> Option<Vec<f64>> {
        let mut intersector = self.0.intersector().ok()?;
        let mut seconds = Vec::with_capacity(queries.runs.len());
        let mut asked = Vec::new();
        for (_, range) in &queries.runs {
            asked.clear();
            asked.extend(queries.run(range).map(|query| (query.record.is_occlusion(), question(&query))));
            let start = clock::thread_seconds();
            for (occlusion, query) in &asked {
                black_box(hit(&mut intersector, *occlusion, query));
            }
            seconds.push(clock::thread_seconds() - start);
        }
        Some(seconds)
    }

    /// What `rounds` came to, and whether the answers were those recorded.
    pub fn time(&self, queries: &Queries, rounds: &[Vec<f64>]) -> Option<EmbreeTime> {
        let mut intersector = self.0.intersector().ok()?;
        let every = queries.runs.iter().flat_map(|(_, range)| queries.run(range));
        let mut differs = |query: &Query| {
            hit(&mut intersector, query.record.is_occlusion(), &question(query)) != query.record.is_hit()
        };
        let differing = every.filter(|query| differs(query)).count() as u64;
        let time: Time = queries.time(rounds);
        Some(EmbreeTime { time, differing, version: embree::Scene::version() })
    }
}

fn question(query: &Query) -> embree::Query {
    embree::Query { mask: query.record.mask, ..embree::Query::new(query.ray) }
}

fn hit(intersector: &mut Intersector, occlusion: bool, query: &embree::Query) -> bool {
    if occlusion { intersector.occluded(query) } else { intersector.closest_hit(query).is_some() }
}
