//! Units of work: square tiles of the image with all their samples, in a fixed order.
//!
//! A tile is as large as lets its queries fit in one chunk of a `.rays`, so that a unit is a chunk when it can be, and as
//! coherent as possible. Inside a tile, samples go by groups of neighbouring pixels, one packet each.

use crate::format::rays::MAX_CHUNK_RECORDS;
use crate::render::job::Job;
use crate::render::sampler::Sampler;

/// Largest edge of a tile, in pixels.
const MAX_EDGE: u32 = 32;

/// A job cut into tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tiles {
    width: u32,
    height: u32,
    edge: u32,
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    pub x: u32,
    pub y: u32,
    pub width: u32,
    pub height: u32,
}

/// One sample of one pixel.
#[derive(Clone, Copy, Debug)]
pub struct PixelSample {
    /// y * width + x: the pixel as records name it.
    pub path: u32,
    /// The point of the image, in pixels from its upper left corner.
    pub x: f32,
    pub y: f32,
    pub sampler: Sampler,
}

/// The dimensions of a sample's random numbers: the point in the pixel, then [`PER_DEPTH`] for each surface.
const PIXEL: u32 = 0;
/// Random numbers that one surface may use.
pub const PER_DEPTH: u32 = 4;

/// The first dimension of the random numbers for rays of a depth, at least 1.
#[inline]
pub fn first_dimension(depth: u8) -> u32 {
    1 + (u32::from(depth) - 1) * PER_DEPTH
}

impl Tiles {
    pub fn new(job: &Job) -> Tiles {
        let per_pixel = u64::from(job.samples) * job.queries_per_sample();
        let mut edge = MAX_EDGE;
        while edge > 1 && u64::from(edge * edge) * per_pixel > MAX_CHUNK_RECORDS as u64 {
            edge /= 2;
        }
        Tiles { width: job.width, height: job.height, edge }
    }

    pub fn len(&self) -> u64 {
        u64::from(self.columns()) * u64::from(self.height.div_ceil(self.edge))
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn columns(&self) -> u32 {
        self.width.div_ceil(self.edge)
    }

    /// Tile `index` of [`Self::len`], row by row.
    pub fn tile(&self, index: u64) -> Tile {
        let columns = u64::from(self.columns());
        let (x, y) = ((index % columns) as u32 * self.edge, (index / columns) as u32 * self.edge);
        Tile { x, y, width: self.edge.min(self.width - x), height: self.edge.min(self.height - y) }
    }
}

impl Tile {
    /// Calls `trace` for each sample of the tile, in groups of at most `group` neighbouring pixels, with the pixels'
    /// indices within the tile.
    pub fn for_each_group(&self, job: &Job, mut trace: impl FnMut(&[usize], &[PixelSample])) {
        let (mut pixels, mut samples) = (Vec::with_capacity(job.packet), Vec::with_capacity(job.packet));
        // A packet covers a block as square as can be.
        let block_width = match job.packet {
            16 | 8 => 4,
            4 => 2,
            _ => 1,
        };
        let block_height = job.packet as u32 / block_width;
        for y in (0..self.height).step_by(block_height as usize) {
            for x in (0..self.width).step_by(block_width as usize) {
                for sample in 0..job.samples {
                    pixels.clear();
                    samples.clear();
                    for py in y..(y + block_height).min(self.height) {
                        for px in x..(x + block_width).min(self.width) {
                            pixels.push((py * self.width + px) as usize);
                            samples.push(pixel_sample(job, self.x + px, self.y + py, sample));
                        }
                    }
                    trace(&pixels, &samples);
                }
            }
        }
    }
}

fn pixel_sample(job: &Job, x: u32, y: u32, sample: u32) -> PixelSample {
    let path = y * job.width + x;
    let sampler = Sampler::new(job.seed, path, sample);
    let [u, v] = sampler.pair(PIXEL);
    PixelSample { path, x: x as f32 + u, y: y as f32 + v, sampler }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::job::tests::job;

    #[test]
    fn every_sample_of_every_pixel_once() {
        for (width, height, samples, packet) in
            [(1, 1, 1, 1), (33, 65, 2, 1), (70, 31, 3, 4), (37, 41, 1, 8), (18, 3, 40, 16)]
        {
            let job = Job { width, height, samples, packet, ..job() };
            let tiles = Tiles::new(&job);
            let mut seen = vec![0u32; (width * height) as usize];
            for index in 0..tiles.len() {
                let tile = tiles.tile(index);
                tile.for_each_group(&job, |pixels, group| {
                    assert!(group.len() <= packet && pixels.len() == group.len());
                    for (&pixel, sample) in pixels.iter().zip(group) {
                        let (x, y) = (tile.x + pixel as u32 % tile.width, tile.y + pixel as u32 / tile.width);
                        assert_eq!(sample.path, y * width + x);
                        // The sum of a pixel and almost 1 may round up.
                        let (x, y) = (x as f32, y as f32);
                        assert!(sample.x >= x && sample.x <= x + 1.0 && sample.y >= y && sample.y <= y + 1.0);
                        seen[sample.path as usize] += 1;
                    }
                });
            }
            assert!(seen.iter().all(|&n| n == samples), "{width}x{height}");
        }
    }

    #[test]
    fn a_tile_fits_in_a_chunk() {
        let tile = |samples, max_depth| Tiles::new(&Job { samples, max_depth, ..job() }).edge;
        assert_eq!(tile(1, 4), 32);
        assert_eq!(tile(8, 4), 16);
        assert_eq!(tile(1 << 20, 4), 1);
    }
}
