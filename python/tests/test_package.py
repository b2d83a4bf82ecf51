"""Against what the geometry says and what the commands say of the same files; and bad files by the hundred.

    EMBREE_TRACE_BIN=target/debug PYTHONPATH=python python3 -m unittest discover python/tests
"""

import contextlib
import io
import json
import os
import pathlib
import random
import re
import struct
import subprocess
import tempfile
import tracemalloc
import unittest

import numpy as np
import xxhash
import zstandard

import embree_trace
from embree_trace import FormatError, open_bvh, open_rays

ROOT = pathlib.Path(__file__).resolve().parents[2]
BIN = pathlib.Path(os.environ["EMBREE_TRACE_BIN"]).resolve()
# The page is run in another directory.
os.environ["EMBREE_TRACE_BIN"] = str(BIN)


def run(*words):
    return subprocess.run([str(BIN / words[0]), *map(str, words[1:])], check=True, capture_output=True, text=True).stdout


def setUpModule():
    global directory, work
    directory = tempfile.TemporaryDirectory()
    work = pathlib.Path(directory.name)
    run("make-scene", "courtyard", work / "scene.obj", "--detail", 1)
    for name, more in [("casts", []), ("packed", ["--compress"])]:
        run("embree-trace", work / "scene.obj", "--size", "40x30", "--seed", 1, *more,
            "--savetrace", work / f"{name}.rays", work / "built.bvh")


def tearDownModule():
    directory.cleanup()


class Files(unittest.TestCase):
    def test_hits_lie_on_the_triangles_that_they_name(self):
        casts, tree = open_rays(work / "casts.rays", verify=True).queries(), open_bvh(work / "built.bvh", verify=True)
        hits = casts[(casts["triangle"] != 0xFFFFFFFF) & (casts["kind"] == 0)]
        self.assertGreater(len(hits), 1000)
        along = hits["origin"] + hits["t"][:, None] * hits["direction"]
        corners, u, v = tree.triangles[hits["triangle"]], hits["u"][:, None], hits["v"][:, None]
        inside = (1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
        size = np.linalg.norm(tree.nodes["upper"][0] - tree.nodes["lower"][0])
        self.assertLess(np.abs(along - inside).max(), 1e-4 * size)

    def test_boxes_hold_what_is_below(self):
        tree = open_bvh(work / "built.bvh")
        seen = np.zeros(len(tree.triangles), int)
        for node in np.flatnonzero(tree.is_leaf):
            corners = tree.triangles[tree.leaf_triangles(node)].reshape(-1, 3)
            self.assertTrue((corners >= tree.nodes["lower"][node]).all() and (corners <= tree.nodes["upper"][node]).all())
            seen[tree.leaf_triangles(node)] += 1
        self.assertTrue((seen == 1).all())
        with self.assertRaises(ValueError):
            tree.leaf_triangles(0)

    def test_the_commands_say_the_same(self):
        rays, tree = open_rays(work / "casts.rays"), open_bvh(work / "built.bvh")
        said, of_tree = (
            json.loads(run("trace-info", work / name, "--format", "json")) for name in ("casts.rays", "built.bvh")
        )
        depths = rays.column("depth")
        for depth, expected in said["by_depth"].items():
            own = rays.queries()[depths == int(depth)]
            self.assertEqual((len(own), int((own["flags"] & 1).sum())), (expected["queries"], expected["hits"]))
        self.assertEqual(sum(depth["queries"] for depth in said["by_depth"].values()), len(rays))
        self.assertEqual((f"{tree.fingerprint:016x}", tree.depth), (of_tree["fingerprint"], of_tree["depth"]))
        self.assertEqual([int(count) for count in tree.geometries["triangle_count"]],
                         [geometry["triangle_count"] for geometry in of_tree["geometries"]])
        self.assertEqual(rays.fingerprint, tree.fingerprint)
        self.assertTrue(rays.complete)

    def test_raw_chunks_are_views_and_compressed_ones_the_same(self):
        raw = open_rays(work / "casts.rays")
        self.assertTrue(any(isinstance(base, np.memmap) for base in bases(raw.chunks[0].queries())))
        packed = open_rays(work / "packed.rays", verify=True)
        self.assertTrue(packed.chunks[0].compressed)
        self.assertEqual(packed.queries().tobytes(), raw.queries().tobytes())
        self.assertEqual(raw.column("t").tobytes(), raw.queries()["t"].tobytes())

    def test_damage_is_told_or_harmless(self):
        chance = random.Random(1)
        for name, opens in [("casts.rays", open_rays), ("packed.rays", open_rays), ("built.bvh", open_bvh)]:
            whole = (work / name).read_bytes()
            damaged = [whole[: chance.randrange(len(whole))] for _ in range(60)]
            for _ in range(200):
                bits = bytearray(whole)
                # Headers are hit often enough this way.
                place = chance.randrange(min(len(bits), chance.choice([64, 400, len(bits)])))
                bits[place] ^= 1 << chance.randrange(8)
                damaged.append(bytes(bits))
            told = 0
            for number, content in enumerate(damaged):
                path = work / "damaged"
                path.write_bytes(content)
                try:
                    opened = opens(path, verify=True)
                    if opens is open_rays:
                        opened.queries()
                        [chunk.rejects() for chunk in opened]
                except FormatError as error:
                    told += 1
                    self.assertIn("damaged: at byte", str(error))
                    self.assertNotIn("\n", str(error))
            self.assertGreater(told, 60, name)

    def refuse(self, content, opens, what, verify=True):
        (work / "hostile").write_bytes(content)
        with self.assertRaisesRegex(FormatError, what):
            opened = opens(work / "hostile", verify=verify)
            if opens is open_rays:
                opened.queries()

    def test_a_whole_recording_that_lost_a_chunk_is_damaged(self):
        """The end says that it is whole, so what the index names has to be there, whether checksums are looked at or not."""
        whole = (work / "casts.rays").read_bytes()
        chunks = open_rays(work / "casts.rays").chunks
        self.assertGreater(len(chunks), 1)
        for chunk in chunks:
            for magic in (b"RIDX", b"SCHK"):
                content = bytearray(whole)
                content[chunk.offset : chunk.offset + 4] = magic
                for verify in (False, True):
                    self.refuse(content, open_rays, f"at byte {chunk.offset}:", verify)
        index = int.from_bytes(whole[-16:-8], "little")
        for place in (index, index + 33, index + 64, index + 72, len(whole) - 16):
            content = bytearray(whole)
            content[place] ^= 1
            self.refuse(content, open_rays, "damaged|index", False)
        content = bytearray(whole)
        content[index + 48] ^= 1
        self.refuse(content, open_rays, "checksum of the index")
        # One that was killed is no error: it has what was whole.
        (work / "killed.rays").write_bytes(whole[: chunks[-1].offset + 500])
        killed = open_rays(work / "killed.rays", verify=True)
        self.assertFalse(killed.complete)
        self.assertEqual(len(killed), sum(map(len, chunks[:-1])))

    def test_a_frame_decodes_to_what_its_chunk_says_and_takes_no_more_memory(self):
        whole = (work / "packed.rays").read_bytes()

        def killed(frame, records):
            head = struct.pack("<4sBBHIIIIQQQQQ", b"RCHK", 1, 0, 0, records, 0, 0, 0, 0, len(frame), 64 * records,
                               xxhash.xxh3_64_intdigest(frame), 0)
            return whole[:64] + head + frame

        good = zstandard.ZstdCompressor().compress(bytes(640))
        (work / "hostile").write_bytes(killed(good, 10))
        self.assertEqual(len(open_rays(work / "hostile", verify=True)), 10)
        terabytes = b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 1 << 42) + b"\x01\0\0"
        bomb = zstandard.ZstdCompressor().compress(bytes(200 << 20))
        for frame in (good + good, good[:-1], b"", terabytes, bomb):
            for verify in (False, True):
                content = killed(frame, 10)
                tracemalloc.start()
                self.addCleanup(tracemalloc.stop)
                self.refuse(content, open_rays, "at byte 64: chunk", verify)
                self.assertLess(tracemalloc.get_traced_memory()[1], 64 << 20)
                tracemalloc.stop()

    def test_a_tree_whose_checksums_hold_is_still_a_tree(self):
        whole = (work / "built.bvh").read_bytes()
        tree = open_bvh(work / "built.bvh")
        count = int.from_bytes(whole[112:116], "little")
        entries = {}
        for number in range(count):
            tag, size, offset, length = struct.unpack_from("<4sIQQ", whole, 128 + 32 * number)
            entries[tag.decode()] = (128 + 32 * number, offset, size * length)

        def written(tag, place, value):
            """With `value` there in a section, or in the header where there is no tag; and with checksums that hold."""
            content = bytearray(whole)
            place += entries[tag][1] if tag else 0
            content[place : place + len(value)] = value
            for entry, offset, size in entries.values():
                content[entry + 24 : entry + 32] = struct.pack("<Q", xxhash.xxh3_64_intdigest(bytes(content[offset : offset + size])))
            content[120:128] = struct.pack("<Q", xxhash.xxh3_64_intdigest(bytes(content[128 : 128 + 32 * count])))
            return content

        inner = np.flatnonzero(~tree.is_leaf)
        last, first = int(inner[-1]), int(tree.nodes["first"][inner[-1]])
        leaf = int(np.flatnonzero(tree.is_leaf)[0])
        for what, content in [
            ("a parent", written("NODE", 32 * last + 12, struct.pack("<I", first - 1))),
            ("entry of PRIM", written("NODE", 32 * leaf + 12, struct.pack("<I", int(tree.nodes["first"][leaf]) + 1))),
            ("not a number", written("NODE", 0, struct.pack("<f", float("nan")))),
            ("fingerprint", written("TRIS", 0, struct.pack("<f", 12345.0))),
            ("a geometry", written("GEOM", 12, struct.pack("<I", 1_000_000_000))),
        ]:
            for verify in (False, True):
                self.refuse(content, open_bvh, what, verify)
        for what, content in [
            ("depth 999", written("", 56, struct.pack("<I", 999))),
            ("bounds", written("", 24, struct.pack("<f", -12345.0))),
            ("primitives", written("", 52, struct.pack("<I", 999))),
            ("several leaves", written("PRIM", 0, struct.pack("<I", int(tree.primitives[1])))),
        ]:
            self.refuse(content, open_bvh, what)
        # A META so deep that a parser gives up; it stands behind the file.
        deep = b"[" * 200_000
        content = bytearray(whole) + bytes(-len(whole) % 64)
        struct.pack_into("<QQQ", content, entries["META"][0] + 8, len(content), len(deep), xxhash.xxh3_64_intdigest(deep))
        self.refuse(content + deep, open_bvh, "META", False)

    def test_what_is_no_file_of_ours_is_refused(self):
        for content in [b"", b"\x89RAYS\r\n\x1a", b"\x89BVH\r\n\x1a\n" + bytes(8), b"v 0 0 0\n" * 40]:
            (work / "other").write_bytes(content)
            for opens in (open_rays, open_bvh):
                with self.assertRaises(FormatError):
                    opens(work / "other")
        with self.assertRaises(OSError):
            open_rays(work / "none.rays")


class Commands(unittest.TestCase):
    def test_a_bad_option_is_the_one_line_of_the_command(self):
        with self.assertRaises(embree_trace.CommandError) as caught:
            embree_trace.build(work / "built.bvh", work / "no.bvh", splits="none")
        self.assertEqual(caught.exception.code, 2)
        self.assertTrue(str(caught.exception).startswith("bvh-build: error: "))

    def test_the_reader_of_the_formats_page(self):
        """Runs the code of docs/formats.md as it stands there, beside trace-info and the package."""
        page = (ROOT / "docs/formats.md").read_text()
        (code,) = re.findall(r"```python\n(.*?)```", page, re.S)
        names, before, out = {}, os.getcwd(), io.StringIO()
        os.chdir(work)
        self.addCleanup(os.chdir, before)
        with contextlib.redirect_stdout(out):
            exec(compile(code, "docs/formats.md", "exec"), names)
        said, of_tree = (json.loads(run("trace-info", work / name, "--format", "json")) for name in ("casts.rays", "built.bvh"))
        casts = names["casts"]
        self.assertTrue(out.getvalue().startswith(f"{len(casts)} queries; "))
        for depth, expected in said["by_depth"].items():
            own = casts[casts["depth"] == int(depth)]
            self.assertEqual((len(own), int((own["flags"] & 1).sum())), (expected["queries"], expected["hits"]))
        self.assertEqual(sum(depth["queries"] for depth in said["by_depth"].values()), len(casts))
        packed = np.concatenate(list(names["queries"]("packed.rays")))
        self.assertEqual(packed.tobytes(), casts.tobytes())
        nodes, primitives, triangles = names["tree"]("built.bvh")
        self.assertEqual((len(nodes), len(primitives), len(triangles)), tuple(of_tree[key] for key in ("nodes", "primitives", "triangles")))
        # A recording that was killed in its last chunk.
        chunks = open_rays("casts.rays").chunks
        (work / "killed.rays").write_bytes((work / "casts.rays").read_bytes()[: chunks[-1].offset + 501])
        self.assertEqual([len(part) for part in names["queries"]("killed.rays")], [len(chunk) for chunk in chunks[:-1]])

    def test_the_page_does_what_it_says(self):
        """Runs the blocks of docs/python.md one after the other; what a block prints has to be what stands below it."""
        page = (ROOT / "docs/python.md").read_text()
        blocks = re.findall(r"```python\n(.*?)```\n(?:\n```text\n(.*?)```)?", page, re.S)
        self.assertGreater(len(blocks), 4)
        names, before = {}, os.getcwd()
        os.chdir(work)
        self.addCleanup(os.chdir, before)
        for code, expected in blocks:
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                exec(compile(code, "docs/python.md", "exec"), names)
            if expected:
                self.assertEqual(out.getvalue(), expected, code)


def bases(array):
    while array is not None:
        yield array
        array = getattr(array, "base", None)


if __name__ == "__main__":
    unittest.main()
