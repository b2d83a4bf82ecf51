//! Wavefront MTL: of each material, what decides which rays follow: colour, mirror, emission.
//!
//! `Kd` is the diffuse reflectance, `Ke` the emission. `Ks` is a mirror only under an illumination model that reflects
//! (`illum` 3 to 9); under the others it describes a highlight, for which no ray is asked. Textures and transparency are ignored.
//! The first definition of a name counts.

use super::lines::{self, Sink};
use super::{Kind, Material, Warnings, number};
use crate::geometry::Vec3;
use std::collections::HashMap;
use std::io::{self, Write};

/// Reads a library and adds its materials to `materials` by name; a name that is there keeps its
/// material.
pub fn parse(bytes: &[u8], materials: &mut HashMap<String, Material>, warnings: &mut Warnings) {
    let mut reader = Reader { materials, warnings, current: None };
    lines::from_slice(bytes, &mut reader);
    reader.finish();
}

/// Writes materials as a library that [`parse`] reads back. `names` stands in for the materials' own names.
///
/// # Errors
/// The writer's own.
pub(crate) fn write(materials: &[Material], names: &[String], mut out: impl Write) -> io::Result<()> {
    for (material, name) in materials.iter().zip(names) {
        let Material { diffuse, specular, emission, .. } = material;
        writeln!(out, "newmtl {name}")?;
        writeln!(out, "Kd {} {} {}", diffuse.x, diffuse.y, diffuse.z)?;
        if *specular != Vec3::ZERO {
            writeln!(out, "Ks {} {} {}\nillum 3", specular.x, specular.y, specular.z)?;
        }
        if *emission != Vec3::ZERO {
            writeln!(out, "Ke {} {} {}", emission.x, emission.y, emission.z)?;
        }
    }
    Ok(())
}

/// A name from a file: UTF-8, or else Latin-1, in which every byte is a character.
pub(crate) fn text(bytes: &[u8]) -> String {
    match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(_) => bytes.iter().map(|&byte| char::from(byte)).collect(),
    }
}

struct Reader<'a> {
    materials: &'a mut HashMap<String, Material>,
    warnings: &'a mut Warnings,
    current: Option<Current>,
}

struct Current {
    material: Material,
    highlight: Vec3,
    illumination: u32,
}

impl Sink for Reader<'_> {
    fn line(&mut self, number: u64, line: &[u8]) {
        let line = lines::without_comment(line).trim_ascii();
        let end = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
        let (keyword, rest) = line.split_at(end);
        let rest = rest.trim_ascii();
        if keyword.eq_ignore_ascii_case(b"newmtl") {
            self.finish();
            let material = Material { name: text(rest), ..Material::default() };
            self.current = Some(Current { material, highlight: Vec3::ZERO, illumination: 0 });
            return;
        }
        let Some(current) = &mut self.current else { return };
        let colour = match keyword {
            b"Kd" => &mut current.material.diffuse,
            b"Ke" => &mut current.material.emission,
            b"Ks" => &mut current.highlight,
            b"illum" => {
                match std::str::from_utf8(rest).ok().and_then(|rest| rest.parse().ok()) {
                    Some(model) => current.illumination = model,
                    None => self.warnings.add(Kind::UnreadableMaterial, number),
                }
                return;
            }
            _ => return,
        };
        match read_colour(rest) {
            Some(value) => *colour = value,
            None => self.warnings.add(Kind::UnreadableMaterial, number),
        }
    }

    fn too_long(&mut self, number: u64) {
        self.warnings.add(Kind::UnreadableMaterial, number);
    }
}

impl Reader<'_> {
    fn finish(&mut self) {
        let Some(Current { mut material, highlight, illumination }) = self.current.take() else { return };
        material.diffuse = material.diffuse.clamp(Vec3::ZERO, Vec3::ONE);
        material.emission = material.emission.max(Vec3::ZERO);
        if (3..=9).contains(&illumination) {
            material.specular = highlight.clamp(Vec3::ZERO, Vec3::ONE);
        }
        self.materials.entry(material.name.clone()).or_insert(material);
    }
}

/// One number (grey) or three; finite.
fn read_colour(rest: &[u8]) -> Option<Vec3> {
    let mut values = rest.split(u8::is_ascii_whitespace).filter(|token| !token.is_empty());
    let red = number::parse_f32(values.next()?)?;
    let colour = match values.next() {
        Some(green) => Vec3::new(red, number::parse_f32(green)?, number::parse_f32(values.next()?)?),
        None => Vec3::splat(red),
    };
    colour.is_finite().then_some(colour)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(library: &[u8]) -> (HashMap<String, Material>, Warnings) {
        let (mut materials, mut warnings) = (HashMap::new(), Warnings::default());
        parse(library, &mut materials, &mut warnings);
        (materials, warnings)
    }

    #[test]
    fn the_fields_that_matter() {
        let (materials, warnings) = read(
            b"Kd 1 1 1\r\n  newmtl my light\r\n\tKd 0.5 .25 1e0\r\nKe 17 12 4\nmap_Kd a b.png\nTf 1 1 1\nd 0.5\nKs 1 1 1\nillum 2\n\
              newmtl mirror\nKd 2 -1 0.5\nillum 3\nKs 0.9\nnewmtl plain",
        );
        assert!(warnings.is_empty(), "{warnings}");
        let light = &materials["my light"];
        assert_eq!((light.diffuse, light.emission), (Vec3::new(0.5, 0.25, 1.0), Vec3::new(17.0, 12.0, 4.0)));
        assert_eq!(light.specular, Vec3::ZERO, "a highlight is not a mirror");
        assert_eq!(materials["mirror"].specular, Vec3::splat(0.9));
        assert_eq!(materials["mirror"].diffuse, Vec3::new(1.0, 0.0, 0.5), "clamped");
        assert_eq!(materials["plain"].diffuse, Material::default().diffuse);
        assert_eq!(materials.len(), 3);
    }

    #[test]
    fn comments_end_lines_and_the_first_definition_counts() {
        let (materials, warnings) = read(
            b"newmtl a # main\nKd 1 0 0# red\nKs 1 #grey\nillum 3 # mirror \\\nmap_Kd C:\\a\\\nKe 0,5 1.0D+00 0 # lamp\n\
              newmtl a\nKd 0 1 0\nnewmtl b#1\nillum 3# mirror\nKs \\\n 1 1 \\ \n 1\n",
        );
        assert!(warnings.is_empty(), "{warnings}");
        let a = &materials["a"];
        assert_eq!((a.diffuse, a.specular, a.emission), (Vec3::X, Vec3::ONE, Vec3::new(0.5, 1.0, 0.0)));
        assert_eq!(materials["b#1"].specular, Vec3::ONE);
        assert_eq!(materials.len(), 2);
    }

    #[test]
    fn what_is_no_number_is_counted_and_leaves_the_default() {
        let (materials, warnings) = read(b"newmtl a\nKd spectral x.rfl\nKe nan 0 0\nillum x\nKd 1 2\n");
        assert_eq!(warnings.count(Kind::UnreadableMaterial), 4);
        assert_eq!(warnings.first_line(Kind::UnreadableMaterial), Some(2));
        assert_eq!(materials["a"], Material { name: "a".to_owned(), ..Material::default() });
    }
}
