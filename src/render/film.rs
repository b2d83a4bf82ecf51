//! The image: linear radiance per pixel, and how it becomes a file.
//!
//! An EXR holds the radiance as it is. A PNG is for looking at: exposed so that the middle of the image is neither black nor
//! white, its highlights rolled off (Narkowicz's fit of the ACES curve, 2015), in sRGB.

use crate::geometry::Vec3;
use crate::render::tiles::Tile;
use image::{ImageBuffer, ImageFormat, Rgb};
use std::io::Cursor;
use thiserror::Error;

/// What an image file holds, by the extension of its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageKind {
    Png,
    Exr,
}

impl ImageKind {
    /// The kind that a file name asks for; `None` for extensions other than png and exr.
    pub fn of(path: &std::path::Path) -> Option<ImageKind> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "png" => Some(ImageKind::Png),
            "exr" => Some(ImageKind::Exr),
            _ => None,
        }
    }
}

/// An image could not be encoded.
#[derive(Debug, Error)]
#[error("image of {width} x {height}: {source}")]
pub struct ImageError {
    width: u32,
    height: u32,
    source: image::ImageError,
}

/// Linear radiance, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    pub width: u32,
    pub height: u32,
    pub pixels: Vec<Vec3>,
}

/// Where the geometric mean of the luminance comes to lie before the curve: middle grey.
const MIDDLE_GREY: f32 = 0.18;

impl Film {
    pub fn new(width: u32, height: u32) -> Film {
        Film { width, height, pixels: vec![Vec3::ZERO; width as usize * height as usize] }
    }

    /// Puts the pixels of a tile, row by row, where they belong.
    pub fn place(&mut self, tile: &Tile, pixels: &[Vec3]) {
        for (row, pixels) in pixels.chunks_exact(tile.width as usize).enumerate() {
            let first = (tile.y as usize + row) * self.width as usize + tile.x as usize;
            self.pixels[first..first + pixels.len()].copy_from_slice(pixels);
        }
    }

    /// The factor that brings the geometric mean luminance of the lit pixels to middle grey; 1 for a black image.
    pub fn exposure(&self) -> f32 {
        let (mut sum, mut lit) = (0.0, 0u64);
        for pixel in &self.pixels {
            let luminance = luminance(*pixel);
            if luminance > 0.0 && luminance.is_finite() {
                sum += f64::from(luminance).ln();
                lit += 1;
            }
        }
        if lit == 0 { 1.0 } else { MIDDLE_GREY / (sum / lit as f64).exp() as f32 }
    }

    /// The bytes of an image file.
    ///
    /// # Errors
    /// When the encoder refuses the size.
    pub fn encode(&self, kind: ImageKind) -> Result<Vec<u8>, ImageError> {
        let mut bytes = Cursor::new(Vec::new());
        let (width, height) = (self.width, self.height);
        let encoded = match kind {
            ImageKind::Png => {
                let exposure = self.exposure();
                let pixel = |x, y| Rgb(self.at(x, y).to_array().map(|radiance| display(exposure * radiance)));
                ImageBuffer::from_fn(width, height, pixel).write_to(&mut bytes, ImageFormat::Png)
            }
            ImageKind::Exr => {
                let pixel = |x, y| Rgb(self.at(x, y).to_array());
                ImageBuffer::from_fn(width, height, pixel).write_to(&mut bytes, ImageFormat::OpenExr)
            }
        };
        encoded.map_err(|source| ImageError { width, height, source })?;
        Ok(bytes.into_inner())
    }

    fn at(&self, x: u32, y: u32) -> Vec3 {
        self.pixels[y as usize * self.width as usize + x as usize]
    }
}

/// Relative luminance (ITU-R BT.709).
#[inline]
pub fn luminance(rgb: Vec3) -> f32 {
    rgb.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

/// One channel, tone mapped and in sRGB.
fn display(x: f32) -> u8 {
    // Beyond 10,000 it is white anyway, and squares stay finite; NaN is black.
    let x = if x > 0.0 { x.min(1e4) } else { 0.0 };
    let mapped = (x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)).min(1.0);
    let encoded = if mapped <= 0.003_130_8 { 12.92 * mapped } else { 1.055 * mapped.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> Film {
        let mut film = Film::new(4, 2);
        for (i, pixel) in film.pixels.iter_mut().enumerate() {
            *pixel = Vec3::new(i as f32, 0.5 * i as f32, 0.25);
        }
        film
    }

    #[test]
    fn exr_keeps_radiance() {
        let film = ramp();
        let bytes = film.encode(ImageKind::Exr).unwrap();
        let read = image::load_from_memory_with_format(&bytes, ImageFormat::OpenExr).unwrap().into_rgb32f();
        assert_eq!(read.dimensions(), (4, 2));
        let pixels: Vec<Vec3> = read.pixels().map(|p| Vec3::from_array(p.0)).collect();
        assert_eq!(pixels, film.pixels);
    }

    #[test]
    fn png_is_monotonic_and_the_right_way_up() {
        let bytes = ramp().encode(ImageKind::Png).unwrap();
        let read = image::load_from_memory_with_format(&bytes, ImageFormat::Png).unwrap().into_rgb8();
        let reds: Vec<u8> = read.pixels().map(|p| p.0[0]).collect();
        assert!(reds.is_sorted() && reds[0] == 0 && reds[7] > 200, "{reds:?}");
    }

    #[test]
    fn exposure_undoes_brightness() {
        let mut film = ramp();
        let before = film.exposure();
        film.pixels.iter_mut().for_each(|p| *p *= 1000.0);
        assert!((film.exposure() * 1000.0 / before - 1.0).abs() < 1e-4);
        assert_eq!(Film::new(3, 3).exposure(), 1.0);
    }

    #[test]
    fn the_curve_ends_where_it_should() {
        assert_eq!((display(0.0), display(f32::NAN), display(-1.0)), (0, 0, 0));
        assert_eq!((display(1e30), display(100.0)), (255, 255));
        assert!((90..150).contains(&display(MIDDLE_GREY)), "{}", display(MIDDLE_GREY));
    }

    #[test]
    fn kinds_by_name() {
        let of = |name: &str| ImageKind::of(std::path::Path::new(name));
        assert_eq!(of("a/b.PNG"), Some(ImageKind::Png));
        assert_eq!(of("b.exr"), Some(ImageKind::Exr));
        assert_eq!((of("b.jpg"), of("png")), (None, None));
    }
}
