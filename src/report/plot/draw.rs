//! Drawing a figure on any of plotters' backends: title, legend, charts, small print.
//!
//! Lengths are in points and scaled on the way out: 1 for SVG, 2 for PNG. Drawing to memory cannot fail for reasons that a
//! caller could do anything about, so the backends' errors are dropped at this edge.

use super::{Chart, Figure, Mark, Series, Stroke, ramp};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::sync::Once;

const FAMILY: &str = "sans-serif";
const INK: RGBColor = RGBColor(30, 30, 30);
const GRID: RGBColor = RGBColor(226, 226, 226);
const MARGIN: i32 = 14;
const TITLE: i32 = 34;
const LEGEND_ROW: i32 = 22;
const NOTE: i32 = 24;

/// Registers the font that is inside the program.
fn with_font() {
    static FONT: Once = Once::new();
    FONT.call_once(|| {
        // The fonts are constants of a crate: that they are fonts is what the tests of this module show.
        let _ = plotters::style::register_font(FAMILY, FontStyle::Normal, dejavu::sans::regular());
        let _ = plotters::style::register_font(FAMILY, FontStyle::Bold, dejavu::sans::bold());
    });
}

pub fn svg(figure: &Figure) -> String {
    with_font();
    let mut text = String::new();
    let layout = Layout::of(figure, 1);
    {
        let area = SVGBackend::with_string(&mut text, layout.size()).into_drawing_area();
        let _ = layout.draw(&area);
        let _ = area.present();
    }
    text
}

pub fn png(figure: &Figure) -> Vec<u8> {
    with_font();
    let layout = Layout::of(figure, 2);
    let (width, height) = layout.size();
    let mut pixels = vec![0; width as usize * height as usize * 3];
    {
        let area = BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area();
        let _ = layout.draw(&area);
        let _ = area.present();
    }
    let mut bytes = std::io::Cursor::new(Vec::new());
    if let Some(image) = image::RgbImage::from_raw(width, height, pixels) {
        let _ = image.write_to(&mut bytes, image::ImageFormat::Png);
    }
    bytes.into_inner()
}

/// One entry of a legend.
#[derive(Clone, PartialEq)]
struct Entry {
    label: String,
    color: RGBColor,
    stroke: Stroke,
    mark: Mark,
    bar: bool,
}

fn entries<'a>(series: impl Iterator<Item = &'a Series>) -> Vec<Entry> {
    let mut entries: Vec<Entry> = Vec::new();
    for series in series {
        let entry = match series {
            Series::Line { label, color, stroke, mark, .. } => {
                Entry { label: label.clone(), color: *color, stroke: *stroke, mark: *mark, bar: false }
            }
            Series::Bars { label, color, .. } => Entry {
                label: label.clone(),
                color: *color,
                stroke: Stroke::None,
                mark: Mark::None,
                bar: true,
            },
            Series::Band { .. } | Series::Scatter { .. } => continue,
        };
        if !entry.label.is_empty() && !entries.contains(&entry) {
            entries.push(entry);
        }
    }
    entries
}

/// Where everything goes.
struct Layout<'a> {
    figure: &'a Figure,
    scale: i32,
    /// Rows of the figure's legend.
    legend: Vec<Vec<Entry>>,
}

type Drawn<DB> = Result<(), DrawingAreaErrorKind<<DB as DrawingBackend>::ErrorType>>;

impl<'a> Layout<'a> {
    fn of(figure: &'a Figure, scale: i32) -> Layout<'a> {
        let shared = figure.charts.iter().filter(|chart| !chart.legend).flat_map(|chart| &chart.series);
        let width = figure.columns as i32 * figure.chart_size.0 as i32;
        let mut legend: Vec<Vec<Entry>> = Vec::new();
        let mut used = i32::MAX;
        for entry in entries(shared) {
            let needed = entry_width(&entry.label);
            if used.saturating_add(needed) > width {
                legend.push(Vec::new());
                used = 0;
            }
            used += needed;
            if let Some(row) = legend.last_mut() {
                row.push(entry);
            }
        }
        Layout { figure, scale, legend }
    }

    fn top(&self) -> i32 {
        let scale_row = if self.figure.scale.is_some() { LEGEND_ROW + 4 } else { 0 };
        MARGIN + TITLE + self.legend.len() as i32 * LEGEND_ROW + scale_row
    }

    fn size(&self) -> (u32, u32) {
        let columns = self.figure.columns.max(1);
        let rows = self.figure.charts.len().div_ceil(columns) as u32;
        let (width, height) = self.figure.chart_size;
        let note = if self.figure.note.is_empty() { MARGIN } else { NOTE + MARGIN / 2 };
        let scale = self.scale as u32;
        (
            scale * (columns as u32 * width + 2 * MARGIN as u32),
            scale * (rows * height + (self.top() + note) as u32),
        )
    }

    fn font(&self, size: i32) -> TextStyle<'static> {
        (FAMILY, size * self.scale).into_font().color(&INK)
    }

    fn draw<DB: DrawingBackend>(&self, area: &DrawingArea<DB, Shift>) -> Drawn<DB> {
        let s = self.scale;
        area.fill(&WHITE)?;
        let (width, height) = self.size();
        let title = TextStyle::from((FAMILY, f64::from(17 * s), FontStyle::Bold).into_font())
            .color(&INK)
            .pos(Pos::new(HPos::Center, VPos::Center));
        area.draw_text(&self.figure.title, &title, (width as i32 / 2, (MARGIN + TITLE / 2 - 4) * s))?;
        for (row, entries) in self.legend.iter().enumerate() {
            let used: i32 = entries.iter().map(|entry| entry_width(&entry.label)).sum();
            let mut x = (width as i32 / s - used) / 2;
            let y = MARGIN + TITLE + row as i32 * LEGEND_ROW + LEGEND_ROW / 2;
            for entry in entries {
                self.entry(area, entry, x, y)?;
                x += entry_width(&entry.label);
            }
        }
        if let Some((label, low, high)) = &self.figure.scale {
            self.color_scale(area, label, *low, *high, self.top() - LEGEND_ROW / 2 - 4, width as i32 / s)?;
        }
        let (chart_width, chart_height) = self.figure.chart_size;
        let columns = self.figure.columns.max(1);
        for (index, chart) in self.figure.charts.iter().enumerate() {
            let x = MARGIN + (index % columns) as i32 * chart_width as i32;
            let y = self.top() + (index / columns) as i32 * chart_height as i32;
            let end = ((x + chart_width as i32) * s, (y + chart_height as i32) * s);
            self.chart(&area.clone().shrink((x * s, y * s), (end.0 - x * s, end.1 - y * s)), chart)?;
        }
        if !self.figure.note.is_empty() {
            let note = self.font(11).pos(Pos::new(HPos::Center, VPos::Center));
            area.draw_text(&self.figure.note, &note, (width as i32 / 2, height as i32 - (NOTE / 2 + 2) * s))?;
        }
        Ok(())
    }

    /// A legend entry whose left end is at (`x`, `y`) in points.
    fn entry<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, Shift>,
        entry: &Entry,
        x: i32,
        y: i32,
    ) -> Drawn<DB> {
        let s = self.scale;
        let (from, to) = ((x * s, y * s), ((x + 30) * s, y * s));
        if entry.bar {
            area.draw(&Rectangle::new(
                [(from.0, from.1 - 5 * s), (to.0, to.1 + 5 * s)],
                entry.color.filled(),
            ))?;
        }
        for segment in self.strokes(&[from, to], entry.stroke) {
            area.draw(&PathElement::new(segment, entry.color.stroke_width(2 * s as u32)))?;
        }
        self.mark(area, entry.mark, ((x + 15) * s, y * s), entry.color)?;
        let style = self.font(13).pos(Pos::new(HPos::Left, VPos::Center));
        // Centring takes the font's line, which is higher above its letters than below.
        area.draw_text(&entry.label, &style, ((x + 37) * s, (y + 2) * s))
    }

    fn color_scale<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, Shift>,
        label: &str,
        low: f64,
        high: f64,
        y: i32,
        width: i32,
    ) -> Drawn<DB> {
        let s = self.scale;
        let (bar, left) = (160, width / 2 - 40);
        for step in 0..bar * s {
            let x = left * s + step;
            let color = ramp(f64::from(step) / f64::from(bar * s));
            area.draw(&Rectangle::new([(x, (y - 6) * s), (x + 1, (y + 6) * s)], color.filled()))?;
        }
        let at = |h| self.font(12).pos(Pos::new(h, VPos::Center));
        area.draw_text(&format!("{label}   {low}"), &at(HPos::Right), ((left - 8) * s, y * s))?;
        area.draw_text(&high.to_string(), &at(HPos::Left), ((left + bar + 8) * s, y * s))
    }

    fn chart<DB: DrawingBackend>(&self, area: &DrawingArea<DB, Shift>, chart: &Chart) -> Drawn<DB> {
        let s = self.scale;
        let title = TextStyle::from((FAMILY, f64::from(14 * s), FontStyle::Bold).into_font()).color(&INK);
        let mut context = ChartBuilder::on(area)
            .caption(&chart.title, title)
            .margin(8 * s)
            .margin_right(18 * s)
            .set_label_area_size(LabelAreaPosition::Left, names_width(&chart.y).max(58) * s)
            .set_label_area_size(LabelAreaPosition::Bottom, 44 * s)
            .build_cartesian_2d(chart.x.low..chart.x.high, chart.y.low..chart.y.high)?;
        let (x_step, y_step) = (step(&chart.x, 6.0), step(&chart.y, 6.0));
        context
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID.stroke_width(s as u32))
            .axis_style(INK.stroke_width(s as u32))
            .set_all_tick_mark_size(4 * s)
            .label_style(self.font(12))
            .axis_desc_style(self.font(13))
            .x_desc(&chart.x.label)
            .y_desc(&chart.y.label)
            .x_labels(ticks(&chart.x, x_step))
            .y_labels(ticks(&chart.y, y_step))
            .x_label_formatter(&|value| tick(&chart.x, *value, x_step))
            .y_label_formatter(&|value| tick(&chart.y, *value, y_step))
            .draw()?;
        let plotting = context.plotting_area();
        let inside = |x: f64, y: f64| {
            (chart.x.low..=chart.x.high).contains(&x) && (chart.y.low..=chart.y.high).contains(&y)
        };
        // Relative to `area`, which is what is drawn on: the plot itself would clip marks in half at its border.
        let base = area.get_base_pixel();
        let pixel = |x: f64, y: f64| {
            let (x, y) = plotting.map_coordinate(&(x, y));
            (x - base.0, y - base.1)
        };
        for series in &chart.series {
            match series {
                Series::Band { color, points } => {
                    let clamp = |y: f64| y.clamp(chart.y.low, chart.y.high);
                    let upper = points.iter().map(|p| pixel(p.0, clamp(p.2)));
                    let lower = points.iter().rev().map(|p| pixel(p.0, clamp(p.1)));
                    let outline: Vec<_> = upper.chain(lower).collect();
                    if outline.len() > 2 {
                        area.draw(&Polygon::new(outline, color.mix(0.2)))?;
                    }
                }
                Series::Scatter { points } => {
                    for (x, y, color) in points.iter().filter(|p| inside(p.0, p.1)) {
                        area.draw(&Circle::new(pixel(*x, *y), 3 * s / 2, color.mix(0.75).filled()))?;
                    }
                }
                Series::Bars { color, bars, .. } => {
                    for &(from, to, height) in bars {
                        let corners = [pixel(from, height), pixel(to, chart.y.low.max(0.0))];
                        area.draw(&Rectangle::new(corners, color.mix(0.85).filled()))?;
                    }
                }
                Series::Line { color, stroke, mark, points, .. } => {
                    let path: Vec<_> =
                        points.iter().filter(|p| inside(p.0, p.1)).map(|p| pixel(p.0, p.1)).collect();
                    for segment in self.strokes(&path, *stroke) {
                        area.draw(&PathElement::new(segment, color.stroke_width(2 * s as u32)))?;
                    }
                    for &point in &path {
                        self.mark(area, *mark, point, *color)?;
                    }
                }
            }
        }
        if chart.legend {
            self.inner_legend(area, chart, pixel(chart.x.high, chart.y.low))?;
        }
        Ok(())
    }

    /// A chart's own legend, in the lower right corner of its plot.
    fn inner_legend<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, Shift>,
        chart: &Chart,
        corner: (i32, i32),
    ) -> Drawn<DB> {
        let s = self.scale;
        let entries = entries(chart.series.iter());
        let width = entries.iter().map(|entry| entry_width(&entry.label)).max().unwrap_or(0);
        let height = 18 * entries.len() as i32 + 8;
        let (right, bottom) = corner;
        let (left, top) = (right - (width + 2) * s, bottom - (height + 6) * s);
        let frame = [(left, top), (right - 6 * s, bottom - 6 * s)];
        area.draw(&Rectangle::new(frame, WHITE.mix(0.85).filled()))?;
        area.draw(&Rectangle::new(frame, GRID.stroke_width(s as u32)))?;
        for (row, entry) in entries.iter().enumerate() {
            self.entry(area, entry, left / s + 8, top / s + 13 + 18 * row as i32)?;
        }
        Ok(())
    }

    fn mark<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, Shift>,
        mark: Mark,
        at: (i32, i32),
        color: RGBColor,
    ) -> Drawn<DB> {
        let s = self.scale;
        match mark {
            Mark::None => Ok(()),
            Mark::Disk => area.draw(&Circle::new(at, 3 * s, color.filled())),
            Mark::Ring => {
                area.draw(&Circle::new(at, 7 * s / 2, WHITE.filled()))?;
                area.draw(&Circle::new(at, 7 * s / 2, color.stroke_width(3 * s as u32 / 2)))
            }
            Mark::Cross => area.draw(&Cross::new(at, 3 * s, color.stroke_width(3 * s as u32 / 2))),
        }
    }

    /// A path cut into the visible pieces of its stroke.
    fn strokes(&self, path: &[(i32, i32)], stroke: Stroke) -> Vec<Vec<(i32, i32)>> {
        let (on, off) = match stroke {
            Stroke::None => return Vec::new(),
            Stroke::Solid if path.len() > 1 => return vec![path.to_vec()],
            Stroke::Solid => return Vec::new(),
            Stroke::Dashed => (6.0, 4.0),
            Stroke::Dotted => (1.5, 3.0),
        };
        let (on, off) = (on * f64::from(self.scale), off * f64::from(self.scale));
        let mut pieces = Vec::new();
        let (mut visible, mut left) = (true, on);
        for pair in path.windows(2) {
            let [from, to] = [pair[0], pair[1]].map(|(x, y)| (f64::from(x), f64::from(y)));
            let length = (to.0 - from.0).hypot(to.1 - from.1);
            let at = |along: f64| {
                let t = along / length;
                let mix = |a: f64, b: f64| (a + t * (b - a)).round() as i32;
                (mix(from.0, to.0), mix(from.1, to.1))
            };
            let mut along = 0.0;
            while along < length {
                let end = (along + left).min(length);
                if visible {
                    pieces.push(vec![at(along), at(end)]);
                }
                left -= end - along;
                along = end;
                if left <= 1e-9 {
                    visible = !visible;
                    left = if visible { on } else { off };
                }
            }
        }
        pieces
    }
}

/// Points that a legend entry takes, with the gap behind it.
fn entry_width(label: &str) -> i32 {
    let text = (FAMILY, 13).into_font();
    let width = text.box_size(label).map_or(8 * label.chars().count() as u32, |size| size.0);
    37 + width as i32 + 20
}

/// Points that the names of an axis take beside it.
fn names_width(axis: &super::Axis) -> i32 {
    let font = (FAMILY, 12).into_font();
    let width = |name: &String| font.box_size(name).map_or(0, |size| size.0 as i32);
    axis.names.iter().map(width).max().map_or(0, |width| width + 12)
}

/// A round distance between ticks, so that there are about `count`.
fn step(axis: &super::Axis, count: f64) -> f64 {
    if !axis.names.is_empty() {
        return 1.0;
    }
    if axis.logarithmic {
        return ((axis.high - axis.low) / 8.0).ceil().max(1.0);
    }
    let raw = (axis.high - axis.low) / count;
    let power = 10f64.powf(raw.log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().find(|m| m * power >= raw * 0.999).unwrap_or(10.0) * power
}

/// The number of ticks at that distance.
fn ticks(axis: &super::Axis, step: f64) -> usize {
    ((axis.high - axis.low) / step).floor() as usize + 1
}

/// What stands at a tick.
fn tick(axis: &super::Axis, value: f64, step: f64) -> String {
    if !axis.names.is_empty() {
        let name = (value.fract() == 0.0 && value >= 0.0).then(|| axis.names.get(value as usize)).flatten();
        return name.cloned().unwrap_or_default();
    }
    if axis.logarithmic {
        if value.fract().abs() > 1e-6 {
            return String::new();
        }
        let superscript = |c: char| match c {
            '-' => '⁻',
            '1' => '¹',
            '2' => '²',
            '3' => '³',
            digit => char::from_u32(0x2070 + digit as u32 - '0' as u32).unwrap_or(digit),
        };
        return format!("10{}", format!("{value:.0}").chars().map(superscript).collect::<String>());
    }
    let decimals = (-step.log10().floor()).clamp(0.0, 6.0) as usize;
    let text = format!("{value:.decimals$}");
    if text.trim_start_matches('-').chars().all(|c| c == '0' || c == '.') {
        text.replace('-', "")
    } else {
        text
    }
}
