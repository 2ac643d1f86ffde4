"""Record: signals of one test on a uniform clock, with units and source."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from hitchid._support import checks
from hitchid._support.records import Notice, Value
from hitchid._support.tables import Summarised, Table
from hitchid.errors import InputError
from hitchid.logs.resampling import GRID_TOLERANCE, REGULAR_CLOCK, ClockQuality
from hitchid.logs.units import UNITS, check_unit, conversion_factor

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes

DISPLACEMENT = "displacement"
LIFTING = "lifting"
LOWERING = "lowering"
DIRECTIONS = (LIFTING, LOWERING)
COMMAND = MappingProxyType({LIFTING: "lifting_command", LOWERING: "lowering_command"})
SIGNED_COMMAND = "command"  # role of one command for both directions
HOLD_ROLES = (SIGNED_COMMAND, *COMMAND.values())  # hold their last value between samples

RAMP = "ramp"
CYCLE = "cycle"
IDLE = "idle"
MAX_SAMPLES = 1e8  # of a resampled record, a day at 1 kHz; more are a wrong unit of time (chosen)
FINGERPRINT_STEP = 1e-6  # of the range; above the rounding error of a unit conversion (chosen)
KINDS = (LIFTING, LOWERING, RAMP, CYCLE, IDLE)


@dataclass(frozen=True, eq=False, repr=False)
class Record(Value, Summarised):
    """One test on a uniform clock.

    Two records are equal if everything but their source is.

    Attributes:
        name: the log's file name without its endings.
        step_s: sampling time, s.
        signals: role to samples, each of shape [N]: `displacement`, `lifting_command`, `lowering_command`,
            and covariates under their own names. A plant with one channel has one command.
        units: role to unit.
        kind: `lifting`, `lowering`, `ramp`, `cycle` or `idle`.
        start_s: time of the first sample on the log's clock, s.
        source: the file it was read from; None for a table in memory.
        notices: changes made to the log in reading.
        clock: regularity of the log's clock.
    """

    name: str
    step_s: float
    signals: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    kind: str = IDLE
    start_s: float = 0.0
    source: Path | None = field(default=None, compare=False)
    notices: tuple[Notice, ...] = ()
    clock: ClockQuality = REGULAR_CLOCK

    def __post_init__(self) -> None:
        """Check types, shapes, units and finiteness, and freeze the samples."""
        checks.instance(self.name, str, "record: name", "text")
        checks.instance(self.signals, Mapping, f"record '{self.name}': signals", "role to samples")
        checks.instance(self.units, Mapping, f"record '{self.name}': units", "role to unit")
        checks.number(self.start_s, f"record '{self.name}': start_s")
        checks.one_of(self.kind, KINDS, f"record '{self.name}': kind")
        # Checked here once, so that no later step has to ask what a record holds.
        if DISPLACEMENT not in self.signals:
            raise InputError(
                f"record '{self.name}': a displacement signal is required, got {sorted(self.signals)}"
            )
        if not any(role in self.signals for role in COMMAND.values()):
            raise InputError(f"record '{self.name}': at least one command signal is required, got none")
        if not checks.number(self.step_s, f"record '{self.name}': the sampling time") > 0:
            raise InputError(f"record '{self.name}': the sampling time must be positive, got {self.step_s} s")
        shape = np.shape(self.signals[DISPLACEMENT])[:1] or (1,)
        frozen = {}
        for role, samples in self.signals.items():
            where = f"record '{self.name}': '{role}'"
            frozen[role] = array = _read_only(samples, where)
            if role not in self.units:
                raise InputError(f"{where} has no unit; expected one of {', '.join(UNITS)}")
            check_unit(self.units[role], where)
            if array.shape != shape:
                raise InputError(f"{where} has shape {array.shape}, expected {shape}")
            if not np.all(np.isfinite(array)):
                row = int(np.flatnonzero(~np.isfinite(array))[0])
                raise InputError(f"{where} is {array[row]} at sample {row}")
        object.__setattr__(self, "signals", MappingProxyType(frozen))
        object.__setattr__(self, "units", MappingProxyType(dict(self.units)))

    @classmethod
    def from_dataframe(
        cls,
        frame: Any,
        *,
        name: str = "test",
        signals: Mapping[str, object] | None = None,
        units: Mapping[str, str] | None = None,
        kind: str | None = None,
    ) -> "Record":
        """Return the record of a table, prepared as a log file is: clock, units, signed commands, notices.

        Args:
            frame: of pandas or polars, one column a signal. The time is a column or, in pandas, the index:
                numbers, dates or durations; of dates, seconds since the first.
            name: of the record.
            signals: signal to column as `[signals]` in `campaign.toml`; by default columns named after their
                signal and unit as `to_dataframe` writes them, or `current_up_A` and `current_down_A`.
            units: column to unit, where the column's name does not end in it.
            kind: of the test; by default detected from its commands.

        Raises:
            InputError: an argument or the table cannot be used, or a long gap divides it.
        """
        from hitchid.logs.dataframes import record_from_dataframe

        return record_from_dataframe(frame, name=name, signals=signals, units=units, kind=kind)

    def to_dataframe(self) -> "pandas.DataFrame":
        """Return a table of `time_s` and every signal, each column named after its signal and unit.

        Raises:
            InputError: pandas is not installed.
        """
        from hitchid.logs.dataframes import to_dataframe

        return to_dataframe(self)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.signals[DISPLACEMENT])

    def __getitem__(self, signal: str) -> np.ndarray:
        """Return a signal by its name, such as `displacement` or `lifting_command`, shape [N].

        Raises:
            InputError: the record has no such signal.
        """
        return self.signals[checks.one_of(signal, self.signals, f"record '{self.name}': signal")]

    def __contains__(self, signal: object) -> bool:
        """Return whether the record has a signal of this name."""
        return signal in self.signals

    # Without this Python would iterate by number, and fail at 0 with a confusing message.
    __iter__ = None  # a record is neither a sequence of samples nor of signals

    @property
    def time_s(self) -> np.ndarray:
        """Time of each sample in the log, s, shape [N]."""
        return self.start_s + self.step_s * np.arange(len(self))

    @property
    def displacement(self) -> np.ndarray:
        """Measured displacement, in `units["displacement"]`, shape [N]."""
        return self.signals[DISPLACEMENT]

    @property
    def unit(self) -> str:
        """Unit of the displacement, of errors and of predictions."""
        return self.units[DISPLACEMENT]

    @property
    def directions(self) -> tuple[str, ...]:
        """Directions this record has a command for."""
        return tuple(direction for direction in DIRECTIONS if COMMAND[direction] in self.signals)

    def command(self, direction: str) -> np.ndarray:
        """Return the command of a direction, shape [N].

        Raises:
            InputError: the record has no such command.
        """
        role = COMMAND[checks.one_of(direction, DIRECTIONS, "direction")]
        if role not in self.signals:
            raise InputError(
                f"record '{self.name}': there is no {direction} command; signals: {', '.join(self.signals)}"
            )
        return self.signals[role]

    def require(self, covariates: Sequence[str]) -> "Record":
        """Return the record itself if it has the covariates.

        Raises:
            InputError: it lacks one of them.
        """
        for name in covariates:
            if name not in self.signals:
                raise InputError(f"record '{self.name}' has no '{name}'; the model requires this covariate")
        return self

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the shape of the displacement, which identifies a test.

        The samples relative to the first, divided by their range and rounded to 10⁻⁶, and the range in SI
        units are hashed: the fingerprint does not depend on file name, unit and mapping of commands.
        """
        # The start is left out: the same log with another zero of its sensor is the same test.
        relative = self.displacement - self.displacement[0]
        peak_to_peak = float(np.ptp(relative))
        shape = relative / (peak_to_peak or 1.0)
        # The irrational offset moves round decimals away from the limits of rounding.
        steps = np.round(shape / FINGERPRINT_STEP + 1 / np.pi).astype(np.int64)
        size = f"{peak_to_peak * UNITS[self.unit].factor:.6e}"
        return hashlib.sha256(size.encode() + steps.tobytes()).hexdigest()

    def slice(self, start: int, stop: int, *, name: str | None = None, kind: str | None = None) -> "Record":
        """Return samples `start:stop` as a new record."""
        return replace(
            self,
            name=self.name if name is None else name,
            kind=self.kind if kind is None else kind,
            signals={role: samples[start:stop] for role, samples in self.signals.items()},
            start_s=self.start_s + start * self.step_s,
        )

    def resample(self, step_s: float) -> "Record":
        """Return the record at sampling time `step_s`; raises `InputError` unless it is above 0."""
        checks.number(step_s, "step_s", above=0.0)
        # Before anything is allocated: a step in the wrong unit asks for more samples than the memory holds.
        samples = np.floor((len(self) - 1) * self.step_s / step_s * (1 + 1e-12)) + 1
        if not samples <= MAX_SAMPLES:
            raise InputError(
                f"step_s: expected a sampling time that gives at most {MAX_SAMPLES:g} samples of "
                f"{len(self) * self.step_s:g} s, got {step_s:g} s"
            )
        count = int(samples)
        new_times_s = step_s * np.arange(count)
        old_times_s = self.step_s * np.arange(len(self))
        sentence = f"resampled from {self.step_s:.4g} s to {step_s:.4g} s"
        return replace(
            self,
            step_s=step_s,
            signals=resampled(self.signals, old_times_s, new_times_s),
            notices=(*self.notices, Notice("step-changed", sentence)),
            clock=replace(self.clock, logged_step_s=self.clock.logged_step_s or self.step_s),
        )

    def trim(self, start_s: float | None = None, stop_s: float | None = None) -> "Record":
        """Return the samples from one time to another, both included; a notice says so.

        Args:
            start_s, stop_s: on the record's clock as in `time_s`, s; None for its first and last sample.

        Raises:
            InputError: fewer than two samples are left.
        """
        from hitchid.logs.preparation import trim

        return trim(self, start_s, stop_s)

    def detrend(self, *signals: str) -> "Record":
        """Return the record without the linear trend of measured signals, y − b (t − t̄); a notice says so.

        b is the slope of the least-squares line, t̄ the mean time: the mean of the signal stays. A hitch
        integrates its command, so a trend of the displacement is motion unless the sensor drifts.

        Args:
            signals: measured signals; by default the displacement.

        Raises:
            InputError: a signal is missing or a command.
        """
        from hitchid.logs.preparation import detrend

        return detrend(self, signals or (DISPLACEMENT,))

    def low_pass(self, cutoff_hz: float, *signals: str) -> "Record":
        """Return the record with measured signals low-pass filtered, for display; a notice says so.

        A Butterworth filter of order 2, run forwards and backwards: no phase shift, but each sample depends
        on later ones, so that a model identified from it would be told the future.

        Args:
            cutoff_hz: frequency at which the amplitude is halved, Hz; below half the sampling rate.
            signals: measured signals; by default all.

        Raises:
            InputError: the frequency cannot be used, or a signal is missing or a command.
        """
        from hitchid.logs.preparation import low_pass

        return low_pass(self, cutoff_hz, signals)

    def decimate(self, factor: int) -> "Record":
        """Return every `factor`-th sample; a notice says so.

        Measured signals are low-pass filtered before, commands keep the value they hold at that sample.

        Args:
            factor: of the sampling time, at least 2.

        Raises:
            InputError: the factor is no such number, or fewer than two samples are left.
        """
        from hitchid.logs.preparation import decimate

        return decimate(self, factor)

    def convert(self, units: Mapping[str, str]) -> "Record":
        """Return the record in other units of the same dimensions.

        Raises:
            InputError: a unit is unknown or of another dimension.
        """
        checks.instance(units, Mapping, "units", "role to unit")
        # Units of signals that this record lacks are for others of its campaign.
        factors = {
            role: conversion_factor(self.units[role], unit, f"record '{self.name}', {role}")
            for role, unit in units.items()
            if role in self.signals
        }
        return replace(
            self,
            signals={role: samples * factors.get(role, 1.0) for role, samples in self.signals.items()},
            units={**self.units, **{role: units[role] for role in factors}},
        )

    def plot(self, axes: "Sequence[Axes] | np.ndarray | None" = None) -> np.ndarray:
        """Draw displacement above and commands below, over the time of the log.

        Args:
            axes: two matplotlib axes to draw into; None for a new figure of pyplot.

        Returns:
            The two axes.

        Raises:
            InputError: other than two axes are given.
        """
        from hitchid.logs.plotting import plot_record

        return plot_record(self, axes)

    def _summary(self) -> Table:
        from hitchid.logs.summaries import record_summary

        return record_summary(self)


def _read_only(samples: np.ndarray, name: str) -> np.ndarray:
    """Return read-only samples: without a copy if they are read-only already."""
    # A slice of a record is a view: its base cannot be written through anything else either.
    base = samples if getattr(samples, "base", None) is None else samples.base
    if isinstance(base, np.ndarray) and samples.dtype == np.float64 and not base.flags.writeable:
        return samples
    try:
        array = np.array(samples, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise checks.input_error(name, "numbers", samples) from error
    array.setflags(write=False)
    return array


def resampled(
    signals: Mapping[str, np.ndarray], old_times_s: np.ndarray, new_times_s: np.ndarray
) -> dict[str, np.ndarray]:
    """Resample signals from one time base to another.

    Commands by zero-order hold, with a tolerance of 2 % of a step; measured signals by linear interpolation.

    Args:
        signals: role to samples, each of shape [N].
        old_times_s, new_times_s: s, shapes [N] and [M], increasing.
    """
    rows = held_rows(old_times_s, new_times_s)
    return {
        role: samples[rows] if role in COMMAND.values() else np.interp(new_times_s, old_times_s, samples)
        for role, samples in signals.items()
    }


def held_rows(old_times_s: np.ndarray, new_times_s: np.ndarray) -> np.ndarray:
    """Return the row whose value is held at each new time, shape [M].

    Tolerance: 2 % of a step of the finer time base, since a slow command must not come early.
    """
    steps_s = [float(np.median(np.diff(times))) for times in (old_times_s, new_times_s) if times.size > 1]
    slack = GRID_TOLERANCE * min(steps_s, default=0.0)
    return np.maximum(np.searchsorted(old_times_s, new_times_s + slack, side="right") - 1, 0)
