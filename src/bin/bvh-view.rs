//! `bvh-view TREE.bvh [OTHER.bvh] [RAYS.rays]`: trees and rays on screen.

use clap::Parser;
use embree_trace::cli::{self, Failure, Outcome, TextOrJson};
use embree_trace::files::OutputFile;
use embree_trace::replay::pixels::ImageSize;
use embree_trace::traverse::Traversal;
use embree_trace::view::layers::{PixelColor, RayColor, SurfaceColor};
use embree_trace::view::modes::ModeName;
use embree_trace::view::modes::crossplane::{Facing, Shown};
use embree_trace::view::modes::query::Wanted;
use embree_trace::view::offscreen::{LONGEST_SIDE, Offscreen};
use embree_trace::view::summary::Summary;
use embree_trace::view::window;
use embree_trace::view::wishes::{BoxWish, Wishes, parse_plane};
use serde::Serialize;
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
  bvh-view built.bvh ours.bvh casts.rays --pixels difference
  bvh-view built.bvh casts.rays --mode crossplane --plane y:0.3 --plane-shows traffic
  bvh-view built.bvh casts.rays --mode query --pixel 320,240
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

    /// Measure N frames in which the camera moves, drawn without a display, and print how long they took
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000), conflicts_with = "screenshot")]
    frames: Option<u32>,

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

    /// Show the recorded image as a heat map of its pixels
    #[arg(long, value_enum, value_name = "WHAT")]
    pixels: Option<PixelColor>,

    /// Size of the recorded image, where the trees do not say
    #[arg(long, value_name = "WxH")]
    image: Option<ImageSize>,

    /// Show the queries of this scene; without this, of the one that the trees are of, when the
    /// recording holds several
    #[arg(long, value_name = "N")]
    scene: Option<u16>,

    /// Where the plane of mode crossplane stands: x, y, z or camera, and a place from 0 to 1, such as y:0.3
    #[arg(long, value_name = "PLANE", value_parser = parse_plane)]
    plane: Option<(Facing, f32)>,

    /// What the plane shows
    #[arg(long, value_enum, value_name = "WHAT")]
    plane_shows: Option<Shown>,

    /// Query of the recording to follow in mode query, by its number
    #[arg(long, value_name = "N")]
    query: Option<u64>,

    /// Pixel of the recorded image whose queries to follow
    #[arg(long, value_name = "X,Y", value_parser = pixel, conflicts_with = "query")]
    pixel: Option<[u32; 2]>,

    /// Step of the query's traversal to go to
    #[arg(long, value_name = "N", default_value_t = 0)]
    step: usize,

    /// Leave out the panels
    #[arg(long)]
    no_panels: bool,

    /// How to print what was measured; json also says what a screenshot shows
    #[arg(long, value_enum, default_value_t = TextOrJson::Text)]
    format: TextOrJson,
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let expected = || format!("expected WIDTHxHEIGHT, each from 16 to {LONGEST_SIDE}, such as 1280x800");
    let (width, height) = text.split_once(['x', 'X']).ok_or_else(expected)?;
    let side = |text: &str| text.parse().ok().filter(|side| (16..=LONGEST_SIDE).contains(side));
    Ok([side(width).ok_or_else(expected)?, side(height).ok_or_else(expected)?])
}

fn pixel(text: &str) -> Result<[u32; 2], String> {
    let (x, y) = text.split_once(',').ok_or("expected X,Y, such as 320,240")?;
    let number =
        |text: &str| text.trim().parse().map_err(|_| format!("\"{text}\" is not a number of pixels"));
    Ok([number(x)?, number(y)?])
}

fn main() -> ExitCode {
    let arguments: Arguments = cli::parse(PROGRAM, std::env::args_os());
    if arguments.screenshot.is_some() || arguments.frames.is_some() {
        // Mesa's layer that chooses among graphics cards asks the desktop which one it uses, and complains where there is none.
        // SAFETY: no other thread is there yet that could read the environment.
        unsafe { std::env::set_var("NODEVICE_SELECT", "1") };
    }
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
        pixels: arguments.pixels,
        image: arguments.image,
        scene: arguments.scene,
        plane: arguments.plane,
        shows: arguments.plane_shows,
        query: arguments.query.map(Wanted::Number),
        pixel: arguments.pixel,
        step: arguments.step,
        no_panels: arguments.no_panels,
    };
    let files = arguments.files.clone();
    match (&arguments.screenshot, arguments.frames) {
        (None, None) => window::show(files, wishes, arguments.size)?,
        (Some(path), _) => screenshot(arguments, path, Offscreen::new(files, wishes, arguments.size)?)?,
        (None, Some(frames)) => {
            measure(arguments, frames, Offscreen::new(files, wishes, arguments.size)?)?;
        }
    }
    Ok(Outcome::Good)
}

/// What moving costs.
#[derive(Serialize)]
struct Frames {
    frames: u32,
    median_ms: f64,
    slowest_ms: f64,
    frames_per_second: f64,
    /// Pixels of the window per pixel that is cast, in each direction.
    coarseness: u32,
}

fn measure(arguments: &Arguments, frames: u32, mut offscreen: Offscreen) -> Result<(), Failure> {
    offscreen.settle(PATIENCE)?;
    let mut times = offscreen.measure(frames)?;
    times.sort();
    let milliseconds = |index: usize| times[index].as_secs_f64() * 1e3;
    let median_ms = milliseconds(times.len() / 2);
    let measured = Frames {
        frames,
        median_ms,
        slowest_ms: milliseconds(times.len() - 1),
        frames_per_second: 1e3 / median_ms,
        coarseness: offscreen.viewer.session().map_or(0, |session| session.coarseness()),
    };
    let text = match arguments.format {
        TextOrJson::Json => serde_json::to_string_pretty(&measured)?,
        TextOrJson::Text => format!(
            "{frames} frames while the camera moves: {median_ms:.1} ms each, {:.1} frames a second, at 1/{} resolution",
            measured.frames_per_second, measured.coarseness
        ),
    };
    writeln!(std::io::stdout().lock(), "{text}")?;
    Ok(())
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
