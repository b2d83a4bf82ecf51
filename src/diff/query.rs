//! Two queries that answer to each other: which of their values differ, and whether that is a tie.

use super::report::{First, Value};
use super::tie::Ties;
use super::{Options, Tolerance};
use crate::format::rays::{NO_DEPTH, NO_PATH, Purpose, Record, Reject, flag};
use crate::replay::pixels::ImageSize;
use std::hash::Hasher;
use twox_hash::XxHash3_64;

/// Bits of [`Record::flags`] that count by themselves. Others have no meaning yet, or are told by the hit and the rejects.
pub(super) const COUNTED_FLAGS: u8 = flag::COHERENT | flag::UNDECIDED | flag::INTERRUPTED;

/// A query of one file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Query<'a> {
    /// Of the query in its file.
    pub(super) number: u64,
    pub(super) scene: u16,
    pub(super) record: &'a Record,
    pub(super) rejects: &'a [Reject],
}

/// A query that is kept while its file is read on.
#[derive(Clone, Debug)]
pub(super) struct Kept {
    pub(super) number: u64,
    pub(super) scene: u16,
    pub(super) record: Record,
    pub(super) rejects: Box<[Reject]>,
}

impl Kept {
    pub(super) fn query(&self) -> Query<'_> {
        Query { number: self.number, scene: self.scene, record: &self.record, rejects: &self.rejects }
    }
}

/// Why a query was asked, apart from its ray: what queries are paired by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) struct Key {
    depth: u8,
    kind: u8,
    purpose: u8,
}

/// How two queries compare.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Relation {
    Same,
    /// The same but for the triangle, and two are hit at one t.
    Tie,
    Changed(Fields),
}

/// A set of values of a query, by their place in [`FIELDS`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Fields(u32);

/// A value's name, and its text.
type Field = (&'static str, fn(&Query) -> String);

const FIELDS: [Field; 18] = [
    ("origin", |query| format!("{:?}", query.record.origin.to_array())),
    ("direction", |query| format!("{:?}", query.record.direction.to_array())),
    ("tnear", |query| format!("{:?}", query.record.tnear)),
    ("tfar", |query| format!("{:?}", query.record.tfar)),
    ("time", |query| format!("{:?}", query.record.time)),
    ("mask", |query| format!("{:#x}", query.record.mask)),
    ("path", |query| query.record.path.to_string()),
    ("kind", |query| kind_name(query.record).to_string()),
    ("depth", |query| query.record.depth.to_string()),
    ("purpose", |query| Purpose::from_byte(query.record.purpose).name().to_string()),
    ("scene", |query| query.scene.to_string()),
    ("flags", |query| format!("{:#x}", query.record.flags & COUNTED_FLAGS)),
    ("rejects", |query| match query.rejects {
        [] => "none".to_string(),
        [first, ..] => format!("{}, first triangle {}", query.rejects.len(), first.triangle),
    }),
    ("hit", |query| answer(query.record)),
    ("t", |query| format!("{:?}", query.record.t)),
    ("triangle", |query| query.record.triangle.to_string()),
    ("u", |query| format!("{:?}", query.record.u)),
    ("v", |query| format!("{:?}", query.record.v)),
];

impl Fields {
    const ORIGIN: Fields = Fields(1);
    const DIRECTION: Fields = Fields(1 << 1);
    const TNEAR: Fields = Fields(1 << 2);
    const TFAR: Fields = Fields(1 << 3);
    const TIME: Fields = Fields(1 << 4);
    const MASK: Fields = Fields(1 << 5);
    const PATH: Fields = Fields(1 << 6);
    const KIND: Fields = Fields(1 << 7);
    const DEPTH: Fields = Fields(1 << 8);
    const PURPOSE: Fields = Fields(1 << 9);
    const SCENE: Fields = Fields(1 << 10);
    const FLAGS: Fields = Fields(1 << 11);
    const REJECTS: Fields = Fields(1 << 12);
    const HIT: Fields = Fields(1 << 13);
    const T: Fields = Fields(1 << 14);
    const TRIANGLE: Fields = Fields(1 << 15);
    const U: Fields = Fields(1 << 16);
    const V: Fields = Fields(1 << 17);
    /// What two triangles at one t differ in.
    const OF_A_TIE: Fields = Fields(Fields::TRIANGLE.0 | Fields::U.0 | Fields::V.0);

    /// The other one where `differs`.
    fn add(&mut self, field: Fields, differs: bool) {
        if differs {
            self.0 |= field.0;
        }
    }

    fn contains(self, field: Fields) -> bool {
        self.0 & field.0 != 0
    }

    fn named(self) -> impl Iterator<Item = Field> {
        let is_in = move |(place, field): (usize, Field)| (self.0 >> place & 1 != 0).then_some(field);
        FIELDS.into_iter().enumerate().filter_map(is_in)
    }

    pub(super) fn names(self) -> Vec<&'static str> {
        self.named().map(|(name, _)| name).collect()
    }

    /// The values of both queries.
    pub(super) fn values(self, a: &Query, b: &Query) -> Vec<Value> {
        self.named().map(|(name, text)| Value::new(name, text(a), text(b))).collect()
    }
}

/// Decides how queries compare.
pub(super) struct Judge<'o> {
    questions: Tolerance,
    pub(super) answers: Tolerance,
    ties: Ties<'o>,
}

impl<'o> Judge<'o> {
    pub(super) fn new(options: &Options<'o>) -> Judge<'o> {
        Judge { questions: options.questions, answers: options.answers, ties: Ties::new(options.trees) }
    }

    /// Whether two queries are one by what they ask: the same ray for the same purpose, whatever its interval and mask.
    pub(super) fn same_question(&self, a: &Query, b: &Query) -> bool {
        let (a, b) = (a.record, b.record);
        (a.path, key(a)) == (b.path, key(b))
            && self.questions.equal_vectors(a.origin, b.origin)
            && self.questions.equal_vectors(a.direction, b.direction)
    }

    pub(super) fn agree(&self, a: &Query, b: &Query) -> bool {
        self.same_question(a, b) && !matches!(self.compare(a, b), Relation::Changed(_))
    }

    pub(super) fn compare(&self, a: &Query, b: &Query) -> Relation {
        let mut fields = self.questions_differ(a, b);
        let (one, other) = (a.record, b.record);
        fields.add(Fields::HIT, one.is_hit() != other.is_hit());
        if !fields.contains(Fields::HIT) {
            let answers = self.answers;
            fields.add(Fields::T, !answers.equal(one.t, other.t, 0.0));
            fields.add(Fields::TRIANGLE, one.triangle != other.triangle);
            // Barycentric coordinates are parts of 1, which is what an error in them is measured by.
            fields.add(Fields::U, !answers.equal(one.u, other.u, 1.0));
            fields.add(Fields::V, !answers.equal(one.v, other.v, 1.0));
        }
        if fields == Fields::default() {
            return Relation::Same;
        }
        // Exactly, one triangle is right, and not the other.
        let can_tie = self.answers != Tolerance::Exact && one.is_hit() && !one.is_occlusion();
        let only_triangle = fields.contains(Fields::TRIANGLE) && fields.0 & !Fields::OF_A_TIE.0 == 0;
        if can_tie && only_triangle && self.ties.are_at_one_t(a, b) {
            return Relation::Tie;
        }
        Relation::Changed(fields)
    }

    fn questions_differ(&self, a: &Query, b: &Query) -> Fields {
        let questions = self.questions;
        let mut fields = Fields::default();
        let (one, other) = (a.record, b.record);
        fields.add(Fields::ORIGIN, !questions.equal_vectors(one.origin, other.origin));
        fields.add(Fields::DIRECTION, !questions.equal_vectors(one.direction, other.direction));
        fields.add(Fields::TNEAR, !questions.equal(one.tnear, other.tnear, 0.0));
        fields.add(Fields::TFAR, !questions.equal(one.tfar, other.tfar, 0.0));
        fields.add(Fields::TIME, !questions.equal(one.time, other.time, 0.0));
        fields.add(Fields::MASK, one.mask != other.mask);
        fields.add(Fields::PATH, one.path != other.path);
        fields.add(Fields::KIND, one.kind != other.kind);
        fields.add(Fields::DEPTH, one.depth != other.depth);
        fields.add(Fields::PURPOSE, one.purpose != other.purpose);
        fields.add(Fields::SCENE, a.scene != b.scene);
        fields.add(Fields::FLAGS, (one.flags ^ other.flags) & COUNTED_FLAGS != 0);
        let triangles = |reject: &Reject| reject.triangle;
        let same_rejects = a.rejects.iter().map(triangles).eq(b.rejects.iter().map(triangles));
        fields.add(Fields::REJECTS, !same_rejects);
        fields
    }

    /// How likely two queries of one path are one in both files: 0 when not at all, else the more the likelier.
    pub(super) fn likeness(&self, a: &Query, b: &Query) -> u32 {
        let (one, other) = (a.record, b.record);
        if key(one) != key(other) {
            return 0;
        }
        if self.same_question(a, b) {
            return if self.agree(a, b) { 24 } else { 16 };
        }
        let near = Tolerance::Relative(1e-2);
        let likes = [
            near.equal_vectors(one.origin, other.origin),
            near.equal_vectors(one.direction, other.direction),
            one.is_hit() == other.is_hit(),
        ];
        4 + likes.into_iter().map(u32::from).sum::<u32>()
    }

    /// A triangle that a tree which was given does not have, when one was asked for.
    pub(super) fn finish(self) -> Result<(), super::TreesError> {
        self.ties.finish()
    }
}

pub(super) fn key(record: &Record) -> Key {
    Key { depth: record.depth, kind: record.kind, purpose: record.purpose }
}

/// A hash of the bits of the ray, and of why it was asked.
pub(super) fn question_hash(record: &Record) -> u64 {
    let mut hasher = XxHash3_64::new();
    hasher.write(bytemuck::bytes_of(&[record.origin, record.direction]));
    hasher.write(bytemuck::bytes_of(&record.path));
    hasher.write(&[record.depth, record.kind, record.purpose]);
    hasher.finish()
}

/// A hash of the bits of the ray alone.
pub(super) fn ray_hash(record: &Record) -> u64 {
    XxHash3_64::oneshot(bytemuck::bytes_of(&[record.origin, record.direction]))
}

/// The query as one line says it; `None` of the depth where it is not known.
pub(super) fn describe(query: &Query, image: Option<ImageSize>) -> String {
    let record = query.record;
    let pixel = match image.and_then(|image| image.pixel(record.path)) {
        _ if record.path == NO_PATH => "unknown".to_string(),
        Some((x, y)) => format!("{x},{y}"),
        None => record.path.to_string(),
    };
    let depth = known_depth(record).map_or("unknown".to_string(), |depth| depth.to_string());
    let purpose = Purpose::from_byte(record.purpose).name();
    let (number, kind) = (query.number, kind_name(record));
    format!("query {number}, {kind}, pixel {pixel}, depth {depth}, purpose {purpose}")
}

/// The first difference, of a query that only one file has.
pub(super) fn unpaired(query: &Query, only: &'static str, image: Option<ImageSize>) -> First {
    let ray = format!(
        "origin {:?}, direction {:?}",
        query.record.origin.to_array(),
        query.record.direction.to_array()
    );
    let none = || "nothing".to_string();
    let (a, b) = if only == "A" { (ray, none()) } else { (none(), ray) };
    First {
        element: format!("{}, only in {only}", describe(query, image)),
        values: vec![Value { name: "query".into(), a, b }],
    }
}

pub(super) fn known_depth(record: &Record) -> Option<u8> {
    (record.depth != NO_DEPTH).then_some(record.depth)
}

fn kind_name(record: &Record) -> &'static str {
    if record.is_occlusion() { "occlusion" } else { "closest hit" }
}

fn answer(record: &Record) -> String {
    match (record.is_occlusion(), record.is_hit()) {
        (true, true) => "occluded".to_string(),
        (true, false) => "not occluded".to_string(),
        (false, true) => format!("triangle {} at t {:?}", record.triangle, record.t),
        (false, false) => "a miss".to_string(),
    }
}
