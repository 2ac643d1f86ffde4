"""Records of one campaign: one set of units, one clock, the kind of each; those that do not fit left out."""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from statistics import median_low
from typing import NoReturn, TypeVar

import numpy as np

from hitchid._support import checks
from hitchid._support.records import Notice, Severity, Value
from hitchid.errors import InputError, LogError, SettingsError
from hitchid.logs.kinds import detect_kind, full_scales
from hitchid.logs.record import COMMAND, CYCLE, DIRECTIONS, DISPLACEMENT, IDLE, KINDS, Record
from hitchid.logs.units import UNITS

# Tests that cannot be used: left out with the reason; in strict mode an error.

Item = TypeVar("Item")
Result = TypeVar("Result")
MAX_SHOWN = 10  # causes named in one error message (chosen)


@dataclass(frozen=True, eq=False)
class LeftOut(Value):
    """A log or test that is not used.

    Attributes:
        name: of the log or test.
        error: the reason, as an exception.
    """

    name: str
    error: InputError

    @property
    def reason(self) -> str:
        """The reason, without the name."""
        return self.error.reason if isinstance(self.error, LogError) else str(self.error)

    def describe(self) -> dict[str, str]:
        """Return name and reason for JSON output."""
        return {"name": self.name, "reason": self.reason}


def split_usable(
    items: Iterable[tuple[str, Item]], work: Callable[[Item], Result], *, strict: bool
) -> tuple[list[Result], list[LeftOut]]:
    """Return the results of usable items by name, and those for which `work` raises `InputError`.

    Raises:
        SettingsError: a settings file is wrong.
        InputError: with `strict`, an item cannot be used.
    """
    usable, left_out = [], []
    for name, item in items:
        try:
            usable.append(work(item))
        # It concerns all items: to leave each of them out would hide the one cause.
        except SettingsError:
            raise
        except InputError as error:
            if strict:
                raise
            # Without the traceback, whose frames would keep the arrays of the log alive.
            left_out.append(LeftOut(name, error.with_traceback(None)))
    return usable, left_out


def left_out_notices(left_out: Sequence[LeftOut], total: int, what: str) -> tuple[Notice, ...]:
    """Return a notice for each reason with the names concerned, and one with the count of all `what`."""
    if not left_out:
        return ()
    names: dict[str, list[str]] = {}
    for item in left_out:
        names.setdefault(item.reason, []).append(item.name)
    notices = [
        Notice("left-out", f"left out: {reason}", ", ".join(affected), Severity.WARNING)
        for reason, affected in names.items()
    ]
    count = f"{len(left_out)} of {total} {what} left out"
    return (*notices, Notice("left-out-count", count, severity=Severity.WARNING))


def refuse(left_out: Sequence[LeftOut], what: str) -> NoReturn:
    """Raise an error if no item can be used: the common cause, else all causes.

    Raises:
        InputError: always; the first item's own error where all have the same.
    """
    if len({item.reason for item in left_out}) == 1:
        raise left_out[0].error
    causes = [f"{item.name}: {item.reason}" for item in left_out[:MAX_SHOWN]]
    more = [f"and {len(left_out) - MAX_SHOWN} more"] if len(left_out) > MAX_SHOWN else []
    raise InputError(f"none of the {len(left_out)} {what} can be used: {'; '.join([*causes, *more])}")


MAX_RATE_RATIO = 100  # of sampling times in one campaign; above it, a unit of time is wrong (chosen)


def unified(
    records: Sequence[Record], kinds: Mapping[str, str], *, strict: bool
) -> tuple[list[Record], list[LeftOut]]:
    """Return the usable records in the order of their names, and those left out; see `Campaign.of`."""

    def split(
        candidates: Iterable[Record], work: Callable[[Record], Record]
    ) -> tuple[list[Record], list[LeftOut]]:
        return split_usable(((record.name, record) for record in candidates), work, strict=strict)

    def natural_order(record: Record) -> list[tuple[int, str]]:  # test-2 before test-10
        parts = re.split(r"(\d+)", record.name)
        return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]

    ordered = sorted(records, key=natural_order)
    # The commands and units of most records: the first one may be the odd one out.
    counts = Counter(map(_dimensions, ordered))
    reference = max(ordered, key=lambda record: counts[_dimensions(record)])
    usable, mismatched = split(ordered, lambda record: _to_reference_units(record, reference))
    # The lower median of the sampling times, which is one of them.
    step_s = float(f"{median_low(record.step_s for record in usable):.4g}")
    on_clock, off_clock = split(usable, lambda record: _to_common_clock(record, step_s))
    # Kinds come last: 5 % of full scale is a share of the largest command of all that is left.
    scales = full_scales(on_clock)
    classified = [replace(record, kind=_kind(record, scales, kinds)) for record in on_clock]
    moving, stationary = split(classified, _require_motion)
    excluded = [*mismatched, *off_clock, *stationary]
    if not moving:
        refuse(excluded, "tests")
    # A direction without any test left would be missing in the model, silently.
    causes = {item.name: item for item in excluded}
    for direction in DIRECTIONS:
        unusable = [
            causes[record.name]
            for record in ordered
            if record.name in causes and detect_kind(record, full_scales([record])) == direction
        ]
        if unusable and not any(record.kind in (direction, CYCLE) for record in moving):
            refuse(unusable, f"{direction} tests")
    return moving, excluded


def _dimensions(record: Record) -> tuple[tuple[str, str], ...]:
    """Return displacement and commands with the dimensions of their units."""
    roles = [role for role in (DISPLACEMENT, *COMMAND.values()) if role in record.signals]
    units = [record.units.get(role, "") for role in roles]
    return tuple((r, UNITS[u].dimension if u in UNITS else u) for r, u in zip(roles, units, strict=True))


def _to_reference_units(record: Record, reference: Record) -> Record:
    """Return a record in the units of another."""
    if record.directions != reference.directions:
        raise InputError(
            f"record '{record.name}' has commands for {' and '.join(record.directions)}, "
            f"'{reference.name}' for {' and '.join(reference.directions)}; "
            "all records of a campaign must have the same commands"
        )
    # No copy of all samples where nothing has to be converted.
    return record if record.units == reference.units else record.convert(reference.units)


def _require_motion(record: Record) -> Record:
    """Return a record unless its displacement is constant although it is commanded to move."""
    if record.kind != IDLE and np.ptp(record.displacement) == 0:
        problem = (
            f"the displacement is constant ({record.displacement[0]:g} {record.unit}) over all {len(record)} "
            "samples although the command changes; check whether the sensor is connected"
        )
        raise LogError(record.source or record.name, problem)
    return record


def _to_common_clock(record: Record, step_s: float) -> Record:
    """Return a record at the common sampling time: resampled, unless the drift is below 5 % of it."""
    drift = abs(record.step_s - step_s) * len(record)
    if not 1 / MAX_RATE_RATIO <= record.step_s / step_s <= MAX_RATE_RATIO:
        problem = (
            f"has a sampling time of {record.step_s:.4g} s, the median of the logs is {step_s:.4g} s; "
            f"expected at most {MAX_RATE_RATIO} times longer or shorter than the median"
        )
        raise LogError(record.source or record.name, problem)
    # Rounded stamps make steps differ slightly: to resample for that would smooth the log for nothing.
    return replace(record, step_s=step_s) if drift <= 0.05 * step_s else record.resample(step_s)


def _kind(record: Record, scales: Mapping[str, float], kinds: Mapping[str, str]) -> str:
    for pattern, kind in kinds.items():
        checks.instance(pattern, str, "kinds: pattern", "text")
        if fnmatchcase(record.name, pattern):
            if kind not in KINDS:
                raise InputError(f"tests: '{kind}' is not a kind of test; expected one of {', '.join(KINDS)}")
            return kind
    return detect_kind(record, scales)
