"""Recordings: `.rays` files, chunk by chunk as structured arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterator, List, Optional

import numpy as np

from .files import Mapped, Path, text

#: A query and its answer, 64 bytes; see docs/formats.md, *Record*.
RECORD = np.dtype(
    [
        ("origin", "<f4", 3), ("tnear", "<f4"), ("direction", "<f4", 3), ("tfar", "<f4"), ("time", "<f4"), ("mask", "<u4"),
        ("t", "<f4"), ("triangle", "<u4"), ("u", "<f4"), ("v", "<f4"), ("path", "<u4"),
        ("kind", "u1"), ("depth", "u1"), ("flags", "u1"), ("purpose", "u1"),
    ]
)
#: A candidate hit that the program's own filter refused: of which record of the chunk, and which triangle.
REJECT = np.dtype([("record", "<u4"), ("triangle", "<u4")])

#: Names of the values of `purpose`.
PURPOSES = ("unknown", "camera", "shadow", "ambient occlusion", "diffuse", "specular")
#: `triangle` of a query without a hit, or whose hit is no triangle; `path` of one whose pixel is unknown.
NONE = 0xFFFF_FFFF

_HEADER = np.dtype(
    [("", "V16"), ("fingerprint", "<u8"), ("embree", "<u4"), ("flags", "<u4"), ("producer", "S32")]
)
_CHUNK = np.dtype(
    [
        ("magic", "S4"), ("codec", "u1"), ("", "V1"), ("scene", "<u2"), ("records", "<u4"), ("rejects", "<u4"),
        ("thread", "<u4"), ("", "V4"), ("sequence", "<u8"), ("stored", "<u8"), ("decoded", "<u8"), ("checksum", "<u8"), ("", "V8"),
    ]
)
_MOST_RECORDS = 65_536
_MOST_DECODED = 16 << 20
#: Of a zstd frame, decoded at a time: 4 bytes give at most 128 KiB, so these give at most 32 MiB.
_PIECE = 1024
_ENTRY = np.dtype([("offset", "<u8"), ("records", "<u4"), ("rejects", "<u4")])
_END = b"RAYSEND\0"


@dataclass(frozen=True)
class Chunk:
    """Part of a recording, from one thread. `len()` is its number of queries."""

    file: Mapped
    #: Of its header in the file, in bytes.
    offset: int
    scene: int
    thread: int
    #: Of its first query within the thread.
    sequence: int
    count: int
    reject_count: int
    compressed: bool

    def __len__(self) -> int:
        return self.count

    @property
    def end(self) -> int:
        """Where the next chunk stands, in bytes."""
        return (self.offset + 64 + len(self._body()) + 63) // 64 * 64

    def _body(self) -> np.ndarray:
        head = self.file.struct(self.offset, "chunk header", _CHUNK)
        return self.file.bytes(self.offset + 64, int(head["stored"]), "chunk")

    def _decoded(self) -> np.ndarray:
        body, size = self._body(), 64 * self.count + 8 * self.reject_count
        if not self.compressed:
            return body
        try:
            import zstandard
        except ImportError as error:
            raise ImportError("a compressed recording needs the package zstandard (Debian: python3-zstandard)") from error
        # Piece by piece, so that a frame which decodes to more than it should is left before it takes the memory: neither the size
        # that a frame states nor `max_output_size` would do that.
        frame, parts, decoded, body = zstandard.ZstdDecompressor().decompressobj(), [], 0, body.tobytes()
        try:
            for start in range(0, len(body), _PIECE):
                if frame.eof:
                    self.file.fail(self.offset, "chunk: bytes behind its zstd frame")
                parts.append(frame.decompress(body[start : start + _PIECE]))
                decoded += len(parts[-1])
                if decoded > size:
                    self.file.fail(self.offset, f"chunk: more than {size} bytes decoded")
        except (zstandard.ZstdError, MemoryError) as error:
            self.file.fail(self.offset, f"chunk: zstd: {error}")
        if not frame.eof or frame.unused_data or decoded != size:
            self.file.fail(self.offset, f"chunk: {decoded} bytes decoded, expected one zstd frame of {size}")
        return np.frombuffer(b"".join(parts), np.uint8)

    def queries(self) -> np.ndarray:
        """Its queries, an array of `RECORD`: a view of the file where it is raw, else decoded anew by each call."""
        plain = self._decoded()[: 64 * self.count]
        if self.compressed:
            # Byte c of every record is column c.
            plain = np.ascontiguousarray(plain.reshape(64, self.count).T).reshape(-1)
        return plain.view(RECORD)

    def rejects(self) -> np.ndarray:
        """Candidates that the program refused, an array of `REJECT`."""
        rejects = self._decoded()[64 * self.count :].view(REJECT)
        if len(rejects) and int(rejects["record"].max()) >= self.count:
            self.file.fail(self.offset, f"a reject of record {rejects['record'].max()}: the chunk has {self.count}")
        return rejects

    def verify(self) -> None:
        """Compares its checksum, and looks at every record's kind and flag of rejects; raises `FormatError` where it is damaged.

        Needs the package xxhash, and zstandard where the chunk is compressed.
        """
        head = self.file.struct(self.offset, "chunk header", _CHUNK)
        self.file.check(self.offset, self._body(), int(head["checksum"]), "the chunk")
        queries = self.queries()
        if (queries["kind"] > 1).any():
            self.file.fail(self.offset, f"kind {queries['kind'].max()} of a record: expected 0 or 1")
        refused = np.zeros(self.count, bool)
        refused[self.rejects()["record"]] = True
        if ((queries["flags"] & 4 != 0) != refused).any():
            self.file.fail(self.offset, "flag bit 2 is not set in exactly the records that have rejects")


class Rays:
    """A recording. `len()` is its number of queries; iterating gives its chunks."""

    def __init__(self, path: Path, verify: bool = False) -> None:
        self._file = Mapped(path, b"\x89RAYS\r\n\x1a", 64)
        header = self._file.struct(0, "header", _HEADER)
        #: Checksum of the scene's triangles, as in the `.bvh`; 0 when it is unknown.
        self.fingerprint = int(header["fingerprint"])
        #: Embree's version, such as 31305; 0 when it was not Embree.
        self.embree_version = int(header["embree"])
        self.deterministic = bool(header["flags"] & 1)
        self.producer = text(header["producer"])
        #: Whether the recording has its end; a killed one has not, and what was whole of it is here all the same.
        self.complete = len(self._file.data) >= 144 and self._file.data[-8:].tobytes() == _END
        #: Chunks in file order. Those of a killed recording go as far as the first that is damaged or not whole.
        self.chunks: List[Chunk] = self._indexed(verify) if self.complete else list(self._walk(len(self._file.data)))
        if verify:
            for chunk in self.chunks:
                chunk.verify()

    def _indexed(self, verify: bool) -> List[Chunk]:
        # With its end, a file has all that its index names, or it is damaged.
        size = len(self._file.data)
        at = int(self._file.bytes(size - 16, 8, "place of the index").view("<u8")[0])
        if at % 64 or not 64 <= at <= size - 80:
            self._file.fail(size - 16, f"the index at {at}: expected a multiple of 64 before the end")
        head = self._file.struct(at, "index", _CHUNK)
        stored = int(head["stored"])
        if head["magic"] != b"RIDX" or head["codec"] != 0 or stored != size - 80 - at or stored != int(head["decoded"]) or stored % 16:
            self._file.fail(at, f"magic {bytes(head['magic'])!r}, {stored} bytes: expected an index of {size - 80 - at} bytes")
        body = self._file.bytes(at + 64, stored, "index")
        if verify:
            self._file.check(at, body, int(head["checksum"]), "the index")
        chunks = list(self._walk(at))
        for number, (chunk, entry) in enumerate(zip(chunks, body.view(_ENTRY))):
            if (chunk.offset, chunk.count, chunk.reject_count) != tuple(int(value) for value in entry):
                self._file.fail(at + 64 + 16 * number, f"entry {number} of the index is not what the chunk at {chunk.offset} says")
        if len(chunks) != stored // 16:
            self._file.fail(chunks[-1].end if chunks else 64, f"{len(chunks)} whole chunks before, of {stored // 16} in the index: expected one")
        return chunks

    def _walk(self, size: int) -> Iterator[Chunk]:
        at = 64
        while at + 64 <= size:
            head = self._file.struct(at, "chunk header", _CHUNK)
            stored, records, rejects = int(head["stored"]), int(head["records"]), int(head["rejects"])
            if head["magic"] != b"RCHK" or at + 64 + stored > size:
                # The rest was being written when the program ended.
                return
            codec, decoded = int(head["codec"]), int(head["decoded"])
            if codec > 1:
                self._file.fail(at + 4, f"codec {codec}: expected 0 or 1")
            if records > _MOST_RECORDS:
                self._file.fail(at + 8, f"{records} records: a chunk has at most {_MOST_RECORDS}")
            if decoded != 64 * records + 8 * rejects or (codec == 0 and stored != decoded):
                self._file.fail(at + 32, f"{stored} bytes, {decoded} decoded, for {records} records and {rejects} rejects")
            if codec == 1 and decoded > _MOST_DECODED:
                self._file.fail(at + 40, f"{decoded} bytes decoded: at most {_MOST_DECODED}")
            yield Chunk(
                self._file, at, int(head["scene"]), int(head["thread"]), int(head["sequence"]), records, rejects, codec == 1
            )
            at = (at + 64 + stored + 63) // 64 * 64

    def __len__(self) -> int:
        return sum(len(chunk) for chunk in self.chunks)

    def __iter__(self) -> Iterator[Chunk]:
        return iter(self.chunks)

    def queries(self, scene: Optional[int] = None) -> np.ndarray:
        """All queries, or those of one scene, in one array of `RECORD`: a copy, unless there is one raw chunk."""
        parts = [chunk.queries() for chunk in self.chunks if scene is None or chunk.scene == scene]
        return parts[0] if len(parts) == 1 else np.concatenate(parts or [np.zeros(0, RECORD)])

    def column(self, name: str, scene: Optional[int] = None) -> np.ndarray:
        """One field of all queries, such as `"t"`: reads a chunk at a time, so only the column has to fit into memory."""
        parts = [np.array(chunk.queries()[name]) for chunk in self.chunks if scene is None or chunk.scene == scene]
        return np.concatenate(parts or [np.zeros(0, RECORD)[name]])


def open_rays(path: Path, verify: bool = False) -> Rays:
    """Opens a recording. Its structure is checked always, its checksums where `verify` is set (which reads all of it).

    Raises `FormatError` for what is no recording or is damaged, and `OSError` for what cannot be read.
    """
    return Rays(path, verify)
