//! Charts inside a page: SVG whose colours are the page's, so that they follow light, dark and print, with a tooltip on each mark.
//!
//! Series are told apart by colour and by dashes. Nothing is wider than the page: a chart scales with it.

use maud::{Markup, html};

/// Colours of series before they begin again.
const SERIES: usize = 7;
const WIDTH: f64 = 560.0;

/// The style of a series: its colour and dashes.
pub fn class(series: usize) -> String {
    format!("s{}", series % SERIES)
}

/// A row of a bar chart: a bar of two parts, one after the other.
pub struct Bar {
    pub series: usize,
    pub parts: [f64; 2],
    /// What stands behind the bar.
    pub value: String,
    pub tooltip: String,
}

/// Names of series, each with a sample of its line or bar.
pub fn legend<'a>(names: impl IntoIterator<Item = &'a String>) -> Markup {
    html! {
        ul.legend {
            @for (series, name) in names.into_iter().enumerate() {
                li {
                    svg viewBox="0 0 32 12" aria-hidden="true" { path.(class(series)) d="M1 6H31" {} }
                    (name)
                }
            }
        }
    }
}

/// Horizontal bars in groups, all on one scale from 0.
pub fn bars<'a>(title: &str, groups: &'a [(String, Vec<Bar>)]) -> Markup {
    const LABELS: f64 = 112.0;
    const VALUES: f64 = 96.0;
    const BAR: f64 = 15.0;
    let longest =
        groups.iter().flat_map(|(_, bars)| bars).map(|bar| bar.parts.iter().sum()).fold(0.0, f64::max);
    let scale = if longest > 0.0 { (WIDTH - LABELS - VALUES) / longest } else { 0.0 };
    let rows: usize = groups.iter().map(|(_, bars)| bars.len()).sum();
    let height = rows as f64 * BAR + groups.len() as f64 * 10.0 + 4.0;
    let place = |top: &mut f64, (name, bars): &'a (String, Vec<Bar>)| {
        let start = *top;
        *top += BAR * bars.len() as f64 + 10.0;
        Some((start, name, bars))
    };
    let placed = groups.iter().scan(4.0, place);
    html! {
        svg.chart viewBox={ "0 0 " (WIDTH) " " (height) } role="img" aria-label=(title) {
            @for (start, name, bars) in placed {
                text x=(LABELS - 8.0) y=(start + BAR * bars.len() as f64 / 2.0 + 4.0) text-anchor="end" { (name) }
                @for (row, bar) in bars.iter().enumerate() {
                    @let y = start + row as f64 * BAR;
                    @let [solid, light] = bar.parts.map(|part| part * scale);
                    g {
                        title { (bar.tooltip) }
                        rect.(class(bar.series)) x=(LABELS) y=(number(y)) width=(number(solid)) height=(BAR - 3.0) {}
                        rect.(class(bar.series)).light x=(number(LABELS + solid)) y=(number(y)) width=(number(light)) height=(BAR - 3.0) {}
                        text.tick x=(number(LABELS + solid + light + 6.0)) y=(number(y + BAR - 5.0)) { (bar.value) }
                    }
                }
                line.axis x1=(LABELS) x2=(LABELS) y1=(number(start - 2.0)) y2=(number(start + BAR * bars.len() as f64)) {}
            }
        }
    }
}

/// A line of a chart.
pub struct Line {
    pub series: usize,
    /// (x, y, tooltip), from left to right.
    pub points: Vec<(f64, f64, String)>,
    /// Level from each point to the next, as histograms are.
    pub steps: bool,
}

/// Lines over axes from (x) the first to the last point and (y) from 0.
pub fn lines(title: &str, x_label: &str, y_label: &str, x_ticks: &[(f64, String)], lines: &[Line]) -> Markup {
    const HEIGHT: f64 = 300.0;
    let (left, right, top, bottom) = (52.0, WIDTH - 12.0, 12.0, HEIGHT - 46.0);
    let points = || lines.iter().flat_map(|line| &line.points);
    let low = points().map(|point| point.0).fold(f64::INFINITY, f64::min);
    let high = points().map(|point| point.0).fold(f64::NEG_INFINITY, f64::max);
    let (low, high) = if low < high { (low, high) } else { (low - 0.5, low + 0.5) };
    let most = points().map(|point| point.1).fold(0.0, f64::max);
    let y_ticks = ticks(most);
    let highest = y_ticks.last().copied().unwrap_or(1.0).max(most);
    let at_x = |x: f64| left + (x - low) / (high - low) * (right - left);
    let at_y = |y: f64| bottom - y / highest * (bottom - top);
    let path = |line: &Line| {
        let mut path = String::new();
        for (index, (x, y, _)) in line.points.iter().enumerate() {
            let (x, y) = (number(at_x(*x)), number(at_y(*y)));
            path += &match (index, line.steps) {
                (0, _) => format!("M{x} {y}"),
                (_, true) => format!("H{x}V{y}"),
                (_, false) => format!("L{x} {y}"),
            };
        }
        path
    };
    html! {
        svg.chart viewBox={ "0 0 " (WIDTH) " " (HEIGHT) } role="img" aria-label=(title) {
            @for tick in &y_ticks {
                line.grid x1=(left) x2=(right) y1=(number(at_y(*tick))) y2=(number(at_y(*tick))) {}
                text.tick x=(left - 6.0) y=(number(at_y(*tick) + 4.0)) text-anchor="end" { (short(*tick)) }
            }
            @for (x, name) in x_ticks.iter().filter(|(x, _)| (low..=high).contains(x)) {
                line.axis x1=(number(at_x(*x))) x2=(number(at_x(*x))) y1=(bottom) y2=(bottom + 5.0) {}
                text.tick x=(number(at_x(*x))) y=(bottom + 19.0) text-anchor="middle" { (name) }
            }
            line.axis x1=(left) x2=(right) y1=(bottom) y2=(bottom) {}
            text x=((left + right) / 2.0) y=(HEIGHT - 8.0) text-anchor="middle" { (x_label) }
            text transform={ "translate(14 " ((top + bottom) / 2.0) ") rotate(-90)" } text-anchor="middle" { (y_label) }
            @for line in lines {
                path.(class(line.series)) d=(path(line)) {}
                @for (x, y, tooltip) in &line.points {
                    circle.hover.(class(line.series)) cx=(number(at_x(*x))) cy=(number(at_y(*y))) r="6" { title { (tooltip) } }
                }
            }
        }
    }
}

/// Round numbers from 0 to at least `most`, about five.
fn ticks(most: f64) -> Vec<f64> {
    if most <= 0.0 || !most.is_finite() {
        return vec![0.0, 1.0];
    }
    let raw = most / 5.0;
    let power = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|step| *step >= raw * 0.999);
    let step = step.unwrap_or(10.0 * power);
    (0..=(most / step).ceil() as usize).map(|index| index as f64 * step).collect()
}

/// Coordinates to a hundredth: enough for a screen, and short.
fn number(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

/// A number in as few characters as tell it: 1200 as 1.2k, 0.30000000000000004 as 0.3.
pub fn short(value: f64) -> String {
    let (value, unit) = match value.abs() {
        v if v >= 1e6 => (value / 1e6, "M"),
        v if v >= 1e4 => (value / 1e3, "k"),
        _ => (value, ""),
    };
    let decimals =
        if value == 0.0 { 0 } else { (2.0 - value.abs().log10().floor()).clamp(0.0, 6.0) as usize };
    let text = format!("{value:.decimals$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text}{unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_right() {
        for (value, text) in [
            (0.0, "0"),
            (0.1 + 0.2, "0.3"),
            (1.0, "1"),
            (12.345, "12.3"),
            (100.0, "100"),
            (1234.5, "1234"),
            (12_500.0, "12.5k"),
            (2e6, "2M"),
            (0.001234, "0.00123"),
        ] {
            assert_eq!(short(value), text);
        }
        assert_eq!(ticks(0.0), [0.0, 1.0]);
        assert_eq!(ticks(10.0), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
        assert!(ticks(0.37).last().is_some_and(|last| *last >= 0.37));
    }

    #[test]
    fn charts_hold_every_mark_and_escape_names() {
        let bar =
            |value: f64| Bar { series: 8, parts: [value, 1.0], value: "v".into(), tooltip: "<tip>".into() };
        let svg = bars("a \"title\"", &[("<name>".into(), vec![bar(1.0), bar(3.0)])]).into_string();
        assert_eq!(svg.matches("<rect").count(), 4);
        assert!(
            svg.contains("&lt;name&gt;")
                && svg.contains("&lt;tip&gt;")
                && svg.contains("a &quot;title&quot;")
        );
        let line =
            |steps| Line { series: 0, points: vec![(0.0, 1.0, "a".into()), (1.0, 2.0, "b".into())], steps };
        let svg = lines("t", "x", "y", &[(0.0, "zero".into())], &[line(true), line(false)]).into_string();
        assert!(svg.contains("H548V") && svg.contains("L548") && svg.contains("zero"));
        // Nothing, one point, and nothing but zeros are drawn too.
        let alone = Line { series: 0, points: vec![(3.0, 0.0, String::new())], steps: false };
        for svg in [lines("t", "x", "y", &[], &[alone]), lines("t", "x", "y", &[], &[]), bars("t", &[])] {
            assert!(!svg.into_string().contains("NaN"));
        }
    }
}
