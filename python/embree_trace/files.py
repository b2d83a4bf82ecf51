"""What both formats share: a mapped file whose bytes are only looked at where they are, and one kind of error."""

from __future__ import annotations

import os
from typing import Union

import numpy as np

Path = Union[str, "os.PathLike[str]"]


class FormatError(ValueError):
    """A file that is not what it should be: which, where, and what was found."""


class Mapped:
    """A file, mapped read-only."""

    def __init__(self, path: Path, magic: bytes, header: int) -> None:
        self.path = os.fspath(path)
        size = os.path.getsize(self.path)
        # NumPy cannot map nothing.
        self.data = np.memmap(self.path, np.uint8, "r") if size else np.zeros(0, np.uint8)
        if self.data[: len(magic)].tobytes() != magic:
            self.fail(0, f"not a {'.rays' if b'RAYS' in magic else '.bvh'} file")
        found = self.struct(0, "version", np.dtype([("", "V8"), ("major", "<u2"), ("minor", "<u2"), ("header", "<u4")]))
        if found["major"] != 1:
            self.fail(8, f"major version {found['major']}: this reader knows version 1")
        if found["header"] != header or size < header:
            self.fail(12, f"a header of {found['header']} bytes in a file of {size}: expected {header}")

    def fail(self, offset: int, what: str) -> None:
        """Raises the error of a place in the file."""
        raise FormatError(f"{self.path}: at byte {offset}: {what}")

    def bytes(self, offset: int, length: int, what: str) -> np.ndarray:
        """`length` bytes from `offset`, as a view."""
        if length < 0 or offset < 0 or offset + length > len(self.data):
            self.fail(offset, f"{what} of {length} bytes: the file has {len(self.data)} bytes")
        return self.data[offset : offset + length]

    def struct(self, offset: int, what: str, dtype: np.dtype) -> np.void:
        """One value of a structure, as a view."""
        return self.bytes(offset, dtype.itemsize, what).view(dtype)[0]

    def check(self, offset: int, body: np.ndarray, expected: int, what: str) -> None:
        """Compares the checksum of `body`, XXH3-64, with what the file says."""
        try:
            import xxhash
        except ImportError as error:
            raise ImportError("verify=True needs the package xxhash (Debian: python3-xxhash)") from error
        found = xxhash.xxh3_64_intdigest(memoryview(np.ascontiguousarray(body)))
        if found != expected:
            self.fail(offset, f"the checksum of {what} is {found:016x}, the file says {expected:016x}: it is damaged")


def text(field: bytes) -> str:
    """Text that is filled up with zeros; NumPy has cut them off."""
    return field.decode("utf-8", "replace")
