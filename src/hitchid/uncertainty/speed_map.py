"""Speed map, delay and response time of a fitted model, with 95 % intervals."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid.estimation import Objective
from hitchid.handover.responses import speed_lag, step_times
from hitchid.model.estimates import (
    TIME_RESOLUTION_SAMPLES,
    Characteristics,
    Interval,
    MeasuredSpeed,
    Quantity,
    SpeedPoint,
    make_quantity,
)
from hitchid.structures import Batch, ModelSpec, PhysicalModel, Scales, opening_command, speeds_at
from hitchid.structures.nonlinearity import OPENING
from hitchid.uncertainty.influence import Influence
from hitchid.uncertainty.profile import MIN_PACE, Profile
from hitchid.uncertainty.profile import STEP as EDGE
from hitchid.uncertainty.scores import DeadZoneError, combined_variance, t_quantile

# Operating points of the tests: command levels, loads, and speeds measured at constant command.

LEVEL_TOLERANCE = 0.01  # changes of the command below this share of the largest are noise; all chosen
# Width of a level in tolerances, number of levels, share of the active samples in one level and in all.
MAX_LEVEL_WIDTH, MAX_LEVELS, MIN_LEVEL_SHARE, MIN_STEADY_SHARE = 3, 9, 0.02, 0.8
QUANTILES, GRID_LEVELS = (0.05, 0.95), 7  # of the evenly spaced levels: end quantiles, number
SETTLING_RESPONSE_TIMES, MIN_SAMPLES, MAX_STRETCHES = 3.0, 5, 100  # before a speed is taken; samples; speeds
MIDDLE_SHARE = 0.5  # middle part of the displacement range in which speeds are taken


def operating_levels(batch: Batch, opening: float) -> Float[np.ndarray, " l"]:
    """Return the command levels of the tests, ascending, shape [L].

    If at most 9 levels contain 80 % of the samples above `opening`, these; otherwise 7 evenly spaced levels
    from the 5 % to the 95 % quantile of those samples.
    """
    logged = np.abs(np.asarray(batch.raw_command))[np.asarray(batch.loss_mask)]
    active_commands = np.sort(logged[logged > opening])
    if not active_commands.size:
        return active_commands
    bins = np.round(active_commands / (LEVEL_TOLERANCE * active_commands[-1])).astype(int)
    groups = np.split(active_commands, np.flatnonzero(np.diff(bins) > 1) + 1)
    steady = [group for group in groups if group.size >= MIN_LEVEL_SHARE * active_commands.size]
    narrow = all(np.ptp(group) <= MAX_LEVEL_WIDTH * LEVEL_TOLERANCE * active_commands[-1] for group in steady)
    if (
        narrow
        and len(steady) <= MAX_LEVELS
        and sum(map(len, steady)) >= MIN_STEADY_SHARE * active_commands.size
    ):
        return np.array([np.median(group) for group in steady])
    slowest, fastest = np.quantile(active_commands, QUANTILES)
    return np.linspace(slowest, fastest, GRID_LEVELS)


def operating_loads(load: Float[np.ndarray, " t"]) -> Float[np.ndarray, " k"]:
    """Return mean and mean ± standard deviation of a covariate, clipped to its range, shape [K]."""
    mean, deviation = load.mean(), load.std()
    return np.unique(np.clip([mean - deviation, mean, mean + deviation], load.min(), load.max()))


def measured_speeds(
    batch: Batch, opening: float, response_time: float, load: Float[np.ndarray, " t"] | None
) -> tuple[MeasuredSpeed, ...]:
    """Return mean speeds around mid stroke at constant command, by command; the 100 longest stretches.

    A stretch begins three response times after the last change of its command, lies in the middle half of
    the displacement range and has at least five samples.
    The response time is in s, the load that of the speed map, of each test.
    """
    loss_mask, displacement = np.asarray(batch.loss_mask), np.asarray(batch.displacement)
    logged = np.abs(np.asarray(batch.raw_command))
    travel = np.sign(np.asarray(batch.raw_command)) * np.asarray(batch.travel)
    low, high = displacement[loss_mask].min(), displacement[loss_mask].max()
    middle = np.abs(displacement - 0.5 * (low + high)) <= MIDDLE_SHARE * 0.5 * (high - low)
    settling_samples = int(np.ceil(SETTLING_RESPONSE_TIMES * response_time / batch.step_s)) + 1
    sized_speeds: list[tuple[int, MeasuredSpeed]] = []
    loads = [None] * len(logged) if load is None else load.tolist()
    for row, test_load in enumerate(loads):
        changed = np.abs(np.diff(logged[row])) > LEVEL_TOLERANCE * logged.max()
        for stretch in np.split(np.arange(logged.shape[1]), np.flatnonzero(changed) + 1):
            steady_samples = stretch[settling_samples:]
            steady_samples = steady_samples[(loss_mask & middle)[row, steady_samples]]
            command = float(np.median(logged[row, stretch]))
            if (
                steady_samples.size < MIN_SAMPLES
                or command <= opening
                or np.ptp(logged[row, steady_samples]) > 2 * LEVEL_TOLERANCE * command
            ):
                continue
            time_s = batch.step_s * (steady_samples - steady_samples[0])
            speed = np.polyfit(time_s, travel[row, steady_samples], 1)[0]
            sized_speeds.append((steady_samples.size, MeasuredSpeed(command, test_load, float(speed))))
    # The more samples, the more certain is the slope.
    longest = sorted(sized_speeds, key=lambda entry: -entry[0])[:MAX_STRETCHES]
    return tuple(sorted((speed for _, speed in longest), key=lambda entry: entry.command))


GRADIENT_STEP, TINY = 1e-3, 1e-300  # of differences, in the unit cube, chosen; smallest speed divided by
INSTANT_S = 1e-6  # response time, s, below which a model has neither lag nor dead time; chosen
BATCH_SIZE = 64  # positions evaluated at once, padded so that one compiled function serves all; chosen
# Widths of an interval that count as determined: of delay and response time over the sampling time, and of
# the opening over the largest command; chosen.
RESOLUTIONS = np.array([TIME_RESOLUTION_SAMPLES, TIME_RESOLUTION_SAMPLES, 0.05])


class _Points(NamedTuple):
    """Operating points: levels and loads of the speed map, level and load of the step, dead zone."""

    levels: Float[Array, " s"]
    loads: Float[Array, "s c"]
    level: Float[Array, ""]
    load: Float[Array, " c"]
    dead_zone: Float[Array, ""]


def characteristics(
    objective: Objective,
    position: np.ndarray,
    influence: Influence,
    *,
    dead_zone: Quantity,
    dead_zone_error: DeadZoneError,
    units: Mapping[str, str],
) -> Characteristics | None:
    """Return speed map, dead zone, delay and response time of a fitted model, each with its 95 % interval.

    How an interval follows from the influence of the tests: see `_intervals`.

    Args:
        objective: identification tests and model specification.
        position: the estimates in the unit cube, shape [D].
        influence: influence of the tests on the estimates.
        dead_zone, dead_zone_error: dead zone of the command, and its standard error.
        units: `x` and `u` to the units of displacement and command.

    Returns:
        None for a nonlinear structure, or where no command exceeds the opening.
    """
    model_spec, batch = objective.spec, objective.batch
    largest = float(np.abs(np.asarray(batch.raw_command)[np.asarray(batch.loss_mask)]).max())
    if model_spec.structure.linear is None:
        return None
    physical_model = model_spec.physical_model(jnp.asarray(objective.values(position)), objective.scales)
    opening = float(opening_command(physical_model, dead_zone.value))
    levels = operating_levels(batch, opening)
    if not levels.size:
        return None
    load_name, test_loads = _varied_load(physical_model, batch)
    commands, loads, load_rows = _speed_map_grid(physical_model, levels, load_name, test_loads)
    level, mean_load = float(levels[levels.size // 2]), np.asarray(physical_model.mean_load)
    points = _Points(*map(jnp.asarray, (commands, load_rows, level, mean_load, dead_zone.value)))
    values = _evaluate(objective, position[None], points)[0]
    # Relative to these, how fast a quantity changes is compared with a parameter; see `_open_ends`.
    scales = np.concatenate([np.maximum(values[:-3], TINY), [batch.step_s, batch.step_s, largest]])
    intervals = _intervals(objective, position, influence, points, dead_zone_error, scales)
    fastest = float(values[:-3].max())
    speeds = zip(commands.tolist(), loads, values[:-3].tolist(), intervals[:-3], strict=True)
    names, resolutions = ("delay", "response time", "opening"), (RESOLUTIONS * scales[-3:]).tolist()
    times = zip(names, ("s", "s", units["u"]), values[-3:].tolist(), intervals[-3:], resolutions, strict=True)
    delay, response_time, opening_quantity = (make_quantity(*row) for row in times)
    has_lag = response_time.value > INSTANT_S
    return Characteristics(
        command_unit=units["u"],
        speed_unit=f"{units['x']}/s",
        load=load_name,
        dead_zone=dead_zone,
        opening=opening_quantity if OPENING in {p.name for p in model_spec.parameters} else None,
        level=level,
        delay=delay if has_lag else None,
        response_time=response_time if has_lag else None,
        speed_map=tuple(SpeedPoint.of(*row, fastest) for row in speeds),
        measured=measured_speeds(batch, opening, response_time.value, test_loads),
    )


def _varied_load(physical_model: PhysicalModel, batch: Batch) -> tuple[str | None, np.ndarray | None]:
    """Return the covariate with the largest effect on the speed and its value in each test; None without."""
    if physical_model.scheduling is None:
        return None, None
    sizes = np.abs(np.asarray(physical_model.scheduling.effects)[0]).sum(axis=1)
    name = physical_model.covariates[int(np.argmax(sizes))]
    return name, np.asarray(batch.load([name]))[:, 0]


def _speed_map_grid(
    physical_model: PhysicalModel, levels: np.ndarray, load_name: str | None, test_loads: np.ndarray | None
) -> tuple[np.ndarray, Sequence[float | None], np.ndarray]:
    """Return command, load and all covariates of each point, levels by loads; the others have their mean."""
    loads = np.zeros(1) if test_loads is None else operating_loads(test_loads)
    commands, grid_loads = (grid.ravel() for grid in np.meshgrid(levels, loads, indexing="ij"))
    load_rows = np.tile(np.asarray(physical_model.mean_load), (grid_loads.size, 1))
    if load_name is None:
        return commands, [None] * commands.size, load_rows
    load_rows[:, physical_model.covariates.index(load_name)] = grid_loads
    return commands, grid_loads.tolist(), load_rows


def _intervals(
    objective: Objective,
    position: np.ndarray,
    influence: Influence,
    points: _Points,
    dead_zone_error: DeadZoneError,
    scales: np.ndarray,
) -> list[Interval]:
    """Return the 95 % interval of each quantity; `scales` are the quantities' reference values, shape [Q].

    The interval of a quantity q is q ± t √(Σₜ (∇q·δₜ)² + δ₀²), with δₜ the influence of test t on the
    estimates, δ₀ the change of q per standard error of the dead zone, parameters refitted, and t Student's
    quantile at the degrees of freedom of that sum. It is widened to the range over the allowed points of the
    profiles whose RMSE is close to the best, and open above where q rises with a parameter beyond an open end
    of its profile. The lower end is at least zero.
    """

    def scaled_quantities(positions: np.ndarray, points: _Points = points) -> np.ndarray:
        return _evaluate(objective, positions, points) / scales

    best = scaled_quantities(position[None])[0]
    gradient = _gradient(scaled_quantities, position)
    # Refitted, a gain makes up for most of the dead zone's error: a speed that occurred hardly changes.
    above, below = (
        scaled_quantities(estimate[None], points._replace(dead_zone=points.dead_zone + shift))[0]
        for estimate, shift in zip(
            influence.shifted_estimates,
            (dead_zone_error.standard_error, -dead_zone_error.standard_error),
            strict=True,
        )
    )
    half_widths = _half_widths(influence, gradient, 0.5 * (above - below), dead_zone_error)
    lower, upper = best - half_widths, best + half_widths
    # Largest ratio of an RMSE to the best, √(1 + t²/(T − D)): with few tests the test of a profile has little
    # power far from the estimate, and this limits its range.
    degrees = max(len(influence.by_test) - int(influence.free.sum()), 1)
    max_ratio = float(np.sqrt(1 + t_quantile(float(degrees)) ** 2 / degrees))
    for profile in influence.profiles:
        well_fitted = profile.allowed & (profile.fitness <= max_ratio * profile.fitness.min())
        allowed = scaled_quantities(profile.positions[well_fitted])
        lower, upper = np.minimum(lower, allowed.min(axis=0)), np.maximum(upper, allowed.max(axis=0))
    for profile in influence.profiles:
        open_below, open_above = _open_ends(profile, scaled_quantities, lower, upper, max_ratio)
        lower, upper = np.where(open_below, 0.0, lower), np.where(open_above, np.inf, upper)
    # The interval of a speed that is zero at the estimate has no upper end: its scale is not defined.
    upper = np.where(best > 0, upper, np.inf)
    with np.errstate(over="ignore"):
        lower, upper = scales * np.nan_to_num(lower, nan=0.0), scales * upper
    return [
        (max(0.0, float(low)), float(high) if np.isfinite(high) else None)
        for low, high in zip(lower, upper, strict=True)
    ]


def _gradient(
    quantities: Callable[[np.ndarray], np.ndarray], position: np.ndarray
) -> Float[np.ndarray, "d q"]:
    """Return derivatives by the position, central differences with Richardson extrapolation, shape [D, Q]."""
    steps = GRADIENT_STEP * np.eye(position.size)
    near, far = (
        np.subtract(*np.split(quantities(np.concatenate([position + width, position - width])), 2))
        / (2 * GRADIENT_STEP)
        for width in (steps, 2 * steps)
    )
    return (4 * near - 0.5 * far) / 3


def _half_widths(
    influence: Influence, gradient: np.ndarray, dead_zone_effect: np.ndarray, dead_zone_error: DeadZoneError
) -> Float[np.ndarray, " q"]:
    """Return half the 95 % interval of each quantity; infinite where a derivative is not finite."""
    finite = np.all(np.isfinite(gradient), axis=0) & np.isfinite(dead_zone_effect)
    gradient, dead_zone_effect = np.where(finite, gradient, 0.0), np.where(finite, dead_zone_effect, 0.0)
    by_test = influence.by_test @ gradient
    test_degrees = influence.scores.degrees_of_freedom(gradient[influence.free])
    variances, degrees = combined_variance(by_test, dead_zone_effect, test_degrees, dead_zone_error)
    widths = np.array([t_quantile(float(degree)) for degree in degrees]) * np.sqrt(variances)
    return np.where(finite, widths, np.inf)


def _open_ends(
    profile: Profile,
    quantities: Callable[[np.ndarray], np.ndarray],
    lower: np.ndarray,
    upper: np.ndarray,
    max_ratio: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return which quantities fall, and which rise, beyond an interval at a profile's open ends, shape [Q].

    A quantity must be at the end of its interval there and change at more than a tenth of the parameter's
    rate, as in `open_ends` of a profile.
    """
    open_below = open_above = np.zeros(lower.size, dtype=bool)
    for number, step in [(0, -EDGE)] * (profile.lower is None) + [(-1, EDGE)] * (profile.upper is None):
        if profile.fitness[number] > max_ratio * profile.fitness.min():
            continue
        end, outward = profile.positions[number], step * profile.tangents[number]
        centre, forward, backward = quantities(np.stack([end, end + outward, end - outward]))
        with np.errstate(invalid="ignore"):  # a quantity that is infinite on both sides does not change
            pace = (forward - backward) / (2 * EDGE * profile.search_range)
        open_below, open_above = (
            open_below | (centre <= lower) & (pace < -MIN_PACE),
            open_above | (centre >= upper) & (pace > MIN_PACE),
        )
    return open_below, open_above


def _evaluate(objective: Objective, positions: np.ndarray, points: _Points) -> Float[np.ndarray, "p q"]:
    """Return the quantities at each position: speeds, then delay, response time and opening.

    Positions and operating points are padded, so that one program serves campaigns of any number of levels.
    """
    structure, rows = objective.spec.structure.require_linear(), []
    count = points.levels.size
    padding = (0, -count % MAX_LEVELS)
    # A program for each number of command levels would take half a second to compile.
    padded_points = points._replace(
        levels=jnp.asarray(np.pad(points.levels, padding, mode="edge")),
        loads=jnp.asarray(np.pad(points.loads, (padding, (0, 0)), mode="edge")),
    )
    for start in range(0, len(positions), BATCH_SIZE):
        chunk = positions[start : start + BATCH_SIZE]
        padded = np.concatenate([chunk, np.repeat(chunk[-1:], BATCH_SIZE - len(chunk), axis=0)])
        values = objective.values(padded)
        lags = [speed_lag(structure, row[: len(structure.parameters)]) for row in values]
        quantities = _quantities(
            objective.spec, objective.scales, jnp.asarray(values), jnp.asarray(lags), padded_points
        )
        rows.append(np.asarray(quantities)[: len(chunk)])
    return np.delete(np.concatenate(rows), np.s_[count : count + padding[1]], axis=1)


@eqx.filter_jit
def _quantities(
    model_spec: ModelSpec,
    scales: Scales,
    values: Float[Array, "p d"],
    lags: Float[Array, " p"],
    points: _Points,
) -> Float[Array, "p q"]:
    def quantities_at(values: Float[Array, " d"], lag_s: Float[Array, ""]) -> Float[Array, " q"]:
        physical_model = model_spec.physical_model(values, scales)
        middle = jnp.broadcast_to(scales.centre, points.levels.shape)
        speeds = speeds_at(physical_model, points.levels, middle, points.loads, points.dead_zone)
        at_load = physical_model.at_load(points.load)
        times = step_times(at_load, points.level, points.dead_zone, lag_s)
        opening = opening_command(at_load, points.dead_zone)
        return jnp.concatenate([speeds, jnp.stack([*times, opening])])

    return jax.vmap(quantities_at)(values, lags)
