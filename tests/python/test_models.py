"""Error models as functions of arrays: derivatives against differences, and the same numbers as the simulator's."""
import unittest

import numpy
import rigor
from rigor import models
from rigs import CONFIGS

SENSORS = CONFIGS / "sensors"


def slopes(function, x, h=1e-6):
    """Central differences of (…, m) by each of the last axis of x: (…, m, n)."""
    columns = []
    for i in range(x.shape[-1]):
        step = numpy.zeros(x.shape[-1])
        step[i] = h
        columns.append((function(x + step) - function(x - step)) / (2 * h))
    return numpy.stack(columns, -1)


class Functions(unittest.TestCase):
    def test_each_has_derivatives_that_agree_with_differences(self):
        rng = numpy.random.default_rng(5)
        # Draws and steps have none; valid, saturated and counts are no numbers to be differentiated.
        skipped = {"poisson_quantile", "emva_quantise", "lidar_quantise", "fisheye_project", "fisheye_unproject", "lens_undistort",
                   "tof_read_tap", "tof_nearest_range"}
        checked = 0
        for name, (takes, gives) in models.functions.items():
            if name in skipped:
                continue
            x = rng.uniform(0.2, 0.6, (20, len(takes)))
            for i, argument in enumerate(takes):
                if argument in ("triangle", "bias", "variation"):
                    x[:, i] = float(argument != "triangle")
                if argument in ("full_well_e", "full_scale_dn"):
                    x[:, i] = 50
                if argument in ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"):
                    x[:, i] *= 0.05

            def call(v):
                value = getattr(models, name)(*numpy.moveaxis(v, -1, 0))
                return numpy.stack(value if isinstance(value, tuple) else (value,), -1)
            _, by = getattr(models, name)(*x.T, derivatives=True)
            exact = numpy.stack([numpy.stack(by[n], -1) if isinstance(by[n], tuple) else by[n][:, None] for n in takes], -1)
            free = [i for i, n in enumerate(takes) if n not in ("triangle", "bias", "variation")]
            numpy.testing.assert_allclose(exact[..., free], slopes(call, x)[..., free], rtol=1e-4, atol=1e-6, err_msg=name)
            checked += 1
        self.assertGreater(checked, 15)

    def test_arguments_broadcast_and_are_named(self):
        sigma = models.lidar_range_sigma_m(numpy.linspace(0.1, 1, 6).reshape(2, 3), 0.002, scale_m=0.0065, offset=0.19, exponent=1)
        self.assertEqual(sigma.shape, (2, 3))
        self.assertAlmostEqual(sigma[0, 0], numpy.hypot(0.002, 0.0065 / 0.29))
        with self.assertRaisesRegex(rigor.BadInput, "expected q, floor_m"):
            models.lidar_range_sigma_m(1, floor=0.1)


class Cameras(unittest.TestCase):
    def test_projection_and_its_inverse_with_derivatives(self):
        for file in ("strong-effects-camera.yaml", "fisheye-190.yaml", "demo-camera.yaml"):
            with self.subTest(file=file):
                camera = models.Camera(SENSORS / file)
                rng = numpy.random.default_rng(1)
                points = numpy.concatenate([rng.uniform(-0.4, 0.4, (50, 2)), rng.uniform(1, 2, (50, 1))], 1)
                pixels, by_point, by_parameter = camera.project(points, derivatives=True)
                self.assertTrue(numpy.isfinite(pixels).all())
                numpy.testing.assert_allclose(by_point, slopes(camera.project, points), rtol=1e-5, atol=1e-4)
                rays, by_pixel = camera.unproject(pixels, derivatives=True)
                numpy.testing.assert_allclose(rays, points / numpy.linalg.norm(points, axis=1, keepdims=True), atol=1e-9)
                numpy.testing.assert_allclose(by_pixel, slopes(camera.unproject, pixels, 1e-4), rtol=1e-4, atol=1e-8)
                for k, name in enumerate(camera.parameters):
                    other = models.Camera(SENSORS / file)
                    h = 1e-6
                    if k < 4:
                        setattr(other, name, getattr(other, name) + h)
                    else:
                        other.lens[k - 4] += h
                    numpy.testing.assert_allclose(by_parameter[..., k], (other.project(points) - pixels) / h, rtol=1e-3, atol=1e-3)

    def test_what_is_behind_has_no_image(self):
        camera = models.Camera(SENSORS / "demo-camera.yaml")
        self.assertTrue(numpy.isnan(camera.project([[0, 0, -1.0]])).all())

    def test_noise_has_the_variance_of_emva_1288(self):
        camera = models.Camera(SENSORS / "industrial-global-shutter.yaml")
        rate = numpy.full(200_000, 3000 / camera.exposure_s)
        mean, slope = camera.mean_dn(rate, derivatives=True)
        picture = camera.expose(rate, rng=numpy.random.default_rng(3))
        electrons = 3000 + camera.dark_e_per_s * camera.exposure_s
        variance = camera.gain_dn_per_e**2 * (electrons + camera.read_noise_e**2 + camera.dsnu_e**2 + (3000 * camera.prnu)**2) + 1 / 12
        n = len(rate)
        self.assertLess(abs(picture.mean() - mean[0]), 5 * numpy.sqrt(variance / n) + 0.02)
        self.assertLess(abs(picture.var() / variance - 1), 5 * numpy.sqrt(2 / n) + 0.01)
        self.assertAlmostEqual(slope[0], camera.gain_dn_per_e * camera.exposure_s, delta=1e-9)


class Ranges(unittest.TestCase):
    def test_a_lidar_scatters_as_its_model_says(self):
        lidar = models.Lidar(SENSORS / "velodyne-vlp16.yaml")
        measured = lidar.measure(numpy.full(100_000, 10.0), 0.5, rng=numpy.random.default_rng(2))
        self.assertTrue(numpy.isfinite(measured).all())
        expected = numpy.hypot(lidar.sigma_m(10.0, 0.5), lidar.step_m / numpy.sqrt(12))
        self.assertLess(abs(measured.std() / expected - 1), 0.02)
        self.assertTrue(numpy.isnan(lidar.measure(lidar.max_m + 5)))
        r, e = numpy.array([5.0, 20.0]), numpy.array([0.3, 0.8])
        _, by = lidar.sigma_m(r, e, derivatives=True)
        h = 1e-6
        numpy.testing.assert_allclose(by["remission"], (lidar.sigma_m(r, e + h) - lidar.sigma_m(r, e - h)) / (2 * h), rtol=1e-5)

    def test_a_time_of_flight_pixel_measures_what_is_there(self):
        tof = models.Tof(SENSORS / "sr4000.yaml")
        ranges = numpy.linspace(1, 4, 30)
        taps, slope = tof.taps(ranges, 0.8, derivatives=True)
        h = 1e-6
        numpy.testing.assert_allclose(slope, (tof.taps(ranges + h, 0.8) - tof.taps(ranges - h, 0.8)) / (2 * h), rtol=1e-5, atol=1e-2)
        measured, amplitude = tof.demodulate(taps, ranges)
        self.assertLess(numpy.abs(measured - ranges).max(), 0.1)
        self.assertTrue((numpy.diff(amplitude) < 0).all())
        noisy, _ = tof.measure(numpy.full(20_000, 2.0), 0.8, rng=numpy.random.default_rng(4))
        self.assertLess(abs(noisy.std() / tof.sigma_m(2.0, 0.8) - 1), 0.1)


if __name__ == "__main__":
    unittest.main()
