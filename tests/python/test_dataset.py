"""Labelled samples: the same as the command's, by number, by pose, and as a folder."""
import pickle
import unittest
from pathlib import Path

import numpy
import rigor
from rigs import CONFIGS, InFolder

DEMO = {"channels": ["right"], "within": (-3, -4, 3, -2), "yaw": (60, 120), "vary": {"joint.turntable": (0, 360)}, "samples": 4,
        "seed": 3}


class Dataset(InFolder):
    def demo(self, **more):
        return rigor.dataset(CONFIGS / "demo.yaml", **{**DEMO, **more})

    def test_samples_have_labels_for_each_pixel(self):
        dataset = self.demo()
        self.assertEqual(len(dataset), 4)
        self.assertEqual(dataset.channels, [("right", "image", False)])
        names = {c["id"]: c["name"] for c in dataset.categories}
        for sample in dataset:
            view = sample["right"]
            self.assertEqual(view.array.shape, view.depth_m.shape)
            self.assertEqual(view.array.shape, view.instance.shape)
            self.assertIn("joint.turntable", sample.conditions)
            for thing in view.instances:
                x, y, width, height = thing["box"]
                mask = view.instance == thing["id"]
                self.assertEqual(mask.sum(), thing["area_px"])
                rows, columns = numpy.nonzero(mask)
                self.assertEqual((columns.min(), rows.min()), (x, y))
                self.assertEqual((numpy.ptp(columns) + 1, numpy.ptp(rows) + 1), (width, height))
                self.assertEqual(names[thing["category"]], thing["class"])
                self.assertAlmostEqual(float(numpy.median(view.depth_m[mask])), thing["median_depth_m"], delta=0.05)

    def test_sample_k_is_the_same_whatever_was_made_before_and_wherever(self):
        dataset = self.demo()
        last = dataset[3]["right"].array
        again = pickle.loads(pickle.dumps(self.demo()))
        numpy.testing.assert_array_equal(again[-1]["right"].array, last)
        self.assertTrue((dataset[2]["right"].array != last).any())
        self.assertEqual(dataset.manifest, again.manifest)
        with self.assertRaises(IndexError):
            dataset[4]

    def test_a_folder_is_the_commands_own(self):
        said = self.demo(samples=2).save("ours", layers=["depth"])
        self.assertEqual((said["samples"], said["made"], said["there"]), (2, 2, 0))
        self.rigor("dataset", CONFIGS / "demo.yaml", "--channels", "right", "--within=-3,-4,3,-2", "--yaw", "60..120", "--vary",
                   "joint.turntable=0..360", "--sample", 2, "--seed", 3, "--layers", "depth", "-o", "theirs")
        ours = {p.relative_to("ours"): p.read_bytes() for p in Path("ours").rglob("*") if p.is_file()}
        theirs = {p.relative_to("theirs"): p.read_bytes() for p in Path("theirs").rglob("*") if p.is_file()}
        self.assertEqual(ours.keys(), theirs.keys())
        self.assertEqual([n for n in ours if ours[n] != theirs[n]], [])
        self.assertEqual(self.demo(samples=2).save("ours", layers=["depth"])["there"], 2)

    def test_poses_of_an_array(self):
        pose = [[0, -3, 1.5, numpy.sqrt(0.5), 0, 0, numpy.sqrt(0.5)], [0.5, -3, 1.5, numpy.sqrt(0.5), 0, 0, numpy.sqrt(0.5)]]
        dataset = self.demo(within=None, yaw=None, samples=None, poses=numpy.array(pose), truth=False)
        self.assertEqual(len(dataset), 2)
        sample = dataset[1]
        numpy.testing.assert_allclose(sample.T_world_carrier[:3, 3], pose[1][:3], atol=1e-9)
        self.assertIsNone(sample["right"].truth)

    def test_what_is_wrong_is_named(self):
        with self.assertRaisesRegex(rigor.BadInput, "yaw: expected"):
            self.demo(yaw="north")
        with self.assertRaisesRegex(rigor.BadInput, "expected one of them"):
            self.demo(along="path.csv")
        with self.assertRaisesRegex(rigor.BadInput, "poses: expected rows"):
            self.demo(within=None, yaw=None, poses=[[1, 2, 3]])
        with self.assertRaisesRegex(rigor.BadInput, "layers: expected some of depth"):
            self.demo(samples=1).save("x", layers=["deep"])


if __name__ == "__main__":
    unittest.main()
