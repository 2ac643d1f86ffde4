"""Campaign: all tests of one plant, and which of them are held out."""

import hashlib
import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from glob import escape
from statistics import median_low
from typing import TYPE_CHECKING

import numpy as np

from hitchid._support import checks
from hitchid._support.notices import Notice, Severity
from hitchid.data.left_out import LeftOut, left_out_notices, refuse, split_usable
from hitchid.data.record import COMMAND, CYCLE, DIRECTIONS, DISPLACEMENT, IDLE, KINDS, RAMP, Record
from hitchid.data.test_kinds import detect_kind, full_scales, ramp_direction, strokes
from hitchid.data.units import UNITS
from hitchid.errors import InputError, LogError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HELD_OUT_FRACTION = 0.2  # of the tests of a direction; the default split (chosen)
STROKE_SEPARATOR = "#"
MAX_RATE_RATIO = 100  # of sampling times in one campaign; above it, a unit of time is wrong (chosen)


@dataclass(frozen=True)
class Campaign:
    """Tests of one plant on one clock and in one set of units.

    Attributes:
        records: the tests, in the order of their names.
        test_patterns: patterns on names that mark the held-out tests; without any, the last 20 % of each
            direction's tests are held out.
        unmatched: patterns of a settings file that match no test here; an error only in an identification.
        left_out: logs and tests that cannot be used, with their reasons.
        strict: whether one test that cannot be used is an error in later steps too.
    """

    records: tuple[Record, ...]
    test_patterns: tuple[str, ...] | None = None
    unmatched: tuple[str, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    strict: bool = False

    @classmethod
    def of(
        cls,
        records: Sequence[Record],
        *,
        test_patterns: Sequence[str] | None = None,
        kinds: Mapping[str, str] | None = None,
        left_out: Sequence[LeftOut] = (),
        strict: bool = False,
    ) -> "Campaign":
        """Return records on one clock and in one set of units, and detect the kind of each.

        A record is left out if its commands or dimensions differ from those of most records, if its sampling
        time differs by a factor above 100, or if its displacement is constant although its command is not.

        Args:
            records: tests, in any order.
            test_patterns: patterns on names that mark the held-out tests.
            kinds: pattern on names to kind; overrides the detection from the commands.
            left_out: logs that could not be read.
            strict: whether one record that cannot be used is an error for all.

        Raises:
            InputError: no records, an empty record, equal names, a pattern that matches no test, an unknown
                kind, or every test of a direction is left out; with `strict`, any test is left out.
        """
        records = checks.tuple_of(records, Record, "records", "records, each a hitchid.Record")
        if test_patterns is not None:
            test_patterns = checks.tuple_of(test_patterns, str, "test_patterns", "patterns on names")
        checks.instance(kinds or {}, Mapping, "kinds", "pattern on names to kind")
        if not records:
            raise InputError("a campaign needs at least one record, got none")
        if empty := [record.name for record in records if not len(record)]:
            raise InputError(f"record '{empty[0]}' holds no samples; expected at least one")
        names = [record.name for record in records]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two records are called '{name}'; names must differ")
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
        classified = [replace(record, kind=_kind(record, scales, kinds or {})) for record in on_clock]
        moving, stationary = split_usable(_with_names(classified), _require_motion, strict=strict)
        excluded = [*mismatched, *off_clock, *stationary]
        if not moving:
            refuse(excluded, "tests")
        _check_directions(moving, excluded, ordered)
        all_left_out = (*left_out, *excluded)
        for pattern in test_patterns or ():
            if not any(fnmatchcase(name, pattern) for name in (*names, *(item.name for item in left_out))):
                raise InputError(
                    f"split.test: the pattern '{pattern}' matches none of the {len(names)} tests"
                )
        patterns = None if test_patterns is None else tuple(test_patterns)
        return cls(tuple(moving), patterns, left_out=all_left_out, strict=strict)

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Logs left out with the reason, their number, and a warning without any held-out test left."""
        notices = left_out_notices(self.left_out, len(self.left_out) + len(self.records), "logs")
        patterns = self.test_patterns
        if notices and patterns is not None and not any(_matches(r, patterns) for r in self.records):
            sentence = "split.test matches only logs that are left out: no test is held out"
            return (*notices, Notice("nothing-held-out", sentence, severity=Severity.WARNING))
        return notices

    @property
    def step_s(self) -> float:
        """Sampling time of every record, s."""
        return self.records[0].step_s

    @property
    def units(self) -> Mapping[str, str]:
        """Role to unit, the same for every record."""
        return self.records[0].units

    @property
    def covariates(self) -> tuple[str, ...]:
        """Names of the further measured inputs that every record has."""
        standard_roles = {DISPLACEMENT, *COMMAND.values()}
        first, *rest = (set(record.signals) - standard_roles for record in self.records)
        return tuple(sorted(first.intersection(*rest)))

    @property
    def directions(self) -> tuple[str, ...]:
        """Directions that single-direction tests excite."""
        return tuple(direction for direction in DIRECTIONS if self.of_kind(direction))

    @property
    def digest(self) -> str:
        """SHA-256 of names, kinds, clocks, units, samples and split."""
        hasher = hashlib.sha256(repr(self.test_patterns).encode(errors="surrogateescape"))
        for record in self.records:
            metadata = (record.name, record.kind, record.step_s, record.start_s, sorted(record.units.items()))
            hasher.update(repr(metadata).encode(errors="surrogateescape"))
            for role in sorted(record.signals):
                hasher.update(role.encode(errors="surrogateescape") + record.signals[role].tobytes())
        return hasher.hexdigest()

    def of_kind(self, kind: str) -> tuple[Record, ...]:
        """Return the records of one kind."""
        return tuple(record for record in self.records if record.kind == kind)

    def ramps(self, direction: str) -> tuple[Record, ...]:
        """Return the slow ramps that excite `direction`."""
        return tuple(record for record in self.of_kind(RAMP) if ramp_direction(record) == direction)

    def held_out(self, direction: str) -> tuple[Record, ...]:
        """Return the held-out tests of a direction; identification does not use them."""
        tests = self.of_kind(direction)
        if self.test_patterns is not None:
            return tuple(record for record in tests if _matches(record, self.test_patterns))
        if len(tests) < 2:
            return ()
        return tests[-max(1, round(HELD_OUT_FRACTION * len(tests))) :]

    def identification(self, direction: str) -> tuple[Record, ...]:
        """Return the tests of a direction that are not held out."""
        held_out = {record.name for record in self.held_out(direction)}
        return tuple(record for record in self.of_kind(direction) if record.name not in held_out)

    def without(self, fingerprints: Collection[str]) -> "Campaign":
        """Return the campaign without records of these fingerprints; the result may be empty."""
        return replace(self, records=tuple(r for r in self.records if r.fingerprint not in fingerprints))

    def segmented(self, dead_zones: Mapping[str, float]) -> "Campaign":
        """Return the campaign with its mixed cycles cut into strokes of one direction each.

        Strokes of a held-out cycle are held out; without any held-out cycle, the last 20 % of each
        direction's strokes are. Raises `InputError` for an unknown direction or an invalid dead zone.
        """
        zones = checks.mapping_of(dead_zones, DIRECTIONS, "dead_zones")
        dead_zones = {
            direction: checks.number(zone, f"dead_zones, {direction}") for direction, zone in zones.items()
        }
        cut_records = []
        for record in self.records:
            if record.kind != CYCLE:
                cut_records.append(record)
                continue
            for number, stroke in enumerate(strokes(record, dead_zones), start=1):
                name = f"{record.name}{STROKE_SEPARATOR}{number:03d}"
                cut_records.append(record.slice(stroke.start, stroke.stop, name=name, kind=stroke.direction))
        held_out = self.held_out(CYCLE)
        patterns = tuple(f"{escape(record.name)}{STROKE_SEPARATOR}*" for record in held_out) or None
        return replace(self, records=tuple(cut_records), test_patterns=patterns)

    def plot(
        self, axes: "Axes | Sequence[Axes] | np.ndarray | None" = None, *, direction: str | None = None
    ) -> np.ndarray:
        """Draw displacement over time of each test, coloured by what the hitch does.

        Args:
            axes: matplotlib axes to draw into, one for each test; None for a new figure of pyplot with at
                most 12 tests. Over the last axes stands the number of tests that are not drawn.
            direction: lifting or lowering, for the tests of one direction; None for all.

        Returns:
            The axes, one for each test.

        Raises:
            InputError: there are no such tests, or `axes` are not matplotlib axes.
        """
        from hitchid.data.plotting import plot_campaign

        if direction is not None:
            checks.one_of(direction, DIRECTIONS, "direction")
        return plot_campaign(self, axes, direction)


def _matches(record: Record, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(record.name, pattern) for pattern in patterns)


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
            f"'{reference.name}' for {' and '.join(reference.directions)}; one campaign needs one signal map"
        )
    return record if record.units == reference.units else record.convert(reference.units)


def _require_motion(record: Record) -> Record:
    """Return a record unless its displacement is constant although it is commanded to move."""
    if record.kind != IDLE and np.ptp(record.displacement) == 0:
        raise LogError(
            record.source or record.name,
            f"the displacement is constant ({record.displacement[0]:g} {record.unit}) over all "
            f"{len(record)} samples although the command changes; expected a moving piston "
            "(is the sensor connected?)",
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
            f"has a sampling time of {record.step_s:.4g} s, the logs one of {step_s:.4g} s in the median; "
            f"expected none that differs by more than a factor of {MAX_RATE_RATIO}",
        )
    return replace(record, step_s=step_s) if drift <= 0.05 * step_s else record.resample(step_s)


def _kind(record: Record, scales: Mapping[str, float], kinds: Mapping[str, str]) -> str:
    for pattern, kind in kinds.items():
        if fnmatchcase(record.name, pattern):
            if kind not in KINDS:
                raise InputError(f"tests: '{kind}' is no kind of test; expected one of {', '.join(KINDS)}")
            return kind
    return detect_kind(record, scales)
