"""Parameters of a model as a table: values, standard errors, intervals and verdicts of both directions."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import isclose
from typing import TYPE_CHECKING, overload

from hitchid._support.dataframes import dataframe
from hitchid._support.inert import html_text
from hitchid._support.short_repr import short_repr
from hitchid._support.summary import screen
from hitchid.data.record import COMMAND, DISPLACEMENT
from hitchid.errors import InputError
from hitchid.model.channel import Channel
from hitchid.model.estimates import Interval
from hitchid.model.uncertainty import Uncertainty
from hitchid.structures import DEAD_TIME, ModelOption, Parameter
from hitchid.structures.static_nonlinearity import NEUTRAL

if TYPE_CHECKING:
    from pandas import DataFrame

    from hitchid.model.hitch import Hitch

DEAD_ZONE = Parameter("dead_zone", "{u}", 0.0, 1.0, linear=True, symbol="dead zone")
SET_BY_HAND, NO_INTERVAL, NO_DEAD_TIME = "set by hand", "no interval", "not part of the model"
MAX_VERDICT = 44  # characters of a verdict in a table as text; chosen
HEADER = ("direction", "name", "symbol", "value", "unit", "standard error", "95 %", "verdict")


@short_repr
@dataclass(frozen=True)
class ParameterRow:
    """One parameter of a model.

    Attributes:
        direction: lifting or lowering.
        name, symbol: name for `Hitch.with_parameters`, and symbol in formulas.
        value: in `unit`.
        unit: unit of value, standard error and interval.
        standard_error: None where there is none; of a dead zone only the interval is known.
        interval: lower and upper end of the 95 % interval; None for an end that the tests do not determine.
        verdict: whether the tests determine it, and what would; `set by hand` for a value that was set.
    """

    direction: str
    name: str
    symbol: str
    value: float
    unit: str
    standard_error: float | None
    interval: Interval
    verdict: str


@dataclass(frozen=True, repr=False)
class ParameterTable(Sequence[ParameterRow]):
    """Parameters of all directions of a model.

    `table["lifting", "gain"]` is one row, `table["lifting"]` the rows of one direction.

    Attributes:
        rows: of all parameters.
    """

    rows: tuple[ParameterRow, ...]

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[ParameterRow]:
        return iter(self.rows)

    @overload
    def __getitem__(self, key: int | tuple[str, str]) -> ParameterRow: ...
    @overload
    def __getitem__(self, key: slice | str) -> "ParameterTable": ...
    def __getitem__(self, key: int | slice | str | tuple[str, str]) -> "ParameterRow | ParameterTable":
        """Return the row of a direction and a name or of a number, or the rows of a direction or slice.

        Raises:
            InputError: there is no such direction or parameter.
            IndexError: there is no row of this number.
        """
        if isinstance(key, int):
            return self.rows[key]
        if isinstance(key, slice):
            return ParameterTable(self.rows[key])
        matching = [row for row in self.rows if key in ((row.direction, row.name), row.direction)]
        if not matching:
            known = ", ".join(f"{row.direction} {row.name}" for row in self.rows)
            raise InputError(f"parameter: expected one of {known}; got {key!r}")
        return ParameterTable(tuple(matching)) if isinstance(key, str) else matching[0]

    def to_dataframe(self) -> "DataFrame":
        """Return the table as a pandas DataFrame, the interval in the columns `lower` and `upper`.

        Raises:
            InputError: pandas is not installed.
        """
        rows = []
        for row in self.rows:
            cells = asdict(row)
            lower, upper = cells.pop("interval")
            verdict = cells.pop("verdict")
            rows.append({**cells, "lower": lower, "upper": upper, "verdict": verdict})
        return dataframe(rows)

    def __repr__(self) -> str:
        cells = [HEADER, *map(_cells, self.rows)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in cells
        ]
        return screen(["ParameterTable", *lines])

    def _repr_html_(self) -> str:
        head = "".join(f"<th>{html_text(cell)}</th>" for cell in HEADER)
        body = "".join(
            f"<tr>{''.join(f'<td>{html_text(cell)}</td>' for cell in _cells(row))}</tr>" for row in self.rows
        )
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def parameter_table(model: "Hitch") -> ParameterTable:
    """Return the parameters of a model; see `Hitch.parameters`."""
    return ParameterTable(
        tuple(
            row
            for direction, channel in model.channels.items()
            for row in _rows(
                channel,
                model.units,
                model.uncertainty.get(direction),
                frozenset(model.provenance.set_by_hand.get(direction, {})),
            )
        )
    )


def definitions(channel: Channel, uncertainty: Uncertainty | None) -> dict[str, Parameter]:
    """Return name to definition of the parameters of a channel, in the order of its table.

    Of the nonlinearities these are the identified ones, or without uncertainty those that have an effect.
    """
    benchmark = channel.benchmark
    values = benchmark.named_values()
    identified = set() if uncertainty is None else {p.name for p in uncertainty.benchmark.parameters}
    structure = benchmark.structure
    parameters = () if structure.uses_raw_command else (DEAD_ZONE,)
    parameters += structure.parameters
    parameters += tuple(
        p
        for p in benchmark.parameters[len(structure.parameters) + 1 :]
        if p.name in identified or values[p.name] != NEUTRAL.get(p.name, 0.0)
    )
    if ModelOption.DEAD_TIME in structure.options:
        parameters += (DEAD_TIME,)
    return {parameter.name: parameter for parameter in parameters}


def values_of(channel: Channel) -> dict[str, float]:
    """Return parameter name to value of a channel, dead zone and dead time among them."""
    return {
        DEAD_ZONE.name: channel.dead_zone,
        DEAD_TIME.name: 0.0,
        **channel.benchmark.named_values(),
    }


def _rows(
    channel: Channel, units: Mapping[str, str], uncertainty: Uncertainty | None, set_by_hand: frozenset[str]
) -> Iterator[ParameterRow]:
    """Yield the rows of one direction."""
    known = _known(channel, uncertainty)
    values = values_of(channel)
    template = {"x": units[DISPLACEMENT], "u": units[COMMAND[channel.direction]]}
    for name, parameter in definitions(channel, uncertainty).items():
        no_part = name == DEAD_TIME.name and not values[name]
        error, interval, verdict = known.get(
            name, (None, (None, None), NO_DEAD_TIME if no_part else NO_INTERVAL)
        )
        yield ParameterRow(
            channel.direction,
            name,
            parameter.symbol or name.replace("_", " "),
            values[name],
            parameter.unit.format(**template),
            error,
            interval,
            SET_BY_HAND if name in set_by_hand else verdict,
        )


def _known(
    channel: Channel, uncertainty: Uncertainty | None
) -> dict[str, tuple[float | None, Interval, str]]:
    """Return parameter name to standard error, interval and verdict, where they are known."""
    if uncertainty is None:
        return {}
    known = {p.name: (p.error, p.interval, p.verdict) for p in uncertainty.benchmark.parameters}
    characteristics = uncertainty.characteristics
    if characteristics is not None and isclose(characteristics.dead_zone.value, channel.dead_zone):
        interval, value = characteristics.dead_zone.interval, characteristics.dead_zone.value
        verdict = "determined" if characteristics.dead_zone.determined else "not determined"
        known[DEAD_ZONE.name] = (None, interval, "as given" if interval == (value, value) else verdict)
    return known


def _cells(row: ParameterRow) -> tuple[str, ...]:
    lower, upper = row.interval
    ends = "" if row.interval == (None, None) else f"{_end(lower)} … {_end(upper)}"
    verdict = row.verdict if len(row.verdict) <= MAX_VERDICT else f"{row.verdict[: MAX_VERDICT - 1]}…"
    error = "" if row.standard_error is None else f"{row.standard_error:.2g}"
    return row.direction, row.name, row.symbol, f"{row.value:.5g}", row.unit, error, ends, verdict


def _end(value: float | None) -> str:
    return "?" if value is None else f"{value:.4g}"
