"""All tests of one plant, and which of them are held out."""

import hashlib
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from glob import escape
from statistics import median_low

import numpy as np

from hitchid import checks
from hitchid.errors import InputError, LogError
from hitchid.modes import detect_kind, full_scales, ramp_mode, strokes
from hitchid.record import COMMAND, CYCLE, DISPLACEMENT, IDLE, KINDS, MODES, RAMP, Record

HELD_OUT_FRACTION = 0.2
LARGEST_RATE_RATIO = 100


@dataclass(frozen=True)
class Campaign:
    """Tests of one plant on one clock and in one set of units.

    Attributes:
        records: the tests, in the order of their names.
        test_patterns: patterns on names that mark the held-out tests; without any, the last 20 % of each
            mode's tests are held out.
        unmatched: patterns of a settings file that match no test here; only an identification minds.
    """

    records: tuple[Record, ...]
    test_patterns: tuple[str, ...] | None = None
    unmatched: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        records: Sequence[Record],
        *,
        test_patterns: Sequence[str] | None = None,
        kinds: Mapping[str, str] | None = None,
    ) -> "Campaign":
        """Bring records onto one clock and one set of units, and tell what each one is.

        Args:
            records: tests, in any order.
            test_patterns: patterns on names that mark the held-out tests.
            kinds: pattern on names to kind, where it should not be found from the commands.

        Raises:
            InputError: no records, equal names, unlike commands, or a pattern that matches no test.
            LogError: a record's displacement never changes although its command does.
        """
        records = checks.several(records, Record, "records", "records, each a hitchid.Record")
        if test_patterns is not None:
            test_patterns = checks.several(test_patterns, str, "test_patterns", "patterns on names")
        checks.instance(kinds or {}, Mapping, "kinds", "pattern on names to kind")
        if not records:
            raise InputError("a campaign needs at least one record, none came")
        if empty := [record.name for record in records if not len(record)]:
            raise InputError(f"record '{empty[0]}' holds no samples; required at least one")
        names = [record.name for record in records]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two records are called '{name}'; names must differ")
        ordered = sorted(records, key=lambda record: _natural(record.name))
        first = ordered[0]
        for record in ordered:
            if record.modes != first.modes:
                raise InputError(
                    f"record '{record.name}' has commands for {' and '.join(record.modes)}, "
                    f"'{first.name}' for {' and '.join(first.modes)}; one campaign needs one signal map"
                )
        same_units = [
            record if record.units == first.units else record.convert(first.units) for record in ordered
        ]
        on_clock = [_on_clock(record, _common_step(ordered)) for record in same_units]
        scales = full_scales(on_clock)
        told = tuple(replace(record, kind=_kind(record, scales, kinds or {})) for record in on_clock)
        for record in told:
            if record.kind != IDLE and np.ptp(record.displacement) == 0:
                raise LogError(
                    record.source or record.name,
                    f"the displacement is constant ({record.displacement[0]:g} {record.unit}) over all "
                    f"{len(record)} samples although the command changes; required a moving piston "
                    "(is the sensor connected?)",
                )
        for pattern in test_patterns or ():
            if not any(fnmatchcase(name, pattern) for name in names):
                raise InputError(
                    f"split.test: the pattern '{pattern}' matches none of the {len(names)} tests"
                )
        return cls(told, None if test_patterns is None else tuple(test_patterns))

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
        known = {DISPLACEMENT, *COMMAND.values()}
        first, *rest = (set(record.signals) - known for record in self.records)
        return tuple(sorted(first.intersection(*rest)))

    @property
    def modes(self) -> tuple[str, ...]:
        """The modes that single-direction tests excite."""
        return tuple(mode for mode in MODES if self.of_kind(mode))

    @property
    def digest(self) -> str:
        """SHA-256 of all there is: names, kinds, clocks, units, every sample, what is held out."""
        whole = hashlib.sha256(repr(self.test_patterns).encode(errors="surrogateescape"))
        for record in self.records:
            told = (record.name, record.kind, record.step_s, record.start_s, sorted(record.units.items()))
            whole.update(repr(told).encode(errors="surrogateescape"))
            for role in sorted(record.signals):
                whole.update(role.encode(errors="surrogateescape") + record.signals[role].tobytes())
        return whole.hexdigest()

    def of_kind(self, kind: str) -> tuple[Record, ...]:
        """Return the records of one kind."""
        return tuple(record for record in self.records if record.kind == kind)

    def ramps(self, mode: str) -> tuple[Record, ...]:
        """Return the slow ramps that excite `mode`."""
        return tuple(record for record in self.of_kind(RAMP) if ramp_mode(record) == mode)

    def held_out(self, mode: str) -> tuple[Record, ...]:
        """Return the tests of a mode that no identification may see."""
        tests = self.of_kind(mode)
        if self.test_patterns is not None:
            return tuple(
                r for r in tests if any(fnmatchcase(r.name, pattern) for pattern in self.test_patterns)
            )
        if len(tests) < 2:
            return ()
        return tests[-max(1, round(HELD_OUT_FRACTION * len(tests))) :]

    def identification(self, mode: str) -> tuple[Record, ...]:
        """Return the tests of a mode that are not held out."""
        held_out = {record.name for record in self.held_out(mode)}
        return tuple(record for record in self.of_kind(mode) if record.name not in held_out)

    def without(self, fingerprints: Collection[str]) -> "Campaign":
        """Return the campaign without the records that these are the fingerprints of; it may be empty."""
        return replace(self, records=tuple(r for r in self.records if r.fingerprint not in fingerprints))

    def segmented(self, dead_zones: Mapping[str, float]) -> "Campaign":
        """Return the campaign with its mixed cycles cut into strokes of one mode each.

        Strokes of a held-out cycle are held out; where no whole cycle is, the last 20 % of each mode's
        strokes are.
        """
        zones = checks.keyed(dead_zones, MODES, "dead_zones")
        dead_zones = {mode: checks.number(zone, f"dead_zones, {mode}") for mode, zone in zones.items()}
        cut = []
        for record in self.records:
            if record.kind != CYCLE:
                cut.append(record)
                continue
            for number, stroke in enumerate(strokes(record, dead_zones), start=1):
                name = f"{record.name}#{number:03d}"
                cut.append(record.slice(stroke.start, stroke.stop, name=name, kind=stroke.mode))
        held_out = self.held_out(CYCLE)
        patterns = tuple(f"{escape(record.name)}#*" for record in held_out) or None
        return Campaign(tuple(cut), patterns)


def _natural(name: str) -> list[tuple[int, str]]:
    """Return a sorting key that puts test-2 before test-10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def _common_step(records: Sequence[Record]) -> float:
    """Return the step of a middle record: one that logs have, where the mean of two would fit neither."""
    return float(f"{median_low(record.step_s for record in records):.4g}")


def _on_clock(record: Record, step_s: float) -> Record:
    """Adopt the common sampling time where the stamps cannot tell the difference, else resample."""
    drift = abs(record.step_s - step_s) * len(record)
    if not 1 / LARGEST_RATE_RATIO <= record.step_s / step_s <= LARGEST_RATE_RATIO:
        raise LogError(
            record.source or record.name,
            f"has a sampling time of {record.step_s:.4g} s, the logs one of {step_s:.4g} s in the median; "
            f"required none that differs by more than a factor of {LARGEST_RATE_RATIO}",
        )
    return replace(record, step_s=step_s) if drift <= 0.05 * step_s else record.resample(step_s)


def _kind(record: Record, scales: Mapping[str, float], kinds: Mapping[str, str]) -> str:
    for pattern, kind in kinds.items():
        if fnmatchcase(record.name, pattern):
            if kind not in KINDS:
                raise InputError(f"tests: '{kind}' is no kind of test; required one of {', '.join(KINDS)}")
            return kind
    return detect_kind(record, scales)
