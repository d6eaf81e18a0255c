"""The package as `cmake --install` leaves it: it finds its libraries by itself."""
import os
import subprocess
import sys
import unittest

from rigs import InFolder


class Installed(InFolder):
    def test_it_is_imported_from_its_prefix(self):
        prefix = self.folder / "prefix"
        for component in ("python", "libraries"):
            subprocess.run(["cmake", "--install", os.environ["RIGOR_BINARY_DIR"], "--prefix", prefix, "--component", component],
                           check=True, capture_output=True)
        site = prefix / "lib/python3/dist-packages"
        self.assertEqual({p.name for p in site.iterdir()}, {"rigor", "rigor_client.py"})
        self.assertTrue((site / "rigor/py.typed").is_file())
        self.assertFalse(any(p.is_symlink() for p in (site / "rigor").iterdir()))
        code = ("import rigor; print(rigor.__file__); print(open('/proc/self/maps').read())")
        environment = {"PATH": os.environ["PATH"], "PYTHONPATH": str(site)}
        said = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
        self.assertEqual(said.returncode, 0, said.stderr)
        self.assertIn(str(site / "rigor/__init__.py"), said.stdout)
        libraries = {line.split()[-1] for line in said.stdout.splitlines() if "/librigor_" in line}
        self.assertEqual(len(libraries), 3, libraries)
        self.assertTrue(all(library.startswith(str(prefix)) for library in libraries), libraries)


if __name__ == "__main__":
    unittest.main()
