//! `--order`: a traversal order for occlusion queries, and what they cost in it and in every other.

use crate::arguments::Arguments;
use embree_trace::optimize::order;
use embree_trace::training::occlusions::Occlusions;
use embree_trace::traverse::{Counts, OcclusionOrder, OrderName, Prepared};
use embree_trace::tree::TreeView;
use serde_json::{Value, json};
use std::io::Write;
use std::time::Instant;

/// The order of every node, and what occlusion queries cost in it and in every other.
pub fn ordered(
    prepared: &Prepared,
    tree: TreeView,
    queries: &Occlusions,
    arguments: &Arguments,
) -> (Vec<u8>, Value) {
    let config = order::Config { c_i: arguments.ci, c_p: arguments.cp, ..Default::default() };
    let started = Instant::now();
    let chosen = order::choose(prepared, tree.nodes.len(), &queries.training, &config);
    let seconds = started.elapsed().as_secs_f64();
    let mut report = json!({
        "training": queries.training.len(), "held_out": queries.held_out.len(), "deciding": chosen.deciding,
        "rounds": chosen.rounds, "seconds": seconds,
    });
    let counts = |counts: Counts| {
        json!({
            "node_visits": counts.node_visits, "box_tests": counts.box_tests, "primitive_tests": counts.primitive_tests,
        })
    };
    for (side, queries) in [("costs_training", &queries.training), ("costs_held_out", &queries.held_out)] {
        for name in OrderName::ALL {
            // Every name but `recorded` fits every tree, and that was made for this one.
            if let Ok(order) = OcclusionOrder::new(Some(name), tree, Some(&chosen.orders)) {
                report[side][name.key()] = counts(order::measure(prepared, &order, queries));
            }
        }
        report[side]["limit"] = counts(order::limit(prepared, queries));
    }
    (chosen.orders, report)
}

/// A line for each order: what an occlusion query costs in it, and what that is of nearest first.
pub fn print_order(out: &mut impl Write, order: &Value) -> std::io::Result<()> {
    for (side, count, name) in [
        ("costs_training", "training", "training occlusion queries"),
        ("costs_held_out", "held_out", "held-out occlusion queries"),
    ] {
        let queries = order[count].as_u64().unwrap_or_default();
        if queries == 0 {
            continue;
        }
        writeln!(out, "{queries} {name}: each\n{:<12}{:>10}{:>12}{:>10}", "", "visits", "box+prim", "ratio")?;
        let costs = &order[side];
        let number = |name: &str, key: &str| costs[name][key].as_u64().unwrap_or_default() as f64;
        let tests = |name: &str| number(name, "box_tests") + number(name, "primitive_tests");
        for name in OrderName::ALL.map(OrderName::key).into_iter().chain(["limit"]) {
            let (visits, tests, ratio) =
                (number(name, "node_visits"), tests(name), tests(name) / tests("nearest"));
            let each = queries as f64;
            writeln!(out, "{name:<12}{:>10.2}{:>12.2}{ratio:>10.3}", visits / each, tests / each)?;
        }
    }
    Ok(())
}
