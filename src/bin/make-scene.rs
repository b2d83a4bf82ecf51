//! Writes a generated scene as OBJ and MTL: for the demo, for tests, and for measuring when no other scene is at hand.

use clap::{Parser, ValueEnum};
use embree_trace::cli::{self, Failure, Outcome, TextOrJson};
use embree_trace::files::OutputFile;
use embree_trace::mesh::generate::Sequence;
use embree_trace::mesh::{Mesh, generate, obj};
use embree_trace::progress::Progress;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Write a generated scene: the same bytes on every machine.
#[derive(Parser)]
#[command(
    name = "make-scene",
    version,
    after_help = "Examples:
  make-scene cornell-box box.obj
  make-scene courtyard court.obj --detail 18       a million triangles
  make-scene courtyard court.obj --triangles 200000
  make-scene terrain land.obj --triangles 10000000
  make-scene twist column.obj --frames 20          column.0000.obj to column.0019.obj, the same faces in each"
)]
struct Arguments {
    /// Which scene
    scene: Scene,
    /// The OBJ file to write; its materials go beside it, as .mtl
    output: PathBuf,
    /// How fine: courtyard: triangles grow with its square (1: 5 thousand, 18: a million, 56: ten million);
    /// quads: cells along a side; slivers: needles; all others: triangles
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=LARGEST as i64))]
    detail: Option<u32>,
    /// How fine, as about so many triangles
    #[arg(long, value_name = "N", conflicts_with = "detail", value_parser = clap::value_parser!(u32).range(1..))]
    triangles: Option<u32>,
    /// Frames of a scene that moves (twist, burst, cloth, crossing), each with its number before the .obj; 1 is the first one alone
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    frames: u32,
    /// Seed of the random numbers, where the scene uses any
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// What to print
    #[arg(long, value_enum, default_value_t = TextOrJson::Text)]
    format: TextOrJson,
}

/// The largest detail of any scene.
const LARGEST: u32 = 200_000_000;

#[derive(Clone, Copy, ValueEnum)]
enum Scene {
    CornellBox,
    Courtyard,
    Slivers,
    Coincident,
    Quads,
    Terrain,
    Soup,
    Twist,
    Burst,
    Cloth,
    Crossing,
}

impl Scene {
    fn moves(self) -> bool {
        matches!(self, Scene::Twist | Scene::Burst | Scene::Cloth | Scene::Crossing)
    }

    /// The default of `--detail`, and the largest that 32-bit indices allow for.
    fn detail(self) -> (u32, u32) {
        match self {
            Scene::Courtyard => (4, 400),
            Scene::Quads => (16, 10_000),
            Scene::Slivers => (600, LARGEST),
            Scene::Twist | Scene::Burst | Scene::Cloth | Scene::Crossing => (100_000, LARGEST),
            Scene::CornellBox | Scene::Coincident | Scene::Terrain | Scene::Soup => (1_000_000, LARGEST),
        }
    }

    /// The detail that comes nearest to a number of triangles.
    fn detail_for(self, triangles: u32) -> u32 {
        let per_square = |count: f64| ((f64::from(triangles) / count).sqrt().round() as u32).max(1);
        match self {
            Scene::Courtyard => per_square(3_300.0),
            Scene::Quads => per_square(4.0),
            _ => triangles,
        }
    }

    /// `time` is that of a frame, from 0 to 1.
    fn generate(self, detail: u32, seed: u64, time: f64) -> Mesh {
        match self {
            Scene::CornellBox => generate::cornell_box(),
            Scene::Courtyard => generate::courtyard(detail, seed),
            Scene::Slivers => generate::slivers(detail, seed),
            Scene::Coincident => generate::coincident(),
            Scene::Quads => generate::quads(detail),
            Scene::Terrain => generate::terrain(detail as usize, seed),
            Scene::Soup => generate::soup(detail as usize, seed),
            Scene::Twist => Sequence::Twist.frame(detail, time),
            Scene::Burst => Sequence::Burst.frame(detail, time),
            Scene::Cloth => Sequence::Cloth.frame(detail, time),
            Scene::Crossing => Sequence::Crossing.frame(detail, time),
        }
    }
}

fn main() -> ExitCode {
    let arguments: Arguments = cli::parse("make-scene", std::env::args_os());
    cli::run("make-scene", || {
        let (default, largest) = arguments.scene.detail();
        let asked = arguments.triangles.map(|triangles| arguments.scene.detail_for(triangles));
        let detail = arguments.detail.or(asked).unwrap_or(default);
        if detail > largest {
            return Err(Failure::new(match arguments.triangles {
                Some(triangles) => {
                    format!("--triangles {triangles}: so many are more than this scene can have")
                }
                None => format!("--detail {detail}: expected 1 to {largest} for this scene"),
            }));
        }
        if arguments.frames > 1 && !arguments.scene.moves() {
            return Err(Failure::new("--frames is for scenes that move: twist, burst, cloth, crossing"));
        }
        let library = arguments.output.with_extension("mtl");
        let last = f64::from(arguments.frames - 1).max(1.0);
        let (mut triangles, mut vertices) = (0, 0);
        for frame in 0..arguments.frames {
            let mesh = arguments.scene.generate(detail, arguments.seed, f64::from(frame) / last);
            (triangles, vertices) = (mesh.triangle_count(), mesh.vertices.len());
            write(&mesh, &arguments.path(frame), &library)?;
        }
        let path = arguments.path(0);
        let path = path.display();
        match arguments.format {
            TextOrJson::Text if arguments.frames == 1 => {
                println!("{path}: {triangles} triangles, {vertices} vertices");
            }
            TextOrJson::Text => {
                println!(
                    "{path} and on: {} frames, each {triangles} triangles, {vertices} vertices",
                    arguments.frames
                );
            }
            TextOrJson::Json => println!(
                "{}",
                serde_json::json!({
                    "path": path.to_string(), "frames": arguments.frames, "triangles": triangles, "vertices": vertices,
                })
            ),
        }
        Ok(Outcome::Good)
    })
}

impl Arguments {
    /// The OBJ of a frame: numbered when there are several.
    fn path(&self, frame: u32) -> PathBuf {
        match self.frames {
            1 => self.output.clone(),
            _ => self.output.with_extension(format!("{frame:04}.obj")),
        }
    }
}

fn write(mesh: &Mesh, output: &Path, library: &Path) -> Result<(), Failure> {
    if library == output {
        return Err(Failure::new(format!(
            "{}: the materials go to a .mtl beside it; name an .obj",
            output.display()
        )));
    }
    let name = library.file_name().unwrap_or_default().to_string_lossy();
    let (mut obj_file, mut mtl_file) = (OutputFile::create(output)?, OutputFile::create(library)?);
    let progress = Progress::new("writing", obj::line_count(mesh) as u64);
    let (mut obj_text, mut mtl_text) = (BufWriter::new(&mut obj_file), BufWriter::new(&mut mtl_file));
    let written = obj::write(mesh, &name, &mut obj_text, &mut mtl_text, &progress)
        .and_then(|()| obj_text.flush())
        .and_then(|()| mtl_text.flush());
    // What is still buffered after an error is of no use.
    drop((obj_text.into_parts(), mtl_text.into_parts()));
    written.map_err(|error| obj_file.write_error(error))?;
    mtl_file.commit()?;
    obj_file.commit()?;
    Ok(())
}
