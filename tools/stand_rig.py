#!/usr/bin/env python3
"""Puts the robot of configs/rigs/seekurjr-forest*.yaml into another stand: exports the map of its stems, plans a way, writes a rig.

    rigor world import configs/worlds/real-stand.import.yaml -o av06.rigor --set …
    tools/stand_rig.py av06.rigor --past="20,-20 80,-20 80,20 20,20 20,-18" -o stand
    rigor run stand/seekurjr-forest-light-av06.yaml --clock virtual

Other keys of the rig stay as they are. The standard library alone is needed, and `rigor` (--rigor FILE where it is not in PATH).
"""
import argparse
import json
import math
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def run(*words):
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"stand_rig: {' '.join(str(w) for w in words)}\n{done.stderr.strip()}")
    return done.stdout


def replaced(text, pattern, value):
    text, count = re.subn(pattern, lambda m: m.group(1) + value + m.group(2), text, flags=re.MULTILINE)
    if count == 0:
        sys.exit(f"stand_rig: expected a line like {pattern} in the rig, found none")
    return text


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("world", type=Path, help="world file or import plan")
    parser.add_argument("--past", required=True, metavar='="X,Y X,Y …"', help="start, places on the way, goal")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for map, way and rig")
    parser.add_argument("--rig", type=Path, default=ROOT / "configs/rigs/seekurjr-forest-light.yaml")
    parser.add_argument("--at-height", type=float, default=0.8, help="metres above the foot where stems are measured (0.8)")
    parser.add_argument("--clearance", default="0.9", help="metres from bark to the way (0.9)")
    parser.add_argument("--rigor", default="rigor")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    stems, way = options.output / "stems.csv", options.output / "way.csv"
    print(run(options.rigor, "world", "export", options.world, "-o", stems, "--at-height", options.at_height, "--force").strip())
    print(run(sys.executable, ROOT / "tools/plan_way.py", stems, "-o", way, f"--past={options.past}",
              f"--clearance={options.clearance}").strip())
    anchor = json.loads(run(options.rigor, "world", "info", options.world, "--json"))["anchor"]
    rows = [tuple(float(v) for v in line.split(",")) for line in way.read_text().splitlines()[1:]]
    ahead = rows[min(4, len(rows) - 1)]
    start = f"position_m: [{rows[0][0]}, {rows[0][1]}], " \
            f"yaw_deg: {math.degrees(math.atan2(ahead[1] - rows[0][1], ahead[0] - rows[0][0])):.1f}"
    text = options.rig.read_text()
    stand = options.world.name.split(".")[0]
    old = re.search(r"^name: (\S+)", text, re.MULTILINE).group(1)
    name = f"{old}-{stand}"
    text = re.sub(r"\A(#.*\n)+", f"# As tools/stand_rig.py made it of {options.rig.name} for {options.world.name}.\n", text)
    text = text.replace(f"name: {old}\n", f"name: {name}\n").replace(f"report/{old}.mcap", f"report/{name}.mcap")
    text = replaced(text, r"^(  world: )\S+()", str(options.world.resolve()))
    text = replaced(text, r"(T_world_start: \{ )position_m: \[[^]]*\], yaw_deg: [-\d.]+( \})", start)
    text = replaced(text, r"^(  start: \{ )position_m: \[[^]]*\], yaw_deg: [-\d.]+(,)", start)
    text = replaced(text, r"^(  gnss: .*origin: \{ )[^}]*?( \})",
                    f"latitude_deg: {anchor['latitude_deg']}, longitude_deg: {anchor['longitude_deg']}, height_m: {anchor['height_m']}")
    text = replaced(text, r"^(  map: \{ file: )[^,} ]+()", str(stems.resolve()))
    text = replaced(text, r"^(  path: \{ file: )[^,} ]+()", str(way.resolve()))
    text = text.replace(" ../", f" {options.rig.resolve().parent.parent}/")
    rig = options.output / f"{name}.yaml"
    rig.write_text(text)
    print(rig)


if __name__ == "__main__":
    main()
