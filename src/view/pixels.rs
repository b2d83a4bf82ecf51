//! The recorded image as a heat map: what the queries of each pixel cost in a tree, or how much more in one tree than in the other.
//!
//! Costs are counted in the background, tree by tree. From where the recording's camera stood, the map lies over the picture, and follows it as one
//! looks around; from anywhere else it stands in a corner.

use super::heat::{Scale, differences_of, short};
use super::layers::{PixelColor, PixelLayer};
use super::load::{OpenTree, Recording};
use super::paint::color32;
use super::panels;
use super::results::{COSTS, every_query};
use super::shared::{Legend, Shared};
use super::work::{Latest, Wake};
use crate::explore::heat::{PixelWork, per_pixel};
use crate::explore::queries::Source;
use crate::render::camera::{Camera, View};
use crate::replay::pixels::ImageSize;
use crate::traverse::Traversal;
use eframe::egui::{
    self, Color32, ColorImage, Mesh, Pos2, Rect, Sense, Stroke, StrokeKind, TextureHandle, TextureOptions,
    Ui, pos2, vec2,
};
use std::sync::Arc;

/// Queries that are asked.
const LOOKED_AT: u64 = 2_000_000;
/// Cells of the map, in each direction, when it lies over a picture: straight lines stay straight to within a pixel.
const CELLS: usize = 24;
/// An eye may be so far from the camera's, in diagonals of the scene.
const SAME_PLACE: f32 = 1e-3;
/// Width of the map in a corner, in widths of the picture, and its height at most.
const CORNER: [f32; 2] = [0.32, 0.45];

/// A map as it was last coloured, and from what.
struct Colored {
    stamps: Vec<usize>,
    layer: PixelLayer,
    texture: TextureHandle,
    legend: Legend,
}

/// A map to be drawn.
struct Map {
    size: ImageSize,
    texture: egui::TextureId,
    legend: Legend,
}

/// The maps of all trees.
#[derive(Default)]
pub struct Pixels {
    work: Vec<Latest<Traversal, PixelWork>>,
    colored: Vec<Option<Colored>>,
}

impl Pixels {
    /// Has the costs of a tree's pixels counted, where the size of the image is known.
    pub fn ask(
        &mut self,
        number: usize,
        tree: &Arc<OpenTree>,
        recording: &Arc<Recording>,
        traversal: Traversal,
        wake: &Wake,
    ) {
        let Some(size) = recording.image else { return };
        self.work.resize_with(self.work.len().max(number + 1), Latest::default);
        let steps = recording.rays.query_count();
        let (tree, recording) = (tree.clone(), recording.clone());
        self.work[number].ask(&traversal, steps, wake, move |progress| {
            let source = Source { rays: &recording.rays, choice: every_query(&recording), limit: LOOKED_AT };
            let work = per_pixel(&tree.asked(traversal), &source, size, &COSTS, progress);
            let work = work.map_err(|error| error.to_string())?;
            // Every query tests the root's box.
            if work.gammas.iter().all(|&gamma| gamma == 0.0) {
                return Err("no query says which pixel it serves".to_owned());
            }
            Ok(work)
        });
    }

    pub fn is_busy(&self) -> bool {
        self.work.iter().any(|work| work.fraction().is_some())
    }

    /// The map of a tree as the layer wants it, once what it needs has been counted.
    fn map(&mut self, context: &egui::Context, layer: &PixelLayer, number: usize) -> Option<Map> {
        let trees = match layer.color {
            PixelColor::Cost | PixelColor::Tests => vec![number],
            PixelColor::Difference => vec![0, 1],
        };
        let work: Vec<Arc<PixelWork>> =
            trees.iter().map(|&tree| self.work.get(tree)?.value.clone()).collect::<Option<_>>()?;
        let stamps: Vec<usize> = work.iter().map(|work| Arc::as_ptr(work) as usize).collect();
        let size = work.first()?.size;
        self.colored.resize_with(self.colored.len().max(number + 1), || None);
        let colored = &mut self.colored[number];
        let fits = |old: &Colored| old.stamps == stamps && old.layer.colors_as(layer);
        if !colored.as_ref().is_some_and(fits) {
            let (colors, legend) = match &work[..] {
                [first, second] => differences(&first.costs, &second.costs),
                _ => {
                    let (title, values) = match layer.color {
                        PixelColor::Tests => ("box and triangle tests per pixel", &work[0].gammas),
                        _ => ("cost per pixel, ns", &work[0].costs),
                    };
                    let scale = Scale::of(values)?;
                    let color = |&value: &f64| layer.map.color(scale.share(value));
                    (values.iter().map(color).collect(), scale.legend(title, layer.map))
                }
            };
            let pixels = colors.into_iter().map(color32).collect();
            let image = ColorImage::new([size.width as usize, size.height as usize], pixels);
            let texture = context.load_texture(format!("pixels {number}"), image, TextureOptions::NEAREST);
            *colored = Some(Colored { stamps, layer: layer.clone(), texture, legend });
        }
        let colored = colored.as_ref()?;
        Some(Map { size, texture: colored.texture.id(), legend: colored.legend.clone() })
    }

    /// What is to be said while there is no map of a tree.
    fn excuse(&self, number: usize) -> String {
        match self.work.get(number) {
            None => {
                "The tree does not say how large the recorded image is: start with --image WxH.".to_owned()
            }
            Some(Latest { error: Some(error), .. }) => error.clone(),
            Some(work) => format!("costs of pixels: {:.0}%", 100.0 * work.fraction().unwrap_or(0.0)),
        }
    }
}

/// Colours of what pixels cost more in the first tree (orange) than in the second (blue).
fn differences(first: &[f64], second: &[f64]) -> (Vec<super::paint::Rgba>, Legend) {
    let differences: Vec<f64> = first.iter().zip(second).map(|(a, b)| a - b).collect();
    let (high, colors) = differences_of(&differences);
    let legend = Legend::Difference {
        title: "cost per pixel, ns, left - right".to_owned(),
        low: format!("-{}", short(high)),
        high: format!("+{}", short(high)),
    };
    (colors, legend)
}

/// Points of the image, a grid of [`CELLS`], where they appear to a camera that stands where the image's stood; `None` behind it.
fn sheet(recorded: &Camera, camera: &Camera, size: ImageSize) -> Vec<Option<[f32; 2]>> {
    let along = |step: usize, side: u32| step as f32 / CELLS as f32 * side as f32;
    let points = (0..=CELLS).flat_map(|y| (0..=CELLS).map(move |x| (x, y)));
    points
        .map(|(x, y)| {
            let ray = recorded.ray(along(x, size.width), along(y, size.height));
            camera.project(camera.eye + ray.direction).map(|(place, _)| place)
        })
        .collect()
}

/// Draws the map of a tree over its picture, or into a corner of it; returns what its colours mean.
pub fn show(ui: &Ui, shared: &mut Shared, number: usize, rect: Rect) -> Option<Legend> {
    let layer = shared.layers.pixels.clone();
    if !layer.visible {
        return None;
    }
    let Map { size, texture, legend } = shared.pixels.map(ui.ctx(), &layer, number)?;
    let tint = Color32::WHITE.gamma_multiply(layer.opacity);
    let painter = ui.painter().with_clip_rect(rect);
    match over(shared, size, rect) {
        Some(places) => {
            painter.add(mesh(&places, texture, tint));
        }
        None => {
            let width = (CORNER[0] * rect.width()).min(CORNER[1] * rect.height() * aspect(size));
            let corner = Rect::from_min_size(
                pos2(rect.right() - width - 10.0, rect.top() + 10.0),
                vec2(width, width / aspect(size)),
            );
            painter.image(texture, corner, whole(), tint);
            painter.rect_stroke(corner, 0.0, Stroke::new(1.0, Color32::from_gray(140)), StrokeKind::Outside);
        }
    }
    // One legend is enough for a map that is the same in both pictures.
    (layer.color != PixelColor::Difference || number == 0).then_some(legend)
}

fn aspect(size: ImageSize) -> f32 {
    size.width as f32 / size.height as f32
}

/// Where the map's grid appears in a picture; `None` when one does not stand where the image was taken.
fn over(shared: &Shared, size: ImageSize, rect: Rect) -> Option<Vec<Option<Pos2>>> {
    let recorded: View = shared.opened.recording.as_ref()?.view?;
    let view = shared.camera.view;
    if recorded.eye.distance(view.eye) > SAME_PLACE * shared.opened.size() {
        return None;
    }
    let (width, height) = (rect.width().max(1.0), rect.height().max(1.0));
    let recorded = Camera::new(&recorded, size.width, size.height).ok()?;
    let camera = Camera::new(&view, width as u32, height as u32).ok()?;
    let (across, down) = (rect.width() / width.floor(), rect.height() / height.floor());
    let place = |[x, y]: [f32; 2]| rect.min + vec2(x * across, y * down);
    Some(sheet(&recorded, &camera, size).into_iter().map(|point| point.map(place)).collect())
}

fn mesh(places: &[Option<Pos2>], texture: egui::TextureId, tint: Color32) -> Mesh {
    let mut mesh = Mesh::with_texture(texture);
    let side = CELLS + 1;
    for (index, place) in places.iter().enumerate() {
        let share = |step: usize| step as f32 / CELLS as f32;
        let uv = pos2(share(index % side), share(index / side));
        mesh.vertices.push(egui::epaint::Vertex { pos: place.unwrap_or_default(), uv, color: tint });
    }
    for cell in (0..CELLS * side).filter(|cell| cell % side < CELLS) {
        let corners = [cell, cell + 1, cell + side, cell + side + 1];
        if corners.iter().all(|&corner| places[corner].is_some()) {
            let [a, b, c, d] = corners.map(|corner| corner as u32);
            mesh.add_triangle(a, b, c);
            mesh.add_triangle(c, b, d);
        }
    }
    mesh
}

/// All of a texture.
fn whole() -> Rect {
    Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0))
}

/// Shows the map of the active tree in a panel, with a mark at pixel `current`; returns the pixel that is clicked.
pub fn picker(ui: &mut Ui, shared: &mut Shared, current: Option<u32>) -> Option<u32> {
    let Some(Map { size, texture, legend }) =
        shared.pixels.map(ui.ctx(), &shared.layers.pixels, shared.active)
    else {
        ui.weak(shared.pixels.excuse(shared.active));
        return None;
    };
    let sides = [size.width, size.height];
    let width = ui.available_width();
    let (area, response) = ui.allocate_exact_size(vec2(width, width / aspect(size)), Sense::click_and_drag());
    ui.painter().image(texture, area, whole(), Color32::WHITE);
    if let Some((x, y)) = current.and_then(|path| size.pixel(path)) {
        let place = vec2((x as f32 + 0.5) / size.width as f32, (y as f32 + 0.5) / size.height as f32);
        let center = area.min + place * area.size();
        ui.painter().circle_stroke(center, 5.0, Stroke::new(2.0, Color32::WHITE));
        ui.painter().circle_stroke(center, 7.0, Stroke::new(1.0, Color32::BLACK));
    }
    let pointer = response.interact_pointer_pos().filter(|_| response.clicked() || response.dragged());
    response.on_hover_text("The recorded image, by what the queries of each pixel cost. Click to pick one.");
    ui.small(shared.tree().name());
    panels::legend(ui, &legend);
    let place = (pointer? - area.min) / area.size();
    let pixel = |share: f32, side: u32| ((share * side as f32).max(0.0) as u32).min(side - 1);
    Some(pixel(place.y, sides[1]) * size.width + pixel(place.x, sides[0]))
}

/// The layer's entry in the list of what can be seen.
pub fn settings(ui: &mut Ui, shared: &mut Shared) {
    let two = shared.opened.trees.len() == 2;
    let excuse = (0..shared.opened.trees.len())
        .find(|&number| shared.pixels.work.get(number).is_none_or(|work| work.value.is_none()))
        .map(|number| shared.pixels.excuse(number));
    let PixelLayer { visible, opacity, color, map } = &mut shared.layers.pixels;
    let mut there = false;
    let hint = "What the queries of each pixel cost: over the picture where one stands where the image was taken, else in a corner";
    panels::section(ui, visible, "Recorded image", hint, |ui| {
        let is_possible = |color: &PixelColor| two || *color != PixelColor::Difference;
        let possible: Vec<PixelColor> = PixelColor::ALL.into_iter().filter(is_possible).collect();
        panels::choose(ui, "pixels", color, &possible, |color| color.name().to_owned());
        if *color != PixelColor::Difference {
            panels::choose(ui, "pixel map", map, &super::paint::ColorMap::ALL, |map| map.name().to_owned());
        }
        panels::opacity(ui, opacity);
        there = ui.button("stand where it was taken").clicked();
        if let Some(excuse) = excuse {
            ui.weak(excuse);
        }
    });
    if there && shared.opened.recording.as_ref().is_some_and(|recording| recording.view.is_some()) {
        shared.camera.view = shared.opened.start;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec3;

    #[test]
    fn the_image_lies_where_it_was_taken() {
        let view = View { eye: Vec3::new(1.0, 2.0, 3.0), target: Vec3::ZERO, up: Vec3::Y, fov_degrees: 60.0 };
        let size = ImageSize::new(40, 30).expect("a size");
        let recorded = Camera::new(&view, 40, 30).expect("a camera");
        let side = CELLS + 1;
        // The same camera in a window of the same height, but twice as wide: the image covers its middle half.
        let wide = Camera::new(&view, 160, 60).expect("a camera");
        let places = sheet(&recorded, &wide, size);
        let corner = |index: usize| places[index].expect("before the eye");
        for (index, expected) in [(0, [40.0, 0.0]), (CELLS, [120.0, 0.0]), (side * side - 1, [120.0, 60.0])] {
            let [x, y] = corner(index);
            assert!((x - expected[0]).abs() < 0.01 && (y - expected[1]).abs() < 0.01, "{index}: {x} {y}");
        }
        // Behind one's back there is no image.
        let back = View { target: view.eye + (view.eye - view.target), ..view };
        let back = Camera::new(&back, 160, 60).expect("a camera");
        assert!(sheet(&recorded, &back, size).iter().all(Option::is_none));
    }

    #[test]
    fn differences_are_those_of_the_costs() {
        let (colors, legend) = differences(&[8.0, 1.0, 3.0], &[4.0, 5.0, 3.0]);
        assert!(
            colors[0][0] > colors[0][2] && colors[1][2] > colors[1][0] && colors[2] == [236, 236, 236, 255]
        );
        let Legend::Difference { low, high, .. } = legend else { panic!("{legend:?}") };
        assert_eq!((low.as_str(), high.as_str()), ("-4.0", "+4.0"));
    }
}
