//! What is in the pictures: against rays cast one by one, against places computed by hand, and against pictures that somebody has looked at.

use crate::room::{HOT, HOT_SIDE, PATIENCE, Room, references, shown};
use embree_trace::geometry::Vec3;
use embree_trace::render::camera::{Camera, View};
use embree_trace::view::layers::{PixelColor, RayColor, SurfaceColor};
use embree_trace::view::modes::ModeName;
use embree_trace::view::modes::crossplane::{Facing, Shown};
use embree_trace::view::modes::query::Wanted;
use embree_trace::view::paint::background;
use embree_trace::view::wishes::{BoxWish, Wishes};
use image::RgbaImage;

fn bare() -> Wishes {
    Wishes { no_panels: true, boxes: Some(BoxWish::None), ..Wishes::default() }
}

fn is_background(image: &RgbaImage, x: u32, y: u32) -> bool {
    let expected = background((y as f32 + 0.5) / image.height() as f32);
    image
        .get_pixel(x, y)
        .0
        .iter()
        .zip(expected)
        .take(3)
        .all(|(&found, expected)| found.abs_diff(expected) <= 12)
}

#[test]
fn the_silhouette_is_that_of_rays_cast_one_by_one() {
    let room = Room::new();
    let view =
        View { eye: Vec3::new(10.0, 8.0, -9.0), target: Vec3::splat(2.75), up: Vec3::Y, fov_degrees: 50.0 };
    let wishes = Wishes { view: Some("10,8,-9/2.75,2.75,2.75/0,1,0".to_owned()), fov: Some(50.0), ..bare() };
    let image = shown(room.paths(&["sweep.bvh"]), wishes, [160, 160]).picture().expect("a picture");
    let camera = Camera::new(&view, 160, 160).expect("a camera");
    let (mut hits, mut misses) = (0, 0);
    for y in (4..156).step_by(3) {
        for x in (4..156).step_by(3) {
            // Where all around is alike: edges are smoothed.
            let around = |d: f32| {
                [(-d, -d), (d, -d), (-d, d), (d, d), (0.0, 0.0)].map(|(dx, dy)| {
                    room.nearest(&camera.ray(x as f32 + 0.5 + dx, y as f32 + 0.5 + dy)).is_some()
                })
            };
            match around(1.5) {
                [true, true, true, true, true] => {
                    hits += 1;
                    assert!(!is_background(&image, x, y), "nothing at {x}, {y}");
                }
                [false, false, false, false, false] => {
                    misses += 1;
                    assert!(is_background(&image, x, y), "something at {x}, {y}");
                }
                _ => {}
            }
        }
    }
    assert!(hits > 500 && misses > 100, "{hits} {misses}");
}

#[test]
fn a_box_stands_where_it_was_computed_by_hand() {
    let room = Room::new();
    let wishes = Wishes {
        view: Some("2.75,2.75,-8/2.75,2.75,0/0,1,0".to_owned()),
        fov: Some(90.0),
        boxes: Some(BoxWish::Level(0)),
        ..bare()
    };
    let image = shown(room.paths(&["sweep.bvh"]), wishes, [400, 400]).picture().expect("a picture");
    // The root's box is 0 to 5.5 on all axes. Its front face is 8 away, of which the picture shows 8 to each side of the middle, 25 pixels a
    // metre: it reaches 2.75 · 25 = 68.75 pixels from the middle.
    let yellow = |x: u32, y: u32| {
        let [red, green, blue, _] = image.get_pixel(x, y).0;
        red > 150 && green > 140 && blue < 120
    };
    let column = |x: u32| (100..300).filter(|&y| yellow(x, y)).collect::<Vec<u32>>();
    let (upper, lower) = (200 - 69, 200 + 69);
    for x in [150, 200, 250] {
        let rows = column(x);
        assert!(rows.iter().any(|&y| y.abs_diff(upper) <= 2), "{x}: {rows:?}");
        assert!(rows.iter().any(|&y| y.abs_diff(lower) <= 2), "{x}: {rows:?}");
        assert!(rows.iter().all(|&y| (upper - 3..=lower + 3).contains(&y)), "{x}: {rows:?}");
    }
    assert!(yellow(200 - 69, 170) || yellow(200 - 68, 170), "the left edge");
    assert!(column(120).is_empty(), "beside the box");
}

#[test]
fn pixels_lie_where_they_were_taken() {
    let room = Room::new();
    let wishes = Wishes { pixels: Some(PixelColor::Cost), ..bare() };
    let mut window = shown(room.paths(&["sweep.bvh", "hot.rays"]), wishes, [480, 480]);
    window.viewer.session().expect("files are open").shared.layers.pixels.opacity = 1.0;
    window.frame(Vec::new());
    let image = window.picture().expect("a picture");
    // Each pixel of the image is a square of ten pixels; those that cost most have the brightest colour of the map, and no others.
    let top = |x: u32, y: u32| {
        let [red, green, blue, _] = image.get_pixel(x, y).0;
        red > 245 && (220..240).contains(&green) && blue < 60
    };
    let [left, upper] = HOT.map(|place| 10 * place);
    let side = 10 * HOT_SIDE;
    // Above the legend; edges may be off by a pixel.
    for (x, y) in (0..380).flat_map(|y| (0..480).map(move |x| (x, y))) {
        let within = |margin: i64| {
            [(x, left), (y, upper)].into_iter().all(|(place, start)| {
                let (place, start) = (i64::from(place), i64::from(start));
                (start + margin..start + i64::from(side) - margin).contains(&place)
            })
        };
        assert!(!within(1) || top(x, y), "{x}, {y}: {:?}", image.get_pixel(x, y));
        assert!(within(-1) || !top(x, y), "{x}, {y}: {:?}", image.get_pixel(x, y));
    }
    // From another place it stands in the corner, and leaves the middle alone.
    window.viewer.session().expect("files are open").shared.camera.view.eye.x += 0.5;
    window.settle(PATIENCE).expect("a picture");
    let image = window.picture().expect("a picture");
    let corner = [left, upper].map(|place| f64::from(place + side / 2) * 0.32);
    let (x, y) = (480.0 - 10.0 - 0.32 * 480.0 + corner[0], 10.0 + corner[1]);
    let [red, green, blue, _] = image.get_pixel(x as u32, y as u32).0;
    assert!(red > 230 && green > 210 && blue < 80, "{red} {green} {blue}");
}

/// Compares a window with the picture that is kept of it. Where `BLESS` is set in the environment, it is kept instead.
fn compare(name: &str, files: &[&str], wishes: Wishes) {
    let room = Room::new();
    let image = shown(room.paths(files), wishes, [960, 600]).picture().expect("a picture");
    let path = references().join(format!("{name}.png"));
    if std::env::var_os("BLESS").is_some() {
        image.save(&path).expect("writing the reference");
        return;
    }
    let expected = image::open(&path).expect("a reference").to_rgba8();
    assert_eq!(image.dimensions(), expected.dimensions(), "{name}");
    // Drivers differ at edges of lines and letters; a mode that draws something else differs in whole areas.
    let far =
        |(a, b): (&image::Rgba<u8>, &image::Rgba<u8>)| a.0.iter().zip(b.0).any(|(&a, b)| a.abs_diff(b) > 48);
    let wrong = image.pixels().zip(expected.pixels()).filter(|&pair| far(pair)).count();
    let share = wrong as f64 / (960.0 * 600.0);
    if share > 0.015 {
        let found = std::env::temp_dir().join(format!("bvh-view-{name}.png"));
        image.save(&found).expect("writing the picture");
        panic!("{name}: {:.2}% of the pixels are wrong, see {}", 100.0 * share, found.display());
    }
}

#[test]
fn mode_move() {
    let wishes = Wishes {
        rays: Some(400),
        points: Some(400),
        ray_color: Some(RayColor::Purpose),
        ..Wishes::default()
    };
    compare("move", &["sweep.bvh", "casts.rays"], wishes);
}

#[test]
fn mode_explore() {
    let wishes = Wishes { mode: ModeName::Explore, node: Some(1), ..Wishes::default() };
    compare("explore", &["sweep.bvh", "casts.rays"], wishes);
}

#[test]
fn mode_crossplane() {
    let wishes = Wishes {
        mode: ModeName::Crossplane,
        plane: Some((Facing::Z, 0.3)),
        shows: Some(Shown::Traffic),
        ..Wishes::default()
    };
    compare("crossplane", &["sweep.bvh", "casts.rays"], wishes);
}

#[test]
fn mode_query() {
    let wishes =
        Wishes { mode: ModeName::Query, query: Some(Wanted::Number(3000)), step: 6, ..Wishes::default() };
    compare("query", &["sweep.bvh", "casts.rays"], wishes);
}

#[test]
fn pixels_of_two_trees() {
    let wishes = Wishes { pixels: Some(PixelColor::Difference), ..Wishes::default() };
    compare("pixels", &["sweep.bvh", "binned.bvh", "casts.rays"], wishes);
}

#[test]
fn two_trees() {
    let wishes =
        Wishes { mode: ModeName::Explore, color: Some(SurfaceColor::Difference), ..Wishes::default() };
    compare("two-trees", &["sweep.bvh", "binned.bvh", "casts.rays"], wishes);
}
