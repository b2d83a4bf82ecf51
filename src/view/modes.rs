//! Interaction modes, one after the pattern *state*: what keys and clicks mean, what is drawn for them, and what stands in the panel.
//!
//! The camera is the same in all of them; a mode sees keys and clicks that did not move it.

pub mod crossplane;
pub mod explore;
pub mod navigate;
pub mod query;

use super::overlay::Overlay;
use super::shared::{Legend, Shared, Spot};
use eframe::egui::{Key, Modifiers, Ui};

/// What happened since the last frame, apart from the camera.
#[derive(Clone, Debug, Default)]
pub struct Input {
    /// Keys pressed, with the modifiers held.
    pub keys: Vec<(Key, Modifiers)>,
    /// A click into a picture.
    pub click: Option<Spot>,
    /// A second click at the same place.
    pub double_click: bool,
    /// A picture is dragged with the modifier Ctrl: by shares of its height, to the right and down.
    pub drag: Option<[f32; 2]>,
}

impl Input {
    /// Whether a key was pressed without modifiers, or with only shift.
    pub fn pressed(&self, key: Key) -> bool {
        self.keys.iter().any(|&(pressed, modifiers)| pressed == key && !modifiers.command && !modifiers.alt)
    }
}

/// A way to interact.
pub trait Mode {
    fn name(&self) -> &'static str;

    /// What one does in it, in a sentence.
    fn purpose(&self) -> &'static str;

    /// Its keys and clicks, and what they do.
    fn keys(&self) -> &'static [(&'static str, &'static str)];

    /// Called once when it becomes the current one.
    fn enter(&mut self, _shared: &mut Shared) {}

    /// Answers keys and clicks.
    fn update(&mut self, shared: &mut Shared, input: &Input);

    /// Draws into the picture of a pane.
    fn overlay(&self, _shared: &Shared, _pane: usize, _overlay: &mut Overlay) {}

    /// What the colours of what it draws mean.
    fn legend(&self, _pane: usize) -> Option<Legend> {
        None
    }

    /// The panel beside the pictures.
    fn panel(&mut self, ui: &mut Ui, shared: &mut Shared);

    /// Whether nothing is being worked out that will change the picture.
    fn is_settled(&self) -> bool {
        true
    }
}

/// The modes by name, in the order of their keys, 1 to 4.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum ModeName {
    #[default]
    Move,
    Explore,
    Crossplane,
    Query,
}

impl ModeName {
    pub const ALL: [ModeName; 4] = [ModeName::Move, ModeName::Explore, ModeName::Crossplane, ModeName::Query];
}

/// All modes, of which one is current. Each keeps its state while another is.
#[derive(Default)]
pub struct Modes {
    navigate: navigate::Navigate,
    explore: explore::Explore,
    pub crossplane: crossplane::Crossplane,
    pub query: query::QueryMode,
    current: ModeName,
}

impl Modes {
    pub fn current(&mut self) -> &mut dyn Mode {
        self.mode(self.current)
    }

    pub fn mode(&mut self, name: ModeName) -> &mut dyn Mode {
        match name {
            ModeName::Move => &mut self.navigate,
            ModeName::Explore => &mut self.explore,
            ModeName::Crossplane => &mut self.crossplane,
            ModeName::Query => &mut self.query,
        }
    }

    pub fn name(&self) -> ModeName {
        self.current
    }

    pub fn switch(&mut self, to: ModeName, shared: &mut Shared) {
        if to != self.current {
            self.current = to;
            self.current().enter(shared);
        }
    }
}
