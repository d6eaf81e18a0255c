"""A controller tuned against the harvester: how fast its crane may slew so that it is there soon and its head swings little.

    python3 harvester_slew.py

rigor.Env has the calls of gymnasium: what trains an agent there can be given it. Here the one number of a ramp is searched.
"""
import argparse

import numpy
import rigor

TARGET_DEG = 30.0


def make_env(duration_s):
    """The crane alone: the scanners of the rig look seldom."""
    def reward(observation, action, rig):
        slew, hang = observation
        return -abs(slew - TARGET_DEG) / TARGET_DEG - 0.2 * abs(hang - make_env.at_rest)
    make_env.at_rest = 0.0
    return rigor.Env("harvester", observe=["crane_state.slew", "crane_state.hang"], act=["crane.slew_to"], low=-110, high=110, every=10,
                     fixed={"drive.v": 0, "drive.steer_to": 0, "drive.enable": 1, "crane.boom_to": 50, "crane.stick_to": -100,
                            "crane.telescope_to": 0}, duration_s=duration_s, reward=reward,
                     set={f"channels.{c}.rate_hz": 0.01 for c in ("left", "right", "ground")} | {"analyses": {}})


def episode(env, ramp_degps, seed=1):
    """Total reward of a slew at this rate."""
    observation, info = env.reset(seed=seed)
    total, truncated, target = 0.0, False, 0.0
    while not truncated:
        target = min(TARGET_DEG, target + ramp_degps * 0.05)
        observation, reward, _, truncated, info = env.step([target])
        total += 0.0 if numpy.isnan(reward) else reward
    return total, observation


def main():
    options = argparse.ArgumentParser()
    options.add_argument("--duration", type=float, default=8.0)
    options.add_argument("--ramps", type=float, nargs="+", default=[4, 8, 16, 32, 64])
    options = options.parse_args()
    best = None
    with make_env(options.duration) as env:
        for ramp in options.ramps:
            total, last = episode(env, ramp)
            print(f"{ramp:5.0f} deg/s: {total:8.2f}, ends at slew {last[0]:.1f} deg, hang {last[1]:.1f} deg")
            if best is None or total > best[1]:
                best = (ramp, total)
    print(f"best: {best[0]:.0f} deg/s")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
