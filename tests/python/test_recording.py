"""Recordings from Python: Rigor's own and others', whole and damaged."""
import unittest
from pathlib import Path

import numpy
import rigor
from rigs import CONFIGS, InFolder


class OfADemo(InFolder):
    """One run of the demo, by rigs and compression; made once."""
    folders = None

    @classmethod
    def setUpClass(cls):
        import tempfile
        cls.made = tempfile.TemporaryDirectory()
        cls.files, cls.last = {}, {}
        for compression in ("none", "zstd", "lz4"):
            cls.files[compression] = str(Path(cls.made.name) / f"{compression}.mcap")
            with rigor.Rig(CONFIGS / "demo.yaml", clock="virtual", duration_s=0.5, record=cls.files[compression], report=False,
                           set={"record": {"file": "r.mcap", "compression": compression, "chunk_kib": 64, "budget_mib": 16}}) as rig:
                last = {}
                while rig.step():
                    for name in ("right", "turntable"):
                        if rig[name].fresh:
                            last[name] = rig[name].sample
            cls.last = last  # the same for each

    @classmethod
    def tearDownClass(cls):
        cls.made.cleanup()

    def each(self):
        for compression, file in self.files.items():
            with self.subTest(compression=compression):
                yield rigor.open(file)

    def test_channels_have_what_the_ports_showed(self):
        for rec in self.each():
            right = rec["right"]
            self.assertEqual(right.kind, "image")
            last, seen = right[-1], self.last["right"]
            self.assertEqual((last.sequence, last.t_capture_ns, last.format, last.exposure_ns),
                             (seen.sequence, seen.t_capture_ns, seen.format, seen.exposure_ns))
            numpy.testing.assert_array_equal(last.array(), seen.array())
            self.assertEqual(last.array().shape, (360, 480))
            position = rec["turntable"].array()
            self.assertEqual(position["position"][-1], self.last["turntable"].values["position"])
            self.assertEqual(rec["turntable"][-1].values, self.last["turntable"].values)

    def test_arrays_point_into_the_file_and_are_read_only(self):
        rec = rigor.open(self.files["none"])
        a, b = rec["right"][0].array(), rec["right"][0].array()
        self.assertEqual(a.ctypes.data, b.ctypes.data)
        with self.assertRaises(ValueError):
            a[0, 0] = 1
        before = a.sum()
        del rec
        self.assertEqual(b.sum(), before)  # the array keeps the file

    def test_all_of_a_channel_in_one_array(self):
        for rec in self.each():
            right = rec["right"]
            pictures = right.array()
            self.assertEqual(pictures.shape, (len(right), 360, 480))
            for i, sample in enumerate(right):
                numpy.testing.assert_array_equal(pictures[i], sample.array())
            self.assertEqual(right[::2].array().shape[0], (len(right) + 1) // 2)
            numpy.testing.assert_array_equal(right[::-1].array(), pictures[::-1])
            self.assertEqual(len(right[5:5]), 0)

    def test_stamps_are_int64_and_those_of_each_sample(self):
        for rec in self.each():
            table = rec["turntable"]
            stamps = table.stamps
            self.assertEqual(stamps.t_capture_ns.dtype, numpy.int64)
            self.assertEqual([s.t_capture_ns for s in table], stamps.t_capture_ns.tolist())
            self.assertTrue((stamps.t_release_ns - stamps.t_capture_ns == 10_000_000).all())
            self.assertTrue((numpy.diff(stamps.t_capture_ns) == 10_000_000).all())
            self.assertEqual(table[3:7].stamps.sequence.tolist(), [3, 4, 5, 6])
            self.assertEqual(rec.to_utc_ns(stamps.t_release_ns).tolist(), table.times.tolist())

    def test_a_pair_has_both_sides(self):
        rec = rigor.open(self.files["zstd"])
        left = rec["left"]
        self.assertEqual(left.real.stamps.t_capture_ns.tolist(), left.simulated.stamps.t_capture_ns.tolist())
        self.assertEqual(len(rec["left/simulated"]), len(left))
        self.assertTrue((left[0].array() != left.simulated[0].array()).any())

    def test_visibility_says_what_the_application_saw(self):
        rec = rigor.open(self.files["zstd"])
        seen = rec["right"].visibility
        fresh = seen[seen["status"] == "fresh"]
        self.assertEqual(fresh["sequence"].tolist(), list(range(len(fresh))))
        stamps = rec["right"].stamps[:len(fresh)]
        self.assertEqual(fresh["t_ns"].tolist(), stamps.t_release_ns.tolist())
        cycle = int(fresh["cycle"][1])
        self.assertEqual(rec["right"].status_at([0, cycle - 1, cycle, cycle + 1]).tolist(), ["never", "held", "fresh", "held"])

    def test_names_are_offered(self):
        rec = rigor.open(self.files["zstd"])
        with self.assertRaisesRegex(rigor.BadInput, "did you mean 'right'"):
            rec["rigt"]
        self.assertIn("right", rec)
        self.assertEqual(len(rec["/right/image"]), len(rec["right"]))
        self.assertIn("demo", rec.rig)
        self.assertEqual(rec.metadata["rigor"]["seed"], "1")
        self.assertIn("right", rec._repr_html_())
        self.assertTrue(rec["right"][0]._repr_png_().startswith(b"\x89PNG"))

    def test_messages_of_any_type_are_read_by_the_files_own_definitions(self):
        rec = rigor.open(self.files["lz4"])
        info = rec.topics["/right/camera_info"][0]
        self.assertEqual((info.width, info.height, info.k.shape), (480, 360, (9,)))
        self.assertGreater(info.k[0], 100)
        for topic in rec.topics.values():
            if len(topic):
                topic[0], topic[-1]

    def test_a_damaged_chunk_is_an_error_or_passed_over(self):
        data = bytearray(Path(self.files["none"]).read_bytes())
        image = rigor.open(self.files["none"])["right"][0].array().tobytes()
        at = data.index(image[:64])
        data[at + 100] ^= 0xff
        Path("damaged.mcap").write_bytes(data)
        with self.assertRaises(rigor.ProtocolError):
            rigor.open("damaged.mcap")["right"].array()
        unchecked = rigor.open("damaged.mcap", verify=False)["right"][0].array()
        self.assertEqual((unchecked.reshape(-1) != numpy.frombuffer(image, "u1")).sum(), 1)

    def test_a_file_that_was_cut_gives_what_is_there(self):
        data = Path(self.files["zstd"]).read_bytes()
        Path("cut.mcap").write_bytes(data[:len(data) * 3 // 5])
        rec = rigor.open("cut.mcap")
        self.assertTrue(rec.about["truncated"])
        self.assertGreater(len(rec["turntable"]), 3)
        whole = rigor.open(self.files["zstd"])["turntable"].array()
        numpy.testing.assert_array_equal(rec["turntable"].array(), whole[:len(rec["turntable"])])

    def test_what_is_no_recording_is_refused(self):
        Path("no.mcap").write_bytes(b"not a recording")
        with self.assertRaises(rigor.BadInput):
            rigor.open("no.mcap")
        with self.assertRaises(rigor.NotFound):
            rigor.open("missing.mcap")

    def test_memory_is_bounded_by_the_cache(self):
        rec = rigor.open(self.files["zstd"], cache_mb=0.1)
        keep = rec["right"][0].array()
        before = keep.copy()
        for sample in rec["left"]:
            sample.array()
        numpy.testing.assert_array_equal(keep, before)  # its chunk left the cache and stays with the array


class OfInertialChannels(InFolder):
    def test_numbers_of_all_kinds_are_structured_arrays(self):
        seen = {}
        with rigor.Rig(CONFIGS / "rigs/forest-discs.yaml", clock="virtual", duration_s=1.2, record="r.mcap", report=False,
                       set={"analyses": {}}) as rig:
            while rig.step():
                for name, port in rig.ports().items():
                    if port.fresh:
                        seen[name] = port.sample
        rec = rigor.open("r.mcap")
        imu, odometry, fix, truth = (rec[n].array() for n in ("imu", "odometry", "gnss", "truth"))
        self.assertEqual(imu["specific_force_mps2"].shape[1], 3)
        self.assertEqual(tuple(imu["angular_rate_radps"][seen["imu"].sequence]), seen["imu"].angular_rate_radps)
        self.assertEqual(rec["imu"][-1].specific_force_mps2, tuple(imu["specific_force_mps2"][-1]))
        self.assertEqual(tuple(odometry["wheel_angle_rad"][seen["odometry"].sequence]), seen["odometry"].wheel_angle_rad)
        self.assertEqual(fix["latitude_deg"][seen["gnss"].sequence], seen["gnss"].latitude_deg)
        self.assertEqual(tuple(truth["orientation_wxyz"][seen["truth"].sequence]), seen["truth"].orientation_wxyz)
        cloud = rec["scanner"][seen["scanner"].sequence].array()
        numpy.testing.assert_array_equal(cloud, seen["scanner"].array())
        self.assertEqual(cloud.dtype, rigor.POINT)
        points = rec["scanner"].array()
        self.assertEqual(len(points), sum(len(s.array()) for s in rec["scanner"]))
        self.assertEqual(points["x_m"][points["sample"] == 1].tolist(), rec["scanner"][1].array()["x_m"].tolist())
        self.assertGreater(len(rec.commands("drive")), 5)


if __name__ == "__main__":
    unittest.main()
