#!/usr/bin/env python3
"""Writes the stand that configs/rigs/harvester.yaml thins: trees on level ground beside a strip road, those marked for felling
that a forester would take (thin ones, crowded by thicker neighbours) within a crane's reach, and the way along the road. The map
of stems comes from the world: rigor world export. Repeatable: run it again and nothing changes.

    tools/make_harvester_stand.py configs/worlds
    rigor world export configs/worlds/harvester-stand.yaml -o configs/worlds/data/harvester-stems.csv --force
"""
import math
import random
import sys
from pathlib import Path

COUNT, APART_M, ROAD_HALF_M, MARKED = 130, 1.9, 2.4, 6
REACH_M = (3.6, 7.0)
X_M, Y_M = (-22.0, 48.0), (-18.0, 18.0)


def road(x):
    """The strip road's centre line: a gentle S."""
    return 1.5 * math.sin(x / 14.0)


def way():
    """From -6 to 32 m, points half a metre apart in x."""
    return [(0.5 * k, road(0.5 * k)) for k in range(-12, 65)]


def from_road(x, y):
    return min(math.hypot(x - px, y - py) for px, py in ((0.5 * k, road(0.5 * k)) for k in range(-52, 105)))


def main(folder):
    rng = random.Random(11)
    trees = []
    while len(trees) < COUNT:
        x, y = rng.uniform(*X_M), rng.uniform(*Y_M)
        if from_road(x, y) < ROAD_HALF_M or any(math.hypot(x - t["x"], y - t["y"]) < APART_M for t in trees):
            continue
        trees.append({"x": round(x, 3), "y": round(y, 3), "dbh": round(min(max(rng.gauss(0.29, 0.06), 0.17), 0.46), 3),
                      "heading": round(rng.uniform(0, 2 * math.pi), 2), "marked": False})
    def crowded(t):
        return sum((o["dbh"] / t["dbh"]) / math.hypot(o["x"] - t["x"], o["y"] - t["y"]) for o in trees if o is not t
                   and math.hypot(o["x"] - t["x"], o["y"] - t["y"]) < 6)
    reached = [t for t in trees if REACH_M[0] < from_road(t["x"], t["y"]) < REACH_M[1] and 3 < t["x"] < 32]
    for t in sorted(reached, key=crowded, reverse=True):
        if sum(o["marked"] for o in trees) < MARKED and all(math.hypot(o["x"] - t["x"], o["y"] - t["y"]) > 5 for o in trees if o["marked"]):
            t["marked"] = True
    lines = ["# A stand of spruces beside a strip road, as tools/make_harvester_stand.py writes it.",
             "rigor_world: 1", f"next_id: {100 + COUNT}", "nodes:",
             "  - { id: 1, type: Material, attributes: { name: soil, reflectance: [0.13, 0.11, 0.07, 0.25, 0.27, 0.35], roughness: 1 } }",
             "  - { id: 2, type: GroundPlane, attributes: { name: ground, half_extent_m: 120, cell_m: 1 }, edges: { made_of: [1] } }",
             "  - { id: 3, type: Atmosphere, attributes: { name: air, cloud_cover: 0.3 } }"]
    for i, t in enumerate(trees):
        marked = ", marked: true" if t["marked"] else ""
        lines.append(f"  - {{ id: {100 + i}, type: Tree, attributes: {{ position: [{t['x']}, {t['y']}, 0], species: Picea, "
                     f"dbh_m: {t['dbh']}, crown_base_m: 7, heading_rad: {t['heading']}{marked} }} }}")
    (folder / "harvester-stand.yaml").write_text("\n".join(lines) + "\n")
    (folder / "data" / "harvester-way.csv").write_text(
        "\n".join(["x_m,y_m"] + [f"{x:.3f},{y:.3f}" for x, y in way()]) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "configs/worlds"))
