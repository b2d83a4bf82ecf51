//! A comparison as one page that can be sent to a colleague: tables, charts, heat maps and their differences.
//!
//! The page holds everything that it shows: no script, no font, no picture from elsewhere. Whatever came from a file is escaped by
//! the templates. `facts` says what was compared, `tables`, `plots` and `maps` show it, `chart` draws, `style.css` is the look.

mod chart;
mod facts;
mod maps;
mod plots;
mod tables;
mod times;

use super::circumstances::Circumstances;
use super::tree_names;
use crate::compare::{Comparison, RecordingResult, relative};
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// The whole page. `failures` are the lines that made the comparison fail.
pub fn render(comparison: &Comparison, circumstances: &Circumstances, failures: &[String]) -> String {
    let names = tree_names(comparison);
    let title = match names.as_slice() {
        [only] => only.clone(),
        [first, others @ ..] => format!("{first} against {}", others.join(", ")),
        [] => String::new(),
    };
    let pictures = comparison.recordings.iter().map(|recording| maps::pictures(comparison, recording)).sum();
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "bvh-compare: " (title) }
                style { (PreEscaped(include_str!("html/style.css"))) }
            }
            body {
                a.skip href="#main" { "Skip to the results" }
                div.page {
                    (contents(comparison))
                    main #main {
                        h1 { (title) }
                        p.stamp { (circumstances.when) ", " (circumstances.program) }
                        @if !failures.is_empty() {
                            div.failed role="alert" {
                                strong { "The comparison failed." }
                                ul { @for line in failures { li { (line) } } }
                            }
                        }
                        @for recording in &comparison.recordings { (sentence(comparison, recording, &names)) }
                        @if let Some(why) = &comparison.left_out { p.soft { (why) } }
                        @for (number, recording) in comparison.recordings.iter().enumerate() {
                            (results(comparison, recording, number + 1, pictures))
                        }
                        h2 #trees { "The trees" }
                        (tables::trees(comparison))
                        h2 #compared { "What was compared" }
                        (facts::section(comparison, circumstances))
                        h2 #words { "Words" }
                        (facts::words())
                    }
                }
            }
        }
    };
    page.into_string()
}

/// The parts of a recording's results: the end of the anchor, and the title.
const PARTS: [(&str, &str); 7] = [
    ("cost", "Cost per query"),
    ("time", "Time per query"),
    ("embree", "Embree's kernels"),
    ("groups", "By kind, depth and purpose"),
    ("distribution", "Distribution"),
    ("levels", "Where in the tree"),
    ("maps", "Where in the image"),
];

fn shown(comparison: &Comparison, recording: &RecordingResult, part: &str) -> bool {
    match part {
        "levels" => recording.trees[0].runs[0].outcome.profile.is_some(),
        "time" => recording.timing.is_some(),
        "embree" => comparison.kernels.is_some(),
        _ => true,
    }
}

fn contents(comparison: &Comparison) -> Markup {
    html! {
        nav aria-label="Contents" {
            h2 { "Contents" }
            ul {
                @for (number, recording) in comparison.recordings.iter().enumerate() {
                    li {
                        a href={ "#r" (number + 1) } { (plots::recording_name(recording)) }
                        ul {
                            @for (part, title) in PARTS.iter().filter(|(part, _)| shown(comparison, recording, part)) {
                                li { a href={ "#r" (number + 1) "-" (part) } { (title) } }
                            }
                        }
                    }
                }
                li { a href="#trees" { "The trees" } }
                li { a href="#compared" { "What was compared" } }
                li { a href="#words" { "Words" } }
            }
        }
    }
}

/// What came out, in a sentence or two.
fn sentence(comparison: &Comparison, recording: &RecordingResult, names: &[String]) -> Markup {
    let traversal = comparison.settings.traversals[0].name();
    let total = |tree: usize| &recording.trees[tree].runs[0].outcome.tallies.total;
    let cost = |tree: usize| comparison.cost(tree, total(tree));
    let told = |tree: usize| {
        let (Some(own), Some(first)) = (cost(tree), cost(0)) else {
            return format!("was asked in packets, which have no cost beside that of {}.", names[0]);
        };
        let ratio = relative(own, first);
        let change = 100.0 * (ratio - 1.0);
        let verb = match change {
            c if c <= -0.05 => format!("{:.1}% less than", -c),
            c if c >= 0.05 => format!("{c:.1}% more than"),
            _ => "as much as".to_owned(),
        };
        format!(
            "is expected to take {verb} {} under {traversal}: {own:.1} ns per query against {first:.1}, a ratio of {ratio:.3}.",
            names[0],
        )
    };
    // What is expected is not always what is measured: where both are known, both are said.
    let took = |tree: usize| {
        let timing = recording.timing.as_ref()?;
        let ns = |tree: usize| 1e9 * timing.trees[tree][0].total.median / timing.queries.max(1) as f64;
        let ratio = relative(ns(tree), ns(0));
        Some(format!("It takes {:.0} ns per query against {:.0}, a ratio of {ratio:.3}.", ns(tree), ns(0)))
    };
    let runs = || recording.trees.iter().flat_map(|tree| &tree.runs).map(|run| &run.outcome.tallies.total);
    let wrong: u64 = runs().map(|total| total.mismatches).sum();
    let borderline = runs().map(|total| total.borderline).max().unwrap_or(0);
    let unjudged = super::unjudged(recording);
    html! {
        @if comparison.recordings.len() > 1 { h3 { (plots::recording_name(recording)) } }
        @if names.len() == 1 {
            p.lead { strong { (names[0]) } " is expected to take " (cost(0).map_or("–".to_owned(), |cost| format!("{cost:.1}"))) " ns per query under " (traversal) "." }
        }
        @for (tree, name) in names.iter().enumerate().skip(1) { p.lead { strong { (name) } " " (told(tree)) @if let Some(took) = took(tree) { " " (took) } } }
        p {
            (super::grouped(total(0).queries)) " queries of " code { (recording.path) } ", over "
            (names.len()) @if names.len() == 1 { " tree" } @else { " trees" } " in "
            (comparison.settings.traversals.iter().map(|t| t.name()).collect::<Vec<_>>().join(" and ")) ". "
            @if wrong == 0 { "Every answer " @if unjudged.is_some() { "that can be judged " } "agrees with the recorded one" } @else { span.wrong { (super::grouped(wrong)) " wrong answers" } }
            @if borderline > 0 { "; " (super::grouped(borderline)) " at most graze an edge or a plane, so that two answers are right" }
            @if let Some(unjudged) = &unjudged { "; not judged: " (unjudged) }
            "."
        }
    }
}

/// Everything about one recording.
fn results(comparison: &Comparison, recording: &RecordingResult, number: usize, pictures: usize) -> Markup {
    let names = &tree_names(comparison);
    let orders = 0..comparison.settings.traversals.len();
    let part = |part: &str| {
        let title = PARTS.iter().find(|(name, _)| *name == part).map_or("", |(_, title)| title);
        html! { h3 id={ "r" (number) "-" (part) } { (title) } }
    };
    html! {
        section {
            h2 id={ "r" (number) } { "Results: " (plots::recording_name(recording)) }
            (part("cost"))
            (tables::summary(comparison, recording))
            (tables::packets(comparison, recording))
            (tables::segments(comparison, recording))
            @if let Some(timing) = &recording.timing {
                (part("time"))
                (times::section(comparison, recording, timing))
            }
            @if shown(comparison, recording, "embree") {
                (part("embree"))
                (times::embrees(comparison, recording))
            }
            (part("groups"))
            (chart::legend(names))
            div.charts { @for run in orders.clone() { (plots::group_bars(comparison, recording, names, run)) } }
            @for run in orders.clone() { (tables::breakdown(comparison, recording, run)) }
            (part("distribution"))
            (chart::legend(names))
            div.charts { @for run in orders.clone() { (plots::histogram(comparison, recording, names, run)) } }
            @if shown(comparison, recording, "levels") {
                (part("levels"))
                (chart::legend(names))
                div.charts { @for run in orders.clone() { @if let Some(levels) = plots::levels(comparison, recording, names, run) { (levels) } } }
            }
            (part("maps"))
            @match maps::section(comparison, recording, pictures) {
                Some(maps) => { (maps) }
                None => { p.soft { "No tree says how large the traced image was; with --size WxH there are pictures here." } }
            }
        }
    }
}
