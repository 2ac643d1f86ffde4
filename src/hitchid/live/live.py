"""Online simulation: one line of JSON in, one prediction out; faulty lines give flags, not errors."""

import json
import math
from collections import deque
from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hitchid._support.records import short_repr
from hitchid.live.adaptation_process import OnlineAdaptation
from hitchid.live.events import REPORTED
from hitchid.live.parameters import AdjustableHitch
from hitchid.logs import COMMAND, DIRECTIONS, DISPLACEMENT
from hitchid.model import Hitch, Load, Packed

# Flags for inputs outside the ranges of the identification tests, sample by sample.


class RangeCheck:
    """Compares commands and displacement with those of the identification tests.

    It computes with Python's numbers: for single ones NumPy takes several times as long.
    """

    def __init__(self, model: Hitch) -> None:
        self._commands: list[tuple[str, float, float, float, str]] = []
        self._displacements: list[tuple[float, float, str]] = []
        for direction, channel in model.channels.items():
            covered, role = channel.operating_range, COMMAND[direction]
            lowest, highest = float(covered.command.lowest), float(covered.command.highest)
            # As the command that it is said of, not beyond the dead zone as it is kept.
            ends = " to ".join(f"{channel.dead_zone + end:.4g}" for end in (lowest, highest))
            text = f"{ends} {model.units.get(role, '')}"
            self._commands.append((role, channel.dead_zone, lowest, highest, text))
            low, high = float(covered.displacement.lowest), float(covered.displacement.highest)
            self._displacements.append((low, high, model.describe_range(direction, DISPLACEMENT)))

    def flags(self, sample: Mapping[str, float], mode: int) -> list[str]:
        """Return a sentence for each command outside its range, and for a displacement outside all of them.

        The mode is the index of the active channel; −1 before any was active.
        """
        outside = []
        for role, dead_zone, lowest, highest, text in self._commands:
            effective = max(abs(sample.get(role, 0.0)) - dead_zone, 0.0)
            if effective > highest or 0 < effective < lowest:
                outside.append((role, text))
        measured = sample.get(DISPLACEMENT, math.nan)
        ranges = self._displacements if mode < 0 else self._displacements[mode : mode + 1]
        if math.isfinite(measured) and not any(low <= measured <= high for low, high, _ in ranges):
            outside.append((DISPLACEMENT, ranges[0][2]))
        return [f"outside: {role} {sample[role]:g}; the identified range is {text}" for role, text in outside]


TIME = "time_s"
FIELDS = (TIME, *COMMAND.values(), DISPLACEMENT)
MAX_GAP_SAMPLES = 1000  # longest gap that is simulated, 10 s at 100 Hz; a longer one restarts; chosen
# s of the latest states, which are kept: steps within it can be taken back. A stamp that jumps farther is not
# believed alone: what is simulated on its word could not be taken back where it is wrong. Chosen.
KEPT_S = 1.0
LEAST_KEPT = 10  # samples of a slow model that are kept however long they take: a few may be lost; chosen
AGREEING = 5  # samples in a row whose clock is followed although it jumps: 0.05 s at 100 Hz; chosen
USUAL = 1.5  # times the shortest of its latest intervals, within which the next sample is on time; chosen
STANDING = "standing"  # `Output.mode` before any channel was active
DIGITS = 9  # decimals of `Output.time_s`: 1 ns, removes rounding errors
MAX_MAGNITUDE = 1e9  # a command or displacement beyond it, in its unit, is taken as missing; chosen
MAX_SHOWN = 80  # characters of names in a flag; chosen

Sample = Mapping[str, float]


@short_repr
class Output(NamedTuple):
    """Output of a model for one sample.

    Attributes:
        time_s: time of the displacement: one sampling time after the sample, on the model's clock, s.
        displacement: predicted displacement, in the model's unit; None before the first measured one.
        mode: active channel: lifting or lowering; standing before any was active.
        flags: sentences about missing or implausible inputs.
    """

    time_s: float
    displacement: float | None
    mode: str
    flags: tuple[str, ...]

    def to_json(self) -> str:
        """Return the output as one line of JSON."""
        return json.dumps(self._asdict())


class Live:
    """Online simulation of a model, sample by sample; every line gives an output, never NaN.

    The model has its own clock, which starts at the first sample. Each sample is assigned to the nearest
    sampling time; a second one for the same time replaces the first. A missing command keeps its last value;
    without a measured displacement the model simulates from the commands. Steps without a sample are
    simulated; samples out of order are ignored. A sample that left a gap is taken back where the next one
    belongs into that gap. A clock that jumps by more than a second, and by more than the stream's own
    interval, is followed once five samples agree.
    Functions are compiled before the first sample.

    With an adaptation `learn` is to be called after each output, once that is on its way; where it was not,
    the next sample begins with it.

    Args:
        model: an identified hitch.
        initial: initial displacement, in the model's unit; None for the first measured one.
        load: covariate before motion, or several by name; by default the mean of the identification tests.
        adaptation: of the same model, at the same load; None for a model that stays as it is.

    Raises:
        InputError: initial displacement or load is not finite, or beyond 1e9.
    """

    def __init__(
        self,
        model: Hitch,
        *,
        initial: float | None = None,
        load: Load | None = None,
        adaptation: OnlineAdaptation | None = None,
    ) -> None:
        self._model = model
        self._stepped: Hitch | AdjustableHitch = model
        self._adaptation = adaptation
        if adaptation is not None:
            self._stepped = AdjustableHitch(model)
            self._numbers = adaptation.numbers
        self._load = load
        self._displacement = initial
        self._state = None if initial is None else self._init_state(initial)
        self._origin_s: float | None = None
        self._latest_s = self._settled_s = -math.inf  # latest time stamp, and latest that is not taken back
        self._steps = 0
        # Never more than are simulated: what was forgotten in a longer gap could not be taken back.
        self._most_taken_back = min(max(LEAST_KEPT, round(KEPT_S / model.step_s)), MAX_GAP_SAMPLES)
        # Two more: the sample before a gap, and the one after it.
        self._history: deque[tuple[Packed | None, Sample]] = deque(maxlen=self._most_taken_back + 2)
        self._unused_s: deque[float] = deque(maxlen=2 * AGREEING)
        self._heard_s: deque[float] = deque(maxlen=AGREEING)  # latest stamps, used or not
        self._measured = False
        self._line = ""
        self._unlearned: list[Sample] = []
        self._doubted: list[Sample] = []  # the same where the next sample may take them back
        self._learned: list[str] = []
        self._range_check = RangeCheck(model)
        # Compiles both, which the first sample should not wait for.
        state, _ = self._stepped.step(self._init_state(0.0), np.zeros(len(DIRECTIONS)), math.nan)
        self._mode = model.switching(state).mode

    def process(self, line: str) -> Output:
        """Advance the model by one line of JSON and return its output."""
        self.learn()
        self._line = line
        sample, flags = _parse(line)
        if sample is None and KEPT_S < self._next_sample_s - self._latest_s < math.inf:
            # However many lines are no samples, they don't drive the clock away from that of the samples.
            return self._output(flags)
        sample = sample or {}
        stamp, before_s = sample.get(TIME, math.nan), self._latest_s
        stamped = math.isfinite(stamp)
        time_s = stamp if stamped else self._next_sample_s
        if self._origin_s is None or (stamped and before_s == -math.inf):
            self._set_clock(time_s)
        offset = (time_s - self._next_sample_s) / self._model.step_s
        offset = round(min(max(offset, -1e15), 1e15))  # limited, so that infinities can be rounded
        usual_s = self._usual_s(stamp)
        doubtful = stamped and self._is_doubtful(stamp, offset, usual_s)
        if doubtful and not self._is_agreed(stamp):
            doubt = "out of order" if stamp <= before_s else "doubtful"
            return self._output([*flags, f"{doubt}: {stamp:.12g} s follows {before_s:.12g} s"])
        skipped, replaced = [], {}
        if offset > 0:
            if stamp - before_s > usual_s:  # a stream slower than the model leaves steps out by its nature
                flags.append(f"late: {offset} samples are missing before {time_s:.12g} s")
            skipped = self._fill_gap(offset, sample)
        elif offset < 0 and (doubtful or -offset > len(self._history)):
            flags.append(f"the clock was set back from {self._next_sample_s:.12g} s to {stamp:.12g} s")
            self._follow_clock(-offset, sample)
        elif offset < 0:
            if stamp < before_s:
                flags.append(f"out of order: {stamp:.12g} s follows {before_s:.12g} s, which is left out")
                self._doubted.clear()
            replaced = self._undo_steps(-offset)
        if TIME in replaced:  # not where the step was one of a gap
            flags.append(
                f"early: the samples at {replaced[TIME]:.12g} s and {time_s:.12g} s are in the same "
                f"sampling step; the sample at {time_s:.12g} s is used"
            )
        merged = {**replaced, **sample}  # what the later sample lacks, the one in its place had
        self._step(merged)
        self._unlearned += self._doubted
        self._doubted = [*skipped, merged] if not replaced else []
        if stamped:
            self._latest_s = stamp
            self._unused_s.clear()
        if offset <= 0 or doubtful:  # a gap before it is what the next sample may take back
            self._settle()
        flags += self._learned
        self._learned = []
        if self._state is not None:
            flags += self._input_flags(self._state, merged)
        return self._output(flags)

    def learn(self) -> None:
        """Learn from the latest sample; what changes by it takes effect, and is a flag, with the next one."""
        unlearned, self._unlearned = self._unlearned, []
        if self._adaptation is None:
            return
        for sample in unlearned:
            commands = np.array([[sample.get(COMMAND[direction], math.nan) for direction in DIRECTIONS]])
            events = self._adaptation.feed(commands, np.array([sample.get(DISPLACEMENT, math.nan)]))
            numbers = self._adaptation.numbers
            if numbers is not self._numbers:  # the same object where nothing changed: no comparison a sample
                self._numbers = numbers
                if self._state is not None:
                    self._state = self._with_numbers(self._state)
            self._learned += [event.sentence for event in events if event.kind in REPORTED]

    def rehearse(self) -> None:
        """Compute the latest sample once more, without effect.

        To be called shortly before the next sample comes: a processor that did something else since the last
        one then has the program and its data in its caches again.
        """
        _parse(self._line)
        if self._state is not None and self._history:
            _, sample = self._history[-1]
            self._predict(self._state, sample)
            self._input_flags(self._state, sample)

    @property
    def _next_sample_s(self) -> float:
        """Time of the next sample on the model's clock, s."""
        return (self._origin_s or 0.0) + self._steps * self._model.step_s

    def _set_clock(self, time_s: float) -> None:
        """Set the model's clock."""
        self._origin_s, self._steps, self._latest_s = time_s, 0, -math.inf
        self._history.clear()

    def _usual_s(self, stamp: float) -> float:
        """Take in a time stamp; return how long after another one it is on time, s; 0 where not known."""
        if math.isfinite(stamp):
            self._heard_s.append(stamp)
        intervals_s = [later - earlier for earlier, later in pairwise(sorted(set(self._heard_s)))]
        return USUAL * min(intervals_s) if len(intervals_s) > 1 else 0.0

    def _is_doubtful(self, stamp: float, offset: int, usual_s: float) -> bool:
        """Return whether a time stamp alone is not believed: from the past, or far ahead.

        In a stream that is as slow, far ahead is usual.
        """
        if offset >= 0:
            since_s = stamp - max((own for own in self._heard_s if own < stamp), default=-math.inf)
            return offset > self._most_taken_back and not KEPT_S < since_s <= usual_s
        return stamp <= self._settled_s or stamp == self._latest_s

    def _is_agreed(self, stamp: float) -> bool:
        """Return whether the clock of a doubtful sample is that of the latest unused ones.

        Samples that are a little late make no other clock: those after them are on time within a second.
        """
        if abs(stamp - self._latest_s) <= KEPT_S:
            return False
        longest_s = MAX_GAP_SAMPLES * self._model.step_s
        agreeing = sum(0 < stamp - unused_s <= longest_s for unused_s in self._unused_s)
        self._unused_s.append(stamp)
        # A clock that a single sample has set is worth no more than that of another one.
        return agreeing >= (AGREEING - 1 if self._steps > 1 else 1)

    def _settle(self) -> None:
        """Let the latest sample count whatever the next one is."""
        self._settled_s = self._latest_s
        self._unlearned += self._doubted
        self._doubted = []

    def _follow_clock(self, samples: int, sample: Sample) -> None:
        """Set the clock to that of a sample; after a long time nothing but that sample is known."""
        alone = self._steps <= 1 and not math.isfinite(sample.get(DISPLACEMENT, math.nan))
        self._set_clock(sample[TIME])
        if samples > MAX_GAP_SAMPLES and not alone:
            self._state = self._displacement = None

    def _fill_gap(self, samples: int, sample: Sample) -> list[Sample]:
        """Simulate over missing samples, and return them; restart after more than `MAX_GAP_SAMPLES`."""
        if samples > MAX_GAP_SAMPLES:
            self._follow_clock(samples, sample)
            return []
        missing: list[Sample] = [{} for _ in range(samples)]
        for empty in missing:
            self._step(empty)
        return missing

    def _undo_steps(self, samples: int) -> Sample:
        """Undo the latest steps; return the sample of the first of them."""
        sample: Sample = {}
        for _ in range(min(samples, len(self._history))):
            self._state, sample = self._history.pop()
        self._steps -= samples
        if self._state is not None:  # one of before a promotion has the numbers of then
            self._state = self._with_numbers(self._state)
        return sample

    def _step(self, sample: Sample) -> None:
        measured = sample.get(DISPLACEMENT, math.nan)
        self._history.append((self._state, sample))  # the state before it, to which a step is taken back
        self._steps += 1
        if self._state is None and math.isfinite(measured):
            self._state = self._init_state(measured)
        if self._state is not None:
            self._state, self._displacement = self._predict(self._state, sample)
            self._measured |= math.isfinite(measured)

    def _init_state(self, displacement: float) -> Packed:
        return self._with_numbers(self._model.init_state(displacement, self._load))

    def _with_numbers(self, state: Packed) -> Packed:
        """Return a state with the numbers in use: it has those of the models at its load."""
        if isinstance(self._stepped, AdjustableHitch):
            return self._stepped.adjust(self._numbers, state)
        return state

    def _predict(self, state: Packed, sample: Sample) -> tuple[Packed, float]:
        """Return state and displacement one sampling time after a sample."""
        commands = np.array([sample.get(COMMAND[direction], math.nan) for direction in DIRECTIONS])
        state, displacement = self._stepped.step(state, commands, sample.get(DISPLACEMENT, math.nan))
        return state, float(displacement)

    def _input_flags(self, state: Packed, sample: Sample) -> list[str]:
        roles = [COMMAND[direction] for direction in self._model.channels]
        missing = [role for role in roles if not math.isfinite(sample.get(role, math.nan))]
        flags = [f"{role} is missing: the last value is held" for role in missing]
        if self._measured and not math.isfinite(sample.get(DISPLACEMENT, math.nan)):
            flags.append("no displacement was measured: the model simulates")
        self._mode, both_valves_active = self._model.switching(state)
        if both_valves_active:
            flags.append("both commands are active: the lowering command is used")
        return flags + self._range_check.flags(sample, self._mode)

    def _output(self, flags: list[str]) -> Output:
        time_s = round(self._next_sample_s, DIGITS)
        if self._state is None:
            return Output(time_s, None, STANDING, (*flags, "waiting for an initial displacement"))
        direction = STANDING if self._mode < 0 else tuple(self._model.channels)[self._mode]
        return Output(time_s, self._displacement, direction, tuple(flags))


def _parse(line: str) -> tuple[dict[str, float] | None, list[str]]:
    """Return the numbers of one line, None where it is no sample, and flags for what cannot be used."""
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        return None, ["not understood: the line is not JSON"]
    if not isinstance(content, dict):
        return None, ['not understood: expected an object like {"time_s": 0.01, "lifting_command": 0.5}']
    # Names of a stream may be of any length and number: a flag stays a line.
    unknown = ", ".join(f"'{name:.{MAX_SHOWN}}'" for name in content if name not in FIELDS)
    flags = [f"not known: {unknown:.{MAX_SHOWN}}; expected one of {', '.join(FIELDS)}"] if unknown else []
    sample = {}
    for name in FIELDS:
        value = content.get(name)
        if isinstance(value, int | float) and not isinstance(value, bool):
            try:
                number = float(value)
            except OverflowError:  # JSON has integers of any length
                number = math.inf
            sample[name] = number if name == TIME or abs(number) < MAX_MAGNITUDE else math.nan
        elif value is not None:
            flags.append(f"not a number: {name}")
    return sample, flags
