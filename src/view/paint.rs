//! Colours: of surfaces, of values (maps that colour-blind readers can tell apart), and of kinds.

use crate::format::rays::{NO_DEPTH, Purpose};
use crate::geometry::{Triangle, Vec3};
use colorous::{CIVIDIS, Gradient, INFERNO, VIRIDIS};
use eframe::egui::Color32;
use std::sync::Arc;

/// Red, green, blue, opacity.
pub type Rgba = [u8; 4];

/// What surfaces look like.
#[derive(Clone, Debug, Default)]
pub enum Paint {
    /// All alike.
    #[default]
    Plain,
    /// A colour for each triangle, by its index into `TRIS`; one whose opacity is 0 stays plain, but darker.
    Each(Arc<Vec<Rgba>>),
}

/// A plain surface.
const PLAIN: Rgba = [196, 194, 188, 255];
/// What is beside the point when triangles are coloured.
const ASIDE: Rgba = [92, 94, 98, 255];

/// The background at a height of the image: 0 is its upper edge.
pub fn background(height: f32) -> Rgba {
    let mix = |top: f32, bottom: f32| (top + (bottom - top) * height) as u8;
    [mix(38.0, 24.0), mix(42.0, 26.0), mix(50.0, 30.0), 255]
}

/// The colour of a surface that a ray meets: brighter the more it faces the eye, so that shapes can be read, whatever side is seen.
pub fn shade(paint: &Paint, triangle: u32, triangles: &[Triangle], direction: Vec3) -> Rgba {
    let index = triangle as usize;
    let color = match paint {
        Paint::Plain => PLAIN,
        Paint::Each(colors) => match colors.get(index) {
            Some(color) if color[3] > 0 => *color,
            _ => ASIDE,
        },
    };
    let normal = triangles[index].scaled_normal().normalize_or_zero();
    // A little from the upper left of the world as well: two walls that meet the eye alike differ.
    let light =
        0.32 + 0.60 * normal.dot(direction).abs() + 0.08 * normal.dot(Vec3::new(0.36, 0.48, 0.80)).abs();
    let lit = |channel: u8| (f32::from(channel) * light).min(255.0) as u8;
    [lit(color[0]), lit(color[1]), lit(color[2]), 255]
}

/// How values become colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ColorMap {
    #[default]
    Viridis,
    Cividis,
    Inferno,
}

impl ColorMap {
    pub const ALL: [ColorMap; 3] = [ColorMap::Viridis, ColorMap::Cividis, ColorMap::Inferno];

    pub fn name(self) -> &'static str {
        match self {
            ColorMap::Viridis => "viridis",
            ColorMap::Cividis => "cividis",
            ColorMap::Inferno => "inferno",
        }
    }

    /// The colour of a share of the scale, 0 to 1; what is beyond has the colour of the end.
    pub fn color(self, share: f64) -> Rgba {
        let gradient: Gradient = match self {
            ColorMap::Viridis => VIRIDIS,
            ColorMap::Cividis => CIVIDIS,
            ColorMap::Inferno => INFERNO,
        };
        let color = gradient.eval_continuous(if share > 0.0 { share.min(1.0) } else { 0.0 });
        [color.r, color.g, color.b, 255]
    }
}

/// The colour of a difference from -1 (blue) over 0 (white) to 1 (orange): ends that colour-blind readers tell apart.
pub fn difference(share: f64) -> Rgba {
    let end: [f64; 3] = if share < 0.0 { [0.0, 90.0, 181.0] } else { [220.0, 90.0, 10.0] };
    let strength = share.abs().min(1.0);
    let mix = |channel: usize| (236.0 + (end[channel] - 236.0) * strength) as u8;
    [mix(0), mix(1), mix(2), 255]
}

/// Colours of kinds, told apart by everybody: Okabe and Ito's, without black.
pub const KINDS: [Rgba; 7] = [
    [230, 159, 0, 255],
    [86, 180, 233, 255],
    [0, 158, 115, 255],
    [240, 228, 66, 255],
    [0, 114, 178, 255],
    [213, 94, 0, 255],
    [204, 121, 167, 255],
];

/// The colour of a purpose: camera rays blue, shadow rays green, what bounces orange and red.
pub fn purpose(purpose: Purpose) -> Rgba {
    match purpose {
        Purpose::Unknown => KINDS[6],
        Purpose::Camera => KINDS[1],
        Purpose::Shadow => KINDS[2],
        Purpose::AmbientOcclusion => KINDS[3],
        Purpose::Diffuse => KINDS[0],
        Purpose::Specular => KINDS[5],
    }
}

/// Colour of the selected node, of its children and of hits: from [`KINDS`].
pub const SELECTED: Rgba = KINDS[3];
pub const LEFT: Rgba = KINDS[1];
pub const RIGHT: Rgba = KINDS[0];
pub const HIT: Rgba = KINDS[1];
pub const MISS: Rgba = KINDS[5];

/// Colours of children that are told apart among up to eight.
const CHILDREN: [Rgba; 8] = [
    LEFT,
    RIGHT,
    KINDS[2],
    KINDS[6],
    [120, 120, 255, 255],
    KINDS[5],
    [170, 230, 120, 255],
    [150, 110, 70, 255],
];

/// The colour of child `number` of a node.
pub fn child(number: usize) -> Rgba {
    CHILDREN[number % CHILDREN.len()]
}

/// The colour of a depth: what is deeper is brighter.
pub fn color_of_depth(depth: u8) -> Rgba {
    match depth {
        NO_DEPTH => [150, 150, 150, 255],
        _ => ColorMap::Viridis.color(0.15 + f64::from(depth) / 8.0),
    }
}

/// The colour of a share of the highest cost.
pub fn color_of_cost(share: f64) -> Rgba {
    ColorMap::Inferno.color(0.12 + 0.88 * share)
}

/// For egui.
pub fn color32([red, green, blue, opacity]: Rgba) -> Color32 {
    Color32::from_rgba_unmultiplied(red, green, blue, opacity)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surfaces_are_brighter_where_they_face_the_eye() {
        let triangles = [Triangle([Vec3::ZERO, Vec3::X, Vec3::Y])];
        let facing = shade(&Paint::Plain, 0, &triangles, Vec3::NEG_Z);
        let along = shade(&Paint::Plain, 0, &triangles, Vec3::NEG_X);
        assert!(facing[0] > 2 * along[0] && facing == shade(&Paint::Plain, 0, &triangles, Vec3::Z));
        let red = Paint::Each(Arc::new(vec![[200, 0, 0, 255]]));
        let painted = shade(&red, 0, &triangles, Vec3::NEG_Z);
        assert!(painted[0] > 150 && painted[1] == 0);
        // Where the table says nothing, surfaces step back.
        let aside = shade(&Paint::Each(Arc::new(vec![])), 0, &triangles, Vec3::NEG_Z);
        assert!(aside[0] < facing[0]);
    }

    #[test]
    fn scales_end_where_they_say() {
        for map in ColorMap::ALL {
            assert_eq!(map.color(f64::NAN), map.color(0.0));
            assert_eq!(map.color(7.0), map.color(1.0));
            let brightness = |share| map.color(share)[..3].iter().map(|&c| u32::from(c)).sum::<u32>();
            assert!(brightness(0.0) < brightness(0.5) && brightness(0.5) < brightness(1.0));
        }
        assert_eq!(difference(0.0)[..3], [236; 3]);
        assert!(difference(-1.0)[2] > 150 && difference(2.0)[0] > 200);
    }
}
