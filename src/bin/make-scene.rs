//! Writes a generated scene as OBJ and MTL: for the demo, for tests, and for measuring when no other scene is at hand.

use clap::{Parser, ValueEnum};
use embree_trace::cli::{self, Failure, Outcome};
use embree_trace::files::FileError;
use embree_trace::mesh::{Mesh, generate, obj};
use std::fs::File;
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
  make-scene courtyard court.obj --detail 13       a million triangles
  make-scene terrain land.obj --detail 10000000    ten million triangles"
)]
struct Arguments {
    /// Which scene
    scene: Scene,
    /// The OBJ file to write; its materials go beside it, as .mtl
    output: PathBuf,
    /// How fine: courtyard: triangles grow with its square (1: 6 thousand, 13: a million); quads: cells along a side;
    /// slivers: needles; terrain, soup: triangles
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=200_000_000))]
    detail: Option<u32>,
    /// Seed of the random numbers, where the scene uses any
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

#[derive(Clone, Copy, ValueEnum)]
enum Scene {
    CornellBox,
    Courtyard,
    Slivers,
    Coincident,
    Quads,
    Terrain,
    Soup,
}

impl Scene {
    fn generate(self, detail: Option<u32>, seed: u64) -> Mesh {
        let detail = |default: u32| detail.unwrap_or(default);
        match self {
            Scene::CornellBox => generate::cornell_box(),
            Scene::Courtyard => generate::courtyard(detail(4), seed),
            Scene::Slivers => generate::slivers(detail(600), seed),
            Scene::Coincident => generate::coincident(),
            Scene::Quads => generate::quads(detail(16)),
            Scene::Terrain => generate::terrain(detail(1_000_000) as usize, seed),
            Scene::Soup => generate::soup(detail(1_000_000) as usize, seed),
        }
    }
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    cli::run("make-scene", || {
        let mesh = arguments.scene.generate(arguments.detail, arguments.seed);
        let library = arguments.output.with_extension("mtl");
        write(&mesh, &arguments.output, &library)?;
        println!(
            "{}: {} triangles, {} vertices",
            arguments.output.display(),
            mesh.triangle_count(),
            mesh.vertices.len()
        );
        Ok(Outcome::Good)
    })
}

fn write(mesh: &Mesh, output: &Path, library: &Path) -> Result<(), Failure> {
    if library == output {
        return Err(Failure::new(format!(
            "{}: the materials go to a .mtl beside it; name an .obj",
            output.display()
        )));
    }
    let name = library.file_name().unwrap_or_default().to_string_lossy();
    let create = |path: &Path| File::create(path).map_err(|e| FileError::new(path, "create", e));
    let (mut obj_file, mut mtl_file) = (BufWriter::new(create(output)?), BufWriter::new(create(library)?));
    obj::write(mesh, &name, &mut obj_file, &mut mtl_file)
        .and_then(|()| obj_file.flush())
        .and_then(|()| mtl_file.flush())
        .map_err(|e| FileError::new(output, "write", e))?;
    Ok(())
}
