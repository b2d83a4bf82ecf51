//! A committed scene of the recorded program, as its file says (`embree-shim/exchange.h`). The file comes from a process that
//! we do not control: every number is checked.

use crate::embree::ffi::{
    self, EXCHANGE_INSTANCE, EXCHANGE_INSTANCED, EXCHANGE_MAGIC, EXCHANGE_OTHER, EXCHANGE_QUADS,
    EXCHANGE_TRIANGLES, ExchangePart, ExchangeScene,
};
use crate::geometry::Triangle;
use crate::tree::Node;
use std::fs;
use std::path::Path;
use thiserror::Error;

/// A file that is not what the preload library writes, or cannot be read.
#[derive(Debug, Error)]
#[error("the program's scene {number} cannot be read: {problem}")]
pub struct CaptureError {
    pub number: u32,
    pub problem: String,
}

/// What is attached under a geomID.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    Triangles,
    Quads,
    /// An instance of another capture: 3 x 4, row by row.
    Instance {
        capture: u32,
        transform: [[f32; 4]; 3],
    },
    /// Left out: RTCGeometryType.
    Other {
        geometry_type: u32,
    },
}

/// One attached geometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    pub geometry: u32,
    pub kind: Kind,
    /// It has several time steps. Triangles or transform are those of the first one, and Embree's tree does not have it.
    pub moving: bool,
    pub mask: u32,
    /// In the flattened numbering.
    pub first_triangle: u32,
    pub triangle_count: u32,
}

/// A committed scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// Which of the program's scenes, and its how many-th commit, from 0.
    pub scene: u32,
    pub commit: u32,
    pub parts: Vec<Part>,
    /// Embree's tree; empty when it could not be read.
    pub nodes: Vec<Node>,
    /// With [`INSTANCE`] set: the geomID of an instance; else a triangle, in the flattened numbering.
    pub primitives: Vec<u32>,
    /// Of the parts that are no instances, in their order.
    pub triangles: Vec<Triangle>,
    /// With those of the instances.
    pub flattened_count: u32,
    pub splits: bool,
    /// Geometries that are left out, also in instances.
    pub others: u32,
    pub producer: String,
    /// Why there is no tree.
    pub doubt: String,
}

/// Set in an entry of [`Capture::primitives`] that names an instance.
pub const INSTANCE: u32 = EXCHANGE_INSTANCE;

impl Capture {
    /// Reads the file of capture `number`.
    ///
    /// # Errors
    /// When it cannot be read, or is not as it should be.
    pub fn read(directory: &Path, number: u32) -> Result<Capture, CaptureError> {
        let error = |problem: String| CaptureError { number, problem };
        let bytes = fs::read(directory.join(format!("{number}.scene"))).map_err(|e| error(e.to_string()))?;
        Capture::parse(&bytes).map_err(|problem| error(problem.to_owned()))
    }

    fn parse(bytes: &[u8]) -> Result<Capture, &'static str> {
        const SHORT: &str = "it is too short";
        let (header, rest) = bytes.split_at_checked(size_of::<ExchangeScene>()).ok_or(SHORT)?;
        // SAFETY: as many bytes as the struct has; it holds numbers and letters only, so any bytes are one.
        let header: ExchangeScene = unsafe { std::ptr::read_unaligned(header.as_ptr().cast()) };
        if header.magic != EXCHANGE_MAGIC {
            return Err("it is of another version of embree-trace");
        }
        let section = |rest: &mut &[u8], count: u64, element: usize| -> Result<Vec<u8>, &'static str> {
            let length = usize::try_from(count).ok().and_then(|count| count.checked_mul(element));
            let (taken, left) = length.and_then(|length| rest.split_at_checked(length)).ok_or(SHORT)?;
            *rest = left;
            Ok(taken.to_vec())
        };
        let mut rest = rest;
        let parts = section(&mut rest, header.part_count, size_of::<ExchangePart>())?;
        let nodes = section(&mut rest, header.node_count, size_of::<Node>())?;
        let primitives = section(&mut rest, header.primitive_count, 4)?;
        let triangles = section(&mut rest, header.triangle_count, size_of::<Triangle>())?;
        if !rest.is_empty() {
            return Err("it is too long");
        }
        let capture = Capture {
            scene: header.scene,
            commit: header.commit,
            parts: parts.chunks_exact(size_of::<ExchangePart>()).map(part).collect::<Result<_, _>>()?,
            nodes: bytemuck::pod_collect_to_vec(&nodes),
            primitives: bytemuck::pod_collect_to_vec(&primitives),
            triangles: bytemuck::pod_collect_to_vec(&triangles),
            flattened_count: u32::try_from(header.flattened_count)
                .map_err(|_| "it has too many triangles")?,
            splits: header.splits != 0,
            others: header.others,
            producer: ffi::text(&header.producer),
            doubt: ffi::text(&header.doubt),
        };
        capture.check()?;
        Ok(capture)
    }

    /// That following any number of it stays inside.
    fn check(&self) -> Result<(), &'static str> {
        let (mut next, mut own) = (0u32, 0usize);
        for part in &self.parts {
            if part.first_triangle != next {
                return Err("its geometries do not follow each other");
            }
            next = next.checked_add(part.triangle_count).ok_or("it has too many triangles")?;
            match part.kind {
                Kind::Triangles | Kind::Quads => own += part.triangle_count as usize,
                Kind::Instance { .. } => {}
                Kind::Other { .. } if part.triangle_count == 0 => {}
                Kind::Other { .. } => return Err("a geometry without triangles has some"),
            }
        }
        if next != self.flattened_count || own != self.triangles.len() {
            return Err("its geometries' triangles are not as many as it says");
        }
        let mut has_parent = vec![false; self.nodes.len()];
        for (index, node) in self.nodes.iter().enumerate() {
            let range = node.range();
            if node.is_leaf() {
                if range.end > self.primitives.len() {
                    return Err("a leaf leads outside of its tree");
                }
                continue;
            }
            if range.is_empty() || range.start <= index || range.end > self.nodes.len() {
                return Err("a node leads outside of its tree");
            }
            if has_parent[range.clone()].iter().any(|&has| has) {
                return Err("a node has two parents");
            }
            has_parent[range].fill(true);
        }
        let inside = |entry: &u32| entry & INSTANCE != 0 || *entry < self.flattened_count;
        if !self.primitives.iter().all(inside) {
            return Err("a leaf names a triangle that does not exist");
        }
        Ok(())
    }

    /// Whether there is a tree.
    pub fn has_tree(&self) -> bool {
        !self.nodes.is_empty()
    }
}

fn part(bytes: &[u8]) -> Result<Part, &'static str> {
    // SAFETY: the caller gives as many bytes as the struct has; it holds numbers only.
    let part: ExchangePart = unsafe { std::ptr::read_unaligned(bytes.as_ptr().cast()) };
    let kind = match part.kind {
        EXCHANGE_TRIANGLES => Kind::Triangles,
        EXCHANGE_QUADS => Kind::Quads,
        EXCHANGE_INSTANCED => {
            let [a, b, c, d, e, f, g, h, i, j, k, l] = part.transform;
            Kind::Instance { capture: part.capture, transform: [[a, b, c, d], [e, f, g, h], [i, j, k, l]] }
        }
        EXCHANGE_OTHER => Kind::Other { geometry_type: part.type_ },
        _ => return Err("a geometry has an unknown kind"),
    };
    Ok(Part {
        geometry: part.geometry,
        kind,
        moving: part.moving != 0,
        mask: part.mask,
        first_triangle: part.first_triangle,
        triangle_count: part.triangle_count,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bytes of a struct that holds numbers only.
    fn bytes<T>(value: &T) -> Vec<u8> {
        // SAFETY: both structs of the exchange consist of numbers without gaps, so every byte is set.
        unsafe { std::slice::from_raw_parts((&raw const *value).cast(), size_of::<T>()).to_vec() }
    }

    fn header() -> ExchangeScene {
        // SAFETY: numbers only, for which zero is one.
        let mut header: ExchangeScene = unsafe { std::mem::zeroed() };
        header.magic = EXCHANGE_MAGIC;
        (header.part_count, header.node_count, header.primitive_count) = (2, 3, 3);
        (header.triangle_count, header.flattened_count) = (2, 3);
        header
    }

    fn parts() -> [ExchangePart; 2] {
        // SAFETY: as above.
        let mut parts: [ExchangePart; 2] = unsafe { std::mem::zeroed() };
        (parts[0].kind, parts[0].triangle_count) = (EXCHANGE_QUADS, 2);
        (parts[1].kind, parts[1].geometry, parts[1].first_triangle, parts[1].triangle_count) =
            (EXCHANGE_INSTANCED, 4, 2, 1);
        parts
    }

    fn file(
        header: &ExchangeScene,
        parts: &[ExchangePart],
        nodes: [Node; 3],
        primitives: [u32; 3],
    ) -> Vec<u8> {
        let mut file = bytes(header);
        parts.iter().for_each(|part| file.extend(bytes(part)));
        file.extend_from_slice(bytemuck::bytes_of(&nodes));
        file.extend_from_slice(bytemuck::bytes_of(&primitives));
        file.extend_from_slice(&[0; 2 * size_of::<Triangle>()]);
        file
    }

    fn nodes() -> [Node; 3] {
        let bounds = crate::geometry::Aabb::EMPTY;
        [Node::inner(bounds, 1, 2), Node::leaf(bounds, 0, 2), Node::leaf(bounds, 2, 1)]
    }

    #[test]
    fn a_file_is_read() {
        let capture = Capture::parse(&file(&header(), &parts(), nodes(), [0, 1, INSTANCE | 4])).unwrap();
        assert_eq!((capture.triangles.len(), capture.flattened_count), (2, 3));
        assert!(matches!(capture.parts[1].kind, Kind::Instance { .. }) && capture.has_tree());
    }

    /// What a file is made of.
    struct Whole {
        header: ExchangeScene,
        parts: [ExchangePart; 2],
        nodes: [Node; 3],
        primitives: [u32; 3],
    }

    /// Nothing that a broken program could leave is followed.
    #[test]
    fn bad_files_are_refused() {
        let good = file(&header(), &parts(), nodes(), [0, 1, INSTANCE | 4]);
        for length in 0..good.len() {
            assert!(Capture::parse(&good[..length]).is_err());
        }
        let refused = |change: &dyn Fn(&mut Whole)| {
            let (header, parts, nodes) = (header(), parts(), nodes());
            let mut whole = Whole { header, parts, nodes, primitives: [0, 1, INSTANCE | 4] };
            change(&mut whole);
            let Whole { header, parts, nodes, primitives } = whole;
            Capture::parse(&file(&header, &parts, nodes, primitives)).unwrap_err()
        };
        assert!(refused(&|whole| whole.header.magic += 1).contains("another version"));
        assert!(refused(&|whole| whole.header.node_count = u64::MAX / 2).contains("short"));
        assert!(refused(&|whole| whole.header.flattened_count = 4).contains("not as many"));
        assert!(refused(&|whole| whole.parts[1].kind = 9).contains("unknown kind"));
        assert!(refused(&|whole| whole.parts[1].first_triangle = 1).contains("do not follow"));
        assert!(refused(&|whole| whole.parts[1].triangle_count = u32::MAX).contains("too many"));
        assert!(refused(&|whole| whole.nodes[0].first = 0).contains("outside"));
        assert!(refused(&|whole| whole.nodes[0].first = 2).contains("outside"));
        assert!(refused(&|whole| whole.nodes[2].first = 3).contains("outside"));
        assert!(
            refused(&|whole| whole.nodes[1] = Node { first: 2, count: 1, ..whole.nodes[0] })
                .contains("two parents")
        );
        assert!(refused(&|whole| whole.primitives[0] = 3).contains("does not exist"));
    }
}
