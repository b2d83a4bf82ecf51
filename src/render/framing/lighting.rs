//! Lights for a scene that has none, chosen for where its camera stands: a panel under a ceiling, or a sky.

use super::{Axes, Framing, Sight};
use crate::geometry::Vec3;
use crate::render::lights::{Panel, Sky};

/// From a point this enclosed, the sun can only shine through windows.
const INDOORS: f32 = 0.9;

impl<Q: Sight> Framing<'_, Q> {
    /// The panel for a camera that stands in a room, or `None` under the open sky.
    pub fn panel(&mut self, eye: Vec3) -> Option<Panel> {
        if self.enclosure(eye) < INDOORS {
            return None;
        }
        let Axes { up, front, right } = self.axes;
        let ceiling = self.distance(eye, up)?;
        // A little below, so that it does not lie in a lamp or a beam.
        let centre = eye + up * (0.9 * ceiling);
        // As far as half the way to the walls on both sides, so that it hangs free.
        let mut half = |axis: Vec3| {
            let to = |framing: &mut Self, axis| framing.distance(centre, axis).unwrap_or(ceiling);
            let free = to(self, axis).min(to(self, -axis));
            axis * (0.5 * free).clamp(0.05 * ceiling, 1.5 * ceiling)
        };
        let (across, along) = (half(right), half(front));
        // right × front points down, as right = up × front.
        Some(Panel { corner: centre - across - along, edges: [2.0 * across, 2.0 * along] })
    }
}

/// A sky whose sun stands high behind the camera's left shoulder, so that what it looks at is lit and shaded.
pub fn sky(axes: &Axes, forward: Vec3) -> Sky {
    let up = axes.up;
    let level = (forward - up * forward.dot(up)).try_normalize().unwrap_or(-axes.front);
    let left = up.cross(level);
    Sky { up, sun: (up * 1.6 - level * 0.7 + left * 0.6).normalize() }
}
