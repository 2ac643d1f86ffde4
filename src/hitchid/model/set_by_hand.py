"""A model with parameters that were set by hand."""

from collections.abc import Mapping
from dataclasses import replace
from math import inf, log
from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid.errors import InputError
from hitchid.model.channel import Channel
from hitchid.model.estimates import NOT_ASSESSED, Estimate, Estimates
from hitchid.model.parameters import DEAD_ZONE, SET_BY_HAND, definitions, values_of
from hitchid.model.uncertainty import Uncertainty
from hitchid.networks.operating_range import OperatingRange
from hitchid.structures import DEAD_TIME, Parameter, PhysicalModel, Scale

if TYPE_CHECKING:
    from hitchid.model.hitch import Hitch

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
    provenance = replace(model.provenance, set_by_hand=set_by_hand, digest="") if given else model.provenance
    return replace(model, channels=channels, uncertainty=uncertainty, rivals=rivals, provenance=provenance)


def _checked(
    channel: Channel, uncertainty: Uncertainty | None, direction: str, values: Mapping[str, float]
) -> dict[str, float]:
    """Return values as numbers; raise InputError for unknown names and values that are not admissible."""
    known = definitions(channel, uncertainty)
    checks.mapping_of(values, known, direction)
    current = values_of(channel)
    checked = {name: checks.number(value, f"{direction} {name}") for name, value in values.items()}
    for name, value in checked.items():
        lower, upper, open_below = _admissible(known[name], channel, current[name], uncertainty)
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
    searched = [(each.lower, each.upper) for each in estimates if each.name == parameter.name]
    lowers, uppers = zip((parameter.lower, parameter.upper), (current, current), *searched, strict=True)
    lower = 0.0 if parameter.name == DEAD_TIME.name else min(lowers)
    return lower, max(uppers), False


def _changed(channel: Channel, values: Mapping[str, float]) -> Channel:
    """Return a channel with other values, without compensators; its range covers the same commands."""
    dead_zone = values.get(DEAD_ZONE.name, channel.dead_zone)
    return replace(
        channel,
        dead_zone=dead_zone,
        benchmark=_changed_benchmark(channel.benchmark, values),
        operating_range=_shifted(channel.operating_range, channel.dead_zone - dead_zone),
        compensator=None,
        speed_compensator=None,
    )


def _changed_benchmark(benchmark: PhysicalModel, values: Mapping[str, float]) -> PhysicalModel:
    row = [
        values.get(parameter.name, current)
        for parameter, current in zip(
            benchmark.parameters, map(float, benchmark.parameter_vector), strict=True
        )
    ]
    return benchmark.with_parameter_vector(jnp.asarray(row))


def _shifted(operating_range: OperatingRange, shift: float) -> OperatingRange:
    """Return the range with effective commands moved by a shift; closed valves stay in it."""
    command = operating_range.command
    lowest = jnp.where(command.lowest > 0, jnp.maximum(command.lowest + shift, 0.0), command.lowest)
    ends = (lowest, command.highest + shift)
    return eqx.tree_at(lambda tree: (tree.command.lowest, tree.command.highest), operating_range, ends)


def _without_intervals(estimates: Estimates, values: Mapping[str, float]) -> Estimates:
    """Return estimates without the intervals of set parameters, and of those that depend on them.

    The fit of parameter j, with those in the set S held at values z_S standard errors from their estimates,
    is R_jS R_SS⁻¹ z_S standard errors from its own estimate, R the correlation matrix. An interval stays
    where that is at most a tenth. None stays where the dead zone or another parameter was set that was not
    estimated with them, or one without a standard error, whose correlations are not known.
    """
    parameters = estimates.parameters
    known = {parameter.name for parameter in parameters}
    selected = [number for number, parameter in enumerate(parameters) if parameter.name in values]
    steps = np.array([_standard_steps(parameters[i], values[parameters[i].name]) for i in selected])
    correlation = np.array(estimates.correlation)
    if known >= set(values) and np.all(np.isfinite(steps)) and correlation.size:
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
