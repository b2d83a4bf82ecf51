//! Reading a table, ours or another program's: pieces of at most a chunk, with all columns in step.

use super::guard::guarded;
use super::{COLUMNS, Content, REJECTS, footer, key, pages, wrong};
use crate::convert::{ConvertError, Losses, Source};
use crate::format::rays::{Chunk, ChunkInfo, Header, MAX_CHUNK_RECORDS, Record, Reject, flag, kind};
use bytemuck::Zeroable;
use bytes::Bytes;
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::DataType;
use parquet::errors::ParquetError;
use parquet::file::metadata::RowGroupMetaData;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::schema::types::SchemaDescriptor;
use std::borrow::Cow;
use std::collections::HashMap;

/// Reads a table. A chunk ends with the row group, after [`MAX_CHUNK_RECORDS`] rows, and where scene or thread change.
pub struct ParquetSource {
    bytes: Bytes,
    reader: SerializedFileReader<Bytes>,
    wanted: Vec<Wanted>,
    header: Header,
    count: u64,
    /// The row group to be opened next.
    group: usize,
    /// Of the open row group.
    columns: Vec<Column>,
    left: usize,
    /// Rows of all that was read.
    row: u64,
    /// Read, and not yet given: another scene's or thread's rows behind those given.
    piece: Piece,
    /// By thread: where the numbers of its queries end.
    ends: HashMap<u32, u64>,
    losses: Losses,
}

/// Rows in step.
#[derive(Default)]
struct Piece {
    records: Vec<Record>,
    rejects: Vec<Reject>,
    infos: Vec<ChunkInfo>,
    /// Rows that were given.
    given: usize,
}

/// A column of the table that is read.
#[derive(Clone, Copy)]
struct Wanted {
    /// Its number among all columns of the table.
    index: usize,
    name: &'static str,
    content: Content,
    /// Definition level of a value that is there.
    defined: i16,
}

struct Column {
    wanted: Wanted,
    reader: ColumnReader,
}

impl From<ParquetError> for ConvertError {
    fn from(error: ParquetError) -> ConvertError {
        wrong(error)
    }
}

const LOST_REJECTS: &str = "flag of a query that says that it had rejects, which the table does not hold";

impl ParquetSource {
    /// Reads the metadata.
    ///
    /// # Errors
    /// When the file is damaged, or its table is not one of queries.
    pub fn parse(bytes: Bytes) -> Result<ParquetSource, ConvertError> {
        guarded(|| Self::read(bytes))
    }

    fn read(bytes: Bytes) -> Result<ParquetSource, ConvertError> {
        footer::check(&bytes)?;
        let reader = SerializedFileReader::new(bytes.clone())?;
        let metadata = reader.metadata();
        let wanted = wanted(metadata.file_metadata().schema_descr())?;
        let mut count = 0_u64;
        for group in metadata.row_groups() {
            let rows = rows(group)?;
            count = count.checked_add(rows as u64).ok_or_else(|| wrong("more than 2^64 rows"))?;
        }
        let mut header = Header { producer: "Parquet, converted".into(), ..Header::default() };
        for pair in metadata.file_metadata().key_value_metadata().into_iter().flatten() {
            let Some(value) = &pair.value else { continue };
            match pair.key.as_str() {
                key::FINGERPRINT => header.fingerprint = u64::from_str_radix(value, 16).unwrap_or(0),
                key::EMBREE => header.embree_version = value.parse().unwrap_or(0),
                key::DETERMINISTIC => header.deterministic = value == "true",
                key::PRODUCER => header.producer = value.clone(),
                _ => {}
            }
        }
        Ok(ParquetSource {
            bytes,
            reader,
            wanted,
            header,
            count,
            group: 0,
            columns: Vec::new(),
            left: 0,
            row: 0,
            piece: Piece::default(),
            ends: HashMap::new(),
            losses: Losses::default(),
        })
    }

    /// Opens the next row group that has rows; false at the end.
    fn open(&mut self) -> Result<bool, ConvertError> {
        while self.group < self.reader.num_row_groups() {
            let group = self.reader.get_row_group(self.group)?;
            self.group += 1;
            self.left = rows(group.metadata())?;
            if self.left == 0 {
                continue;
            }
            self.columns.clear();
            for &wanted in &self.wanted {
                pages::check(&self.bytes, group.metadata().column(wanted.index), self.left as u64)?;
                self.columns.push(Column { wanted, reader: group.get_column_reader(wanted.index)? });
            }
            return Ok(true);
        }
        Ok(false)
    }

    /// Reads the next rows of the open row group.
    fn fill(&mut self) -> Result<(), ConvertError> {
        let rows = self.left.min(MAX_CHUNK_RECORDS);
        let mut piece = Piece {
            records: vec![Record::zeroed(); rows],
            rejects: Vec::new(),
            infos: vec![ChunkInfo::default(); rows],
            given: 0,
        };
        // A table without numbers is counted.
        for (row, info) in piece.infos.iter_mut().enumerate() {
            info.sequence = self.row + row as u64;
        }
        for column in &mut self.columns {
            column.read(rows, self.row, &mut piece)?;
        }
        let mut has_rejects = vec![false; rows];
        piece.rejects.iter().for_each(|reject| has_rejects[reject.record as usize] = true);
        for (row, (record, has_rejects)) in piece.records.iter_mut().zip(has_rejects).enumerate() {
            if record.kind > kind::OCCLUSION {
                let row = self.row + row as u64;
                return Err(wrong(format!("row {row}: kind: found {}, expected 0 or 1", record.kind)));
            }
            if has_rejects {
                record.flags |= flag::HAS_REJECTS;
            } else if record.flags & flag::HAS_REJECTS != 0 {
                record.flags &= !flag::HAS_REJECTS;
                self.losses.lose(LOST_REJECTS, 1);
            }
        }
        self.left -= rows;
        self.row += rows as u64;
        self.piece = piece;
        Ok(())
    }
}

/// The columns of a table that are queries'. All row groups have the same ones.
fn wanted(schema: &SchemaDescriptor) -> Result<Vec<Wanted>, ConvertError> {
    let mut found: Vec<Wanted> = Vec::new();
    for (index, column) in schema.columns().iter().enumerate() {
        let path = column.path().parts();
        // A list is a column within a column, whatever the writer calls what is between.
        let plain = path.len() == 1;
        let first = path.first().map_or("", String::as_str);
        let known = COLUMNS
            .iter()
            .chain([&REJECTS])
            .find(|&&(name, content)| name == first && plain != (content == Content::Rejects));
        let Some(&(name, content)) = known else { continue };
        if column.max_rep_level() != i16::from(!plain) {
            return Err(wrong(format!(
                "column {name}: a list of lists; expected one value or one list a row"
            )));
        }
        if found.iter().any(|other| other.name == name) {
            return Err(wrong(format!("column {name}: there is a second one")));
        }
        found.push(Wanted { index, name, content, defined: column.max_def_level() });
    }
    let missing: Vec<&str> = COLUMNS
        .iter()
        .filter(|(name, content)| {
            !content.may_be_missing() && !found.iter().any(|column| column.name == *name)
        })
        .map(|&(name, _)| name)
        .collect();
    if missing.is_empty() {
        return Ok(found);
    }
    let expected = "a table of queries as trace-convert writes it";
    Err(wrong(format!("the columns {} are missing; expected {expected}", missing.join(", "))))
}

/// Rows of a row group; the format lets it say less than none.
fn rows(group: &RowGroupMetaData) -> Result<usize, ConvertError> {
    usize::try_from(group.num_rows()).map_err(|_| wrong(format!("a row group of {} rows", group.num_rows())))
}

impl Column {
    /// Reads the values of `rows` rows, of which the first is number `first` of the table, into their places.
    fn read(&mut self, rows: usize, first: u64, piece: &mut Piece) -> Result<(), ConvertError> {
        let Wanted { name, content, defined, .. } = self.wanted;
        if content == Content::Rejects {
            let (definitions, repetitions, values) = self.integers(rows)?;
            let mut values = values.into_iter();
            let mut starts = 0;
            for (&definition, &repetition) in definitions.iter().zip(&repetitions) {
                starts += usize::from(repetition == 0);
                if definition < defined {
                    continue;
                }
                let triangle = values.next().and_then(|value| u32::try_from(value).ok());
                let record = starts.checked_sub(1).filter(|&record| record < rows);
                let (Some(triangle), Some(record)) = (triangle, record) else {
                    return Err(wrong(format!(
                        "column {name}: found a list that does not begin, or no number of a triangle"
                    )));
                };
                piece.rejects.push(Reject { record: record as u32, triangle });
            }
            return if starts == rows {
                Ok(())
            } else {
                Err(wrong(format!("column {name}: {starts} lists for {rows} rows")))
            };
        }
        if let Content::Float(offset) = content {
            let values = self.floats(rows)?;
            self.whole(values.len(), rows, first)?;
            for (record, value) in piece.records.iter_mut().zip(values) {
                bytemuck::bytes_of_mut(record)[offset..offset + 4].copy_from_slice(&value.to_le_bytes());
            }
            return Ok(());
        }
        let (_, _, values) = self.integers(rows)?;
        self.whole(values.len(), rows, first)?;
        for (row, value) in values.into_iter().enumerate() {
            let most = match content {
                Content::Byte(_) => u8::MAX.into(),
                Content::Scene => u16::MAX.into(),
                Content::Sequence => i128::from(u64::MAX),
                _ => u32::MAX.into(),
            };
            if !(0..=most).contains(&value) {
                let row = first + row as u64;
                return Err(wrong(format!("row {row}: {name}: found {value}, expected 0 to {most}")));
            }
            match content {
                Content::Word(offset) => {
                    let bytes = (value as u32).to_le_bytes();
                    bytemuck::bytes_of_mut(&mut piece.records[row])[offset..offset + 4]
                        .copy_from_slice(&bytes);
                }
                Content::Byte(offset) => {
                    bytemuck::bytes_of_mut(&mut piece.records[row])[offset] = value as u8
                }
                Content::Scene => piece.infos[row].scene = value as u16,
                Content::Thread => piece.infos[row].thread = value as u32,
                _ => piece.infos[row].sequence = value as u64,
            }
        }
        Ok(())
    }

    /// Whether every row has a value.
    fn whole(&self, values: usize, rows: usize, first: u64) -> Result<(), ConvertError> {
        let name = self.wanted.name;
        if values == rows {
            return Ok(());
        }
        let last = first + rows as u64;
        Err(wrong(format!(
            "column {name}: found {values} values in rows {first} to {last}, expected one in each"
        )))
    }

    fn floats(&mut self, rows: usize) -> Result<Vec<f32>, ConvertError> {
        match &mut self.reader {
            ColumnReader::FloatColumnReader(reader) => Ok(values(reader, rows)?.2),
            ColumnReader::DoubleColumnReader(reader) => {
                Ok(values(reader, rows)?.2.into_iter().map(|value| value as f32).collect())
            }
            _ => Err(wrong(format!("column {}: expected FLOAT", self.wanted.name))),
        }
    }

    /// Levels and values; 32 bits are taken as unsigned, and 64 bits of a number within the thread.
    fn integers(&mut self, rows: usize) -> Result<Values<i128>, ConvertError> {
        let sequence = self.wanted.content == Content::Sequence;
        match &mut self.reader {
            ColumnReader::Int32ColumnReader(reader) => {
                let (definitions, repetitions, values) = values(reader, rows)?;
                Ok((
                    definitions,
                    repetitions,
                    values.into_iter().map(|value| i128::from(value as u32)).collect(),
                ))
            }
            ColumnReader::Int64ColumnReader(reader) => {
                let (definitions, repetitions, values) = values(reader, rows)?;
                let wide = |value: i64| if sequence { i128::from(value as u64) } else { value.into() };
                Ok((definitions, repetitions, values.into_iter().map(wide).collect()))
            }
            _ => Err(wrong(format!("column {}: expected whole numbers", self.wanted.name))),
        }
    }
}

type Values<T> = (Vec<i16>, Vec<i16>, Vec<T>);

/// Levels and values of the next rows.
fn values<T: DataType>(reader: &mut ColumnReaderImpl<T>, rows: usize) -> Result<Values<T::T>, ConvertError> {
    let (mut definitions, mut repetitions, mut values) = (Vec::new(), Vec::new(), Vec::new());
    let mut read = 0;
    while read < rows {
        let (records, _, _) =
            reader.read_records(rows - read, Some(&mut definitions), Some(&mut repetitions), &mut values)?;
        if records == 0 {
            return Err(wrong(format!("the file ends after {read} of {rows} rows of a column")));
        }
        read += records;
    }
    Ok((definitions, repetitions, values))
}

impl Source for ParquetSource {
    fn header(&self) -> Header {
        self.header.clone()
    }

    fn count(&self) -> u64 {
        self.count
    }

    fn next(&mut self) -> Result<Option<Chunk<'_>>, ConvertError> {
        if self.piece.given == self.piece.records.len() {
            if self.left == 0 && !guarded(|| self.open())? {
                return Ok(None);
            }
            guarded(|| self.fill())?;
        }
        let Piece { records, rejects, infos, given } = &mut self.piece;
        let start = *given;
        let mut info = infos[start];
        let same = |other: &ChunkInfo| (other.scene, other.thread) == (info.scene, info.thread);
        let end = start + infos[start..].iter().take_while(|other| same(other)).count();
        *given = end;
        // Rows that were sorted or left out must not give a thread two queries of one number.
        let before = self.ends.entry(info.thread).or_insert(0);
        info.sequence = info.sequence.max(*before);
        *before = info.sequence.saturating_add((end - start) as u64);
        let of = |row: usize| rejects.partition_point(|reject| (reject.record as usize) < row);
        let own = rejects[of(start)..of(end)].iter();
        let own = own.map(|reject| Reject { record: reject.record - start as u32, ..*reject }).collect();
        Ok(Some(Chunk { info, records: Cow::Borrowed(&records[start..end]), rejects: Cow::Owned(own) }))
    }

    fn losses(&self) -> Losses {
        self.losses.clone()
    }
}
