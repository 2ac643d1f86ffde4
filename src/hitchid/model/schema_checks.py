"""Checks of what belongs together in a description: values with their parameters, sizes with each other."""

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from hitchid._support.bounded import MAX_MAGNITUDE, SMALLEST
from hitchid.model.bands import Bands
from hitchid.model.estimates import Characteristics, Estimates, Information
from hitchid.structures import DEAD_TIME, Parameter, Scale
from hitchid.structures.nonlinearity import NEUTRAL

# Settings of an identification may widen the bounds of a search. How far beyond the default ones a value is
# accepted: by this factor where its logarithm is searched, else by so many of their distances; chosen.
WIDENED, WIDENED_LINEAR = 1000.0, 5.0


def check_values(where: str, values: Sequence[float], parameters: Sequence[Parameter]) -> None:
    """Raise ValueError unless each value is one that its parameter may have; see `admissible`."""
    check_shape(where, values, (len(parameters),))
    for parameter, value in zip(parameters, values, strict=True):
        lower, upper = admissible(parameter)
        if not lower <= value <= upper and value != NEUTRAL.get(parameter.name):
            raise ValueError(f"{where}: {parameter.name}: got {value:g}, expected {lower:.4g} to {upper:.4g}")


def admissible(parameter: Parameter) -> tuple[float, float]:
    """Return the lowest and the highest value of a parameter.

    Where the default bounds are absolute, these, widened; where they scale with the tests, any number. None
    is at or below zero where its logarithm is searched or the default bounds are above, but for a dead time
    of zero, which is none.
    """
    lower, upper = parameter.lower, parameter.upper
    positive = not parameter.linear or lower > 0
    if parameter.scale is not Scale.NONE or "{" in parameter.unit:
        ends = -MAX_MAGNITUDE, MAX_MAGNITUDE
    elif parameter.linear:
        ends = lower - WIDENED_LINEAR * (upper - lower), upper + WIDENED_LINEAR * (upper - lower)
    else:
        ends = lower / WIDENED, WIDENED * upper
    if parameter.name == DEAD_TIME.name or lower == 0:
        return 0.0, ends[1]
    return (max(ends[0], SMALLEST), ends[1]) if positive else ends


def check_estimates(estimates: Estimates, names: Collection[str]) -> None:
    estimated = [estimate.name for estimate in estimates.parameters]
    check_names("parameters", estimated, names)
    for estimate in estimates.parameters:
        ends = [end for end in (estimate.lower, estimate.value, *estimate.interval) if end is not None]
        if not estimate.lower < estimate.upper:
            bounds = f"{estimate.lower:g} and {estimate.upper:g}"
            raise ValueError(f"{estimate.name}: got bounds {bounds}, expected lower < upper")
        if not estimate.linear and min(ends) <= 0:
            raise ValueError(
                f"{estimate.name}: got {min(ends):g}, expected more than 0 on a logarithmic scale"
            )
    check_shape("correlation", estimates.correlation, (len(estimated), len(estimated)))


def check_information(information: Information, estimated: Collection[str]) -> None:
    check_names("names", information.names, estimated)
    count = len(information.names)
    check_shape("slopes", information.slopes, (count,))
    for name in ("curvature", "score_covariance", "dead_zone_covariance"):
        check_shape(name, getattr(information, name), (count, count))
    check_shape("autocovariance", information.autocovariance[:1], (1,))


def check_bands(bands: Bands, parameters: Sequence[Parameter], networks: int) -> None:
    for member in bands.ensemble:
        check_values("ensemble.benchmark", member.benchmark, parameters)
        if member.network is not None and not 0 <= member.network < networks:
            raise ValueError(f"ensemble.network: got {member.network}, expected one of {networks} networks")
    spread = bands.predictions
    levels, horizons = len(bands.levels), len(spread.horizons)
    check_rising("levels", bands.levels)
    check_shape("free_run", bands.free_run, (levels,))
    check_rising("predictions.horizons", spread.horizons)
    check_shape("predictions.movements", spread.movements, (horizons,))
    check_shape("predictions.growths", spread.growths, (horizons,))
    check_shape("predictions.multipliers", spread.multipliers, (horizons, levels))


def check_characteristics(characteristics: Characteristics, covariates: Collection[str]) -> None:
    points, load = characteristics.speed_map, characteristics.load
    if load is not None:
        check_names("load", [load], covariates)
    # A full grid, since a curve is drawn over all commands for each load.
    operating_points = {(point.command, point.load) for point in points}
    commands, loads = {command for command, _ in operating_points}, {load for _, load in operating_points}
    if not points or not len(points) == len(operating_points) == len(commands) * len(loads):
        raise ValueError("speed_map: expected one point for each command at each load, at least one")
    if (load is None) != (loads == {None}) or None in loads - {None}:
        raise ValueError(f"speed_map: expected {'no load' if load is None else 'a load'} in each point")


def check_names(where: str, names: Sequence[str], admitted: Collection[str]) -> None:
    for name in names:
        if name not in admitted or names.count(name) > 1:
            raise ValueError(f"{where}: got '{name}', expected each once, of {listed(admitted)}")


def check_shape(where: str, rows: object, shape: tuple[int, ...]) -> None:
    try:
        actual = np.shape(rows)  # type: ignore[arg-type]
    except ValueError:  # rows of unequal lengths
        actual = None
    if actual != shape and not (0 in shape and actual == (0,)):
        expected = " by ".join(map(str, shape))
        got = "rows of unequal lengths" if actual is None else " by ".join(map(str, actual))
        raise ValueError(f"{where}: got {got}, expected {expected}")


def check_rising(where: str, values: Collection[float | int]) -> None:
    if not values or list(values) != sorted(set(values)):
        raise ValueError(f"{where}: expected rising numbers, at least one")


def listed(names: Collection[str]) -> str:
    return ", ".join(names) or "none"


@contextmanager
def named(name: str) -> Iterator[None]:
    """Put a name before the message of a ValueError."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error
