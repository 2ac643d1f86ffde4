"""Campaign: all tests of one plant, and which of them are held out."""

import hashlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from fnmatch import fnmatchcase
from glob import escape
from typing import TYPE_CHECKING, overload

import numpy as np

from hitchid._support import checks
from hitchid._support.records import Notice, Severity, Value
from hitchid._support.tables import Summarised, Table
from hitchid.errors import InputError
from hitchid.logs.kinds import ramp_direction, strokes
from hitchid.logs.record import COMMAND, CYCLE, DIRECTIONS, DISPLACEMENT, RAMP, Record
from hitchid.logs.unification import LeftOut, left_out_notices, unified

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HELD_OUT_FRACTION = 0.2  # of the tests of a direction; the default split (chosen)
STROKE_SEPARATOR = "#"


@dataclass(frozen=True, eq=False, repr=False)
class Campaign(Value, Summarised):
    """Tests of one plant on one clock and in one set of units; a sequence of records.

    `campaign[0]` and `campaign["up-1"]` are records, `campaign[:3]` and `campaign[["up-1", "up-2"]]` are
    campaigns.

    Attributes:
        records: the tests, in the order of their names.
        test_patterns: patterns on names that mark the held-out tests; without any, the last 20 % of each
            direction's tests are held out.
        unmatched: patterns of a settings file that match no test here; an error only in an identification.
        left_out: logs and tests that cannot be used, with their reasons.
        strict: whether one test that cannot be used is an error in later steps too.
        end_stops: lowest and highest displacement that the piston can reach, in the displacement's unit; None
            where they are found from the tests.
    """

    records: tuple[Record, ...]
    test_patterns: tuple[str, ...] | None = None
    unmatched: tuple[str, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    strict: bool = False
    end_stops: tuple[float, float] | None = None

    @classmethod
    def of(
        cls,
        records: Sequence[Record],
        *,
        test_patterns: Sequence[str] | None = None,
        kinds: Mapping[str, str] | None = None,
        left_out: Sequence[LeftOut] = (),
        strict: bool = False,
        end_stops: Sequence[float] | None = None,
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
            end_stops: lowest and highest displacement that the piston can reach, in the displacement's unit;
                by default found from the tests.

        Raises:
            InputError: no records, an empty record, equal names, a pattern that matches no test, an unknown
                kind, or every test of a direction is left out; with `strict`, any test is left out.
        """
        records = checks.tuple_of(records, Record, "records", "records, each a hitchid.Record")
        if test_patterns is not None:
            test_patterns = checks.tuple_of(test_patterns, str, "test_patterns", "patterns on names")
        checks.instance(kinds or {}, Mapping, "kinds", "pattern on names to kind")
        stops = None
        if end_stops is not None:
            positions = checks.numbers(end_stops, "end_stops").tolist()
            if len(positions) != 2 or not positions[0] < positions[1]:
                raise InputError(f"end_stops: expected the lower and the higher position, got {positions}")
            stops = (positions[0], positions[1])
        if not records:
            raise InputError("a campaign needs at least one record, got none")
        # Median, range and full scale of what follows need at least one sample.
        if empty := [record.name for record in records if not len(record)]:
            raise InputError(f"record '{empty[0]}' holds no samples; expected at least one")
        names = [record.name for record in records]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two records have the name '{name}'; names must differ")
        usable, excluded = unified(records, kinds or {}, strict=strict)
        all_left_out = (*left_out, *excluded)
        # A pattern that matches nothing holds nothing out, and the accuracy would be that of used tests.
        for pattern in test_patterns or ():
            if not any(fnmatchcase(name, pattern) for name in (*names, *(item.name for item in left_out))):
                raise InputError(
                    f"split.test: the pattern '{pattern}' matches none of the {len(names)} tests"
                )
        patterns = None if test_patterns is None else tuple(test_patterns)
        return cls(tuple(usable), patterns, left_out=all_left_out, strict=strict, end_stops=stops)

    @classmethod
    def from_dataframes(
        cls,
        frames: Mapping[str, object] | Iterable[object],
        *,
        signals: Mapping[str, object] | None = None,
        units: Mapping[str, str] | None = None,
        test_patterns: Sequence[str] | None = None,
        kinds: Mapping[str, str] | None = None,
        strict: bool = False,
        end_stops: Sequence[float] | None = None,
    ) -> "Campaign":
        """Return the campaign of tables, each prepared as a log file is; see `Record.from_dataframe`.

        Args:
            frames: name to table of pandas or polars; tables without names are called test-1, test-2, ….
            signals, units: as in `Record.from_dataframe`, the same for all tables.
            test_patterns, kinds, end_stops: as in `of`.
            strict: raise an error for a table that cannot be used; otherwise it is left out.

        Returns:
            One record a table, several for a table with long gaps.

        Raises:
            InputError: an argument or no table can be used, or as `of`.
        """
        from hitchid.logs.dataframes import read_frames

        records, left_out = read_frames(frames, signals, units, strict=strict)
        return cls.of(
            records,
            test_patterns=test_patterns,
            kinds=kinds,
            left_out=left_out,
            strict=strict,
            end_stops=end_stops,
        )

    def __len__(self) -> int:
        """Return the number of tests."""
        return len(self.records)

    def __iter__(self) -> Iterator[Record]:
        """Return an iterator over the tests."""
        return iter(self.records)

    def __contains__(self, test: object) -> bool:
        """Return whether a test, or a test of a name, is in the campaign."""
        return any(test in (record.name, record) for record in self.records)

    @overload
    def __getitem__(self, key: int | np.integer | str) -> Record: ...

    @overload
    def __getitem__(self, key: slice | Iterable[str]) -> "Campaign": ...

    def __getitem__(self, key: int | np.integer | str | slice | Iterable[str]) -> "Record | Campaign":
        """Return the test of a number or name, or the campaign of a slice or of several names.

        A campaign without patterns of held-out tests holds out the last 20 % of the tests it has.

        Raises:
            InputError: there is no such test, or no test is selected.
        """
        if isinstance(key, str):
            return self.records[self._index(key)]
        if isinstance(key, int | np.integer):
            if not -len(self) <= key < len(self):
                raise InputError(
                    f"campaign: expected a test index from {-len(self)} to {len(self) - 1}, got {key}"
                )
            return self.records[key]
        if isinstance(key, slice):
            try:
                rows = range(len(self))[key]
            except (TypeError, ValueError) as error:
                raise InputError(f"campaign: expected a slice of whole numbers, got {key}") from error
            # Always in the order of the campaign: the default split takes the last tests.
            chosen = tuple(self.records[row] for row in sorted(rows))
        else:
            names = checks.tuple_of(key, str, "campaign: key", "a number, a name, a slice or names")
            chosen = tuple(self.records[row] for row in sorted({self._index(name) for name in names}))
        if not chosen:
            raise InputError("campaign: no test is selected, expected at least one")
        return replace(self, records=chosen)

    def _index(self, name: str) -> int:
        names = [record.name for record in self.records]
        if name in names:
            return names.index(name)
        nearest = get_close_matches(name, names, n=1) or names[:1]
        raise InputError(
            f"campaign: none of the {len(self)} tests is named '{name}'; did you mean '{nearest[0]}'?"
        )

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
        # A model can use a covariate only if no test lacks it.
        first, *rest = (set(record.signals) - standard_roles for record in self.records)
        return tuple(sorted(first.intersection(*rest)))

    @property
    def directions(self) -> tuple[str, ...]:
        """Directions that single-direction tests excite."""
        return tuple(direction for direction in DIRECTIONS if self.of_kind(direction))

    @property
    def digest(self) -> str:
        """SHA-256 of names, kinds, clocks, units, samples, split and end stops."""
        # A file name need not be UTF-8: surrogates stand for the bytes that are not.
        hasher = hashlib.sha256(repr(self.test_patterns).encode(errors="surrogateescape"))
        if self.end_stops is not None:
            hasher.update(repr(self.end_stops).encode())
        for record in self.records:
            metadata = (record.name, record.kind, record.step_s, record.start_s, sorted(record.units.items()))
            hasher.update(repr(metadata).encode(errors="surrogateescape"))
            for role in sorted(record.signals):
                hasher.update(role.encode(errors="surrogateescape") + record.signals[role].tobytes())
        return hasher.hexdigest()

    def end_stop(self, sign: int) -> float | None:
        """Return the end stop of rising (+1) or falling (−1) displacement, None where it is not given."""
        return None if self.end_stops is None else self.end_stops[sign > 0]

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
        # The last by name, not random ones: the same logs always give the same split.
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
        # Whoever held out a log did so as a whole: nothing may be identified from one of its strokes.
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
        from hitchid.logs.plotting import plot_campaign

        if direction is not None:
            checks.one_of(direction, DIRECTIONS, "direction")
        return plot_campaign(self, axes, direction)

    def _summary(self) -> Table:
        from hitchid.logs.summaries import campaign_summary

        return campaign_summary(self)


def _matches(record: Record, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(record.name, pattern) for pattern in patterns)
