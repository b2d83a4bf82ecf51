//! `trace-convert`: recordings and trees in the formats of other programs, and back.

use clap::{Parser, ValueEnum};
use embree_trace::cli::{self, Failure, Outcome, TextOrJson};
use embree_trace::convert::replayed::{Found, Replayer};
use embree_trace::convert::{ConvertError, Kind, Selection, Summary, copy, sink, source};
use embree_trace::files::{FileError, MappedFile, OutputFile};
use embree_trace::format::bvh::Bvh;
use embree_trace::format::rays::{Chunk, Codec};
use embree_trace::progress::Progress;
use embree_trace::replay::select::Filter;
use std::fmt;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Convert recordings between ours (.rays) and NumPy (.npy) and the ray files of RayVisualizer (2011)
#[derive(Parser)]
#[command(
    version,
    after_help = "\
Examples:
  trace-convert casts.rays casts.npy                       np.load(\"casts.npy\", mmap_mode=\"r\")
  trace-convert casts.npy casts.rays                       and back
  trace-convert casts.rays shadow.npy --filter purpose=shadow --sample 100000
  trace-convert casts.rays casts.rays2011                  for RayVisualizer
  trace-convert old.bin casts.rays --from rays-2011 --bvh built.bvh    with the triangle of every hit

The input's format is told by its content, the output's by its ending: .rays, .rays2011, .npy. --from and --to say it where
that does not. What the output's format has no place for is counted and printed; nothing is dropped silently. docs/formats.md says what each
format keeps.

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
    /// Only so many queries, evenly chosen from the whole file (before --filter)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    sample: Option<u64>,
    /// A tree of the scene: find the triangle of every hit that has none, as those of 2011 have
    #[arg(long, value_name = "TREE.bvh")]
    bvh: Option<PathBuf>,
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

fn main() -> ExitCode {
    let arguments: Arguments = cli::parse("trace-convert", std::env::args_os());
    cli::run("trace-convert", || run(&arguments))
}

fn run(arguments: &Arguments) -> Result<Outcome, Failure> {
    let (input, output) = (&arguments.input, &arguments.output);
    let file = MappedFile::open(input)?;
    let from = arguments.from.or_else(|| Kind::of_content(&file)).or_else(|| Kind::of_name(input));
    let from = from.ok_or_else(|| unknown(input, "--from"))?;
    let to = arguments.to.or_else(|| Kind::of_name(output)).ok_or_else(|| unknown(output, "--to"))?;
    let summary = queries(arguments, &file, from, to)?;
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

/// An error of the input, with its path.
fn in_input(arguments: &Arguments, error: ConvertError) -> Failure {
    Failure::new(format!("{}: {error}", arguments.input.display()))
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
        Ok(input) => in_input(arguments, input),
        Err(source) => FileError { source, ..error }.into(),
    })
}

fn queries(arguments: &Arguments, file: &[u8], from: Kind, to: Kind) -> Result<Summary, Failure> {
    let selection = Selection { filter: arguments.filter.clone(), sample: arguments.sample };
    let located = |error| in_input(arguments, error);
    let mut queries = source(file, from).map_err(located)?;
    let mut header = queries.header();
    let tree = arguments.bvh.as_deref().map(MappedFile::open).transpose()?;
    let in_tree = |error: &dyn fmt::Display| {
        let path = arguments.bvh.as_deref().unwrap_or(Path::new(""));
        Failure::new(format!("{}: {error}", path.display()))
    };
    let bvh = tree.as_deref().map(Bvh::parse).transpose().map_err(|error| in_tree(&error))?;
    let replayer = bvh.as_ref().map(|bvh| Replayer::new(bvh, header.fingerprint)).transpose();
    let replayer = replayer.map_err(|error| in_tree(&error))?;
    if let Some(bvh) = &bvh {
        header.fingerprint = bvh.header.fingerprint;
    }
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
    Ok(Summary {
        input: arguments.input.display().to_string(),
        from: from.name(),
        output: arguments.output.display().to_string(),
        to: to.name(),
        queries: chosen - losses.left_out_count(),
        bytes,
        losses,
        triangles,
    })
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
