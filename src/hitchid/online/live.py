"""A model in a loop with something that runs now: a sample in, an answer out, whatever comes."""

import json
import math
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from hitchid.data.record import COMMAND, DISPLACEMENT, MODES
from hitchid.data.test_kinds import effective_command
from hitchid.model import Channel, Hitch, Packed

TIME = "time_s"
KNOWN = (TIME, *COMMAND.values(), DISPLACEMENT)
LONGEST_GAP = 1000
SET_BACK = 10_000
RECENT = 100
STANDING = "standing"
DIGITS = 9
LARGEST = 1e9

Sample = Mapping[str, float]


class Answer(NamedTuple):
    """What a model says to one sample.

    Attributes:
        time_s: the time the displacement is for: one sampling time after the sample, on the model's clock, s.
        displacement: in the model's unit; None as long as none is known to start from.
        mode: the channel in charge: lifting, lowering, or standing before any was.
        flags: what was missing or odd.
    """

    time_s: float
    displacement: float | None
    mode: str
    flags: tuple[str, ...]

    def line(self) -> str:
        """Return the answer as one line of JSON."""
        return json.dumps(self._asdict())


class Live:
    """A model that is asked sample by sample; it answers every line and never with NaN.

    It steps on a clock of its own, from the first sample on: each sample counts for the sampling time it is
    nearest to, a second one for the same takes the place of the first. Where commands are missing the last
    ones stand; without a measured displacement it coasts on commands. Sampling times without a sample are
    made up for; samples from the past are not taken in. Programs are compiled before the first sample.

    Args:
        model: an identified hitch.
        initial: displacement to start from, in the model's unit; None for the first one measured.
        load: second measured input before motion, where the model hears one.

    Raises:
        InputError: a number to start from is not finite.
    """

    def __init__(self, model: Hitch, *, initial: float | None = None, load: float = 0.0) -> None:
        self._model = model
        self._load = load
        self._displacement = initial
        self._state = None if initial is None else model.initial(initial, load)
        self._origin_s: float | None = None
        self._latest_s = -math.inf
        self._steps = 0
        self._recent: deque[tuple[Packed | None, Sample]] = deque(maxlen=RECENT)
        self._measured = False
        self._covered = {mode: _ranges(channel) for mode, channel in model.channels.items()}
        state, _ = model.step(model.initial(0.0, load), np.zeros(len(MODES)), math.nan)
        model.situation(state)

    def hear(self, line: str) -> Answer:
        """Take in one line of JSON and answer it."""
        sample, flags = _read(line)
        stamp = sample.get(TIME, math.nan)
        stamped = math.isfinite(stamp)
        time_s = stamp if stamped else self._due_s
        if self._origin_s is None or (stamped and self._latest_s == -math.inf):
            self._restart(time_s)
        behind = _whole((time_s - self._due_s) / self._model.step_s)
        if behind < -SET_BACK:
            flags.append(f"the clock was set back from {self._latest_s:g} s: starting anew")
            self._forget(time_s)
            behind = 0
        elif behind < 0 and (stamp <= self._latest_s or -behind > len(self._recent)):
            return self._answer([*flags, f"out of order: {stamp:g} s came after {self._latest_s:g} s"])
        elif behind > 0:
            flags.append(f"late: {behind} samples are missing before {time_s:g} s")
            self._make_up(behind, time_s)
        earlier = self._take_back(-behind) if behind < 0 else {}
        if TIME in earlier:
            flags.append(f"early: {time_s:g} s takes the place of {earlier[TIME]:g} s, nearest to one time")
        if stamped:
            self._latest_s = stamp
        whole = {**earlier, **sample}
        self._step(whole)
        if self._state is not None:
            flags += self._said(self._state, whole)
        return self._answer(flags)

    @property
    def _due_s(self) -> float:
        """Time of the next sample on the model's clock, s."""
        return (self._origin_s or 0.0) + self._steps * self._model.step_s

    def _restart(self, time_s: float) -> None:
        """Set the model's clock."""
        self._origin_s, self._steps, self._latest_s = time_s, 0, -math.inf
        self._recent.clear()

    def _forget(self, time_s: float) -> None:
        """Set the model's clock, and wait for a displacement to start from."""
        self._restart(time_s)
        self._state = self._displacement = None

    def _make_up(self, samples: int, time_s: float) -> None:
        """Coast over samples that never came; after too many nothing is known any more."""
        if samples > LONGEST_GAP:
            self._forget(time_s)
            return
        for _ in range(samples):
            self._step({})

    def _take_back(self, samples: int) -> Sample:
        """Undo the latest steps; return what the first of them was made with."""
        sample: Sample = {}
        for _ in range(min(samples, len(self._recent))):
            self._state, sample = self._recent.pop()
        self._steps -= samples
        return sample

    def _step(self, sample: Sample) -> None:
        measured = sample.get(DISPLACEMENT, math.nan)
        self._recent.append((self._state, sample))
        self._steps += 1
        if self._state is None and math.isfinite(measured):
            self._state = self._model.initial(measured, self._load)
        if self._state is not None:
            commands = np.array([sample.get(COMMAND[mode], math.nan) for mode in MODES])
            self._state, displacement = self._model.step(self._state, commands, measured)
            self._displacement = float(displacement)
            self._measured |= math.isfinite(measured)

    def _said(self, state: Packed, sample: Sample) -> list[str]:
        heard = [COMMAND[mode] for mode in self._model.channels]
        lost = [role for role in heard if not math.isfinite(sample.get(role, math.nan))]
        flags = [f"{role} is missing: the last one stands" for role in lost]
        if self._measured and not math.isfinite(sample.get(DISPLACEMENT, math.nan)):
            flags.append("coasting: no displacement was measured")
        situation = self._model.situation(state)
        if bool(situation.both):
            flags.append("both valves are on: lowering counts")
        return flags + self._out_of_range(sample, int(situation.mode))

    def _out_of_range(self, sample: Sample, charge: int) -> list[str]:
        """Tell what of a sample leaves the tests; a displacement, those of each channel that may move it."""
        model, found = self._model, []
        for mode, channel in model.channels.items():
            command = abs(effective_command(np.array([sample.get(COMMAND[mode], 0.0)]), channel.dead_zone)[0])
            lowest, highest = self._covered[mode]["command"]
            if command > highest or 0 < command < lowest:
                found.append((COMMAND[mode], model.covered(mode, "command")))
        modes = tuple(model.channels)
        possible = modes if charge < 0 else modes[charge : charge + 1]
        measured = sample.get(DISPLACEMENT, math.nan)
        ends = [self._covered[mode][DISPLACEMENT] for mode in possible]
        if math.isfinite(measured) and all(not low <= measured <= high for low, high in ends):
            found.append((DISPLACEMENT, model.covered(possible[0], DISPLACEMENT)))
        return [f"outside: {role} {sample[role]:g}; the tests covered {covered}" for role, covered in found]

    def _answer(self, flags: list[str]) -> Answer:
        time_s = round(self._due_s, DIGITS)
        if self._state is None:
            return Answer(time_s, None, STANDING, (*flags, "waiting for a displacement to start from"))
        charge = int(self._model.situation(self._state).mode)
        mode = STANDING if charge < 0 else tuple(self._model.channels)[charge]
        return Answer(time_s, self._displacement, mode, tuple(flags))


def _ranges(channel: Channel) -> dict[str, tuple[float, float]]:
    """Return from where to where commands beyond the dead zone, and displacements, went in the tests."""
    if channel.envelope is None:
        return dict.fromkeys(("command", DISPLACEMENT), (-math.inf, math.inf))
    covered = {"command": channel.envelope.command, DISPLACEMENT: channel.envelope.displacement}
    return {name: (float(ends.lowest), float(ends.highest)) for name, ends in covered.items()}


def _read(line: str) -> tuple[dict[str, float], list[str]]:
    """Return the numbers of one line, and what is odd about it."""
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        return {}, ["not understood: the line is no JSON"]
    if not isinstance(content, dict):
        return {}, ['not understood: required an object like {"time_s": 0.01, "lifting_command": 0.5}']
    flags = [f"not known: '{name}'; known are {', '.join(KNOWN)}" for name in content if name not in KNOWN]
    sample = {}
    for name in KNOWN:
        value = content.get(name)
        if isinstance(value, int | float) and not isinstance(value, bool):
            number = _finite(value)
            sample[name] = number if name == TIME or abs(number) < LARGEST else math.nan
        elif value is not None:
            flags.append(f"not a number: {name}")
    return sample, flags


def _finite(value: int | float) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _whole(samples: float) -> int:
    """Return a number of samples; beyond all measure, one that is too many."""
    return round(min(max(samples, -1e15), 1e15))
