"""Rigs from Python: the same recordings as the command's, and what can be done between steps."""
import os
import signal
import threading
import unittest
import warnings
from pathlib import Path

import rigor
from rigs import CONFIGS, InFolder


class Rigs(InFolder):
    def test_a_rig_that_is_stepped_gives_the_recording_of_the_command_byte_for_byte(self):
        self.rigor("run", CONFIGS / "demo.yaml", "--clock", "virtual", "--duration", "0.25", "--record", "command.mcap", "--report", "r")
        with rigor.Rig(CONFIGS / "demo.yaml", clock="virtual", duration_s=0.25, record="stepped.mcap", report=False) as rig:
            while rig.step(7):
                pass
        self.assertTrue(rig.report.passed, rig.report.text)
        self.assertEqual(Path("command.mcap").read_bytes(), Path("stepped.mcap").read_bytes())

    def test_ports_show_what_came_and_commands_arrive(self):
        turned = []
        with rigor.Rig(self.table()) as rig:
            self.assertTrue(rig.step())
            self.assertEqual(rig["turntable"].status, "never")
            self.assertIsNone(rig["turntable"].sample)
            rig.command("table_command", enable=1, target_rate=30)
            while rig.step(10):
                if rig["turntable"].fresh:
                    sample = rig["turntable"].sample
                    turned.append((sample.sequence, sample.values["position"]))
                    self.assertEqual(sample.t_release_ns - sample.t_capture_ns, 10_000_000)
            self.assertGreater(turned[-1][1], 15)
            self.assertEqual([s for s, _ in turned], list(range(turned[0][0], turned[0][0] + len(turned))))
            self.assertFalse(rig.step())
        commands = rigor.open("table.mcap").commands("table_command")
        self.assertEqual(commands["target_rate"].tolist(), [30.0])
        self.assertEqual(commands["t_effect_ns"][0], 1_000_000 + 10_000_000)

    def test_a_value_that_is_not_named_keeps_what_was_commanded(self):
        with rigor.Rig(self.table()) as rig:
            rig.step()
            with self.assertRaisesRegex(rigor.BadInput, "enable, target_rate in the first command, got none for enable"):
                rig.command("table_command", target_rate=3)
            rig.command("table_command", enable=1, target_rate=3)
            rig.step()
            rig.command("table_command", target_rate=4)
            with self.assertRaisesRegex(rigor.BadInput, "did you mean 'target_rate'"):
                rig.command("table_command", target_rat=4)
            with self.assertRaisesRegex(rigor.BadInput, "did you mean 'table_command'"):
                rig.command("table_comand", enable=1, target_rate=4)
            rig.step()
        self.assertEqual(rigor.open("table.mcap").commands("table_command")["enable"].tolist(), [1, 1])

    def test_samples_stay_good_when_the_run_goes_on(self):
        kept = []
        with rigor.Rig(self.table()) as rig:
            while rig.step(10):
                if rig["turntable"].sample:
                    kept.append(rig["turntable"].sample)
        self.assertEqual(sorted({s.sequence for s in kept}), list(range(len({s.sequence for s in kept}))))

    def test_faults_and_switches_take_effect_and_are_recorded(self):
        with rigor.Rig(self.table()) as rig:
            rig.step(100)
            self.assertEqual(rig.pairs, ["load"])
            self.assertEqual(rig["load"].sample.values["force"], 24)
            rig.switch("load", "simulated")
            rig.fault("turntable", "drop", probability=1, for_s=0.3)
            rig.step(100)
            self.assertEqual(rig["load"].sample.values["force"], 25)
            self.assertEqual(rig["turntable"].status, "overdue")
            rig.clear_faults()
            rig.step(100)
            self.assertIn(rig["turntable"].status, ("held", "fresh"))
            with self.assertRaisesRegex(rigor.BadInput, "did you mean 'load'"):
                rig.switch("lod", "real")
            with self.assertRaises(rigor.BadInput):
                rig.fault("turntable", "dorp")
        kinds = [e.kind for e in rigor.open("table.mcap").events]
        self.assertIn("pair_switch", kinds)
        self.assertEqual([f.begins for f in rigor.open("table.mcap").faults][:1], [True])

    def test_expectations_are_told_while_it_runs_and_decide_the_report(self):
        with rigor.Rig(self.table()) as rig:
            rig.step()
            rig.command("table_command", enable=1, target_rate=80)
            rig.step(300)
            self.assertEqual(rig.expected()[0]["state"], "holds")  # so far
            rig.step(650)
            self.assertEqual(rig.expected()[0]["state"], "violated")
        self.assertFalse(rig.report.passed)
        self.assertFalse(rig.report["expect"][0]["holds"])
        self.assertIn("not passed", rig.report._repr_html_())

    def test_run_reports_progress_and_writes_the_page(self):
        seen = []
        with rigor.Rig(self.table(), report="report") as rig:
            report = rig.run(progress=seen.append)
        self.assertEqual(len(seen), 10)
        self.assertEqual(seen, sorted(seen))
        self.assertTrue(report.passed)
        self.assertIn("<html", report.html())

    def test_ctrl_c_ends_a_step_and_the_recording_is_whole(self):
        def interrupt(_):
            os.kill(os.getpid(), signal.SIGINT)
        with self.assertRaises(KeyboardInterrupt):
            with rigor.Rig(self.table(), duration_s=100000) as rig:
                rig.step(20)
                threading.Timer(0, interrupt, [0]).start()
                rig.step(100_000_000)
        self.assertTrue(rigor.open("table.mcap").about["good"])

    def test_what_progress_raises_ends_the_run(self):
        def stop(_):
            raise ZeroDivisionError
        with rigor.Rig(self.table()) as rig, self.assertRaises(ZeroDivisionError):
            rig.run(progress=stop)

    def test_calls_out_of_order_are_refused(self):
        rig = rigor.Rig(self.table())
        rig.run()
        with self.assertRaises(rigor.WrongState):
            rig.step()
        rig.close()
        with self.assertRaises(rigor.WrongState):
            rig["turntable"].status

    def test_a_seed_is_the_rigs_seed(self):
        with rigor.Rig(self.table(), seed=7, set={"duration_s": 0.01}) as rig:
            self.assertEqual((rig.seed, rig.duration_s), (7, 0.01))


class Follower(rigor.Application):
    rate_hz = 50

    def start(self, rig):
        self.gain = rig.params.get("gain", 1)
        self.turns, self.ended = 0, False

    def step(self, turn):
        self.turns += 1
        if turn["turntable"].fresh:
            turn.command("table_command", enable=1, target_rate=self.gain * (20 - turn["turntable"].sample.values["position"]))

    def finish(self):
        self.ended = True


class Failing(Follower):
    def step(self, turn):
        if turn.cycle >= 100:
            raise LookupError("nothing was found")


class Applications(InFolder):
    def test_an_object_commands_within_the_loop(self):
        follower = Follower()
        with rigor.Rig(self.table(), application=follower, params={"gain": 4}) as rig:
            report = rig.run()
        self.assertTrue(report.passed, report.text)
        self.assertEqual((follower.turns, follower.ended, follower.gain), (50, True, 4))
        position = rigor.open("table.mcap")["turntable"].array()["position"][-1]
        self.assertGreater(position, 15)

    def test_it_repeats_byte_for_byte(self):
        for name in ("a.mcap", "b.mcap"):
            with rigor.Rig(self.table(), application=Follower, record=name) as rig:
                rig.run()
        self.assertEqual(Path("a.mcap").read_bytes(), Path("b.mcap").read_bytes())

    def test_what_it_raises_comes_out_of_the_run(self):
        with self.assertRaisesRegex(LookupError, "nothing was found"):
            with rigor.Rig(self.table(), application=Failing) as rig:
                rig.run()
        with self.assertRaises(LookupError):
            with rigor.Rig(self.table(), application=Failing) as rig:
                rig.step(50)
                rig.step(500)

    def test_by_the_wall_clock_it_must_be_in_a_file(self):
        class Inner(rigor.Application):
            pass
        with self.assertRaisesRegex(rigor.BadInput, "a class at the top of a file"):
            rigor.Rig(self.table(), clock="wall", application=Inner)
        self.assertTrue(rigor._application.command_for(Follower)[2].endswith("test_rig.py"))


class WithAProcess(InFolder):
    def test_a_process_commands_what_an_object_does(self):
        with rigor.Rig(self.table(), application=Follower, record="a.mcap") as rig:
            rig.run()
        command = rigor._application.command_for(Follower)
        with rigor.Rig(self.table(), set={"application": {"command": command}}, record="c.mcap") as rig:
            rig.run()
        a, c = (rigor.open(f).commands("table_command") for f in ("a.mcap", "c.mcap"))
        self.assertGreater(len(a), 10)
        self.assertEqual(a.tolist(), c.tolist())


class Errors(InFolder):
    def test_they_carry_the_place(self):
        with self.assertRaises(rigor.BadInput) as caught:
            rigor.Rig(self.table("colour: red\n"))
        error = caught.exception
        self.assertEqual((os.path.basename(error.file), error.key), ("table.yaml", "colour"))
        self.assertEqual(Path("table.yaml").read_text(encoding="utf-8").splitlines()[error.line - 1][error.column - 1:], "colour: red")
        self.assertIsInstance(error, ValueError)
        self.assertIn("colour", str(error))

    def test_a_file_that_is_not_there_is_not_found(self):
        with self.assertRaises(rigor.NotFound):
            rigor.Rig("no-such.yaml")
        with self.assertRaises(rigor.BadInput):
            rigor.Rig(self.table(), clock="sundial")
        with self.assertRaises(rigor.BadInput) as caught:
            rigor.Rig(self.table(), set={"loop.spn_us": 10})
        self.assertIn("did you mean spin_us", str(caught.exception))

    def test_warnings_are_pythons(self):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with rigor.Rig(self.table()) as rig:
                rig.run()


if __name__ == "__main__":
    unittest.main()
