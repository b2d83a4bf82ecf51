"""The commands `bvh-build` and `bvh-compare` as functions: they are run as they are installed."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from typing import Iterable, List, Sequence, Union

from .files import Path

#: Where the commands are looked for before the PATH, when this is set in the environment.
DIRECTORY = "EMBREE_TRACE_BIN"


class CommandError(RuntimeError):
    """A command that did not do its work: its one line, and `code`, with which it ended."""

    def __init__(self, line: str, code: int) -> None:
        super().__init__(line)
        self.code = code


def _options(options: dict) -> List[str]:
    """`max_leaf=4` as `--max-leaf 4`, `order=True` as `--order`, a sequence with commas; nothing for `None` and `False`."""
    words: List[str] = []
    for name, value in options.items():
        if value is None or value is False:
            continue
        words.append("--" + name.replace("_", "-"))
        if value is not True:
            several = isinstance(value, Iterable) and not isinstance(value, (str, os.PathLike))
            words.append(",".join(map(str, value)) if several else os.fspath(value) if isinstance(value, os.PathLike) else str(value))
    return words


def _run(command: str, words: Sequence[str], good: Sequence[int] = (0,)) -> str:
    directory = os.environ.get(DIRECTORY)
    program = os.path.join(directory, command) if directory else shutil.which(command)
    if program is None:
        raise CommandError(f"{command} is not on the PATH: install it (cargo install --path .), or set {DIRECTORY}", 127)
    try:
        ended = subprocess.run([program, *words], capture_output=True, text=True, check=False)
    except OSError as error:
        raise CommandError(f"{command}: {error}", 127) from error
    if ended.returncode not in good:
        raise CommandError(ended.stderr.strip() or f"{command} ended with code {ended.returncode}", ended.returncode)
    return ended.stdout


def build(tree: Path, out: Path, **options: object) -> dict:
    """Builds another tree over the triangles of `tree` and writes it to `out`; returns what `bvh-build` says of it.

    Options are those of the command: `build("built.bvh", "ours.bvh", rays="casts.rays", train=0.1, max_leaf=4)`.
    """
    return json.loads(_run("bvh-build", [os.fspath(tree), os.fspath(out), *_options(options), "--format", "json"]))


def compare(trees: Union[Path, Sequence[Path]], rays: Path, **options: object) -> dict:
    """Replays a recording over one or more trees; returns what `bvh-compare --format json` prints.

    A wrong answer is no error here: it is in `mismatches` of the result.
    """
    several = [trees] if isinstance(trees, (str, os.PathLike)) else list(trees)
    paths = [os.fspath(path) for path in [*several, rays]]
    return json.loads(_run("bvh-compare", [*paths, *_options(options), "--format", "json"], good=(0, 1)))
