//! What a recording intersector hands on: every query and its answer, in order, in batches of a fixed size.
#![cfg(feature = "embree")]

mod embree_support;

use embree_support::*;
use embree_trace::embree::{BATCH_RECORDS, BatchSink, Hit, Query, Scene, Settings, Stop};
use embree_trace::format::rays::{NO_TRIANGLE, Purpose, Record, Reject, flag, kind};
use embree_trace::geometry::Ray;
use embree_trace::mesh::Faces;

/// Keeps batches as they come, and stops after some.
#[derive(Default)]
struct Keep {
    batches: Vec<Vec<Record>>,
    stop_after: Option<usize>,
}

impl BatchSink for Keep {
    fn batch(&mut self, records: &[Record], rejects: &[Reject]) -> Result<(), Stop> {
        assert!(rejects.is_empty());
        self.batches.push(records.to_vec());
        if self.stop_after.is_some_and(|limit| self.batches.len() >= limit) { Err(Stop) } else { Ok(()) }
    }
}

/// The record that a query and its answer must give, written out from `docs/formats.md`.
fn expected(query: &Query, kind: u8, hit: Option<Hit>, occluded: bool) -> Record {
    let is_hit = hit.is_some() || occluded;
    Record {
        origin: query.ray.origin,
        tnear: query.ray.tnear,
        direction: query.ray.direction,
        tfar: query.ray.tfar,
        time: query.time,
        mask: query.mask,
        t: if occluded { f32::NEG_INFINITY } else { hit.map_or(f32::INFINITY, |hit| hit.t) },
        triangle: hit.map_or(NO_TRIANGLE, |hit| hit.triangle),
        u: hit.map_or(0.0, |hit| hit.u),
        v: hit.map_or(0.0, |hit| hit.v),
        path: query.path,
        kind,
        depth: query.depth,
        flags: if is_hit { flag::HIT } else { 0 } | if query.coherent { flag::COHERENT } else { 0 },
        purpose: query.purpose as u8,
    }
}

/// Queries whose every field differs from its neighbours'.
fn labelled(count: usize, seed: u64) -> Vec<Query> {
    let mut queries = queries(count, seed);
    for (index, query) in queries.iter_mut().enumerate() {
        query.time = index as f32 / count as f32;
        query.mask = if index % 7 == 0 { 0 } else { !(index as u32) | 1 };
        query.path = index as u32 * 3;
        query.depth = (index % 256) as u8;
        query.purpose = Purpose::ALL[index % Purpose::ALL.len()];
        query.coherent = index % 3 == 0;
    }
    queries
}

#[test]
fn records_are_the_queries_and_their_answers() {
    let mesh = soup(Faces::Triangles, 300, 0.5, 1);
    let scene = Scene::new(&mesh, &Settings::default()).unwrap();
    let mut plain = scene.intersector().unwrap();
    let queries = labelled(3000, 2);
    let hostile = Query::new(Ray { tnear: f32::NAN, ..queries[0].ray });
    let mut truth = Vec::new();
    let mut sink = Keep::default();
    let mut recording = scene.recording_intersector(&mut sink).unwrap();
    let mut random = Random(4);
    let mut next = 0;
    while next < queries.len() {
        let length = random.below(40).min(queries.len() - next);
        // A refused query among the others leaves no record.
        let mut asked = queries[next..next + length].to_vec();
        asked.insert(random.below(length + 1), hostile);
        let (mut hits, mut occluded) = (vec![None; length + 1], vec![false; length + 1]);
        let single = random.below(2) == 0;
        let closest = random.below(2) == 0;
        match (single, closest) {
            (true, true) => {
                asked.iter().zip(&mut hits).for_each(|(query, hit)| *hit = recording.closest_hit(query))
            }
            (true, false) => asked
                .iter()
                .zip(&mut occluded)
                .for_each(|(query, answer)| *answer = recording.occluded(query)),
            (false, true) => recording.closest_hits(&asked, &mut hits),
            (false, false) => recording.occluded_packet(&asked, &mut occluded),
        }
        for (lane, query) in asked.iter().enumerate() {
            if closest {
                assert_eq!(hits[lane], plain.closest_hit(query), "recording changed an answer");
            } else {
                assert_eq!(occluded[lane], plain.occluded(query), "recording changed an answer");
            }
            if !query.ray.tnear.is_nan() {
                let kind = if closest { kind::CLOSEST_HIT } else { kind::OCCLUSION };
                truth.push(expected(query, kind, hits[lane], occluded[lane]));
            }
        }
        next += length;
    }
    assert!(recording.refused() > 50);
    assert_eq!(recording.flush(), Ok(()));
    drop(recording);
    let records: Vec<Record> = sink.batches.concat();
    assert_eq!(records.len(), truth.len());
    for (record, truth) in records.iter().zip(&truth) {
        assert_eq!(bytemuck::bytes_of(record), bytemuck::bytes_of(truth), "{record:?} {truth:?}");
    }
    assert!(truth.iter().filter(|record| record.is_hit()).count() > 500);
    assert!(sink.batches[..sink.batches.len() - 1].iter().all(|batch| batch.len() == BATCH_RECORDS));
}

#[test]
fn batches_are_full_but_for_a_flush_and_the_end() {
    let scene = Scene::new(&soup(Faces::Triangles, 10, 0.5, 1), &Settings::default()).unwrap();
    let query = queries(1, 1)[0];
    let sizes = |run: &dyn Fn(&mut embree_trace::embree::Intersector)| {
        let mut sink = Keep::default();
        let mut recording = scene.recording_intersector(&mut sink).unwrap();
        run(&mut recording);
        drop(recording);
        sink.batches.iter().map(Vec::len).collect::<Vec<_>>()
    };
    assert_eq!(sizes(&|_| ()), [0usize; 0]);
    assert_eq!(sizes(&|i| i.flush().unwrap()), [0usize; 0]);
    let ask = |intersector: &mut embree_trace::embree::Intersector, count: usize| {
        for _ in 0..count {
            intersector.occluded(&query);
        }
    };
    assert_eq!(sizes(&|i| ask(i, 1)), [1]);
    assert_eq!(sizes(&|i| ask(i, BATCH_RECORDS - 1)), [BATCH_RECORDS - 1]);
    assert_eq!(sizes(&|i| ask(i, BATCH_RECORDS)), [BATCH_RECORDS]);
    assert_eq!(sizes(&|i| ask(i, BATCH_RECORDS + 1)), [BATCH_RECORDS, 1]);
    let flushed = sizes(&|i| {
        ask(i, 5);
        i.flush().unwrap();
        i.flush().unwrap();
        ask(i, BATCH_RECORDS + 2);
    });
    assert_eq!(flushed, [5, BATCH_RECORDS, 2]);
    // A packet may straddle the border of two batches.
    let straddling = sizes(&|i| {
        ask(i, BATCH_RECORDS - 5);
        i.closest_hits(&[query; 16], &mut [None; 16]);
    });
    assert_eq!(straddling, [BATCH_RECORDS, 11]);
}

#[test]
fn a_sink_that_stops_is_left_alone_and_queries_go_on() {
    let scene = Scene::new(&soup(Faces::Triangles, 100, 0.5, 1), &Settings::default()).unwrap();
    let mut plain = scene.intersector().unwrap();
    let mut sink = Keep { stop_after: Some(2), ..Keep::default() };
    let mut recording = scene.recording_intersector(&mut sink).unwrap();
    assert_eq!(recording.flush(), Ok(()));
    for query in queries(4 * BATCH_RECORDS, 1) {
        assert_eq!(recording.closest_hit(&query), plain.closest_hit(&query));
    }
    assert_eq!(recording.flush(), Err(Stop));
    assert_eq!(recording.flush(), Err(Stop));
    drop(recording);
    assert_eq!(sink.batches.iter().map(Vec::len).collect::<Vec<_>>(), [BATCH_RECORDS; 2]);
}

struct Panics;

impl BatchSink for Panics {
    fn batch(&mut self, _: &[Record], _: &[Reject]) -> Result<(), Stop> {
        panic!("the sink fell over")
    }
}

#[test]
fn a_panic_of_a_sink_comes_out_of_flush() {
    let scene = Scene::new(&soup(Faces::Triangles, 100, 0.5, 1), &Settings::default()).unwrap();
    let mut sink = Panics;
    let mut recording = scene.recording_intersector(&mut sink).unwrap();
    for query in queries(2 * BATCH_RECORDS + 3, 1) {
        recording.occluded(&query);
    }
    let panic = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| recording.flush())).unwrap_err();
    assert_eq!(panic.downcast_ref(), Some(&"the sink fell over"));
    assert_eq!(recording.flush(), Err(Stop));
    recording.occluded(&queries(1, 1)[0]);
}
