"""The error models of simulated sensors as functions of arrays, with their derivatives.

The formulas are those that simulators, shaders and calibrations share; `functions` has each with the names of what it takes and
gives. Arguments broadcast; with `derivatives=True` a function gives its value and a dictionary of slopes by argument:

    sigma, slope = rigor.models.lidar_range_sigma_m(q, floor_m=0.002, scale_m=0.0065, offset=0.19, exponent=1, derivatives=True)
    slope["q"]                                                  # d sigma / d q, as sigma

    camera = rigor.models.Camera("left.yaml")
    pixels, by_point, by_parameter = camera.project(points, derivatives=True)

Draws of noise are arguments (uniform, or standard normal): a model holds no random generator.
"""
from __future__ import annotations

import os

import numpy

from . import _rigor
from ._errors import BadInput

#: Names of what each function takes and gives.
functions: dict[str, tuple[list[str], list[str]]] = {k: tuple(v) for k, v in _rigor.models.functions.items()}


def _function(name: str):
    call = getattr(_rigor.models, name)
    takes, gives = functions[name]

    def function(*args, derivatives: bool = False, **named):
        if len(args) > len(takes) or set(named) - set(takes[len(args):]) or len(args) + len(named) != len(takes):
            raise BadInput(name, f"expected {', '.join(takes)}; got {len(args)} by place and {', '.join(named) or 'none'} by name")
        values = numpy.broadcast_arrays(*[numpy.asarray(v, float) for v in (*args, *(named[n] for n in takes[len(args):]))])
        shape = values[0].shape
        flat = [numpy.ascontiguousarray(v).reshape(-1) for v in values]
        result = call(flat, derivatives)
        out, by = result if derivatives else (result, None)
        out = [o.reshape(shape) for o in out]
        value = out[0] if len(gives) == 1 else tuple(out)
        if not derivatives:
            return value
        slopes = {n: by[0, i].reshape(shape) if len(gives) == 1 else tuple(b[i].reshape(shape) for b in by)
                  for i, n in enumerate(takes)}
        return value, slopes
    function.__name__ = function.__qualname__ = name
    function.__doc__ = f"({', '.join(takes)}) -> {', '.join(gives)}; float64 arrays that broadcast, units in the names."
    return function


for _name in functions:
    globals()[_name] = _function(_name)
del _name


class _Model:
    def __init__(self, values: dict, path):
        self.__dict__.update(values)
        self.path = os.fspath(path)

    def __repr__(self) -> str:
        values = ", ".join(f"{k}={v}" for k, v in self.__dict__.items() if not isinstance(v, list) or len(v) <= 8)
        return f"{type(self).__name__}({values})"


class Camera(_Model):
    """A camera's sensor model (YAML): width_px, height_px, fx_px, fy_px, cx_px, cy_px, projection (opencv or kannala_brandt),
    lens (k1 k2 p1 p2 k3 k4 k5 k6, or k1 k2 k3 k4), theta_max_rad, exposure_s, and the EMVA 1288 values gain_dn_per_e, black_dn,
    full_well_e, read_noise_e, dark_e_per_s, dsnu_e, prnu, adc_bits, response (c2, c3).

    Optical frame: x right, y down, z forward; pixel centres at integers. draw: that device of those which the model's covariance
    describes; 0: the model itself.
    """

    def __init__(self, file, draw: int = 0):
        super().__init__(_rigor.load_camera(os.fspath(file), draw), file)

    @property
    def parameters(self) -> list[str]:
        """Names of the columns of `by_parameter`."""
        lens = ["k1", "k2", "k3", "k4"] if self._fisheye else ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"]
        return ["fx_px", "fy_px", "cx_px", "cy_px", *lens]

    @property
    def _fisheye(self) -> bool:
        return self.projection == "kannala_brandt"

    def project(self, points, derivatives: bool = False):
        """Pixels (…, 2) of points (…, 3) in the optical frame, metres; NaN where the lens takes no light from there. With
        derivatives also d pixel / d point (…, 2, 3) and d pixel / d parameter (…, 2, p)."""
        p = numpy.asarray(points, float)
        x, y, z = p[..., 0], p[..., 1], p[..., 2]
        with numpy.errstate(divide="ignore", invalid="ignore"):
            if self._fisheye:
                (xd, yd, valid), by = fisheye_project(x, y, z, *self.lens, self.theta_max_rad, derivatives=True)
                by_point = numpy.stack([numpy.stack([by[n][i] for n in "xyz"], -1) for i in (0, 1)], -2)
            else:
                u, v = x / z, y / z
                (xd, yd), by = lens_distort(u, v, *self.lens, derivatives=True)
                det = by["x"][0] * by["y"][1] - by["x"][1] * by["y"][0]
                valid = (z > 0) & (det > 1e-6)
                valid &= self._before_fold(u, v)
                by_point = numpy.stack([numpy.stack([by["x"][i] / z, by["y"][i] / z, -(by["x"][i] * u + by["y"][i] * v) / z], -1)
                                        for i in (0, 1)], -2)
        f = numpy.array([self.fx_px, self.fy_px])
        pixels = numpy.stack([self.fx_px * xd + self.cx_px, self.fy_px * yd + self.cy_px], -1)
        pixels = numpy.where((numpy.asarray(valid) > 0.5)[..., None], pixels, numpy.nan)
        if not derivatives:
            return pixels
        by_parameter = numpy.zeros((*pixels.shape, len(self.parameters)))
        by_parameter[..., 0, 0], by_parameter[..., 1, 1] = xd, yd
        by_parameter[..., 0, 2] = by_parameter[..., 1, 3] = 1
        for k, name in enumerate(self.parameters[4:]):
            for i in (0, 1):
                by_parameter[..., i, 4 + k] = f[i] * by[name][i]
        return pixels, by_point * f[:, None], by_parameter

    def _before_fold(self, u, v):
        """Whether the lens model has not folded on the way from the axis: the formula's own inverse comes back."""
        xd, yd = lens_distort(u, v, *self.lens)
        bu, bv, valid = lens_undistort(xd, yd, *self.lens)
        near = numpy.hypot(bu - u, bv - v) <= 1e-6 * (1 + numpy.hypot(u, v))
        return (valid > 0.5) & near

    def unproject(self, pixels, derivatives: bool = False):
        """Rays (…, 3) of unit length of pixels (…, 2); NaN where no ray of the lens reaches them. With derivatives also
        d ray / d pixel (…, 3, 2)."""
        p = numpy.asarray(pixels, float)
        xd, yd = (p[..., 0] - self.cx_px) / self.fx_px, (p[..., 1] - self.cy_px) / self.fy_px
        if self._fisheye:
            (x, y, z, valid), by = fisheye_unproject(xd, yd, *self.lens, self.theta_max_rad, derivatives=True)
            slope = numpy.stack([numpy.stack([by["x"][i], by["y"][i]], -1) for i in range(3)], -2)
        else:
            (x, y, valid), by = lens_undistort(xd, yd, *self.lens, derivatives=True)
            z = numpy.ones_like(x)
            slope = numpy.stack([numpy.stack([by["x"][i], by["y"][i]], -1) if i < 2 else numpy.zeros((*x.shape, 2))
                                 for i in range(3)], -2)
        raw = numpy.stack([x, y, z], -1)
        length = numpy.linalg.norm(raw, axis=-1, keepdims=True)
        ray = numpy.where((valid > 0.5)[..., None], raw / length, numpy.nan)
        if not derivatives:
            return ray
        slope = slope / numpy.array([self.fx_px, self.fy_px])
        unit = raw / length
        return ray, (slope - unit[..., None] * (unit[..., None] * slope).sum(-2, keepdims=True)) / length[..., None]

    def undistort(self, pixels):
        """Where an ideal pinhole of the same intrinsics has pixels (…, 2): straight lines stay straight. Not for a fisheye."""
        ray = self.unproject(pixels)
        return numpy.stack([self.fx_px * ray[..., 0] / ray[..., 2] + self.cx_px,
                            self.fy_px * ray[..., 1] / ray[..., 2] + self.cy_px], -1)

    def mean_dn(self, rate_e_per_s, exposure_s: float | None = None, derivatives: bool = False):
        """Mean value in DN of pixels that collect so many electrons a second, before rounding; with derivatives also
        d DN / d rate."""
        exposure = self.exposure_s if exposure_s is None else exposure_s
        electrons, by_rate = emva_mean_electrons(rate_e_per_s, self.dark_e_per_s, 1.0, exposure, derivatives=True)
        kept, by_shot = emva_collected_electrons(electrons, self.full_well_e, 0.0, 0.0, 0.0, derivatives=True)
        dn, by = emva_signal_dn(kept, self.gain_dn_per_e, self.black_dn, 2.0**self.adc_bits - 1, *self.response, derivatives=True)
        return (dn, by["electrons"] * by_shot["shot_e"] * by_rate["rate_e_per_s"]) if derivatives else dn

    def expose(self, rate_e_per_s, exposure_s: float | None = None, rng=None):
        """A picture in DN, rounded and clipped, of pixels that collect so many electrons a second: EMVA 1288 with shot, read and
        pattern noise. rng: a numpy.random.Generator; None: one that is seeded with 0."""
        rng = rng if rng is not None else numpy.random.default_rng(0)
        rate = numpy.asarray(rate_e_per_s, float)
        exposure = self.exposure_s if exposure_s is None else exposure_s

        def uniform():
            return rng.uniform(1e-9, 1 - 1e-9, rate.shape)
        gain = 1 + self.prnu * normal_quantile(uniform())
        mean = emva_mean_electrons(rate, self.dark_e_per_s, gain, exposure)
        shot = poisson_quantile(mean, uniform()) if self.shot_noise else mean
        kept = emva_collected_electrons(shot, self.full_well_e, self.dsnu_e * normal_quantile(uniform()), self.read_noise_e,
                                        normal_quantile(uniform()))
        top = 2.0**self.adc_bits - 1
        return emva_quantise(emva_signal_dn(kept, self.gain_dn_per_e, self.black_dn, top, *self.response), top)


class Lidar(_Model):
    """A LiDAR's sensor model (YAML): wavelength_nm, beams, columns, divergence_rad, min_m, max_m, step_m, bias_m, scale,
    beam_bias_m, floor_m, scale_m, offset, exponent, reference_range_m, … (docs/sensors.md)."""

    def __init__(self, file, draw: int = 0):
        super().__init__(_rigor.load_lidar(os.fspath(file), draw), file)

    def sigma_m(self, range_m, remission, derivatives: bool = False):
        """Standard deviation of range, metres, of echoes of this remission (1: a white plate); with derivatives also those by
        range and by remission."""
        r, e = numpy.broadcast_arrays(numpy.asarray(range_m, float), numpy.asarray(remission, float))
        if self.reference_range_m > 0:
            q, by_q = lidar_received_power(e, r, self.reference_range_m, self.overlap_m, derivatives=True)
        else:
            q, by_q = e, {"remission": numpy.ones_like(e), "range_m": numpy.zeros_like(e)}
        sigma, by = lidar_range_sigma_m(q, self.floor_m, self.scale_m, self.offset, self.exponent, derivatives=True)
        return (sigma, {n: by["q"] * by_q[n] for n in ("range_m", "remission")}) if derivatives else sigma

    def measure(self, range_m, remission=1.0, cos_incidence=1.0, beam=0, rng=None):
        """Ranges (m) as the device gives them: mean errors, noise, rounding, detection; NaN: no return."""
        rng = rng if rng is not None else numpy.random.default_rng(0)
        r, e, c, b = numpy.broadcast_arrays(numpy.asarray(range_m, float), remission, cos_incidence, beam)
        bias = self.bias_m + numpy.asarray(self.beam_bias_m)[b]
        measured = r + lidar_range_error_m(r, self.scale, bias, self.remission_bias_m, e, self.incidence_bias_m, c)
        sigma = self.sigma_m(r, e)
        if self.retro_sigma_m > 0:
            sigma = numpy.where(e > 1, self.retro_sigma_m, sigma)
        measured = measured + sigma * normal_quantile(rng.uniform(1e-9, 1 - 1e-9, r.shape))
        if self.step_m > 0:
            measured = lidar_quantise(measured, self.step_m)
        least = lidar_least_remission(r, self.minimum_remission, self.limit_remission, self.limit_range_m, self.overlap_m)
        seen = (e >= least) & (measured >= self.min_m) & (measured <= self.max_m)
        return numpy.where(seen, measured, numpy.nan)


class Tof(_Model):
    """A time-of-flight camera's sensor model (YAML): width_px, height_px, fx_px, …, frequencies_hz, contrast, harmonics,
    intensity_w_per_sr, electrons_per_radiance, unambiguous_range_m, full_well_e, read_noise_e, … (docs/sensors.md)."""

    LIGHT_MPS = 299792458.0

    def __init__(self, file, draw: int = 0):
        super().__init__(_rigor.load_tof(os.fspath(file), draw), file)

    def taps(self, range_m, remission=1.0, background_e=0.0, frequency: int = 0, derivatives: bool = False):
        """Mean electrons of the four taps (4, …) of a pixel on the axis; with derivatives also d tap / d range (4, …)."""
        r, e = numpy.broadcast_arrays(numpy.asarray(range_m, float), numpy.asarray(remission, float))
        turns_per_m = 2 * self.frequencies_hz[frequency] / self.LIGHT_MPS
        active, by_active = tof_active_electrons(self.electrons_per_radiance, self.intensity_w_per_sr, r, e, derivatives=True)
        (x, y), by_turns = tof_phasor(r * turns_per_m, float(self.triangle), *self.harmonics, float(self.wiggling_bias),
                                      float(self.sine_like_noise), derivatives=True)
        taps, by = tof_taps(active, active * x, active * y, self.contrast, background_e + self.dark_e, derivatives=True)
        taps = numpy.stack(taps)
        if not derivatives:
            return taps
        slope_active, tx, ty = by_active["range_m"], by_turns["turns"][0] * turns_per_m, by_turns["turns"][1] * turns_per_m
        slope = numpy.stack([by["active_e"][k] * slope_active + by["sum_x_e"][k] * (slope_active * x + active * tx)
                             + by["sum_y_e"][k] * (slope_active * y + active * ty) for k in range(4)])
        return taps, slope

    def demodulate(self, taps, about_m, frequency: int = 0):
        """Range (m) nearest to `about_m` and amplitude (electrons) of four taps (4, …)."""
        turns, amplitude = tof_demodulate(*taps)
        turns_per_m = 2 * self.frequencies_hz[frequency] / self.LIGHT_MPS
        error = tof_range_error(self.offset_m, self.amplitude_error_m_e, amplitude)
        return tof_nearest_range(turns, turns_per_m, about_m) + error, amplitude

    def measure(self, range_m, remission=1.0, background_e=0.0, frequency: int = 0, rng=None):
        """Ranges (m, nearest to the true ones) and amplitudes (electrons) with shot and read noise, well and converter."""
        rng = rng if rng is not None else numpy.random.default_rng(0)
        mean = self.taps(range_m, remission, background_e, frequency)

        def uniform():
            return rng.uniform(1e-9, 1 - 1e-9, mean.shape)
        read, _ = tof_read_tap(poisson_quantile(mean, uniform()), self.ambient_suppression * background_e, self.full_well_e,
                               self.read_noise_e, normal_quantile(uniform()), self.step_e)
        return self.demodulate(read, range_m, frequency)

    def sigma_m(self, range_m, remission=1.0, background_e=0.0, frequency: int = 0):
        """Standard deviation of the range (m) by Lange's formula."""
        signal = 0.5 * tof_active_electrons(self.electrons_per_radiance, self.intensity_w_per_sr, range_m, remission)
        return tof_range_sigma(2 * self.frequencies_hz[frequency] / self.LIGHT_MPS, signal, background_e + self.dark_e,
                               self.read_noise_e, self.contrast)
