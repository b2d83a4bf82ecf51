//! Files that a program writes, run by run: whether they are the same on Embree's trees and on planted ones.
//!
//! Pictures are compared by pixel, since a file may hold the time at which it was written; all others by byte. The program's own runs on
//! Embree's trees are compared, too: what differs among them is not the trees' doing.

use crate::files::FileError;
use image::{DynamicImage, ImageReader, Rgb, RgbImage};
use serde::Serialize;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// How a file differs from that of the first run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Difference {
    /// Runs that were compared.
    pub runs: u32,
    /// Runs whose file differs.
    pub differing: u32,
    /// Pixels that differ, in the run with most; `None` for what is no picture.
    pub pixels: Option<u64>,
    /// The greatest difference of a channel, of 1.
    pub greatest: Option<f64>,
}

/// What became of one file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Output {
    pub path: String,
    /// Size in pixels; `None` for what is no picture that we can read.
    pub size: Option<(u32, u32)>,
    /// Among runs on Embree's trees.
    pub plain: Difference,
    /// Of runs on planted trees from the first on Embree's.
    pub planted: Difference,
    /// A picture of the pixels that differ on planted trees, where there are any.
    pub picture: Option<String>,
}

impl Output {
    /// Whether planted trees change more than the program itself does from run to run; of pictures, more than `allowed` pixels.
    pub fn is_changed(&self, allowed: u64) -> bool {
        match (self.plain.pixels, self.planted.pixels) {
            (plain, Some(planted)) => planted > plain.unwrap_or(0) + allowed,
            (_, None) => self.planted.differing > 0 && self.plain.differing == 0,
        }
    }
}

/// Follows the files of one program.
pub struct Outputs {
    files: Vec<Followed>,
    kept: PathBuf,
    started: SystemTime,
}

struct Followed {
    path: PathBuf,
    /// A copy of the first run's.
    first: Option<PathBuf>,
    output: Output,
}

impl Outputs {
    /// `kept` is the directory where copies go.
    pub fn new(paths: &[PathBuf], kept: &Path) -> Outputs {
        let files = paths.iter().map(|path| Followed {
            path: path.clone(),
            first: None,
            output: Output {
                path: path.display().to_string(),
                size: None,
                plain: Difference::default(),
                planted: Difference::default(),
                picture: None,
            },
        });
        Outputs { files: files.collect(), kept: kept.to_owned(), started: start() }
    }

    /// A run begins: files that are older were not written by it.
    pub fn before_run(&mut self) {
        self.started = start();
    }

    /// A run on Embree's trees has ended.
    ///
    /// # Errors
    /// When the program has not written a file, or it cannot be copied.
    pub fn plain(&mut self) -> Result<(), FileError> {
        for number in 0..self.files.len() {
            self.check_written(number)?;
            match self.files[number].first.clone() {
                None => {
                    let copy = self.copy(number, "plain")?;
                    self.files[number].output.size = read(&copy).map(|image| (image.width(), image.height()));
                    self.files[number].first = Some(copy);
                }
                Some(first) => {
                    let file = &mut self.files[number];
                    compare(&first, &file.path, &mut file.output.plain)?;
                }
            }
        }
        Ok(())
    }

    /// A run on planted trees has ended.
    ///
    /// # Errors
    /// As [`Self::plain`].
    pub fn planted(&mut self) -> Result<(), FileError> {
        for number in 0..self.files.len() {
            self.check_written(number)?;
            let Some(first) = self.files[number].first.clone() else { continue };
            let file = &mut self.files[number];
            let before = file.output.planted.clone();
            let map = compare(&first, &file.path, &mut file.output.planted)?;
            let is_first = before.runs == 0;
            let is_worse = file.output.planted.pixels > before.pixels;
            if is_first || is_worse {
                self.copy(number, "planted")?;
            }
            if let (Some(map), true) = (map, is_worse) {
                let path = self.place(number, "difference")?.with_extension("png");
                let saved = map.save_with_format(&path, image::ImageFormat::Png);
                let error = |error| FileError::new(&path, "write", std::io::Error::other(error));
                saved.map_err(error)?;
                self.files[number].output.picture = Some(path.display().to_string());
            }
        }
        Ok(())
    }

    /// What was found.
    pub fn finish(self) -> Vec<Output> {
        self.files.into_iter().map(|file| file.output).collect()
    }

    fn check_written(&self, number: usize) -> Result<(), FileError> {
        let path = &self.files[number].path;
        let error = |error| FileError::new(path, "compare", error);
        let written = fs::metadata(path).and_then(|metadata| metadata.modified()).map_err(error)?;
        if written < self.started {
            return Err(error(std::io::Error::other("the program has not written it in this run")));
        }
        Ok(())
    }

    /// Where a copy goes; the number keeps two files of one name apart.
    fn place(&self, number: usize, what: &str) -> Result<PathBuf, FileError> {
        let directory = self.kept.join(what);
        fs::create_dir_all(&directory)
            .map_err(|error| FileError::new(&directory, "create the directory", error))?;
        let name = self.files[number].path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok(directory.join(match self.files.len() {
            1 => name,
            _ => format!("{number}-{name}"),
        }))
    }

    fn copy(&self, number: usize, what: &str) -> Result<PathBuf, FileError> {
        let to = self.place(number, what)?;
        fs::copy(&self.files[number].path, &to).map_err(|error| FileError::new(&to, "write", error))?;
        Ok(to)
    }
}

/// Now, as a file's time may say it: file systems count in steps of some milliseconds, and those behind the clock.
fn start() -> SystemTime {
    SystemTime::now() - Duration::from_millis(20)
}

/// A picture, whatever its name ends with.
fn read(path: &Path) -> Option<DynamicImage> {
    ImageReader::open(path).ok()?.with_guessed_format().ok()?.decode().ok()
}

/// Compares a run's file with the first one's. Returns a map of the pixels that differ, if there are any.
fn compare(first: &Path, now: &Path, difference: &mut Difference) -> Result<Option<RgbImage>, FileError> {
    difference.runs += 1;
    let bytes = |path: &Path| fs::read(path).map_err(|error| FileError::new(path, "read", error));
    let same = bytes(first)? == bytes(now)?;
    let Some((first, now)) = read(first).zip(read(now)) else {
        difference.differing += u32::from(!same);
        return Ok(None);
    };
    difference.pixels = Some(difference.pixels.unwrap_or(0));
    difference.greatest = Some(difference.greatest.unwrap_or(0.0));
    if same {
        return Ok(None);
    }
    let all = u64::from(first.width()) * u64::from(first.height());
    let (pixels, greatest, map) = if (first.width(), first.height()) == (now.width(), now.height()) {
        differing_pixels(&first, &now)
    } else {
        // Another size: no pixel has a counterpart.
        (all, 1.0, None)
    };
    difference.differing += u32::from(pixels > 0);
    difference.pixels = difference.pixels.max(Some(pixels));
    difference.greatest = difference.greatest.map(|before| before.max(greatest));
    Ok(map)
}

/// How many pixels differ, by how much at most, and where: red on the first picture's greys.
fn differing_pixels(first: &DynamicImage, now: &DynamicImage) -> (u64, f64, Option<RgbImage>) {
    let mut map = RgbImage::new(first.width(), first.height());
    for (to, from) in map.pixels_mut().zip(first.to_luma8().pixels()) {
        *to = Rgb([from.0[0] / 2; 3]);
    }
    let (mut pixels, mut greatest) = (0, 0.0f64);
    let (first, now) = (first.to_rgba32f(), now.to_rgba32f());
    for ((to, a), b) in map.pixels_mut().zip(first.pixels()).zip(now.pixels()) {
        // NaN is the same as NaN.
        if a.0.map(f32::to_bits) != b.0.map(f32::to_bits) {
            pixels += 1;
            let by = a.0.iter().zip(b.0).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
            greatest = greatest.max(by);
            *to = Rgb([255, 0, 0]);
        }
    }
    (pixels, greatest, (pixels > 0).then_some(map))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(directory: &Path, pixels: [u8; 4], format: image::ImageFormat) -> PathBuf {
        let path = directory.join("picture");
        let picture = RgbImage::from_fn(2, 2, |x, y| Rgb([pixels[(2 * y + x) as usize], 0, 0]));
        picture.save_with_format(&path, format).expect("written");
        path
    }

    #[test]
    fn pixels_are_counted_and_shown_where_they_differ() {
        let directory = tempfile::tempdir().expect("a directory");
        for format in [image::ImageFormat::Png, image::ImageFormat::Pnm, image::ImageFormat::Bmp] {
            let path = picture(directory.path(), [1, 2, 3, 4], format);
            let mut outputs = Outputs::new(&[path], directory.path());
            outputs.before_run();
            outputs.plain().expect("there");
            outputs.plain().expect("there");
            outputs.planted().expect("there");
            picture(directory.path(), [1, 2, 3, 255], format);
            outputs.planted().expect("there");
            let output = outputs.finish().remove(0);
            assert_eq!(output.size, Some((2, 2)));
            assert_eq!((output.plain.runs, output.plain.differing, output.plain.pixels), (1, 0, Some(0)));
            assert_eq!((output.planted.runs, output.planted.differing), (2, 1));
            assert_eq!(
                (output.planted.pixels, output.is_changed(0), output.is_changed(1)),
                (Some(1), true, false)
            );
            let by = output.planted.greatest.expect("a picture");
            assert!((by - 251.0 / 255.0).abs() < 1e-6, "{by}");
            let map = image::open(output.picture.expect("shown")).expect("a picture").to_rgb8();
            let red: Vec<bool> = map.pixels().map(|pixel| pixel.0 == [255, 0, 0]).collect();
            assert_eq!(red, [false, false, false, true]);
        }
    }

    #[test]
    fn what_is_no_picture_is_compared_by_byte_and_what_was_not_written_is_told() {
        let directory = tempfile::tempdir().expect("a directory");
        let path = directory.path().join("a.txt");
        let mut outputs = Outputs::new(std::slice::from_ref(&path), directory.path());
        assert!(outputs.plain().is_err(), "it is not there");
        fs::write(&path, "a").expect("written");
        outputs.plain().expect("there");
        fs::write(&path, "b").expect("written");
        outputs.planted().expect("there");
        std::thread::sleep(Duration::from_millis(60));
        outputs.before_run();
        assert!(outputs.planted().is_err(), "it is old");
        let output = outputs.finish().remove(0);
        assert_eq!((output.size, output.planted.differing, output.planted.pixels), (None, 1, None));
        assert!(output.is_changed(5));
    }
}
