//! Writing a `.rays` file from front to back, so that what is cut off at any moment can be read up to its last full chunk.

use super::codec::{Codec, EncodedChunk, encode_chunk};
use super::layout::{
    ChunkHeader, ChunkInfo, END_MARK, ENTRY_BYTES, FOOTER_BYTES, HEADER_BYTES, Header, INDEX_MAGIC, padding,
};
use super::record::{Record, Reject};
use crate::format::checksum;
use byteorder::{LittleEndian, WriteBytesExt};
use std::io::{self, Seek, SeekFrom, Write};

/// What has been written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    pub chunks: u64,
    pub records: u64,
    pub rejects: u64,
    /// Bytes of the file.
    pub bytes: u64,
}

/// Writes chunks to `W`, each at once: give it a file itself rather than a buffer, so that a killed program loses nothing
/// that was written. After an error the writer takes nothing more, and the file is one that was cut off.
pub struct RaysWriter<W: Write> {
    out: W,
    totals: Totals,
    /// The body of the index so far.
    index: Vec<u8>,
    failed: bool,
}

impl<W: Write> RaysWriter<W> {
    /// Writes the header.
    pub fn new(mut out: W, header: &Header) -> io::Result<RaysWriter<W>> {
        out.write_all(&header.bytes())?;
        let totals = Totals { bytes: HEADER_BYTES, ..Totals::default() };
        Ok(RaysWriter { out, totals, index: Vec::new(), failed: false })
    }

    /// Encodes and writes one chunk; see [`encode_chunk`] for what it must hold.
    pub fn write_chunk(
        &mut self,
        info: &ChunkInfo,
        records: &[Record],
        rejects: &[Reject],
        codec: Codec,
    ) -> io::Result<()> {
        self.write_encoded(&encode_chunk(info, records, rejects, codec)?)
    }

    /// Writes a chunk that any thread has encoded.
    pub fn write_encoded(&mut self, chunk: &EncodedChunk) -> io::Result<()> {
        if self.failed {
            return Err(io::Error::other("an earlier chunk could not be written"));
        }
        // Cleared again at the end: half a chunk in the file must not be followed by another.
        self.failed = true;
        let offset = self.totals.bytes;
        let end = offset + HEADER_BYTES + chunk.stored_bytes();
        self.out.write_all(&chunk.header)?;
        for part in &chunk.body {
            self.out.write_all(part)?;
        }
        self.out.write_all(padding(end))?;
        self.index.write_u64::<LittleEndian>(offset)?;
        self.index.write_u32::<LittleEndian>(chunk.records)?;
        self.index.write_u32::<LittleEndian>(chunk.rejects)?;
        self.totals.chunks += 1;
        self.totals.records += u64::from(chunk.records);
        self.totals.rejects += u64::from(chunk.rejects);
        self.totals.bytes = end + padding(end).len() as u64;
        self.failed = false;
        Ok(())
    }

    /// What has been written so far: after an error, what a reader will recover.
    pub fn totals(&self) -> Totals {
        self.totals
    }

    /// Replaces the header: for what is known only at the end.
    ///
    /// # Errors
    /// When the file cannot be written twice, such as a pipe: then it is as it was.
    pub fn replace_header(&mut self, header: &Header) -> io::Result<()>
    where
        W: Seek,
    {
        self.out.seek(SeekFrom::Start(0))?;
        // Cleared again at the end: the next chunk must not be written in the wrong place.
        let failed = std::mem::replace(&mut self.failed, true);
        self.out.write_all(&header.bytes())?;
        self.out.seek(SeekFrom::Start(self.totals.bytes))?;
        self.failed = failed;
        Ok(())
    }

    /// Writes the index and the end mark.
    pub fn finish(mut self) -> io::Result<(W, Totals)> {
        if self.failed {
            return Err(io::Error::other("an earlier chunk could not be written"));
        }
        let index_bytes = self.totals.chunks * ENTRY_BYTES;
        let header = ChunkHeader {
            magic: INDEX_MAGIC,
            codec: 0,
            info: ChunkInfo::default(),
            records: 0,
            rejects: 0,
            stored_bytes: index_bytes,
            decoded_bytes: index_bytes,
            checksum: checksum(&self.index),
        };
        let mut tail = Vec::from(header.bytes());
        tail.extend_from_slice(&self.index);
        tail.write_u64::<LittleEndian>(self.totals.bytes)?;
        tail.extend_from_slice(&END_MARK);
        self.out.write_all(&tail)?;
        self.out.flush()?;
        self.totals.bytes += HEADER_BYTES + index_bytes + FOOTER_BYTES;
        Ok((self.out, self.totals))
    }
}
