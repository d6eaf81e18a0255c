#!/usr/bin/env python3
"""Errors of quick LiDARs and time-of-flight cameras against references by 1024 rays and more (bench_range).

    build/release/benches/bench_range --out refs --reference 2            # once: a minute
    build/release/benches/bench_range --out quick --json quick/times.json
    python3 benches/range_error.py refs --store benches/range_references  # once: as small files
    python3 benches/range_error.py benches/range_references quick [--pictures DIR] [--json FILE] [--markdown]

All of it without the devices' own errors. LiDAR, over its beams:

  gap       share of beams without return; of a quick one, less that of the reference
  echoes    mean number of echoes of a beam, as a device with dual returns counts them: 0, 1 or 2
  ks        Kolmogorov-Smirnov distance of the ranges: the largest difference of their cumulative distributions
  rmse      of range, of beams whose range is within 0.2 m of the reference; outliers: share of the others
  missed    share of the reference's returns that are not there; false: share of beams with a return that it has not

Time of flight, over its pixels:

  bias, rms of range, of pixels within 50 mm of the reference (a range is a phase: it differs by at most half of the
            unambiguous range); outliers: share of the others
  amplitude bias of its mean, and RMS relative to the mean

The reference joins the rays of its passes. Its own error is that of one pass against another, so an upper bound.
"""
import argparse
import json
import re
import sys
from pathlib import Path

import numpy as np

import error_files
from error_files import rms

SENSORS = ("velodyne-vlp16", "sick-lms111", "sr4000", "sr4000-moving")
PLACES = ("indoor", "forest", "landscape")
UNAMBIGUOUS_M = {"sr4000": 299792458 / (2 * 30e6), "sr4000-moving": 299792458 / (2 * 30e6)}
OUTLIER_M = {"lidar": 0.2, "tof": 0.05}


def is_tof(sensor):
    return sensor in UNAMBIGUOUS_M


def ks_distance(a, b):
    """Of two samples, each in any order."""
    if len(a) == 0 or len(b) == 0:
        return 0.0 if len(a) == len(b) else 1.0
    a, b, at = np.sort(a), np.sort(b), np.concatenate([a, b])
    return float(np.abs(np.searchsorted(a, at, "right") / len(a) - np.searchsorted(b, at, "right") / len(b)).max())


def lidar_errors(quick, reference):
    """Arrays whose last axis is range (NaN: no return), remission, echoes."""
    q, r = quick.reshape(-1, 3), reference.reshape(-1, 3)
    has_q, has_r = np.isfinite(q[:, 0]), np.isfinite(r[:, 0])
    difference = (q[:, 0] - r[:, 0])[has_q & has_r]
    near = np.abs(difference) <= OUTLIER_M["lidar"]
    return {"gap": float(has_r.mean() - has_q.mean()), "echoes": float(q[:, 2].mean() - r[:, 2].mean()),
            "ks": ks_distance(q[has_q, 0], r[has_r, 0]), "rmse_m": rms(difference[near]) if near.any() else 0.0,
            "outliers": float(1 - near.mean()) if len(near) else 0.0,
            "missed": float((has_r & ~has_q).sum() / max(has_r.sum(), 1)), "false": float((has_q & ~has_r).mean())}


def phase_difference(quick, reference, unambiguous_m):
    difference = quick - reference
    return difference - unambiguous_m * np.round(difference / unambiguous_m)


def tof_errors(quick, reference, unambiguous_m):
    """Arrays whose last axis is range (NaN: none), amplitude, nothing."""
    q, r = quick.reshape(-1, 3), reference.reshape(-1, 3)
    has_q, has_r = np.isfinite(q[:, 0]), np.isfinite(r[:, 0])
    difference = phase_difference(q[:, 0], r[:, 0], unambiguous_m)[has_q & has_r]
    near = np.abs(difference) <= OUTLIER_M["tof"]
    mean = r[:, 1].mean()
    return {"bias_m": float(difference[near].mean()) if near.any() else 0.0, "rms_m": rms(difference[near]) if near.any() else 0.0,
            "outliers": float(1 - near.mean()) if len(near) else 0.0,
            "amplitude_bias": float(q[:, 1].mean() / mean - 1), "amplitude_rms": rms(q[:, 1] - r[:, 1]) / mean,
            "missed": float((has_r & ~has_q).sum() / max(has_r.sum(), 1)), "false": float((has_q & ~has_r).mean())}


def errors_of(sensor, quick, reference):
    return tof_errors(quick, reference, UNAMBIGUOUS_M[sensor]) if is_tof(sensor) else lidar_errors(quick, reference)


# ------------------------------------------------------------------ references

def own_errors(sensor, passes):
    """Of each pass against the first, in the mean, without sign."""
    each = [errors_of(sensor, p, passes[0]) for p in passes[1:]]
    return {key: float(np.mean([abs(e[key]) for e in each])) for key in each[0]}


def reference_of(folder, stem, sensor):
    """(values, own errors): from a stored file, or else from the passes of bench_range."""
    file = folder / f"{stem}.npz"
    if file.is_file():
        with np.load(file) as z:
            return z["values"].astype(float), json.loads(str(z["own"]))
    return np.load(folder / f"{stem}-reference.npy").astype(float), own_errors(sensor, error_files.passes_of(folder, stem))


def rounded(values, sensor):
    """Range to 1/16 mm or 1/2 mm, the rest to 11 bits: finer than the error of any reference, and they pack well."""
    out = values.copy()
    step_m = 2.0 ** (-14 if is_tof(sensor) else -11)
    out[..., 0] = np.round(values[..., 0] / step_m) * step_m
    fraction, exponent = np.frexp(values[..., 1])
    out[..., 1] = np.ldexp(np.round(fraction * 2048) / 2048, exponent)
    return out.astype(np.float32)


def store(folder, stem, sensor, target):
    values, own = reference_of(folder, stem, sensor)
    file, size_kib = error_files.store(target, stem, {"values": rounded(values, sensor), "own": json.dumps(own)})
    print(f"{file}: {size_kib:.0f} KiB")


# ------------------------------------------------------------------ tables and pictures

COLUMNS = {"lidar": [("gap", 100, "gap %", "+.2f"), ("echoes", 1, "echoes", "+.3f"), ("ks", 1, "KS", ".4f"), ("rmse_m", 1e3, "RMSE mm", ".1f"),
                     ("outliers", 100, "outliers %", ".2f"), ("missed", 100, "missed %", ".2f"), ("false", 100, "false %", ".2f")],
           "tof": [("bias_m", 1e3, "bias mm", "+.2f"), ("rms_m", 1e3, "RMS mm", ".2f"), ("outliers", 100, "outliers %", ".2f"),
                   ("amplitude_bias", 100, "amplitude %", "+.2f"), ("amplitude_rms", 100, "amplitude RMS %", ".1f"),
                   ("missed", 100, "missed %", ".2f"), ("false", 100, "false %", ".2f")]}


def file_name(run):
    return f"{run['renderer']}-{run['knobs']}".replace(",", "").replace("/", "-").replace(" ", "-")


def print_table(sensor, rows, markdown):
    columns = COLUMNS["tof" if is_tof(sensor) else "lidar"]
    cells = [["", "CPU ms"] + [c[2] for c in columns]]
    for row in rows:
        own = row["name"] == "reference"
        cpu = "" if row["cpu_ms"] is None else f"{row['cpu_ms']:.3g}" if row["cpu_ms"] < 1000 else f"{row['cpu_ms']:.0f}"
        cells.append(["reference itself" if own else row["label"], cpu] +
                     [f"{row[key] * scale:{form.lstrip('+') if own else form}}" for key, scale, _, form in columns])
    if markdown:
        lines = ["| " + " | ".join(c) + " |" for c in cells]
        lines.insert(1, "|---|" + "---:|" * (len(columns) + 1))
    else:
        widths = [max(len(c[i]) for c in cells) for i in range(len(cells[0]))]
        lines = ["  " + c[0].ljust(widths[0]) + "".join("  " + t.rjust(w) for t, w in zip(c[1:], widths[1:])) for c in cells]
    print("\n".join(lines))


def places_of(references):
    return [(p, s) for p in PLACES for s in SENSORS
            if (references / f"{p}-{s}.npz").is_file() or (references / f"{p}-{s}-reference.npy").is_file()]


def measure(references, quick, runs, pictures=None):
    """Rows of all places and sensors that were measured, of each first that of the reference itself: dictionaries."""
    times = {(r["world"], r["sensor"], file_name(r)): r for r in runs}
    out = []
    for place, sensor in places_of(references):
        stem = f"{place}-{sensor}"
        quick_of = {n: np.load(quick / f"{stem}-{n}.npy").astype(float)
                    for p, s, n in times if (p, s) == (place, sensor) and (quick / f"{stem}-{n}.npy").is_file()}
        if not quick_of:
            continue
        reference, own = reference_of(references, stem, sensor)
        has = np.isfinite(reference[..., 0])
        about = (f"{has.size} {'pixels' if is_tof(sensor) else 'beams'}, {100 * (1 - has.mean()):.1f} % without return" +
                 ("" if is_tof(sensor) else f", {reference[..., 2].mean():.3f} echoes a beam"))
        out.append({"place": place, "sensor": sensor, "name": "reference", "about": about, "cpu_ms": None, **own})
        for name, values in quick_of.items():
            run = times[place, sensor, name]
            out.append({"place": place, "sensor": sensor, "name": name, "label": f"{run['renderer']}, {run['knobs']}", **run,
                        **errors_of(sensor, values, reference)})
        if pictures and is_tof(sensor):
            side_by_side(pictures / f"range-{stem}.png", sensor, reference, quick_of)
    return out


def range_colours(reference, unambiguous_m):
    """Near is bright; without range: blue."""
    range_m = reference[..., 0]
    grey = 255 * (1 - np.nan_to_num(range_m) / unambiguous_m)
    return np.where(np.isfinite(range_m)[..., None], np.stack([grey] * 3, -1), [40, 60, 140])


def error_colours(quick, reference, unambiguous_m):
    """White: none; red: 50 mm too far and more; blue: too near. Missing or too many: black."""
    d = phase_difference(quick[..., 0], reference[..., 0], unambiguous_m) / OUTLIER_M["tof"]
    shade = np.clip(np.nan_to_num(d), -1, 1)
    colours = 255 * np.stack([1 + np.minimum(shade, 0), 1 - np.abs(shade), 1 - np.maximum(shade, 0)], -1)
    one = np.isfinite(quick[..., 0]) != np.isfinite(reference[..., 0])
    none = ~np.isfinite(quick[..., 0]) & ~np.isfinite(reference[..., 0])
    return np.where(one[..., None], 0, np.where(none[..., None], [200, 200, 200], colours))


def side_by_side(file, sensor, reference, quick_of):
    """Of a time-of-flight camera: the reference's ranges, and the errors in full with 1, 4 and 16 samples."""
    shown = [range_colours(reference, UNAMBIGUOUS_M[sensor])]
    shown += [error_colours(quick, reference, UNAMBIGUOUS_M[sensor]) for name, quick in quick_of.items()
              if re.fullmatch(r"rays-(1|4|16)-samples?-in-full(-four-instants)?", name)]
    gap = np.full((reference.shape[0], 2, 3), 255.0)
    row = np.concatenate([part for picture in shown for part in (picture, gap)][:-1], axis=1)
    error_files.png(file, row.repeat(3, axis=0).repeat(3, axis=1))


def self_test():
    rng = np.random.default_rng(1)
    beams = np.stack([rng.uniform(2, 40, 4000), rng.uniform(5, 50, 4000), np.ones(4000)], -1)
    beams[:400, 0], beams[:400, 2] = np.nan, 0
    same = all(v == 0 for v in lidar_errors(beams, beams).values())
    near = beams.copy()
    near[..., 0] += rng.normal(0, 0.03, 4000)
    e = lidar_errors(near, beams)
    noisy = abs(e["rmse_m"] - 0.03) < 0.002 and e["outliers"] == 0 and e["ks"] < 0.005
    gone = beams.copy()
    gone[400:800, 0] = np.nan  # a tenth more than the tenth that has none
    gone[800:1160, 0] += 5  # a tenth of those that both have, and 8/9 of the beams have
    gone[:40, 0] = 7
    e = lidar_errors(gone, beams)
    gaps = (abs(e["gap"] - 0.09) < 1e-9 and abs(e["missed"] - 400 / 3600) < 1e-9 and abs(e["false"] - 0.01) < 1e-9 and
            abs(e["outliers"] - 360 / 3200) < 1e-9)
    # Two uniform distributions, one shifted by a fifth of its width.
    shifted = abs(ks_distance(np.arange(1000), np.arange(1000) + 200.5) - 0.201) < 0.002
    pixels = np.stack([rng.uniform(0.2, 4.8, (40, 50)), rng.uniform(500, 5000, (40, 50)), np.zeros((40, 50))], -1)
    unambiguous_m = UNAMBIGUOUS_M["sr4000"]
    moved = pixels * [1, 1.02, 1]
    moved[..., 0] = (pixels[..., 0] + 0.004) % unambiguous_m
    moved[0, :, 0] = (pixels[0, :, 0] + 0.3) % unambiguous_m
    moved[1, 0, 0] = pixels[1, 0, 0] - unambiguous_m + 0.004
    e = tof_errors(moved, pixels, unambiguous_m)
    phase = (abs(e["bias_m"] - 0.004) < 1e-6 and abs(e["rms_m"] - 0.004) < 1e-6 and abs(e["outliers"] - 1 / 40) < 1e-9 and
             abs(e["amplitude_bias"] - 0.02) < 1e-9)
    packed = rounded(pixels, "sr4000")
    fine = np.abs(packed - pixels)[..., 0].max() < 4e-5 and (np.abs(packed / np.maximum(pixels, 1e-9) - 1)[..., 1]).max() < 5e-4
    print(f"self-test: same {same}, noisy {noisy}, gaps {gaps}, shifted {shifted}, phase {phase}, packed {fine}")
    return 0 if same and noisy and gaps and shifted and phase and fine else 1


def main():
    if sys.argv[1:] == ["--self-test"]:
        return self_test()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("references", type=Path)
    parser.add_argument("quick", type=Path, nargs="?")
    parser.add_argument("--store", type=Path, metavar="DIR")
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--markdown", action="store_true")
    o = parser.parse_args()
    known = places_of(o.references)
    if not known:
        sys.exit(f"range_error: {o.references} has no reference: bench_range --out {o.references} --reference 2")
    if o.store:
        for place, sensor in known:
            store(o.references, f"{place}-{sensor}", sensor, o.store)
        return 0
    if not o.quick:
        sys.exit("range_error: expected a folder of quick measurements (bench_range --out DIR), or --store DIR")
    if o.pictures:
        o.pictures.mkdir(parents=True, exist_ok=True)
    out = measure(o.references, o.quick, error_files.runs_of(o.quick), o.pictures)
    for place, sensor in known:
        rows = [r for r in out if (r["place"], r["sensor"]) == (place, sensor)]
        if rows:
            print(f"\n{place}, {sensor}: {rows[0]['about']}\n")
            print_table(sensor, rows, o.markdown)
    if o.json:
        o.json.write_text(json.dumps(out, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
