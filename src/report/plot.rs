//! Plots: a [`Figure`] of [`Chart`]s, each with series, drawn to SVG and PNG.
//!
//! Colours are those of Okabe and Ito, which people with any colour vision tell apart; published curves are dashed with hollow marks,
//! so that a black-and-white print shows them apart too. The font is inside the program, so that plots are the same on every machine.

mod draw;

use crate::files::{FileError, OutputFile};
use plotters::style::RGBColor;
use std::path::Path;

pub type Color = RGBColor;
pub const BLUE: Color = RGBColor(0, 114, 178);
pub const VERMILLION: Color = RGBColor(213, 94, 0);
pub const GREEN: Color = RGBColor(0, 158, 115);
pub const ORANGE: Color = RGBColor(230, 159, 0);
pub const SKY: Color = RGBColor(86, 180, 233);
pub const PURPLE: Color = RGBColor(204, 121, 167);
pub const BLACK: Color = RGBColor(0, 0, 0);

/// Colours in the order in which series take them.
pub const PALETTE: [Color; 7] = [BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK];

/// A colour of the ordered scale (cividis, made for all colour vision) for `t` from 0 (dark blue) to 1 (yellow).
pub fn ramp(t: f64) -> Color {
    let color = colorous::CIVIDIS.eval_continuous(t.clamp(0.0, 1.0));
    RGBColor(color.r, color.g, color.b)
}

/// How a line is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stroke {
    None,
    Solid,
    Dashed,
    Dotted,
}

/// What stands at each point of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    None,
    /// Filled.
    Disk,
    /// Hollow: for what others published.
    Ring,
    Cross,
}

/// One thing in a chart.
#[derive(Clone, Debug, PartialEq)]
pub enum Series {
    /// Points joined by a line.
    Line { label: String, color: Color, stroke: Stroke, mark: Mark, points: Vec<(f64, f64)> },
    /// (x, low, high): a shaded band, without a legend entry.
    Band { color: Color, points: Vec<(f64, f64, f64)> },
    /// Many small points, each with its own colour.
    Scatter { points: Vec<(f64, f64, Color)> },
    /// (from, to, height): bars from 0.
    Bars { label: String, color: Color, bars: Vec<(f64, f64, f64)> },
}

impl Series {
    pub fn line(label: &str, color: Color, stroke: Stroke, mark: Mark, points: Vec<(f64, f64)>) -> Series {
        Series::Line { label: label.to_owned(), color, stroke, mark, points }
    }

    pub fn band(color: Color, points: Vec<(f64, f64, f64)>) -> Series {
        Series::Band { color, points }
    }
}

/// One axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    pub label: String,
    pub low: f64,
    pub high: f64,
    /// Values are log10 of what they stand for.
    pub logarithmic: bool,
    /// Names of the values 0, 1, 2, … instead of numbers.
    pub names: Vec<String>,
}

/// One panel.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    pub title: String,
    pub x: Axis,
    pub y: Axis,
    pub series: Vec<Series>,
    /// Has a legend of its own beside it; otherwise its entries go to the figure's.
    pub legend: bool,
}

impl Chart {
    /// A chart whose axes fit the series.
    pub fn new(title: &str, x: &str, y: &str, series: Vec<Series>) -> Chart {
        let mut bounds = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        let mut grow = |x: f64, y: f64| {
            bounds = [bounds[0].min(x), bounds[1].max(x), bounds[2].min(y), bounds[3].max(y)];
        };
        for series in &series {
            match series {
                Series::Line { points, .. } => points.iter().for_each(|p| grow(p.0, p.1)),
                Series::Band { points, .. } => points.iter().for_each(|p| {
                    grow(p.0, p.1);
                    grow(p.0, p.2);
                }),
                Series::Scatter { points } => points.iter().for_each(|p| grow(p.0, p.1)),
                Series::Bars { bars, .. } => bars.iter().for_each(|b| {
                    grow(b.0, 0.0);
                    grow(b.1, b.2);
                }),
            }
        }
        let axis = |label: &str, low: f64, high: f64| {
            let margin = if high > low { 0.04 * (high - low) } else { 0.5 };
            let (low, high) = if low <= high { (low - margin, high + margin) } else { (0.0, 1.0) };
            Axis { label: label.to_owned(), low, high, logarithmic: false, names: Vec::new() }
        };
        let [left, right, bottom, top] = bounds;
        Chart {
            title: title.to_owned(),
            x: axis(x, left, right),
            y: axis(y, bottom, top),
            series,
            legend: false,
        }
    }

    pub fn with_x(mut self, low: f64, high: f64) -> Chart {
        (self.x.low, self.x.high) = (low, high);
        self
    }

    pub fn with_y(mut self, low: f64, high: f64) -> Chart {
        (self.y.low, self.y.high) = (low, high);
        self
    }

    pub fn with_legend(mut self) -> Chart {
        self.legend = true;
        self
    }

    /// Both axes hold log10 of their values.
    pub fn logarithmic(mut self) -> Chart {
        self.x.logarithmic = true;
        self.y.logarithmic = true;
        self
    }
}

/// Charts in rows of `columns`, with one title and one legend.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    pub title: String,
    pub columns: usize,
    pub charts: Vec<Chart>,
    /// A line of small print at the bottom: what bands are, where published values come from.
    pub note: String,
    /// Width and height of one chart, in points.
    pub chart_size: (u32, u32),
    /// A scale of colours beside the legend: what it shows, and the values at its ends.
    pub scale: Option<(String, f64, f64)>,
}

impl Figure {
    pub fn new(title: &str, columns: usize, charts: Vec<Chart>) -> Figure {
        let note = String::new();
        Figure { title: title.to_owned(), columns, charts, note, chart_size: (440, 330), scale: None }
    }

    /// The figure as SVG text.
    pub fn svg(&self) -> String {
        draw::svg(self)
    }

    /// The figure as PNG bytes, at twice the SVG's size.
    pub fn png(&self) -> Vec<u8> {
        draw::png(self)
    }

    /// Writes `name`.svg and `name`.png in `directory`.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&self, directory: &Path, name: &str) -> Result<(), FileError> {
        for (extension, bytes) in [("svg", self.svg().into_bytes()), ("png", self.png())] {
            let file = OutputFile::create(&directory.join(format!("{name}.{extension}")))?;
            file.commit_with(|out| out.write_all(&bytes))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figure() -> Figure {
        let line = Series::line("ours", BLUE, Stroke::Solid, Mark::Disk, vec![(0.0, 1.0), (1.0, 3.0)]);
        let published =
            Series::line("published", BLUE, Stroke::Dashed, Mark::Ring, vec![(0.0, 1.1), (1.0, 2.9)]);
        let band = Series::band(BLUE, vec![(0.0, 0.9, 1.1), (1.0, 2.9, 3.1)]);
        let scatter = Series::Scatter { points: vec![(0.5, 2.0, ramp(0.5)), (f64::NAN, 1.0, BLACK)] };
        let bars = Series::Bars { label: "bars".into(), color: GREEN, bars: vec![(0.0, 0.5, 1.0)] };
        Figure::new(
            "Title & <more>",
            2,
            vec![
                Chart::new("a", "x", "y", vec![band, line, published]),
                Chart::new("b", "x", "y", vec![scatter]).logarithmic(),
                Chart::new("c", "x", "y", vec![bars]).with_legend(),
                Chart::new("empty", "x", "y", vec![]),
            ],
        )
    }

    #[test]
    fn svg_and_png_hold_what_they_show() {
        let svg = figure().svg();
        for text in ["Title &amp; &lt;more&gt;", "ours", "published", "empty", "bars"] {
            assert!(svg.contains(text), "{text}");
        }
        let png = image::load_from_memory(&figure().png()).unwrap().to_rgb8();
        assert_eq!(png.width() % 2, 0);
        let blue = png.pixels().filter(|p| p.0 == [0, 114, 178]).count();
        assert!(blue > 500, "a solid blue line: {blue} pixels");
    }

    #[test]
    fn the_same_figure_is_the_same_bytes() {
        assert_eq!(figure().png(), figure().png());
        assert_eq!(figure().svg(), figure().svg());
    }
}
