"""Trees: `.bvh` files, section by section as arrays."""

from __future__ import annotations

import json
from typing import Dict, Optional

import numpy as np

from .files import Mapped, Path, text

#: A node: its box, and its children (an inner node) or its entries of `primitives` (a leaf, bit 31 of `count`).
NODE = np.dtype([("lower", "<f4", 3), ("first", "<u4"), ("upper", "<f4", 3), ("count", "<u4")])
#: A geometry of the recorded scene, and which triangles are its.
GEOMETRY = np.dtype(
    [
        ("instance", "<u4"), ("geometry", "<u4"), ("first_triangle", "<u4"), ("triangle_count", "<u4"),
        ("mask", "<u4"), ("kind", "<u4"), ("flags", "<u4"), ("instance_mask", "<u4"),
    ]
)
LEAF = np.uint32(0x8000_0000)

_HEADER = np.dtype(
    [
        ("", "V16"), ("fingerprint", "<u8"), ("lower", "<f4", 3), ("upper", "<f4", 3), ("max_children", "<u4"),
        ("max_leaf", "<u4"), ("depth", "<u4"), ("flags", "<u4"), ("producer", "S48"), ("sections", "<u4"), ("", "V4"), ("checksum", "<u8"),
    ]
)
_ENTRY = np.dtype([("tag", "S4"), ("bytes", "<u4"), ("offset", "<u8"), ("count", "<u8"), ("checksum", "<u8")])
_SIZES = {b"NODE": 32, b"PRIM": 4, b"TRIS": 36, b"GEOM": 32, b"ORDR": 1, b"META": 1}
_NEEDED = (b"NODE", b"PRIM", b"TRIS", b"GEOM")


class Bvh:
    """A tree and its triangles. All arrays are views of the file."""

    def __init__(self, path: Path, verify: bool = False) -> None:
        self._file = Mapped(path, b"\x89BVH\r\n\x1a\n", 128)
        header = self._file.struct(0, "header", _HEADER)
        #: Checksum of the triangles; a recording of the same scene has the same.
        self.fingerprint = int(header["fingerprint"])
        self.depth, self.max_children, self.max_leaf = (int(header[name]) for name in ("depth", "max_children", "max_leaf"))
        self.flags, self.producer = int(header["flags"]), text(header["producer"])
        sections = self._sections(int(header["sections"]), int(header["checksum"]), verify)
        #: Array of `NODE`; node 0 is the root.
        self.nodes: np.ndarray = sections[b"NODE"].view(NODE)
        #: Indices of triangles, as leaves list them.
        self.primitives: np.ndarray = sections[b"PRIM"].view("<u4")
        #: n by 3 vertices by 3 coordinates, in world space.
        self.triangles: np.ndarray = sections[b"TRIS"].view("<f4").reshape(-1, 3, 3)
        self.geometries: np.ndarray = sections[b"GEOM"].view(GEOMETRY)
        #: Order of children for occlusion queries, one per node; `None` where the tree has none.
        self.order: Optional[np.ndarray] = sections.get(b"ORDR")
        #: How the tree was built.
        self.meta: dict = self._meta(sections.get(b"META"))
        recorded = self.meta.get("recorded")
        #: Number of its scene in the recording that it comes from, for `Rays.queries(scene)`; `None` where the tree does not say.
        self.scene: Optional[int] = recorded.get("number") if isinstance(recorded, dict) else None
        self._check()
        if verify:
            self._check_header(header)

    def _sections(self, count: int, checksum: int, verify: bool) -> Dict[bytes, np.ndarray]:
        table = self._file.bytes(128, 32 * count, "section table").view(_ENTRY)
        if verify:
            self._file.check(128, table.view(np.uint8), checksum, "the section table")
        sections: Dict[bytes, np.ndarray] = {}
        for number, entry in enumerate(table):
            at, tag, length = 128 + 32 * number, bytes(entry["tag"]), int(entry["bytes"])
            if tag not in _SIZES:
                continue
            if tag in sections or length != _SIZES[tag]:
                self._file.fail(at, f"section {tag.decode()}: there twice, or of elements of {length} bytes")
            offset = int(entry["offset"])
            if offset % 64:
                self._file.fail(at + 8, f"section {tag.decode()} at {offset}: expected a multiple of 64")
            sections[tag] = self._file.bytes(offset, length * int(entry["count"]), f"section {tag.decode()}")
            if verify:
                self._file.check(offset, sections[tag], int(entry["checksum"]), f"section {tag.decode()}")
            if tag == b"TRIS" and int(entry["checksum"]) != self.fingerprint:
                self._file.fail(16, f"scene fingerprint {self.fingerprint:016x}: the checksum of TRIS is {int(entry['checksum']):016x}")
        for tag in _NEEDED:
            if tag not in sections:
                self._file.fail(128, f"there is no section {tag.decode()}")
        return sections

    def _meta(self, section: Optional[np.ndarray]) -> dict:
        if section is None:
            return {}
        try:
            meta = json.loads(section.tobytes())
        except (ValueError, RecursionError) as error:
            self._file.fail(128, f"section META: {error}")
        return meta if isinstance(meta, dict) else {}

    def _check(self) -> None:
        nodes = self.nodes
        if not len(nodes):
            self._file.fail(128, "section NODE is empty: there is no root")
        leaf, count = self.is_leaf, (nodes["count"] & ~LEAF).astype(np.int64)
        end = nodes["first"].astype(np.int64) + count
        inner = ~leaf
        if (end[leaf & (count > 0)] > len(self.primitives)).any() or (end[inner] > len(nodes)).any():
            self._file.fail(128, "a node whose children or primitives are not there")
        if (count[inner] == 0).any() or (nodes["first"][inner] <= np.flatnonzero(inner)).any():
            self._file.fail(128, "an inner node that has no children, or does not stand before them")
        if len(self.primitives) and int(self.primitives.max()) >= len(self.triangles):
            self._file.fail(128, f"triangle {self.primitives.max()}: there are {len(self.triangles)}")
        if (_covered(nodes["first"][inner], count[inner], len(nodes))[1:] != 1).any():
            self._file.fail(128, "a node without a parent, or with several")
        filled = leaf & (count > 0)
        if (_covered(nodes["first"][filled], count[filled], len(self.primitives)) != 1).any():
            self._file.fail(128, "an entry of PRIM in no leaf, or in several")
        if np.isnan(nodes["lower"]).any() or np.isnan(nodes["upper"]).any():
            self._file.fail(128, "a box with a coordinate that is not a number")
        first = self.geometries["first_triangle"].astype(np.int64)
        ends = first + self.geometries["triangle_count"]
        if (first[1:] < ends[:-1]).any() or (ends > len(self.triangles)).any():
            self._file.fail(128, f"a geometry whose triangles are another's, or not among the {len(self.triangles)}")
        if self.order is not None and (len(self.order) != len(nodes) or (self.order > 3).any()):
            self._file.fail(128, f"section ORDR: expected {len(nodes)} values of 0 to 3")

    def _check_header(self, header: np.void) -> None:
        nodes, leaf = self.nodes, self.is_leaf
        count = (nodes["count"] & ~LEAF).astype(np.int64)
        for name in ("lower", "upper"):
            if not np.array_equal(header[name], nodes[name][0]):
                self._file.fail(24, f"bounds, {name}: not the root's")
        children = int(count[~leaf].max(initial=0))
        # Of a tree without inner nodes any width is right.
        if children > self.max_children or int(count[leaf].max(initial=0)) != self.max_leaf:
            self._file.fail(48, f"at most {self.max_children} children and {self.max_leaf} primitives: not those of the content")
        if not self.flags & 1 and (np.bincount(self.primitives, minlength=1) > 1).any():
            self._file.fail(60, "a triangle in several leaves, and flag bit 0 is not set")
        # Level after level: the nodes below those of one are the next.
        level, depth = np.zeros(1, np.int64), 0
        while len(level) and depth <= self.depth:
            depth += 1
            inner = level[~leaf[level]]
            own = count[inner]
            starts = np.repeat(nodes["first"][inner].astype(np.int64) - (np.cumsum(own) - own), own)
            level = starts + np.arange(len(starts))
        if depth != self.depth:
            self._file.fail(56, f"depth {self.depth}: not that of the content")

    @property
    def is_leaf(self) -> np.ndarray:
        """For each node, whether it is a leaf."""
        return (self.nodes["count"] & LEAF) != 0

    def areas(self) -> np.ndarray:
        """Surface area of each node's box, float64; 0 where it is empty."""
        sides = np.maximum(self.nodes["upper"].astype(np.float64) - self.nodes["lower"], 0)
        return 2 * (sides[:, 0] * sides[:, 1] + sides[:, 1] * sides[:, 2] + sides[:, 2] * sides[:, 0])

    def leaf_triangles(self, node: int) -> np.ndarray:
        """Triangles of a leaf."""
        first, count = int(self.nodes["first"][node]), int(self.nodes["count"][node])
        if not count & int(LEAF):
            raise ValueError(f"node {node} is not a leaf")
        return self.primitives[first : first + (count & 0x7FFF_FFFF)]


def _covered(first: np.ndarray, count: np.ndarray, length: int) -> np.ndarray:
    """In how many of the ranges of `count` from `first` each of 0 to `length` is; the ranges end at `length` or before."""
    starts = np.bincount(first.astype(np.int64), minlength=length + 1)
    ends = np.bincount(first.astype(np.int64) + count, minlength=length + 1)
    return np.cumsum(starts - ends)[:length]


def open_bvh(path: Path, verify: bool = False) -> Bvh:
    """Opens a tree. Its structure is checked always, its checksums where `verify` is set (which reads all of it).

    Raises `FormatError` for what is no tree or is damaged, and `OSError` for what cannot be read.
    """
    return Bvh(path, verify)
