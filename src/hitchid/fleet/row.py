"""Row of one machine: what was found, or the error that ended it, and what it took."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import datetime
from functools import cache
from typing import ClassVar, Literal, TypeVar

from pydantic import TypeAdapter, ValidationError

from hitchid._support.bounded import Correlation, Count, Error, Factor, Figure, Number, Share, Size
from hitchid._support.files import canonical_json
from hitchid.errors import InputError

DONE, FAILED = "done", "failed"
MAX_BYTES = 2**20  # of the file of a row; chosen: two hundred times the largest one seen


@dataclass(frozen=True)
class DirectionRow:
    """One direction of a machine.

    Attributes:
        structure: of the benchmark, with its nonlinearities.
        gain: in the units of displacement and command.
        dead_zone: in the command's unit.
        gain_error: standard error of ln gain, that of the dead zone included; None where not determined.
        dead_zone_error: standard error, in the command's unit; 0 for a given dead zone.
        correlation: of the errors of ln gain and dead zone.
        delay_s, delay_error_s: from a step of the command to 5 % of the speed, s; None where there is none.
        load_scatter: standard deviation of the speed between tests, relative; None where not determined.
        rmse: free run on the identification tests, in the displacement's unit.
        held_out_rmse: free run on the tests that were held out, in the displacement's unit; None without any.
        tests: number of tests it was identified from.
    """

    structure: str
    gain: Number
    dead_zone: Size
    gain_error: Factor | None
    dead_zone_error: Factor
    correlation: Correlation
    delay_s: Size | None
    delay_error_s: Factor | None
    load_scatter: Factor | None
    rmse: Error
    held_out_rmse: Error | None
    tests: Count


@dataclass(frozen=True)
class DriftRow:
    """Change of one direction since its identification.

    Attributes:
        gain_change: relative; 0.08 runs 8 % faster for the same effective command. This and the next four are
            None with fewer than four tests: these do not tell a change from the scatter between tests.
        gain_change_error: standard error, the identification's included.
        dead_zone_change: in the command's unit.
        dead_zone_change_error: standard error, the identification's included.
        p_value: probability of changes as large in a machine that has not changed, by Hotelling's test; None
            where the identification had no errors.
        rmse: free run with the model as identified, in the displacement's unit.
        reference_rmse: that of the held-out tests of the identification, or else of its own tests.
        tests: number of new tests.
    """

    gain_change: Figure | None
    gain_change_error: Factor | None
    dead_zone_change: Figure | None
    dead_zone_change_error: Factor | None
    p_value: Share | None
    rmse: Error
    reference_rmse: Error
    tests: Count


@dataclass(frozen=True)
class Cost:
    """What a task took.

    Attributes:
        seconds: from its begin to its end, s.
        core_seconds: computing time of all threads, s.
        bytes_read, bytes_written: from and to the stores.
        peak_bytes: largest memory of the worker until then.
    """

    seconds: Error
    core_seconds: Error
    bytes_read: Count
    bytes_written: Count
    peak_bytes: Count


@dataclass(frozen=True)
class TaskRow:
    """Outcome of one task on one machine.

    Attributes:
        machine: name of its folder in the store of logs.
        key: digest of the content of its logs, and of all else that the outcome depends on.
        signature: the same with the listing of its logs instead of their content.
        date: time of its newest log, ISO 8601 and UTC; may be empty.
        state: `done`, or `failed` where the logs cannot be used.
        cause, message: of a failure: kind of the error, and its text; empty otherwise.
        notices: remarks on data and choices.
        cost: what the task took; that of the first run where a later one found the same logs.
        directions: direction to its figures, a record of numbers and texts.
    """

    # A file of another's making: no other keys, no text for a number, none that is not finite.
    __pydantic_config__: ClassVar = {"extra": "forbid", "strict": True, "allow_inf_nan": False}

    machine: str
    key: str
    signature: str
    date: str
    state: Literal["done", "failed"]
    cause: str = ""
    message: str = ""
    notices: tuple[str, ...] = ()
    cost: Cost | None = None
    directions: Mapping[str, object] = field(default_factory=dict)

    def as_json(self) -> bytes:
        """Return the row as the content of a file."""
        return canonical_json(asdict(self))

    @classmethod
    def from_json(cls: "type[OneRow]", content: bytes, name: str) -> "OneRow":
        """Return the row in the content of a file.

        Raises:
            InputError: it is not a row.
        """
        from hitchid.logs import describe_settings

        try:
            # Before it is parsed: a row of gigabytes would end the process that reads it.
            if len(content) > MAX_BYTES:
                raise ValueError(f"got more than {MAX_BYTES >> 20} MiB")
            row = _adapter(cls).validate_json(content)
            row.check()
        except ValueError as error:
            reason = describe_settings(error) if isinstance(error, ValidationError) else error
            raise InputError(f"{name}: is not a row of a fleet: {reason}") from error
        return row

    def check(self) -> None:
        """Check what the types do not: raises ValueError for other directions, or a date that is none."""
        from hitchid.logs import DIRECTIONS  # imports NumPy, before which a worker takes its core

        for direction in self.directions:
            if direction not in DIRECTIONS:
                raise ValueError(f"directions: got '{direction}', expected {' or '.join(DIRECTIONS)}")
        try:
            # A trend takes seconds of it, which a date in the year 1 does not have.
            datetime.fromisoformat(self.date or "2000-01-01").timestamp()
        except (ValueError, OverflowError) as error:
            raise ValueError(f"date: got '{self.date}', expected one in ISO 8601") from error


OneRow = TypeVar("OneRow", bound=TaskRow)


@dataclass(frozen=True)
class Row(TaskRow):
    """Outcome of the identification of one machine.

    Attributes:
        directions: direction to its figures.
        digest: of the model.
        units: role to unit.
    """

    directions: Mapping[str, DirectionRow] = field(default_factory=dict)
    digest: str = ""
    units: Mapping[str, str] = field(default_factory=dict)

    def check(self) -> None:
        """Check the units, too; see `TaskRow.check`."""
        from hitchid.logs import UNITS

        super().check()
        for role, unit in self.units.items():
            if unit not in UNITS:
                raise ValueError(f"units.{role}: got '{unit}', expected one of {', '.join(UNITS)}")


@dataclass(frozen=True)
class ValidationRow(TaskRow):
    """Outcome of the validation of one machine.

    Attributes:
        directions: direction to its change since the identification.
        faults: of the new logs, as the audit names them.
        model: key of the model.
    """

    directions: Mapping[str, DriftRow] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    model: str = ""

    @property
    def p_value(self) -> float:
        """Smallest p-value of a direction, for all directions together (Bonferroni); 1 without any."""
        values = [drift.p_value for drift in self.directions.values() if drift.p_value is not None]
        return min(1.0, len(values) * min(values)) if values else 1.0


@cache
def _adapter(kind: type) -> TypeAdapter:
    return TypeAdapter(kind)
