//! The summary of a `.rays`: header, chunks, queries by every property, histograms.
//!
//! Each chunk is counted into a `Counts` on some thread; counts are integers, so their sum does not depend on threads.

use super::histogram::{Bin, Histogram, PowersOfTwo, by_number};
use super::text::{self, grouped, percent};
use crate::format::FormatError;
use crate::format::rays::{Codec, NO_DEPTH, Purpose, Rays, Record, Recovery, flag, kind};
use crate::progress::Progress;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;
use std::fmt::{self, Formatter};

/// Groups of one property that the text shows; JSON has them all.
const SHOWN_GROUPS: usize = 24;

/// A length this close to 1 is that of a normalised direction.
const UNIT_LENGTH_TOLERANCE: f32 = 1e-5;

/// Queries that share a property.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    pub queries: u64,
    pub hits: u64,
    /// Queries that the program marked as coherent.
    pub coherent: u64,
    /// Queries of which a filter rejected a candidate.
    pub with_rejects: u64,
}

impl Tally {
    fn add(&mut self, record: &Record) {
        let is = |bit: u8| u64::from(record.flags & bit != 0);
        self.queries += 1;
        self.hits += is(flag::HIT);
        self.coherent += is(flag::COHERENT);
        self.with_rejects += is(flag::HAS_REJECTS);
    }

    fn merge(&mut self, other: &Tally) {
        self.queries += other.queries;
        self.hits += other.hits;
        self.coherent += other.coherent;
        self.with_rejects += other.with_rejects;
    }

    /// Hits per query, 0 to 1.
    pub fn hit_rate(&self) -> f64 {
        percent(self.hits, self.queries) / 100.0
    }
}

impl Serialize for Tally {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeStruct;
        let mut fields = serializer.serialize_struct("Tally", 5)?;
        fields.serialize_field("queries", &self.queries)?;
        fields.serialize_field("hits", &self.hits)?;
        fields.serialize_field("hit_rate", &self.hit_rate())?;
        fields.serialize_field("coherent", &self.coherent)?;
        fields.serialize_field("with_rejects", &self.with_rejects)?;
        fields.end()
    }
}

/// Tallies by the values of one property, in the property's own order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Groups(pub Vec<(String, Tally)>);

impl Serialize for Groups {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(name, tally)| (name, tally)))
    }
}

/// How the queries are stored.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Chunks {
    pub count: u64,
    pub raw: u64,
    pub compressed: u64,
    /// Bytes of all bodies in the file, and once decoded.
    pub stored_bytes: u64,
    pub decoded_bytes: u64,
    /// Decoded bytes per stored byte; 1 when nothing is stored.
    pub compression_ratio: f64,
    pub fewest_records: u32,
    pub most_records: u32,
}

/// What a cut-off file still held.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Recovered {
    pub queries: u64,
    pub lost_bytes: u64,
}

/// Everything that is shown of a `.rays`.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// 16 hexadecimal digits; zeros when unknown, or when the queries are of several scenes.
    pub fingerprint: String,
    pub embree_version: u32,
    pub deterministic: bool,
    pub producer: String,
    pub file_bytes: u64,
    /// Whether the checks of `--verify` were made (and held, or there would be no summary).
    pub verified: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recovery: Option<Recovered>,
    pub queries: u64,
    #[serde(flatten)]
    pub total: TotalShares,
    /// Candidate hits that filters refused, and the most of one query.
    pub rejects: u64,
    pub most_rejects: u32,
    /// Hits that triangles cannot decide: of something that is none, or that moves.
    pub undecided: u64,
    pub chunks: Chunks,
    pub by_kind: Groups,
    pub by_purpose: Groups,
    pub by_depth: Groups,
    pub by_scene: Groups,
    pub by_thread: Groups,
    pub histograms: Vec<Histogram>,
}

/// What holds for all queries together, beside their number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TotalShares {
    pub hits: u64,
    pub hit_rate: f64,
    pub coherent: u64,
    pub with_rejects: u64,
}

/// The counts of some of the chunks.
struct Counts {
    by_kind: [Tally; 2],
    by_purpose: [Tally; Purpose::ALL.len()],
    by_depth: Box<[Tally; 256]>,
    by_scene: BTreeMap<u16, Tally>,
    by_thread: BTreeMap<u32, Tally>,
    rejects: u64,
    most_rejects: u32,
    undecided: u64,
    /// Directions of length 1 up to rounding, and the lengths of the others.
    normalised: u64,
    direction: PowersOfTwo,
    segment: PowersOfTwo,
    hit_t: PowersOfTwo,
    reject_counts: [u64; 33],
}

impl Counts {
    fn new() -> Counts {
        Counts {
            by_kind: Default::default(),
            by_purpose: Default::default(),
            by_depth: Box::new([Tally::default(); 256]),
            by_scene: BTreeMap::new(),
            by_thread: BTreeMap::new(),
            rejects: 0,
            most_rejects: 0,
            undecided: 0,
            normalised: 0,
            direction: PowersOfTwo::default(),
            segment: PowersOfTwo::default(),
            hit_t: PowersOfTwo::default(),
            reject_counts: [0; 33],
        }
    }

    fn add(&mut self, chunk: &crate::format::rays::Chunk) {
        let mut all = Tally::default();
        for record in chunk.records.iter() {
            all.add(record);
            self.by_kind[usize::from(record.kind == kind::OCCLUSION)].add(record);
            self.by_purpose[Purpose::from_byte(record.purpose) as usize].add(record);
            self.by_depth[usize::from(record.depth)].add(record);
            self.undecided += u64::from(record.flags & flag::UNDECIDED != 0);

            let length = record.direction.length();
            let segment = record.effective_segment();
            if (length - 1.0).abs() < UNIT_LENGTH_TOLERANCE {
                self.normalised += 1;
            } else {
                self.direction.add(length);
            }
            self.segment.add((segment.tfar - segment.tnear) * length);
            if record.is_hit() && !record.is_occlusion() {
                self.hit_t.add(record.t);
            }
        }
        self.by_scene.entry(chunk.info.scene).or_default().merge(&all);
        self.by_thread.entry(chunk.info.thread).or_default().merge(&all);
        self.rejects += chunk.rejects.len() as u64;
        for same in chunk.rejects.chunk_by(|a, b| a.record == b.record) {
            self.most_rejects = self.most_rejects.max(same.len() as u32);
            self.reject_counts[same.len().min(32)] += 1;
        }
    }

    fn merge(mut self, other: Counts) -> Counts {
        let pairs =
            |into: &mut [Tally], from: &[Tally]| into.iter_mut().zip(from).for_each(|(a, b)| a.merge(b));
        pairs(&mut self.by_kind, &other.by_kind);
        pairs(&mut self.by_purpose, &other.by_purpose);
        pairs(&mut self.by_depth[..], &other.by_depth[..]);
        for (scene, tally) in &other.by_scene {
            self.by_scene.entry(*scene).or_default().merge(tally);
        }
        for (thread, tally) in &other.by_thread {
            self.by_thread.entry(*thread).or_default().merge(tally);
        }
        self.rejects += other.rejects;
        self.most_rejects = self.most_rejects.max(other.most_rejects);
        self.undecided += other.undecided;
        self.normalised += other.normalised;
        self.direction.merge(&other.direction);
        self.segment.merge(&other.segment);
        self.hit_t.merge(&other.hit_t);
        self.reject_counts.iter_mut().zip(&other.reject_counts).for_each(|(a, b)| *a += b);
        self
    }
}

impl Summary {
    /// Counts every query of a file.
    ///
    /// # Errors
    /// When the file is damaged; with `verify` also when [`Rays::verify`] fails.
    pub fn of(bytes: &[u8], verify: bool, progress: &Progress) -> Result<Summary, FormatError> {
        let rays = Rays::parse(bytes)?;
        if verify {
            rays.verify()?;
        }
        let counts = rays.fold_chunks(
            Counts::new,
            |counts, _, chunk| {
                counts.add(&chunk);
                progress.advance(chunk.records.len() as u64);
            },
            Counts::merge,
        )?;
        Ok(Summary::new(&rays, &counts, verify))
    }

    fn new(rays: &Rays, counts: &Counts, verified: bool) -> Summary {
        let mut total = Tally::default();
        counts.by_kind.iter().for_each(|tally| total.merge(tally));
        let header = rays.header.clone();
        Summary {
            fingerprint: format!("{:016x}", header.fingerprint),
            embree_version: header.embree_version,
            deterministic: header.deterministic,
            producer: header.producer,
            file_bytes: rays.file_bytes(),
            verified,
            recovery: rays.recovery.map(|Recovery { queries, lost_bytes }| Recovered { queries, lost_bytes }),
            queries: total.queries,
            total: TotalShares {
                hits: total.hits,
                hit_rate: total.hit_rate(),
                coherent: total.coherent,
                with_rejects: total.with_rejects,
            },
            rejects: counts.rejects,
            most_rejects: counts.most_rejects,
            undecided: counts.undecided,
            chunks: Chunks::of(rays),
            by_kind: groups(["closest_hit", "occlusion"].iter().zip(counts.by_kind)),
            by_purpose: groups(Purpose::ALL.iter().map(|purpose| purpose.name()).zip(counts.by_purpose)),
            by_depth: groups((0..=255u8).map(depth_name).zip(*counts.by_depth)),
            by_scene: groups(counts.by_scene.iter().map(|(scene, tally)| (scene, *tally))),
            by_thread: groups(counts.by_thread.iter().map(|(thread, tally)| (thread, *tally))),
            histograms: histograms(counts),
        }
    }
}

fn depth_name(depth: u8) -> String {
    if depth == NO_DEPTH { "unknown".to_string() } else { depth.to_string() }
}

/// Only what occurs is a group.
fn groups<N: ToString>(tallies: impl Iterator<Item = (N, Tally)>) -> Groups {
    Groups(
        tallies
            .filter(|(_, tally)| tally.queries > 0)
            .map(|(name, tally)| (name.to_string(), tally))
            .collect(),
    )
}

fn histograms(counts: &Counts) -> Vec<Histogram> {
    let depths: Vec<u64> = counts.by_depth.iter().take(NO_DEPTH.into()).map(|tally| tally.queries).collect();
    let mut depth = by_number("depth", &depths, 0);
    let unknown = counts.by_depth[usize::from(NO_DEPTH)].queries;
    if unknown > 0 {
        depth.bins.push(Bin::named("unknown", unknown));
    }
    let purposes = Purpose::ALL.iter().zip(counts.by_purpose).filter(|(_, tally)| tally.queries > 0);
    let purpose = purposes.map(|(purpose, tally)| Bin::named(purpose.name(), tally.queries)).collect();
    let mut rejects = by_number("rejects of queries that have some", &counts.reject_counts[1..32], 1);
    if counts.reject_counts[32] > 0 {
        rejects.bins.push(Bin::named("32 and more", counts.reject_counts[32]));
    }
    let mut direction = counts.direction.histogram("length of directions");
    if counts.normalised > 0 {
        direction.bins.insert(0, Bin::named("1 (normalised)", counts.normalised));
    }
    vec![
        Histogram { name: "purpose", bins: purpose },
        depth,
        counts.hit_t.histogram("t of closest hits"),
        counts.segment.histogram("length of effective segments"),
        direction,
        rejects,
    ]
}

impl Chunks {
    fn of(rays: &Rays) -> Chunks {
        let mut chunks = Chunks { count: rays.chunks().len() as u64, ..Chunks::default() };
        for chunk in rays.chunks() {
            match chunk.codec {
                Codec::Raw => chunks.raw += 1,
                Codec::Compressed => chunks.compressed += 1,
            }
            chunks.stored_bytes += chunk.stored_bytes;
            chunks.decoded_bytes += chunk.decoded_bytes();
        }
        let records = || rays.chunks().iter().map(|chunk| chunk.records);
        chunks.fewest_records = records().min().unwrap_or(0);
        chunks.most_records = records().max().unwrap_or(0);
        chunks.compression_ratio = match chunks.stored_bytes {
            0 => 1.0,
            stored => chunks.decoded_bytes as f64 / stored as f64,
        };
        chunks
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        writeln!(f, "ray queries (.rays version 1)")?;
        text::line(f, "producer", &self.producer)?;
        text::line(
            f,
            "scene fingerprint",
            match self.fingerprint.trim_matches('0') {
                "" => "unknown, or several scenes",
                _ => &self.fingerprint,
            },
        )?;
        text::line(
            f,
            "Embree",
            match self.embree_version {
                0 => "not recorded from Embree".to_string(),
                version => format!("{}.{}.{}", version / 10_000, version / 100 % 100, version % 100),
            },
        )?;
        text::line(
            f,
            "order of records",
            match self.deterministic {
                true => "does not depend on threads",
                false => "as threads came",
            },
        )?;
        text::line(f, "file", text::bytes(self.file_bytes))?;
        if let Some(recovery) = self.recovery {
            let (queries, bytes) = (grouped(recovery.queries), grouped(recovery.lost_bytes));
            text::line(
                f,
                "CUT OFF",
                format!("recovered {queries} queries; {bytes} bytes belong to no whole chunk"),
            )?;
        }
        if self.verified {
            text::line(f, "verified", "checksums, fields, results and sequence numbers")?;
        }
        let chunks = &self.chunks;
        let (raw, compressed) = (grouped(chunks.raw), grouped(chunks.compressed));
        text::line(f, "chunks", format!("{} ({raw} raw, {compressed} compressed)", grouped(chunks.count)))?;
        let (fewest, most) = (grouped(chunks.fewest_records.into()), grouped(chunks.most_records.into()));
        text::line(f, "queries per chunk", format!("{fewest} to {most}"))?;
        let (stored, decoded) = (text::bytes(chunks.stored_bytes), text::bytes(chunks.decoded_bytes));
        text::line(f, "stored", format!("{stored} for {decoded} ({:.2} x)", chunks.compression_ratio))?;
        text::line(f, "queries", grouped(self.queries))?;
        text::line(f, "hits", share(self.total.hits, self.queries))?;
        text::line(f, "coherent", share(self.total.coherent, self.queries))?;
        text::line(f, "undecided", share(self.undecided, self.queries))?;
        let most = grouped(self.most_rejects.into());
        let with = share(self.total.with_rejects, self.queries);
        text::line(f, "rejects", format!("{}, of {with} queries, at most {most}", grouped(self.rejects)))?;

        writeln!(
            f,
            "\n  {:<20}{:>15} {:>8} {:>15} {:>8} {:>15}",
            "", "queries", "share", "hits", "hit rate", "with rejects"
        )?;
        let properties = [
            ("", &self.by_kind),
            ("", &self.by_purpose),
            ("depth ", &self.by_depth),
            ("scene ", &self.by_scene),
            ("thread ", &self.by_thread),
        ];
        for (index, (prefix, groups)) in properties.into_iter().enumerate() {
            if index > 0 && !groups.0.is_empty() {
                writeln!(f)?;
            }
            self.fmt_groups(f, prefix, groups)?;
        }
        self.histograms.iter().try_for_each(|histogram| text::histogram(f, histogram))
    }
}

impl Summary {
    fn fmt_groups(&self, f: &mut Formatter, prefix: &str, groups: &Groups) -> fmt::Result {
        for (name, tally) in groups.0.iter().take(SHOWN_GROUPS) {
            let name = format!("{prefix}{}", name.replace('_', " "));
            let (queries, hits, rejects) =
                (grouped(tally.queries), grouped(tally.hits), grouped(tally.with_rejects));
            let (share, rate) = (percent(tally.queries, self.queries), 100.0 * tally.hit_rate());
            writeln!(f, "  {name:<20}{queries:>15} {share:>7.2}% {hits:>15} {rate:>7.2}% {rejects:>15}")?;
        }
        if groups.0.len() > SHOWN_GROUPS {
            writeln!(f, "  … and {} more", groups.0.len() - SHOWN_GROUPS)?;
        }
        Ok(())
    }
}

fn share(part: u64, whole: u64) -> String {
    format!("{} ({:.2}%)", grouped(part), percent(part, whole))
}
