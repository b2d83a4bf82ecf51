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
import contextlib
import datetime
import io
import json
import os
import pathlib
import statistics
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs/performance.md"
FIGURE = ROOT / "docs/images/kernels.svg"
KERNELS = [(isa, robust) for isa in ("sse42", "avx2", "avx512") for robust in (False, True)]
TREES = ["area", "ours"]
NONE = "–"


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
            names = ["embree-trace", "bvh-build", "bvh-compare"]
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

    def record(self, scene, name, seed):
        """A recording of the scene, the tree that Embree built, and how many triangles it has."""
        rays, built, said = (
            self.path(name, f"{seed}.rays"),
            self.path(name, "built.bvh"),
            self.path(name, f"{seed}.said"),
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
            "seconds": time.time() - started,
        }

    def clear(self, name):
        """Removes the large files; what was measured stays."""
        for path in self.options.keep.glob(f"{name}.*"):
            if path.suffix in (".rays", ".bvh", ".said"):
                path.unlink()


def kernels_name(isa, robust):
    return f"{isa} robust" if robust else isa


def median(values):
    values = [value for value in values if value is not None]
    return statistics.median(values) if values else None


def ratio(value):
    return NONE if value is None else f"{value:.3f}"


def table(header, text, rows):
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * text + "--:|" * (len(header) - text))
    for row in rows:
        print("| " + " | ".join(row) + " |")
    print()


def part(group, kind):
    return group if kind is None else group.get("by_kind", {}).get(kind)


def to_medium(times, tree, kind=None):
    group = part(times["trees"][tree], kind)
    return group and group.get("ratio_to_own")


def to_best(times, tree, kind=None):
    group = part(times["trees"][tree], kind)
    return group and group.get("ratio_to_best")


def high(times, kind=None):
    """Embree's tree of high quality relative to that of medium quality."""
    both = [part(group, kind) for group in (times["embree"].get("high"), times["embree"]) if group]
    return both[0]["seconds"] / both[1]["seconds"] if len(both) == 2 and all(both) else None


def spread(times):
    groups = [times["embree"], times["embree"].get("high")]
    embree = [(group["greatest"] - group["least"]) / group["seconds"] for group in groups if group]
    planted = [tree["spread"] for tree in times["trees"].values() if "spread" in tree]
    return max(embree + planted)


COLUMNS = [
    ("Embree high", high),
    ("medium, planted", lambda times: to_medium(times, "built")),
    ("area", lambda times: to_medium(times, "area")),
    ("**rays**", lambda times: to_medium(times, "ours")),
    ("rays, closest", lambda times: to_medium(times, "ours", "closest_hit")),
    ("rays, occlusion", lambda times: to_medium(times, "ours", "occlusion")),
    ("area / best", lambda times: to_best(times, "area")),
    ("**rays / best**", lambda times: to_best(times, "ours")),
]


def time_table(all_times):
    rows = []
    values = [[] for _ in COLUMNS]
    for name, times in all_times.items():
        found = [column(times) for _, column in COLUMNS]
        for list_, value in zip(values, found):
            list_.append(value)
        rows.append(
            [name, f"{times['triangles']:,}", *map(ratio, found), f"{100 * spread(times):.0f}%"]
        )
    rows.append(["**median**", "", *(ratio(median(list_)) for list_ in values), ""])
    known = [[value for value in list_ if value is not None] for list_ in values]
    rows.append(["**worst**", "", *(ratio(max(list_, default=None)) for list_ in known), ""])
    table(["scene", "triangles", *(title for title, _ in COLUMNS), "spread"], 1, rows)


def answer_table(all_answers):
    """A row a scene, sums over the kernels; then what is not 0, kernel by kernel."""
    keys = ["flipped", "apart"]
    rows, sums, told = [], [0] * 7, []
    for name, by_kernels in all_answers.items():
        planted = {kernels: found for kernels, found in by_kernels.items() if found.get("answers")}
        row = [len(planted)]
        answers = [found["answers"] for found in planted.values()]
        row.append(sum(one["queries"] for one in answers))
        row += [sum(one[key] for one in answers) for key in keys]
        row += [sum(one["packets"][key] for one in answers) for key in keys]
        row.append(sum(one["mismatches"] for one in answers))
        rows.append([name, *(f"{value:,}" for value in row)])
        sums = [a + b for a, b in zip(sums, row)]
        for kernels, found in planted.items():
            one = found["answers"]
            if any(one[key] or one["packets"][key] for key in keys) or one["mismatches"]:
                packets, own = one["packets"], found["own"]["mismatches"]
                told.append(
                    f"{name}, {kernels}: {one['flipped']} flipped and {one['apart']} apart singly, "
                    f"{packets['flipped']} and {packets['apart']} in packets, {one['mismatches']} wrong; "
                    f"on Embree's own tree {own} wrong"
                )
    rows.append(["**all**", *(f"{value:,}" for value in sums)])
    table(
        [
            "scene",
            "kernels",
            "queries",
            "flipped",
            "apart",
            "flipped, packets",
            "apart, packets",
            "wrong",
        ],
        1,
        rows,
    )
    for line in told:
        print(f"- {line}")
    if told:
        print()


def machine():
    model = [
        line.split(":")[1].strip()
        for line in open("/proc/cpuinfo")
        if line.startswith("model name")
    ]
    return f"{model[0]}, {os.cpu_count()} cores"


def several(values):
    """What all scenes have, or from the least to the greatest."""
    least, greatest = min(values), max(values)
    return f"{least}" if least == greatest else f"{least} to {greatest}"


TIMES = """Time of Embree's kernels for queries of another seed, relative to its own tree of medium \
quality: paths of depth {depth}, one thread, medians of {rounds} interleaved rounds of up to \
{queries:,} queries, {budget} s for each of our trees. *medium, planted*: Embree's own tree in our \
pages. *area*, the control: `bvh-build built.bvh area.bvh --rays casts.rays --area-only`; *rays*: \
`bvh-build built.bvh ours.bvh --rays casts.rays`. *best*: the better of medium and high. *spread*: between the least and the \
greatest round, the largest of a scene
"""

ANSWERS = """Answers on our tree from rays (with SSE one of four children a node) that are not those on \
Embree's own tree, by its kernels for SSE 4.2, AVX2 and AVX-512, each default and robust. *flipped*: a \
hit for a miss; *apart*: t beyond 1e-4; *wrong*: other than recorded, and not as good
"""


def report(all_times, all_answers):
    """The tables as they stand in the page."""
    times = list(all_times.values())
    embree = times[0]["embree"]
    number = embree["version"]
    version = f"{number // 10000}.{number // 100 % 100}.{number % 100}"
    loads = [load for one in times for load in one["load"]]
    print(
        f"*{several([one['date'] for one in times])}, {machine()}, Embree {version}, "
        f"{embree['isa']}, "
        f"{embree['structure']}; load of the machine {min(loads):.1f} to {max(loads):.1f}, "
        f"median {median(loads):.1f}*\n"
    )
    said = {
        "depth": several([one["depth"] for one in times]),
        "rounds": several([one["timing"]["rounds"] for one in times]),
        "queries": max(one["timing"]["queries"] for one in times),
        "budget": several([round(one["budget"]) for one in times]),
    }
    print(TIMES.format(**said))
    time_table(all_times)
    if all_answers:
        print(ANSWERS)
        answer_table(all_answers)


SERIES = [
    ("Embree high", "#CC79A7", high, "cross"),
    ("best tree from area", "#009E73", lambda times: to_medium(times, "area"), "ring"),
    ("best tree from rays", "#0072B2", lambda times: to_medium(times, "ours"), "disk"),
]


def mark(kind, color, x, y):
    if kind == "cross":
        cross = f"M{x - 4:.1f} {y - 4}l8 8m0 -8l-8 8"
        return f'<path d="{cross}" stroke="{color}" stroke-width="1.6" fill="none"/>'
    fill = color if kind == "disk" else "#FFFFFF"
    circle = f'cx="{x:.1f}" cy="{y}" r="4"'
    return f'<circle {circle} fill="{fill}" stroke="{color}" stroke-width="1.6"/>'


def words(x, y, text, anchor="middle", size=11, weight="normal"):
    font = f'font-family="sans-serif" font-size="{size}" font-weight="{weight}" fill="#1E1E1E"'
    return f'<text x="{x:.1f}" y="{y}" text-anchor="{anchor}" {font}>{text}</text>'


def line(path, color, width=1):
    return f'<path d="{path}" stroke="{color}" stroke-width="{width}"/>'


def figure(all_times):
    """What the table says of time, as SVG: one line a scene, the fastest at the top."""
    order = sorted(all_times, key=lambda name: to_medium(all_times[name], "ours") or 9)
    left, right, top, step, width = 150, 830, 84, 22, 860
    bottom = top + step * len(order)
    values = [value(times) for _, _, value, _ in SERIES for times in all_times.values()]
    values = [value for value in values if value is not None] + [1.0]
    low, great = min(values) - 0.03, max(values) + 0.03
    place = lambda value: left + (value - low) / (great - low) * (right - left)
    size = f'width="{width}" height="{bottom + 60}"'
    title = "Time of Embree's own kernels, on rays that no tree has seen"
    lines = [
        f'<svg {size} viewBox="0 0 {width} {bottom + 60}" xmlns="http://www.w3.org/2000/svg">',
        f'<rect {size} fill="#FFFFFF"/>',
        words(width / 2, 26, title, size=14, weight="bold"),
    ]
    for number, (label, color, _, kind) in enumerate(SERIES):
        x = left + 40 + 220 * number
        lines += [mark(kind, color, x, 54), words(x + 12, 58, label, "start", 12)]
    for tenth in range(int(low * 10) + 1, int(great * 10) + 1):
        x, is_one = place(tenth / 10), tenth == 10
        vertical = f"M{x:.1f} {top - 8}V{bottom}"
        lines.append(line(vertical, "#888888" if is_one else "#E2E2E2", 2 if is_one else 1))
        lines.append(words(x, bottom + 16, f"{tenth / 10:.1f}"))
    for number, name in enumerate(order):
        y = top + step * number + 8
        lines += [line(f"M{left} {y}H{right}", "#F0F0F0"), words(left - 10, y + 4, name, "end")]
        for _, color, value, kind in SERIES:
            found = value(all_times[name])
            if found is not None:
                lines.append(mark(kind, color, place(found), y))
    below = "relative to Embree's tree of medium quality; less is faster"
    lines += [words((left + right) / 2, bottom + 42, below, size=12), "</svg>", ""]
    FIGURE.write_text("\n".join(lines))


def write(text):
    """Puts the tables between their marks."""
    begin, end = "<!-- measured: kernels -->", "<!-- end: kernels -->"
    page = PAGE.read_text()
    head, rest = page.split(begin)
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
    """What is kept: times by scene, the smallest first, and answers by scene and kernels."""
    paths = bench.options.keep.glob("*.times.json")
    times = {path.name.split(".")[0]: json.loads(path.read_text()) for path in paths}
    times = dict(sorted(times.items(), key=lambda item: item[1]["triangles"]))
    answers = {}
    for name in times:
        for kernels in (kernels_name(*kernels) for kernels in KERNELS):
            path = bench.answers_path(name, kernels)
            if path.exists():
                answers.setdefault(name, {})[kernels] = json.loads(path.read_text())
    return times, answers


def main():
    options = arguments()
    bench = Bench(options)
    scenes = options.scenes
    if not scenes:
        folder = pathlib.Path(os.environ.get("EMBREE_TRACE_SCENES", ROOT / "../shared/scenes"))
        scenes = sorted(folder.glob("*.obj.zst"), key=lambda path: path.stat().st_size)
    for scene in [] if options.tables else scenes:
        measure(bench, scene, bool(options.scenes))
    times, answers = load(bench)
    if not times:
        sys.exit("nothing is measured yet")
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        report(times, answers)
    print(text.getvalue(), end="")
    write(text.getvalue())
    figure(times)


if __name__ == "__main__":
    main()
