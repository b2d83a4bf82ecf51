//! How many rays are drawn while the camera moves: as many as leave frames quick enough, found by trying.

use std::time::{Duration, Instant};

/// A frame that takes longer halves what is drawn, one that is shorter draws more.
const LONG: Duration = Duration::from_millis(80);
const SHORT: Duration = Duration::from_millis(50);
/// Fewer would not show where rays go; more cannot be told apart in movement.
const FEWEST: usize = 250;
const MOST: usize = 50_000;

/// What the last frames say.
#[derive(Clone, Debug)]
pub struct Pace {
    shapes: usize,
    last: Option<Instant>,
}

impl Default for Pace {
    fn default() -> Pace {
        Pace { shapes: 2000, last: None }
    }
}

impl Pace {
    /// A frame begins at `now`; the camera moves, or not. Frames around a rest say nothing.
    pub fn frame(&mut self, moving: bool, now: Instant) {
        let took = self.last.map(|last| now.saturating_duration_since(last));
        self.last = moving.then_some(now);
        match took.filter(|_| moving) {
            Some(took) if took > LONG => self.shapes = (self.shapes / 2).max(FEWEST),
            Some(took) if took < SHORT => self.shapes = (self.shapes + self.shapes / 4).min(MOST),
            _ => {}
        }
    }

    /// How many shapes of a batch are drawn in movement.
    pub fn shapes(&self) -> usize {
        self.shapes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_frames_draw_less_and_quick_ones_more() {
        let (mut pace, mut now) = (Pace::default(), Instant::now());
        let mut frames = |milliseconds, count| {
            for _ in 0..count {
                now += Duration::from_millis(milliseconds);
                pace.frame(true, now);
            }
            pace.shapes()
        };
        assert_eq!(frames(100, 1), 2000, "the first frame has no beginning");
        assert_eq!(frames(100, 1), 1000);
        assert_eq!(frames(60, 5), 1000);
        assert_eq!(frames(16, 1), 1250);
        assert_eq!(frames(16, 100), MOST);
        assert_eq!(frames(200, 100), FEWEST);
        let rest = now + Duration::from_secs(9);
        pace.frame(false, rest);
        pace.frame(true, rest + Duration::from_secs(9));
        assert_eq!(pace.shapes(), FEWEST);
        pace.frame(true, rest + Duration::from_millis(9010));
        assert!(pace.shapes() > FEWEST);
    }
}
