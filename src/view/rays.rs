//! The layer of recorded rays: which are chosen, and what they look like.

use super::layers::{RayColor, RayLayer};
use super::load::{OpenTree, Recording};
use super::overlay::{Batch, Line, Overlay, Point, Shapes};
use super::paint::{self, HIT, MISS, Rgba, color_of_cost, color_of_depth};
use super::shared::Legend;
use super::work::{Latest, Wake};
use crate::explore::queries::{Sampled, Source};
use crate::explore::rays::{Segment, Wanted, segments};
use crate::format::rays::{NO_DEPTH, Purpose};
use crate::geometry::Aabb;
use crate::random::mixed;
use crate::replay::query::Choice;
use crate::replay::select::Filter;
use crate::traverse::Traversal;
use std::sync::Arc;

/// Records that are looked at for rays to draw; where few of them are wanted, up to so many.
const LOOKED_AT: [u64; 3] = [1 << 20, 1 << 23, 1 << 26];

/// What decides which rays are drawn.
#[derive(Clone, Debug, PartialEq)]
struct Question {
    filter: String,
    hit: Option<bool>,
    every: u64,
    most: usize,
    color: RayColor,
    /// For costs.
    traversal: Option<(usize, Traversal)>,
}

/// Rays as they are drawn.
#[derive(Debug)]
pub struct Drawn {
    pub segments: Vec<Segment>,
    lines: Arc<Vec<Line>>,
    points: Arc<Vec<Point>>,
    /// How many there would be.
    pub matched: u64,
    pub sampled: Sampled,
    pub legend: Legend,
}

/// The layer's rays, chosen in the background.
#[derive(Default)]
pub struct Rays {
    latest: Latest<Question, Drawn>,
}

/// The filter of a layer; `None` when it lets nothing through.
fn filter(layer: &RayLayer) -> Option<String> {
    let chosen: Vec<&str> = Purpose::ALL
        .into_iter()
        .filter(|&purpose| layer.purposes[purpose as usize])
        .map(Purpose::name)
        .collect();
    let mut conditions = Vec::new();
    if chosen.len() < Purpose::ALL.len() {
        conditions.push(format!("purpose={}", chosen.join("+")));
    }
    conditions.extend(layer.depth.map(|depth| format!("depth={depth}")));
    let something = !chosen.is_empty() && (layer.hits || layer.misses);
    something.then(|| conditions.join(","))
}

impl Rays {
    /// Brings the rays up to date with the layer.
    pub fn update(
        &mut self,
        layer: &RayLayer,
        (number, tree): (usize, &Arc<OpenTree>),
        recording: &Arc<Recording>,
        traversal: Traversal,
        bounds: Aabb,
        wake: &Wake,
    ) {
        let chosen = filter(layer).filter(|_| layer.visible || layer.points);
        let Some(filter) = chosen else { return self.latest.forget() };
        let question = Question {
            filter,
            hit: if layer.hits && layer.misses { None } else { Some(layer.hits) },
            every: layer.every,
            most: layer.most,
            color: layer.color,
            traversal: (layer.color == RayColor::Cost).then_some((number, traversal)),
        };
        let (tree, recording, asked) = (tree.clone(), recording.clone(), question.clone());
        let steps = recording.rays.query_count();
        self.latest.ask(&question, steps, wake, move |progress| {
            let filter: Filter = asked.filter.parse().map_err(|error| format!("{error}"))?;
            let choice = Choice { scene: recording.scene, filter, held_out: None, sample: None };
            let cost = asked.traversal.map(|(_, traversal)| (tree.asked(traversal), 0.0..=f64::INFINITY));
            let wanted = Wanted { hit: asked.hit, cost, every: asked.every, most: asked.most };
            let mut found = None;
            for limit in LOOKED_AT {
                let source = Source { rays: &recording.rays, choice: choice.clone(), limit };
                let now = segments(&source, &wanted, &bounds, progress).map_err(|error| error.to_string())?;
                let enough = now.list.len() >= asked.most || now.sampled.is_all() || progress.is_stopped();
                found = Some(now);
                if enough {
                    break;
                }
            }
            let found = found.ok_or("no rays were looked for")?;
            Ok(drawn(found.list, found.matched, found.sampled, asked.color))
        });
    }

    pub fn is_busy(&self) -> bool {
        self.latest.fraction().is_some()
    }

    pub fn drawn(&self) -> Option<&Arc<Drawn>> {
        self.latest.value.as_ref()
    }

    pub fn error(&self) -> Option<&str> {
        self.latest.error.as_deref()
    }

    /// Draws them.
    pub fn overlay(&self, layer: &RayLayer, overlay: &mut Overlay) {
        let Some(drawn) = self.drawn() else { return };
        let mut batch = |shapes, opacity, scale| {
            overlay.batches.push(Batch { shapes, opacity, behind: layer.behind, scale, thinned: true });
        };
        if layer.visible {
            batch(Shapes::Lines(drawn.lines.clone()), layer.opacity, layer.width);
        }
        if layer.points {
            batch(Shapes::Points(drawn.points.clone()), (2.0 * layer.opacity).min(1.0), layer.size);
        }
    }
}

/// Lines and points of segments, in an order of which every beginning is a fair sample.
fn drawn(mut segments: Vec<Segment>, matched: u64, sampled: Sampled, by: RayColor) -> Drawn {
    segments.sort_by_key(|segment| mixed(segment.query));
    let mut costs: Vec<f32> =
        segments.iter().map(|segment| segment.cost).filter(|cost| !cost.is_nan()).collect();
    costs.sort_by(f32::total_cmp);
    let high = costs.get(costs.len().saturating_sub(1) * 99 / 100).copied().unwrap_or(1.0).max(1.0);
    let color = |segment: &Segment| -> Rgba {
        match by {
            RayColor::Purpose => paint::purpose(segment.purpose),
            RayColor::Depth => color_of_depth(segment.depth),
            RayColor::Hit => {
                if segment.hit {
                    HIT
                } else {
                    MISS
                }
            }
            RayColor::Cost => color_of_cost(f64::from(segment.cost / high)),
        }
    };
    let width = 1.0;
    let lines = segments.iter().map(|segment| Line {
        from: segment.from,
        width,
        to: segment.to,
        color: color(segment),
    });
    let ends = segments.iter().filter(|segment| segment.hit && !segment.is_occlusion);
    let points = ends.map(|segment| Point { at: segment.to, size: 1.0, color: color(segment) });
    let kinds = match by {
        RayColor::Purpose => Purpose::ALL
            .into_iter()
            .filter(|&purpose| segments.iter().any(|segment| segment.purpose == purpose))
            .map(|purpose| (paint::purpose(purpose), purpose.name().to_owned()))
            .collect(),
        RayColor::Depth => {
            let mut depths: Vec<u8> = segments.iter().map(|segment| segment.depth).collect();
            depths.sort_unstable();
            depths.dedup();
            let name =
                |depth| if depth == NO_DEPTH { "unknown".to_owned() } else { format!("depth {depth}") };
            depths.into_iter().take(10).map(|depth| (color_of_depth(depth), name(depth))).collect()
        }
        RayColor::Hit => vec![(HIT, "hits".to_owned()), (MISS, "misses".to_owned())],
        RayColor::Cost => Vec::new(),
    };
    let title = "rays".to_owned();
    let legend = match by {
        RayColor::Cost => Legend::Scale {
            title: "cost per ray, ns".to_owned(),
            low: "0".to_owned(),
            high: format!("{high:.0} or more"),
            map: paint::ColorMap::Inferno,
        },
        _ => Legend::Kinds { title, kinds },
    };
    let (lines, points) = (Arc::new(lines.collect()), Arc::new(points.collect()));
    Drawn { lines, points, matched, sampled, legend, segments }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::layers::Layers;

    #[test]
    fn a_layer_says_which_rays() {
        let mut layer = Layers::default().rays;
        assert_eq!(filter(&layer), Some(String::new()));
        layer.depth = Some(2);
        layer.purposes = [false, true, false, false, true, false];
        assert_eq!(filter(&layer), Some("purpose=camera+diffuse,depth=2".to_owned()));
        assert!(filter(&layer).is_some_and(|text| text.parse::<Filter>().is_ok()));
        layer.purposes = [false; 6];
        assert_eq!(filter(&layer), None);
    }
}
