#!/usr/bin/env python3
"""Tables of docs/traversal.md, from what bvh-compare said: SCENE.SIZE.KEY.json in the directory given; the key is that of sorting, `none`, or `close` for
an image of 1024 x 1024."""

import json
import pathlib
import statistics
import sys

PURPOSES = ["camera", "shadow", "diffuse"]
SIZES = ["16", "64", "256"]
KEYS = ["direction", "origin", "both"]


class Run:
    """Queries of one scene in packets of one size, sorted by one key or by none; in the same run also alone, as recorded."""

    def __init__(self, path):
        report = json.loads(path.read_text())
        self.traversals = report["trees"][0]["traversals"]
        timing = report.get("timing") or {}
        self.queries = timing.get("queries")
        self.sort_seconds = timing.get("sort_seconds")
        self.embree = report.get("embree")

    def group(self, purpose, order="odf"):
        return self.traversals[order]["by_purpose"].get(purpose)

    def octets(self, purpose, order="odf"):
        group = self.group(purpose, order)
        return group["packets"]["octets"] / group["queries"]

    def seconds(self, purpose, order="odf", way=None):
        traversal = self.traversals[order]
        time = traversal["other_times"][way] if way else traversal["time"]
        return time["by_purpose"][purpose]["seconds"]

    def gain(self, purpose, order="odf", way=None):
        """How many times as fast as alone, depth first, in the order of the recording."""
        return self.seconds(purpose) / self.seconds(purpose, order, way)


def load(directory):
    paths = sorted(pathlib.Path(directory).glob("*.json"))
    return {tuple(path.name.rsplit(".", 3)[:3]): Run(path) for path in paths}


def table(header, rows):
    print("| " + " | ".join(header) + " |")
    print("|---|---|" + "---:|" * (len(header) - 2))
    for row in rows:
        print("| " + " | ".join(row) + " |")
    print()


def percent(part, whole):
    return f"{100 * part / whole:.0f}%" if whole else "–"


def shares(runs, scenes, purposes, sizes, key):
    rows = []
    for scene in scenes:
        for purpose in purposes:
            for size in sizes:
                group = runs[scene, size, key].group(purpose)
                if not group:
                    continue
                packets = group["packets"]
                parts = [packets[name] for name in ["early_hits", "early_misses", "by_rays", "few"]]
                ruled = packets["early_hits"] + packets["early_misses"]
                rows.append(
                    [scene, purpose, size, f"{packets['decisions'] / group['queries']:.2f}"]
                    + [percent(part, packets["decisions"]) for part in parts]
                    + [percent(ruled, packets["decisions"]), percent(ruled, ruled + packets["by_rays"])]
                    + [str(group["mismatches"])]
                )
    header = ["scene", "queries", "packet", "decisions per query", "early hit", "early miss", "rays", "few"]
    table(header + ["a rule decided", "of those asked", "wrong"], rows)


def columns_of(runs, scenes, columns):
    """A row for each scene and purpose, and the medians: `columns` are a title, and what gives a value for a scene and a purpose."""
    rows = []
    for purpose in PURPOSES:
        found = []
        for scene in scenes:
            if runs[scene, "256", "none"].group(purpose):
                found.append([value(scene, purpose) for _, value in columns])
                rows.append([scene, purpose] + [f"{value:.2f}" for value in found[-1]])
        rows.append(["median", purpose] + [f"{statistics.median(column):.2f}" for column in zip(*found)])
    table(["scene", "queries"] + [title for title, _ in columns], rows)


def main():
    runs = load(sys.argv[1])
    scenes = sorted({scene for scene, _, _ in runs})

    def gain(size, key="none", order="odf", way="packets"):
        return lambda scene, purpose: runs[scene, size, key].gain(purpose, order, way)

    def octets(order):
        return lambda scene, purpose: runs[scene, "256", "none"].octets(purpose, order)

    def alone(scene, purpose):
        run = runs[scene, "256", "none"]
        return run.seconds(purpose) * 1e9 / run.group(purpose)["queries"]

    def embree(scene, purpose):
        run = runs[scene, "256", "none"]
        return run.embree["by_purpose"][purpose]["seconds"] / run.seconds(purpose, way="packets")

    print("By which rule it was decided whether a packet enters a box, depth first, queries as recorded:\n")
    shares(runs, scenes, PURPOSES, SIZES, "none")
    print("The same for camera queries of an image of 1024 × 1024:\n")
    shares(runs, scenes, ["camera"], ["64", "256"], "close")
    print("Nanoseconds per query alone, and how many times as fast packets of 16, 64 and 256 are, and packets of 256 as `rtcIntersect1` and `rtcOccluded1`:\n")
    columns_of(
        runs, scenes, [("alone, ns", alone)] + [(size, gain(size)) for size in SIZES] + [("256, Embree", embree)]
    )
    print("Sorted, alone and in packets of 256, relative to alone and unsorted; sorting itself is not in it:\n")
    sorted_columns = [("packets, unsorted", gain("256"))]
    sorted_columns += [(f"alone, by {key}", gain("256", key, way="sorted")) for key in KEYS]
    sorted_columns += [(f"packets, by {key}", gain("256", key, way="packets_sorted")) for key in KEYS]
    columns_of(runs, scenes, sorted_columns)
    took = [run.sort_seconds * 1e9 / run.queries for run in runs.values() if run.sort_seconds]
    print(f"Sorting took {min(took):.0f} to {max(took):.0f} ns per query.\n")
    print("RayOrder, relative to alone and depth first, and tests of an octet against a box per query, in packets of 256:\n")
    ray_order = [("RayOrder alone", gain("256", order="ray_order", way=None)), ("RayOrder in packets", gain("256", order="ray_order"))]
    ray_order += [("octets, ODF", octets("odf")), ("octets, RayOrder", octets("ray_order"))]
    columns_of(runs, scenes, [("ODF in packets", gain("256"))] + ray_order)


main()
