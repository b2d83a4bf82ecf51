//! One picture of the scene in the window: cast coarsely while something changes, and finely once it rests.
//!
//! A change is answered at once, in the frame that it came with, at a resolution that the time allowed for it permits; so what is drawn over
//! the picture always fits it. After a moment of rest a thread casts the full resolution, and then again and again through other points of the pixels,
//! until edges are smooth. Any change ends that.

use super::cast::{Image, Scene, cast};
use super::load::OpenTree;
use super::paint::Paint;
use super::work::{Wake, Work};
use crate::render::camera::View;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// Casting in a frame may take so long.
const BUDGET: Duration = Duration::from_millis(30);
/// How long nothing changes before the picture is refined.
const REST: Duration = Duration::from_millis(120);
/// Pixels of the coarsest picture are this many wide.
const COARSEST: u32 = 8;
/// Pictures that are averaged at rest.
pub const ROUNDS: u32 = 16;

/// What a picture depends on.
#[derive(Clone, Debug)]
pub struct Subject {
    pub tree: Arc<OpenTree>,
    pub view: View,
    /// Of the pane, in pixels.
    pub size: [u32; 2],
    pub paint: Paint,
}

impl PartialEq for Subject {
    fn eq(&self, other: &Subject) -> bool {
        let paint = match (&self.paint, &other.paint) {
            (Paint::Plain, Paint::Plain) => true,
            (Paint::Each(a), Paint::Each(b)) => Arc::ptr_eq(a, b),
            _ => false,
        };
        paint && self.view == other.view && self.size == other.size && Arc::ptr_eq(&self.tree, &other.tree)
    }
}

/// A picture that came from refining: how many rounds are in it.
type Refined = (u32, Image);

/// A picture and how it is made.
#[derive(Debug, Default)]
pub struct Pane {
    subject: Option<Subject>,
    /// What is shown now.
    image: Option<Image>,
    /// Pixels of the pane per pixel of the picture.
    coarseness: u32,
    changed: Option<Instant>,
    /// Whether it was in the last frame that it changed, however long ago that was.
    just_changed: bool,
    refining: Option<Work<Refined>>,
    rounds: u32,
    /// Camera rays per second, as last measured.
    speed: f64,
}

/// What became of a picture in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progressed {
    /// There is another picture than before.
    pub new: bool,
    /// When to look again at the latest, if not before.
    pub again: Option<Duration>,
}

impl Pane {
    /// The picture that is shown.
    pub fn image(&self) -> Option<&Image> {
        self.image.as_ref()
    }

    /// Whether the camera or what it looks at has changed just now.
    pub fn is_moving(&self) -> bool {
        self.changed.is_some_and(|changed| changed.elapsed() < REST)
    }

    /// Whether what it looks at changed in the last frame.
    pub fn has_just_changed(&self) -> bool {
        self.just_changed
    }

    /// Whether the picture is as good as it gets.
    pub fn is_finished(&self) -> bool {
        self.rounds >= ROUNDS
    }

    /// Pixels of the pane per pixel of the picture, in each direction.
    pub fn coarseness(&self) -> u32 {
        self.coarseness
    }

    /// Brings the picture up to date with `subject`.
    pub fn show(&mut self, subject: Subject, wake: &Wake) -> Progressed {
        self.just_changed = self.subject.as_ref() != Some(&subject);
        if self.just_changed {
            self.refining = None;
            self.rounds = 0;
            self.cast_at_once(&subject);
            self.subject = Some(subject);
            self.changed = Some(Instant::now());
            return Progressed { new: true, again: Some(REST) };
        }
        if let Some(work) = &mut self.refining {
            let Some((rounds, image)) = work.newest() else { return Progressed { new: false, again: None } };
            (self.rounds, self.coarseness, self.image) = (rounds, 1, Some(image));
            return Progressed { new: true, again: None };
        }
        let waited = self.changed.map_or(REST, |changed| changed.elapsed());
        if waited < REST {
            return Progressed { new: false, again: Some(REST - waited) };
        }
        self.refining = Some(refine(subject, wake));
        // What was thinned out for the movement is drawn in full now.
        Progressed { new: true, again: None }
    }

    /// How coarse a picture of `pixels` has to be, to be cast in time.
    fn affordable(&self, pixels: f64) -> u32 {
        let speed = if self.speed > 0.0 { self.speed } else { 2e6 };
        let coarseness = (pixels / (speed * BUDGET.as_secs_f64())).sqrt().ceil();
        (coarseness as u32).clamp(1, COARSEST)
    }

    fn cast_at_once(&mut self, subject: &Subject) {
        let [width, height] = subject.size;
        self.coarseness = self.affordable(f64::from(width) * f64::from(height));
        let coarse = [width, height].map(|side| side.div_ceil(self.coarseness) as usize);
        let started = Instant::now();
        let mut image = Image::new(coarse[0], coarse[1]);
        let scene = Scene { prepared: subject.tree.caster(), triangles: subject.tree.triangles() };
        cast(scene, &subject.view, [0.5; 2], &subject.paint, &mut image, &AtomicBool::new(false));
        let speed = (coarse[0] * coarse[1]) as f64 / started.elapsed().as_secs_f64().max(1e-6);
        // Old measurements fade: scenes are faster from some places than from others.
        self.speed = if self.speed > 0.0 { 0.5 * (self.speed + speed) } else { speed };
        self.image = Some(image);
    }
}

/// Casts `subject` in full, round after round, each through another point of the pixels; gives the mean of all rounds.
fn refine(subject: Subject, wake: &Wake) -> Work<Refined> {
    Work::start(wake, move |stop, give| {
        let [width, height] = subject.size.map(|side| side as usize);
        let mut image = Image::new(width, height);
        let mut sums = vec![[0u32; 3]; image.colors.len()];
        // Distances and triangles are those through the middles of pixels, from the first round.
        let mut first: Option<Image> = None;
        for round in 0..ROUNDS {
            let scene = Scene { prepared: subject.tree.caster(), triangles: subject.tree.triangles() };
            let offset = if round == 0 { [0.5; 2] } else { [halton(round, 2), halton(round, 3)] };
            if !cast(scene, &subject.view, offset, &subject.paint, &mut image, stop.flag()) {
                return;
            }
            for (sum, color) in sums.iter_mut().zip(&image.colors) {
                (0..3).for_each(|channel| sum[channel] += u32::from(color[channel]));
            }
            let shown = first.get_or_insert_with(|| image.clone());
            // Each step is a picture to be uploaded: four of them are enough.
            let rounds = round + 1;
            if rounds.is_power_of_two() {
                for (color, sum) in shown.colors.iter_mut().zip(&sums) {
                    *color = [0, 1, 2, 3]
                        .map(|channel| if channel < 3 { (sum[channel] / rounds) as u8 } else { 255 });
                }
                give((rounds, shown.clone()));
            }
        }
    })
}

/// Element `index` of Halton's sequence in a base: points that fill a square evenly.
fn halton(mut index: u32, base: u32) -> f32 {
    let (mut value, mut share) = (0.0, 1.0);
    while index > 0 {
        share /= base as f32;
        value += share * (index % base) as f32;
        index /= base;
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_as_fine_as_time_allows() {
        let pane = |speed| Pane { speed, ..Pane::default() };
        let budget = BUDGET.as_secs_f64();
        assert_eq!(pane(1e6 / budget).affordable(1e6), 1);
        assert_eq!(pane(1e6 / budget).affordable(4e6), 2);
        assert_eq!(pane(1.0).affordable(1e6), COARSEST);
    }

    #[test]
    fn points_fill_the_pixel() {
        assert_eq!([1, 2, 3, 4].map(|index| halton(index, 2)), [0.5, 0.25, 0.75, 0.125]);
        let mean = (1..64).map(|index| halton(index, 3)).sum::<f32>() / 63.0;
        assert!((mean - 0.5).abs() < 0.02);
    }
}
