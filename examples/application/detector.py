"""Turns the table of the demo towards the brightest column of a camera's picture.

rigor run demo --clock virtual --set "application={command: [python3, $PWD/detector.py]}"
"""
import rigor_client


class Detector(rigor_client.Application):
    rate_hz = 50

    def start(self, rig):
        self.gain = rig.params.get("gain_degps_per_px", 0.1)
        self.rate_degps = 0.0

    def step(self, turn):
        camera = turn["right"]
        if camera.fresh:
            width = camera.sample.width_px
            columns = [sum(camera.sample.bytes[x::width]) for x in range(width)]
            self.rate_degps = self.gain * (columns.index(max(columns)) - width / 2)
        turn.command("table_command", enable=1, target_rate=self.rate_degps)


rigor_client.run(Detector())
