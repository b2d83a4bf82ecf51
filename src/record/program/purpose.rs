//! Why a program asked, guessed from how it asked: records of one thread in their order -> purpose and depth.
//!
//! Embree is told nothing of it. What is not recognised stays unknown. docs/recording.md has the rules for users.

use crate::embree::ffi::EXCHANGE_NESTED;
use crate::format::rays::{NO_DEPTH, Purpose, Record};
use crate::geometry::Vec3;
use std::path::Path;

/// Which rules hold for a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rules {
    /// Masks have no meaning: occlusion queries are for shadow; closest-hit queries from the point from which
    /// the thread first asked are the camera's (of a pinhole camera). What callbacks ask is not: its answer comes first.
    General,
    /// Cycles puts the visibility of its rays into the mask (`PathRayFlag` in its kernel/types.h).
    Cycles,
    /// Everything stays unknown.
    None,
}

impl Rules {
    pub const ALL: [Rules; 3] = [Rules::General, Rules::Cycles, Rules::None];

    /// The name in options.
    pub fn name(self) -> &'static str {
        match self {
            Rules::General => "general",
            Rules::Cycles => "cycles",
            Rules::None => "none",
        }
    }

    /// By the program's name.
    pub fn of_program(program: &Path) -> Rules {
        let name = program.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with("blender") || name.starts_with("cycles") { Rules::Cycles } else { Rules::General }
    }
}

/// Bits of Cycles' visibility.
mod cycles {
    pub const CAMERA: u32 = 1;
    pub const TRANSMIT: u32 = 4;
    pub const DIFFUSE: u32 = 8;
    pub const GLOSSY: u32 = 16;
    pub const TRANSPARENT: u32 = 64;
    pub const SHADOW: u32 = 0x300;
}

/// Guesses for one thread.
pub struct Guess {
    rules: Rules,
    eye: Option<Vec3>,
    /// Depth of the path that it is on.
    depth: Option<u8>,
}

impl Guess {
    pub fn new(rules: Rules) -> Guess {
        Guess { rules, eye: None, depth: None }
    }

    /// Fills purpose and depth of the thread's next record. Returns whether a new path starts here.
    pub fn fill(&mut self, record: &mut Record) -> bool {
        let nested = u32::from(record.depth) == EXCHANGE_NESTED;
        record.depth = NO_DEPTH;
        let purpose = match self.rules {
            Rules::None => return false,
            Rules::General => self.general(record, nested),
            Rules::Cycles => by_visibility(record),
        };
        record.purpose = purpose as u8;
        match purpose {
            Purpose::Camera => self.depth = Some(0),
            // Cycles follows one path at a time, and a bounce is its next step.
            Purpose::Diffuse | Purpose::Specular if self.rules == Rules::Cycles => {
                self.depth = self.depth.map(|depth| depth.saturating_add(1).min(0xFE));
            }
            _ => {}
        }
        let known = self.rules == Rules::Cycles || purpose == Purpose::Camera;
        // A shadow ray belongs to the bounce that it lights.
        let shadow = u8::from(purpose == Purpose::Shadow);
        if let (true, Some(depth)) = (known, self.depth) {
            record.depth = depth.saturating_add(shadow).min(0xFE);
        }
        // A camera ray that goes on behind something transparent starts nothing.
        let goes_on = self.rules == Rules::Cycles && record.mask & cycles::TRANSPARENT != 0;
        purpose == Purpose::Camera && !goes_on
    }

    fn general(&mut self, record: &Record, nested: bool) -> Purpose {
        if record.is_occlusion() {
            return Purpose::Shadow;
        } else if nested {
            return Purpose::Unknown;
        }
        let eye = *self.eye.get_or_insert(record.origin);
        if eye == record.origin { Purpose::Camera } else { Purpose::Unknown }
    }
}

fn by_visibility(record: &Record) -> Purpose {
    let has = |bits: u32| record.mask & bits != 0;
    // Subsurface scattering asks with all bits.
    if has(cycles::CAMERA) && has(cycles::SHADOW) {
        Purpose::Unknown
    } else if has(cycles::SHADOW) {
        Purpose::Shadow
    } else if has(cycles::CAMERA) {
        Purpose::Camera
    } else if has(cycles::GLOSSY) || (has(cycles::TRANSMIT) && !has(cycles::DIFFUSE)) {
        Purpose::Specular
    } else if has(cycles::DIFFUSE) {
        Purpose::Diffuse
    } else {
        Purpose::Unknown
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::rays::kind;
    use bytemuck::Zeroable;

    fn record(kind: u8, mask: u32, x: f32) -> Record {
        Record { kind, mask, origin: Vec3::new(x, 0.0, 0.0), depth: NO_DEPTH, ..Record::zeroed() }
    }

    fn filled(rules: Rules, records: &[Record]) -> Vec<(Purpose, u8, bool)> {
        let mut guess = Guess::new(rules);
        records
            .iter()
            .map(|&record| {
                let mut record = record;
                let starts = guess.fill(&mut record);
                (Purpose::from_byte(record.purpose), record.depth, starts)
            })
            .collect()
    }

    #[test]
    fn the_first_origin_is_the_eye() {
        let closest = |x| record(kind::CLOSEST_HIT, u32::MAX, x);
        let found = filled(
            Rules::General,
            &[closest(1.0), record(kind::OCCLUSION, 1, 5.0), closest(5.0), closest(1.0)],
        );
        assert_eq!(
            found,
            [
                (Purpose::Camera, 0, true),
                (Purpose::Shadow, NO_DEPTH, false),
                (Purpose::Unknown, NO_DEPTH, false),
                (Purpose::Camera, 0, true)
            ]
        );
    }

    /// A user geometry asks before its thread's first answer.
    #[test]
    fn what_a_callback_asks_is_not_from_the_eye() {
        let closest = |x| record(kind::CLOSEST_HIT, u32::MAX, x);
        let nested = |x| Record { depth: EXCHANGE_NESTED as u8, ..closest(x) };
        let found = filled(Rules::General, &[nested(3.0), closest(1.0), nested(1.0), closest(1.0)]);
        let (camera, unknown) = ((Purpose::Camera, 0, true), (Purpose::Unknown, NO_DEPTH, false));
        assert_eq!(found, [unknown, camera, unknown, camera]);
        assert_eq!(filled(Rules::None, &[nested(1.0)]), [unknown]);
    }

    #[test]
    fn masks_of_cycles() {
        let masks = [1, 0x100, 0xA, 0x200, 0x16, 0x7FF, 0x41];
        let records = masks.map(|mask| record(kind::CLOSEST_HIT, mask, 0.0));
        assert_eq!(
            filled(Rules::Cycles, &records),
            [
                (Purpose::Camera, 0, true),
                (Purpose::Shadow, 1, false),
                (Purpose::Diffuse, 1, false),
                (Purpose::Shadow, 2, false),
                (Purpose::Specular, 2, false),
                (Purpose::Unknown, 2, false),
                (Purpose::Camera, 0, false),
            ]
        );
        assert_eq!(filled(Rules::None, &records)[0], (Purpose::Unknown, NO_DEPTH, false));
    }
}
