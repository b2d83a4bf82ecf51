//! What a user asked for on the command line, put into effect once the files are open: the same for a window and for a screenshot.

use super::layers::{Boxes, PixelColor, RayColor, SurfaceColor};
use super::modes::ModeName;
use super::modes::crossplane::{Facing, Shown as PlaneShows};
use super::modes::query::Wanted;
use super::session::Session;
use super::shared::Shared;
use crate::render::camera::{Camera, CameraError, View, parse_view};
use crate::replay::pixels::ImageSize;
use crate::traverse::Traversal;
use clap::ValueEnum;
use std::str::FromStr;
use thiserror::Error;

/// Which boxes: `children`, `level:N`, `above:SHARE` or `none`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BoxWish {
    None,
    Children,
    Level(usize),
    Above(f64),
}

impl FromStr for BoxWish {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<BoxWish, &'static str> {
        let expected = "expected children, level:N, above:SHARE (such as above:0.01) or none";
        match text.split_once(':') {
            None if text == "children" => Ok(BoxWish::Children),
            None if text == "none" => Ok(BoxWish::None),
            Some(("level", levels)) => levels.parse().map(BoxWish::Level).map_err(|_| expected),
            Some(("above", share)) => match share.parse::<f64>() {
                Ok(share) if share > 0.0 && share <= 1.0 => Ok(BoxWish::Above(share)),
                _ => Err(expected),
            },
            _ => Err(expected),
        }
    }
}

/// What was asked for; what was not stays as a window starts.
#[derive(Clone, Debug, Default)]
pub struct Wishes {
    /// `eye/target[/up]`.
    pub view: Option<String>,
    pub fov: Option<f32>,
    pub mode: ModeName,
    pub traversal: Option<Traversal>,
    /// A node of the first tree.
    pub node: Option<u32>,
    pub boxes: Option<BoxWish>,
    pub color: Option<SurfaceColor>,
    pub ray_color: Option<RayColor>,
    /// Most rays.
    pub rays: Option<usize>,
    /// Most hit points.
    pub points: Option<usize>,
    /// The recorded image as a heat map.
    pub pixels: Option<PixelColor>,
    /// Its size, where the trees do not say it.
    pub image: Option<ImageSize>,
    /// The scene of the recording, where it is asked for.
    pub scene: Option<u16>,
    /// The way the plane stands, and where.
    pub plane: Option<(Facing, f32)>,
    /// What the plane shows.
    pub shows: Option<PlaneShows>,
    /// A query or a pixel of the recording, to be followed, and its step.
    pub query: Option<Wanted>,
    pub pixel: Option<[u32; 2]>,
    pub step: usize,
    pub no_panels: bool,
}

/// Why a wish cannot be met by these files.
#[derive(Debug, Error)]
pub enum WishError {
    #[error(transparent)]
    Camera(#[from] CameraError),
    #[error("--node {node}: the tree has nodes 0 to {last}")]
    Node { node: u32, last: usize },
    #[error("--{0} needs a recording (.rays)")]
    NoRecording(&'static str),
    #[error("--{0}: no tree says how large the recorded image is: add --image WxH")]
    NoImage(&'static str),
    #[error("--pixels difference: expected two trees")]
    OneTree,
    #[error("--pixel {x},{y}: the recorded image has {width} x {height} pixels")]
    Pixel { x: u32, y: u32, width: u32, height: u32 },
}

impl Wishes {
    /// Puts them into effect.
    ///
    /// # Errors
    /// When a view is none, or there is no such node.
    pub fn apply(&self, session: &mut Session) -> Result<(), WishError> {
        let shared = &mut session.shared;
        let mut view = shared.camera.view;
        if let Some(text) = &self.view {
            let (eye, target, up) = parse_view(text)?;
            view = View { eye, target, up: up.unwrap_or(shared.opened.up.up), ..view };
        }
        view.fov_degrees = self.fov.unwrap_or(view.fov_degrees);
        // Whatever the size: a view that no camera can have is refused now.
        Camera::new(&view, 3, 2)?;
        shared.camera.view = view;
        if let Some(node) = self.node {
            let nodes = shared.tree().bvh.tree.nodes.len();
            if node as usize >= nodes {
                return Err(WishError::Node { node, last: nodes - 1 });
            }
            shared.go(node);
        }
        shared.traversal = self.traversal.unwrap_or(shared.traversal);
        session.modes.switch(self.mode, shared);
        // After the mode, which makes visible what it is about.
        let layers = &mut shared.layers;
        if let Some(wish) = self.boxes {
            layers.boxes.visible = wish != BoxWish::None;
            match wish {
                BoxWish::None => {}
                BoxWish::Children => layers.boxes.which = Boxes::Children,
                BoxWish::Level(levels) => (layers.boxes.which, layers.boxes.levels) = (Boxes::Level, levels),
                BoxWish::Above(share) => (layers.boxes.which, layers.boxes.share) = (Boxes::Above, share),
            }
        }
        layers.surfaces.color = self.color.unwrap_or(layers.surfaces.color);
        layers.rays.color = self.ray_color.unwrap_or(layers.rays.color);
        if let Some(most) = self.rays {
            (layers.rays.visible, layers.rays.most) = (true, most);
        }
        if let Some(most) = self.points {
            (layers.rays.points, layers.rays.most) = (true, most);
        }
        if let Some(color) = self.pixels {
            let recording = shared.opened.recording.as_ref().ok_or(WishError::NoRecording("pixels"))?;
            if recording.image.is_none() {
                return Err(WishError::NoImage("pixels"));
            }
            if color == PixelColor::Difference && shared.opened.trees.len() < 2 {
                return Err(WishError::OneTree);
            }
            (layers.pixels.visible, layers.pixels.color) = (true, color);
        }
        let plane = &mut session.modes.crossplane;
        (plane.facing, plane.place) = self.plane.unwrap_or((plane.facing, plane.place));
        plane.shown = self.shows.unwrap_or(plane.shown);
        if let Some(wanted) = self.wanted(shared)? {
            session.modes.query.want(wanted, self.step);
        }
        session.panels = !self.no_panels;
        Ok(())
    }
}

impl Wishes {
    /// The query that is to be followed.
    fn wanted(&self, shared: &Shared) -> Result<Option<Wanted>, WishError> {
        let recording = shared.opened.recording.as_ref();
        if let Some([x, y]) = self.pixel {
            let recording = recording.ok_or(WishError::NoRecording("pixel"))?;
            let image = recording.image.ok_or(WishError::NoImage("pixel"))?;
            if x >= image.width || y >= image.height {
                return Err(WishError::Pixel { x, y, width: image.width, height: image.height });
            }
            return Ok(Some(Wanted::Pixel(y * image.width + x)));
        }
        match (self.query, recording) {
            (Some(_), None) => Err(WishError::NoRecording("query")),
            (query, _) => Ok(query),
        }
    }
}

/// A plane: `x`, `y`, `z` or `camera`, and where along its normal, such as `y:0.3`.
pub fn parse_plane(text: &str) -> Result<(Facing, f32), &'static str> {
    let expected = "expected x, y, z or camera, and a place from 0 to 1, such as y:0.3";
    let (facing, place) = text.split_once(':').ok_or(expected)?;
    let facing = <Facing as ValueEnum>::from_str(facing, true).map_err(|_| expected)?;
    match place.parse::<f32>() {
        Ok(place) if (0.0..=1.0).contains(&place) => Ok((facing, place)),
        _ => Err(expected),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_are_named() {
        assert_eq!(parse_plane("y:0.3"), Ok((Facing::Y, 0.3)));
        assert_eq!(parse_plane("camera:0"), Ok((Facing::Camera, 0.0)));
        for bad in ["", "y", "w:0.5", "x:2", "x:nan", "x:-1"] {
            assert!(parse_plane(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn boxes_are_named() {
        assert_eq!("children".parse(), Ok(BoxWish::Children));
        assert_eq!("level:3".parse(), Ok(BoxWish::Level(3)));
        assert_eq!("above:0.25".parse(), Ok(BoxWish::Above(0.25)));
        for bad in ["", "level", "level:x", "above:0", "above:2", "above:nan", "all:3"] {
            assert!(bad.parse::<BoxWish>().is_err(), "{bad}");
        }
    }
}
