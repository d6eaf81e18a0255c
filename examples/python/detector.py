"""Your detector against a rig: it finds the bright column of a camera's picture and turns the table towards it.

    python3 detector.py                  virtual time, within this process
    python3 detector.py --clock wall     by the clock, in a process of its own, with emulated devices

The run judges itself: the table must have been commanded, and the camera must not have lost a picture.
"""
import argparse

import rigor


class Detector(rigor.Application):
    rate_hz = 50

    def start(self, rig):
        self.gain = rig.params.get("gain_degps_per_px", 0.1)
        self.rate_degps = 0.0

    def step(self, turn):
        camera = turn["right"]
        if camera.fresh:
            columns = camera.sample.array().sum(axis=0, dtype="u4")
            self.rate_degps = self.gain * (int(columns.argmax()) - len(columns) / 2)
        turn.command("table_command", enable=1, target_rate=self.rate_degps)


def main():
    options = argparse.ArgumentParser()
    options.add_argument("--clock", default="virtual", choices=["virtual", "wall"])
    options.add_argument("--duration", type=float, default=2.0)
    options = options.parse_args()
    expect = [{"of": "right", "missing": {"max": 0}}, {"of": "turntable.rate", "value": {"min": -40, "max": 40}}]
    with rigor.Rig("demo", clock=options.clock, duration_s=options.duration, application=Detector, record="detector.mcap",
                   report=False, replace=True, set={"expect": expect}) as rig:
        report = rig.run(progress=lambda t_s: print(f"\r{t_s:.1f} s", end="", flush=True))
    print()
    print(report)
    commands = rigor.open("detector.mcap").commands("table_command")
    print(f"{len(commands)} commands, target rate from {commands['target_rate'].min():.1f} to {commands['target_rate'].max():.1f} deg/s")
    return 0 if report.passed else 1


if __name__ == "__main__":
    raise SystemExit(main())
