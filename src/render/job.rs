//! What to compute, checked before anything runs.

use clap::ValueEnum;
use thiserror::Error;

/// How pixels get their radiance, and so which rays there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Integrator {
    /// Paths with a shadow ray to a light at every surface
    Path,
    /// Ambient occlusion: short rays over the hemisphere
    Ao,
    /// Camera rays only
    Primary,
    /// Camera rays and one shadow ray to a light or the sky
    Shadow,
}

impl Integrator {
    pub fn name(self) -> &'static str {
        match self {
            Integrator::Path => "path",
            Integrator::Ao => "ao",
            Integrator::Primary => "primary",
            Integrator::Shadow => "shadow",
        }
    }
}

/// What to compute.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Job {
    pub width: u32,
    pub height: u32,
    /// Samples per pixel.
    pub samples: u32,
    pub seed: u64,
    pub integrator: Integrator,
    /// `path`: how often a path is scattered at most, which is also the largest depth of a query; 1 is direct light
    /// and one bounce that may find the sky or a lamp.
    pub max_depth: u8,
    /// `ao`: rays per camera ray that hits.
    pub ao_rays: u32,
    pub threads: usize,
    /// Camera rays and first shadow rays asked at once: 1, 4, 8 or 16.
    pub packet: usize,
}

/// What a [`Job`] may ask for at most.
pub struct Limits;

impl Limits {
    pub const EDGE: u32 = 65_536;
    /// Pixels of an image: 800 MB of radiance.
    pub const PIXELS: u64 = 1 << 26;
    pub const SAMPLES: u32 = 1 << 24;
    pub const DEPTH: u8 = 254;
    pub const AO_RAYS: u32 = 1024;
    pub const THREADS: usize = 1024;
}

/// Why a job cannot be done.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum JobError {
    #[error("size {0}: expected WIDTHxHEIGHT, each from 1 to 65536")]
    Size(String),
    #[error("size {width}x{height}: {pixels} pixels, at most {} are possible", Limits::PIXELS)]
    Pixels { width: u32, height: u32, pixels: u64 },
    #[error("{what} {found}: expected {least} to {most}")]
    Range { what: &'static str, found: u64, least: u64, most: u64 },
    #[error("packet {0}: expected 1, 4, 8 or 16")]
    Packet(usize),
}

impl Job {
    /// `WIDTHxHEIGHT`.
    ///
    /// # Errors
    /// Anything that is not two numbers from 1 to [`Limits::EDGE`].
    pub fn parse_size(text: &str) -> Result<(u32, u32), JobError> {
        let edge = |t: &str| t.parse().ok().filter(|n| (1..=Limits::EDGE).contains(n));
        let size = text.split_once(['x', 'X']).and_then(|(w, h)| Some((edge(w)?, edge(h)?)));
        size.ok_or_else(|| JobError::Size(text.to_owned()))
    }

    /// The job itself, if every number is one that can be computed with.
    ///
    /// # Errors
    /// The first number that is not.
    pub fn validated(self) -> Result<Job, JobError> {
        let (width, height) = (self.width, self.height);
        if ![width, height].iter().all(|n| (1..=Limits::EDGE).contains(n)) {
            return Err(JobError::Size(format!("{width}x{height}")));
        }
        let pixels = u64::from(width) * u64::from(height);
        if pixels > Limits::PIXELS {
            return Err(JobError::Pixels { width, height, pixels });
        }
        for (what, found, most) in [
            ("samples per pixel", u64::from(self.samples), u64::from(Limits::SAMPLES)),
            ("max depth", u64::from(self.max_depth), u64::from(Limits::DEPTH)),
            ("ao rays", u64::from(self.ao_rays), u64::from(Limits::AO_RAYS)),
            ("threads", self.threads as u64, Limits::THREADS as u64),
        ] {
            if !(1..=most).contains(&found) {
                return Err(JobError::Range { what, found, least: 1, most });
            }
        }
        if ![1, 4, 8, 16].contains(&self.packet) {
            return Err(JobError::Packet(self.packet));
        }
        Ok(self)
    }

    /// Queries that one sample of a pixel asks at most.
    pub fn queries_per_sample(&self) -> u64 {
        match self.integrator {
            Integrator::Path => 1 + 2 * u64::from(self.max_depth),
            Integrator::Ao => 1 + u64::from(self.ao_rays),
            Integrator::Primary => 1,
            Integrator::Shadow => 2,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn job() -> Job {
        Job {
            width: 8,
            height: 8,
            samples: 1,
            seed: 0,
            integrator: Integrator::Path,
            max_depth: 4,
            ao_rays: 4,
            threads: 1,
            packet: 1,
        }
    }

    #[test]
    fn sizes() {
        assert_eq!(Job::parse_size("640x480"), Ok((640, 480)));
        for bad in ["0x1", "1x0", "640", "640x", "x", "-1x5", "65537x1", "99999999999x1", "1x1x1", ""] {
            assert_eq!(Job::parse_size(bad), Err(JobError::Size(bad.to_owned())), "{bad}");
        }
    }

    #[test]
    fn jobs_are_checked() {
        assert_eq!(job().validated(), Ok(job()));
        let bad = [
            Job { width: 0, ..job() },
            Job { width: 65_536, height: 65_536, ..job() },
            Job { samples: 0, ..job() },
            Job { samples: u32::MAX, ..job() },
            Job { max_depth: 0, ..job() },
            Job { max_depth: 255, ..job() },
            Job { ao_rays: 0, ..job() },
            Job { threads: 0, ..job() },
            Job { threads: 1 << 20, ..job() },
            Job { packet: 3, ..job() },
        ];
        for job in bad {
            assert!(job.validated().is_err(), "{job:?}");
        }
    }
}
