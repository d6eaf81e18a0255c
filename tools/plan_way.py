#!/usr/bin/env python3
"""Plans a way between the stems of a map (x_m,y_m,diameter_m, as `rigor world stems` writes it) past given places.

    tools/plan_way.py stems.csv -o way.csv --past="-30,-30 30,-30 30,30 -30,30 -30,-28"

The shortest way on a grid that keeps `--clearance` metres from every stem's bark, and rather `--comfort` metres; then rounded
as far as it still does. Writes x_m,y_m half a metre apart. The standard library alone is needed.
"""
import argparse
import csv
import heapq
import math
import sys

CELL_M, REACH_M = 0.25, 4.0


class Stems:
    """Bark-to-bark distances, by cells of REACH_M."""

    def __init__(self, rows):
        self.cells = {}
        for x, y, r in rows:
            self.cells.setdefault((math.floor(x / REACH_M), math.floor(y / REACH_M)), []).append((x, y, r))

    def distance(self, x, y):
        i, j = math.floor(x / REACH_M), math.floor(y / REACH_M)
        near = [s for a in (-1, 0, 1) for b in (-1, 0, 1) for s in self.cells.get((i + a, j + b), [])]
        return min([math.hypot(x - s[0], y - s[1]) - s[2] for s in near] + [REACH_M])


def shortest(stems, start, goal, clearance, comfort):
    """Dijkstra with a bound (A*) over 16 directions; list of points from start to goal."""
    steps = [(a, b) for a in (-2, -1, 0, 1, 2) for b in (-2, -1, 0, 1, 2) if math.gcd(abs(a), abs(b)) == 1]
    cost_at = {}

    def price(cell):
        if cell not in cost_at:
            d = stems.distance(cell[0] * CELL_M, cell[1] * CELL_M)
            cost_at[cell] = math.inf if d < clearance else 1 + 3 * max(0.0, 1 - (d - clearance) / (comfort - clearance))
        return cost_at[cell]

    def cell_of(p):
        return (round(p[0] / CELL_M), round(p[1] / CELL_M))

    def free_cell(p):
        """The nearest that keeps the comfort, else the clearance."""
        i, j = cell_of(p)
        around = sorted((a * a + b * b, i + a, j + b) for a in range(-12, 13) for b in range(-12, 13))
        for least in (1.0, math.inf):
            for _, a, b in around:
                if price((a, b)) <= least and not math.isinf(price((a, b))):
                    return (a, b)
        sys.exit(f"plan_way: {p[0]:g},{p[1]:g}: expected a place within 3 m that is {clearance:g} m from every stem, found none")

    first, last = cell_of(start), cell_of(goal)
    if math.isinf(price(first)):
        first = free_cell(start)
    if math.isinf(price(last)):
        last = free_cell(goal)
    best, before, queue = {first: 0.0}, {}, [(0.0, first)]
    while queue:
        _, cell = heapq.heappop(queue)
        if cell == last:
            break
        for a, b in steps:
            to = (cell[0] + a, cell[1] + b)
            if abs(to[0] - first[0]) + abs(to[0] - last[0]) > 2 * abs(first[0] - last[0]) + 400 or \
               abs(to[1] - first[1]) + abs(to[1] - last[1]) > 2 * abs(first[1] - last[1]) + 400:
                continue
            cost = best[cell] + math.hypot(a, b) * CELL_M * (price(cell) + price(to)) / 2
            if cost < best.get(to, math.inf):
                best[to], before[to] = cost, cell
                heapq.heappush(queue, (cost + math.hypot(to[0] - last[0], to[1] - last[1]) * CELL_M, to))
    if last not in best:
        sys.exit(f"plan_way: no way from {start} to {goal} that keeps {clearance:g} m from every stem")
    cells = [last]
    while cells[-1] != first:
        cells.append(before[cells[-1]])
    return [(a * CELL_M, b * CELL_M) for a, b in reversed(cells)]


def resampled(points, spacing_m):
    out, left = [points[0]], spacing_m
    for (ax, ay), (bx, by) in zip(points, points[1:]):
        length, at = math.hypot(bx - ax, by - ay), 0.0
        while length - at >= left:
            at += left
            left = spacing_m
            out.append((ax + (bx - ax) * at / length, ay + (by - ay) * at / length))
        left -= length - at
    if math.dist(out[-1], points[-1]) > 0.2 * spacing_m:
        out.append(points[-1])
    return out


def rounded(stems, points, clearance):
    """Each point moves towards the middle of its neighbours, where it keeps the clearance."""
    points = list(points)
    for _ in range(300):
        for i in range(1, len(points) - 1):
            x = 0.5 * points[i][0] + 0.25 * (points[i - 1][0] + points[i + 1][0])
            y = 0.5 * points[i][1] + 0.25 * (points[i - 1][1] + points[i + 1][1])
            if stems.distance(x, y) >= min(clearance, stems.distance(*points[i])):
                points[i] = (x, y)
    return points


def places(text):
    points = [tuple(float(v) for v in place.split(",")) for place in text.split()]
    if len(points) < 2 or any(len(p) != 2 for p in points):
        raise argparse.ArgumentTypeError(f'expected two places or more, as in "0,0 20,5.5", got "{text}"')
    return points


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("stems")
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--past", type=places, required=True, metavar='="X,Y X,Y …"', help="start, places on the way, goal; where a stem is too near, the nearest place that is free")
    parser.add_argument("--clearance", type=float, default=0.9, help="metres from bark to the way (0.9)")
    parser.add_argument("--comfort", type=float, default=1.6, help="metres from which more is worth no detour (1.6)")
    options = parser.parse_args()
    with open(options.stems, newline="") as f:
        rows = [(float(r["x_m"]), float(r["y_m"]), float(r["diameter_m"]) / 2) for r in csv.DictReader(f)]
    stems = Stems(rows)
    points = [options.past[0]]
    for a, b in zip(options.past, options.past[1:]):
        leg = shortest(stems, points[-1] if len(points) > 1 else a, b, options.clearance, options.comfort)
        points = points + leg[1:] if len(points) > 1 else leg
    way = rounded(stems, resampled(points, 0.5), options.clearance)
    way = resampled(way, 0.5)
    length = sum(math.dist(a, b) for a, b in zip(way, way[1:]))
    with open(options.output, "w", newline="\n") as out:
        out.write("x_m,y_m\n" + "".join(f"{x:.2f},{y:.2f}\n" for x, y in way))
    print(f"{options.output}: {length:.1f} m, never nearer than {min(stems.distance(x, y) for x, y in way):.2f} m to bark")


if __name__ == "__main__":
    main()
