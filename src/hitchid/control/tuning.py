"""Tuning of a position controller: the fastest that keeps its margins for what the tests leave open."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.progress import ProgressCallback, ProgressUpdate, silent
from hitchid._support.records import short_repr
from hitchid.control.controller import Gains, HitchController, HoldWindow
from hitchid.control.loops import (
    CROSSING_NOISE,
    MAX_SENSITIVITY,
    METHODS,
    MIDDLE,
    MIN_GAIN_DB,
    MIN_PHASE_DEG,
    SHARE,
    STROKE_SHARES,
    DirectionLoops,
    DirectionMargins,
    GainsOf,
    axis_of,
    operating_points,
    pi_gains,
    sensor_noise,
)
from hitchid.control.prediction import drawn_hitches, loads_of_channels, run_on_model
from hitchid.errors import InputError
from hitchid.logs import COMMAND, DIRECTIONS, DISPLACEMENT
from hitchid.model import PARAMETER_DRAWS, Hitch, Load

LOWEST_RAD_S, HIGHEST_RAD_S = 0.05, 30.0  # bandwidths searched; below, a loop takes a minute to settle
BISECTIONS = 12  # of the bandwidth: its resolution is two thousandths
# Of the largest speed: a target that moves no faster is followed, by a hitch that may be faster than its
# model; chosen.
SPEED_SHARE = 1.1
DECELERATION_LAGS = 2.5  # in which the reference stops; chosen: with 1.5, the bench overshoots twice as far
# Half widths of the hold window in standard deviations of the sensor noise, of which the smoothed position
# has a quarter; chosen.
INNER_NOISE, OUTER_NOISE = 0.75, 3.5
RISE_SAMPLES = 1.0  # shortest rise of a current to its largest: no limit but the valve's own; chosen
# Draws on which methods are compared, their steps as a share of the range of displacement, and ramps as far
# as a step in at least this time, s, at no more than half the largest speed; chosen.
TRIAL_DRAWS, TRIAL_SHARE, TRIAL_RAMP_S = 16, 0.1, 2.5
TRIAL_SETTLING_S, TRIAL_START_S = 3.0, 0.5  # s, of a trial run after the longest ramp, and before it; chosen


@short_repr
class OpenLoop(NamedTuple):
    """Open loop of one direction in the middle of its operating points.

    Attributes:
        omega: rad/s, shape [F].
        response: of the model, and of each draw, shape [1 + S, F].
    """

    omega: Float[np.ndarray, " f"]
    response: Complex[np.ndarray, "s f"]


@short_repr
class TrialRun(NamedTuple):
    """Closed loops on models with drawn parameters.

    Attributes:
        time_s: s, shape [N].
        target: in the displacement's unit, shape [N].
        measured: shape [S, N].
    """

    time_s: Float[np.ndarray, " n"]
    target: Float[np.ndarray, " n"]
    measured: Float[np.ndarray, "s n"]

    @property
    def iae(self) -> float:
        """∫ abs(target − measured) dt, the mean of the runs, in the displacement's unit times s."""
        return float(np.abs(self.measured - self.target).sum(axis=1).mean() * self.time_s[1])


@short_repr
@dataclass(frozen=True)
class Tuning:
    """A tuned controller with the reasons for trust in it.

    Attributes:
        controller: tuned.
        method: `PI` or `LQI`, whichever has the smaller error in trial runs.
        trials: method to its IAE over draws, the geometric mean of steps and ramps both ways, in the
            displacement's unit times s.
        margins: direction to its margins.
        load: covariates that it is tuned for, by name; empty without.
        units: of displacement and commands, by role.
        draws: number of parameter vectors of the margins.
        loops: direction to its open loop.
        steps: step up and step down of the controller on drawn models.
    """

    controller: HitchController
    method: str
    trials: Mapping[str, float]
    margins: Mapping[str, DirectionMargins]
    load: Mapping[str, float]
    units: Mapping[str, str]
    draws: int
    loops: Mapping[str, OpenLoop] = field(default_factory=dict)
    steps: tuple[TrialRun, ...] = ()


@double_precision
def tune(
    model: Hitch,
    *,
    load: Load | None = None,
    draws: int = PARAMETER_DRAWS,
    seed: int = 0,
    progress: ProgressCallback = silent,
) -> Tuning:
    """Return the fastest position controller that keeps its margins over draws of the identified parameters.

    In each direction the bandwidth is the largest with which 95 % of the draws keep every margin at nine
    operating points, also where a load that is a fifth heavier than that of the tests is lowered faster, and
    with which the noise of the sensor asks for at most 4 % of the largest speed. Two ways to spend it are
    compared on drawn models: PI control of the predicted position, and LQI with feedback of the predicted
    speed.

    Args:
        model: of both directions, sampled every 10 ms, in any units.
        load: covariates that the controller is tuned for; their mean in the tests by default.
        draws: parameter vectors.
        seed: of the draws.
        progress: called with what is done.

    Raises:
        InputError: the model has another clock, lacks a direction or an integrator, or its
            parameters are too little determined for any bandwidth.
    """
    check_tunable(model)
    progress(ProgressUpdate("operating points", 0.0))
    rows = loads_of_channels(model, load)
    loops, named_load = [], {}
    for direction, row in zip(DIRECTIONS, rows, strict=True):
        loops.append(DirectionLoops.of(model, direction, row, draws, seed))
        covariates = model.channels[direction].benchmark.covariates
        named_load |= dict(zip(covariates, row.tolist(), strict=False))
    trials: dict[str, tuple[HitchController, tuple[TrialRun, ...]]] = {}
    for number, (method, gains_of) in enumerate(METHODS.items(), start=1):
        gains = [own for loop in loops if (own := fastest_gains(loop, gains_of)) is not None]
        if len(gains) < len(loops):
            continue  # a method without gains for both directions is no controller
        controller = _controller(model, gains, rows)
        progress(ProgressUpdate(f"{method}: trial runs", 0.3 * number))
        trials[method] = controller, _trial_runs(controller, model, load, seed)
    if not trials:
        raise InputError(_refusal(loops))
    errors = {
        name: float(np.exp(np.mean([np.log(run.iae) for run in runs]))) for name, (_, runs) in trials.items()
    }
    method = min(errors, key=lambda name: errors[name])
    controller, runs = trials[method]
    tuned = tuple(zip(loops, controller.gains, strict=True))
    return Tuning(
        *(controller, method, errors),
        margins={loop.direction: loop.margins(gains) for loop, gains in tuned},
        load=named_load,
        units={role: model.units[role] for role in (DISPLACEMENT, *COMMAND.values())},
        draws=draws,
        loops={loop.direction: OpenLoop(loop.omega, loop.responses(gains)[MIDDLE]) for loop, gains in tuned},
        steps=runs[:2],
    )


def highest_rad_s(loop: DirectionLoops) -> float:
    """Return the largest bandwidth that is searched, rad/s: that which the noise of the sensor allows."""
    return max(LOWEST_RAD_S, min(HIGHEST_RAD_S, loop.noise_rad_s))


def fastest_gains(loop: DirectionLoops, gains_of: GainsOf) -> Gains | None:
    """Return the gains of the largest bandwidth with all margins; None where the smallest lacks one."""
    highest = highest_rad_s(loop)
    # On a logarithmic scale: the range spans three decades.
    low, high = np.log([LOWEST_RAD_S, highest])

    def gains(log_bandwidth: float) -> Gains:
        return gains_of(float(np.exp(log_bandwidth)), loop.lags, loop.step_s)

    # Bisection needs an end that passes; without one the tests leave too much open.
    if not loop.margins(gains(low)).passed:
        return None
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        tried = gains(middle)
        # The noise is multiplied by the gain on the position, which is not the bandwidth with every method.
        passed = tried.proportional <= highest and loop.margins(tried).passed
        low, high = (middle, high) if passed else (low, middle)
    # The last that has passed, not one between it and the first that has not.
    return gains(low)


def _controller(
    model: Hitch, gains: Sequence[Gains], rows: Sequence[Float[np.ndarray, " c"]]
) -> HitchController:
    channels = tuple(model.channels.values())
    axes = tuple(axis_of(model, channel, row) for channel, row in zip(channels, rows, strict=True))
    noise = sensor_noise(model)
    # Windows and crossing speeds in terms of the noise: a rig with a better sensor holds more closely.
    lags_s = np.array([axis.lags[0] for axis in axes])
    stop_s = DECELERATION_LAGS * np.array([a1 + a2**0.5 for a1, a2 in (axis.lags for axis in axes)])
    middle = jnp.asarray(np.mean([point[1] for point in operating_points(channels[0])]))
    fastest = np.array([float(axis.fastest(middle)) for axis in axes])
    largest = max(axis.largest_command for axis in axes)
    return HitchController(
        axes=(axes[0], axes[1]),
        # Arrays, so that controllers of other gains share their compiled programs.
        gains=(Gains(*map(jnp.asarray, gains[0])), Gains(*map(jnp.asarray, gains[1]))),
        deceleration=jnp.asarray(fastest / np.maximum(stop_s, model.step_s)),
        speed_share=jnp.asarray(SPEED_SHARE),
        lags_s=jnp.asarray(lags_s),
        crossing_speed=jnp.asarray([CROSSING_NOISE * noise * gain.proportional for gain in gains]),
        hold=HoldWindow(jnp.asarray(INNER_NOISE * noise), jnp.asarray(OUTER_NOISE * noise)),
        rate=jnp.asarray(largest / (RISE_SAMPLES * model.step_s)),
    )


def _trial_runs(
    controller: HitchController, model: Hitch, load: Load | None, seed: int
) -> tuple[TrialRun, ...]:
    """Return steps, then ramps, on drawn models: margins say what is safe, but not which method is faster."""
    hitches = drawn_hitches(controller, model, load, TRIAL_DRAWS, seed)
    if hitches is None:
        raise InputError("model: its parameters have no standard errors")
    points = [displacement for _, displacement in operating_points(model.channels[DIRECTIONS[0]])]
    middle, travel = float(np.mean(points)), TRIAL_SHARE * float(np.ptp(points) / np.ptp(STROKE_SHARES))
    # Ramps that both directions can follow.
    slowest = min(float(axis.fastest(jnp.asarray(middle))) for axis in controller.axes)
    ramp_s = max(TRIAL_RAMP_S, 2 * travel / slowest)
    time_s = np.arange(0.0, TRIAL_START_S + ramp_s + TRIAL_SETTLING_S, model.step_s)
    moving_s = time_s - TRIAL_START_S
    step = np.where(moving_s < 0, 0.0, travel)
    ramp = travel * np.clip(moving_s / ramp_s, 0.0, 1.0)
    runs = []
    for number, way in enumerate((step, -step, ramp, -ramp)):
        # Equal noise and draws for all methods, others for each way.
        target, key = middle + way, jax.random.key(seed + number)
        measured = run_on_model(controller, hitches, key, target, start=middle)
        runs.append(TrialRun(time_s, target, measured))
    return tuple(runs)


def check_tunable(model: Hitch) -> None:
    """Raise unless a model has the clock, the directions and the structures of a hitch.

    Raises:
        InputError: the model has another clock, or lacks a direction or an integrator.
    """
    checks.instance(model, Hitch, "model", "a model as hitchid.load returns it")
    missing = [direction for direction in DIRECTIONS if direction not in model.channels]
    if missing:
        raise InputError(f"model: has no {missing[0]} channel; a position controller needs both directions")
    if not np.isclose(model.step_s, 0.01):
        raise InputError(f"model: its sampling time is {model.step_s:g} s, expected 0.01 s")
    for direction, channel in model.channels.items():
        structure, values = channel.benchmark.structure, channel.benchmark.values
        # No derivative depends on the displacement of an integrator: constant current moves it for ever.
        if structure.linear is None or np.any(np.asarray(structure.linear.state_space(values)[0])[:, 0] != 0):
            raise InputError(
                f"model: the {direction} structure '{structure.name}' has no steady speed at constant "
                "current; a position controller needs a linear structure with an integrator"
            )
        if not np.isfinite(float(channel.operating_range.command.highest)):
            raise InputError(
                f"model: the range of its {direction} test commands is not stored; identify it again"
            )


def _refusal(loops: Sequence[DirectionLoops]) -> str:
    """Return why no bandwidth has its margins, and which test would help."""
    # At the smallest bandwidth that is searched: no other has been looked at.
    slowest = [loop.margins(pi_gains(LOWEST_RAD_S, loop.lags, loop.step_s)) for loop in loops]
    number = next((number for number, own in enumerate(slowest) if not own.passed), 0)
    loop, worst = loops[number], slowest[number].worst
    return (
        f"model: the {loop.direction} parameters are too little determined for a controller: at "
        f"{LOWEST_RAD_S:g} rad/s 95 % of the draws have {worst.gain_db:.1f} dB gain margin, "
        f"{worst.phase_deg:.0f}° phase margin, Ms {worst.sensitivity:.2f} and {1e3 * worst.delay_s:.0f} ms "
        f"delay margin; expected {MIN_GAIN_DB:g} dB, {MIN_PHASE_DEG:g}°, {MAX_SENSITIVITY:g} and "
        f"{2e3 * loop.dead_time_s:.0f} ms; run the test of hitchid design MODEL --for control"
    )


# What limits a controller: a parameter that its margins depend on, or the noise of its sensor.

CAPPED = 0.99  # of the largest bandwidth that is searched; the search ends within a thousandth of it


@short_repr
@dataclass(frozen=True)
class Limitation:
    """What the tests of one direction leave open, as far as it limits the controller.

    Attributes:
        direction: lifting or lowering.
        bandwidth_rad_s: largest of PI control with all margins, or that at the bound of `limit`.
        limit: what ends the bandwidth: the `margins`; or before them the `noise` of the sensor, which asks
            for 4 % of the largest speed there, or the end of the `search` at 30 rad/s. Noise is as
            identified, and may contain what the model misses.
        nominal: Ms at the worst operating point with the identified parameters.
        worst: Ms that 95 % of the draws keep there.
        shares: parameter to the share of the variance of log Ms over draws that would vanish with this
            parameter known, to first order; the largest first.
    """

    direction: str
    bandwidth_rad_s: float
    limit: Literal["margins", "noise", "search"]
    nominal: float
    worst: float
    shares: Mapping[str, float]

    @property
    def parameter(self) -> str:
        """The parameter with the largest share."""
        return next(iter(self.shares))


@double_precision
def limitation(
    model: Hitch,
    direction: str | None = None,
    *,
    load: Load | None = None,
    draws: int = PARAMETER_DRAWS,
    seed: int = 0,
) -> Limitation:
    """Return what limits the controller in the direction where the parameters' spread costs Ms the most.

    A direction that its margins limit comes before one that the noise of the sensor does.

    At the largest bandwidth of PI control that keeps its margins, log Ms of a draw is correlated with each of
    its parameters over all draws; the squared correlation is the share of its variance that goes with the
    parameter. Ms bounds gain and phase margin (Skogestad & Postlethwaite 2005, sec. 2.4.3).

    Args:
        model: of both directions, sampled every 10 ms, in any units.
        direction: only this one.
        load: covariates that the controller is tuned for; their mean in the tests by default.
        draws: parameter vectors.
        seed: of the draws.

    Raises:
        InputError: the model cannot be tuned, or has no parameter with a standard error.
    """
    check_tunable(model)
    if direction is not None:
        checks.one_of(direction, DIRECTIONS, "direction")
    limitations = [
        _limitation(model, name, row, draws, seed)
        for name, row in zip(DIRECTIONS, loads_of_channels(model, load), strict=True)
        if direction in (None, name)
    ]
    return max(limitations, key=lambda own: (own.limit == "margins", own.worst / own.nominal))


def _limitation(
    model: Hitch, direction: str, row: Float[np.ndarray, " c"], draws: int, seed: int
) -> Limitation:
    loops = DirectionLoops.of(model, direction, row, draws, seed)
    fastest = fastest_gains(loops, pi_gains)
    # A model that is refused has no such bandwidth; it is judged at the smallest that is searched.
    gains = fastest or pi_gains(LOWEST_RAD_S, loops.lags, loops.step_s)
    limit = "noise" if loops.noise_rad_s < HIGHEST_RAD_S else "search"
    if fastest is None or fastest.proportional < CAPPED * highest_rad_s(loops):
        limit = "margins"
    # Of the model, then of each draw, at its worst operating point.
    sensitivity = np.max([point.sensitivity for point in loops.margins_at_points(gains)], axis=0)
    names = [parameter.name for parameter in model.channels[direction].benchmark.parameters]
    # Logarithms: Ms of a draw near its stability limit has no bound.
    logs = np.log(np.minimum(sensitivity[1:], np.finfo(float).max))
    shares = {
        name: float(np.corrcoef(column, logs)[0, 1] ** 2)
        for name, column in zip(names, loops.vectors.T, strict=True)
        if np.ptp(column) > 0 and np.ptp(logs) > 0
    }
    if not shares:
        raise InputError(f"model: no {direction} parameter changes the margins; no test helps the controller")
    return Limitation(
        direction,
        float(gains.proportional),
        limit,
        float(sensitivity[0]),
        float(np.quantile(sensitivity[1:], SHARE)),
        dict(sorted(shares.items(), key=lambda item: -item[1])),
    )
