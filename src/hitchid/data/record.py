"""Record: signals of one test on a uniform clock, with units and source."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from hitchid._support import checks
from hitchid._support.notices import Notice
from hitchid.data.resampling import GRID_TOLERANCE, REGULAR_CLOCK, ClockQuality
from hitchid.data.units import UNITS, check_unit, conversion_factor
from hitchid.errors import InputError

DISPLACEMENT = "displacement"
LIFTING = "lifting"
LOWERING = "lowering"
DIRECTIONS = (LIFTING, LOWERING)
COMMAND = MappingProxyType({LIFTING: "lifting_command", LOWERING: "lowering_command"})

RAMP = "ramp"
CYCLE = "cycle"
IDLE = "idle"
FINGERPRINT_STEP = 1e-6  # of the range; above the rounding error of a unit conversion (chosen)
KINDS = (LIFTING, LOWERING, RAMP, CYCLE, IDLE)


@dataclass(frozen=True)
class Record:
    """One test on a uniform clock.

    Attributes:
        name: the log's file name without its endings.
        step_s: sampling time, s.
        signals: role to samples, each of shape [N]: `displacement`, `lifting_command`, `lowering_command`,
            and covariates under their own names. A plant with one channel has one command.
        units: role to unit.
        kind: `lifting`, `lowering`, `ramp`, `cycle` or `idle`.
        start_s: time of the first sample on the log's clock, s.
        source: the file it was read from.
        notices: changes made to the log in reading.
        clock: regularity of the log's clock.
    """

    name: str
    step_s: float
    signals: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    kind: str = IDLE
    start_s: float = 0.0
    source: Path | None = None
    notices: tuple[Notice, ...] = ()
    clock: ClockQuality = REGULAR_CLOCK

    def __post_init__(self) -> None:
        """Check types, shapes, units and finiteness, and freeze the samples."""
        checks.instance(self.name, str, "record: name", "text")
        checks.instance(self.signals, Mapping, f"record '{self.name}': signals", "role to samples")
        checks.instance(self.units, Mapping, f"record '{self.name}': units", "role to unit")
        checks.number(self.start_s, f"record '{self.name}': start_s")
        checks.one_of(self.kind, KINDS, f"record '{self.name}': kind")
        if DISPLACEMENT not in self.signals:
            raise InputError(
                f"record '{self.name}': a displacement signal is required, got {sorted(self.signals)}"
            )
        if not any(role in self.signals for role in COMMAND.values()):
            raise InputError(f"record '{self.name}': at least one command signal is required, got none")
        if not checks.number(self.step_s, f"record '{self.name}': the sampling time") > 0:
            raise InputError(f"record '{self.name}': the sampling time must be positive, got {self.step_s} s")
        frozen = {}
        for role, samples in self.signals.items():
            array = _read_only(samples, f"record '{self.name}': '{role}'")
            if role not in self.units:
                raise InputError(
                    f"record '{self.name}': '{role}' has no unit; expected one of {', '.join(UNITS)}"
                )
            check_unit(self.units[role], f"record '{self.name}': '{role}'")
            expected_shape = np.shape(self.signals[DISPLACEMENT])[:1] or (1,)
            if array.shape != expected_shape:
                raise InputError(
                    f"record '{self.name}': '{role}' has shape {array.shape}, expected {expected_shape}"
                )
            if not np.all(np.isfinite(array)):
                row = int(np.flatnonzero(~np.isfinite(array))[0])
                raise InputError(f"record '{self.name}': '{role}' is {array[row]} at sample {row}")
            frozen[role] = array
        object.__setattr__(self, "signals", MappingProxyType(frozen))
        object.__setattr__(self, "units", MappingProxyType(dict(self.units)))

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.signals[DISPLACEMENT])

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

    def require(self, covariate: str | None) -> "Record":
        """Return the record itself if it has the covariate, or if none is required.

        Raises:
            InputError: it lacks the covariate.
        """
        if covariate is not None and covariate not in self.signals:
            raise InputError(f"record '{self.name}' has no '{covariate}'; the model requires this covariate")
        return self

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the shape of the displacement, which identifies a test.

        The samples relative to the first, divided by their range and rounded to 10⁻⁶, and the range in SI
        units are hashed: the fingerprint does not depend on file name, unit and mapping of commands.
        """
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
        count = int(np.floor((len(self) - 1) * self.step_s / step_s * (1 + 1e-12))) + 1
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

    def convert(self, units: Mapping[str, str]) -> "Record":
        """Return the record in other units of the same dimensions.

        Raises:
            InputError: a unit is unknown or of another dimension.
        """
        checks.instance(units, Mapping, "units", "role to unit")
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


def _read_only(samples: np.ndarray, name: str) -> np.ndarray:
    """Return read-only samples: without a copy if they are read-only already."""
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
        old_times_s: time of the samples, s, shape [N], increasing.
        new_times_s: time of the new samples, s, shape [M].

    Returns:
        Role to samples, each of shape [M].
    """
    rows = held_rows(old_times_s, new_times_s)
    return {
        role: samples[rows] if role in COMMAND.values() else np.interp(new_times_s, old_times_s, samples)
        for role, samples in signals.items()
    }


def held_rows(old_times_s: np.ndarray, new_times_s: np.ndarray) -> np.ndarray:
    """Return the row whose value is held at each new time, with a tolerance of 2 % of a step, shape [M]."""
    slack = GRID_TOLERANCE * float(np.median(np.diff(old_times_s))) if old_times_s.size > 1 else 0.0
    return np.maximum(np.searchsorted(old_times_s, new_times_s + slack, side="right") - 1, 0)
