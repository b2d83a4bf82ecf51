//! Heat maps in a page: those of all trees on one scale, then what each tree costs more or less than the first.
//!
//! Pictures are PNG inside the page, a byte per pixel. Together they have at most `MOST_PIXELS`; larger ones are reduced by averaging
//! squares of pixels, and the page says so.

use super::super::heatmap::{self, scale_end};
use super::super::tree_names;
use super::chart::short;
use crate::compare::{Comparison, RecordingResult};
use crate::replay::pixels::ImageSize;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use colorous::{Color, Gradient, PURPLE_ORANGE, VIRIDIS};
use maud::{Markup, html};

/// Of all pictures of a page: at a byte each, and four thirds of that in the page, some 5 MB.
const MOST_PIXELS: usize = 4_000_000;
/// A picture's longer side: no page shows more.
const LONGEST_SIDE: u32 = 1024;
/// The scale of differences ends at this fraction of the pixels that differ.
const SCALE_END: f64 = 0.995;

/// How many pixels on a side become one, so that `pictures` of this size fit into a page.
fn reduction(size: ImageSize, pictures: usize) -> u32 {
    let fits = |factor: u32| {
        let small = reduced_size(size, factor);
        let pixels = small.width as usize * small.height as usize * pictures.max(1);
        pixels <= MOST_PIXELS && small.width.max(small.height) <= LONGEST_SIDE
    };
    (1..).find(|&factor| fits(factor) || factor >= size.width.max(size.height)).unwrap_or(1)
}

fn reduced_size(size: ImageSize, factor: u32) -> ImageSize {
    ImageSize { width: size.width.div_ceil(factor), height: size.height.div_ceil(factor) }
}

/// Means of squares of `factor` pixels on a side; at the right and lower border of what is there.
fn reduced(values: &[f64], size: ImageSize, factor: u32) -> Vec<f64> {
    let small = reduced_size(size, factor);
    let mut means = Vec::with_capacity(small.width as usize * small.height as usize);
    for y in 0..small.height {
        for x in 0..small.width {
            let columns = x * factor..((x + 1) * factor).min(size.width);
            let rows = y * factor..((y + 1) * factor).min(size.height);
            let count = columns.len() * rows.len();
            let row = |y: u32| {
                let start = y as usize * size.width as usize;
                values[start + columns.start as usize..start + columns.end as usize].iter().sum::<f64>()
            };
            means.push(rows.map(row).sum::<f64>() / count as f64);
        }
    }
    means
}

/// A picture of one colour per value, `place` saying where on the gradient (0 to 1), as a data URI.
fn picture(
    values: &[f64],
    size: ImageSize,
    gradient: Gradient,
    place: impl Fn(f64) -> f64,
) -> Option<String> {
    let palette: Vec<u8> =
        (0..=255).flat_map(|index| gradient.eval_continuous(f64::from(index) / 255.0).into_array()).collect();
    let pixels: Vec<u8> =
        values.iter().map(|&value| (place(value).clamp(0.0, 1.0) * 255.0).round() as u8).collect();
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, size.width, size.height);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_palette(palette);
    let mut writer = encoder.write_header().ok()?;
    writer.write_image_data(&pixels).ok()?;
    writer.finish().ok()?;
    Some(format!("data:image/png;base64,{}", BASE64_STANDARD.encode(bytes)))
}

/// One traversal's pictures: values per pixel of each tree, and of each but the first what it costs more than the first.
struct Costs {
    trees: Vec<Vec<f64>>,
    differences: Vec<Vec<f64>>,
}

impl Costs {
    fn of(comparison: &Comparison, recording: &RecordingResult, run: usize, factor: u32) -> Costs {
        let pixels = recording.trees.iter().filter_map(|tree| tree.runs[run].outcome.pixels.as_ref());
        let costs = &comparison.settings.costs;
        let trees: Vec<Vec<f64>> =
            pixels.map(|pixels| reduced(&pixels.costs(costs), pixels.size, factor)).collect();
        let less_first =
            |tree: &Vec<f64>| tree.iter().zip(&trees[0]).map(|(value, first)| value - first).collect();
        Costs { differences: trees.iter().skip(1).map(less_first).collect(), trees }
    }
}

/// How many pictures [`section`] shows of a recording.
pub fn pictures(comparison: &Comparison, recording: &RecordingResult) -> usize {
    let shown = recording.trees[0].runs[0].outcome.pixels.is_some();
    if shown { comparison.settings.traversals.len() * (2 * comparison.trees.len() - 1) } else { 0 }
}

/// The pictures of one recording, of `pictures` in the whole page; `None` when its pixels were not summed.
pub fn section(comparison: &Comparison, recording: &RecordingResult, pictures: usize) -> Option<Markup> {
    let size = recording.trees[0].runs[0].outcome.pixels.as_ref()?.size;
    let factor = reduction(size, pictures);
    let small = reduced_size(size, factor);
    let names = tree_names(comparison);
    let traversals = &comparison.settings.traversals;
    let maps: Vec<Costs> =
        (0..traversals.len()).map(|run| Costs::of(comparison, recording, run, factor)).collect();
    let end = scale_end(maps.iter().flat_map(|map| &map.trees).flatten().copied(), heatmap::SCALE_END);
    let magnitudes = maps.iter().flat_map(|map| &map.differences).flatten().map(|value| value.abs());
    let spread = scale_end(magnitudes, SCALE_END);
    Some(html! {
        p.soft {
            "Γ summed over the queries of each pixel, " (small.width) " × " (small.height) " pixels."
            @if factor > 1 {
                " Reduced from " (size.width) " × " (size.height) ": a pixel here is the mean of " (factor) " × " (factor) "."
            }
            " All pictures of costs share one scale, and so do all differences."
        }
        (cost_scale(end))
        @for (traversal, map) in traversals.iter().zip(&maps) {
            h4 { (traversal.name()) }
            div.maps {
                @for (name, values) in names.iter().zip(&map.trees) {
                    @let note = format!("mean {}", short(mean(values)));
                    @let alt = format!("Heat map of {name} under {}, {note}", traversal.name());
                    (figure(name, &note, &alt, picture(values, small, VIRIDIS, |value| value / end), small))
                }
            }
        }
        @if names.len() > 1 {
            h4 { "Difference from " (names[0]) }
            (difference_scale(spread))
            @for (traversal, map) in traversals.iter().zip(&maps) {
                div.maps {
                    @for (name, values) in names[1..].iter().zip(&map.differences) {
                        @let title = format!("{name} − {}, {}", names[0], traversal.name());
                        @let note = difference_note(values);
                        @let place = |value: f64| 0.5 + 0.5 * value / spread;
                        (figure(&title, &note, &format!("{title}: {note}"), picture(values, small, PURPLE_ORANGE, place), small))
                    }
                }
            }
        }
    })
}

fn figure(title: &str, note: &str, alt: &str, source: Option<String>, size: ImageSize) -> Markup {
    html! {
        figure {
            figcaption { strong { (title) } ": " (note) }
            @if let Some(source) = source {
                img src=(source) alt=(alt) title=(alt) width=(size.width) height=(size.height);
            }
        }
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// What a picture of differences says, in words.
fn difference_note(values: &[f64]) -> String {
    let share = |count: usize| 100.0 * count as f64 / values.len().max(1) as f64;
    let less = share(values.iter().filter(|value| **value < 0.0).count());
    let more = share(values.iter().filter(|value| **value > 0.0).count());
    format!("less in {less:.0}% of the pixels, more in {more:.0}%; mean {}", signed(mean(values)))
}

fn signed(value: f64) -> String {
    let sign = if value > 0.0 {
        "+"
    } else if value < 0.0 {
        "−"
    } else {
        ""
    };
    format!("{sign}{}", short(value.abs()))
}

fn cost_scale(end: f64) -> Markup {
    let mut ticks = [0.0, 0.25, 0.5, 0.75, 1.0].map(|quarter| short(quarter * end));
    ticks[4].push_str(" or more");
    scale(|t| VIRIDIS.eval_continuous(t), "Γ per pixel", ticks)
}

fn difference_scale(spread: f64) -> Markup {
    let mut ticks = [-1.0, -0.5, 0.0, 0.5, 1.0].map(|part| signed(part * spread));
    ticks[0].push_str(" or less");
    ticks[4].push_str(" or more");
    scale(
        |t| PURPLE_ORANGE.eval_continuous(t),
        "Γ per pixel more than the first tree: purple costs less, orange costs more",
        ticks,
    )
}

/// A bar of colours with a number at each quarter.
fn scale(color: impl Fn(f64) -> Color, label: &str, ticks: [String; 5]) -> Markup {
    let stop = |step: u32| {
        let Color { r, g, b } = color(f64::from(step) / 16.0);
        format!("#{r:02x}{g:02x}{b:02x}")
    };
    let stops: Vec<String> = (0..=16).map(stop).collect();
    html! {
        div.scale {
            div { (label) }
            div.bar style={ "background: linear-gradient(to right, " (stops.join(", ")) ")" } {}
            div.ticks { @for tick in ticks { span { (tick) } } }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn size(width: u32, height: u32) -> ImageSize {
        ImageSize { width, height }
    }

    #[test]
    fn pictures_are_bounded_whatever_their_size_and_number() {
        assert_eq!(reduction(size(640, 480), 6), 1);
        for (size, count) in
            [(size(1920, 1080), 6), (size(8192, 4096), 1), (size(1, 1 << 25), 3), (size(9, 9), 9999)]
        {
            let small = reduced_size(size, reduction(size, count));
            let pixels = small.width as usize * small.height as usize * count;
            assert!(
                pixels <= MOST_PIXELS && small.width.max(small.height) <= LONGEST_SIDE,
                "{size:?}: {small:?}"
            );
        }
    }

    #[test]
    fn reducing_keeps_means() {
        let values: Vec<f64> = (0..15).map(f64::from).collect();
        assert_eq!(reduced(&values, size(5, 3), 1), values);
        // 5 × 3 in squares of 2: the last column and row are what is there.
        let means = reduced(&values, size(5, 3), 2);
        assert_eq!(means, [3.0, 5.0, 6.5, 10.5, 12.5, 14.0]);
    }

    #[test]
    fn a_picture_is_a_png_in_the_gradients_colours() {
        let values = [0.0, 1.0, 0.5, 7.0];
        let uri = picture(&values, size(2, 2), VIRIDIS, |value| value).expect("a picture");
        let bytes = BASE64_STANDARD
            .decode(uri.strip_prefix("data:image/png;base64,").expect("a PNG"))
            .expect("base64");
        let image = image::load_from_memory(&bytes).expect("a PNG").to_rgb8();
        let expected = |t| VIRIDIS.eval_continuous(t).into_array();
        assert_eq!(image.get_pixel(0, 0).0, expected(0.0));
        assert_eq!(image.get_pixel(1, 0).0, expected(1.0));
        assert_eq!(image.get_pixel(1, 1).0, expected(1.0), "above the end");
    }

    #[test]
    fn more_is_orange_and_less_is_purple() {
        let [less, none, more] = [0.0, 0.5, 1.0].map(|t| PURPLE_ORANGE.eval_continuous(t));
        assert!(less.b > less.r && less.b > less.g, "{less:?}");
        assert!(more.r > more.g && more.g > more.b, "{more:?}");
        assert!(none.r.min(none.g).min(none.b) > 230, "{none:?}");
    }

    #[test]
    fn differences_are_told_with_their_sign() {
        assert_eq!(
            difference_note(&[-2.0, -2.0, 0.0, 1.0]),
            "less in 50% of the pixels, more in 25%; mean −0.75"
        );
        assert_eq!([signed(0.0), signed(1.5)], ["0", "+1.5"]);
    }
}
