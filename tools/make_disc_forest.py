#!/usr/bin/env python3
"""Writes the forest of cylinders that configs/rigs/forest-discs.yaml drives through: a world, the map of its stems with errors of
20 mm, and a way of one round and one of 200 m. Repeatable: run it again and nothing changes.

    tools/make_disc_forest.py configs/worlds
"""
import math
import random
import sys
from pathlib import Path

HALF_M, COUNT, APART_M, LANE_M, MAP_SIGMA_M = 16.0, 60, 1.6, 1.3, 0.02


def way():
    """A rounded rectangle of 20 x 12 m, 55 m long."""
    points = []
    for (cx, cy, start) in ((8, -4, -90), (8, 4, 0), (-8, 4, 90), (-8, -4, 180)):
        points += [(cx + 2 * math.cos(math.radians(start + a)), cy + 2 * math.sin(math.radians(start + a)))
                   for a in range(0, 91, 15)]
    return [(0.0, -6.0)] + points + [(0.0, -6.0)]


def way_of_length(length):
    """Round after round, and the last one as far as the length goes."""
    lap, points, left = way(), [way()[0]], length
    while True:
        for a, b in zip(lap, lap[1:]):
            d = math.dist(a, b)
            if d >= left:
                return points + [(a[0] + (b[0] - a[0]) * left / d, a[1] + (b[1] - a[1]) * left / d)]
            points.append(b)
            left -= d


def near(x, y, path, limit):
    for (ax, ay), (bx, by) in zip(path, path[1:]):
        length2 = (bx - ax) ** 2 + (by - ay) ** 2
        u = max(0.0, min(1.0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length2)) if length2 else 0.0
        if math.hypot(x - ax - u * (bx - ax), y - ay - u * (by - ay)) < limit:
            return True
    return False


def main(folder):
    rng = random.Random(7)
    path = way()
    stems = []
    while len(stems) < COUNT:
        x, y, d = rng.uniform(-HALF_M, HALF_M), rng.uniform(-HALF_M, HALF_M), rng.uniform(0.18, 0.5)
        if near(x, y, path, LANE_M) or any(math.hypot(x - s[0], y - s[1]) < APART_M for s in stems):
            continue
        stems.append((round(x, 3), round(y, 3), round(d, 3)))
    world = ["# A forest of cylinders on flat ground, as tools/make_disc_forest.py writes it.",
             "rigor_world: 1", f"next_id: {10 + COUNT}", "nodes:",
             "  - { id: 1, type: Material, attributes: { name: bark, reflectance: [0.22, 0.18, 0.14, 0.4, 0.42, 0.4], roughness: 1 } }",
             "  - { id: 2, type: Material, attributes: { name: soil, reflectance: [0.15, 0.12, 0.08, 0.25, 0.27, 0.35], roughness: 1 } }",
             "  - { id: 3, type: GroundPlane, attributes: { name: ground, half_extent_m: 60, cell_m: 1 }, edges: { made_of: [2] } }"]
    for i, (x, y, d) in enumerate(stems):
        world.append(f"  - {{ id: {10 + i}, type: Body, attributes: {{ name: stem-{i}, shape: cylinder, size_m: [{d}, {d}, 8], "
                     f"pose: [1, 0, 0, {x}, 0, 1, 0, {y}, 0, 0, 1, 4] }}, edges: {{ made_of: [1] }} }}")
    (folder / "disc-forest.yaml").write_text("\n".join(world) + "\n")
    rows = ["x_m,y_m,diameter_m,fell"]
    for i, (x, y, d) in enumerate(stems):
        rows.append(f"{x + rng.gauss(0, MAP_SIGMA_M):.3f},{y + rng.gauss(0, MAP_SIGMA_M):.3f},{d},{'true' if i % 20 == 0 else 'false'}")
    (folder / "data" / "disc-forest-stems.csv").write_text("\n".join(rows) + "\n")
    for name, points in (("disc-forest-way", path), ("disc-forest-way-200m", way_of_length(200))):
        (folder / "data" / f"{name}.csv").write_text("\n".join(["x_m,y_m"] + [f"{x:.3f},{y:.3f}" for x, y in points]) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "configs/worlds"))
