//! Costs per pixel as a picture: a title, the image in colours that colour-blind readers can tell apart, and a bar that says
//! what each colour means. All pictures of one comparison share the bar's scale, so that they can be laid side by side.

use super::stem;
use crate::compare::{Comparison, RecordingResult};
use crate::replay::pixels::ImageSize;
use colorous::VIRIDIS;
use image::{Rgb, RgbImage};
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

/// A picture and the name of its file.
pub struct HeatMap {
    pub file_name: String,
    pub picture: RgbImage,
}

const MARGIN: u32 = 16;
const TITLE: RasterHeight = RasterHeight::Size24;
const LABEL: RasterHeight = RasterHeight::Size16;
const BAR_WIDTH: u32 = 24;
/// Pixels are drawn as squares so large that the image is at least this wide or high: small images are not stamps.
const LEAST_SIDE: u32 = 480;
const INK: [u8; 3] = [20, 20, 20];
const PAPER: Rgb<u8> = Rgb([255, 255, 255]);
/// The scale ends at this fraction of the pixels that have a cost: a few extreme ones would leave the rest dark.
pub(super) const SCALE_END: f64 = 0.999;

/// A heat map of every tree under every traversal that summed pixels, for each recording.
pub fn render(comparison: &Comparison) -> Vec<HeatMap> {
    comparison
        .recordings
        .iter()
        .enumerate()
        .flat_map(|(number, recording)| {
            let several = comparison.recordings.len() > 1;
            let prefix =
                if several { format!("{}-{}-", number + 1, stem(&recording.path)) } else { String::new() };
            maps(comparison, recording, &prefix)
        })
        .collect()
}

fn maps(comparison: &Comparison, recording: &RecordingResult, prefix: &str) -> Vec<HeatMap> {
    let costs = &comparison.settings.costs;
    let mut maps = Vec::new();
    for (number, (facts, tree)) in comparison.trees.iter().zip(&recording.trees).enumerate() {
        for run in &tree.runs {
            if let Some(pixels) = &run.outcome.pixels {
                maps.push((number, stem(&facts.path), run.traversal, pixels.size, pixels.costs(costs)));
            }
        }
    }
    let end = scale_end(maps.iter().flat_map(|(.., values)| values.iter().copied()), SCALE_END);
    let mut drawn = Vec::with_capacity(maps.len());
    for (number, stem, traversal, size, values) in maps {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let title = format!("{stem}, {}", traversal.name());
        let caption = format!(
            "cost per pixel = {} x box tests + {} x primitive tests; mean {mean:.1}",
            costs.c_i, costs.c_p
        );
        drawn.push(HeatMap {
            file_name: format!("{prefix}{}-{stem}-{}.png", number + 1, traversal.key()),
            picture: picture(&title, &caption, size, &values, end),
        });
    }
    drawn
}

/// The value at the top of a scale: `fraction` of the positive ones are not above it.
pub(super) fn scale_end(values: impl Iterator<Item = f64>, fraction: f64) -> f64 {
    let mut positive: Vec<f64> = values.filter(|value| *value > 0.0).collect();
    if positive.is_empty() {
        return 1.0;
    }
    let index = ((positive.len() - 1) as f64 * fraction) as usize;
    *positive.select_nth_unstable_by(index, f64::total_cmp).1
}

fn picture(title: &str, caption: &str, size: ImageSize, values: &[f64], end: f64) -> RgbImage {
    let zoom = (LEAST_SIDE / size.width.max(size.height)).max(1);
    let (map_width, map_height) = (size.width * zoom, size.height * zoom);
    let bar_height = map_height.max(160);
    let labels = 18 * get_raster_width(FontWeight::Regular, LABEL) as u32;
    let text_width = (title.chars().count() * get_raster_width(FontWeight::Regular, TITLE))
        .max(caption.chars().count() * get_raster_width(FontWeight::Regular, LABEL))
        as u32;
    let top = MARGIN + TITLE.val() as u32 + LABEL.val() as u32 + MARGIN;
    let bar_left = MARGIN + map_width + MARGIN;
    let width = (bar_left + BAR_WIDTH + labels).max(text_width + MARGIN) + MARGIN;
    let mut image = RgbImage::from_pixel(width, top + bar_height + 2 * MARGIN, PAPER);

    write(&mut image, title, MARGIN, MARGIN, TITLE);
    write(&mut image, caption, MARGIN, MARGIN + TITLE.val() as u32, LABEL);
    for y in 0..map_height {
        for x in 0..map_width {
            let value = values[((y / zoom) * size.width + x / zoom) as usize];
            image.put_pixel(MARGIN + x, top + y, color(value / end));
        }
    }
    for y in 0..bar_height {
        let shade = color(1.0 - f64::from(y) / f64::from(bar_height - 1));
        for x in 0..BAR_WIDTH {
            image.put_pixel(bar_left + x, top + y, shade);
        }
    }
    // Ticks at quarters; what lies above the top has the top's colour.
    for quarter in 0..=4u32 {
        let value = end * f64::from(quarter) / 4.0;
        let more = if quarter == 4 { " or more" } else { "" };
        let text = format!("{value:.0}{more}");
        let y = top + (bar_height - 1) * (4 - quarter) / 4;
        for x in 0..6 {
            image.put_pixel(bar_left + BAR_WIDTH + x, y, Rgb(INK));
        }
        write(&mut image, &text, bar_left + BAR_WIDTH + 9, y.saturating_sub(LABEL.val() as u32 / 2), LABEL);
    }
    image
}

/// The colour of `fraction` of the scale.
fn color(fraction: f64) -> Rgb<u8> {
    let shade = VIRIDIS.eval_continuous(fraction.clamp(0.0, 1.0));
    Rgb([shade.r, shade.g, shade.b])
}

/// Writes one line of text, its top left corner at (x, y). What the font does not know is a question mark.
fn write(image: &mut RgbImage, text: &str, x: u32, y: u32, size: RasterHeight) {
    let advance = get_raster_width(FontWeight::Regular, size) as u32;
    for (index, character) in text.chars().enumerate() {
        let glyph = get_raster(character, FontWeight::Regular, size)
            .or_else(|| get_raster('?', FontWeight::Regular, size));
        let Some(glyph) = glyph else { continue };
        for (row, line) in glyph.rows().enumerate() {
            for (column, &coverage) in line.iter().enumerate() {
                let (x, y) = (x + index as u32 * advance + column as u32, y + row as u32);
                if let Some(pixel) = image.get_pixel_mut_checked(x, y) {
                    let mix = |paper: u8, ink: u8| {
                        ((u32::from(paper) * (255 - u32::from(coverage))
                            + u32::from(ink) * u32::from(coverage))
                            / 255) as u8
                    };
                    *pixel = Rgb(std::array::from_fn(|channel| mix(pixel.0[channel], INK[channel])));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_shows_every_pixel_in_the_colour_of_its_value() {
        let size = ImageSize::new(3, 2).expect("a size");
        let values = [0.0, 10.0, 5.0, 20.0, 2.5, 7.5];
        let image = picture("title", "caption", size, &values, 10.0);
        let zoom = LEAST_SIDE / 3;
        let top = MARGIN + 24 + 16 + MARGIN;
        for (index, value) in values.iter().enumerate() {
            let (x, y) = (index as u32 % 3 * zoom + zoom / 2, index as u32 / 3 * zoom + zoom / 2);
            assert_eq!(*image.get_pixel(MARGIN + x, top + y), color(value / 10.0));
        }
        // Something was written, and the bar runs from the colour of 0 up to that of the end.
        let dark = |y: std::ops::Range<u32>| {
            y.flat_map(|y| (0..200).map(move |x| (x, y))).any(|(x, y)| image.get_pixel(x, y).0 == INK)
        };
        assert!(
            dark(MARGIN..top) || image.pixels().filter(|p| p.0[0] < 128 && p.0[0] == p.0[1]).count() > 50
        );
        let bar = MARGIN + 3 * zoom + MARGIN + 5;
        assert_eq!(*image.get_pixel(bar, top), color(1.0));
        assert_eq!(*image.get_pixel(bar, top + 2 * zoom - 1), color(0.0));
    }

    #[test]
    fn the_scale_leaves_out_extremes_only() {
        assert_eq!(scale_end([].into_iter(), SCALE_END), 1.0);
        assert_eq!(scale_end([0.0, 4.0].into_iter(), SCALE_END), 4.0);
        let values = (1..=10_000).map(f64::from).chain([1e9]);
        assert!((9_980.0..=10_000.0).contains(&scale_end(values, SCALE_END)));
    }
}
