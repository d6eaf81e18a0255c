"""A rig as an environment for learning, with the calls of gymnasium, which is not needed for it."""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy

from ._errors import BadInput
from ._rig import Rig


class Box:
    """What a space of gymnasium says of arrays: shape, dtype, low, high, sample(), contains()."""

    def __init__(self, shape, dtype="float64", low=-numpy.inf, high=numpy.inf, names: Sequence[str] = ()):
        self.shape, self.dtype, self.names = tuple(shape), numpy.dtype(dtype), list(names)
        self.low = numpy.broadcast_to(numpy.asarray(low, self.dtype), self.shape)
        self.high = numpy.broadcast_to(numpy.asarray(high, self.dtype), self.shape)
        self._rng = numpy.random.default_rng(0)

    def seed(self, seed: int | None = None) -> None:
        self._rng = numpy.random.default_rng(seed)

    def sample(self) -> numpy.ndarray:
        """Uniform between the bounds; of a normal distribution where there are none."""
        bounded = numpy.isfinite(self.low) & numpy.isfinite(self.high)
        uniform = self._rng.uniform(numpy.where(bounded, self.low, 0), numpy.where(bounded, self.high, 1))
        return numpy.where(bounded, uniform, self._rng.normal(size=self.shape)).astype(self.dtype)

    def contains(self, x) -> bool:
        x = numpy.asarray(x)
        return x.shape == self.shape and bool((x >= self.low).all() and (x <= self.high).all())

    def __repr__(self) -> str:
        return f"Box({self.shape}, {self.dtype}, {', '.join(self.names)})"


class Env:
    """A rig in virtual time that one acts on.

        env = rigor.Env("demo", observe=["turntable.position", "turntable.rate"], act=["table_command.target_rate"],
                        fixed={"table_command.enable": 1}, low=-20, high=20, reward=lambda obs, action, rig: -abs(obs[0] - 30))
        observation, info = env.reset(seed=7)
        observation, reward, terminated, truncated, info = env.step([5.0])

    observe: values of channels ("turntable.position"), which make a vector (n,) of float64 (NaN: nothing was seen yet), or
    channels as a whole ("scanner"), with which an observation is a dictionary: "values" the vector, and the array of each.
    act: values of sinks, the action (n,), between low and high; fixed: further values. every: cycles of the loop in a step.
    reward(observation, action, rig) gives the reward, or (reward, terminated). truncated: the rig's duration is over. The rig's
    own application is left out. Episodes of one seed repeat exactly. More options are those of rigor.Rig.
    """
    metadata: dict = {"render_modes": ["rgb_array"]}
    render_mode = "rgb_array"

    def __init__(self, rig, *, observe: Sequence[str], act: Sequence[str], reward: Callable, fixed: Mapping[str, float] | None = None,
                 low=-numpy.inf, high=numpy.inf, every: int = 1, render: str | None = None, set: Mapping[str, object] | None = None,
                 **options):
        self._rig_file, self._reward, self._every, self._render = rig, reward, int(every), render
        self._values = [name for name in observe if "." in name]
        self._channels = [name for name in observe if "." not in name]
        self._act, self._fixed = list(act), dict(fixed or {})
        for name in (*self._act, *self._fixed):
            if "." not in name:
                raise BadInput("act", f"expected SINK.VALUE, got \"{name}\"")
        self._set = {**(set or {})}
        self._options = {"record": False, "report": False, "clock": "virtual", **options}
        self.action_space = Box((len(self._act),), low=low, high=high, names=self._act)
        self.observation_space: Box | dict[str, Box] = Box((len(self._values),), names=self._values)
        self.rig: Rig | None = None
        self._seed: int | None = options.pop("seed", None)
        self._options.pop("seed", None)

    def reset(self, *, seed: int | None = None, options: Mapping[str, object] | None = None):
        """Begins an episode: (observation, info). seed: of the rig; None: that of the episode before. options: values of the
        rig for this episode, as `set`."""
        self.close()
        if seed is not None:
            self._seed = seed
        self.rig = Rig(self._rig_file, seed=self._seed, set={**self._set, **(options or {})}, application=_Nothing(),
                       **self._options).prepare()
        if self._channels:
            spaces = {"values": Box((len(self._values),), names=self._values)} if self._values else {}
            for name in self._channels:
                port = self.rig[name]
                spaces[name] = Box((port.height_px, port.width_px) if port.width_px else (-1,), "float64", names=[name])
            self.observation_space = spaces
        self.rig.step(1)
        return self._observe(), {"t_s": self.rig.t_s}

    def step(self, action):
        """(observation, reward, terminated, truncated, info) after an action (n,)."""
        if self.rig is None:
            raise BadInput("env", "expected reset() before step()")
        action = numpy.clip(numpy.asarray(action, float).reshape(len(self._act)), self.action_space.low, self.action_space.high)
        commands: dict[str, dict[str, float]] = {}
        for name, value in (*self._fixed.items(), *zip(self._act, action)):
            sink, _, key = name.partition(".")
            commands.setdefault(sink, {})[key] = float(value)
        for sink, values in commands.items():
            self.rig.command(sink, **values)
        more = self.rig.step(self._every)
        observation = self._observe()
        judged = self._reward(observation, action, self.rig)
        reward, terminated = judged if isinstance(judged, tuple) else (judged, False)
        return observation, float(reward), bool(terminated), not more, {"t_s": self.rig.t_s}

    def render(self) -> numpy.ndarray | None:
        """The picture of the channel `render`, (height, width[, 3]); None before the first."""
        sample = self.rig[self._render].sample if self.rig and self._render else None
        return None if sample is None else sample.array()

    def close(self) -> None:
        if self.rig is not None:
            self.rig.close()
            self.rig = None

    def __enter__(self) -> "Env":
        return self

    def __exit__(self, *_):
        self.close()

    def _observe(self):
        values = numpy.full(len(self._values), numpy.nan)
        for i, name in enumerate(self._values):
            channel, _, key = name.partition(".")
            sample = self.rig[channel].sample
            if sample is not None:
                values[i] = _value(sample, key, name)
        if not self._channels:
            return values
        observation = {"values": values} if self._values else {}
        for name in self._channels:
            sample = self.rig[name].sample
            observation[name] = None if sample is None else sample.array()
        return observation


class _Nothing:
    """In place of the rig's own application: who commands is the environment."""
    rate_hz = None

    def start(self, rig):
        pass

    def step(self, turn):
        pass

    def finish(self):
        pass


def _value(sample, key: str, name: str) -> float:
    if sample.kind == "registers":
        if key in sample.values:
            return sample.values[key]
        known = sample.values
    else:
        key, _, index = key.partition("[")
        if hasattr(sample, key):
            value = getattr(sample, key)
            return float(value[int(index[:-1])]) if index else float(value)
        known = [k for k in sample.__dict__ if k not in ("kind", "bytes")]
    raise BadInput(name, f"expected one of {', '.join(known)}")
