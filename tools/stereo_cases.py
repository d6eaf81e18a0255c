#!/usr/bin/env python3
"""Semi-global matching in four cases: simple scene and forest, with ideal cameras and with the cameras' error models.

usage: tools/stereo_cases.py [--qualities] [--rigor build/release/rigor] [-o report/stereo-cases] [--pictures docs/images]

Runs configs/rigs/stereo.yaml and stereo-forest.yaml twice each, and prints the tables of docs/stereo.md. Each case has its folder
with result.json and a picture of each view; --pictures copies that of one view of each case. With --qualities the cases are instead
those of the forest by the renderer rays: quick, as by default, better, and 64 samples a pixel.
"""
import argparse
import json
import pathlib
import shutil
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
IDEAL = ["channels.left.ideal=true", "channels.right.ideal=true", "application.pinholes=true"]
# Folder, name, rig, settings, and the view whose picture is shown.
CASES = [("simple-ideal", "simple scene, ideal cameras", "stereo.yaml", IDEAL, 3),
         ("simple-real", "simple scene, error models", "stereo.yaml", [], 3),
         ("forest-ideal", "forest, ideal cameras", "stereo-forest.yaml", IDEAL, 0),
         ("forest-real", "forest, error models", "stereo-forest.yaml", [], 0)]


def rays(quality):
    return [f"channels.{side}.{key}" for side in ("left", "right") for key in ("renderer=rays", f"quality={{ {quality} }}")]


QUALITIES = [("quick", "forest, 1 sample, 16 at the sky's edges", "stereo-forest.yaml", rays("samples_per_pixel: 1, sky_samples: 16"), 0),
             ("default", "forest, 1 sample, 7 more where uneven, 64 at the sky's edges", "stereo-forest.yaml",
              rays("samples_per_pixel: 1, uneven_samples: 7, sky_samples: 64"), 0),
             ("better", "forest, 4 samples, 16 more where uneven, 64 at the sky's edges", "stereo-forest.yaml",
              rays("samples_per_pixel: 4, uneven_samples: 16, sky_samples: 64"), 0),
             ("reference", "forest, 64 samples, 64 at the sky's edges", "stereo-forest.yaml",
              rays("samples_per_pixel: 64, sky_samples: 64"), 0)]


def percent(x):
    return f"{100 * x:.1f} %"


def row(name, e):
    return (f"| {name} | {percent(e['completeness'])} | {percent(e['correct'])} | {percent(e['bad1'])} | {percent(e['bad2'])} | "
            f"{e['disparity_median_px']:.2f} px | {e['disparity_bias_px']:+.2f} px | {e['disparity_rms_px']:.2f} px | "
            f"{e['depth_median_percent']:.2f} % | {e['depth_rms_m']:.2f} m |")


HEAD = ("completeness | correct | bad 1 px | bad 2 px | disparity: median error | bias | RMS | depth: median error | RMS |\n"
        "|---|---|---|---|---|---|---|---|---|---|")


def main():
    p = argparse.ArgumentParser()
    p.add_argument("--rigor", type=pathlib.Path, default=ROOT / "build/release/rigor")
    p.add_argument("-o", "--output", type=pathlib.Path, default=pathlib.Path("report/stereo-cases"))
    p.add_argument("--pictures", type=pathlib.Path)
    p.add_argument("--tables-only", action="store_true", help="of results that are there already")
    p.add_argument("--qualities", action="store_true", help="qualities of the renderer rays in place of the four cases")
    args = p.parse_args()
    results = {}
    cases = QUALITIES if args.qualities else CASES
    for key, name, rig, settings, view in cases:
        folder = args.output / key
        command = [str(args.rigor), "run", str(ROOT / "configs/rigs" / rig), "--json"]
        for s in settings + [f"application.output={folder}"]:
            command += ["--set", s]
        if not args.tables_only and subprocess.run(command, stdout=subprocess.PIPE).returncode != 0:
            print(f"stereo_cases: {' '.join(command)}: failed", file=sys.stderr)
            return 1
        results[key] = json.loads((folder / "result.json").read_text())["evaluation"]
        if args.pictures:
            shutil.copy(folder / f"view-{view:03}.png", args.pictures / f"stereo-{key}.png")
    print("| | " + HEAD)
    for key, name, *_ in cases:
        print(row(name, results[key]["all"]))
    print("\n| | density | of it where nothing is |\n|---|---|---|")
    for key, name, *_ in cases:
        e = results[key]
        print(f"| {name} | {percent(e['density'])} | {percent(e['invented'])} of {percent(e['empty'])} |")
    print("\n| depth | " + HEAD)
    for key, name, *_ in cases:
        for e in results[key]["by_depth"]:
            to = f"{e['from_m']:.0f}–{e['to_m']:.0f} m" if "to_m" in e else f"over {e['from_m']:.0f} m"
            print(row(f"{to}, {name} ({e['judged_px']} px)", e))
    return 0


if __name__ == "__main__":
    sys.exit(main())
