#!/usr/bin/env python3
"""docs/speed-and-error.md from what bench_range, bench_light and bench_camera measured on this machine.

usage: tools/make_speed_and_error.py [build/release/benches]

The folder has bench_NAME.json of the three, and what bench_range and bench_light measured, as NPY files in range/ and light/. Errors are
against the references in benches/range_references and benches/light_references.
"""
import json
import math
import pathlib
import sys
import textwrap

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "benches"))
import light_error  # noqa: E402
import range_error  # noqa: E402
from pareto_plot import plot  # noqa: E402

IMAGES = ROOT / "docs" / "images"
RANGE_PLOTS = {"lidar": [("outliers", "outliers", "share of ranges beyond 0.2 m"), ("ks", "ks", "KS distance of ranges")],
               "tof": [("rms", "rms_m", "range RMS [m]")]}


def number(v, digits=3):
    if v is None or not math.isfinite(v):
        return "–"
    return f"{v:.0f}" if abs(v) >= 10**digits else f"{v:.{digits}g}"


def signed(text):
    """With a true minus, and zero without a sign."""
    return text[1:] if text[0] in "+-" and not text.strip("+-0.%") else text.replace("-", "−")


def table(head, rows):
    out = ["| " + " | ".join(head) + " |", "|" + "|".join(["---"] + ["---:"] * (len(head) - 1)) + "|"]
    out += ["| " + " | ".join(r) + " |" for r in rows]
    return out + [""]


def pictured(name, title, rows, key, y_name):
    """Lines that show a plot of time and error, where there is one."""
    points = [{"x": r["p50_ms"], "y": r[key], "renderer": r["renderer"], "label": r["knobs"] or r["renderer"]}
              for r in rows if r["name"] != "reference"]
    file = f"speed-{name}.svg".replace(" ", "-")
    return [f"![{title}](images/{file})", ""] if plot(IMAGES / file, title, points, "time p50 [ms]", y_name) else []


def range_part(rows):
    out = []
    for place, sensor in dict.fromkeys((r["place"], r["sensor"]) for r in rows):
        runs = [r for r in rows if (r["place"], r["sensor"]) == (place, sensor)]
        kind = "tof" if range_error.is_tof(sensor) else "lidar"
        out += [f"### {sensor}, {place}", "", runs[0]["about"] + ".", ""]
        for suffix, key, y_name in RANGE_PLOTS[kind]:
            out += pictured(f"{sensor}-{place}-{suffix}", f"{sensor}, {place}", runs, key, y_name)
        columns = range_error.COLUMNS[kind]
        lines = []
        for r in runs:
            own = r["name"] == "reference"
            lines.append(["reference itself" if own else r["label"]] +
                         (["", "", "", ""] if own else [number(r["p50_ms"]), number(r["p99_ms"]), number(r["cpu_ms"]), number(r["times_bare"])]) +
                         [signed(f"{r[key] * scale:{form.lstrip('+') if own else form}}") for key, scale, _, form in columns])
        out += table(["renderer, knobs", "p50 ms", "p99 ms", "CPU ms", "× bare"] + [c[2] for c in columns], lines)
    return out


def light_part(rows):
    out = []
    for place in dict.fromkeys(r["place"] for r in rows):
        runs = [r for r in rows if r["place"] == place]
        out += [f"### Light, {place}", "", f"Mean radiance {runs[0]['mean']:.3f} W/(m² sr).", ""]
        out += pictured(f"light-{place}", f"light, {place}", runs, "rms", "RMS of radiance, relative to the mean")
        lines = []
        for r in runs:
            own = r["name"] == "reference"
            lines.append(["reference itself" if own else ", ".join(filter(None, [r["renderer"], r["knobs"]]))] +
                         (["", "", ""] if own else [number(r["p50_ms"]), number(r["cpu_ms"]), "–" if r["new_place_cpu_ms"] is None else f"{r['new_place_cpu_ms']:.0f}"]) +
                         ([""] * 4 if own else [signed(f"{r['bias'][b]:+.1%}") for b in light_error.BANDS]) +
                         [f"{r['rms']:.3f}", f"{r['rms_8x8']:.3f}", "" if own else f"{r['flip']:.3f}", f"{r['flicker']:.3f}"])
        out += table(["renderer, knobs", "p50 ms", "CPU ms", "more in a new place"] + [f"bias {b}" for b in light_error.BANDS] +
                     ["RMS", "RMS 8x8", "FLIP", "flicker"], lines)
    return out


def camera_part(bench):
    out = []
    for world in dict.fromkeys(r["world"] for r in bench["runs"]):
        rows = [[r["question"], f'{r["renderer"]} {r["knobs"]}'.strip(), number(r["p50_ms"]), number(r["p99_ms"]), number(r["cpu_ms"]),
                 number(r["rms"])] for r in bench["runs"] if r["world"] == world]
        out += [f"### Effects, {world}", "", *table(["effect alone", "renderer", "p50 ms", "p99 ms", "CPU ms", "RMS"], rows)]
    return out


def main():
    if len(sys.argv) > 2:
        sys.exit(__doc__)
    folder = pathlib.Path(sys.argv[1]) if len(sys.argv) == 2 else ROOT / "build/release/benches"
    ranges, light, cameras = (json.loads((folder / f"bench_{name}.json").read_text()) for name in ("range", "light", "camera"))
    for old in IMAGES.glob("speed-*.svg"):
        old.unlink()
    text = [
        "# Speed and error",
        "",
        "How long a simulated sensor takes, and how wrong the fast way is. Measured by `./dev bench`, which writes this page;",
        "what was measured is a property of a machine:",
        "",
        f"- processor: {ranges['machine']['cpu']}, {ranges['machine']['threads']} threads",
        f"- Vulkan device: {ranges['machine']['vulkan']}",
        "",
        "CPU is that of all threads together, median. Sensors and worlds stand still, except under *Light of pictures*; [what a driving rig costs](range-error.md#a-rig-that-drives)",
        "is more. In plots the runs that no other beats in both time and error have a name.",
        "",
        "## LiDAR and time of flight",
        "",
        "Against [references by a thousand rays](range-error.md), without the devices' own errors. `× bare` is CPU over that of Embree alone for one ray",
        "a beam or pixel with the same test of leaves.",
        "",
        *range_part(range_error.measure(ROOT / "benches/range_references", folder / "range", ranges["runs"])),
        "## Light of pictures",
        "",
        "640x480 pixels, a window of 160x120 of them against [a path-traced reference](light-error.md). *More in a new place*: CPU of the first picture",
        "from another cube of 1 m, less that of the second. Times are those of pictures from an eye that drives ahead by 6 cm from one to the next;",
        "pictures from an eye that stands still, as under *Effects of cameras*, find all [sunlight through leaves](light-error.md#sunlight-that-is-kept) kept.",
        "",
        *light_part(light_error.measure(ROOT / "benches/light_references", folder / "light", light["runs"])),
        "## Effects of cameras",
        "",
        *textwrap.wrap(" ".join(cameras["about"]), 120),
        "",
        *camera_part(cameras),
    ]
    (ROOT / "docs" / "speed-and-error.md").write_text("\n".join(text).rstrip() + "\n")
    print("docs/speed-and-error.md")


if __name__ == "__main__":
    main()
