"""Single samples and their ground truth."""
import unittest

import numpy
import rigor
from rigs import CONFIGS, InFolder

LIGHT = CONFIGS / "rigs/measuring-light.yaml"


class Sense(InFolder):
    def test_a_picture_is_that_of_the_run_and_has_truth(self):
        with rigor.Rig(CONFIGS / "demo.yaml", clock="virtual", duration_s=0.2, seed=7, record="run.mcap", report=False) as rig:
            rig.run()
        picture, truth = rigor.sense(CONFIGS / "demo.yaml", "right", at=0.0, seed=7)
        numpy.testing.assert_array_equal(picture, rigor.open("run.mcap")["right"][0].array())
        self.assertEqual(truth.range_m.shape, picture.shape)
        self.assertEqual(truth.normal.shape, (*picture.shape, 3))
        self.assertEqual(truth.flow_px_per_s.shape, (*picture.shape, 2))
        seen = truth.node > 0
        self.assertGreater(seen.mean(), 0.05)
        self.assertTrue(numpy.isfinite(truth.range_m[seen]).all())
        numpy.testing.assert_allclose(numpy.linalg.norm(truth.normal[seen], axis=1), 1, atol=1e-5)
        boxes = truth.boxes()
        self.assertEqual(sum(b["pixels"] for b in boxes), seen.sum())

    def test_seeds_draw_other_noise_and_joints_turn(self):
        one, _ = rigor.sense(CONFIGS / "demo.yaml", "right", seed=1, truth=False)
        two, _ = rigor.sense(CONFIGS / "demo.yaml", "right", seed=2, truth=False)
        self.assertTrue((one != two).any())
        turned, _ = rigor.sense(CONFIGS / "demo.yaml", "right", seed=1, joints={"turntable": 30}, truth=False)
        self.assertTrue((one != turned).any())

    def test_a_scan_and_a_range_image_with_truth_for_each_element(self):
        points, truth = rigor.sense(LIGHT, "top", at=0.1)
        self.assertEqual(points.dtype, rigor.POINT)
        self.assertEqual(truth.range_m.shape, points.shape)
        measured = numpy.sqrt(points["x_m"]**2 + points["y_m"]**2 + points["z_m"]**2)
        self.assertLess(numpy.median(numpy.abs(measured - truth.range_m)), 0.2)
        self.assertIsNone(truth.flow_px_per_s)

    def test_what_does_not_look_has_no_truth(self):
        sample, truth = rigor.sense(CONFIGS / "rigs/inertial.yaml", "imu", at=0.5)
        self.assertIsNone(truth)
        self.assertEqual(len(sample.specific_force_mps2), 3)
        with self.assertRaises(rigor.BadInput):
            rigor.sense(CONFIGS / "rigs/inertial.yaml", "imu", truth=True)

    def test_a_sensor_stays_open(self):
        sensor = rigor.Sensor(LIGHT, "top", truth=False)
        a, _ = sensor.sense(0.1)
        b, _ = sensor.sense(0.2)
        again, _ = sensor.sense(0.1)
        numpy.testing.assert_array_equal(a, again)
        self.assertTrue(len(a) != len(b) or (a != b).any())
        self.assertTrue(sensor.renderer)

    def test_unknown_names_are_refused(self):
        with self.assertRaisesRegex(rigor.BadInput, "expected a simulated channel of the rig"):
            rigor.sense(CONFIGS / "demo.yaml", "turntable")
        with self.assertRaises(rigor.BadInput):
            rigor.sense(CONFIGS / "demo.yaml", "right", at=-1)
        with self.assertRaises(rigor.BadInput):
            rigor.sense(CONFIGS / "demo.yaml", "right", joints={"turntabel": 1})


if __name__ == "__main__":
    unittest.main()
