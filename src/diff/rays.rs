//! Two traces, query by query in file order, whatever their chunks and codecs.

use super::{DiffError, First, Report, Tolerance, Value};
use crate::format::FormatError;
use crate::format::rays::{Chunk, NO_DEPTH, NO_PATH, Purpose, Rays, Record, Reject, flag};
use crate::progress::Progress;

/// Bits of [`Record::flags`] that have a meaning; a reader ignores the others.
const KNOWN_FLAGS: u8 = flag::HIT | flag::COHERENT | flag::HAS_REJECTS | flag::UNDECIDED | flag::INTERRUPTED;

/// Compares two files. What counts: the fields of every record, its rejects and its scene, and the scene fingerprint where both know
/// it and no tolerance allows for other geometry. What is noted: Embree's version, the promise of an order, a file that was cut off.
/// What is ignored: producer, thread, sequence number, chunks and codecs.
pub(super) fn compare(
    a: &[u8],
    b: &[u8],
    tolerance: Tolerance,
    progress: &Progress,
) -> Result<Report, DiffError> {
    let rays_a = Rays::parse(a).map_err(DiffError::A)?;
    let rays_b = Rays::parse(b).map_err(DiffError::B)?;
    let (count_a, count_b) = (rays_a.query_count(), rays_b.query_count());
    let mut report = Report { unit: "queries", count_a, count_b, ..Report::default() };
    compare_headers(&rays_a, &rays_b, tolerance, &mut report);

    let (mut a, mut b) = (Cursor::new(&rays_a), Cursor::new(&rays_b));
    loop {
        // Both files decode their next chunk at the same time.
        let (more_a, more_b) = rayon::join(|| a.fill(), || b.fill());
        if !(more_a.map_err(DiffError::A)? && more_b.map_err(DiffError::B)?) {
            break;
        }
        let length = a.left().min(b.left());
        let number = a.number;
        let part_a = a.take(length);
        let part_b = b.take(length);
        compare_parts(part_a, part_b, number, tolerance, &mut report);
        progress.advance(length as u64);
    }
    // What only the longer file has is read, too: damage there is no smaller an error.
    while a.fill().map_err(DiffError::A)? {
        a.take(a.left());
    }
    while b.fill().map_err(DiffError::B)? {
        b.take(b.left());
    }
    report.differ_in_length("queries", count_a, count_b);
    Ok(report)
}

fn compare_headers(a: &Rays, b: &Rays, tolerance: Tolerance, report: &mut Report) {
    let (header_a, header_b) = (&a.header, &b.header);
    let fingerprint = |value: u64| format!("{value:016x}");
    let (known_a, known_b) = (header_a.fingerprint, header_b.fingerprint);
    if known_a != known_b {
        let value = Value::new("scene fingerprint", fingerprint(known_a), fingerprint(known_b));
        if known_a != 0 && known_b != 0 && tolerance == Tolerance::Exact {
            report.differ(&["fingerprint"], || First { element: "header".into(), values: vec![value] });
        } else {
            report.notes.push(value);
        }
    }
    report.note("Embree version", header_a.embree_version, header_b.embree_version);
    report.note("order does not depend on threads", header_a.deterministic, header_b.deterministic);
    report.note("recording was cut off", a.recovery.is_some(), b.recovery.is_some());
}

/// Some records of one chunk, with their rejects.
struct Part<'c> {
    scene: u16,
    records: &'c [Record],
    rejects: &'c [Reject],
    /// Number in the chunk of the first record, which rejects count from.
    start: usize,
}

/// Where reading of one file has come to.
struct Cursor<'r, 'a> {
    rays: &'r Rays<'a>,
    chunk: Option<Chunk<'a>>,
    next_chunk: usize,
    /// Records and rejects of `chunk` that have been taken.
    records: usize,
    rejects: usize,
    /// Records of the file that have been taken.
    number: u64,
}

impl<'r, 'a> Cursor<'r, 'a> {
    fn new(rays: &'r Rays<'a>) -> Cursor<'r, 'a> {
        Cursor { rays, chunk: None, next_chunk: 0, records: 0, rejects: 0, number: 0 }
    }

    fn left(&self) -> usize {
        self.chunk.as_ref().map_or(0, |chunk| chunk.records.len() - self.records)
    }

    /// Makes sure that there are records left, unless the file has ended.
    fn fill(&mut self) -> Result<bool, FormatError> {
        while self.left() == 0 {
            if self.next_chunk == self.rays.chunks().len() {
                return Ok(false);
            }
            self.chunk = Some(self.rays.chunk(self.next_chunk)?);
            self.next_chunk += 1;
            (self.records, self.rejects) = (0, 0);
        }
        Ok(true)
    }

    fn take(&mut self, count: usize) -> Part<'_> {
        let Some(chunk) = &self.chunk else {
            return Part { scene: 0, records: &[], rejects: &[], start: 0 };
        };
        let start = self.records;
        let records = &chunk.records[start..start + count];
        let rejects = &chunk.rejects[self.rejects..];
        let rejects = &rejects[..rejects.partition_point(|reject| (reject.record as usize) < start + count)];
        self.records += count;
        self.rejects += rejects.len();
        self.number += count as u64;
        Part { scene: chunk.info.scene, records, rejects, start }
    }
}

impl Part<'_> {
    /// The triangles that were rejected for a record, and removes them from the part.
    fn next_rejects(&mut self, record: usize) -> &[Reject] {
        let end = self.rejects.partition_point(|reject| reject.record as usize <= self.start + record);
        let (these, rest) = self.rejects.split_at(end);
        self.rejects = rest;
        these
    }
}

fn compare_parts(mut a: Part, mut b: Part, number: u64, tolerance: Tolerance, report: &mut Report) {
    let same_rejects = a.rejects.is_empty() && b.rejects.is_empty();
    let same_bytes = || bytemuck::cast_slice::<_, u8>(a.records) == bytemuck::cast_slice::<_, u8>(b.records);
    if a.scene == b.scene && same_rejects && same_bytes() {
        return;
    }
    let mut values = Vec::new();
    for (index, (record_a, record_b)) in a.records.iter().zip(b.records).enumerate() {
        values.clear();
        if bytemuck::bytes_of(record_a) != bytemuck::bytes_of(record_b) {
            compare_records(record_a, record_b, tolerance, &mut values);
        }
        if a.scene != b.scene {
            values.push(("scene", a.scene.to_string(), b.scene.to_string()));
        }
        let rejects_a = a.next_rejects(index);
        let rejects_b = b.next_rejects(index);
        if !rejects_a.iter().map(|reject| reject.triangle).eq(rejects_b.iter().map(|reject| reject.triangle))
        {
            let text = |rejects: &[Reject]| match rejects {
                [] => "none".to_string(),
                [first, ..] => format!("{}, first triangle {}", rejects.len(), first.triangle),
            };
            values.push(("rejects", text(rejects_a), text(rejects_b)));
        }
        if values.is_empty() {
            continue;
        }
        let names: Vec<&'static str> = values.iter().map(|(name, _, _)| *name).collect();
        report.differ(&names, || First {
            element: describe(number + index as u64, record_a),
            values: values.iter().map(|(name, a, b)| Value::new(name, a, b)).collect(),
        });
    }
}

type Difference = (&'static str, String, String);

fn compare_records(a: &Record, b: &Record, tolerance: Tolerance, values: &mut Vec<Difference>) {
    for (name, a, b) in [("origin", a.origin, b.origin), ("direction", a.direction, b.direction)] {
        if !tolerance.equal_vectors(a, b) {
            values.push((name, format!("{:?}", a.to_array()), format!("{:?}", b.to_array())));
        }
    }
    let floats = [
        ("tnear", a.tnear, b.tnear, 0.0),
        ("tfar", a.tfar, b.tfar, 0.0),
        ("time", a.time, b.time, 0.0),
        ("t", a.t, b.t, 0.0),
        // Barycentric coordinates are parts of 1, which is what an error in them is measured by.
        ("u", a.u, b.u, 1.0),
        ("v", a.v, b.v, 1.0),
    ];
    for (name, a, b, magnitude) in floats {
        if !tolerance.equal(a, b, magnitude) {
            values.push((name, format!("{a:?}"), format!("{b:?}")));
        }
    }
    let integers = [
        ("mask", a.mask, b.mask),
        ("triangle", a.triangle, b.triangle),
        ("path", a.path, b.path),
        ("kind", a.kind.into(), b.kind.into()),
        ("depth", a.depth.into(), b.depth.into()),
        ("flags", (a.flags & KNOWN_FLAGS).into(), (b.flags & KNOWN_FLAGS).into()),
        ("purpose", a.purpose.into(), b.purpose.into()),
    ];
    for (name, a, b) in integers {
        if a != b {
            values.push((name, a.to_string(), b.to_string()));
        }
    }
}

fn describe(number: u64, record: &Record) -> String {
    let pixel = if record.path == NO_PATH { "unknown".to_string() } else { record.path.to_string() };
    let depth = if record.depth == NO_DEPTH { "unknown".to_string() } else { record.depth.to_string() };
    let kind = if record.is_occlusion() { "occlusion" } else { "closest hit" };
    let purpose = Purpose::from_byte(record.purpose).name();
    format!("query {number}, {kind}, pixel {pixel}, depth {depth}, purpose {purpose}")
}
