//! Moving a camera: round what it looks at, through the scene, onto a box; and views that are kept.
//!
//! Pure arithmetic on a [`View`]: whoever has the mouse and the keys turns them into angles and steps.

use crate::geometry::{Aabb, Vec3};
use crate::render::camera::View;
use glam::Quat;

/// The line of sight stays at least this far from the vertical, in radians: beyond it, left and right would swap.
const POLE: f32 = 0.02;

/// A camera that is moved.
#[derive(Clone, Debug)]
pub struct Navigator {
    pub view: View,
    /// Length of the scene's diagonal: what speeds and closest distances are measured in.
    size: f32,
    /// Kept views, by number.
    saved: [Option<View>; 9],
}

impl Navigator {
    /// A camera at `view` in a scene whose diagonal is `size` long.
    pub fn new(view: View, size: f32) -> Navigator {
        Navigator { view, size: size.max(f32::MIN_POSITIVE), saved: [None; 9] }
    }

    fn sight(&self) -> Vec3 {
        self.view.target - self.view.eye
    }

    /// Directions of length 1: forward, right, and up in the image.
    pub fn axes(&self) -> [Vec3; 3] {
        let forward = self.sight().normalize_or(Vec3::NEG_Z);
        let right = forward.cross(self.view.up).normalize_or(Vec3::X);
        [forward, right, right.cross(forward)]
    }

    /// `sight` turned by `across` radians around the vertical and `up` radians towards it, not beyond the poles.
    fn turned(&self, sight: Vec3, across: f32, up: f32) -> Vec3 {
        let vertical = self.view.up.normalize_or(Vec3::Y);
        let [_, right, _] = self.axes();
        let elevation = sight.normalize_or(Vec3::NEG_Z).dot(vertical).clamp(-1.0, 1.0).asin();
        let limit = std::f32::consts::FRAC_PI_2 - POLE;
        let up = (elevation + up).clamp(-limit, limit) - elevation;
        Quat::from_axis_angle(vertical, across) * (Quat::from_axis_angle(right, up) * sight)
    }

    /// Goes round the target: the scene follows the mouse to the right and down by these angles, in radians.
    pub fn orbit(&mut self, right: f32, down: f32) {
        self.view.eye = self.view.target - self.turned(self.sight(), -right, -down);
    }

    /// Turns the head to the right and up, in radians.
    pub fn look(&mut self, right: f32, up: f32) {
        self.view.target = self.view.eye + self.turned(self.sight(), -right, up);
    }

    /// Moves eye and target by shares of the distance between them: what is at the target follows the mouse.
    pub fn pan(&mut self, right: f32, up: f32) {
        let [_, to_right, upwards] = self.axes();
        let step = (to_right * right + upwards * up) * self.sight().length();
        self.view.eye -= step;
        self.view.target -= step;
    }

    /// Comes nearer to the target (`factor` below 1) or goes back. Close to it, the target moves on, so that one never gets stuck.
    pub fn dolly(&mut self, factor: f32) {
        let [forward, ..] = self.axes();
        let closest = 1e-3 * self.size;
        let distance = self.sight().length();
        let next = distance * factor;
        self.view.eye = self.view.target - forward * next.clamp(closest, 1e3 * self.size);
        if next < closest {
            self.view.target += forward * (closest - next);
            self.view.eye += forward * (closest - next);
        }
    }

    /// Flies by shares of the scene's diagonal: forward, to the right and up.
    pub fn fly(&mut self, steps: Vec3) {
        let [forward, right, _] = self.axes();
        let up = self.view.up.normalize_or(Vec3::Y);
        let step = (forward * steps.x + right * steps.y + up * steps.z) * self.size;
        self.view.eye += step;
        self.view.target += step;
    }

    /// Looks at a box from where the camera looks from now, as near as shows all of it in an image of `aspect` (width by height).
    pub fn frame(&mut self, bounds: &Aabb, aspect: f32) {
        if bounds.is_empty() {
            return;
        }
        let [forward, right, up] = self.axes();
        let half = 0.5 * bounds.extent();
        // How far the box reaches to one side of its centre.
        let reach = |axis: Vec3| axis.abs().dot(half);
        let half_height = 0.9 * (self.view.fov_degrees.to_radians() / 2.0).tan();
        let needed = (reach(right) / (half_height * aspect)).max(reach(up) / half_height);
        let distance = (needed + reach(forward)).max(2e-3 * self.size);
        self.view.target = bounds.center();
        self.view.eye = self.view.target - forward * distance;
    }

    /// Keeps the current view under a number from 1 to 9.
    pub fn save(&mut self, number: usize) {
        let view = self.view;
        if let Some(kept) = self.slot(number) {
            *kept = Some(view);
        }
    }

    /// Goes back to a kept view; says whether there is one.
    pub fn restore(&mut self, number: usize) -> bool {
        let kept = self.slot(number).and_then(|kept| *kept);
        self.view = kept.unwrap_or(self.view);
        kept.is_some()
    }

    /// Whether a view is kept under a number.
    pub fn has(&self, number: usize) -> bool {
        number.checked_sub(1).and_then(|index| self.saved.get(index)).is_some_and(Option::is_some)
    }

    fn slot(&mut self, number: usize) -> Option<&mut Option<View>> {
        self.saved.get_mut(number.checked_sub(1)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::camera::Camera;
    use std::f32::consts::{FRAC_PI_2, PI};

    fn navigator() -> Navigator {
        let view = View { eye: Vec3::new(0.0, 0.0, 5.0), target: Vec3::ZERO, up: Vec3::Y, fov_degrees: 90.0 };
        Navigator::new(view, 10.0)
    }

    fn close(a: Vec3, b: Vec3) -> bool {
        (a - b).length() < 1e-4
    }

    #[test]
    fn an_orbit_keeps_the_distance_and_stops_at_the_pole() {
        let mut camera = navigator();
        // The scene is dragged a quarter turn to the right: one looks from its left, -x.
        camera.orbit(FRAC_PI_2, 0.0);
        assert!(close(camera.view.eye, Vec3::new(-5.0, 0.0, 0.0)), "{:?}", camera.view);
        camera.orbit(0.0, 10.0);
        assert!(camera.view.eye.y > 4.99 && (camera.view.eye.length() - 5.0).abs() < 1e-4);
        assert!(Camera::new(&camera.view, 8, 8).is_ok());
        camera.orbit(2.0 * PI, -20.0);
        assert!(camera.view.eye.y < -4.99 && Camera::new(&camera.view, 8, 8).is_ok());
    }

    #[test]
    fn looking_turns_the_head_and_flying_moves_it() {
        let mut camera = navigator();
        camera.look(FRAC_PI_2, 0.0);
        assert!(close(camera.view.target - camera.view.eye, Vec3::new(5.0, 0.0, 0.0)));
        camera.fly(Vec3::new(0.1, 0.2, 0.3));
        // Forward is +x now, right is +z; the scene is 10 across.
        assert!(close(camera.view.eye, Vec3::new(1.0, 3.0, 7.0)), "{:?}", camera.view);
    }

    #[test]
    fn what_is_panned_follows_the_mouse() {
        let mut camera = navigator();
        camera.pan(0.1, -0.2);
        assert!(close(camera.view.target, Vec3::new(-0.5, 1.0, 0.0)));
        assert!(close(camera.view.eye - camera.view.target, Vec3::new(0.0, 0.0, 5.0)));
    }

    #[test]
    fn a_dolly_never_gets_stuck() {
        let mut camera = navigator();
        camera.dolly(0.5);
        assert!(close(camera.view.eye, Vec3::new(0.0, 0.0, 2.5)));
        for _ in 0..100 {
            camera.dolly(0.5);
        }
        assert!(camera.view.eye.z < -0.1 && Camera::new(&camera.view, 8, 8).is_ok());
    }

    #[test]
    fn a_framed_box_fills_the_image_and_stays_inside() {
        let mut camera = navigator();
        camera.orbit(0.7, 0.4);
        let bounds = Aabb { lower: Vec3::new(2.0, -1.0, 3.0), upper: Vec3::new(3.0, 4.0, 3.5) };
        camera.frame(&bounds, 1.5);
        let image = Camera::new(&camera.view, 150, 100).unwrap();
        let (mut largest, corners) = (0.0f32, [bounds.lower, bounds.upper]);
        for corner in 0..8usize {
            let point = Vec3::from_array(std::array::from_fn(|axis| corners[corner >> axis & 1][axis]));
            let ([x, y], _) = image.project(point).unwrap();
            assert!((0.0..=150.0).contains(&x) && (0.0..=100.0).contains(&y));
            largest = largest.max((x / 75.0 - 1.0).abs()).max((y / 50.0 - 1.0).abs());
        }
        assert!(largest > 0.5, "{largest}");
    }

    #[test]
    fn views_are_kept_by_number() {
        let mut camera = navigator();
        camera.save(3);
        camera.save(0);
        camera.save(10);
        let kept = camera.view;
        camera.orbit(1.0, 0.5);
        assert!(!camera.restore(2) && camera.view != kept);
        assert!(camera.has(3) && !camera.has(0) && camera.restore(3) && camera.view == kept);
    }
}
