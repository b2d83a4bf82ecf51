//! The fixed-size structures of a `.rays` file, read with nom and written with byteorder: nothing else knows their offsets.

use super::codec::Codec;
use super::record::{Record, Reject};
use crate::format::{
    ALIGNMENT, FileKind, FormatError, MAJOR, MINOR, Problem, RAYS_MAGIC, check_start, pad_text, padded_text,
    parse_at,
};
use byteorder::{ByteOrder, LittleEndian};
use nom::bytes::complete::take;
use nom::number::complete::{le_u8, le_u16, le_u32, le_u64};

/// Bytes of the file header, and of a chunk header.
pub(super) const HEADER_BYTES: u64 = 64;
/// Bytes of the end of a complete file: the index's offset and the end mark.
pub(super) const FOOTER_BYTES: u64 = 16;
/// Bytes of an index entry.
pub(super) const ENTRY_BYTES: u64 = 16;
/// Magic of a chunk, of the index, and the mark that ends a complete file.
pub(super) const CHUNK_MAGIC: [u8; 4] = *b"RCHK";
pub(super) const INDEX_MAGIC: [u8; 4] = *b"RIDX";
pub(super) const END_MARK: [u8; 8] = *b"RAYSEND\0";

/// Records that one chunk holds at most.
pub const MAX_CHUNK_RECORDS: usize = 65_536;
/// Bytes that the body of a compressed chunk decodes to at most: what one hostile chunk can make a reader allocate.
/// It leaves room for 1.5 million rejects beside a full chunk's records; a larger body is stored raw.
pub const MAX_DECODED_BYTES: u64 = 16 << 20;

/// What a file says of all its queries.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// The companion `.bvh`'s fingerprint; 0 when unknown, or when the queries are of several scenes.
    pub fingerprint: u64,
    /// 31305 for 3.13.5; 0 when not recorded from Embree.
    pub embree_version: u32,
    /// Whether the order of records does not depend on the timing of threads.
    pub deterministic: bool,
    /// Who wrote the file; cut to 32 bytes when written.
    pub producer: String,
}

/// What a writer says of a chunk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ChunkInfo {
    /// 0 for the first traced scene.
    pub scene: u16,
    /// The recording thread, numbered from 0.
    pub thread: u32,
    /// Number, within the thread, of the first record.
    pub sequence: u64,
}

/// Where a chunk stands and what its header says, checked against the file's size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkEntry {
    /// Byte offset of the chunk's header.
    pub offset: u64,
    pub info: ChunkInfo,
    pub codec: Codec,
    pub records: u32,
    pub rejects: u32,
    /// Bytes of the body in the file.
    pub stored_bytes: u64,
    /// XXH3-64 of the stored body.
    pub checksum: u64,
}

impl ChunkEntry {
    /// Byte offset of the body.
    pub fn body(&self) -> u64 {
        self.offset + HEADER_BYTES
    }

    /// Bytes of the body once decoded.
    pub fn decoded_bytes(&self) -> u64 {
        decoded_bytes(self.records, self.rejects)
    }
}

fn decoded_bytes(records: u32, rejects: u32) -> u64 {
    u64::from(records) * size_of::<Record>() as u64 + u64::from(rejects) * size_of::<Reject>() as u64
}

impl Header {
    const DETERMINISTIC: u32 = 1;

    pub(super) fn read(bytes: &[u8]) -> Result<Header, FormatError> {
        check_start(bytes, FileKind::Rays, HEADER_BYTES as u32)?;
        let fields = (le_u64, le_u32, le_u32, take(32usize));
        let (fingerprint, embree_version, flags, producer) = parse_at(bytes, 16, "header", fields)?;
        Ok(Header {
            fingerprint,
            embree_version,
            deterministic: flags & Self::DETERMINISTIC != 0,
            producer: padded_text(producer),
        })
    }

    pub(super) fn bytes(&self) -> [u8; HEADER_BYTES as usize] {
        let mut bytes = [0; HEADER_BYTES as usize];
        bytes[..8].copy_from_slice(&RAYS_MAGIC);
        LittleEndian::write_u16(&mut bytes[8..], MAJOR);
        LittleEndian::write_u16(&mut bytes[10..], MINOR);
        LittleEndian::write_u32(&mut bytes[12..], HEADER_BYTES as u32);
        LittleEndian::write_u64(&mut bytes[16..], self.fingerprint);
        LittleEndian::write_u32(&mut bytes[24..], self.embree_version);
        LittleEndian::write_u32(&mut bytes[28..], if self.deterministic { Self::DETERMINISTIC } else { 0 });
        bytes[32..].copy_from_slice(&pad_text::<32>(&self.producer));
        bytes
    }
}

/// A chunk's header as it stands in the file; of the index's, only magic, sizes and checksum have a meaning.
#[derive(Clone, Copy, Debug)]
pub(super) struct ChunkHeader {
    pub magic: [u8; 4],
    pub codec: u8,
    pub info: ChunkInfo,
    pub records: u32,
    pub rejects: u32,
    pub stored_bytes: u64,
    pub decoded_bytes: u64,
    pub checksum: u64,
}

impl ChunkHeader {
    /// Reads the 64 bytes at `offset`, and checks only that they are there.
    pub(super) fn read(bytes: &[u8], offset: u64) -> Result<ChunkHeader, FormatError> {
        let counts = (take(4usize), le_u8, le_u8, le_u16, le_u32, le_u32, le_u32, le_u32);
        let sizes = (le_u64, le_u64, le_u64, le_u64, le_u64);
        let ((magic, codec, _, scene, records, rejects, thread, _), sizes) =
            parse_at(bytes, offset, "chunk header", (counts, sizes))?;
        let (sequence, stored_bytes, decoded_bytes, checksum, _) = sizes;
        let magic = [magic[0], magic[1], magic[2], magic[3]];
        let info = ChunkInfo { scene, thread, sequence };
        Ok(ChunkHeader { magic, codec, info, records, rejects, stored_bytes, decoded_bytes, checksum })
    }

    pub(super) fn bytes(&self) -> [u8; HEADER_BYTES as usize] {
        let mut bytes = [0; HEADER_BYTES as usize];
        bytes[..4].copy_from_slice(&self.magic);
        bytes[4] = self.codec;
        LittleEndian::write_u16(&mut bytes[6..], self.info.scene);
        LittleEndian::write_u32(&mut bytes[8..], self.records);
        LittleEndian::write_u32(&mut bytes[12..], self.rejects);
        LittleEndian::write_u32(&mut bytes[16..], self.info.thread);
        LittleEndian::write_u64(&mut bytes[24..], self.info.sequence);
        LittleEndian::write_u64(&mut bytes[32..], self.stored_bytes);
        LittleEndian::write_u64(&mut bytes[40..], self.decoded_bytes);
        LittleEndian::write_u64(&mut bytes[48..], self.checksum);
        bytes
    }

    /// Checks the fields of a chunk at `offset` whose body must end by `end`, byte offset where chunks end in the file.
    pub(super) fn entry(&self, offset: u64, end: u64) -> Result<ChunkEntry, FormatError> {
        if self.magic != CHUNK_MAGIC {
            return Err(FormatError::field(offset, "chunk magic", self.magic.escape_ascii(), "RCHK"));
        }
        let codec = Codec::from_byte(self.codec).ok_or_else(|| {
            FormatError::field(offset + 4, "codec", self.codec, "0 (raw) or 1 (compressed)")
        })?;
        if self.records as usize > MAX_CHUNK_RECORDS {
            let expected = format!("at most {MAX_CHUNK_RECORDS}");
            return Err(FormatError::field(offset + 8, "record count of a chunk", self.records, expected));
        }
        let decoded = decoded_bytes(self.records, self.rejects);
        if self.decoded_bytes != decoded {
            return Err(FormatError::field(
                offset + 40,
                "bytes of a decoded body",
                self.decoded_bytes,
                decoded,
            ));
        }
        if codec == Codec::Raw && self.stored_bytes != decoded {
            return Err(FormatError::field(
                offset + 32,
                "stored bytes of a raw body",
                self.stored_bytes,
                decoded,
            ));
        }
        if codec == Codec::Compressed && decoded > MAX_DECODED_BYTES {
            let expected = format!("at most {MAX_DECODED_BYTES} in a compressed chunk");
            return Err(FormatError::field(offset + 40, "bytes of a decoded body", decoded, expected));
        }
        let available = end.saturating_sub(offset + HEADER_BYTES);
        if self.stored_bytes > available {
            let needed = Some(self.stored_bytes);
            return Err(FormatError::new(
                offset + HEADER_BYTES,
                Problem::Truncated { what: "body of a chunk", needed, available },
            ));
        }
        Ok(ChunkEntry {
            offset,
            info: self.info,
            codec,
            records: self.records,
            rejects: self.rejects,
            stored_bytes: self.stored_bytes,
            checksum: self.checksum,
        })
    }
}

/// Zero bytes that fill the file up to the next chunk after `written` bytes.
pub(super) fn padding(written: u64) -> &'static [u8] {
    static ZEROS: [u8; ALIGNMENT as usize] = [0; ALIGNMENT as usize];
    &ZEROS[..(written.wrapping_neg() % ALIGNMENT) as usize]
}
