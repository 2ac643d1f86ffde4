"""Parameters of a model: as a table, as what a model shows of itself, and set by hand."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isclose, log
from typing import TYPE_CHECKING, overload

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hitchid._support import checks
from hitchid._support.inert import html_text
from hitchid._support.numbers import count
from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid._support.screen import screen, sparkline
from hitchid._support.tables import RecordTable, Table, field_column, field_of, interval_columns
from hitchid.errors import InputError
from hitchid.logs.record import COMMAND, DISPLACEMENT
from hitchid.model.channel import Channel
from hitchid.model.estimates import NOT_ASSESSED, Estimate, Estimates, Interval, Uncertainty
from hitchid.structures import DEAD_TIME, ModelOption, Parameter, Scale
from hitchid.structures.nonlinearity import NEUTRAL

if TYPE_CHECKING:
    from pandas import DataFrame

    from hitchid.model.hitch import Hitch


DEAD_ZONE = Parameter("dead_zone", "{u}", 0.0, 1.0, linear=True, symbol="dead zone")
SET_BY_HAND, NO_INTERVAL, NO_DEAD_TIME = "set by hand", "no interval", "not part of the model"
MAX_VERDICT = 44  # characters of a verdict in a table as text; chosen


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


def _interval_text(row: ParameterRow) -> str:
    if row.interval == (None, None):
        return ""
    return " … ".join("?" if end is None else f"{end:.4g}" for end in row.interval)


def _verdict_text(row: ParameterRow) -> str:
    return row.verdict if len(row.verdict) <= MAX_VERDICT else f"{row.verdict[: MAX_VERDICT - 1]}…"


COLUMNS = (
    *map(field_column, ("direction", "name", "symbol")),
    field_column("value", text=lambda row: f"{row.value:.5g}"),
    field_column("unit"),
    field_column(
        "standard_error",
        "standard error",
        lambda row: "" if row.standard_error is None else f"{row.standard_error:.2g}",
    ),
    *interval_columns("{}", "95 %", field_of("interval"), _interval_text),
    field_column("verdict", text=_verdict_text),
)


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
        return RecordTable("parameters", "", COLUMNS, self.rows).data().to_dataframe()

    def __repr__(self) -> str:
        shown = RecordTable("parameters", "", COLUMNS, self.rows).shown()
        cells = [shown.header, *shown.rows]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in cells
        ]
        return screen(["ParameterTable", *lines])

    def _repr_html_(self) -> str:
        shown = RecordTable("parameters", "", COLUMNS, self.rows).shown()
        head = "".join(f"<th>{html_text(cell)}</th>" for cell in shown.header)
        body = "".join(
            f"<tr>{''.join(f'<td>{html_text(cell)}</td>' for cell in row)}</tr>" for row in shown.rows
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
    known: dict[str, tuple[float | None, Interval, str]] = {}
    if uncertainty is not None:
        known = {p.name: (p.error, p.interval, p.verdict) for p in uncertainty.benchmark.parameters}
        characteristics = uncertainty.characteristics
        # Of a dead zone that was changed since, the interval is not known.
        if characteristics is not None and isclose(characteristics.dead_zone.value, channel.dead_zone):
            interval, value = characteristics.dead_zone.interval, characteristics.dead_zone.value
            verdict = "determined" if characteristics.dead_zone.determined else "not determined"
            known[DEAD_ZONE.name] = (None, interval, "as given" if interval == (value, value) else verdict)
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


# What a model shows of itself: structure, parameters with units and errors, corrections.


def hitch_summary(hitch: "Hitch") -> Table:
    """Return sampling time, units, and for each direction its structure and parameters."""
    units = ", ".join(f"{role} in {unit}" for role, unit in hitch.units.items())
    notes = [] if hitch.two_modes is None else [hitch.two_modes.sentence]
    if hitch.limits is not None:
        notes.append(hitch.limits.sentence(hitch.units[DISPLACEMENT]))
    maps = []
    for direction in hitch.channels:
        uncertainty = hitch.uncertainty.get(direction)
        if uncertainty is None or uncertainty.characteristics is None:
            maps.append("")
            continue
        points = uncertainty.characteristics.speed_map
        speeds = np.array([point.speed for point in points if point.load == points[0].load])
        maps.append(sparkline([speeds], f"steady speed over the {direction} command"))
    return Table(
        f"Hitch at {hitch.step_s:g} s: {units}",
        ("direction", "structure", "parameters"),
        tuple(
            (direction, channel.benchmark.structure.name, "; ".join(_facts(hitch, channel)))
            for direction, channel in hitch.channels.items()
        ),
        tuple(notes),
        tuple(maps) if any(maps) else (),
    )


def _facts(hitch: "Hitch", channel: Channel) -> Iterator[str]:
    """Yield G(s), each parameter with its unit, and the corrections of one direction."""
    benchmark = channel.benchmark
    if benchmark.structure.linear is not None:
        yield f"G(s) = {benchmark.structure.formula}"
    uncertainty = hitch.uncertainty.get(channel.direction)
    errors = {e.name: e.error for e in uncertainty.benchmark.parameters} if uncertainty else {}
    command_unit = hitch.units.get(COMMAND[channel.direction], "")
    known = benchmark.parameters
    shown = definitions(channel, uncertainty)
    units = {p.name: p.unit.format(x=hitch.units[DISPLACEMENT], u=command_unit) for p in known}
    symbols = {parameter.name: parameter.symbol for parameter in benchmark.structure.parameters}
    for name, value in benchmark.named_values().items():
        if "_by_" in name and name not in shown:
            continue
        symbol = f" {symbols[name]}" if symbols.get(name) else ""
        error = f" ± {error:.2g}" if (error := errors.get(name)) else ""
        unit = "" if units[name] == "1" else f" {units[name]}"
        yield f"{name}{symbol} = {value:.4g}{error}{unit}"
    yield f"dead zone = {channel.dead_zone:.4g} {command_unit}".rstrip()
    scatter, length = float(channel.load_filter.load_scatter), float(channel.load_filter.load_length)
    if scatter:
        unit = hitch.units[DISPLACEMENT]
        yield f"load filter: speed differs by ± {100 * scatter:.2g} %, alike over {length:.3g} {unit}"
    if uncertainty is not None and uncertainty.load_scatter is not None:
        yield f"load: {uncertainty.load_scatter.sentence}"
    corrections = []
    if channel.compensator is not None:
        corrections.append(f"up to {count(channel.compensator.max_horizon, 'sample')} ahead")
    if channel.speed_compensator is not None:
        corrections.append("free run")
    yield "network corrections: " + (" and ".join(corrections) or "none")


# A model with parameters that were set by hand.

MAX_SHIFT = 0.1  # standard errors by which an estimate may depend on the set values; chosen


@double_precision
def with_parameters(model: "Hitch", changes: Mapping[str, Mapping[str, float] | None]) -> "Hitch":
    """Return a model with parameters set by hand; see `Hitch.with_parameters`."""
    given = {
        direction: checks.instance(values, Mapping, direction, "parameter to value")
        for direction, values in changes.items()
        if values is not None
    }
    given = {direction: values for direction, values in given.items() if values}
    channels, uncertainty, rivals = dict(model.channels), dict(model.uncertainty), dict(model.rivals)
    set_by_hand = {direction: dict(values) for direction, values in model.provenance.set_by_hand.items()}
    for direction, values in given.items():
        checks.one_of(direction, model.channels, "direction")
        channel = model.channels[direction]
        checked = _checked(channel, model.uncertainty.get(direction), direction, values)
        channels[direction] = _changed(channel, checked)
        rivals.pop(direction, None)
        if direction in uncertainty:
            estimates = _without_intervals(uncertainty[direction].benchmark, checked)
            uncertainty[direction] = Uncertainty(estimates)
        set_by_hand[direction] = {**set_by_hand.get(direction, {}), **checked}
    # Without the digest, as no folder holds this model.
    provenance = replace(model.provenance, set_by_hand=set_by_hand, digest="") if given else model.provenance
    return replace(model, channels=channels, uncertainty=uncertainty, rivals=rivals, provenance=provenance)


def _checked(
    channel: Channel, uncertainty: Uncertainty | None, direction: str, values: Mapping[str, float]
) -> dict[str, float]:
    """Return values as numbers; raise InputError for unknown names and values that are not admissible."""
    parameters = definitions(channel, uncertainty)
    checks.mapping_of(values, parameters, direction)
    current = values_of(channel)
    checked = {name: checks.number(value, f"{direction} {name}") for name, value in values.items()}
    for name, value in checked.items():
        lower, upper, open_below = _admissible(parameters[name], channel, current[name], uncertainty)
        if not lower <= value <= upper or (open_below and value == lower):
            required = f"more than {lower:g}" if open_below else f"from {lower:.4g} to {upper:.4g}"
            raise InputError(f"{direction} {name}: expected {required}, got {value:.4g}")
    return checked


def _admissible(
    parameter: Parameter, channel: Channel, current: float, uncertainty: Uncertainty | None
) -> tuple[float, float, bool]:
    """Return the ends of the admissible range of a parameter, and whether the lower one is not admissible.

    A dead zone lies below the largest command of the tests. A parameter whose default bounds are absolute
    lies between them, or those of its search, or up to its value where that is beyond. Others are finite, and
    positive where they are searched by their logarithm.
    """
    if parameter.name == DEAD_ZONE.name:
        return 0.0, channel.dead_zone + float(channel.operating_range.command.highest), False
    if parameter.scale is not Scale.NONE:
        return (-inf, inf, False) if parameter.linear else (0.0, inf, True)
    estimates = () if uncertainty is None else uncertainty.benchmark.parameters
    searched = [(estimate.lower, estimate.upper) for estimate in estimates if estimate.name == parameter.name]
    lowers, uppers = zip((parameter.lower, parameter.upper), (current, current), *searched, strict=True)
    lower = 0.0 if parameter.name == DEAD_TIME.name else min(lowers)
    return lower, max(uppers), False


def _changed(channel: Channel, values: Mapping[str, float]) -> Channel:
    """Return a channel with other values, without compensators; its range covers the same commands."""
    benchmark, dead_zone = channel.benchmark, values.get(DEAD_ZONE.name, channel.dead_zone)
    current = zip(benchmark.parameters, map(float, benchmark.parameter_vector), strict=True)
    row = [values.get(parameter.name, value) for parameter, value in current]
    # Effective commands move by what the dead zone moves; closed valves stay in the range.
    command, shift = channel.operating_range.command, channel.dead_zone - dead_zone
    lowest = jnp.where(command.lowest > 0, jnp.maximum(command.lowest + shift, 0.0), command.lowest)
    ends = (lowest, command.highest + shift)
    operating_range = eqx.tree_at(
        lambda tree: (tree.command.lowest, tree.command.highest), channel.operating_range, ends
    )
    return replace(
        channel,
        dead_zone=dead_zone,
        benchmark=benchmark.with_parameter_vector(jnp.asarray(row)),
        operating_range=operating_range,
        compensator=None,
        speed_compensator=None,
    )


def _without_intervals(estimates: Estimates, values: Mapping[str, float]) -> Estimates:
    """Return estimates without the intervals of set parameters, and of those that depend on them.

    The fit of parameter j, with those in the set S held at values z_S standard errors from their estimates,
    is R_jS R_SS⁻¹ z_S standard errors from its own estimate, R the correlation matrix. An interval stays
    where that is at most a tenth. None stays where the dead zone or another parameter was set that was not
    estimated with them, or one without a standard error, whose correlations are not known.
    """
    parameters = estimates.parameters
    estimated = {parameter.name for parameter in parameters}
    selected = [number for number, parameter in enumerate(parameters) if parameter.name in values]
    steps = np.array([_standard_steps(parameters[i], values[parameters[i].name]) for i in selected])
    correlation = np.array(estimates.correlation)
    if estimated >= set(values) and np.all(np.isfinite(steps)) and correlation.size:
        block = correlation[np.ix_(selected, selected)]
        shifts = np.abs(correlation[:, selected] @ np.linalg.pinv(block, hermitian=True) @ steps)
    else:
        shifts = np.full(len(parameters), inf)
    names = " and ".join(name.replace("_", " ") for name in values)
    kept, changed = [], []
    for parameter, shift in zip(parameters, shifts, strict=True):
        if parameter.name in values:
            changed.append(_unassessed(parameter, values[parameter.name], SET_BY_HAND))
        elif parameter.method == NOT_ASSESSED:
            changed.append(parameter)
        elif shift > MAX_SHIFT or parameter.error is None:
            verdict = f"no interval: estimated with a different value of {names}"
            changed.append(_unassessed(parameter, parameter.value, verdict))
        else:
            kept.append(parameter.name)
            changed.append(parameter)
    keep = np.array([parameter.name in kept for parameter in parameters])
    if correlation.size:
        correlation = np.where(np.outer(keep, keep), correlation, 0.0)
    return replace(
        estimates,
        parameters=tuple(changed),
        derived=(),
        correlation=tuple(tuple(map(float, row)) for row in correlation),
    )


def _standard_steps(estimate: Estimate, value: float) -> float:
    """Return how many standard errors a value is from its estimate, on the scale of the search."""
    if not estimate.error:
        return inf
    if estimate.linear:
        return (value - estimate.value) / estimate.error
    return estimate.value * log(value / estimate.value) / estimate.error


def _unassessed(estimate: Estimate, value: float, verdict: str) -> Estimate:
    return replace(
        estimate,
        value=value,
        error=None,
        interval=(None, None),
        method=NOT_ASSESSED,
        bootstrap=None,
        determined=False,
        verdict=verdict,
        sensitivity=0.0,
        profile=(),
    )
