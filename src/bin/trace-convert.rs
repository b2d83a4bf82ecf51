//! `trace-convert`: recordings and trees in the formats of other programs, and back.

use bytes::Bytes;
use clap::{Parser, ValueEnum};
use embree_trace::cli::{self, Failure, Outcome, TextOrJson};
use embree_trace::convert::boxes::Style;
use embree_trace::convert::numbering::{Numbering, NumberingError};
use embree_trace::convert::replayed::{Found, Replayer};
use embree_trace::convert::trees::{self, Part};
use embree_trace::convert::{ConvertError, Kind, Losses, Selection, Summary, copy, scenes, sink, source};
use embree_trace::files::{FileError, MappedFile, OutputFile};
use embree_trace::format::bvh::Bvh;
use embree_trace::format::rays::{Chunk, Codec};
use embree_trace::progress::Progress;
use embree_trace::replay::select::{Filter, parse_range};
use std::io::{self, Write};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Convert recordings and trees between ours (.rays, .bvh) and NumPy, Parquet, OBJ, and the files of RayVisualizer (2011)
#[derive(Parser)]
#[command(
    version,
    after_help = "\
Examples:
  trace-convert casts.rays casts.parquet                   for pandas, Polars, DuckDB, Spark; and back, losing nothing
  trace-convert casts.rays casts.npy                       np.load(\"casts.npy\", mmap_mode=\"r\")
  trace-convert casts.rays shadow.npy --filter purpose=shadow --sample 100000
  trace-convert casts.rays rays.obj --sample 2000          lines for Blender and MeshLab
  trace-convert built.bvh boxes.obj --level 0..=5          and boxes of the tree
  trace-convert built.bvh scene.obj --part triangles
  trace-convert built.bvh nodes.npy --part nodes
  trace-convert casts.rays casts.rays2011                  for RayVisualizer
  trace-convert built.bvh built.bvh2011 --mesh scene.obj
  trace-convert old.bin casts.rays --from rays-2011 --bvh built.bvh    with the triangle of every hit
  trace-convert old.bvh2011 old.bvh --mesh scene.obj

The input's format is told by its content, the output's by its ending: .rays, .npy, .parquet, .rays2011, .bvh, .bvh2011, .obj. --from and --to
say it where that does not. Queries go from each of rays, npy, parquet and rays-2011 to each, and to obj; trees from bvh to bvh-2011, npy
and obj, and from bvh-2011 to bvh. What the output's format has no place for is counted and printed; nothing is dropped silently.
docs/formats.md says what each format keeps.

Exit codes: 0 good (something may have been lost: it is said), 2 bad input or usage."
)]
struct Arguments {
    /// The file to read
    input: PathBuf,
    /// The file to write; an older one is replaced when the new one is whole
    output: PathBuf,
    /// The format of the input
    #[arg(long, value_enum, value_name = "FORMAT")]
    from: Option<Kind>,
    /// The format of the output
    #[arg(long, value_enum, value_name = "FORMAT")]
    to: Option<Kind>,
    /// Only these queries, written as for bvh-compare: purpose=camera+diffuse,depth=1..
    #[arg(long, default_value = "", hide_default_value = true)]
    filter: Filter,
    /// Only so many queries, evenly chosen from the whole file (before --filter); to an OBJ, 10000 when nothing is said
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    sample: Option<u64>,
    /// Only the queries of this scene, when the recording holds several
    #[arg(long, value_name = "N")]
    scene: Option<u16>,
    /// A tree of the scene: find the triangle of every hit that has none, as those of 2011 have
    #[arg(long, value_name = "TREE.bvh")]
    bvh: Option<PathBuf>,
    /// The scene of a tree of 2011: its files number the triangles in the order of the scene file. Without it, one that is written has the numbers of
    /// the .bvh's triangles, which --part triangles writes as an OBJ
    #[arg(long, value_name = "SCENE.obj")]
    mesh: Option<PathBuf>,
    /// What of a tree to write: by default nodes to .npy, boxes to .obj
    #[arg(long, value_enum)]
    part: Option<Part>,
    /// Boxes of these levels of a tree, the root's is 0: 3, 0..=5, 4..
    #[arg(long, default_value = "0..=5", value_name = "LEVELS", value_parser = levels)]
    level: RangeInclusive<u32>,
    /// How to draw boxes
    #[arg(long, value_enum, default_value = "edges")]
    boxes: Style,
    /// How to store the chunks of a .rays
    #[arg(long, value_enum, default_value = "compressed")]
    codec: CodecName,
    /// How to print what was done
    #[arg(long, value_enum, default_value = "text")]
    format: TextOrJson,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CodecName {
    /// As in memory, to be viewed in place
    Raw,
    /// zstd
    Compressed,
}

fn levels(text: &str) -> Result<RangeInclusive<u32>, String> {
    parse_range(text).ok_or_else(|| "expected a level or a range, such as 3, 0..=5 or 4..".into())
}

/// Lines of an OBJ when nothing is said: more are a haze, and slow in Blender.
const LINES: u64 = 10_000;

fn main() -> ExitCode {
    let arguments: Arguments = cli::parse("trace-convert", std::env::args_os());
    cli::run("trace-convert", || run(&arguments))
}

fn run(arguments: &Arguments) -> Result<Outcome, Failure> {
    let (input, output) = (&arguments.input, &arguments.output);
    let file = Bytes::from_owner(MappedFile::open(input)?);
    let from = arguments.from.or_else(|| Kind::of_content(&file)).or_else(|| Kind::of_name(input));
    let from = from.ok_or_else(|| unknown(input, "--from"))?;
    let to = arguments.to.or_else(|| Kind::of_name(output)).ok_or_else(|| unknown(output, "--to"))?;
    if from.is_tree()
        && (arguments.filter != Filter::default()
            || arguments.sample.is_some()
            || arguments.scene.is_some()
            || arguments.bvh.is_some())
    {
        return Err(Failure::new(format!(
            "{}: --filter, --sample, --scene and --bvh are for queries, and this is a tree",
            input.display()
        )));
    }
    if !from.is_tree() && (arguments.mesh.is_some() || arguments.part.is_some()) {
        return Err(Failure::new(format!(
            "{}: --mesh and --part are for trees, and these are queries",
            input.display()
        )));
    }
    let summary = match from.is_tree() {
        true => tree(arguments, &file, from, to)?,
        false => queries(arguments, &file, from, to)?,
    };
    let mut out = io::stdout().lock();
    match arguments.format {
        TextOrJson::Text => write!(out, "{summary}")?,
        TextOrJson::Json => writeln!(out, "{}", serde_json::to_string(&summary)?)?,
    }
    Ok(Outcome::Good)
}

fn unknown(path: &Path, option: &str) -> Failure {
    Failure::new(format!(
        "{}: neither content nor ending says which format this is: add {option}",
        path.display()
    ))
}

/// Writes the output, whole or not at all, and counts its bytes.
fn write<T>(
    arguments: &Arguments,
    convert: impl FnOnce(&mut dyn Write) -> Result<T, ConvertError>,
) -> Result<(u64, T), Failure> {
    let output = OutputFile::create(&arguments.output)?;
    let written = output.commit_with(|out| {
        let mut out = Counted { out, bytes: 0 };
        let value = convert(&mut out).map_err(|error| match error {
            ConvertError::Output(error) => error,
            error => io::Error::other(error),
        })?;
        Ok((out.bytes, value))
    });
    written.map_err(|error| match error.source.downcast::<ConvertError>() {
        Ok(error) => Failure::in_file(&arguments.input, error),
        Err(source) => FileError { source, ..error }.into(),
    })
}

fn queries(arguments: &Arguments, file: &Bytes, from: Kind, to: Kind) -> Result<Summary, Failure> {
    let sample = arguments.sample.or((to == Kind::Obj).then_some(LINES));
    let selection = Selection { filter: arguments.filter.clone(), sample, scene: arguments.scene };
    let located = |error: ConvertError| Failure::in_file(&arguments.input, error);
    let mut queries = source(file, from).map_err(located)?;
    let mut header = queries.header();
    let tree = arguments.bvh.as_deref().map(MappedFile::open).transpose()?;
    let tree_path = arguments.bvh.as_deref().unwrap_or(Path::new(""));
    let bvh = tree.as_deref().map(Bvh::parse).transpose();
    let bvh = bvh.map_err(|error| Failure::in_file(tree_path, error))?;
    let replayer = match &bvh {
        Some(bvh) => {
            let scenes = source(file, from).and_then(|mut source| scenes(&mut *source)).map_err(located)?;
            // Of several scenes no fingerprint can be said.
            if scenes.numbers.len() < 2 || arguments.scene.is_some() {
                header.fingerprint = bvh.header.fingerprint;
            }
            let replayer = Replayer::new(bvh, &scenes, arguments.scene);
            Some(replayer.map_err(|error| Failure::in_file(tree_path, error))?)
        }
        None => None,
    };
    // Only an array says before its elements how many there are.
    let count = match to {
        Kind::Npy => {
            source(file, from).and_then(|mut source| selection.count(&mut *source)).map_err(located)?
        }
        _ => 0,
    };

    let codec = match arguments.codec {
        CodecName::Raw => Codec::Raw,
        CodecName::Compressed => Codec::Compressed,
    };

    let progress = Progress::new("converting", queries.count());
    let mut triangles = replayer.as_ref().map(|_| Found::default());
    let complete = |chunk: &mut Chunk| {
        if let (Some(replayer), Some(found)) = (&replayer, &mut triangles) {
            *found = *found + replayer.complete(chunk);
        }
    };
    let (bytes, (chosen, losses)) = write(arguments, |out| {
        let sink = sink(out, to, &header, count, codec)?;
        copy(&mut *queries, &selection, complete, sink, &progress)
    })?;
    drop(progress);
    let count = chosen - losses.left_out_count();
    Ok(Summary { bytes, count, triangles, ..summary(arguments, from, to, "queries", losses) })
}

/// What is said of every conversion.
fn summary(arguments: &Arguments, from: Kind, to: Kind, unit: &'static str, losses: Losses) -> Summary {
    Summary {
        input: arguments.input.display().to_string(),
        from: from.name(),
        output: arguments.output.display().to_string(),
        to: to.name(),
        unit,
        count: 0,
        bytes: 0,
        losses,
        triangles: None,
        warnings: Vec::new(),
    }
}

fn tree(arguments: &Arguments, file: &Bytes, from: Kind, to: Kind) -> Result<Summary, Failure> {
    let mesh = arguments.mesh.as_deref();
    let in_mesh = |error: NumberingError| Failure::in_file(mesh.unwrap_or(Path::new("")), error);
    let numbering = mesh.map(Numbering::read).transpose().map_err(in_mesh)?;
    let (bytes, converted) = if from == Kind::Bvh {
        let bvh = Bvh::parse(file).map_err(|error| Failure::in_file(&arguments.input, error))?;
        let checked = numbering.as_ref().map(|numbering| numbering.check(bvh.triangles)).transpose();
        checked.map_err(in_mesh)?;
        let options =
            trees::Options { part: arguments.part, levels: arguments.level.clone(), style: arguments.boxes };
        write(arguments, |out| trees::from_ours(&bvh, to, numbering.as_ref(), &options, out))?
    } else if to == Kind::Bvh {
        let numbering = numbering.as_ref().ok_or_else(|| {
            Failure::new(
                "a tree of 2011 holds no triangles: give the scene file that it was built for with --mesh",
            )
        })?;
        write(arguments, |out| trees::from_2011(file, numbering, out))?
    } else {
        let pair = ConvertError::Pair { from: from.name(), to: to.name() };
        return Err(Failure::in_file(&arguments.input, pair));
    };
    let trees::Converted { unit, count, losses, warnings } = converted;
    Ok(Summary { bytes, count, warnings, ..summary(arguments, from, to, unit, losses) })
}

/// Counts what goes through.
struct Counted<'a> {
    out: &'a mut dyn Write,
    bytes: u64,
}

impl Write for Counted<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}
