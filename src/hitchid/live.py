"""A model in a loop with something that runs now: a sample in, an answer out, whatever comes."""

import json
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from hitchid.model import Hitch, Packed
from hitchid.record import COMMAND, DISPLACEMENT, MODES

TIME = "time_s"
KNOWN = (TIME, *COMMAND.values(), DISPLACEMENT)
LONGEST_GAP = 10_000
STANDING = "standing"
DIGITS = 9
LARGEST = 1e9


class Answer(NamedTuple):
    """What a model says to one sample.

    Attributes:
        time_s: the time the displacement is for: one sampling time after the sample, s.
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

    Where commands are missing the last ones stand; without a measured displacement it coasts on commands.
    Samples that come late are made up for; those from the past are not taken in.

    Args:
        model: an identified hitch.
        initial: displacement to start from, in the model's unit; None for the first one measured.
        load: second measured input before motion, where the model hears one.
    """

    def __init__(self, model: Hitch, *, initial: float | None = None, load: float = 0.0) -> None:
        self._model = model
        self._load = load
        self._state = None if initial is None else model.initial(initial, load)
        self._time_s: float | None = None
        self._displacement = initial
        self._measured = False

    def hear(self, line: str) -> Answer:
        """Take in one line of JSON and answer it."""
        sample, flags = _read(line)
        due = 0.0 if self._time_s is None else self._time_s + self._model.step_s
        told = sample.get(TIME, math.nan)
        time_s = told if math.isfinite(told) else due
        behind = 0 if self._time_s is None else _whole((time_s - due) / self._model.step_s)
        if behind < -LONGEST_GAP:
            flags.append(f"the clock was set back from {self._time_s:g} s: starting anew")
            self._state = self._displacement = None
            behind = 0
        if behind < 0:
            return self._answer(due, [*flags, f"out of order: {time_s:g} s came after {self._time_s:g} s"])
        measured = sample.get(DISPLACEMENT, math.nan)
        if behind > 0:
            flags.append(f"late: {behind} samples are missing before {time_s:g} s")
            self._make_up(behind)
        if self._state is None and math.isfinite(measured):
            self._state = self._model.initial(measured, self._load)
        self._time_s = time_s
        if self._state is not None:
            commands = np.array([sample.get(COMMAND[mode], math.nan) for mode in MODES])
            self._step(commands, measured)
            flags += self._said(self._state, sample, measured)
        return self._answer(time_s + self._model.step_s, flags)

    def _make_up(self, samples: int) -> None:
        """Coast over samples that never came; after too many nothing is known any more."""
        if samples > LONGEST_GAP:
            self._state = self._displacement = None
            return
        for _ in range(samples):
            self._step(np.full(len(MODES), math.nan), math.nan)

    def _step(self, commands: np.ndarray, measured: float) -> None:
        if self._state is not None:
            self._state, displacement = self._model.step(self._state, commands, measured)
            self._displacement = float(displacement)
            self._measured |= math.isfinite(measured)

    def _said(self, state: Packed, sample: Mapping[str, float], measured: float) -> list[str]:
        heard = [COMMAND[mode] for mode in self._model.channels]
        lost = [role for role in heard if not math.isfinite(sample.get(role, math.nan))]
        flags = [f"{role} is missing: the last one stands" for role in lost]
        if self._measured and not math.isfinite(measured):
            flags.append("coasting: no displacement was measured")
        if bool(self._model.situation(state).both):
            flags.append("both valves are on: lowering counts")
        return flags

    def _answer(self, time_s: float, flags: list[str]) -> Answer:
        time_s = round(time_s, DIGITS)
        if self._state is None:
            return Answer(time_s, None, STANDING, (*flags, "waiting for a displacement to start from"))
        charge = int(self._model.situation(self._state).mode)
        mode = STANDING if charge < 0 else tuple(self._model.channels)[charge]
        return Answer(time_s, self._displacement, mode, tuple(flags))


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
