"""Tables and figure of what `tools/held-out --embree` measured (tools/kernels.py): how much time
Embree's kernels took on trees of ours, and which answers differ.

`page` makes the text that stands between the marks of docs/performance.md, `figure` the SVG of the
README. Both are made from the files of the measurements alone.
"""

import contextlib
import io
import os
import statistics

NONE = "–"


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


def purpose_table(all_purposes):
    """Trees for some of the queries beside the tree for all, on these queries alone."""

    def of(found, tree, purpose):
        group = found["trees"][tree]
        group = group if purpose is None else group.get("by_purpose", {}).get(purpose)
        return group and group.get("ratio_to_best")

    columns = [
        ("camera, tree for all", "ours", "camera"),
        ("**camera, its own**", "camera", "camera"),
        ("shadow, tree for all", "ours", "shadow"),
        ("**shadow, its own**", "shadow", "shadow"),
        ("all, tree for all", "ours", None),
        ("**all, other camera's**", "elsewhere", None),
        ("all, limit", "limit", None),
    ]
    rows = [
        [name, *(of(found, tree, purpose) for _, tree, purpose in columns)]
        for name, found in all_purposes.items()
    ]
    medians = ["**median**", *(median(list(column)) for column in list(zip(*rows))[1:])]
    worst = ["**worst**", *(max(v for v in column if v) for column in list(zip(*rows))[1:])]
    rows = [[row[0], *map(ratio, row[1:])] for row in [*rows, medians, worst]]
    table(["scene", *(title for title, *_ in columns)], 1, rows)


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
hit for a miss; *apart*: t beyond 1e-4; *wrong*: other than recorded, and not as good ({dates})
"""


PURPOSES = """
The same of trees for some of the queries (`bvh-build … --filter purpose=camera`), on these queries
alone, and of a tree from a recording of another camera: relative to the better of Embree's trees
on the same queries, {budget} s for each tree. *limit*: the tree that the same search makes of the
very queries that are asked, so that more or better chosen training queries can bring no more.
"""


def report(all_times, all_answers, all_purposes):
    """Prints the tables."""
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
    if all_purposes:
        budgets = several([round(one["budget"]) for one in all_purposes.values()])
        print(PURPOSES.strip().replace("\n", " ").format(budget=budgets) + "\n")
        purpose_table(all_purposes)
    if all_answers:
        dates = [one["date"] for found in all_answers.values() for one in found.values()]
        print(ANSWERS.format(dates=several(dates)))
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


def figure(all_times, path):
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
    path.write_text("\n".join(lines))


def page(all_times, all_answers, all_purposes):
    """The tables as they stand in the page."""
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        report(all_times, all_answers, all_purposes)
    return text.getvalue()
