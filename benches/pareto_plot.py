"""Error against time, one point a run, as SVG: named and on the line are the runs that no other beats in both."""
import math

COLOURS = {"rays": "#c2410c", "raster": "#1d4ed8"}


def ticks(low, high):
    """Powers of ten and what lies between, on a logarithmic axis."""
    out = []
    for e in range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1):
        for m in (1, 2, 5):
            v = m * 10.0**e
            if low <= v <= high:
                out.append(v)
    return out


def front(points):
    """Points that no other beats in both coordinates, from fast to exact."""
    best, out = math.inf, []
    for p in sorted(points, key=lambda p: (p["x"], p["y"])):
        if p["y"] < best:
            best = p["y"]
            out.append(p)
    return out


def plot(path, title, points, x_name, y_name):
    points = [p for p in points if p["x"] > 0 and math.isfinite(p["y"])]
    if not points:
        return False
    floor = min([p["y"] for p in points if p["y"] > 0] or [1e-4]) / 2
    for p in points:
        p["y"] = max(p["y"], floor)
    width, height, left, bottom, top, right = 760, 360, 70, 46, 34, 16
    x0, x1 = min(p["x"] for p in points) / 1.4, max(p["x"] for p in points) * 1.6
    y0, y1 = min(p["y"] for p in points) / 1.5, max(p["y"] for p in points) * 1.5

    def sx(x):
        return left + (width - left - right) * math.log(x / x0) / math.log(x1 / x0)

    def sy(y):
        return height - bottom - (height - bottom - top) * math.log(y / y0) / math.log(y1 / y0)

    s = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="11">',
        f'<rect width="{width}" height="{height}" fill="white"/><text x="{left}" y="18" font-size="13">{title}</text>',
    ]
    for v in ticks(x0, x1):
        s.append(f'<path d="M{sx(v):.1f} {top}V{height - bottom}" stroke="#e5e7eb"/>')
        s.append(f'<text x="{sx(v):.1f}" y="{height - bottom + 14}" text-anchor="middle">{v:g}</text>')
    for v in ticks(y0, y1):
        s.append(f'<path d="M{left} {sy(v):.1f}H{width - right}" stroke="#e5e7eb"/>')
        s.append(f'<text x="{left - 6}" y="{sy(v) + 4:.1f}" text-anchor="end">{v:g}</text>')
    s.append(f'<text x="{(left + width - right) / 2}" y="{height - 8}" text-anchor="middle">{x_name}</text>')
    s.append(
        f'<text transform="translate(14 {(top + height - bottom) / 2}) rotate(-90)" text-anchor="middle">{y_name}</text>'
    )
    best = front(points)
    line = " ".join(f'{sx(p["x"]):.1f},{sy(p["y"]):.1f}' for p in best)
    for i, (engine, colour) in enumerate(COLOURS.items()):
        s.append(f'<circle cx="{width - 150 + 70 * i}" cy="14" r="4" fill="{colour}"/>')
        s.append(f'<text x="{width - 142 + 70 * i}" y="18" fill="{colour}">{engine}</text>')
    s.append(f'<polyline points="{line}" fill="none" stroke="#6b7280" stroke-dasharray="4 3"/>')
    for p in points:
        colour = COLOURS.get(p["renderer"], "#374151")
        s.append(f'<circle cx="{sx(p["x"]):.1f}" cy="{sy(p["y"]):.1f}" r="4" fill="{colour}"><title>{p["label"]}</title></circle>')
    taken = [(sx(p["x"]) - 4, sy(p["y"]) - 4, sx(p["x"]) + 4, sy(p["y"]) + 4) for p in points]

    def covered(box):
        outside = box[0] < left or box[2] > width - 2 or box[1] < top or box[3] > height - bottom
        return 100 * outside + sum(box[0] < t[2] and t[0] < box[2] and box[1] < t[3] and t[1] < box[3] for t in taken)

    for p in best:
        x, y, long = sx(p["x"]), sy(p["y"]), 6.3 * len(p["label"])
        # Beside the point, above or below it: where it covers least.
        places = [(x + 6 if side > 0 else x - 6 - long, y + shift, side) for shift in (-4, 12, -16, 24, -28) for side in (1, -1)]
        tx, ty, side = min(places, key=lambda at: covered((at[0], at[1] - 9, at[0] + long, at[1] + 2)))
        taken.append((tx, ty - 9, tx + long, ty + 2))
        colour = COLOURS.get(p["renderer"], "#374151")
        anchor = f'x="{x + 6:.1f}"' if side > 0 else f'x="{x - 6:.1f}" text-anchor="end"'
        s.append(f'<text {anchor} y="{ty:.1f}" fill="{colour}">{p["label"]}</text>')
    s.append("</svg>\n")
    path.write_text("\n".join(s))
    return True
