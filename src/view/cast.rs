//! Pictures of a scene, ray cast through a tree by [`crate::traverse`]: no triangle is sent to a GPU, so ten million of them open as
//! fast as ten, and what is under a pixel is known at once.
//!
//! An image is cut into squares of 16 × 16 pixels, one packet of camera rays each, on rayon's threads. For every pixel it holds a colour, the
//! distance along the line of sight, and the triangle.

use super::paint::{Paint, background, shade};
use crate::format::rays::NO_TRIANGLE;
use crate::geometry::{Ray, Triangle};
use crate::render::camera::{Camera, View};
use crate::traverse::packet::MOST;
use crate::traverse::{All, PacketScratch, Prepared, Traversal};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Side of the square of pixels that one packet of rays looks through.
const SIDE: usize = 16;

/// What is cast.
#[derive(Clone, Copy)]
pub struct Scene<'a> {
    pub prepared: &'a Prepared,
    pub triangles: &'a [Triangle],
}

/// A picture, row by row from the upper left.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    pub width: usize,
    pub height: usize,
    /// Red, green, blue and 255.
    pub colors: Vec<[u8; 4]>,
    /// Distance along the line of sight; infinite where nothing is hit.
    pub depths: Vec<f32>,
    /// Index into `TRIS`, or [`NO_TRIANGLE`].
    pub triangles: Vec<u32>,
}

impl Image {
    /// A black picture of so many pixels.
    pub fn new(width: usize, height: usize) -> Image {
        let (width, height) = (width.max(1), height.max(1));
        let pixels = width * height;
        Image {
            width,
            height,
            colors: vec![[0, 0, 0, 255]; pixels],
            depths: vec![f32::INFINITY; pixels],
            triangles: vec![NO_TRIANGLE; pixels],
        }
    }

    /// The triangle at a place, in shares of width and height, and its distance along the line of sight.
    pub fn at(&self, x: f32, y: f32) -> Option<(u32, f32)> {
        let column = ((x * self.width as f32) as usize).min(self.width - 1);
        let row = ((y * self.height as f32) as usize).min(self.height - 1);
        let index = row * self.width + column;
        (self.triangles[index] != NO_TRIANGLE).then(|| (self.triangles[index], self.depths[index]))
    }
}

/// Casts `view` into `image`, through the point `offset` of every pixel (`[0.5, 0.5]` is its middle). Returns whether it was finished before
/// `stop` was set; the image is not to be used otherwise. A view that is no camera gives the background.
pub fn cast(
    scene: Scene,
    view: &View,
    offset: [f32; 2],
    paint: &Paint,
    image: &mut Image,
    stop: &AtomicBool,
) -> bool {
    let (width, height) = (image.width, image.height);
    let camera = Camera::new(view, width as u32, height as u32).ok();
    let rows = SIDE * width;
    let strips = image.colors.par_chunks_mut(rows).zip(image.depths.par_chunks_mut(rows));
    let strips = strips.zip(image.triangles.par_chunks_mut(rows)).enumerate();
    strips.for_each_init(Packet::default, |packet, (strip, ((colors, depths), triangles))| {
        let first_row = strip * SIDE;
        for (row, line) in colors.chunks_mut(width).enumerate() {
            line.fill(background((first_row + row) as f32 / height as f32));
        }
        depths.fill(f32::INFINITY);
        triangles.fill(NO_TRIANGLE);
        let Some(camera) = &camera else { return };
        for first_column in (0..width).step_by(SIDE) {
            if stop.load(Ordering::Relaxed) {
                return;
            }
            packet.look(camera, first_column..width.min(first_column + SIDE), first_row, offset, height);
            packet.ask(scene.prepared);
            for (ray, (place, answer)) in packet.rays.iter().zip(packet.places.iter().zip(&packet.answers)) {
                let Some(hit) = answer else { continue };
                let index = (place[1] - first_row) * width + place[0];
                depths[index] = hit.t * ray.direction.dot(camera.forward);
                triangles[index] = hit.triangle;
                colors[index] = shade(paint, hit.triangle, scene.triangles, ray.direction);
            }
        }
    });
    !stop.load(Ordering::Relaxed)
}

/// The rays of one square, and what they hit.
#[derive(Default)]
struct Packet {
    rays: Vec<Ray>,
    /// Column and row of each ray's pixel.
    places: Vec<[usize; 2]>,
    answers: Vec<Option<crate::traverse::Hit>>,
    scratch: PacketScratch,
}

impl Packet {
    fn look(
        &mut self,
        camera: &Camera,
        columns: std::ops::Range<usize>,
        first_row: usize,
        offset: [f32; 2],
        height: usize,
    ) {
        self.rays.clear();
        self.places.clear();
        for row in first_row..height.min(first_row + SIDE) {
            for column in columns.clone() {
                self.rays.push(camera.ray(column as f32 + offset[0], row as f32 + offset[1]));
                self.places.push([column, row]);
            }
        }
        self.answers.resize(self.rays.len(), None);
    }

    fn ask(&mut self, prepared: &Prepared) {
        let everything = &[All; MOST][..self.rays.len()];
        let (scratch, answers) = (&mut self.scratch, &mut self.answers);
        prepared.closest_hits(Traversal::Odf, &self.rays, everything, &mut (), scratch, answers);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builder::{Config, Splits, build};
    use crate::geometry::Vec3;
    use crate::progress::Progress;
    use crate::random::Random;

    /// The distance at which a ray meets a triangle's plane inside of it, in double precision: Cramer's rule, nothing of the library's.
    fn distance(ray: &Ray, triangle: &Triangle) -> Option<f64> {
        let [a, b, c] = triangle.0.map(|v| v.as_dvec3());
        let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let (e1, e2) = (b - a, c - a);
        let determinant = e1.dot(direction.cross(e2));
        let from = origin - a;
        let u = from.dot(direction.cross(e2)) / determinant;
        let v = direction.dot(from.cross(e1)) / determinant;
        let t = e2.dot(from.cross(e1)) / determinant;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some(t)
    }

    #[test]
    fn every_pixel_shows_the_nearest_triangle() {
        let mut random = Random::new(7);
        let mut point = |scale: f32| {
            let mut number = || (random.bits() >> 40) as f32 / (1 << 24) as f32 - 0.5;
            Vec3::new(number(), number(), number()) * scale
        };
        let triangles: Vec<Triangle> = (0..60)
            .map(|_| {
                let centre = point(4.0);
                Triangle([centre, centre + point(2.0), centre + point(2.0)])
            })
            .collect();
        let tree = build(&triangles, &Config::of(Splits::Sweep), &Progress::hidden()).unwrap();
        let prepared = Prepared::new(tree.view(), &triangles, &[]);
        let scene = Scene { prepared: &prepared, triangles: &triangles };
        let view = View { eye: Vec3::new(1.0, 2.0, 6.0), target: Vec3::ZERO, up: Vec3::Y, fov_degrees: 50.0 };
        // Not a multiple of the square's side, so that borders are cast too.
        let mut image = Image::new(53, 37);
        assert!(cast(scene, &view, [0.5; 2], &Paint::Plain, &mut image, &AtomicBool::new(false)));

        let camera = Camera::new(&view, 53, 37).unwrap();
        let (mut hits, mut misses) = (0, 0);
        for (index, &found) in image.triangles.iter().enumerate() {
            let ray = camera.ray((index % 53) as f32 + 0.5, (index / 53) as f32 + 0.5);
            let distances = triangles.iter().map(|triangle| distance(&ray, triangle));
            let nearest = distances
                .enumerate()
                .filter_map(|(triangle, t)| Some((triangle as u32, t?)))
                .min_by(|a, b| a.1.total_cmp(&b.1));
            match nearest {
                Some((triangle, t)) => {
                    hits += 1;
                    assert_eq!(found, triangle, "pixel {index}");
                    let depth = t * f64::from(ray.direction.dot(camera.forward));
                    assert!((f64::from(image.depths[index]) - depth).abs() < 1e-4 * depth);
                }
                None => {
                    misses += 1;
                    assert_eq!(found, NO_TRIANGLE, "pixel {index}");
                    assert_eq!(image.colors[index], background((index / 53) as f32 / 37.0));
                }
            }
        }
        assert!(hits > 300 && misses > 300, "{hits} {misses}");
    }

    #[test]
    fn a_stopped_image_is_not_finished_and_a_view_without_direction_is_empty() {
        let triangles = [Triangle([Vec3::ZERO, Vec3::X, Vec3::Y])];
        let tree = build(&triangles, &Config::of(Splits::Sweep), &Progress::hidden()).unwrap();
        let prepared = Prepared::new(tree.view(), &triangles, &[]);
        let scene = Scene { prepared: &prepared, triangles: &triangles };
        let view = View { eye: Vec3::Z, target: Vec3::ZERO, up: Vec3::Y, fov_degrees: 50.0 };
        let mut image = Image::new(20, 20);
        assert!(!cast(scene, &view, [0.5; 2], &Paint::Plain, &mut image, &AtomicBool::new(true)));
        let nowhere = View { target: view.eye, ..view };
        assert!(cast(scene, &nowhere, [0.5; 2], &Paint::Plain, &mut image, &AtomicBool::new(false)));
        assert!(image.triangles.iter().all(|&triangle| triangle == NO_TRIANGLE));
        assert_eq!(image.at(0.5, 0.5), None);
    }
}
