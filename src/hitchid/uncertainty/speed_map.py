"""Speed map, delay and response time of a fitted form, with the intervals that its parameters hand on."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid.estimation import Misfit
from hitchid.structures import Form, Scales
from hitchid.structures.structure import LinearStructure
from hitchid.uncertainty.characteristics import SAMPLES, Characteristics, SpeedPoint, quantity
from hitchid.uncertainty.dead_zone_error import DeadZoneError, degrees_together, student
from hitchid.uncertainty.estimate import Interval, Quantity
from hitchid.uncertainty.moves import Moves
from hitchid.uncertainty.operating_points import measured_speeds, operating_levels, operating_loads
from hitchid.uncertainty.profile import GOES, Profile
from hitchid.uncertainty.profile import STEP as EDGE
from hitchid.uncertainty.step_response import opening_command, speed_lag, steady_speed, step_times

STEP, TINY = 1e-3, 1e-300
INSTANT_S = 1e-6
TOGETHER = 64
FINE = 0.05


class _Points(NamedTuple):
    """Where quantities are taken: levels and loads of speeds, those of a step, and the dead zone."""

    levels: Float[Array, " s"]
    loads: Float[Array, " s"]
    level: Float[Array, ""]
    load: Float[Array, ""]
    dead_zone: Float[Array, ""]


def characteristics(
    misfit: Misfit,
    position: np.ndarray,
    moved: Moves,
    *,
    dead_zone: Quantity,
    error: DeadZoneError,
    units: Mapping[str, str],
) -> Characteristics | None:
    """Return speed map, dead zone, delay and response time of a fitted form, each with its 95 % interval.

    Each quantity q has the interval q ± t √(Σₜ (∇q·δₜ)² + δ₀²), with δₜ by which each test moves the
    estimates, all of them together, and δ₀ by which q changes with a standard error of the dead zone, the
    parameters fitted anew; t is Student's with the degrees of freedom of that combination. It is widened to
    what profiles allow, the other parameters fitted there, as far as that fits about as well; it is open
    above where a profile has no end and takes the quantity with it. Nothing lies below zero.

    Args:
        misfit: identification tests and form.
        position: the estimates between their bounds, shape [D].
        moved: how far they would move with other tests.
        dead_zone, error: dead zone of the command, and its standard error.
        units: `x` and `u` to the units of displacement and command.

    Returns:
        None where the form has no steady speed, which is where it is not linear, or nothing was commanded.
    """
    form, batch = misfit.form, misfit.batch
    largest = float(np.abs(np.asarray(batch.logged)[np.asarray(batch.counted)]).max())
    loaded = form.load is not None
    if not isinstance(form.structure, LinearStructure):
        return None
    loads = operating_loads(batch, measured=loaded)
    benchmark = form.benchmark(jnp.asarray(misfit.values(position)), misfit.scales)
    opening = float(opening_command(benchmark, float(loads[loads.size // 2]), dead_zone.value))
    levels = operating_levels(batch, opening)
    if not levels.size:
        return None
    middle = float(levels[levels.size // 2]), float(loads[loads.size // 2])
    commands, at_loads = (grid.ravel() for grid in np.meshgrid(levels, loads, indexing="ij"))
    points = _Points(*map(jnp.asarray, (commands, at_loads, *middle, dead_zone.value)))
    values = _evaluated(misfit, position[None], points)[0]
    scales = np.concatenate([np.maximum(values[:-3], TINY), [batch.step_s, batch.step_s, largest]])
    ends = _intervals(misfit, position, moved, points, error, scales)
    fastest = float(values[:-3].max())
    speeds = [
        SpeedPoint.of(float(command), float(load) if loaded else None, float(speed), interval, fastest)
        for command, load, speed, interval in zip(commands, at_loads, values[:-3], ends[:-3], strict=True)
    ]
    named = [
        ("delay", "s", SAMPLES * batch.step_s),
        ("response time", "s", SAMPLES * batch.step_s),
        ("opening", units["u"], FINE * largest),
    ]
    delay, response_time, opens = (
        quantity(name, unit, float(value), interval, resolution)
        for (name, unit, resolution), value, interval in zip(named, values[-3:], ends[-3:], strict=True)
    )
    lags = response_time.value > INSTANT_S
    return Characteristics(
        command_unit=units["u"],
        speed_unit=f"{units['x']}/s",
        load=form.load,
        dead_zone=dead_zone,
        opening=opens if form.curve else None,
        level=middle[0],
        delay=delay if lags else None,
        response_time=response_time if lags else None,
        speed_map=tuple(speeds),
        measured=measured_speeds(batch, opening, response_time.value, loaded=loaded),
    )


def _intervals(
    misfit: Misfit,
    position: np.ndarray,
    moved: Moves,
    points: _Points,
    error: DeadZoneError,
    scales: np.ndarray,
) -> list[Interval]:
    """Return the 95 % interval of each quantity, `scales` being what a change of it is large or small to."""

    def at(positions: np.ndarray, points: _Points = points) -> np.ndarray:
        return _evaluated(misfit, positions, points) / scales

    best = at(position[None])[0]
    gradient = _gradient(at, position)
    beside = _beside(moved, error, at, points)
    reach = _half_widths(moved, gradient, beside, error)
    lower, upper = best - reach, best + reach
    most = _most_worse(len(moved.by_test), int(moved.free.sum()))
    for profile in moved.profiles:
        close = profile.allowed & (profile.fitness <= most * profile.fitness.min())
        allowed = at(profile.positions[close])
        lower, upper = np.minimum(lower, allowed.min(axis=0)), np.maximum(upper, allowed.max(axis=0))
    for profile in moved.profiles:
        falls, rises = _beyond(profile, at, lower, upper, most)
        lower, upper = np.where(falls, 0.0, lower), np.where(rises, np.inf, upper)
    # Nothing says how far from zero a speed is that is zero at the estimate.
    upper = np.where(best > 0, upper, np.inf)
    with np.errstate(over="ignore"):
        lower, upper = scales * np.nan_to_num(lower, nan=0.0), scales * upper
    return [
        (max(0.0, float(low)), float(high) if np.isfinite(high) else None)
        for low, high in zip(lower, upper, strict=True)
    ]


def _gradient(at: Callable[[np.ndarray], np.ndarray], position: np.ndarray) -> Float[np.ndarray, "d q"]:
    """Return derivatives by the position, central differences after Richardson, shape [D, Q]."""
    steps = STEP * np.eye(position.size)
    near, far = (
        np.subtract(*np.split(at(np.concatenate([position + width, position - width])), 2)) / (2 * STEP)
        for width in (steps, 2 * steps)
    )
    return (4 * near - 0.5 * far) / 3


def _half_widths(
    moved: Moves, gradient: np.ndarray, beside: np.ndarray, error: DeadZoneError
) -> Float[np.ndarray, " q"]:
    """Return half the 95 % interval of each quantity; infinite where a derivative is not finite.

    Args:
        moved: by how much each test moves the estimates.
        gradient: of the quantities by the position, shape [D, Q].
        beside: by how much they change with a standard error of the dead zone, shape [Q].
        error: of the dead zone.
    """
    finite = np.all(np.isfinite(gradient), axis=0) & np.isfinite(beside)
    gradient, beside = np.where(finite, gradient, 0.0), np.where(finite, beside, 0.0)
    by_test = moved.by_test @ gradient
    variances = np.stack([np.sum(by_test**2, axis=0), beside**2])
    own = moved.degrees_of(gradient)
    degrees = degrees_together(variances, np.stack([own, np.full_like(own, error.degrees)]))
    widths = np.array([student(float(each)) for each in degrees]) * np.sqrt(variances.sum(axis=0))
    return np.where(finite, widths, np.inf)


def _beside(
    moved: Moves, error: DeadZoneError, at: Callable[..., np.ndarray], points: _Points
) -> Float[np.ndarray, " q"]:
    """Return by how much quantities change with a standard error of the dead zone, parameters fitted anew."""
    above, below = (
        at(position[None], points._replace(dead_zone=points.dead_zone + shift))[0]
        for position, shift in zip(moved.beside, (error.size, -error.size), strict=True)
    )
    return 0.5 * (above - below)


def _most_worse(rows: int, parameters: int) -> float:
    """Return by what factor an RMSE may grow, √(1 + t²/(T − D)), where a test counts as one sample alone.

    A profile's test is weak far from the estimate where tests are few; this keeps to what still fits.
    """
    left = max(rows - parameters, 1)
    return float(np.sqrt(1 + student(float(left)) ** 2 / left))


def _beyond(
    profile: Profile,
    at: Callable[[np.ndarray], np.ndarray],
    lower: np.ndarray,
    upper: np.ndarray,
    most: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Tell which quantities fall, and which rise, beyond an interval where a profile has no end, shape [Q].

    There they must be at the interval's own end, and go on with the parameter by more than a tenth of its
    pace, as `Profile.beyond` has it.
    """
    falls = rises = np.zeros(lower.size, dtype=bool)
    for number, step in [(0, -EDGE)] * (profile.lower is None) + [(-1, EDGE)] * (profile.upper is None):
        if profile.fitness[number] > most * profile.fitness.min():
            continue
        end, outward = profile.positions[number], step * profile.along[number]
        here, onward, back = at(np.stack([end, end + outward, end - outward]))
        pace = (onward - back) / (2 * EDGE * profile.room)
        falls, rises = falls | (here <= lower) & (pace < -GOES), rises | (here >= upper) & (pace > GOES)
    return falls, rises


def _evaluated(misfit: Misfit, positions: np.ndarray, points: _Points) -> Float[np.ndarray, "p q"]:
    """Return the quantities at each position: speeds, then delay, response time and opening."""
    structure, rows = misfit.form.structure, []
    assert isinstance(structure, LinearStructure)  # noqa: S101 - others have no characteristics
    for start in range(0, len(positions), TOGETHER):
        some = positions[start : start + TOGETHER]
        filled = np.concatenate([some, np.repeat(some[-1:], TOGETHER - len(some), axis=0)])
        values = misfit.values(filled)
        lags = [speed_lag(structure, row[: len(structure.parameters)]) for row in values]
        found = _quantities(misfit.form, misfit.scales, jnp.asarray(values), jnp.asarray(lags), points)
        rows.append(np.asarray(found)[: len(some)])
    return np.concatenate(rows)


@eqx.filter_jit
def _quantities(
    form: Form, scales: Scales, values: Float[Array, "p d"], lags: Float[Array, " p"], points: _Points
) -> Float[Array, "p q"]:
    def at(values: Float[Array, " d"], lag_s: Float[Array, ""]) -> Float[Array, " q"]:
        benchmark = form.benchmark(values, scales)
        speeds = steady_speed(benchmark, points.levels, points.loads, points.dead_zone, scales.centre)
        times = step_times(benchmark, points.level, points.load, points.dead_zone, lag_s)
        opening = opening_command(benchmark, points.load, points.dead_zone)
        return jnp.concatenate([speeds, jnp.stack([*times, opening])])

    return jax.vmap(at)(values, lags)
