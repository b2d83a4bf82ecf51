//! What tuning brought, as text or JSON: by scene and in all, medians over the rounds and their spread.

use super::build::{Built, BuiltTree};
use super::outputs::Output;
use super::{Options, TuneError};
use crate::files::{FileError, OutputFile};
use crate::median::median;
use crate::record::program::clocks::{KindTime, SceneKey, SceneTime};
use crate::record::program::report::Report as Recorded;
use crate::record::program::timed::Timed;
use crate::record::program::trees::PlantedScene;
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt;
use std::fs;
use std::path::Path;

/// One run on Embree's trees, and one on planted trees.
#[derive(Clone, Debug)]
pub struct Round {
    pub plain: Timed,
    pub planted: Timed,
}

/// A time on both kinds of trees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Measure {
    /// Seconds, medians over the rounds.
    pub plain: f64,
    pub planted: f64,
    /// Planted over plain within a round: the median, and the least and the greatest.
    pub ratio: f64,
    pub least: f64,
    pub greatest: f64,
}

impl Measure {
    /// Of seconds on Embree's trees and on planted ones, a pair a round; `None` where nothing took time.
    fn of(pairs: Vec<(f64, f64)>) -> Option<Measure> {
        let timed: Vec<(f64, f64)> =
            pairs.into_iter().filter(|(plain, planted)| *plain > 0.0 && *planted > 0.0).collect();
        let mut ratios: Vec<f64> = timed.iter().map(|(plain, planted)| planted / plain).collect();
        let (mut plain, mut planted): (Vec<f64>, Vec<f64>) = timed.into_iter().unzip();
        let ratio = median(&mut ratios)?;
        Some(Measure {
            plain: median(&mut plain)?,
            planted: median(&mut planted)?,
            ratio,
            least: ratios[0],
            greatest: ratios[ratios.len() - 1],
        })
    }
}

/// A scene that a tree was built for.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SceneRow {
    /// Where the tree is.
    pub tree: String,
    pub triangles: u64,
    /// Queries of the first plain run.
    pub queries: u64,
    /// Queries that the tree was built from.
    pub trained: usize,
    /// Ratio of the costs of a query, by count, on queries that the tree was not built from.
    pub expected: Option<f64>,
    /// Whether it was planted in every round.
    pub planted: bool,
    /// Processor time inside of Embree; `None` when the tree was not planted, or the queries were too few for the clock.
    pub embree: Option<Measure>,
    pub closest_hit: Option<Measure>,
    pub occlusion: Option<Measure>,
    /// What planting took, in a run.
    pub planting_seconds: f64,
    /// Whether it pays: it stays in the directory of trees.
    pub kept: bool,
}

/// See the module.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The program and its arguments.
    pub command: Vec<String>,
    pub trees: String,
    pub rounds: u32,
    /// Of the first plain run, and those that were recorded.
    pub queries: u64,
    pub recorded: u64,
    /// Share of the program's processor time that is spent inside of Embree's queries.
    pub share: f64,
    /// Slowest first.
    pub scenes: Vec<SceneRow>,
    /// Processor time inside of Embree's queries, of all scenes, with or without a tree.
    pub embree: Option<Measure>,
    /// Processor time of the program.
    pub program: Option<Measure>,
    /// From start to end.
    pub elapsed: Option<Measure>,
    pub outputs: Vec<Output>,
    pub warnings: Vec<String>,
    /// What to type from now on; `None` when no tree pays.
    pub next: Option<String>,
}

impl Report {
    pub(super) fn new(
        options: &Options,
        recorded: &Recorded,
        built: Built,
        rounds: &[Round],
        outputs: Vec<Output>,
    ) -> Report {
        let measure = |seconds: &dyn Fn(&Timed) -> f64| {
            Measure::of(rounds.iter().map(|round| (seconds(&round.plain), seconds(&round.planted))).collect())
        };
        let embree = measure(&|timed| timed.total().seconds());
        let program = measure(&|timed| timed.processor_seconds);
        let mut scenes: Vec<SceneRow> = built.trees.iter().map(|tree| scene_row(tree, rounds)).collect();
        scenes.sort_by(|a, b| seconds_of(b).total_cmp(&seconds_of(a)));
        let mut warnings: BTreeSet<String> = built.left_out.into_iter().collect();
        warnings.extend(rounds.iter().flat_map(|round| round.planted.planting.warnings.clone()));
        warnings.extend(recorded.warnings.iter().cloned());
        let command: Vec<String> =
            options.program.words().map(|word| word.to_string_lossy().into_owned()).collect();
        let trees = options.trees.display().to_string();
        let queries = rounds.first().map_or(0, |round| round.plain.total().queries());
        let planting: f64 = scenes.iter().map(|scene| scene.planting_seconds).sum();
        warnings.extend(pays_from(embree, program, queries, planting));
        let next = scenes.iter().any(|scene| scene.kept).then(|| {
            let words: Vec<String> = command.iter().map(|word| quoted(word)).collect();
            format!("embree-trace run --trees {} -- {}", quoted(&trees), words.join(" "))
        });
        Report {
            queries,
            recorded: recorded.records,
            share: embree.zip(program).map_or(0.0, |(embree, program)| embree.plain / program.plain),
            command,
            trees,
            rounds: options.rounds,
            scenes,
            embree,
            program,
            elapsed: measure(&|timed| timed.seconds),
            outputs,
            warnings: warnings.into_iter().collect(),
            next,
        }
    }

    /// Moves trees that do not pay out of the directory of trees.
    ///
    /// # Errors
    /// When one cannot be moved.
    pub(super) fn put_aside(&mut self, kept: &Path) -> Result<(), TuneError> {
        for scene in self.scenes.iter_mut().filter(|scene| !scene.kept) {
            let from = Path::new(&scene.tree);
            let to = kept.join(from.file_name().unwrap_or_default());
            fs::rename(from, &to).map_err(|error| FileError::new(from, "move", error))?;
            scene.tree = to.display().to_string();
        }
        Ok(())
    }

    /// Writes the report as JSON.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub(super) fn write(&self, path: &Path) -> Result<(), FileError> {
        OutputFile::create(path)?.commit_with(|out| {
            serde_json::to_writer_pretty(&mut *out, self)?;
            out.write_all(b"\n")
        })
    }

    /// Whether planted trees change a file by more than the program itself does; of pictures, by more than `allowed` pixels.
    pub fn is_changed(&self, allowed: u64) -> bool {
        self.outputs.iter().any(|output| output.is_changed(allowed))
    }
}

fn seconds_of(scene: &SceneRow) -> f64 {
    scene.embree.map_or(0.0, |measure| measure.plain)
}

/// A word on short runs, in which planting takes longer than its trees save: from how many queries on it pays.
fn pays_from(
    embree: Option<Measure>,
    program: Option<Measure>,
    queries: u64,
    planting_seconds: f64,
) -> Option<String> {
    let saved = embree.map(|measure| measure.plain - measure.planted).filter(|&saved| saved > 0.0)?;
    program.filter(|measure| measure.ratio > 1.0 && planting_seconds > saved)?;
    let from = queries as f64 * planting_seconds / saved;
    Some(format!(
        "planting takes {planting_seconds:.3} s of a run, and its trees save {saved:.3} s: they pay where the program asks more than about {from:.0} queries"
    ))
}

/// A scene is the same one in both runs of a round when its geometries are.
fn scene_row(tree: &BuiltTree, rounds: &[Round]) -> SceneRow {
    let path = tree.path.display().to_string();
    let mut sums: Vec<(SceneTime, SceneTime)> = Vec::new();
    let mut planting_seconds = Vec::new();
    let mut is_planted = true;
    for Round { plain, planted } in rounds {
        let is_ours = |scene: &&PlantedScene| scene.tree.as_deref() == Some(&path);
        let here: Vec<&PlantedScene> = planted.planting.scenes.iter().filter(is_ours).collect();
        is_planted &= !here.is_empty();
        planting_seconds.push(here.iter().map(|scene| scene.seconds).sum::<f64>());
        let is_here = |key: &SceneKey| {
            key.geometry != 0
                && here.iter().any(|scene| (scene.process, scene.scene) == (key.process, key.scene))
        };
        let geometries: BTreeSet<u64> =
            planted.times.keys().filter(|key| is_here(key)).map(|key| key.geometry).collect();
        let sum = |timed: &Timed| {
            let mut sum = SceneTime::default();
            for (_, time) in timed.times.iter().filter(|(key, _)| geometries.contains(&key.geometry)) {
                sum.add(time);
            }
            sum
        };
        sums.push((sum(plain), sum(planted)));
    }
    let measure = |seconds: &dyn Fn(&SceneTime) -> f64| {
        Measure::of(sums.iter().map(|(plain, planted)| (seconds(plain), seconds(planted))).collect())
    };
    let kind = |of: fn(&SceneTime) -> KindTime| measure(&|time| of(time).seconds);
    let embree = measure(&SceneTime::seconds);
    SceneRow {
        tree: path,
        triangles: tree.triangles,
        queries: sums.first().map_or(0, |(plain, _)| plain.queries()),
        trained: tree.queries,
        expected: tree.expected,
        planted: is_planted,
        embree,
        closest_hit: kind(|time| time.closest_hit),
        occlusion: kind(|time| time.occlusion),
        planting_seconds: median(&mut planting_seconds).unwrap_or(0.0),
        kept: embree.is_some_and(|measure| measure.ratio < 1.0),
    }
}

/// A word as a shell takes it for one.
fn quoted(word: &str) -> String {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "_-./=:,+@%".contains(letter);
    if !word.is_empty() && word.chars().all(is_plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

impl fmt::Display for Measure {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Measure { plain, planted, ratio, least, greatest } = self;
        write!(f, "{plain:.3} s -> {planted:.3} s: {ratio:.3} ({least:.3} to {greatest:.3})")
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let rounds = match self.rounds {
            1 => "1 round".to_owned(),
            count => format!("{count} rounds"),
        };
        writeln!(
            f,
            "asked    {} queries in a run, {:.0}% of the program's processor time; {} were recorded",
            self.queries,
            100.0 * self.share,
            self.recorded
        )?;
        for scene in &self.scenes {
            let SceneRow { tree, triangles, queries, planted, embree, kept, planting_seconds, .. } = scene;
            writeln!(f, "scene    {triangles} triangles, {queries} queries: {tree}")?;
            match embree {
                Some(measure) => writeln!(f, "         in Embree     {measure}")?,
                None if *planted => writeln!(f, "         too few queries to be timed")?,
                None => writeln!(f, "         not planted")?,
            }
            for (name, kind) in [("closest hit", scene.closest_hit), ("occlusion", scene.occlusion)] {
                if let Some(measure) = kind {
                    writeln!(f, "         {name:<13} {measure}")?;
                }
            }
            if let Some(expected) = scene.expected {
                writeln!(
                    f,
                    "         expected      {expected:.3} by count; planted in {planting_seconds:.3} s"
                )?;
            }
            if !kept {
                writeln!(f, "         it does not pay, and is put aside")?;
            }
        }
        let rows = [("in Embree", self.embree), ("processor", self.program), ("elapsed", self.elapsed)];
        for (number, (name, measure)) in rows.into_iter().enumerate() {
            let start = if number == 0 { "all" } else { "" };
            if let Some(measure) = measure {
                let rounds = if number == 0 { format!(", {rounds}") } else { String::new() };
                writeln!(f, "{start:<8} {name:<13} {measure}{rounds}")?;
            }
        }
        for output in &self.outputs {
            writeln!(f, "output   {output}")?;
        }
        match &self.next {
            Some(next) => writeln!(f, "next     {next}"),
            None => writeln!(f, "next     nothing: no tree of ours is faster than Embree's"),
        }
    }
}

impl fmt::Display for Output {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Output { path, size, plain, planted, picture } = self;
        write!(f, "{path}: ")?;
        match (planted.differing, planted.pixels, size) {
            (0, ..) => write!(f, "the same in {} runs on planted trees", planted.runs)?,
            (_, Some(pixels), Some((width, height))) => {
                let all = u64::from(*width) * u64::from(*height);
                write!(f, "{pixels} of {all} pixels differ on planted trees")?;
                if let Some(greatest) = planted.greatest {
                    write!(f, ", by {greatest:.4} at most")?;
                }
            }
            (differing, ..) => write!(f, "differs in {differing} of {} runs on planted trees", planted.runs)?,
        }
        match (plain.differing, plain.pixels) {
            (0, _) => {}
            (_, Some(pixels)) => write!(f, "; {pixels} pixels differ among runs on Embree's trees, too")?,
            (..) => write!(f, "; it differs among runs on Embree's trees, too")?,
        }
        if let Some(picture) = picture {
            write!(f, "; see {picture}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ratios_are_of_rounds() {
        let measure = Measure::of(vec![(2.0, 1.0), (4.0, 3.0), (1.0, 0.8), (0.0, 0.0)]).expect("times");
        assert_eq!((measure.plain, measure.planted), (2.0, 1.0));
        assert_eq!((measure.ratio, measure.least, measure.greatest), (0.75, 0.5, 0.8));
        assert_eq!(Measure::of(vec![(0.0, 1.0)]), None);
    }

    #[test]
    fn short_runs_are_told() {
        let measure = |plain, planted| Measure::of(vec![(plain, planted)]);
        let told = pays_from(measure(2.0, 1.0), measure(5.0, 6.0), 1000, 2.0).expect("short");
        assert!(told.ends_with("more than about 2000 queries"), "{told}");
        assert_eq!(pays_from(measure(2.0, 1.0), measure(5.0, 4.9), 1000, 2.0), None);
        assert_eq!(pays_from(measure(2.0, 3.0), measure(5.0, 6.0), 1000, 2.0), None);
    }

    #[test]
    fn words_are_quoted_for_a_shell() {
        for word in ["a b", "it's", "", "$HOME", "a;b", "plain-word.ppm"] {
            let output = std::process::Command::new("sh")
                .args(["-c", &format!("printf %s {}", quoted(word))])
                .output()
                .expect("a shell");
            assert_eq!(String::from_utf8_lossy(&output.stdout), word);
        }
    }
}
