"""What the tests of the Python module share: where things are, and a rig without pictures, which costs nothing."""
import os
import subprocess
import tempfile
import unittest
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[2]
CONFIGS = SOURCE / "configs"
DATA = Path(os.environ.get("RIGOR_TEST_DATA", SOURCE / "../shared/data"))
COMMAND = os.environ["RIGOR_COMMAND"]

TABLE = f"""
name: table
seed: 1
duration_s: 1
clock: virtual
loop: {{ rate_hz: 1000 }}
simulation:
  world: {CONFIGS}/worlds/turntable.yaml
  joints: {{ turntable: {{ channel: turntable, position: position, rate: rate, unit: deg }} }}
channels:
  turntable:
    kind: registers
    backend: modbus
    emulated_by: turntable
    rate_hz: 100
    latency_ms: 10
    address: 127.0.0.1
    port: 5020
    registers:
      - {{ name: position, table: input_registers, address: 0, type: s32, byte_order: ABCD, scale: 0.001, unit: deg }}
      - {{ name: rate, table: input_registers, address: 2, type: s32, byte_order: ABCD, scale: 0.001, unit: deg/s }}
  load:
    kind: registers
    rate_hz: 50
    latency_ms: 4
    pair:
      active: real
      real: {{ backend: simulated, signals: {{ force: {{ constant: 24, unit: N }} }} }}
      simulated: {{ backend: simulated, signals: {{ force: {{ constant: 25, unit: N }} }} }}
sinks:
  table_command:
    backend: modbus
    emulated_by: turntable
    latency_ms: 10
    address: 127.0.0.1
    port: 5020
    registers:
      - {{ name: enable, table: holding_registers, address: 0, type: u16 }}
      - {{ name: target_rate, table: holding_registers, address: 4, type: s32, byte_order: ABCD, scale: 0.001, unit: deg/s }}
    safe: {{ enable: 0, target_rate: 0 }}
emulators:
  turntable: {{ backend: modbus, address: 127.0.0.1, port: 5020, model: turntable, joint: turntable }}
expect:
  - {{ of: turntable.position, value: {{ min: -1, max: 45 }} }}
record: {{ file: table.mcap, compression: none, chunk_kib: 64, budget_mib: 4 }}
"""


class InFolder(unittest.TestCase):
    """A folder of its own for each test, in which it runs."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.addCleanup(os.chdir, os.getcwd())
        os.chdir(folder.name)
        self.folder = Path(folder.name)

    def table(self, more=""):
        """The rig without pictures."""
        Path("table.yaml").write_text(TABLE + more, encoding="utf-8")
        return "table.yaml"

    def rigor(self, *words):
        done = subprocess.run([COMMAND, *map(str, words)], capture_output=True, text=True, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout
