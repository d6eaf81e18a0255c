"""Calibrations from Python."""
import unittest

import numpy
import rigor
from rigs import DATA, InFolder


class Calibrate(InFolder):
    def test_a_camera_from_a_list_of_corners(self):
        corners = DATA / "chessboard_left" / "corners_win7_left.vnl"
        if not corners.exists():
            self.skipTest(f"{corners}: no such recording here (RIGOR_TEST_DATA)")
        fit = rigor.calibrate.camera(corners, target="chessboard:9x6:0.025", size="640x480")
        self.assertAlmostEqual(fit["fx_px"], 536, delta=5)
        self.assertEqual(fit.covariance.shape, (len(fit.names),) * 2)
        i = fit.names.index("fx_px")
        self.assertAlmostEqual(numpy.sqrt(fit.covariance[i, i]), fit.sigma["fx_px"])
        self.assertEqual(fit.save("left.yaml"), ["left.yaml"])
        camera = rigor.models.Camera("left.yaml")
        self.assertAlmostEqual(camera.fx_px, fit["fx_px"])
        self.assertIn("<table", fit._repr_html_())
        self.assertIn("fx_px", fit.dict["parameters"])

    def test_options_are_checked_by_name_and_kind(self):
        with self.assertRaisesRegex(rigor.BadInput, "did you mean all_corners"):
            rigor.calibrate.camera("x", target="chessboard:9x6:0.025", all_corner=True)
        with self.assertRaisesRegex(rigor.BadInput, "expected a number, got 'fast'"):
            rigor.calibrate.camera("x", target="chessboard:9x6:0.025", rate_hz="fast")
        with self.assertRaises(rigor.NotFound):
            rigor.calibrate.camera("no-such-folder", target="chessboard:9x6:0.025")

    def test_a_run_in_virtual_time_has_no_latency(self):
        with rigor.Rig(self.table()) as rig:
            rig.run()
        with self.assertRaises(rigor.BadInput):
            rigor.calibrate.latency("table.mcap")


if __name__ == "__main__":
    unittest.main()
