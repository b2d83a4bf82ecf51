//! A query in the scene: its ray, the boxes and the triangle of a step, and the path that it is a part of.

use crate::explore::rays::{Kept, Segment};
use crate::explore::steps::{Event, Steps};
use crate::format::rays::Purpose;
use crate::geometry::Aabb;
use crate::view::overlay::{Line, Overlay, Point, Shapes};
use crate::view::paint::{self, HIT, KINDS, MISS, Rgba, SELECTED};
use crate::view::shared::Shared;
use std::sync::Arc;

/// Waiting boxes that are drawn: those that are taken up next.
const WAITING: usize = 60;
const WHITE: Rgba = [255, 255, 255, 255];

/// The other queries of a path, and where they begin at one another's hits.
pub fn path(shared: &Shared, path: &[Kept], origins: &[Option<usize>], chosen: usize, overlay: &mut Overlay) {
    let others = path.iter().enumerate().filter(|(place, _)| *place != chosen);
    let lines = others.filter_map(|(_, query)| {
        let segment = Segment::of(query.number, &query.record, &shared.opened.bounds)?;
        let color = paint::purpose(Purpose::from_byte(query.record.purpose));
        Some(Line { from: segment.from, width: 1.5, to: segment.to, color })
    });
    overlay.push(Shapes::Lines(Arc::new(lines.collect())), 0.7, 0.4);
    let bounces = path.iter().zip(origins).filter(|(_, origin)| origin.is_some());
    let points = bounces.map(|(query, _)| Point { at: query.record.origin, size: 6.0, color: WHITE });
    overlay.push(Shapes::Points(Arc::new(points.collect())), 1.0, 0.6);
}

/// The query's ray up to where its interval ends in step `here`, and what is tested there.
pub fn step(shared: &Shared, pane: usize, kept: &Kept, steps: &Steps, here: usize, overlay: &mut Overlay) {
    let Some(step) = steps.steps.get(here) else { return };
    let ray = &kept.ray;
    // Far enough to leave the scene, from wherever it comes.
    let reach = 2.0 * (shared.opened.size() + ray.origin.distance(shared.opened.bounds.center()));
    let whole = ray.tfar.min(reach / ray.direction.length().max(f32::MIN_POSITIVE));
    let at = |t: f32| ray.at(t.clamp(ray.tnear, whole.max(ray.tnear)));
    let line = |end: f32, width, color| Line { from: at(ray.tnear), width, to: at(end), color };
    let lines = vec![line(whole, 1.0, [200, 200, 200, 110]), line(step.end, 3.0, WHITE)];
    overlay.push(Shapes::Lines(Arc::new(lines)), 1.0, 0.6);
    boxes(shared, pane, steps, here, overlay);
    if let Event::Triangle { triangle, hit, .. } = step.event {
        let corners = shared.opened.tree(pane).triangles()[triangle as usize].0;
        let color = if hit.is_some() { HIT } else { MISS };
        let edges =
            (0..3).map(|edge| Line { from: corners[edge], width: 2.5, to: corners[(edge + 1) % 3], color });
        overlay.push(Shapes::Lines(Arc::new(edges.collect())), 1.0, 0.6);
    }
    if let Some(at) = steps.point_at(&kept.query(), here) {
        overlay.push(Shapes::Points(Arc::new(vec![Point { at, size: 9.0, color: SELECTED }])), 1.0, 0.6);
    }
}

/// Boxes of a step: the node in question, its children, and what waits.
fn boxes(shared: &Shared, pane: usize, steps: &Steps, here: usize, overlay: &mut Overlay) {
    let nodes = shared.opened.tree(pane).bvh.tree.nodes;
    let bounds = |node: u32| nodes[node as usize].bounds();
    let waiting = steps.state_at(here);
    let waiting: Vec<(Aabb, Rgba, f32)> =
        waiting.iter().take(WAITING).map(|waiting| (bounds(waiting.node), KINDS[1], 0.8)).collect();
    overlay.boxes(&waiting, 0.35, 0.5);
    let mut shown = Vec::new();
    let node = match &steps.steps[here].event {
        Event::Root { .. } => 0,
        Event::Visit { node, children, .. } => {
            for (number, child) in children.iter().enumerate() {
                let (color, width) = match child.entry {
                    Some(_) => (paint::child(number), 2.0),
                    None => ([150, 150, 150, 160], 0.8),
                };
                shown.push((bounds(child.node), color, width));
            }
            *node
        }
        Event::Leaf { node } | Event::Triangle { leaf: node, .. } => *node,
        Event::Taken(waiting) | Event::Culled(waiting) => waiting.node,
    };
    shown.push((bounds(node), SELECTED, 2.5));
    overlay.boxes(&shown, 1.0, 0.45);
}
