//! Writing a table: one row group per chunk, which is all that is in memory.

use super::{COLUMNS, Content, REJECTS, key};
use crate::convert::{ConvertError, Losses, Sink};
use crate::format::rays::{Chunk, Header, Reject};
use parquet::basic::{Compression, ZstdLevel};
use parquet::data_type::{FloatType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::ColumnPath;
use std::io::{self, Write};
use std::sync::Arc;

/// zstd's level: 3 is its own default.
const LEVEL: i32 = 3;

/// Writes a table.
pub struct ParquetSink<W: Write> {
    out: W,
    /// Into memory, which is emptied after every row group.
    writer: SerializedFileWriter<Vec<u8>>,
}

impl<W: Write> ParquetSink<W> {
    /// Begins a file. `header` becomes its metadata.
    ///
    /// # Errors
    /// When `out` cannot be written.
    pub fn new(out: W, header: &Header) -> Result<ParquetSink<W>, ConvertError> {
        let columns = COLUMNS.iter().chain([&REJECTS]);
        let declared: Vec<String> = columns.map(|(name, content)| content.declared(name)).collect();
        let schema =
            parse_message_type(&format!("message queries {{ {} }}", declared.join(" "))).map_err(failed)?;
        let metadata = [
            (key::FINGERPRINT, format!("{:016x}", header.fingerprint)),
            (key::EMBREE, header.embree_version.to_string()),
            (key::DETERMINISTIC, header.deterministic.to_string()),
            (key::PRODUCER, header.producer.clone()),
        ];
        let metadata = metadata.map(|(key, value)| KeyValue::new(key.to_owned(), value));
        let mut properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(ZstdLevel::try_new(LEVEL).map_err(failed)?))
            .set_created_by(concat!("embree-trace version ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_key_value_metadata(Some(metadata.to_vec()));
        // Hardly a coordinate is there twice: looking for it costs more than it saves.
        for name in ["origin", "direction"]
            .iter()
            .flat_map(|name| ["x", "y", "z"].map(|axis| format!("{name}_{axis}")))
        {
            properties = properties.set_column_dictionary_enabled(ColumnPath::from(name), false);
        }
        let writer = SerializedFileWriter::new(Vec::new(), Arc::new(schema), Arc::new(properties.build()));
        Ok(ParquetSink { out, writer: writer.map_err(failed)? })
    }
}

/// An error of writing to memory.
fn failed(error: ParquetError) -> ConvertError {
    ConvertError::Output(io::Error::other(error))
}

/// The bytes of a field of every record.
fn fields<'a, const N: usize>(chunk: &'a Chunk, offset: usize) -> impl Iterator<Item = [u8; N]> + 'a {
    chunk.records.iter().map(move |record| {
        let bytes = bytemuck::bytes_of(record);
        std::array::from_fn(|at| bytes[offset + at])
    })
}

impl<W: Write> Sink for ParquetSink<W> {
    fn write(&mut self, chunk: &Chunk) -> Result<(), ConvertError> {
        let mut group = self.writer.next_row_group().map_err(failed)?;
        let rows = chunk.records.len();
        for (_, content) in COLUMNS.iter().chain([&REJECTS]) {
            let Some(mut column) = group.next_column().map_err(failed)? else { break };
            let whole = |values: Vec<i32>| (values, None);
            let (values, levels) = match *content {
                Content::Float(offset) => {
                    let values: Vec<f32> = fields(chunk, offset).map(f32::from_le_bytes).collect();
                    column.typed::<FloatType>().write_batch(&values, None, None).map_err(failed)?;
                    column.close().map_err(failed)?;
                    continue;
                }
                Content::Sequence => {
                    let first = chunk.info.sequence;
                    let values: Vec<i64> =
                        (0..rows as u64).map(|row| first.wrapping_add(row) as i64).collect();
                    column.typed::<Int64Type>().write_batch(&values, None, None).map_err(failed)?;
                    column.close().map_err(failed)?;
                    continue;
                }
                Content::Word(offset) => whole(fields(chunk, offset).map(i32::from_le_bytes).collect()),
                Content::Byte(offset) => whole(fields(chunk, offset).map(|[byte]| i32::from(byte)).collect()),
                Content::Scene => whole(vec![chunk.info.scene.into(); rows]),
                Content::Thread => whole(vec![chunk.info.thread as i32; rows]),
                Content::Rejects => {
                    let values = chunk.rejects.iter().map(|reject| reject.triangle as i32).collect();
                    (values, Some(levels(rows, &chunk.rejects)))
                }
            };
            let (definitions, repetitions) =
                levels.as_ref().map_or((None, None), |(d, r)| (Some(&d[..]), Some(&r[..])));
            column.typed::<Int32Type>().write_batch(&values, definitions, repetitions).map_err(failed)?;
            column.close().map_err(failed)?;
        }
        group.close().map_err(failed)?;
        self.writer.flush()?;
        let written = self.writer.inner_mut();
        self.out.write_all(written)?;
        written.clear();
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Losses, ConvertError> {
        let footer = self.writer.into_inner().map_err(failed)?;
        self.out.write_all(&footer)?;
        self.out.flush()?;
        Ok(Losses::default())
    }
}

/// Definition and repetition levels of the lists, one of each per reject, and for each row without any: 1 where there is a value, and 1 where it goes
/// on the list before.
fn levels(rows: usize, rejects: &[Reject]) -> (Vec<i16>, Vec<i16>) {
    let (mut definitions, mut repetitions) = (Vec::with_capacity(rows), Vec::with_capacity(rows));
    let mut waiting = rejects;
    for row in 0..rows {
        let own = waiting.partition_point(|reject| reject.record as usize <= row);
        definitions.extend(vec![1; own]);
        repetitions.extend((0..own).map(|place| i16::from(place > 0)));
        if own == 0 {
            definitions.push(0);
            repetitions.push(0);
        }
        waiting = &waiting[own..];
    }
    (definitions, repetitions)
}
