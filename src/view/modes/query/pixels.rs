//! The recorded image as costs of its pixels, to pick one from.

use crate::explore::heat::per_pixel;
use crate::explore::queries::{Asked, Source};
use crate::replay::pixels::ImageSize;
use crate::traverse::Traversal;
use crate::view::heat::Scale;
use crate::view::paint::{ColorMap, Rgba, color32};
use crate::view::panels;
use crate::view::results::{COSTS, every_query};
use crate::view::shared::Shared;
use crate::view::work::Latest;
use eframe::egui::{self, Color32, ColorImage, Sense, Stroke, TextureHandle, TextureOptions, Ui, vec2};
use std::sync::Arc;

/// Queries that are asked.
const LOOKED_AT: u64 = 2_000_000;

/// Costs of all pixels as colours.
struct PixelMap {
    size: ImageSize,
    colors: Vec<Rgba>,
    scale: Scale,
}

/// The map of the active tree, made in the background.
#[derive(Default)]
pub struct Pixels {
    map: Latest<(usize, Traversal), PixelMap>,
    /// On the graphics card, and which map it is of.
    texture: Option<(usize, TextureHandle)>,
}

impl Pixels {
    /// Has the map made, where the size of the image is known.
    pub fn ask(&mut self, shared: &Shared) {
        let Some(recording) = &shared.opened.recording else { return };
        let Some(size) = recording.image else { return };
        let steps = recording.rays.query_count();
        let (own, tree, traversal) = (recording.clone(), shared.tree().clone(), shared.traversal);
        self.map.ask(&(shared.active, traversal), steps, &shared.wake, move |progress| {
            let asked = Asked { prepared: &tree.prepared, traversal, order: &tree.order };
            let source = Source { rays: &own.rays, choice: every_query(), limit: LOOKED_AT };
            let found = per_pixel(&asked, &source, size, progress);
            let (pixels, _) = found.map_err(|error| error.to_string())?;
            let costs = pixels.costs(&COSTS);
            let scale = Scale::of(&costs).ok_or("no query says which pixel it serves")?;
            let color = |&cost: &f64| ColorMap::Viridis.color(scale.share(cost));
            Ok(PixelMap { size, colors: costs.iter().map(color).collect(), scale })
        });
    }

    pub fn is_settled(&self) -> bool {
        self.map.fraction().is_none()
    }

    /// Shows the map with a mark at pixel `current`; returns the one that is clicked.
    pub fn ui(&mut self, ui: &mut Ui, shared: &Shared, current: Option<u32>) -> Option<u32> {
        let Some(map) = self.map.value.clone() else {
            match (&self.map.error, self.map.fraction()) {
                (Some(error), _) => ui.weak(error),
                (None, Some(done)) => ui.weak(format!("costs of pixels: {:.0}%", 100.0 * done)),
                (None, None) => ui.weak("The tree does not say how large the recorded image is."),
            };
            return None;
        };
        let size = [map.size.width as usize, map.size.height as usize];
        let stamp = Arc::as_ptr(&map) as usize;
        if self.texture.as_ref().is_none_or(|(old, _)| *old != stamp) {
            let pixels = map.colors.iter().map(|&color| color32(color)).collect();
            let texture =
                ui.ctx().load_texture("pixels", ColorImage::new(size, pixels), TextureOptions::NEAREST);
            self.texture = Some((stamp, texture));
        }
        let (_, texture) = self.texture.as_ref()?;
        let width = ui.available_width();
        let shown = vec2(width, width * size[1] as f32 / size[0] as f32);
        let (area, response) = ui.allocate_exact_size(shown, Sense::click_and_drag());
        let whole = egui::Rect::from_min_max(egui::pos2(0.0, 0.0), egui::pos2(1.0, 1.0));
        ui.painter().image(texture.id(), area, whole, Color32::WHITE);
        if let Some((x, y)) = current.and_then(|path| map.size.pixel(path)) {
            let place = vec2((x as f32 + 0.5) / size[0] as f32, (y as f32 + 0.5) / size[1] as f32);
            let center = area.min + place * area.size();
            ui.painter().circle_stroke(center, 5.0, Stroke::new(2.0, Color32::WHITE));
            ui.painter().circle_stroke(center, 7.0, Stroke::new(1.0, Color32::BLACK));
        }
        let pointer = response.interact_pointer_pos().filter(|_| response.clicked() || response.dragged());
        response
            .on_hover_text("The recorded image, by what the queries of each pixel cost. Click to pick one.");
        let title = format!("tests per pixel, {}", shared.tree().name());
        panels::legend(ui, &map.scale.legend(&title, ColorMap::Viridis));
        let place = (pointer? - area.min) / area.size();
        let pixel = |share: f32, side: usize| ((share * side as f32).max(0.0) as usize).min(side - 1) as u32;
        Some(pixel(place.y, size[1]) * map.size.width + pixel(place.x, size[0]))
    }
}
