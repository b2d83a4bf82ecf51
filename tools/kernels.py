#!/usr/bin/env python3
"""Time that Embree's own kernels take on trees of ours, for queries that these have not seen, and
whether their answers stay: `tools/held-out --embree`.

Each scene is rendered twice with different seeds. The one recording trains, the other is asked: on
Embree's trees of medium and high quality, on the best tree from area alone and on the best from the
training queries, both of `bvh-build` with the same budget and chosen by the same queries. All of
them take turns in every round, on one thread. Then all queries of the recording are asked on Embree's tree and on the planted one,
singly and in packets, with the kernels of three instruction sets, default and robust.

What was measured of a scene is kept in a folder, one JSON file for times and one for the answers of
each kind of kernels; what is there is not measured again, so a run that was broken off goes on. The
tables and the figure are made from these files alone.
"""

import argparse
import datetime
import json
import os
import pathlib
import subprocess
import sys
import time

from kernels_tables import figure, page, ratio, to_best, to_medium

ROOT = pathlib.Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs/performance.md"
FIGURE = ROOT / "docs/images/kernels.svg"
KERNELS = [(isa, robust) for isa in ("sse42", "avx2", "avx512") for robust in (False, True)]
TREES = ["area", "ours"]


def arguments():
    parser = argparse.ArgumentParser(
        prog="tools/held-out --embree",
        description="Embree's kernels on trees of ours, on held-out queries: measures, then writes "
        "docs/performance.md and the figure of the README.",
    )
    parser.add_argument(
        "scenes",
        nargs="*",
        type=pathlib.Path,
        help="all of ../shared/scenes up to --most when none are named",
    )
    parser.add_argument(
        "--keep",
        type=pathlib.Path,
        default=ROOT / "target/kernels",
        help="folder of what was measured",
    )
    parser.add_argument(
        "--bin",
        type=pathlib.Path,
        default=os.environ.get("BIN"),
        help="folder of the commands; built when absent",
    )
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--depth", default="4", help="of paths")
    parser.add_argument("--budget", default="20", help="seconds for each of our trees")
    parser.add_argument("--rounds", default="5")
    parser.add_argument("--sample", default="400000", help="queries that are timed")
    parser.add_argument(
        "--most",
        type=int,
        default=2_000_000,
        help="triangles of a scene that is measured without being named",
    )
    parser.add_argument("--no-answers", action="store_true", help="only times")
    parser.add_argument(
        "--purposes",
        action="store_true",
        help="also a tree for camera queries, one for shadow queries, one from another camera's, and "
        "one from the asked queries themselves",
    )
    parser.add_argument(
        "--tables", action="store_true", help="measures nothing: tables and figure of what is kept"
    )
    return parser.parse_args()


class Bench:
    """Runs the commands, and keeps what they say."""

    def __init__(self, options):
        self.options = options
        self.bin = options.bin
        options.keep.mkdir(parents=True, exist_ok=True)
        if self.bin is None and not options.tables:
            names = ["embree-trace", "bvh-build", "bvh-compare", "trace-info"]
            build = [
                "cargo",
                "build",
                "--release",
                "--locked",
                "--quiet",
                *[word for name in names for word in ("--bin", name)],
            ]
            subprocess.run(build, cwd=ROOT, check=True)
            self.bin = ROOT / "target/release"

    def path(self, scene, ending):
        return self.options.keep / f"{scene}.{ending}"

    def answers_path(self, scene, kernels):
        return self.path(scene, f"{kernels.replace(' ', '-')}.answers.json")

    def run(self, command, *words, good=(0,)):
        words = [str(pathlib.Path(self.bin) / command), *map(str, words)]
        done = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        if done.returncode not in good:
            raise RuntimeError(f"{' '.join(words)}: {done.stderr.strip()}")
        return done

    def kept(self, path, measure):
        """What is in the file, or what `measure` gives, which is in it afterwards."""
        if path.exists():
            return json.loads(path.read_text())
        value = measure()
        unfinished = path.with_suffix(".new")
        unfinished.write_text(json.dumps(value, indent=1))
        unfinished.rename(path)
        return value

    def record(self, scene, name, seed, view=None, camera=()):
        """A recording of the scene, the tree that Embree built, and how many triangles it has."""
        key = view or seed
        rays, built, said = (
            self.path(name, f"{key}.rays"),
            self.path(name, "built.bvh" if view is None else f"{view}.built.bvh"),
            self.path(name, f"{key}.said"),
        )
        if not said.exists():
            options = [
                "--size",
                self.options.size,
                "--spp",
                1,
                "--max-depth",
                self.options.depth,
                "--seed",
                seed,
                *camera,
            ]
            said.write_text(
                self.run(
                    "embree-trace", scene, "--savetrace", rays, built, *options, "--format", "json"
                ).stdout
            )
        return rays, built, json.loads(said.read_text())["triangles"]

    def trees(self, scene, name):
        """Embree's tree, and ours in the order of TREES."""
        train, built, _ = self.record(scene, name, 1)
        paths = [self.path(name, f"{tree}.bvh") for tree in TREES]
        for path, control in zip(paths, (["--area-only"], [])):
            self.build(built, path, "--rays", train, *control)
        return built, paths

    def build(self, built, path, *words):
        if not path.exists():
            self.run("bvh-build", built, path, *words, "--budget", self.options.budget)

    def tree_for(self, scene, name, isa):
        """Our tree from rays, as wide as the nodes of that instruction set."""
        if isa != "sse42":
            return self.trees(scene, name)[1][-1]
        train, built, _ = self.record(scene, name, 1)
        path = self.path(name, "ours4.bvh")
        self.build(built, path, "--rays", train, "--width", 4)
        return path

    def times(self, scene, name):
        started, load = time.time(), os.getloadavg()[0]
        built, trees = self.trees(scene, name)
        asked, _, triangles = self.record(scene, name, 2)
        choice = ["--traversal", "odf", "--sample", self.options.sample]
        timing = ["--time", "--rounds", self.options.rounds, "--format", "json"]
        report = json.loads(
            self.run("bvh-compare", built, *trees, asked, *choice, *timing, good=(0, 1)).stdout
        )
        named = list(zip(["built", *TREES], report["trees"]))
        return {
            "date": datetime.date.today().isoformat(),
            "load": [load, os.getloadavg()[0]],
            "seconds": time.time() - started,
            "triangles": triangles,
            "budget": float(self.options.budget),
            "depth": int(self.options.depth),
            "timing": report["timing"],
            "embree": report["embree"],
            "trees": {key: tree["time"]["embree"] for key, tree in named},
            "our_traversal": {key: tree["traversals"]["odf"]["time"] for key, tree in named},
            "failures": report["failures"],
        }

    def other_camera(self, name):
        """Where else the scene may be looked at from: a quarter of a circle further for a camera
        outside; one inside goes half of the way to what it looks at and turns by a right angle."""
        said = json.loads(self.path(name, "1.said").read_text())
        eye, target, up = (vector(text) for text in said["camera"].split("/"))
        info = json.loads(
            self.run("trace-info", self.path(name, "built.bvh"), "--format", "json").stdout
        )
        lower, upper = info["lower"], info["upper"]
        sight = [b - a for a, b in zip(eye, target)]
        turned = quarter(sight, up)
        if all(low <= at <= high for low, at, high in zip(lower, eye, upper)):
            eye = [at + 0.5 * way for at, way in zip(eye, sight)]
            target = [at + way for at, way in zip(eye, turned)]
        else:
            eye = [at - way for at, way in zip(target, turned)]
        view = "/".join(",".join(f"{value:.9g}" for value in at) for at in (eye, target, up))
        return ["--camera", view, "--fov", said["fov_degrees"]]

    def purposes(self, scene, name):
        """Times of trees for some of the queries, of one from another camera, and of one from the
        asked queries themselves."""
        built, trees = self.trees(scene, name)
        asked, _, triangles = self.record(scene, name, 2)
        train, *_ = self.record(scene, name, 1)
        elsewhere, *_ = self.record(scene, name, 1, "elsewhere", self.other_camera(name))
        makings = {
            "camera": [train, "--filter", "purpose=camera"],
            "shadow": [train, "--filter", "purpose=shadow"],
            "elsewhere": [elsewhere],
            # What the same search makes of the very queries that are asked.
            "limit": [asked],
        }
        paths = {"ours": trees[-1]}
        for key, (rays, *words) in makings.items():
            paths[key] = self.path(name, f"{key}.bvh")
            self.build(built, paths[key], "--rays", rays, *words)
        choice = ["--traversal", "odf", "--sample", self.options.sample]
        timing = ["--time", "--rounds", self.options.rounds, "--format", "json"]
        words = [built, *paths.values(), asked, *choice, *timing]
        report = json.loads(self.run("bvh-compare", *words, good=(0, 1)).stdout)
        return {
            "date": datetime.date.today().isoformat(),
            "triangles": triangles,
            "budget": float(self.options.budget),
            "trees": {
                key: tree["time"]["embree"] for key, tree in zip(paths, report["trees"][1:])
            },
            "failures": report["failures"],
        }

    def answers(self, scene, name, isa, robust):
        started = time.time()
        tree = self.tree_for(scene, name, isa)
        asked, *_ = self.record(scene, name, 2)
        kernels = ["--embree", "--isa", isa, *(["--robust"] if robust else [])]
        found = self.run(
            "bvh-compare",
            tree,
            asked,
            "--traversal",
            "odf",
            *kernels,
            "--no-time",
            "--format",
            "json",
            good=(0, 1),
        )
        report = json.loads(found.stdout)
        # This processor has no such kernels, or the tree is not planted in scenes of that width.
        embree = report.get("embree") or {"answers": None}
        return {
            **report["trees"][0].get("time", {}).get("embree", {}),
            "own": embree["answers"],
            "date": datetime.date.today().isoformat(),
            "seconds": time.time() - started,
        }

    def clear(self, name):
        """Removes the large files; what was measured stays."""
        for path in self.options.keep.glob(f"{name}.*"):
            if path.suffix in (".rays", ".bvh", ".said"):
                path.unlink()


def vector(text):
    return [float(word) for word in text.split(",")]


def quarter(way, up):
    """The vector turned by a right angle around `up`."""
    length = sum(value * value for value in up) ** 0.5
    x, y, z = (value / length for value in up)
    along = x * way[0] + y * way[1] + z * way[2]
    across = [
        y * way[2] - z * way[1],
        z * way[0] - x * way[2],
        x * way[1] - y * way[0],
    ]
    return [along * axis + turned for axis, turned in zip((x, y, z), across)]


def kernels_name(isa, robust):
    return f"{isa} robust" if robust else isa


def write(text):
    """Puts the tables between their marks."""
    begin, end = "<!-- measured: kernels -->", "<!-- end: kernels -->"
    head, rest = PAGE.read_text().split(begin)
    PAGE.write_text(f"{head}{begin}\n\n{text}{end}{rest.split(end)[1]}")


def measure(bench, scene, is_named):
    """Times and answers of one scene, as far as they are not kept."""
    name = scene.name.split(".")[0]

    def tell(what):
        print(f"{name}{what}", file=sys.stderr)

    kept = bench.path(name, "times.json")
    if not is_named and not kept.exists():
        *_, triangles = bench.record(scene, name, 1)
        if triangles > bench.options.most:
            tell(f": left out, {triangles:,} triangles")
            bench.clear(name)
            return
    times = bench.kept(kept, lambda: bench.times(scene, name))
    medium, best = ratio(to_medium(times, "ours")), ratio(to_best(times, "ours"))
    tell(f": {medium} of medium, {best} of the best, {times['seconds']:.0f} s")
    if bench.options.purposes:
        bench.kept(bench.path(name, "purposes.json"), lambda: bench.purposes(scene, name))
    if bench.options.no_answers:
        return
    for isa, robust in KERNELS:
        kernels = kernels_name(isa, robust)
        path = bench.answers_path(name, kernels)
        found = bench.kept(path, lambda: bench.answers(scene, name, isa, robust))
        if found.get("answers"):
            tell(f", {kernels}: {found['answers']}, {found['seconds']:.0f} s")
        else:
            tell(f", {kernels}: not asked: {found.get('why', 'no such kernels here')}")
    bench.clear(name)


def load(bench):
    """What is kept: times by scene, the smallest first, answers by scene and kernels, and times of
    trees for some of the queries by scene."""
    paths = bench.options.keep.glob("*.times.json")
    times = {path.name.split(".")[0]: json.loads(path.read_text()) for path in paths}
    times = dict(sorted(times.items(), key=lambda item: item[1]["triangles"]))
    answers = {}
    for name in times:
        for kernels in (kernels_name(*kernels) for kernels in KERNELS):
            path = bench.answers_path(name, kernels)
            if path.exists():
                answers.setdefault(name, {})[kernels] = json.loads(path.read_text())
    purposes = {}
    for name in times:
        path = bench.path(name, "purposes.json")
        if path.exists():
            purposes[name] = json.loads(path.read_text())
    return times, answers, purposes


def main():
    options = arguments()
    bench = Bench(options)
    scenes = options.scenes
    if not scenes:
        folder = pathlib.Path(os.environ.get("EMBREE_TRACE_SCENES", ROOT / "../shared/scenes"))
        scenes = sorted(folder.glob("*.obj.zst"), key=lambda path: path.stat().st_size)
    for scene in [] if options.tables else scenes:
        measure(bench, scene, bool(options.scenes))
    times, answers, purposes = load(bench)
    if not times:
        sys.exit("nothing is measured yet")
    text = page(times, answers, purposes)
    print(text, end="")
    write(text)
    figure(times, FIGURE)


if __name__ == "__main__":
    main()
