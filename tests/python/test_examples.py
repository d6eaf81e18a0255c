"""The examples as a reader types them, shortened."""
import subprocess
import sys
import unittest

from rigs import SOURCE, InFolder


class Examples(InFolder):
    def example(self, *words):
        done = subprocess.run([sys.executable, SOURCE / "examples/python" / words[0], *words[1:]], capture_output=True, text=True,
                              check=False)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return done.stdout

    def test_detector(self):
        self.assertIn("commands, target rate from", self.example("detector.py", "--duration", "0.2"))

    def test_lidar_noise_finds_the_model_that_made_the_recording(self):
        said = self.example("lidar_noise.py", "--duration", "0.8").splitlines()
        rows = [[float(v) for v in line.split()] for line in said[1:9]]
        for _, measured, model in rows:
            self.assertLess(abs(measured / model - 1), 0.25)

    def test_harvester(self):
        self.assertIn("best:", self.example("harvester_slew.py", "--duration", "1", "--ramps", "8", "32"))

    def test_labelled_pictures(self):
        said = self.example("labelled_pictures.py", "--samples", "2")
        self.assertRegex(said, r"^2 pictures \(480, 752\), [1-9]")


if __name__ == "__main__":
    unittest.main()
