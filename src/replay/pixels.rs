//! Costs per pixel, for heat maps: summed by all threads into one image.

use super::tally::Costs;
use crate::traverse::Counts;
use serde::{Deserialize, Serialize};
use std::str::FromStr;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use thiserror::Error;

/// Most pixels of an image, as many as `embree-trace` renders: 16 bytes each, so a gigabyte.
const MOST_PIXELS: u64 = 1 << 26;

/// Width and height of the traced image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImageSize {
    pub width: u32,
    pub height: u32,
}

#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("image size {width}x{height}: expected 1 to {MOST_PIXELS} pixels")]
pub struct SizeError {
    width: u32,
    height: u32,
}

impl ImageSize {
    pub fn new(width: u32, height: u32) -> Result<ImageSize, SizeError> {
        match u64::from(width) * u64::from(height) {
            1..=MOST_PIXELS => Ok(ImageSize { width, height }),
            _ => Err(SizeError { width, height }),
        }
    }

    /// x and y of a record's path, if it is a pixel of this image.
    pub fn pixel(self, path: u32) -> Option<(u32, u32)> {
        let (x, y) = (path % self.width, path / self.width);
        (y < self.height).then_some((x, y))
    }
}

impl FromStr for ImageSize {
    type Err = String;

    /// `WIDTHxHEIGHT`, as on command lines.
    fn from_str(text: &str) -> Result<ImageSize, String> {
        let (width, height) = text.split_once(['x', 'X']).ok_or("expected WIDTHxHEIGHT, such as 640x480")?;
        let number = |text: &str| text.parse().map_err(|_| format!("\"{text}\" is not a number of pixels"));
        ImageSize::new(number(width)?, number(height)?).map_err(|error| error.to_string())
    }
}

/// Tests per pixel.
#[derive(Debug, Serialize, Deserialize)]
pub struct Pixels {
    pub size: ImageSize,
    box_tests: Vec<AtomicU64>,
    primitive_tests: Vec<AtomicU64>,
}

impl Pixels {
    pub fn new(size: ImageSize) -> Pixels {
        let zeros = || (0..size.width as usize * size.height as usize).map(|_| AtomicU64::new(0)).collect();
        Pixels { size, box_tests: zeros(), primitive_tests: zeros() }
    }

    /// Adds what a query of pixel `path` cost; a path outside of the image is not counted.
    pub fn add(&self, path: u32, counts: &Counts) {
        let at = path as usize;
        if let (Some(boxes), Some(primitives)) = (self.box_tests.get(at), self.primitive_tests.get(at)) {
            boxes.fetch_add(counts.box_tests, Relaxed);
            primitives.fetch_add(counts.primitive_tests, Relaxed);
        }
    }

    /// Adds what another part of the same recording cost.
    pub fn merge(&self, other: &Pixels) {
        let sums = [(&self.box_tests, &other.box_tests), (&self.primitive_tests, &other.primitive_tests)];
        for (sum, more) in sums.into_iter().flat_map(|(sums, more)| sums.iter().zip(more)) {
            sum.fetch_add(more.load(Relaxed), Relaxed);
        }
    }

    /// Γ of every pixel, row by row.
    pub fn costs(&self, costs: &Costs) -> Vec<f64> {
        let sums = self.box_tests.iter().zip(&self.primitive_tests);
        let counts = |(boxes, primitives): (&AtomicU64, &AtomicU64)| Counts {
            box_tests: boxes.load(Relaxed),
            primitive_tests: primitives.load(Relaxed),
            ..Counts::default()
        };
        sums.map(|pixel| costs.gamma(&counts(pixel))).collect()
    }
}
