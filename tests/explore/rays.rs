//! Segments to draw, queries of a pixel, and what passes a plane: against loops over all records.

use super::{Scene, asked, choice, nanoseconds, source};
use embree_trace::explore::crossing::{Grid, Plane, overlaps, traffic};
use embree_trace::explore::queries::Sampled;
use embree_trace::explore::rays::{Kept, PixelIndex, Segment, Wanted, fetch, origins, segments};
use embree_trace::explore::steps::question;
use embree_trace::explore::walk::Walk;
use embree_trace::format::rays::{Purpose, Record, flag};
use embree_trace::geometry::{Aabb, Ray, Triangle, Vec3};
use embree_trace::progress::Progress;
use embree_trace::traverse::{Counts, Scratch, Traversal};

fn bounds(triangles: &[Triangle]) -> Aabb {
    triangles.iter().fold(Aabb::EMPTY, |all, triangle| all.union(&triangle.bounds()))
}

const ANY: Wanted = Wanted { hit: None, cost: None, every: 1, most: usize::MAX };

#[test]
fn segments_are_those_that_are_wanted() {
    let scene = Scene::new(600, 70);
    let (rays, bounds) = (scene.rays(), bounds(&scene.triangles));
    let tree = &scene.trees()[2];
    let prepared = scene.prepared(tree);
    let asked = asked(tree, &prepared, Traversal::Odf);
    let found = |filter: &str, wanted: &Wanted| {
        segments(&source(&rays, filter, u64::MAX), wanted, &bounds, &Progress::hidden()).expect("whole")
    };
    let numbers = |accepts: &dyn Fn(&Record) -> bool| {
        let numbered = scene.records.iter().enumerate().filter(|(_, record)| accepts(record));
        numbered.map(|(number, _)| number as u64).collect::<Vec<u64>>()
    };
    let queries = |list: &[Segment]| list.iter().map(|segment| segment.query).collect::<Vec<u64>>();

    let all = found("", &ANY);
    assert_eq!((queries(&all.list), all.matched), (numbers(&|_| true), 600));
    for (segment, record) in all.list.iter().zip(&scene.records) {
        assert_eq!(segment.from, record.ray().at(record.tnear));
        let closest_hit = record.is_hit() && !record.is_occlusion();
        assert_eq!(segment.goes_on, !closest_hit && record.tfar > 1e6, "{record:?}");
        if segment.goes_on {
            assert!(!(bounds.lower.cmple(segment.to).all() && segment.to.cmple(bounds.upper).all()));
        } else {
            let end = if closest_hit { record.t } else { record.tfar };
            assert!(segment.to.distance(record.ray().at(end)) < 1e-4);
        }
    }
    let shadows = found("purpose=shadow", &Wanted { hit: Some(true), ..ANY });
    assert_eq!(queries(&shadows.list), numbers(&|record| record.is_occlusion() && record.is_hit()));
    assert_eq!(shadows.sampled.looked_at, 600);

    let cost = |query: u64| {
        let kept = fetch(&rays, &choice(""), query).expect("whole").expect("there");
        let mut counts = Counts::default();
        asked.ask(&kept.query(), &mut counts, &mut Scratch::default());
        nanoseconds(kept.record.is_occlusion(), &counts)
    };
    let dear = found("", &Wanted { cost: Some((asked, 40.0..=90.0)), ..ANY });
    let expected: Vec<u64> = (0..600).filter(|&query| (40.0..=90.0).contains(&cost(query))).collect();
    assert!(expected.len() > 20);
    assert_eq!(queries(&dear.list), expected);
    assert!(dear.list.iter().all(|segment| (f64::from(segment.cost) - cost(segment.query)).abs() < 1e-3));

    let few = found("", &Wanted { every: 6, most: 40, ..ANY });
    assert_eq!((few.list.len(), few.matched), (40, 100));
    assert_eq!(few.sampled, Sampled { taken: 100, looked_at: 100, of: 600 });
    assert!(few.list.is_sorted_by_key(|segment| segment.query) && few.list[39].query > 500);
}

#[test]
fn every_query_of_a_pixel_is_found_with_what_was_rejected() {
    let scene = Scene::new(900, 64);
    let rays = scene.rays();
    let progress = Progress::watched(900);
    let index = PixelIndex::of(&rays, &progress).expect("whole");
    assert_eq!(progress.fraction(), 1.0);
    for path in [0, 1, 77, 191, 192, u32::MAX] {
        let found = index.queries(&rays, &choice(""), path).expect("whole");
        let expected = scene.records.iter().filter(|record| record.path == path);
        assert!(found.iter().map(|kept| &kept.record).eq(expected), "{path}");
        for kept in &found {
            let own = scene.rejects.iter().filter(|reject| u64::from(reject.record) == kept.number);
            assert!(kept.rejects.iter().map(|r| r.triangle).eq(own.map(|r| r.triangle)));
        }
    }
    let some = index.queries(&rays, &choice("kind=occlusion"), 5).expect("whole");
    assert!(!some.is_empty() && some.iter().all(|kept| kept.record.is_occlusion()));
    assert_eq!(fetch(&rays, &choice(""), 900).expect("whole"), None);
}

#[test]
fn bounces_begin_at_the_hits_before_them() {
    let ray = |from: Vec3, to: Vec3, t: Option<f32>, depth: u8, occlusion: bool| {
        let ray = Ray { origin: from, tnear: 0.0, direction: to - from, tfar: f32::INFINITY };
        let mut record = Record { depth, ..question(ray, occlusion) };
        if let Some(t) = t {
            (record.t, record.flags) = (t, flag::HIT);
        }
        Kept::from(record)
    };
    let (eye, a, b, c) = (Vec3::ZERO, Vec3::X, Vec3::new(1.0, 4.0, 0.0), Vec3::new(5.0, 4.0, 1.0));
    let (other, light) = (Vec3::new(0.9, 0.4, 0.0), 20.0 * Vec3::Y);
    let queries = [
        // Two samples of a pixel, asked together: both camera rays, then both first bounces.
        ray(eye, a, Some(1.0), 0, false),
        ray(eye, other, Some(1.0), 0, false),
        ray(a + 1e-5, light, None, 1, true),
        ray(other, light, Some(0.5), 1, true),
        ray(a, b, Some(1.0), 1, false),
        ray(other, c, None, 1, false),
        ray(b + 1e-5, light, None, 2, true),
        ray(c, light, None, 2, true),
    ];
    let none = None::<usize>;
    assert_eq!(origins(&queries), [none, none, Some(0), Some(1), Some(0), Some(1), Some(4), none]);
}

#[test]
fn what_passes_a_plane_is_counted_in_its_cells() {
    let scene = Scene::new(800, 50);
    let rays = scene.rays();
    let plane = Plane::facing(Vec3::new(0.1, 0.0, 0.0), Vec3::new(1.0, 0.3, -0.2), Vec3::Y, [1.6, 1.2]);
    assert!((plane.normal().dot(Vec3::new(1.0, 0.3, -0.2).normalize()) - 1.0).abs() < 1e-6);
    assert!(plane.up.y > 0.0 && (plane.across.length() - 0.8).abs() < 1e-6);
    let grid = Grid { columns: 8, rows: 6 };
    let found =
        traffic(&source(&rays, "", u64::MAX), &plane, grid, usize::MAX, &Progress::hidden()).expect("whole");
    // The ends of a segment are on different sides, and the point between them is within.
    let unit = (plane.across.normalize().as_dvec3(), plane.up.normalize().as_dvec3());
    let passes = |record: &Record| {
        let segment = record.effective_segment();
        let at = |t: f32| segment.origin.as_dvec3() + f64::from(t.min(1e4)) * segment.direction.as_dvec3();
        let side = |t: f32| (at(t) - plane.center.as_dvec3()).dot(unit.0.cross(unit.1));
        let (first, last) = (side(segment.tnear), side(segment.tfar));
        if first * last > 0.0 {
            return None;
        }
        let (start, end) = (at(segment.tnear), at(segment.tfar));
        let point = start + first / (first - last) * (end - start) - plane.center.as_dvec3();
        let place = [point.dot(unit.0) / 0.8, point.dot(unit.1) / 0.6];
        place.iter().all(|x| x.abs() <= 1.0).then_some(place)
    };
    let expected: Vec<(u64, [f64; 2])> =
        (0..800).filter_map(|number| Some((number, passes(&scene.records[number as usize])?))).collect();
    assert!(expected.len() > 60, "{}", expected.len());
    assert_eq!(found.points.len(), expected.len());
    for (point, (number, place)) in found.points.iter().zip(&expected) {
        let record = &scene.records[*number as usize];
        assert_eq!((point.query, point.hit), (*number, record.is_hit()));
        assert_eq!(point.purpose, Purpose::from_byte(record.purpose));
        assert!((0..2).all(|axis| (f64::from(point.place[axis]) - place[axis]).abs() < 1e-4));
    }
    assert_eq!(found.hits + found.misses, expected.len() as u64);
    for (cell, (hits, misses)) in found.hits_by_cell.iter().zip(&found.misses_by_cell).enumerate() {
        let [a, b] = grid.middle(cell);
        let inside = |point: &&embree_trace::explore::crossing::Point| {
            (point.place[0] - a).abs() < 1.0 / 8.0 && (point.place[1] - b).abs() < 1.0 / 6.0
        };
        let inside = found.points.iter().filter(inside);
        assert_eq!(inside.clone().filter(|point| point.hit).count() as u32, *hits);
        assert_eq!(inside.filter(|point| !point.hit).count() as u32, *misses);
    }
    let few = traffic(&source(&rays, "", u64::MAX), &plane, grid, 10, &Progress::hidden()).expect("whole");
    assert_eq!((few.points.len(), few.hits, few.hits_by_cell), (10, found.hits, found.hits_by_cell));
}

#[test]
fn rays_in_and_beside_a_plane_do_not_pass_it() {
    let plane = Plane { center: Vec3::ZERO, across: 2.0 * Vec3::X, up: Vec3::new(1.0, 1.0, 0.0) };
    let ray = |origin: [f32; 3], direction: [f32; 3], tfar: f32| {
        plane.crossing(&Ray { origin: origin.into(), tnear: 0.0, direction: direction.into(), tfar })
    };
    // The axes need not be perpendicular: (2, 0.5, 0) is 0.75 across and 0.5 up.
    assert_eq!(ray([2.0, 0.5, -2.0], [0.0, 0.0, 1.0], 9.0), Some((2.0, [0.75, 0.5])));
    assert_eq!(ray([2.0, 0.5, -2.0], [0.0, 0.0, 1.0], 1.9), None);
    assert_eq!(ray([2.0, 0.5, -2.0], [0.0, 0.0, -1.0], 9.0), None);
    assert_eq!(ray([3.0, 0.0, 0.0], [-1.0, 0.0, 0.0], 9.0), None);
    assert_eq!(ray([f32::NAN, 0.5, -2.0], [0.0, 0.0, 1.0], 9.0), None);
}

#[test]
fn overlapping_boxes_are_those_of_a_loop_over_all_nodes() {
    let scene = Scene::new(1, 1);
    let plane = Plane::facing(Vec3::ZERO, Vec3::Z, Vec3::Y, [2.4, 2.4]);
    let grid = Grid { columns: 9, rows: 7 };
    for tree in scene.trees() {
        let walk = Walk::new(tree.view(), scene.triangles.len());
        for levels in [0..=usize::MAX, 3..=3, 2..=5] {
            let found = overlaps(tree.view(), &plane, grid, levels.clone());
            for (cell, count) in found.iter().enumerate() {
                let point = plane.at(grid.middle(cell));
                let holds = |&node: &u32| {
                    let bounds = tree.nodes[node as usize].bounds();
                    levels.contains(&walk.level(node))
                        && bounds.contains(&Aabb { lower: point, upper: point })
                };
                assert_eq!((0..tree.nodes.len() as u32).filter(holds).count() as u32, *count);
            }
            assert!(found.iter().any(|&count| count > 1));
        }
    }
}
