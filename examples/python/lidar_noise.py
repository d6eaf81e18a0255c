"""The noise model of a LiDAR from a recording in which it stands still: sigma against remission, fitted with the model's own slopes.

    python3 lidar_noise.py                       a simulated VLP-16 in the testbed, recorded first
    python3 lidar_noise.py drive.mcap top        a recording of yours, and its channel

The model is that which simulated LiDARs measure with: sigma^2 = floor^2 + (scale (offset + q)^-exponent)^2 (docs/sensors.md).
`rigor.calibrate.lidar` does more: beams, biases, detection, with their covariance.
"""
import argparse

import numpy
import rigor


def record(file, duration_s):
    """A turning LiDAR that sees the same walls again and again; the rig's other sensors look once, as cheaply as they can."""
    others = {"channels.left.renderer": "rays", "channels.right.renderer": "rays"}
    for channel in ("left", "right", "tof", "scan"):
        others |= {f"channels.{channel}.rate_hz": 0.5, f"channels.{channel}.ideal": True}
    with rigor.Rig("measuring-light", clock="virtual", duration_s=duration_s, record=file, report=False, replace=True,
                   set=others) as rig:
        rig.run()


def scatter(channel):
    """Remission and standard deviation of range of each firing that returned in most scans: (n,), (n,)."""
    points = channel.array()
    points = points[points["return_index"] == 0]
    range_m = numpy.sqrt(points["x_m"].astype(float)**2 + points["y_m"].astype(float)**2 + points["z_m"].astype(float)**2)
    firing = points["t_offset_ns"].astype("i8") * 1024 + points["ring"]
    _, firing = numpy.unique(firing, return_inverse=True)
    count = numpy.bincount(firing)

    def mean(values):
        return numpy.bincount(firing, values) / count
    remission, centre = mean(points["remission"]), mean(range_m)
    variance = numpy.bincount(firing, (range_m - centre[firing])**2) / numpy.maximum(count - 1, 1)
    keep = (count >= 0.8 * len(channel)) & (variance < 0.05**2)  # the rest are edges
    return remission[keep], numpy.sqrt(variance[keep])


def fit(q, sigma, start=(0.002, 0.005, 0.2)):
    """floor_m, scale_m and offset for exponent 1 by Gauss-Newton on log sigma; derivatives come with the model."""
    p = numpy.array(start)
    for _ in range(50):
        value, slope = rigor.models.lidar_range_sigma_m(q, *p, 1.0, derivatives=True)
        jacobian = numpy.stack([slope[n] / value for n in ("floor_m", "scale_m", "offset")], 1)
        step, *_ = numpy.linalg.lstsq(numpy.vstack([jacobian, 1e-3 * numpy.eye(3)]), numpy.append(numpy.log(sigma / value), [0, 0, 0]),
                                      rcond=None)
        p = numpy.maximum(p + 0.5 * step, [0, 1e-6, 1e-3])
    return p


def main():
    options = argparse.ArgumentParser()
    options.add_argument("file", nargs="?")
    options.add_argument("channel", nargs="?", default="top")
    options.add_argument("--duration", type=float, default=1.6)
    options = options.parse_args()
    if options.file is None:
        record("lidar.mcap", options.duration)
    remission, sigma = scatter(rigor.open(options.file or "lidar.mcap")[options.channel])
    edges = numpy.quantile(remission, numpy.linspace(0, 1, 9))
    band = numpy.clip(numpy.searchsorted(edges, remission) - 1, 0, 7)
    # Mean variances, not mean deviations: of few scans these are too small.
    q = numpy.array([remission[band == b].mean() for b in range(8)]) / 100  # the VLP-16 calls a white plate 100
    spread = numpy.array([numpy.sqrt((sigma[band == b]**2).mean()) for b in range(8)])
    p = fit(q, spread)
    print("remission  sigma [mm]  model [mm]")
    for row in zip(q, spread, rigor.models.lidar_range_sigma_m(q, *p, 1.0)):
        print(f"{row[0]:9.3f}  {1e3 * row[1]:10.2f}  {1e3 * row[2]:10.2f}")
    print(f"floor {1e3 * p[0]:.2f} mm, scale {1e3 * p[1]:.2f} mm, offset {p[2]:.3f}; {len(sigma)} firings")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
