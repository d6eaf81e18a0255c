#!/usr/bin/env python3
"""Errors of quick pictures against a path-traced reference (bench_light): table, JSON and pictures side by side.

    build/release/benches/bench_light --out refs --reference 4          # once: ten minutes
    build/release/benches/bench_light --out quick --json quick/times.json
    python3 benches/light_error.py refs --store benches/light_references # once: their means, as small files
    python3 benches/light_error.py benches/light_references quick [--pictures DIR] [--json FILE]

Radiance is relative to the reference's mean, the four bands together unless a column names one:

  bias      mean of quick less reference, by band
  rms       root mean square of the difference, per pixel; rms 8x8: of the means of blocks of 8x8 pixels
  flip      mean FLIP error of the tone-mapped colours, at 67 pixels a degree (Andersson et al., Proc. ACM CGIT 3(2), 2020)
  flicker   RMS of (change of quick) less (change of reference) between the eye and the eye turned by a quarter of a pixel

The reference's own error is the standard error of the mean over its passes, and stands in the first row of a place. It does
not know the error of the 16 x 16 grid in a pixel, which all passes share. It is not subtracted from the others.
"""
import argparse
import json
import sys
from pathlib import Path

import numpy as np

import error_files
from error_files import rms

BANDS = ["red", "green", "blue", "850 nm"]
PIXELS_PER_DEGREE = 67.0


def reference_of(folder, place, turned=""):
    """(mean, RMS of the standard errors of the values, passes) of the passes of bench_light."""
    passes = error_files.passes_of(folder, place, turned)
    return passes.mean(axis=0), rms(passes.std(axis=0, ddof=1) / np.sqrt(len(passes))), len(passes)


def stored(folder, place):
    """{"": (mean, standard error), "-turned": the same} of a place: from a stored file, or else from the passes of bench_light.
    Half precision is finer than the error of any reference."""
    file = folder / f"{place}.npz"
    if file.is_file():
        with np.load(file) as z:
            return {t: (z[f"mean{t}"].astype(float), float(z[f"error{t}"])) for t in ("", "-turned")}
    return {t: reference_of(folder, place, t)[:2] for t in ("", "-turned")}


def store(folder, place, target):
    content = {}
    for turned in ("", "-turned"):
        mean, error, passes = reference_of(folder, place, turned)
        content |= {f"mean{turned}": mean.astype(np.float16), f"error{turned}": error, f"passes{turned}": passes}
    file, size_kib = error_files.store(target, place, content)
    print(f"{file}: {size_kib:.0f} KiB, error {content['error'] / content['mean'].astype(float).mean():.4f} of the mean")


def blocks(picture, side=8):
    h, w, c = picture.shape
    return picture[:h // side * side, :w // side * side].reshape(h // side, side, w // side, side, c).mean(axis=(1, 3))


# ------------------------------------------------------------------ FLIP (the names follow the paper)

def tone_mapped(picture, white):
    """Linear colours, 0 to 1."""
    return np.clip(picture[..., :3] / white, 0, 1)


def to_ycxcz(rgb):
    xyz = rgb @ np.array([[0.4124564, 0.2126729, 0.0193339], [0.3575761, 0.7151522, 0.1191920], [0.1804375, 0.0721750, 0.9503041]])
    xyz = xyz / np.array([0.950428545, 1.0, 1.088900371])
    return np.stack([116 * xyz[..., 1] - 16, 500 * (xyz[..., 0] - xyz[..., 1]), 200 * (xyz[..., 1] - xyz[..., 2])], -1)


def from_ycxcz(v):
    y = (v[..., 0] + 16) / 116
    xyz = np.stack([y + v[..., 1] / 500, y, y - v[..., 2] / 200], -1) * np.array([0.950428545, 1.0, 1.088900371])
    return xyz @ np.linalg.inv(np.array([[0.4124564, 0.2126729, 0.0193339], [0.3575761, 0.7151522, 0.1191920],
                                         [0.1804375, 0.0721750, 0.9503041]]))


def to_hunt_lab(rgb):
    xyz = rgb @ np.array([[0.4124564, 0.2126729, 0.0193339], [0.3575761, 0.7151522, 0.1191920], [0.1804375, 0.0721750, 0.9503041]])
    xyz = xyz / np.array([0.950428545, 1.0, 1.088900371])
    d = 6 / 29
    f = np.where(xyz > d ** 3, np.cbrt(xyz), xyz / (3 * d * d) + 4 / 29)
    lightness = 116 * f[..., 1] - 16
    return np.stack([lightness, 0.01 * lightness * 500 * (f[..., 0] - f[..., 1]), 0.01 * lightness * 200 * (f[..., 1] - f[..., 2])], -1)


def filtered(plane, kernel):
    """Correlation with the borders repeated."""
    ry, rx = kernel.shape[0] // 2, kernel.shape[1] // 2
    padded, out = np.pad(plane, ((ry, ry), (rx, rx)), mode="edge"), np.zeros_like(plane)
    for y in range(kernel.shape[0]):
        for x in range(kernel.shape[1]):
            if kernel[y, x] != 0:
                out += kernel[y, x] * padded[y:y + plane.shape[0], x:x + plane.shape[1]]
    return out


def contrast_kernels():
    """Of the achromatic, red-green and blue-yellow channels: sums of Gaussians of the contrast sensitivity."""
    parts = [[(1.0, 0.0047), (0.0, 1e-5)], [(1.0, 0.0053), (0.0, 1e-5)], [(34.1, 0.04), (13.5, 0.025)]]
    radius = int(np.ceil(3 * np.sqrt(0.04 / (2 * np.pi ** 2)) * PIXELS_PER_DEGREE))
    y, x = np.mgrid[-radius:radius + 1, -radius:radius + 1] / PIXELS_PER_DEGREE
    kernels = []
    for gaussians in parts:
        k = sum(a * np.sqrt(np.pi / b) * np.exp(-np.pi ** 2 * (x * x + y * y) / b) for a, b in gaussians)
        kernels.append(k / k.sum())
    return kernels


def features(lightness):
    """Magnitudes of edges and of points."""
    sd = 0.5 * 0.082 * PIXELS_PER_DEGREE
    radius = int(np.ceil(3 * sd))
    y, x = np.mgrid[-radius:radius + 1, -radius:radius + 1].astype(float)
    g = np.exp(-(x * x + y * y) / (2 * sd * sd))
    magnitudes = []
    for kernel in (-x * g, (x * x / (sd * sd) - 1) * g):
        kernel = np.where(kernel < 0, kernel / -kernel[kernel < 0].sum(), kernel / max(kernel[kernel > 0].sum(), 1e-30))
        magnitudes.append(np.hypot(filtered(lightness, kernel), filtered(lightness, kernel.T)))
    return magnitudes


def hyab(a, b):
    d = a - b
    return np.abs(d[..., 0]) + np.hypot(d[..., 1], d[..., 2])


def flip(reference, test):
    """FLIP's error of each pixel; colours linear, 0 to 1."""
    q_c, p_c, p_t, q_f = 0.7, 0.4, 0.95, 0.5
    kernels, perceived, opponent = contrast_kernels(), [], []
    for rgb in (reference, test):
        ycc = to_ycxcz(rgb)
        opponent.append(ycc)
        smooth = np.stack([filtered(ycc[..., c], kernels[c]) for c in range(3)], -1)
        perceived.append(to_hunt_lab(np.clip(from_ycxcz(smooth), 0, 1)))
    green, blue = (to_hunt_lab(np.array(c, float)) for c in ((0, 1, 0), (0, 0, 1)))
    most = hyab(green, blue) ** q_c
    colour = hyab(*perceived) ** q_c
    cut = p_c * most
    colour = np.where(colour < cut, colour * p_t / cut, p_t + (colour - cut) / (most - cut) * (1 - p_t))
    (edge_a, point_a), (edge_b, point_b) = (features((v[..., 0] + 16) / 116) for v in opponent)
    feature = np.clip(np.maximum(np.abs(edge_a - edge_b), np.abs(point_a - point_b)) / np.sqrt(2), 0, 1) ** q_f
    return colour ** (1 - feature)


# ------------------------------------------------------------------ table and pictures

def errors_of(quick, reference, turned=None, reference_turned=None):
    mean = reference.mean()
    # Nearly all of the reference is below white.
    white = float(np.quantile(reference[..., :3], 0.98))
    out = {"bias": {band: float((quick[..., b] - reference[..., b]).mean() / reference[..., b].mean()) for b, band in enumerate(BANDS)},
           "rms": rms(quick - reference) / mean, "rms_8x8": rms(blocks(quick) - blocks(reference)) / mean,
           "flip": float(flip(tone_mapped(reference, white), tone_mapped(quick, white)).mean())}
    if turned is not None:
        out["flicker"] = rms((turned - quick) - (reference_turned - reference)) / mean
    return out


def png(file, rgb):
    """8-bit colours of linear ones from 0 to 1."""
    v = np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * np.power(np.maximum(rgb, 1e-9), 1 / 2.4) - 0.055)
    error_files.png(file, 255 * np.clip(v, 0, 1) + 0.5)


def side_by_side(file, reference, quick):
    """Reference, quick picture, and the difference about grey, four times as large."""
    white = float(np.quantile(reference[..., :3], 0.98))
    gap = np.ones((reference.shape[0], 4, 3))
    difference = np.clip(0.214 + 4 * (quick - reference)[..., :3] / white, 0, 1)
    row = np.concatenate([tone_mapped(reference, white), gap, tone_mapped(quick, white), gap, difference], axis=1)
    png(file, row.repeat(3, axis=0).repeat(3, axis=1))


def places_of(references):
    return [p for p in ("indoor", "forest", "ground") if list(references.glob(f"{p}-reference-*.npy")) or (references / f"{p}.npz").is_file()]


def measure(references, quick, runs, pictures=None):
    """Rows of all places that were drawn, of each first that of the reference itself: dictionaries."""
    times = {(r["place"], r["name"]): r for r in runs if "place" in r}
    out = []
    for place in places_of(references):
        known = stored(references, place)
        (reference, error), (reference_turned, error_turned) = known[""], known["-turned"]
        mean = float(reference.mean())
        files = [f for f in sorted(quick.glob(f"{place}-*.npy")) if not f.stem.endswith("-turned") and "-reference-" not in f.stem]
        # In the order in which they were drawn.
        order = [name for p, name in times if p == place]
        files.sort(key=lambda f: order.index(f.stem.removeprefix(place + "-")) if f.stem.removeprefix(place + "-") in order else len(order))
        if files:
            out.append({"place": place, "name": "reference", "mean": mean, "rms": error / mean, "rms_8x8": error / mean / 8,
                        "flicker": float(np.hypot(error, error_turned) / mean)})
        for file in files:
            name = file.stem.removeprefix(place + "-")
            picture = np.load(file).astype(float)
            turned = np.load(file.with_name(file.stem + "-turned.npy")).astype(float)
            out.append({"place": place, **times.get((place, name), {}), "name": name,
                        **errors_of(picture, reference, turned, reference_turned)})
            if pictures:
                side_by_side(pictures / f"{place}-{name}.png", reference, picture)
    return out


def self_test():
    rng = np.random.default_rng(1)
    a = rng.uniform(0.2, 0.8, (48, 64, 4))
    e = errors_of(a, a, a, a)
    same = e["rms"] == e["rms_8x8"] == e["flicker"] == 0 and e["flip"] < 1e-6
    e = errors_of(1.1 * a, a)
    biased = all(abs(b - 0.1) < 1e-9 for b in e["bias"].values()) and e["flip"] > 0.01
    e = errors_of(a + rng.normal(0, 0.1, a.shape), a)
    noisy = abs(e["rms"] * a.mean() - 0.1) < 0.005 and abs(e["rms_8x8"] * a.mean() - 0.1 / 8) < 0.004
    # Black against white is nearly the largest error there is (green against blue is 1).
    black, white = np.zeros((64, 64, 3)), np.ones((64, 64, 3))
    largest = flip(black, white).mean()
    whole = 0.9 < largest <= 1.0 + 1e-9
    print(f"self-test: same {same}, biased {biased}, noisy {noisy}, black against white {largest:.3f}")
    return 0 if same and biased and noisy and whole else 1


def main():
    if sys.argv[1:] == ["--self-test"]:
        return self_test()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("references", type=Path)
    parser.add_argument("quick", type=Path, nargs="?")
    parser.add_argument("--store", type=Path, metavar="DIR")
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--json", type=Path)
    o = parser.parse_args()
    places = places_of(o.references)
    if not places:
        sys.exit(f"light_error: {o.references} has no reference: bench_light --out {o.references} --reference 4")
    if o.store:
        for place in places:
            store(o.references, place, o.store)
        return 0
    if not o.quick:
        sys.exit("light_error: expected a folder of quick pictures (bench_light --out DIR), or --store DIR")
    if o.pictures:
        o.pictures.mkdir(parents=True, exist_ok=True)
    out = measure(o.references, o.quick, error_files.runs_of(o.quick), o.pictures)
    for place in places:
        rows = [r for r in out if r["place"] == place]
        if not rows:
            continue
        print(f"\n{place}: mean radiance {rows[0]['mean']:.3f} W/(m2 sr)")
        print(f"  {'':24} {'cpu ms':>8} " + " ".join(f"{'bias ' + b:>12}" for b in BANDS) + f" {'rms':>8} {'rms 8x8':>8} {'flip':>7} {'flicker':>8}")
        for r in rows:
            own = r["name"] == "reference"
            cpu = "" if own else "-" if r.get("cpu_ms") is None else round(r["cpu_ms"])
            bias = " " * (13 * len(BANDS) - 1) if own else " ".join(f"{r['bias'][b]:>+12.1%}" for b in BANDS)
            flip_error = f"{'':7}" if own else f"{r['flip']:7.4f}"
            print(f"  {'reference itself' if own else r['name']:24} {cpu:>8} {bias} {r['rms']:8.4f} {r['rms_8x8']:8.4f} {flip_error} {r['flicker']:8.4f}")
    if o.json:
        o.json.write_text(json.dumps(out, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
