//! One query step by step: against the counts of the same kernels, box tests one by one, and the answers of brute force.

use super::{Scene, asked, choice};
use embree_trace::explore::rays::{Kept, fetch};
use embree_trace::explore::steps::{Event, Steps, Waiting, question};
use embree_trace::geometry::{Ray, Vec3};
use embree_trace::traverse::{Counts, Link, Observer, PreparedRay, Scratch, Traversal};

/// What the kernel itself says that waits, after each visit and each pop.
#[derive(Default)]
struct Snapshots {
    now: Vec<(u32, f32)>,
    all: Vec<Vec<(u32, f32)>>,
}

impl Observer for Snapshots {
    fn waiting(&mut self, _followed: Option<&Link>, waiting: &[Link]) {
        self.now = waiting.iter().map(|link| (link.node, link.entry)).collect();
        self.all.push(self.now.clone());
    }

    fn popped(&mut self, link: &Link, _followed: bool) {
        assert_eq!(self.now.pop(), Some((link.node, link.entry)));
        self.all.push(self.now.clone());
    }
}

#[test]
fn steps_are_what_the_kernels_do() {
    let scene = Scene::new(400, 90);
    let (mut culled, mut left, mut deepest) = (0, 0, 0);
    for tree in scene.trees() {
        let prepared = scene.prepared(&tree);
        for traversal in Traversal::ALL {
            let asked = asked(&tree, &prepared, traversal);
            for number in 0..400 {
                let kept = fetch(&scene.rays(), &choice(""), number).expect("whole").expect("there");
                let query = kept.query();
                let record = &scene.records[number as usize];
                assert_eq!(&kept.record, record);
                let steps = Steps::of(&asked, tree.view(), &query);
                // Totals and answer of the kernels, watched and unwatched, and of brute force.
                let (mut counts, scratch) = (Counts::default(), &mut Scratch::default());
                assert_eq!(steps.answer, asked.ask(&query, &mut counts, scratch));
                assert_eq!(steps.answer.is_some(), asked.ask(&query, &mut (), scratch).is_some());
                let last = steps.steps.last().expect("the root's");
                assert_eq!(last.counts, counts);
                assert_eq!(steps.answer.is_some(), record.is_hit());
                if let (Some(hit), false) = (steps.answer, record.is_occlusion()) {
                    assert_eq!(hit.triangle, record.triangle);
                    assert!((hit.t - record.t).abs() <= 1e-4 * record.t.abs() + 1e-5);
                    assert_eq!(last.end, hit.t);
                }
                // What waits is what the kernel says.
                let mut snapshots = Snapshots::default();
                asked.ask(&query, &mut snapshots, scratch);
                let mut real = snapshots.all.iter();
                let ray = PreparedRay::new(&query.ray);
                let mut before = &steps.steps[0];
                for (place, step) in steps.steps.iter().enumerate() {
                    let state = steps.state_at(place);
                    match &step.event {
                        Event::Root { entry } => {
                            assert_eq!((place, step.counts.box_tests, state.len()), (0, 1, 0));
                            assert_eq!(*entry, ray.entry(&tree.nodes[0].bounds(), ray.tfar));
                        }
                        Event::Visit { node, children, followed, pushed } => {
                            let range = tree.nodes[*node as usize].range();
                            assert_eq!(step.counts.box_tests - before.counts.box_tests, range.len() as u64);
                            assert!(children.iter().map(|child| child.node as usize).eq(range));
                            for child in children {
                                let bounds = tree.nodes[child.node as usize].bounds();
                                assert_eq!(child.entry, ray.entry(&bounds, before.end));
                                let waits = pushed.iter().any(|other| other.node == child.node);
                                assert_eq!(child.entry.is_some(), waits || *followed == Some(child.node));
                            }
                        }
                        Event::Triangle { triangle, hit, leaf } => {
                            assert!(tree.primitives[tree.nodes[*leaf as usize].range()].contains(triangle));
                            assert_eq!(step.counts.primitive_tests, before.counts.primitive_tests + 1);
                            assert!(hit.is_none_or(|t| t <= before.end && t == step.end));
                            assert!(hit.is_some() || step.end == before.end);
                        }
                        Event::Taken(waiting) => assert!(waiting.entry <= step.end),
                        Event::Culled(waiting) => {
                            culled += 1;
                            assert!(waiting.entry > step.end);
                            if traversal == Traversal::RayOrder {
                                assert_eq!(place, steps.steps.len() - 1);
                                assert!(state.iter().all(|other| other.entry >= waiting.entry));
                            }
                        }
                        Event::Leaf { node } => assert!(tree.nodes[*node as usize].is_leaf()),
                    }
                    if matches!(step.event, Event::Visit { .. } | Event::Taken(_) | Event::Culled(_)) {
                        let told = real.next().expect("as many as the kernel tells of").iter().rev();
                        let told: Vec<Waiting> = told.map(|&(node, entry)| Waiting { entry, node }).collect();
                        assert_eq!(state, told, "{traversal:?} {number} {place}");
                    }
                    deepest = deepest.max(state.len());
                    before = step;
                }
                assert!(real.next().is_none());
                left += usize::from(!steps.state_at(usize::MAX - 1).is_empty());
            }
        }
    }
    assert!(culled > 100 && left > 100 && deepest > 5, "{culled} {left} {deepest}");
}

#[test]
fn a_question_of_ones_own_is_followed_too() {
    let scene = Scene::new(1, 1);
    let tree = &scene.trees()[1];
    let prepared = scene.prepared(tree);
    let target = scene.triangles[17].centroid();
    let origin = Vec3::new(0.0, 5.0, 0.0);
    let ray = Ray { origin, tnear: 0.0, direction: target - origin, tfar: f32::INFINITY };
    for (occlusion, traversal) in [(false, Traversal::Odf), (true, Traversal::RayOrder)] {
        let kept = Kept::from(question(ray, occlusion));
        let steps = Steps::of(&asked(tree, &prepared, traversal), tree.view(), &kept.query());
        let hit = steps.answer.expect("there is a triangle on the way");
        assert!(hit.t <= 1.0001);
        let last = steps.point_at(&kept.query(), steps.steps.len() - 1);
        assert!(last.is_none_or(|point| point.is_finite()));
        let entry = steps.point_at(&kept.query(), 0).expect("the root is entered");
        assert!(tree.nodes[0].bounds().lower.cmple(entry + 1e-4).all());
    }
    let away = Kept::from(question(Ray { direction: Vec3::Y, ..ray }, false));
    let steps = Steps::of(&asked(tree, &prepared, Traversal::Odf), tree.view(), &away.query());
    assert_eq!((steps.steps.len(), steps.answer), (1, None));
    assert_eq!(steps.steps[0].event, Event::Root { entry: None });
    assert_eq!(steps.point_at(&away.query(), 0), None);
}
