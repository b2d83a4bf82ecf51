//! The list of what can be seen: each with whether it is, how it is coloured, and how opaque it is.

use super::paint::ColorMap;
use crate::format::rays::Purpose;

/// What colours surfaces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, clap::ValueEnum)]
pub enum SurfaceColor {
    /// All alike
    #[default]
    Plain,
    /// By the child of the current node that holds them
    Subtree,
    /// By what queries spend, in nanoseconds, at each triangle's leaf and on the nodes above it
    Cost,
    /// By tests of each triangle
    Tests,
    /// By queries that end at each triangle
    Hits,
    /// By the difference of the cost between two trees
    Difference,
}

impl SurfaceColor {
    pub const ALL: [SurfaceColor; 6] = [
        SurfaceColor::Plain,
        SurfaceColor::Subtree,
        SurfaceColor::Cost,
        SurfaceColor::Tests,
        SurfaceColor::Hits,
        SurfaceColor::Difference,
    ];

    pub fn name(self) -> &'static str {
        match self {
            SurfaceColor::Plain => "plain",
            SurfaceColor::Subtree => "by subtree",
            SurfaceColor::Cost => "cost per triangle",
            SurfaceColor::Tests => "tests per triangle",
            SurfaceColor::Hits => "hits per triangle",
            SurfaceColor::Difference => "difference of cost",
        }
    }
}

/// Which boxes of the tree are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Boxes {
    /// Of the current node and its children.
    #[default]
    Children,
    /// Of all nodes so many levels below the current one.
    Level,
    /// Of every node below the current one on which at least a share of all cost is spent.
    Above,
}

impl Boxes {
    pub const ALL: [Boxes; 3] = [Boxes::Children, Boxes::Level, Boxes::Above];

    pub fn name(self) -> &'static str {
        match self {
            Boxes::Children => "node and children",
            Boxes::Level => "a level below",
            Boxes::Above => "nodes above a cost",
        }
    }
}

/// What colours recorded rays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, clap::ValueEnum)]
pub enum RayColor {
    #[default]
    Purpose,
    Depth,
    Hit,
    Cost,
}

impl RayColor {
    pub const ALL: [RayColor; 4] = [RayColor::Purpose, RayColor::Depth, RayColor::Hit, RayColor::Cost];

    pub fn name(self) -> &'static str {
        match self {
            RayColor::Purpose => "purpose",
            RayColor::Depth => "depth",
            RayColor::Hit => "hit or miss",
            RayColor::Cost => "cost",
        }
    }
}

/// Surfaces.
#[derive(Clone, Debug)]
pub struct SurfaceLayer {
    pub visible: bool,
    pub opacity: f32,
    pub color: SurfaceColor,
    pub map: ColorMap,
}

/// Boxes of nodes.
#[derive(Clone, Debug)]
pub struct BoxLayer {
    pub visible: bool,
    pub opacity: f32,
    /// How much of that is left behind surfaces.
    pub behind: f32,
    pub which: Boxes,
    /// For [`Boxes::Level`].
    pub levels: usize,
    /// For [`Boxes::Above`].
    pub share: f64,
}

/// Recorded rays, and where they end.
#[derive(Clone, Debug)]
pub struct RayLayer {
    pub visible: bool,
    pub points: bool,
    pub opacity: f32,
    pub behind: f32,
    /// In pixels, of rays and of points.
    pub width: f32,
    pub size: f32,
    pub color: RayColor,
    /// Which purposes, as [`Purpose`] is numbered.
    pub purposes: [bool; Purpose::ALL.len()],
    pub hits: bool,
    pub misses: bool,
    /// Only this depth.
    pub depth: Option<u8>,
    /// Every so-manieth of the chosen ones.
    pub every: u64,
    pub most: usize,
}

/// What colours pixels of the recorded image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, clap::ValueEnum)]
pub enum PixelColor {
    /// By what the queries of each pixel cost in the tree, in nanoseconds
    #[default]
    Cost,
    /// By how much more they cost in the first tree than in the second
    Difference,
    /// By their tests of boxes and triangles, the paper's Γ
    Tests,
}

impl PixelColor {
    pub const ALL: [PixelColor; 3] = [PixelColor::Cost, PixelColor::Difference, PixelColor::Tests];

    pub fn name(self) -> &'static str {
        match self {
            PixelColor::Cost => "cost per pixel",
            PixelColor::Difference => "difference of cost",
            PixelColor::Tests => "tests per pixel",
        }
    }
}

/// The image that was recorded, as costs of its pixels.
#[derive(Clone, Debug)]
pub struct PixelLayer {
    pub visible: bool,
    pub opacity: f32,
    pub color: PixelColor,
    pub map: ColorMap,
}

impl PixelLayer {
    /// Whether both give pixels the same colours.
    pub fn colors_as(&self, other: &PixelLayer) -> bool {
        (self.color, self.map) == (other.color, other.map)
    }
}

/// All of them.
#[derive(Clone, Debug)]
pub struct Layers {
    pub surfaces: SurfaceLayer,
    pub boxes: BoxLayer,
    pub rays: RayLayer,
    pub pixels: PixelLayer,
}

impl Default for Layers {
    fn default() -> Layers {
        Layers {
            surfaces: SurfaceLayer {
                visible: true,
                opacity: 1.0,
                color: SurfaceColor::Plain,
                map: ColorMap::Viridis,
            },
            boxes: BoxLayer {
                visible: false,
                opacity: 1.0,
                behind: 0.35,
                which: Boxes::Children,
                levels: 3,
                share: 0.01,
            },
            rays: RayLayer {
                visible: false,
                points: false,
                opacity: 0.4,
                behind: 0.15,
                width: 1.0,
                size: 4.0,
                color: RayColor::Purpose,
                purposes: [true; Purpose::ALL.len()],
                hits: true,
                misses: true,
                depth: None,
                every: 1,
                most: 20_000,
            },
            pixels: PixelLayer {
                visible: false,
                opacity: 0.8,
                color: PixelColor::Cost,
                map: ColorMap::Viridis,
            },
        }
    }
}
