"""Recordings (`.rays`) and trees (`.bvh`) of embree-trace as NumPy arrays, and its commands as functions.

    rays = embree_trace.open_rays("casts.rays")
    tree = embree_trace.open_bvh("built.bvh")

What is raw in a file is mapped, not copied: an array is there at once, and its bytes are read when they are looked at. The formats are
specified in docs/formats.md.
"""

from .bvh import Bvh, open_bvh
from .commands import CommandError, build, compare
from .files import FormatError
from .rays import Chunk, Rays, open_rays

__all__ = ["Bvh", "Chunk", "CommandError", "FormatError", "Rays", "build", "compare", "open_bvh", "open_rays"]
