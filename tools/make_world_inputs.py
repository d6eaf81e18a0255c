#!/usr/bin/env python3
"""Makes the inputs of the worlds in configs/worlds: small rasters (ESRI ASCII grid), GeoJSON and CSV.

    tools/make_world_inputs.py [FOLDER]      (default: configs/worlds/data)

The same bytes every time. Coordinates are metres of UTM zone 32 (EPSG:32632) at its central meridian, where the grid
points north. The standard library alone is needed.
"""
import json
import math
import random
import sys
from pathlib import Path

CRS = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32632"}}
WORDS = ["water", "grass", "meadow", "shrub", "forest_floor", "fern", "soil", "rock", "gravel", "sand", "snow", "asphalt",
         "concrete", "crop", "wetland", "built_up"]


def noise(x, y, seed):
    """Smooth, between -1 and 1, from a lattice of hashed values one unit apart."""
    def lattice(i, j):
        h = (i * 374761393 + j * 668265263 + seed * 2147483647) & 0xFFFFFFFF
        h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
        return ((h ^ (h >> 16)) & 0xFFFF) / 32767.5 - 1
    i, j = math.floor(x), math.floor(y)
    u, v = x - i, y - j
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
    low = lattice(i, j) * (1 - u) + lattice(i + 1, j) * u
    high = lattice(i, j + 1) * (1 - u) + lattice(i + 1, j + 1) * u
    return low * (1 - v) + high * v


class Site:
    """A square of land around a middle in UTM; x east and y north of it."""

    def __init__(self, folder, name, easting, northing, half, seed):
        self.folder, self.name, self.easting, self.northing, self.half = folder, name, easting, northing, half
        self.random = random.Random(seed)

    def path(self, what):
        return self.folder / f"{self.name}-{what}"

    def grid(self, what, cell, value, form):
        """Cells whose middles lie at x = -half … half."""
        n = round(2 * self.half / cell) + 1
        with open(self.path(what), "w", newline="\n") as out:
            out.write(f"ncols {n}\nnrows {n}\nxllcorner {self.easting - self.half - cell / 2:.2f}\n"
                      f"yllcorner {self.northing - self.half - cell / 2:.2f}\ncellsize {cell}\nNODATA_value -9999\n")
            for row in range(n):
                y = self.half - row * cell
                out.write(" ".join(form.format(value(-self.half + column * cell, y)) for column in range(n)) + "\n")

    def features(self, what, features):
        """(geometry type, coordinates in x and y, properties)"""
        def placed(c):
            if isinstance(c[0], (int, float)):
                return [round(self.easting + c[0], 2), round(self.northing + c[1], 2)]
            return [placed(e) for e in c]
        lines = [json.dumps({"type": "Feature", "properties": p, "geometry": {"type": t, "coordinates": placed(c)}})
                 for t, c, p in features]
        text = ('{"type": "FeatureCollection", "crs": ' + json.dumps(CRS) + ', "features": [\n' + ",\n".join(lines) + "\n]}\n")
        self.path(what).write_text(text)

    def trees(self, count, spacing, wanted, species):
        """Trees no nearer to each other than `spacing`; wanted(x, y): how likely; species: (code, share, dbh, spread)."""
        placed, cells, rows = [], {}, []
        for _ in range(count * 60):
            if len(placed) == count:
                break
            x = self.random.uniform(-1, 1) * self.half
            y = self.random.uniform(-1, 1) * self.half
            pick, size, dead = self.random.random(), self.random.gauss(0, 1), self.random.random()
            if self.random.random() > wanted(x, y):
                continue
            cell = (math.floor(x / spacing), math.floor(y / spacing))
            near = [p for i in (-1, 0, 1) for j in (-1, 0, 1) for p in cells.get((cell[0] + i, cell[1] + j), [])]
            if any((x - p[0]) ** 2 + (y - p[1]) ** 2 < spacing ** 2 for p in near):
                continue
            cells.setdefault(cell, []).append((x, y))
            placed.append((x, y))
            for code, share, dbh, spread in species:
                if pick < share:
                    break
                pick -= share
            rows.append((len(placed), code, dbh * math.exp(size * spread), x, y, "true" if dead < 0.04 else "false"))
        with open(self.path("trees.csv"), "w", newline="\n") as out:
            out.write("tree_id,species,dbh_cm,easting,northing,dead\n")
            for i, code, dbh, x, y, dead in rows:
                out.write(f"{i},{code},{dbh:.1f},{self.easting + x:.2f},{self.northing + y:.2f},{dead}\n")


def forest(folder):
    site = Site(folder, "forest", 500000, 5211000, 100, 1)

    def height(x, y):
        return 612 + 0.06 * x + 0.03 * y + 2.2 * noise(x / 45, y / 45, 1) + 0.5 * noise(x / 11, y / 11, 2)

    def cover(x, y):
        if abs(y + 0.25 * x + 12 * noise(x / 40, 0, 5) - 5) < 1.6:
            return WORDS.index("soil")  # a path
        return WORDS.index("fern" if noise(x / 14, y / 14, 3) > 0.15 else "forest_floor")

    site.grid("dem.asc", 2.5, height, "{:.2f}")
    site.grid("cover.asc", 2, cover, "{:d}")
    site.half = 50  # the hectare that was measured
    site.trees(520, 1.6, lambda x, y: 0.0 if cover(x, y) == WORDS.index("soil") else 0.75 + 0.25 * noise(x / 18, y / 18, 4),
               [("PIAB", 0.45, 28, 0.45), ("FASY", 0.30, 24, 0.55), ("ABAL", 0.17, 22, 0.5), ("ACPS", 0.08, 18, 0.5)])


def hills(folder):
    site = Site(folder, "hills", 500000, 5200000, 500, 2)
    pond_x, pond_y = 150, -170

    def from_pond(x, y):
        return math.hypot((x - pond_x) / 1.5, y - pond_y)

    def height(x, y):
        h = 480 + 26 * noise(x / 330 + 3, y / 330, 11) + 9 * noise(x / 120, y / 120, 12) + 1.5 * noise(x / 35, y / 35, 13)
        hill = 55 * math.exp(-((x + 250) ** 2 + (y - 230) ** 2) / (2 * 130 ** 2))
        bowl = 1 / (1 + math.exp((from_pond(x, y) - 48) / 9))
        yard = math.exp(-(((x - 60) / 95) ** 4 + ((y - 90) / 75) ** 4))
        h = (h + hill) * (1 - yard) + 486 * yard
        return h * (1 - bowl) + (470 - 2.5 * max(0.0, 1 - from_pond(x, y) / 38)) * bowl

    road = [(-500, -60), (-380, -35), (-240, -40), (-120, 10), (-20, 40), (60, 45), (160, 40), (290, 75), (400, 60), (500, 90)]
    track = [(60, 45), (66, 120), (30, 200), (-60, 260), (-150, 290), (-235, 245)]
    path = [(160, 40), (175, -40), (120, -95), (140, -130)]

    def near(line, x, y):
        best = 1e9
        for (ax, ay), (bx, by) in zip(line, line[1:]):
            t = max(0.0, min(1.0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2)))
            best = min(best, math.hypot(x - ax - t * (bx - ax), y - ay - t * (by - ay)))
        return best

    def cover(x, y):
        d = from_pond(x, y)
        word = "meadow"
        if d < 40:
            word = "water"
        elif d < 50:
            word = "wetland"
        elif abs(x - 60) < 80 and abs(y - 95) < 58:
            word = "grass"
        elif height(x, y) > 527:
            word = "rock"
        elif x < -60 and noise(x / 150, y / 150, 14) > -0.1 and y > -30:
            word = "forest_floor"
        elif x > 230 and y > 120 and y < 400:
            word = "crop"
        elif noise(x / 60, y / 60, 15) > 0.55:
            word = "shrub"
        return WORDS.index(word)

    site.grid("dem.asc", 10, height, "{:.1f}")
    site.grid("cover.asc", 10, cover, "{:d}")
    site.features("roads.geojson", [("LineString", road, {"width": 6.0, "surface": "asphalt"}),
                                    ("LineString", track, {"width": 3.0, "surface": "gravel"}),
                                    ("LineString", path, {"width": 1.5, "surface": "soil"})])

    def house(x, y, length, width, turn_deg, height_m, roof, roof_m, name):
        c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
        ring = [(x + c * u - s * v, y + s * u + c * v)
                for u, v in ((-length, -width), (length, -width), (length, width), (-length, width), (-length, -width))]
        return ("Polygon", [ring], {"name": name, "height": height_m, "roof": roof, "roof_height": roof_m})

    site.features("buildings.geojson", [
        house(30, 90, 9, 6, 8, 5.5, "gabled", 3.5, "farm house"), house(95, 100, 15, 8, -5, 6.0, "gabled", 4.5, "barn"),
        house(62, 132, 6, 5, 15, 3.0, "shed", 1.2, "shed"), house(112, 66, 7, 7, 0, 7.0, "pyramidal", 2.0, "mill"),
        house(-15, 75, 8, 5.5, -12, 5.0, "hipped", 3.0, "cottage"), house(130, 120, 5, 4, 0, 3.2, "flat", 0.0, "garage")])
    site.features("fences.geojson", [
        ("LineString", [(0, 60), (48, 62)], {"style": "boards", "height": 1.3}),
        ("LineString", [(150, 60), (152, 150), (80, 155), (0, 150)], {"style": "rails", "height": 1.2}),
        ("LineString", [(235, 115), (235, 405), (480, 405)], {"style": "wire", "height": 1.1})])
    poles = []
    for a, b in zip(road, road[1:]):
        steps = max(1, round(math.hypot(b[0] - a[0], b[1] - a[1]) / 45))
        for k in range(steps):
            t = k / steps
            poles.append(("Point", (a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]) - 7), {"height": 9.0}))
    site.features("poles.geojson", poles)
    ring = [(pond_x + 1.5 * 41 * math.cos(a * math.pi / 24), pond_y + 41 * math.sin(a * math.pi / 24)) for a in range(48)]
    site.features("pond.geojson", [("Polygon", [ring + ring[:1]], {"name": "pond", "level": 470.0})])

    lines = [road, track, path]

    def wanted(x, y):
        if min(near(line, x, y) for line in lines) < 7 or abs(x - 60) < 90 and abs(y - 95) < 65:
            return 0.0
        word = WORDS[cover(x, y)]
        return {"forest_floor": 1.0, "shrub": 0.12, "meadow": 0.02, "wetland": 0.06}.get(word, 0.0)

    site.trees(900, 3.0, wanted, [("PIAB", 0.4, 30, 0.4), ("FASY", 0.25, 28, 0.5), ("QURO", 0.2, 38, 0.5), ("BEPE", 0.15, 20, 0.4)])
    with open(site.path("weather.csv"), "w", newline="\n") as out:
        out.write("time,temperature_c,cloud_cover,visibility_m,rain_mm_per_h,wind_speed_m_per_s,wind_from_deg\n")
        for hour in range(25):
            warm = math.sin((hour - 9) / 24 * 2 * math.pi)
            rain = max(0.0, 4 - abs(hour - 17) * 1.6)
            cloud = min(1.0, 0.15 + 0.85 * math.exp(-((hour - 17) / 3.5) ** 2))
            view = 6000 if rain > 0 else 800 if hour in (5, 6) else 40000
            day, h = 21 + hour // 24, hour % 24
            out.write(f"2024-06-{day:02d}T{h:02d}:00:00Z,{14 + 8 * warm:.1f},{cloud:.2f},{view},{rain:.1f},"
                      f"{2 + 3 * cloud:.1f},{240 + 3 * hour}\n")


def main():
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent.parent / "configs" / "worlds" / "data"
    folder.mkdir(parents=True, exist_ok=True)
    forest(folder)
    hills(folder)


if __name__ == "__main__":
    main()
