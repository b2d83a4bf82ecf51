//! Tables of queries from a description: as we write them, and as other programs might; then changes to bytes of their pages and footer.
//!
//! Parquet has no checksums that would have to be made again, but its footer says how long it is.

use super::bits;
use super::queries::{check_parquet, read, write};
use super::rays::Content;
use super::rays_file::File;
use arbitrary::{Arbitrary, Result, Unstructured};
use embree_trace::convert::Kind;
use embree_trace::format::rays::{Record, flag};
use parquet::basic::{Compression, Encoding, ZstdLevel};
use parquet::data_type::{BoolType, DataType, DoubleType, FloatType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::{WriterProperties, WriterVersion};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::parser::parse_message_type;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

/// The columns that a table must have, in the order of a record: its words, then its last four bytes.
const COLUMNS: [&str; 19] = [
    "origin_x",
    "origin_y",
    "origin_z",
    "tnear",
    "direction_x",
    "direction_y",
    "direction_z",
    "tfar",
    "time",
    "mask",
    "t",
    "triangle",
    "u",
    "v",
    "path",
    "kind",
    "depth",
    "flags",
    "purpose",
];
const WORDS: usize = 15;
const WHOLE_NUMBERS: [&str; 3] = ["mask", "triangle", "path"];

fn is_float(column: usize) -> bool {
    column < WORDS && !WHOLE_NUMBERS.contains(&COLUMNS[column])
}

/// What is wrong with a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Arbitrary)]
enum Fault {
    Missing,
    Twice,
    /// Truth values.
    OtherType,
    /// One value is not there.
    Null,
}

/// How a program writes a column.
#[derive(Clone, Copy, Debug)]
struct Column {
    /// Its number in [`COLUMNS`].
    number: usize,
    /// 64 bits for a number.
    wide: bool,
    optional: bool,
    fault: Option<Fault>,
}

impl Column {
    fn type_name(&self) -> &'static str {
        match (self.fault, is_float(self.number), self.wide) {
            (Some(Fault::OtherType), ..) => "BOOLEAN",
            (_, true, true) => "DOUBLE",
            (_, true, false) => "FLOAT",
            (_, false, true) => "INT64",
            (_, false, false) => "INT32",
        }
    }

    /// Writes the column's value of each record.
    fn write(
        &self,
        group: &mut SerializedRowGroupWriter<Vec<u8>>,
        records: &[Record],
    ) -> std::result::Result<(), ParquetError> {
        let bits = records.iter().map(|record| {
            let bytes = bytemuck::bytes_of(record);
            match self.number.checked_sub(WORDS) {
                Some(byte) => bytes[WORDS * 4 + byte].into(),
                None => u32::from_le_bytes(std::array::from_fn(|at| bytes[self.number * 4 + at])),
            }
        });
        match self.type_name() {
            "BOOLEAN" => self.values::<BoolType>(group, bits.map(|bits| bits & 1 == 1).collect()),
            "DOUBLE" => {
                self.values::<DoubleType>(group, bits.map(|bits| f32::from_bits(bits).into()).collect())
            }
            "FLOAT" => self.values::<FloatType>(group, bits.map(f32::from_bits).collect()),
            "INT64" => self.values::<Int64Type>(group, bits.map(i64::from).collect()),
            _ => self.values::<Int32Type>(group, bits.map(|bits| bits as i32).collect()),
        }
    }

    fn values<T: DataType>(
        &self,
        group: &mut SerializedRowGroupWriter<Vec<u8>>,
        mut values: Vec<T::T>,
    ) -> std::result::Result<(), ParquetError> {
        let mut levels = vec![1; values.len()];
        if self.fault == Some(Fault::Null) && values.pop().is_some() {
            levels[0] = 0;
        }
        let levels = self.is_optional().then_some(&levels[..]);
        if let Some(mut column) = group.next_column()? {
            column.typed::<T>().write_batch(&values, levels, None)?;
            column.close()?;
        }
        Ok(())
    }

    fn is_optional(&self) -> bool {
        self.optional || self.fault == Some(Fault::Null)
    }
}

/// A table as another program might write it.
#[derive(Debug)]
struct Foreign {
    columns: Vec<Column>,
    /// Whether it must be read.
    good: bool,
    rows_per_group: usize,
    properties: WriterProperties,
}

impl<'a> Arbitrary<'a> for Foreign {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<Foreign> {
        let (mut columns, mut good) = (Vec::new(), true);
        for number in 0..COLUMNS.len() {
            let [wide, optional] = u.arbitrary()?;
            // Asked this way round, there is no fault once all bytes are taken.
            let fault = if u.ratio(99, 100)? { None } else { Some(u.arbitrary()?) };
            good &= fault.is_none();
            let column = Column { number, wide, optional, fault };
            let times = match fault {
                Some(Fault::Missing) => 0,
                Some(Fault::Twice) => 2,
                _ => 1,
            };
            columns.extend(std::iter::repeat_n(column, times));
        }
        for at in 0..columns.len() {
            let other = u.int_in_range(at..=columns.len() - 1)?;
            columns.swap(at, other);
        }
        let compression = *u.choose(&[
            Compression::UNCOMPRESSED,
            Compression::SNAPPY,
            Compression::ZSTD(ZstdLevel::default()),
        ])?;
        let version = if u.arbitrary()? { WriterVersion::PARQUET_1_0 } else { WriterVersion::PARQUET_2_0 };
        let mut properties = WriterProperties::builder()
            .set_compression(compression)
            .set_writer_version(version)
            .set_dictionary_enabled(u.arbitrary()?)
            .set_data_page_row_count_limit(u.int_in_range(10..=100)?)
            .set_write_batch_size(u.int_in_range(10..=100)?);
        if u.arbitrary()? {
            properties = properties.set_encoding(Encoding::PLAIN);
        }
        Ok(Foreign {
            columns,
            good,
            rows_per_group: u.int_in_range(30..=200)?,
            properties: properties.build(),
        })
    }
}

impl Foreign {
    fn bytes(&self, records: &[Record]) -> std::result::Result<Vec<u8>, ParquetError> {
        let declared: Vec<String> = (self.columns.iter())
            .map(|column| {
                let repetition = if column.is_optional() { "OPTIONAL" } else { "REQUIRED" };
                format!("{repetition} {} {};", column.type_name(), COLUMNS[column.number])
            })
            .collect();
        let schema = parse_message_type(&format!("message table {{ {} }}", declared.join(" ")))?;
        let properties = Arc::new(self.properties.clone());
        let mut writer = SerializedFileWriter::new(Vec::new(), Arc::new(schema), properties)?;
        for rows in records.chunks(self.rows_per_group) {
            let mut group = writer.next_row_group()?;
            self.columns.iter().try_for_each(|column| column.write(&mut group, rows))?;
            group.close()?;
        }
        writer.into_inner()
    }
}

/// A record as a table of wider numbers and without rejects keeps it: a NaN remains one.
fn kept(mut record: Record) -> [u32; 16] {
    record.flags &= !flag::HAS_REJECTS;
    let mut words: [u32; 16] = bytemuck::cast(record);
    for (_, word) in words.iter_mut().enumerate().filter(|(number, _)| is_float(*number)) {
        *word = bits(f32::from_bits(*word));
    }
    words
}

/// The file's queries as a table, and what a reader must find in it.
pub fn ours(file: &File) -> (Vec<u8>, Content) {
    let mut content = file.content();
    // A chunk is a row group, and what reads it gives no empty pieces.
    content.chunks.retain(|(_, records, _)| !records.is_empty());
    let bytes = write(&content, Kind::Parquet);
    // Numbers that two chunks of a thread share are moved: a table's rows may be in any order.
    let mut ends = HashMap::new();
    for (info, records, _) in &mut content.chunks {
        let end = ends.entry(info.thread).or_insert(0);
        info.sequence = info.sequence.max(*end);
        *end = info.sequence.saturating_add((records.len() / size_of::<Record>()) as u64);
    }
    (bytes, content)
}

/// A change of bytes; the footer's length remains right.
#[derive(Clone, Copy, Debug, Arbitrary)]
struct Edit {
    /// In the footer, or before it.
    footer: bool,
    at: u16,
    change: Change,
}

#[derive(Clone, Copy, Debug, Arbitrary)]
enum Change {
    Set(u8),
    Add(i8),
    Insert(u8),
    Remove,
}

/// Magic at both ends, and the length of the footer before the last.
const MAGIC_BYTES: usize = 4;
const TAIL_BYTES: usize = 8;

impl Edit {
    fn apply(self, bytes: &mut Vec<u8>) {
        let footer = footer(bytes);
        let range = if self.footer { footer.clone() } else { MAGIC_BYTES..footer.start };
        if range.is_empty() {
            return;
        }
        let at = range.start + self.at as usize % range.len();
        match self.change {
            Change::Set(value) => bytes[at] = value,
            Change::Add(delta) => bytes[at] = bytes[at].wrapping_add_signed(delta),
            Change::Insert(value) => bytes.insert(at, value),
            Change::Remove => drop(bytes.remove(at)),
        }
        let end = bytes.len() - TAIL_BYTES;
        // What changed length before the footer moved it.
        let start = if self.footer { footer.start } else { end - footer.len() };
        bytes[end..end + 4].copy_from_slice(&((end - start) as u32).to_le_bytes());
    }
}

/// Where the footer of a table is that we made.
fn footer(bytes: &[u8]) -> Range<usize> {
    let end = bytes.len() - TAIL_BYTES;
    let length = u32::from_le_bytes(std::array::from_fn(|at| bytes[end + at]));
    end - length as usize..end
}

/// Takes bytes as the description of a table and of changes, and gives the changed table to the reader.
///
/// # Panics
/// Where a promise of the reader does not hold.
pub fn check(bytes: &[u8]) {
    // An error says that the bytes describe nothing; there are none left to say more.
    let _ = run(&mut Unstructured::new(bytes));
}

fn run(u: &mut Unstructured) -> Result<()> {
    let file: File = u.arbitrary()?;
    let foreign: Option<Foreign> = u.arbitrary()?;
    let (mut bytes, expected) = match &foreign {
        None => ours(&file),
        Some(foreign) => match foreign.bytes(&file.content().records()) {
            Ok(bytes) => (bytes, file.content()),
            Err(error) => panic!("a table cannot be written: {error}"),
        },
    };
    let edits = u.int_in_range(0..=4u8)?;
    for _ in 0..edits {
        u.arbitrary::<Edit>()?.apply(&mut bytes);
    }
    check_parquet(&bytes);
    if edits > 0 {
        return Ok(());
    }
    match (read(&bytes, Kind::Parquet), foreign) {
        (Ok(found), None) => assert_eq!(found, expected),
        (Ok(found), Some(foreign)) => {
            let twice = foreign.columns.iter().any(|column| column.fault == Some(Fault::Twice));
            // Where there are no rows, types and values are not looked at.
            let bare = expected.records().is_empty();
            assert!(foreign.good || bare && !twice, "read in spite of {:?}", foreign.columns);
            let kept = |records: Vec<Record>| -> Vec<_> { records.into_iter().map(kept).collect() };
            assert_eq!(kept(found.records()), kept(expected.records()));
        }
        (Err(error), foreign) => {
            assert!(foreign.is_some_and(|foreign| !foreign.good), "refused: {error}");
        }
    }
    Ok(())
}
