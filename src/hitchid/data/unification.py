"""Records of one campaign: one set of units, one clock, the kind of each; those that do not fit left out."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from statistics import median_low

import numpy as np

from hitchid._support import checks
from hitchid.data.left_out import LeftOut, refuse, split_usable
from hitchid.data.record import COMMAND, CYCLE, DIRECTIONS, DISPLACEMENT, IDLE, KINDS, Record
from hitchid.data.test_kinds import detect_kind, full_scales
from hitchid.data.units import UNITS
from hitchid.errors import InputError, LogError

MAX_RATE_RATIO = 100  # of sampling times in one campaign; above it, a unit of time is wrong (chosen)


def unified(
    records: Sequence[Record], kinds: Mapping[str, str], *, strict: bool
) -> tuple[list[Record], list[LeftOut]]:
    """Return the usable records in the order of their names, on one clock, and those that are left out.

    Args:
        records: tests, at least one.
        kinds: pattern on names to kind; overrides the detection from the commands.
        strict: whether one record that cannot be used is an error for all.

    Raises:
        InputError: as `Campaign.of`.
    """
    ordered = sorted(records, key=lambda record: _natural_sort_key(record.name))
    reference = _most_common(ordered)
    usable, mismatched = split_usable(
        _with_names(ordered), lambda record: _to_reference_units(record, reference), strict=strict
    )
    step_s = _common_step(usable)
    on_clock, off_clock = split_usable(
        _with_names(usable), lambda record: _to_common_clock(record, step_s), strict=strict
    )
    scales = full_scales(on_clock)
    classified = [replace(record, kind=_kind(record, scales, kinds)) for record in on_clock]
    moving, stationary = split_usable(_with_names(classified), _require_motion, strict=strict)
    excluded = [*mismatched, *off_clock, *stationary]
    if not moving:
        refuse(excluded, "tests")
    _check_directions(moving, excluded, ordered)
    return moving, excluded


def _with_names(records: Iterable[Record]) -> list[tuple[str, Record]]:
    return [(record.name, record) for record in records]


def _dimensions(record: Record) -> tuple[tuple[str, str], ...]:
    """Return displacement and commands with the dimensions of their units."""
    roles = [role for role in (DISPLACEMENT, *COMMAND.values()) if role in record.signals]
    units = [record.units.get(role, "") for role in roles]
    return tuple((r, UNITS[u].dimension if u in UNITS else u) for r, u in zip(roles, units, strict=True))


def _most_common(records: Sequence[Record]) -> Record:
    """Return the first record with the most common commands and dimensions."""
    counts = Counter(map(_dimensions, records))
    return max(records, key=lambda record: counts[_dimensions(record)])


def _to_reference_units(record: Record, reference: Record) -> Record:
    """Return a record in the units of another."""
    if record.directions != reference.directions:
        raise InputError(
            f"record '{record.name}' has commands for {' and '.join(record.directions)}, "
            f"'{reference.name}' for {' and '.join(reference.directions)}; "
            "all records of a campaign must have the same commands"
        )
    return record if record.units == reference.units else record.convert(reference.units)


def _require_motion(record: Record) -> Record:
    """Return a record unless its displacement is constant although it is commanded to move."""
    if record.kind != IDLE and np.ptp(record.displacement) == 0:
        raise LogError(
            record.source or record.name,
            f"the displacement is constant ({record.displacement[0]:g} {record.unit}) over all "
            f"{len(record)} samples although the command changes; "
            "check whether the sensor is connected",
        )
    return record


def _check_directions(records: Sequence[Record], left_out: Sequence[LeftOut], all_: Sequence[Record]) -> None:
    """Refuse a campaign in which all tests of one direction are left out."""
    causes = {item.name: item for item in left_out}
    for direction in DIRECTIONS:
        excluded = [
            causes[record.name]
            for record in all_
            if record.name in causes and detect_kind(record, full_scales([record])) == direction
        ]
        if excluded and not any(record.kind in (direction, CYCLE) for record in records):
            refuse(excluded, f"{direction} tests")


def _natural_sort_key(name: str) -> list[tuple[int, str]]:
    """Return a sorting key that puts test-2 before test-10."""
    return [(int(token), "") if token.isdecimal() else (-1, token) for token in re.split(r"(\d+)", name)]


def _common_step(records: Sequence[Record]) -> float:
    """Return the lower median of the sampling times, which is one of them."""
    return float(f"{median_low(record.step_s for record in records):.4g}")


def _to_common_clock(record: Record, step_s: float) -> Record:
    """Return a record at the common sampling time: resampled, unless the drift is below 5 % of it."""
    drift = abs(record.step_s - step_s) * len(record)
    if not 1 / MAX_RATE_RATIO <= record.step_s / step_s <= MAX_RATE_RATIO:
        raise LogError(
            record.source or record.name,
            (
                f"has a sampling time of {record.step_s:.4g} s, the median of the logs is "
                f"{step_s:.4g} s; expected at most {MAX_RATE_RATIO} times longer or shorter "
                "than the median"
            ),
        )
    return replace(record, step_s=step_s) if drift <= 0.05 * step_s else record.resample(step_s)


def _kind(record: Record, scales: Mapping[str, float], kinds: Mapping[str, str]) -> str:
    for pattern, kind in kinds.items():
        checks.instance(pattern, str, "kinds: pattern", "text")
        if fnmatchcase(record.name, pattern):
            if kind not in KINDS:
                raise InputError(f"tests: '{kind}' is not a kind of test; expected one of {', '.join(KINDS)}")
            return kind
    return detect_kind(record, scales)
