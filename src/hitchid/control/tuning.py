"""Tuning of a position controller: the fastest that keeps its margins for what the tests leave open."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.progress import ProgressCallback, ProgressUpdate, silent
from hitchid._support.short_repr import short_repr
from hitchid.control.controller import Gains, HitchController, HoldWindow
from hitchid.control.direction_loops import (
    MAX_SENSITIVITY,
    MIDDLE,
    MIN_GAIN_DB,
    MIN_PHASE_DEG,
    DirectionLoops,
    DirectionMargins,
    axis_of,
    operating_points,
)
from hitchid.control.gain_design import METHODS, GainsOf, pi_gains
from hitchid.control.prediction import drawn_hitches, loads_of_channels, run_on_model
from hitchid.data.record import COMMAND, DIRECTIONS, DISPLACEMENT
from hitchid.errors import InputError
from hitchid.model import Channel, Hitch
from hitchid.model.loads import Load
from hitchid.model.parameter_draws import DRAWS

LOWEST_RAD_S, HIGHEST_RAD_S = 0.5, 30.0  # bandwidths searched; below, a plant of 0.1 s lag needs no model
BISECTIONS = 12  # of the bandwidth: its resolution is a thousandth
SPEED_SHARE = 0.985  # of the largest speed for the reference: 1.5 % are left to correct errors; chosen
# The reference takes so many lags to full speed; chosen: with one, the bench overshoots where it brakes.
ACCELERATION_LAGS = 2.0
# Standard deviations of the sensor noise: half widths of the hold window, and the error below which a current
# falls to zero; the smoothed position has a sixth of the noise.
INNER_NOISE, OUTER_NOISE, CROSSING_NOISE = 1.5, 6.0, 3.0
MIN_NOISE_MM = 0.02  # mm, for a sensor without noise: a window of 0.12 mm; chosen
RISE_SAMPLES = 2.0  # shortest rise of a current to its largest; chosen
# Draws, steps and ramps on which methods are compared; chosen.
TRIAL_DRAWS, TRIAL_STEPS_MM, TRIAL_RAMPS_MM_S = 16, (20.0, -20.0), (8.0, -8.0)
TRIAL_S, TRIAL_START_S, TRIAL_RAMP_S = 8.0, 0.5, 2.5  # s, of a trial run, and of its ramp: as far as a step


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
        target_mm: shape [N].
        measured_mm: shape [S, N].
    """

    time_s: Float[np.ndarray, " n"]
    target_mm: Float[np.ndarray, " n"]
    measured_mm: Float[np.ndarray, "s n"]

    @property
    def iae_mm_s(self) -> float:
        """∫ abs(target − measured) dt, the mean of the runs, mm·s."""
        return float(np.abs(self.measured_mm - self.target_mm).sum(axis=1).mean() * self.time_s[1])


@short_repr
@dataclass(frozen=True)
class Tuning:
    """A tuned controller with the reasons for trust in it.

    Attributes:
        controller: tuned.
        method: `PI` or `LQI`, whichever has the smaller error in trial runs.
        trials: method to its IAE over draws, the geometric mean of steps and ramps both ways, mm·s.
        margins: direction to its margins.
        load: covariates that it is tuned for, by name; empty without.
        draws: number of parameter vectors of the margins.
        loops: direction to its open loop.
        steps: step up and step down of the controller on drawn models.
    """

    controller: HitchController
    method: str
    trials: Mapping[str, float]
    margins: Mapping[str, DirectionMargins]
    load: Mapping[str, float]
    draws: int
    loops: Mapping[str, OpenLoop] = field(default_factory=dict)
    steps: tuple[TrialRun, ...] = ()


@double_precision
def tune(
    model: Hitch,
    *,
    load: Load | None = None,
    draws: int = DRAWS,
    seed: int = 0,
    progress: ProgressCallback = silent,
) -> Tuning:
    """Return the fastest position controller that keeps its margins over draws of the identified parameters.

    In each direction the bandwidth is the largest with which 95 % of the draws keep every margin at nine
    operating points. Two ways to spend it are compared on drawn models: PI control of the predicted position,
    and LQI with feedback of the predicted speed.

    Args:
        model: of both directions, in mm, A and s, sampled every 10 ms.
        load: covariates that the controller is tuned for; their mean in the tests by default.
        draws: parameter vectors.
        seed: of the draws.
        progress: called with what is done.

    Raises:
        InputError: the model has other units or another clock, lacks a direction or an integrator, or its
            parameters are too little determined for any bandwidth.
    """
    check_tunable(model)
    progress(ProgressUpdate("operating points", 0.0))
    rows = loads_of_channels(model, load)
    loops = [
        DirectionLoops.of(model, direction, row, draws, seed)
        for direction, row in zip(DIRECTIONS, rows, strict=True)
    ]
    trials: dict[str, tuple[HitchController, tuple[TrialRun, ...]]] = {}
    for number, (method, gains_of) in enumerate(METHODS.items(), start=1):
        gains = [found for loop in loops if (found := fastest_gains(loop, gains_of)) is not None]
        if len(gains) < len(loops):
            continue
        controller = _controller(model, gains, rows)
        progress(ProgressUpdate(f"{method}: trial runs", 0.3 * number))
        trials[method] = controller, _trial_runs(controller, model, load, seed)
    if not trials:
        raise InputError(_refusal(loops))
    errors = {
        name: float(np.exp(np.mean([np.log(run.iae_mm_s) for run in runs])))
        for name, (_, runs) in trials.items()
    }
    method = min(errors, key=lambda name: errors[name])
    controller, runs = trials[method]
    return Tuning(
        controller,
        method,
        errors,
        {loop.direction: loop.margins(gains) for loop, gains in zip(loops, controller.gains, strict=True)},
        _named_load(model, rows),
        draws,
        {
            loop.direction: OpenLoop(loop.omega, loop.responses(gains)[MIDDLE])
            for loop, gains in zip(loops, controller.gains, strict=True)
        },
        runs[: len(TRIAL_STEPS_MM)],
    )


def fastest_gains(loop: DirectionLoops, gains_of: GainsOf) -> Gains | None:
    """Return the gains of the largest bandwidth with all margins; None where the smallest lacks one."""
    low, high = np.log([LOWEST_RAD_S, HIGHEST_RAD_S])

    def gains(log_bandwidth: float) -> Gains:
        return gains_of(float(np.exp(log_bandwidth)), loop.lags, loop.step_s)

    if not loop.margins(gains(low)).passed:
        return None
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if loop.margins(gains(middle)).passed else (low, middle)
    return gains(low)


def _controller(
    model: Hitch, gains: Sequence[Gains], rows: Sequence[Float[np.ndarray, " c"]]
) -> HitchController:
    channels = tuple(model.channels.values())
    axes = tuple(axis_of(model, channel, row) for channel, row in zip(channels, rows, strict=True))
    noise = max(MIN_NOISE_MM, *(float(channel.load_filter.noise) for channel in channels))
    lags_s = np.array([axis.lags[0] for axis in axes])
    rise_s = ACCELERATION_LAGS * np.array([a1 + a2**0.5 for a1, a2 in (axis.lags for axis in axes)])
    middle = jnp.asarray(np.mean([point[1] for point in operating_points(channels[0])]))
    fastest = np.array([float(axis.fastest(middle)) for axis in axes])
    largest = max(axis.largest_a for axis in axes)
    return HitchController(
        axes=(axes[0], axes[1]),
        gains=(gains[0], gains[1]),
        acceleration=jnp.asarray(fastest / np.maximum(rise_s, model.step_s)),
        speed_share=jnp.asarray(SPEED_SHARE),
        lags_s=jnp.asarray(lags_s),
        crossing_mm_s=jnp.asarray([CROSSING_NOISE * noise * gain.proportional for gain in gains]),
        hold=HoldWindow(INNER_NOISE * noise, OUTER_NOISE * noise),
        rate_a_s=jnp.asarray(largest / (RISE_SAMPLES * model.step_s)),
    )


def _trial_runs(
    controller: HitchController, model: Hitch, load: Load | None, seed: int
) -> tuple[TrialRun, ...]:
    """Return steps, then ramps, on drawn models."""
    hitches = drawn_hitches(controller, model, load, TRIAL_DRAWS, seed)
    if hitches is None:
        raise InputError("model: its parameters have no standard errors")
    middle = float(np.mean([place for _, place in operating_points(model.channels[DIRECTIONS[0]])]))
    time_s = np.arange(0.0, TRIAL_S, model.step_s)
    moving_s = time_s - TRIAL_START_S
    ways = [
        *(np.where(moving_s < 0, 0.0, step_mm) for step_mm in TRIAL_STEPS_MM),
        *(speed_mm_s * np.clip(moving_s, 0.0, TRIAL_RAMP_S) for speed_mm_s in TRIAL_RAMPS_MM_S),
    ]
    found = []
    for number, way in enumerate(ways):
        target = middle + way
        runs = run_on_model(controller, hitches, jax.random.key(seed + number), target, start_mm=middle)
        found.append(TrialRun(time_s, target, runs))
    return tuple(found)


def check_tunable(model: Hitch) -> None:
    """Raise unless a model has the units, the clock, the directions and the structures of a hitch.

    Raises:
        InputError: the model has other units or another clock, or lacks a direction or an integrator.
    """
    checks.instance(model, Hitch, "model", "a model as hitchid.load returns it")
    missing = [direction for direction in DIRECTIONS if direction not in model.channels]
    if missing:
        raise InputError(f"model: has no {missing[0]} channel; a position controller needs both directions")
    units = {model.units[DISPLACEMENT]: "mm", **{model.units[COMMAND[d]]: "A" for d in DIRECTIONS}}
    for unit, required in units.items():
        if unit != required:
            raise InputError(f"model: its unit is {unit}, expected {required}: mm and A of a hitch's valves")
    if not np.isclose(model.step_s, 0.01):
        raise InputError(f"model: its sampling time is {model.step_s:g} s, expected 0.01 s")
    for direction, channel in model.channels.items():
        structure = channel.benchmark.structure
        if structure.linear is None or not _integrates(channel):
            raise InputError(
                f"model: the {direction} structure '{structure.name}' has no steady speed at constant "
                "current; a position controller needs a linear structure with an integrator"
            )
        if not np.isfinite(float(channel.operating_range.command.highest)):
            raise InputError(
                f"model: the range of its {direction} test commands is not stored; identify it again"
            )


def _integrates(channel: Channel) -> bool:
    """Return whether the displacement grows for ever at constant current."""
    benchmark = channel.benchmark
    a, _ = benchmark.structure.require_linear().state_space(benchmark.values)
    return bool(np.all(np.asarray(a)[:, 0] == 0))


def _refusal(loops: Sequence[DirectionLoops]) -> str:
    """Return why no bandwidth has its margins, and which test would help."""
    slowest = [loop.margins(pi_gains(LOWEST_RAD_S, loop.lags, loop.step_s)) for loop in loops]
    number = next((number for number, found in enumerate(slowest) if not found.passed), 0)
    loop, worst = loops[number], slowest[number].worst
    return (
        f"model: the {loop.direction} parameters are too little determined for a controller: at "
        f"{LOWEST_RAD_S:g} rad/s 95 % of the draws have {worst.gain_db:.1f} dB gain margin, "
        f"{worst.phase_deg:.0f}° phase margin, Ms {worst.sensitivity:.2f} and {1e3 * worst.delay_s:.0f} ms "
        f"delay margin; expected {MIN_GAIN_DB:g} dB, {MIN_PHASE_DEG:g}°, {MAX_SENSITIVITY:g} and "
        f"{2e3 * loop.dead_time_s:.0f} ms; run the test of hitchid design MODEL --for control"
    )


def _named_load(model: Hitch, rows: Sequence[Float[np.ndarray, " c"]]) -> dict[str, float]:
    named: dict[str, float] = {}
    for channel, row in zip(model.channels.values(), rows, strict=True):
        named |= dict(zip(channel.benchmark.covariates, row.tolist(), strict=False))
    return named
