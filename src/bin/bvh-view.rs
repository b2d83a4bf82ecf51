//! `bvh-view TREE.bvh [OTHER.bvh] [RAYS.rays]`: trees and rays on screen.

use clap::Parser;
use embree_trace::cli::{self, Failure, Outcome, TextOrJson};
use embree_trace::files::OutputFile;
use embree_trace::traverse::Traversal;
use embree_trace::view::layers::{RayColor, SurfaceColor};
use embree_trace::view::modes::ModeName;
use embree_trace::view::offscreen::{LONGEST_SIDE, Offscreen};
use embree_trace::view::summary::Summary;
use embree_trace::view::window;
use embree_trace::view::wishes::{BoxWish, Wishes};
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

const PROGRAM: &str = "bvh-view";

/// A screenshot that takes longer is given up.
const PATIENCE: Duration = Duration::from_secs(600);

const EXAMPLES: &str = "\
Examples:
  bvh-view built.bvh casts.rays
  bvh-view built.bvh ours.bvh casts.rays
  bvh-view built.bvh casts.rays --mode explore --node 17 --boxes level:3
  bvh-view built.bvh casts.rays --screenshot view.png --size 1280x800 --mode explore --color cost
  bvh-view built.bvh --screenshot view.png --view 4,2,9/0,1,0 --no-panels

Keys are listed in the window: press ?

Exit code 0: all is well. 2: bad input, or no window.";

/// Shows trees and recorded rays, and where the work goes, in a window or as a picture.
#[derive(Parser)]
#[command(name = PROGRAM, version, after_help = EXAMPLES)]
struct Arguments {
    /// One or two trees (.bvh) over the same triangles, and a recording (.rays) of their scene
    #[arg(required = true, num_args = 1..=3)]
    files: Vec<PathBuf>,

    /// Write a picture of the window to FILE (PNG) instead of opening it; needs no display
    #[arg(long, value_name = "FILE")]
    screenshot: Option<PathBuf>,

    /// Size of the window
    #[arg(long, value_name = "WxH", default_value = "1280x800", value_parser = size)]
    size: [u32; 2],

    /// Where the camera stands and looks: EYE/TARGET or EYE/TARGET/UP, each X,Y,Z
    #[arg(long, value_name = "VIEW", allow_hyphen_values = true)]
    view: Option<String>,

    /// Angle between the upper and the lower edge of the picture, in degrees
    #[arg(long, value_name = "DEGREES")]
    fov: Option<f32>,

    /// Mode to start in
    #[arg(long, value_enum, default_value_t)]
    mode: ModeName,

    /// Order of traversal that is counted and followed
    #[arg(long, value_enum)]
    traversal: Option<Traversal>,

    /// Node of the first tree to start at
    #[arg(long, value_name = "N")]
    node: Option<u32>,

    /// Boxes to draw: children, level:N, above:SHARE or none
    #[arg(long, value_name = "WHICH")]
    boxes: Option<BoxWish>,

    /// What colours surfaces
    #[arg(long, value_enum, value_name = "WHAT")]
    color: Option<SurfaceColor>,

    /// Draw at most N recorded rays, spread over the recording
    #[arg(long, value_name = "N")]
    rays: Option<usize>,

    /// Draw at most N points where recorded queries hit
    #[arg(long, value_name = "N")]
    points: Option<usize>,

    /// What colours rays and points
    #[arg(long, value_enum, value_name = "WHAT")]
    ray_color: Option<RayColor>,

    /// Leave out the panels
    #[arg(long)]
    no_panels: bool,

    /// What to print about a screenshot
    #[arg(long, value_enum, default_value_t = TextOrJson::Text)]
    format: TextOrJson,
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let expected = || format!("expected WIDTHxHEIGHT, each from 16 to {LONGEST_SIDE}, such as 1280x800");
    let (width, height) = text.split_once(['x', 'X']).ok_or_else(expected)?;
    let side = |text: &str| text.parse().ok().filter(|side| (16..=LONGEST_SIDE).contains(side));
    Ok([side(width).ok_or_else(expected)?, side(height).ok_or_else(expected)?])
}

fn main() -> ExitCode {
    let arguments: Arguments = cli::parse(PROGRAM, std::env::args_os());
    cli::run(PROGRAM, || run(&arguments))
}

fn run(arguments: &Arguments) -> Result<Outcome, Failure> {
    let wishes = Wishes {
        view: arguments.view.clone(),
        fov: arguments.fov,
        mode: arguments.mode,
        traversal: arguments.traversal,
        node: arguments.node,
        boxes: arguments.boxes,
        color: arguments.color,
        ray_color: arguments.ray_color,
        rays: arguments.rays,
        points: arguments.points,
        no_panels: arguments.no_panels,
    };
    let files = arguments.files.clone();
    match &arguments.screenshot {
        None => window::show(files, wishes, arguments.size)?,
        Some(path) => screenshot(arguments, path, Offscreen::new(files, wishes, arguments.size)?)?,
    }
    Ok(Outcome::Good)
}

fn screenshot(arguments: &Arguments, path: &Path, mut offscreen: Offscreen) -> Result<(), Failure> {
    offscreen.settle(PATIENCE)?;
    let picture = offscreen.picture()?;
    let mut png = Cursor::new(Vec::new());
    picture.write_to(&mut png, image::ImageFormat::Png)?;
    OutputFile::create(path)?.commit_with(|out| out.write_all(png.get_ref()))?;
    if let (TextOrJson::Json, Some(session)) = (arguments.format, offscreen.viewer.session()) {
        let text = serde_json::to_string_pretty(&Summary::of(&session.shared))?;
        writeln!(std::io::stdout().lock(), "{text}")?;
    }
    Ok(())
}
