"""A rig as an environment."""
import unittest

import numpy
import rigor
from rigs import InFolder


def env(rig, **more):
    return rigor.Env(rig, observe=["turntable.position", "turntable.rate"], act=["table_command.target_rate"],
                     fixed={"table_command.enable": 1}, low=-60, high=60, every=20,
                     reward=lambda obs, action, r: (-abs(obs[0] - 10), obs[0] > 9.5), **more)


class Environments(InFolder):
    def test_episodes_of_one_seed_repeat_and_end(self):
        with env(self.table()) as table:
            episodes = []
            for _ in range(2):
                observation, info = table.reset(seed=3)
                self.assertEqual(observation.shape, table.observation_space.shape)
                rewards, terminated, truncated = [], False, False
                while not (terminated or truncated):
                    action = numpy.array([2 * (10 - numpy.nan_to_num(observation[0]))])
                    observation, reward, terminated, truncated, info = table.step(action)
                    rewards.append(reward)
                episodes.append(rewards)
            self.assertEqual(str(episodes[0]), str(episodes[1]))
            self.assertTrue(terminated or info["t_s"] >= 1)

    def test_the_end_of_the_rig_truncates(self):
        with env(self.table(), duration_s=0.1) as table:
            table.reset()
            steps = 0
            while not table.step([0.0])[3]:
                steps += 1
            self.assertEqual(steps, 4)

    def test_actions_are_clipped_and_spaces_say_so(self):
        with env(self.table()) as table:
            table.reset()
            for _ in range(20):
                table.step([1e9])
            self.assertLessEqual(table.rig["turntable"].sample.values["rate"], 60.1)
            self.assertTrue(table.action_space.contains(table.action_space.sample()))
            self.assertFalse(table.action_space.contains([61.0]))

    def test_names_are_checked(self):
        with self.assertRaises(rigor.BadInput):
            rigor.Env(self.table(), observe=[], act=["table_command"], reward=None)
        table = rigor.Env(self.table(), observe=["turntable.positon"], act=[], reward=lambda *_: 0)
        with table, self.assertRaisesRegex(rigor.BadInput, "expected one of position, rate"):
            table.reset()
            for _ in range(50):
                table.step([])


if __name__ == "__main__":
    unittest.main()
