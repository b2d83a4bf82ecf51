//! Our own `.rays` as a source and as a sink of queries.

use super::{ConvertError, Losses, Sink, Source};
use crate::format::rays::{Chunk, Codec, Header, Rays, RaysWriter};
use std::io::Write;

/// Reads chunk by chunk.
pub struct RaysSource<'a> {
    rays: Rays<'a>,
    next: usize,
}

impl<'a> RaysSource<'a> {
    pub fn new(rays: Rays<'a>) -> RaysSource<'a> {
        RaysSource { rays, next: 0 }
    }
}

impl Source for RaysSource<'_> {
    fn header(&self) -> Header {
        self.rays.header.clone()
    }

    fn count(&self) -> u64 {
        self.rays.query_count()
    }

    fn next(&mut self) -> Result<Option<Chunk<'_>>, ConvertError> {
        if self.next == self.rays.chunks().len() {
            return Ok(None);
        }
        self.next += 1;
        Ok(Some(self.rays.chunk(self.next - 1)?))
    }

    /// What was not saved of a recording that was cut off.
    fn losses(&self) -> Losses {
        let mut losses = Losses::default();
        let lost = self.rays.recovery.map_or(0, |recovery| recovery.lost_bytes);
        losses.lose("byte of the recording, which was cut off: in no whole chunk", lost);
        losses
    }
}

/// Writes every piece as a chunk.
pub struct RaysSink<W: Write> {
    writer: RaysWriter<W>,
    codec: Codec,
}

impl<W: Write> RaysSink<W> {
    /// Writes the header.
    ///
    /// # Errors
    /// When `out` cannot be written.
    pub fn new(out: W, header: &Header, codec: Codec) -> Result<RaysSink<W>, ConvertError> {
        Ok(RaysSink { writer: RaysWriter::new(out, header)?, codec })
    }
}

impl<W: Write> Sink for RaysSink<W> {
    fn write(&mut self, chunk: &Chunk) -> Result<(), ConvertError> {
        self.writer.write_chunk(&chunk.info, &chunk.records, &chunk.rejects, self.codec)?;
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<Losses, ConvertError> {
        self.writer.finish()?;
        Ok(Losses::default())
    }
}
