//! A pinhole camera: where it stands ([`View`]) and which ray belongs to a point of the image ([`Camera`]).

use crate::geometry::{Aabb, DVec3, Ray, Vec3};
use glam::DMat3;
use thiserror::Error;

/// Where a camera stands and looks, in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    pub eye: Vec3,
    pub target: Vec3,
    /// Any vector that points up in the image; need not be perpendicular to the line of sight.
    pub up: Vec3,
    /// Angle between the upper and the lower edge of the image, in degrees.
    pub fov_degrees: f32,
}

/// Why a camera cannot be used.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CameraError {
    #[error("camera `{0}`: expected EYE/TARGET or EYE/TARGET/UP, each as X,Y,Z with finite numbers")]
    Syntax(String),
    #[error("camera: eye, target and up must be finite and below 1e15")]
    Range,
    #[error("camera: eye and target are the same point")]
    NoDirection,
    #[error("camera: up is zero or points along the line of sight; give another as the third triple")]
    NoUp,
    #[error(
        "the scene is too large for a camera to be chosen, which must stand below 1e15: scale it down, or give --camera"
    )]
    SceneRange,
    #[error(
        "no triangle of the scene has an area and coordinates below 1.8e18, as Embree wants them, so there is nothing that a camera could be chosen for: give --camera"
    )]
    NothingToSee,
    #[error("field of view {0}: expected degrees, at least 0.01 and at most 175")]
    FieldOfView(f32),
}

/// Eye, target and, when it was given, up of `x,y,z/x,y,z[/x,y,z]`.
///
/// # Errors
/// [`CameraError::Syntax`] for anything else, not-a-numbers and infinities included.
pub fn parse_view(text: &str) -> Result<(Vec3, Vec3, Option<Vec3>), CameraError> {
    let syntax = || CameraError::Syntax(text.to_owned());
    let mut triples = Vec::with_capacity(3);
    for triple in text.split('/') {
        let mut numbers = triple.split(',').map(|n| n.trim().parse::<f32>().ok().filter(|n| n.is_finite()));
        let mut next = || numbers.next().flatten().ok_or_else(syntax);
        triples.push(Vec3::new(next()?, next()?, next()?));
        if numbers.next().is_some() {
            return Err(syntax());
        }
    }
    match triples[..] {
        [eye, target] => Ok((eye, target, None)),
        [eye, target, up] => Ok((eye, target, Some(up))),
        _ => Err(syntax()),
    }
}

/// A view of an image of a certain size. Pixel (0, 0) is the upper left one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    pub eye: Vec3,
    pub forward: Vec3,
    /// Half the image plane at distance 1, to the right and down.
    right: Vec3,
    down: Vec3,
    width: f32,
    height: f32,
    /// How far from the eye rays start.
    start: f64,
}

/// From farther away than this many diagonals of a scene, rays start nearer.
const FAR: f64 = 64.0;
/// They start this many diagonals before its centre, so that it may also move.
const NEAR: f64 = 8.0;

impl Camera {
    /// # Errors
    /// When the view has no direction, no up, or numbers that no ray can be made of.
    pub fn new(view: &View, width: u32, height: u32) -> Result<Camera, CameraError> {
        if ![view.eye, view.target, view.up].iter().all(|v| v.is_finite() && v.abs().max_element() < 1e15) {
            return Err(CameraError::Range);
        }
        if !(0.01..=175.0).contains(&view.fov_degrees) {
            return Err(CameraError::FieldOfView(view.fov_degrees));
        }
        // In double precision: eye and target may be near each other and far from the origin.
        let sight = view.target.as_dvec3() - view.eye.as_dvec3();
        let forward = sight.try_normalize().ok_or(CameraError::NoDirection)?;
        let up = view.up.as_dvec3().try_normalize().ok_or(CameraError::NoUp)?;
        let side = forward.cross(up);
        if side.length() < 1e-6 {
            return Err(CameraError::NoUp);
        }
        let side = side.normalize();
        let half_height = libm::tan(f64::from(view.fov_degrees).to_radians() / 2.0);
        let half_width = half_height * f64::from(width) / f64::from(height);
        Ok(Camera {
            eye: view.eye,
            forward: forward.as_vec3(),
            right: (side * half_width).as_vec3(),
            down: (forward.cross(side) * half_height).as_vec3(),
            width: width as f32,
            height: height as f32,
            start: 0.0,
        })
    }

    /// The same camera for a scene inside `bounds`. Where the eye is so far away that single
    /// precision cannot tell the scene's surfaces apart along a ray, rays start in front of the
    /// scene instead, on the same lines.
    pub fn facing(self, bounds: &Aabb) -> Camera {
        let distance = (bounds.center().as_dvec3() - self.eye.as_dvec3()).length();
        let diagonal = bounds.extent().as_dvec3().length();
        let start = if distance > FAR * diagonal { distance - NEAR * diagonal } else { 0.0 };
        Camera { start, ..self }
    }

    /// The ray through the point (`x`, `y`) of the image, in pixels from its upper left corner. Its direction has length 1.
    #[inline]
    pub fn ray(&self, x: f32, y: f32) -> Ray {
        let across = 2.0 * x / self.width - 1.0;
        let down = 2.0 * y / self.height - 1.0;
        let direction = (self.forward + across * self.right + down * self.down).normalize();
        let origin = if self.start > 0.0 {
            (self.eye.as_dvec3() + direction.as_dvec3() * self.start).as_vec3()
        } else {
            self.eye
        };
        Ray { origin, tnear: 0.0, direction, tfar: f32::INFINITY }
    }

    /// The view of a pinhole camera whose rays through known points of its image (in pixels) are given; `None` when they have no common
    /// origin or do not span the image. Points may be off by half a pixel: it is a fit by least squares.
    pub fn fitted(samples: &[([f32; 2], Ray)], width: u32, height: u32) -> Option<View> {
        let (_, first) = samples.first()?;
        let eye = first.origin;
        let tolerance = 1e-5 * (1.0 + eye.abs().max_element());
        if !samples.iter().all(|(_, ray)| (ray.origin - eye).abs().max_element() <= tolerance) {
            return None;
        }
        let directions: Vec<DVec3> =
            samples.iter().map(|(_, ray)| ray.direction.as_dvec3().normalize_or_zero()).collect();
        // Directions over their share along the line of sight are a plane: middle + x · right + y · down. The line of sight is the plane's
        // middle, found again with each round.
        let mut forward = directions.iter().sum::<DVec3>().try_normalize()?;
        let mut plane = [DVec3::ZERO; 3];
        for _ in 0..8 {
            let (mut left, mut answer) = (DMat3::ZERO, DMat3::ZERO);
            for (([x, y], _), direction) in samples.iter().zip(&directions) {
                let along = direction.dot(forward);
                if along < 0.05 {
                    return None;
                }
                let across = 2.0 * f64::from(*x) / f64::from(width) - 1.0;
                let down = 2.0 * f64::from(*y) / f64::from(height) - 1.0;
                let row = DVec3::new(1.0, across, down);
                left += DMat3::from_cols(row * row.x, row * row.y, row * row.z);
                let point = *direction / along;
                answer += DMat3::from_cols(row * point.x, row * point.y, row * point.z);
            }
            if left.determinant() < 1e-6 * (samples.len() as f64).powi(3) {
                return None;
            }
            let solved = (left.inverse() * answer).transpose();
            plane = [solved.x_axis, solved.y_axis, solved.z_axis];
            forward = plane[0].try_normalize()?;
        }
        let [middle, _, down] = plane;
        let fov_degrees = (2.0 * (down.length() / middle.length()).atan()).to_degrees() as f32;
        let view =
            View { eye, target: eye + forward.as_vec3(), up: -down.try_normalize()?.as_vec3(), fov_degrees };
        Camera::new(&view, width, height).ok().map(|_| view)
    }

    /// Half the image plane at distance 1: to its right edge, and to its lower edge.
    pub fn half_plane(&self) -> [Vec3; 2] {
        [self.right, self.down]
    }

    /// Where in the image, in pixels, a point appears, and how far along [`Self::forward`] it is; `None` behind the eye.
    pub fn project(&self, point: Vec3) -> Option<([f32; 2], f32)> {
        let sight = point - self.eye;
        let depth = sight.dot(self.forward);
        let across = sight.dot(self.right) / self.right.length_squared() / depth;
        let down = sight.dot(self.down) / self.down.length_squared() / depth;
        let pixel = [(across + 1.0) * 0.5 * self.width, (down + 1.0) * 0.5 * self.height];
        (depth > 0.0 && pixel.iter().all(|p| p.is_finite())).then_some((pixel, depth))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> View {
        View { eye: Vec3::new(0.0, 0.0, 5.0), target: Vec3::ZERO, up: Vec3::Y, fov_degrees: 90.0 }
    }

    fn close(a: Vec3, b: Vec3) -> bool {
        (a - b).length() < 1e-6
    }

    #[test]
    fn corners_and_centre() {
        let camera = Camera::new(&view(), 200, 100).unwrap();
        let centre = camera.ray(100.0, 50.0);
        assert!(close(centre.direction, Vec3::NEG_Z) && centre.origin == view().eye);
        // 90 degrees over the height: the upper edge rises as much as it goes forward; the image is twice as wide.
        assert!(close(camera.ray(100.0, 0.0).direction, Vec3::new(0.0, 1.0, -1.0).normalize()));
        assert!(close(camera.ray(0.0, 0.0).direction, Vec3::new(-2.0, 1.0, -1.0).normalize()));
        assert!(close(camera.ray(200.0, 100.0).direction, Vec3::new(2.0, -1.0, -1.0).normalize()));
    }

    #[test]
    fn a_point_of_a_ray_appears_where_the_ray_started() {
        let camera = Camera::new(&view(), 200, 100).unwrap();
        for (x, y) in [(0.0, 0.0), (150.0, 20.0), (100.0, 50.0), (199.0, 99.0)] {
            let ([px, py], depth) = camera.project(camera.ray(x, y).at(7.0)).unwrap();
            assert!((px - x).abs() < 1e-3 && (py - y).abs() < 1e-3 && depth <= 7.0);
        }
        // 45 degrees up, 5 in front of the eye: the middle of the upper edge.
        assert_eq!(camera.project(Vec3::new(0.0, 5.0, 0.0)), Some(([100.0, 0.0], 5.0)));
        assert_eq!(camera.project(Vec3::new(0.0, 0.0, 6.0)), None);
    }

    #[test]
    fn a_camera_is_found_again_from_its_rays() {
        let view = View {
            eye: Vec3::new(10.0, 2.0, -3.0),
            target: Vec3::new(3.0, 1.0, 4.0),
            up: Vec3::new(0.1, 1.0, 0.0),
            fov_degrees: 63.0,
        };
        let camera = Camera::new(&view, 320, 200).unwrap();
        // Each ray goes somewhere through its pixel, of which only the middle is known.
        let samples: Vec<([f32; 2], Ray)> = (0..500u32)
            .map(|number| {
                let (x, y) = ((number * 77 % 320) as f32, (number * 131 % 200) as f32);
                let inside = (number % 10) as f32 / 10.0 + 0.05;
                ([x + 0.5, y + 0.5], camera.ray(x + inside, y + 1.0 - inside))
            })
            .collect();
        let found = Camera::fitted(&samples, 320, 200).unwrap();
        assert_eq!(found.eye, view.eye);
        assert!((found.fov_degrees - 63.0).abs() < 0.2, "{found:?}");
        let again = Camera::new(&found, 320, 200).unwrap();
        for corner in [(0.0, 0.0), (320.0, 0.0), (160.0, 100.0), (0.0, 200.0)] {
            let cosine =
                again.ray(corner.0, corner.1).direction.dot(camera.ray(corner.0, corner.1).direction);
            assert!(cosine > 0.99999, "{corner:?} {cosine}");
        }
        let mut moved = samples.clone();
        moved[3].1.origin.x += 1.0;
        assert_eq!(Camera::fitted(&moved, 320, 200), None, "no common origin");
        assert_eq!(Camera::fitted(&samples[..2], 320, 200), None, "they do not span the image");
    }

    /// A point of the scene stays in its pixel; and nothing of the scene is skipped.
    #[test]
    fn rays_of_a_far_eye_start_in_front_of_the_scene() {
        let bounds = Aabb { lower: Vec3::splat(-1.0), upper: Vec3::ONE };
        let far = View { eye: Vec3::new(0.0, 0.0, 1e6), fov_degrees: 0.01, ..view() };
        let camera = Camera::new(&far, 100, 100).unwrap();
        assert_eq!(Camera::new(&view(), 100, 100).unwrap().facing(&bounds).ray(3.0, 4.0).origin.z, 5.0);
        for (x, y) in [(50.0, 50.0), (49.5, 50.5), (0.0, 100.0)] {
            let (ray, near) = (camera.ray(x, y), camera.facing(&bounds).ray(x, y));
            assert_eq!(ray.direction, near.direction);
            let from_eye = near.origin.as_dvec3() - ray.origin.as_dvec3();
            assert!(from_eye.cross(ray.direction.as_dvec3()).length() < 1e-4);
            assert!((20.0..30.0).contains(&near.origin.z), "{near:?}");
        }
    }

    #[test]
    fn up_need_not_be_perpendicular() {
        let tilted = View { up: Vec3::new(0.0, 1.0, 3.0), ..view() };
        assert_eq!(Camera::new(&tilted, 64, 64).unwrap(), Camera::new(&view(), 64, 64).unwrap());
        let z_up = View { eye: Vec3::new(0.0, -5.0, 0.0), up: Vec3::Z, ..view() };
        let camera = Camera::new(&z_up, 64, 64).unwrap();
        assert!(close(camera.ray(64.0, 32.0).direction, Vec3::new(1.0, 1.0, 0.0).normalize()));
    }

    #[test]
    fn what_cannot_be_a_camera() {
        let bad = |view: View| Camera::new(&view, 8, 8).unwrap_err();
        assert_eq!(bad(View { target: view().eye, ..view() }), CameraError::NoDirection);
        assert_eq!(bad(View { up: Vec3::Z, ..view() }), CameraError::NoUp);
        assert_eq!(bad(View { up: Vec3::ZERO, ..view() }), CameraError::NoUp);
        assert_eq!(bad(View { eye: Vec3::splat(f32::NAN), ..view() }), CameraError::Range);
        assert_eq!(bad(View { eye: Vec3::splat(1e20), ..view() }), CameraError::Range);
        assert_eq!(bad(View { fov_degrees: 180.0, ..view() }), CameraError::FieldOfView(180.0));
        assert!(matches!(bad(View { fov_degrees: f32::NAN, ..view() }), CameraError::FieldOfView(_)));
    }

    #[test]
    fn views_are_read() {
        let (x, y) = (Vec3::new(1.0, -2.5, 3e2), Vec3::new(0.0, 0.0, 1.0));
        assert_eq!(parse_view("1,-2.5,3e2/0,0,1"), Ok((x, y, None)));
        assert_eq!(parse_view("1, -2.5, 300 / 0,0,1 / 0,0,1"), Ok((x, y, Some(y))));
        for bad in [
            "",
            "1,2,3",
            "1,2/3,4,5",
            "1,2,3,4/5,6,7",
            "nan,0,0/1,1,1",
            "0,0,0/inf,1,1",
            "1,2,3/4,5,6/7,8,9/1,2,3",
            "a,b,c/d,e,f",
        ] {
            assert_eq!(parse_view(bad), Err(CameraError::Syntax(bad.to_owned())));
        }
    }
}
