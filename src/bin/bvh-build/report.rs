//! What was built, as JSON and as a table.

use crate::order::print_order;
use embree_trace::builder::{Config, spatial};
use embree_trace::cli::TextOrJson;
use embree_trace::optimize::Report;
use embree_trace::tree::TreeView;
use embree_trace::tree::statistics::{Statistics, sah_cost};
use serde_json::{Value, json};
use std::io::Write;

/// What each optimiser did to T, in its own measure (the root's P is about 1), step by step.
pub fn optimization(report: &Report) -> Value {
    let stages: Vec<Value> = report
        .stages
        .iter()
        .map(|stage| {
            json!({
                "name": stage.stage.name(),
                "undone": stage.undone,
                "moves": stage.steps.last().map_or(0, |step| step.moves),
                "cost": stage.steps.iter().map(|step| step.cost).collect::<Vec<f64>>(),
            })
        })
        .collect();
    json!({ "before": report.before, "after": report.after, "stages": stages })
}

/// What a tree looks like, in the names of `bvh-compare`.
pub fn described(tree: TreeView, config: &Config) -> Value {
    let Statistics { nodes, leaves, depth, max_children, max_leaf } = Statistics::of(tree);
    let sah_cost = sah_cost(tree, config.c_i, config.c_p);
    json!({
        "nodes": nodes, "leaves": leaves, "depth": depth, "max_children": max_children, "max_leaf": max_leaf,
        "sah_cost": sah_cost,
    })
}

pub fn print(report: &Value, format: TextOrJson) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    if format == TextOrJson::Json {
        return writeln!(out, "{report:#}");
    }
    writeln!(
        out,
        "{} triangles in {:.3} s, {} left out (vertices that are not finite)",
        report["triangles"],
        report["seconds"].as_f64().unwrap_or_default(),
        report["left_out"],
    )?;
    if report["training_queries"] != 0 {
        writeln!(out, "{} training queries", report["training_queries"])?;
    }
    let auto = &report["build"]["auto"];
    if auto["plan"].is_object() {
        print_plans(&mut out, auto, report["build"]["training"]["filter"].as_str().unwrap_or_default())?;
    } else {
        print_trials(&mut out, auto)?;
    }
    let update = &report["build"]["update"];
    if let Some(method) = update["method"].as_str() {
        let rebuilt = if update["rebuilt"] == true { ", rebuilt" } else { "" };
        writeln!(out, "{method}: {} rotations{rebuilt}", update["rotations"])?;
    }
    if let Some(stages) = report["optimized"]["stages"].as_array() {
        let mut cost = report["optimized"]["before"].as_f64().unwrap_or_default();
        for stage in stages {
            let after = stage["cost"].as_array().and_then(|costs| costs.last()?.as_f64()).unwrap_or(cost);
            let name = stage["name"].as_str().unwrap_or_default();
            writeln!(out, "{name}: {} moves, T from {cost:.4} to {after:.4} per query", stage["moves"])?;
            cost = after;
        }
    }
    writeln!(out, "{:<12}{:>10}{:>12}", "", "before", "after")?;
    for name in ["nodes", "leaves", "depth", "max_children", "max_leaf"] {
        let value = |tree: &str| report[tree][name].to_string();
        writeln!(out, "{:<12}{:>10}{:>12}", name.replace('_', " "), value("before"), value("after"))?;
    }
    print_order(&mut out, &report["order"])?;
    let cost = |tree: &str| report[tree]["sah_cost"].as_f64().unwrap_or_default();
    writeln!(out, "{:<12}{:>10.2}{:>12.2}", "SAH cost", cost("before"), cost("after"))
}

/// What was tried for the machine: a line for each plan, with what a judging query costs; and what
/// the tree is expected to gain over the input's, for the queries of `filter`.
fn print_plans(out: &mut impl Write, auto: &Value, filter: &str) -> std::io::Result<()> {
    let trials = auto["trials"].as_array().map(Vec::as_slice).unwrap_or_default();
    let unit = if auto["judges"] == 0 { "a random ray" } else { "a judging query" };
    writeln!(out, "{:<54}{:>18}", format!("{} judging queries", auto["judges"]), format!("ns, {unit}"))?;
    for (index, trial) in trials.iter().enumerate() {
        let plan = &trial["plan"];
        let text = |key: &str| plan[key].as_str().unwrap_or_default();
        let mut name = match text("start") {
            "input" => "the input's own tree".to_owned(),
            _ => format!("{} {}", text("splits"), text("heuristic")),
        };
        if let Some(weight) = plan["weight"].as_f64() {
            name += &format!(" {weight}");
        }
        if text("count") == "log-n" || plan["alpha"].as_f64().is_some_and(|alpha| alpha != 1.0) {
            name += &format!(", ({})^{:.2}", text("count"), plan["alpha"].as_f64().unwrap_or_default());
        }
        let [duplication, overlap] = ["max_duplication", "overlap"].map(|key| plan[key].as_f64());
        let default = spatial::Options::default();
        if let Some(duplication) = duplication.filter(|&value| value != default.max_duplication) {
            name += &format!(", duplication {duplication}");
        }
        if let Some(overlap) = overlap.filter(|&value| value != default.overlap) {
            name += &format!(", overlap {overlap}");
        }
        name += &format!(", {}", text("level"));
        if plan["part"] != 0 {
            name += &format!(" {}", plan["part"]);
        }
        let chosen = if auto["winner"] == index { "  chosen" } else { "" };
        writeln!(out, "{name:<54}{:>18.2}{chosen}", trial["cost"].as_f64().unwrap_or_default())?;
    }
    if auto["confirming"] == 0 {
        return Ok(());
    }
    let cost = &auto["cost"];
    let which = if filter.is_empty() { String::new() } else { format!(" with {filter}") };
    writeln!(out, "expected of other queries{which} ({} held out), ns each", auto["confirming"])?;
    writeln!(out, "{:<14}{:>10}{:>12}{:>12}{:>10}", "", "input", "area alone", "this tree", "ratio")?;
    for (key, name) in [("all", "all"), ("closest_hit", "closest hit"), ("occlusion", "occlusion")] {
        let of = |tree: &str| cost[tree][key].as_f64();
        if let (Some(input), Some(area), Some(tree)) = (of("input"), of("area"), of("tree")) {
            writeln!(out, "{name:<14}{input:>10.2}{area:>12.2}{tree:>12.2}{:>10.3}", tree / input)?;
        }
    }
    Ok(())
}

/// What auto tried: a line for each recipe, with what it costs a judging query and what that is of area alone.
fn print_trials(out: &mut impl Write, auto: &Value) -> std::io::Result<()> {
    let Some(trials) = auto["trials"].as_array().filter(|trials| !trials.is_empty()) else { return Ok(()) };
    writeln!(
        out,
        "{} judging queries: each\n{:<54}{:>10}{:>10}{:>10}",
        auto["judges"], "", "fitted to", "cost", "ratio"
    )?;
    let cost = |trial: &Value| trial["cost"].as_f64().unwrap_or_default();
    for (index, trial) in trials.iter().enumerate() {
        let recipe = &trial["recipe"];
        let text = |key: &str| recipe[key].as_str().unwrap_or_default();
        let mut name = format!("{} {}", text("splits"), text("heuristic"));
        if let Some(weight) = recipe["weight"].as_f64() {
            name += &format!(" {weight}");
        }
        if let Some(alpha) = recipe["alpha"].as_f64().filter(|&alpha| alpha != 1.0) {
            name += &format!(" alpha {alpha}");
        }
        for stage in recipe["optimize"].as_array().into_iter().flatten() {
            name += &format!(" + {}", stage.as_str().unwrap_or_default());
        }
        let chosen = if auto["winner"] == index { "  chosen" } else { "" };
        let ratio = cost(trial) / cost(&trials[0]);
        writeln!(
            out,
            "{name:<54}{:>10}{:>10.2}{ratio:>10.3}{chosen}",
            trial["queries"].to_string(),
            cost(trial)
        )?;
    }
    Ok(())
}
