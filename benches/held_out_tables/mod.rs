//! The tables of `held_out`, as Markdown: ratios to the control, scene by scene, and their medians.

pub mod chart;

use serde::{Deserialize, Serialize};
use std::fmt;

/// What a tree is in the comparison.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Kind {
    /// From area alone.
    Area,
    /// The full sweep from area, occlusion queries in a recorded order.
    SweepOrder,
    Embree,
    Crate,
    /// Trained on the queries of all purposes.
    Auto,
    AutoOrder,
    Limit,
    OtherCamera,
    /// Trained on camera queries.
    Camera,
    CameraLimit,
    /// Trained on shadow queries.
    Shadow,
    ShadowOrder,
    /// Several trees, each for the queries of its purpose.
    TreeAPurpose,
}

/// Box and primitive tests of a tree per held-out query, by purpose too; NaN where there is none.
#[derive(Serialize, Deserialize)]
pub struct Row {
    pub kind: Kind,
    pub name: String,
    pub all: f64,
    #[serde(deserialize_with = "number_or_none")]
    pub camera: f64,
    #[serde(deserialize_with = "number_or_none")]
    pub diffuse: f64,
    #[serde(deserialize_with = "number_or_none")]
    pub shadow: f64,
    /// Node visits of a shadow query.
    #[serde(deserialize_with = "number_or_none")]
    pub shadow_visits: f64,
    /// Answers that are neither the recorded one nor as good.
    pub wrong: u64,
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Row { name, all, camera, diffuse, shadow, shadow_visits, wrong, .. } = self;
        write!(
            f,
            "{name:<26} all {all:7.2}  camera {camera:7.2}  diffuse {diffuse:7.2}  shadow {shadow:7.2}, {shadow_visits:6.2} visits"
        )?;
        if *wrong > 0 { write!(f, "  {wrong} wrong") } else { Ok(()) }
    }
}

/// JSON has no NaN: it is written as null.
fn number_or_none<'de, D: serde::Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f64::NAN))
}

#[derive(Default, Serialize, Deserialize)]
pub struct SceneResult {
    pub name: String,
    pub triangles: usize,
    /// Queries that auto's tree is built from.
    pub training: usize,
    pub counted: u64,
    /// Parts of the counted queries.
    pub camera_share: f64,
    pub shadow_share: f64,
    /// What auto chose, trained on all queries.
    pub chosen: String,
    pub rows: Vec<Row>,
}

/// What is compared: a column of [`Row`].
type Cost = fn(&Row) -> f64;

/// Titles, and which trees stand below them.
type Columns<'a> = &'a [(&'a str, Kind)];

impl SceneResult {
    /// The cheapest tree of a kind, and its name.
    fn best(&self, kind: Kind, cost: Cost) -> Option<(f64, &str)> {
        let rows = self.rows.iter().filter(|row| row.kind == kind && cost(row).is_finite());
        rows.map(|row| (cost(row), row.name.as_str())).min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// What the cheapest tree of a kind costs, relative to the control.
    fn ratio(&self, kind: Kind, cost: Cost) -> f64 {
        let value = |kind| self.best(kind, cost).map_or(f64::NAN, |(cost, _)| cost);
        value(kind) / value(Kind::Area)
    }

    /// What queries cost when those from the camera and those of shadows go to trees of their own.
    pub fn tree_a_purpose(&self) -> Option<Row> {
        let row = |kind| self.rows.iter().find(|row| row.kind == kind);
        let (all, camera, shadow) = (row(Kind::AutoOrder)?, row(Kind::Camera)?, row(Kind::ShadowOrder)?);
        let other = all.all - self.camera_share * all.camera - self.shadow_share * all.shadow;
        Some(Row {
            kind: Kind::TreeAPurpose,
            name: "a tree a purpose".into(),
            all: other + self.camera_share * camera.camera + self.shadow_share * shadow.shadow,
            camera: camera.camera,
            diffuse: all.diffuse,
            shadow: shadow.shadow,
            shadow_visits: shadow.shadow_visits,
            // Counted where each tree has its own row.
            wrong: 0,
        })
    }

    fn wrong(&self, ours: bool) -> u64 {
        let is_ours = |row: &&Row| !matches!(row.kind, Kind::Embree | Kind::Crate);
        self.rows.iter().filter(|row| is_ours(row) == ours).map(|row| row.wrong).sum()
    }
}

pub fn print(scenes: &[SceneResult]) {
    ratios(
        scenes,
        "All queries",
        |row| row.all,
        &[
            ("auto", Kind::Auto),
            ("auto + order", Kind::AutoOrder),
            ("a tree a purpose", Kind::TreeAPurpose),
            ("other camera", Kind::OtherCamera),
            ("limit", Kind::Limit),
            ("Embree", Kind::Embree),
            ("crates", Kind::Crate),
        ],
    );
    let by_purpose: [(&str, Cost, Columns); 3] = [
        (
            "Camera queries",
            |row| row.camera,
            &[
                ("auto, all", Kind::Auto),
                ("auto, camera", Kind::Camera),
                ("limit", Kind::CameraLimit),
                ("other camera", Kind::OtherCamera),
                ("Embree", Kind::Embree),
                ("crates", Kind::Crate),
            ],
        ),
        (
            "Diffuse queries",
            |row| row.diffuse,
            &[("auto, all", Kind::Auto), ("Embree", Kind::Embree), ("crates", Kind::Crate)],
        ),
        (
            "Shadow queries",
            |row| row.shadow,
            &[
                ("auto, all", Kind::Auto),
                ("auto + order", Kind::AutoOrder),
                ("auto, shadow", Kind::Shadow),
                ("auto, shadow + order", Kind::ShadowOrder),
                ("Embree", Kind::Embree),
                ("crates", Kind::Crate),
            ],
        ),
    ];
    for (title, cost, columns) in by_purpose {
        ratios(scenes, title, cost, columns);
    }
    against_sweep(scenes);
    occlusion(scenes);
    choices(scenes);
}

/// What the control and auto cost, relative to the plain full sweep: the baseline of most of the literature.
fn against_sweep(scenes: &[SceneResult]) {
    println!("\nRelative to the full sweep from area, as it is built (leaves of up to eight)\n");
    println!(
        "| scene | control, camera | auto, camera | control, diffuse | auto, diffuse | control, all | auto + order, all |"
    );
    println!("|---|--:|--:|--:|--:|--:|--:|");
    let columns: [(Kind, Cost); 6] = [
        (Kind::Area, |row| row.camera),
        (Kind::Camera, |row| row.camera),
        (Kind::Area, |row| row.diffuse),
        (Kind::Auto, |row| row.diffuse),
        (Kind::Area, |row| row.all),
        (Kind::AutoOrder, |row| row.all),
    ];
    let mut all = [const { Vec::new() }; 6];
    for scene in scenes {
        let Some(sweep) = scene.rows.iter().find(|row| row.name == SWEEP) else { continue };
        let mut line = format!("| {} |", scene.name);
        for ((kind, cost), all) in columns.iter().zip(&mut all) {
            let ratio = scene.best(*kind, *cost).map_or(f64::NAN, |(tests, _)| tests) / cost(sweep);
            line += &format!(" {} |", number(ratio));
            all.extend(ratio.is_finite().then_some(ratio));
        }
        println!("{line}");
    }
    let medians = all.each_mut().map(|ratios| number(median(ratios)));
    println!("| **median** | {} |", medians.join(" | "));
}

/// A table of what trees cost, relative to the control.
fn ratios(scenes: &[SceneResult], title: &str, cost: Cost, columns: Columns) {
    println!("\n{title}: the control's box and primitive tests, and the others' relative to them\n");
    let names: Vec<&str> = columns.iter().map(|(name, _)| *name).collect();
    println!("| scene | control | tests | {} |", names.join(" | "));
    println!("|---|---|--:|{}", "--:|".repeat(columns.len()));
    let mut all = vec![Vec::new(); columns.len()];
    for scene in scenes {
        let Some((tests, control)) = scene.best(Kind::Area, cost) else { continue };
        let mut line = format!("| {} | {control} | {tests:.1} |", scene.name);
        for ((_, kind), all) in columns.iter().zip(&mut all) {
            let ratio = scene.ratio(*kind, cost);
            line += &format!(" {} |", number(ratio));
            all.extend(ratio.is_finite().then_some(ratio));
        }
        println!("{line}");
    }
    let medians: Vec<String> = all.iter_mut().map(|ratios| number(median(ratios))).collect();
    println!("| **median** | | | {} |", medians.join(" | "));
    let worst = |ratios: &Vec<f64>| number(ratios.iter().copied().fold(f64::NAN, f64::max));
    println!("| **worst** | | | {} |", all.iter().map(worst).collect::<Vec<String>>().join(" | "));
}

/// What tree and order bring for shadow queries, each alone and together, in node visits.
fn occlusion(scenes: &[SceneResult]) {
    println!("\nNode visits of a shadow query, relative to the sweep's tree visited nearest first\n");
    println!("| scene | sweep | sweep + order | auto, shadow | auto, shadow + order | auto + order |");
    println!("|---|--:|--:|--:|--:|--:|");
    let kinds = [Kind::SweepOrder, Kind::Shadow, Kind::ShadowOrder, Kind::AutoOrder];
    let mut all = [const { Vec::new() }; 4];
    for scene in scenes {
        let Some(sweep) = scene.rows.iter().find(|row| row.name == SWEEP) else { continue };
        let visits = sweep.shadow_visits;
        if !visits.is_finite() {
            continue;
        }
        let mut line = format!("| {} | {visits:.1} |", scene.name);
        for (kind, all) in kinds.into_iter().zip(&mut all) {
            let row = scene.rows.iter().find(|row| row.kind == kind);
            let ratio = row.map_or(f64::NAN, |row| row.shadow_visits) / visits;
            line += &format!(" {} |", number(ratio));
            all.extend(ratio.is_finite().then_some(ratio));
        }
        println!("{line}");
    }
    let medians = all.each_mut().map(|ratios| number(median(ratios)));
    println!("| **median** | | {} |", medians.join(" | "));
}

/// The full sweep from area, as it was built.
pub const SWEEP: &str = "sweep";

/// What was measured, and which tree of others was the best.
fn choices(scenes: &[SceneResult]) {
    println!("\nWhat was counted, what auto chose, the best trees of others, and wrong answers\n");
    println!(
        "| scene | triangles | training queries | counted | auto | best of Embree | best crate | wrong: ours | others |"
    );
    println!("|---|--:|--:|--:|---|---|---|--:|--:|");
    for scene in scenes {
        let name = |kind| scene.best(kind, |row| row.all).map_or("", |(_, name)| name);
        println!(
            "| {} | {} | {} | {} | {} | {} | {} | {} | {} |",
            scene.name,
            scene.triangles,
            scene.training,
            scene.counted,
            scene.chosen,
            name(Kind::Embree),
            name(Kind::Crate),
            scene.wrong(true),
            scene.wrong(false)
        );
    }
}

fn number(ratio: f64) -> String {
    if ratio.is_finite() { format!("{ratio:.3}") } else { "–".into() }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        count if count % 2 == 1 => values[count / 2],
        count => (values[count / 2 - 1] + values[count / 2]) / 2.0,
    }
}
