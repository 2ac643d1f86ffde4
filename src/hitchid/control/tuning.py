"""Tuning of a position controller: the fastest that keeps its margins for what the tests leave open."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.linalg import expm, solve_discrete_are

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.progress import ProgressCallback, ProgressUpdate, silent
from hitchid._support.short_repr import short_repr
from hitchid.control.axis import Axis
from hitchid.control.controller import Gains, HitchController, HoldWindow
from hitchid.control.margins import Margins, margins
from hitchid.control.open_loop import PlantResponse, frequencies, open_loop, plant_response
from hitchid.control.prediction import drawn_hitches, loads_of_channels, run_on_model
from hitchid.data.record import COMMAND, DIRECTIONS, DISPLACEMENT
from hitchid.errors import InputError
from hitchid.model import Channel, Hitch
from hitchid.model.loads import Load
from hitchid.model.parameter_draws import DRAWS, draws_of
from hitchid.structures import SmallSignal, small_signal_at, small_signals

# Bars of the margins, which 95 % of the draws must meet at every operating point; Skogestad & Postlethwaite
# 2005, Multivariable Feedback Control, sec. 2.4.3, ask for Ms below 2, 6 dB and 30°.
MIN_GAIN_DB, MIN_PHASE_DEG, MAX_SENSITIVITY = 6.0, 45.0, 1.7
MIN_DEAD_TIMES = 2.0  # delay margin over the upper end of the dead time's interval
SHARE = 0.95  # of the draws
COMMAND_SHARES = (0.2, 0.5, 0.8)  # of the largest effective command: operating points; chosen
STROKE_SHARES = (0.1, 0.5, 0.9)  # of the displacement's range: operating points; chosen
LOWEST_RAD_S, HIGHEST_RAD_S = 0.5, 30.0  # bandwidths searched; below, a plant of 0.1 s lag needs no model
BISECTIONS = 12  # of the bandwidth: its resolution is a thousandth
INTEGRAL_RATIO = 8.0  # k_p²/k_i; 4 is a double closed-loop pole of an integrator, 8 overshoots less; chosen
SPEED_SHARE = (
    0.985  # of the reference's speed limit: the rest corrects errors of the gain up to 1.5 %; chosen
)
ACCELERATION_LAGS = 1.0  # the reference takes so many lags to full speed; chosen
# Standard deviations of the sensor noise: half widths of the hold window, and the error below which a current
# falls to zero; the smoothed position has a sixth of the noise.
INNER_NOISE, OUTER_NOISE, CROSSING_NOISE = 1.5, 6.0, 3.0
MIN_NOISE_MM = 0.02  # mm, for a sensor without noise: a window of 0.12 mm; chosen
RISE_SAMPLES = 2.0  # shortest rise of a current to its largest; chosen
TRIAL_DRAWS, TRIAL_STEPS_MM = 16, (20.0, -20.0)  # draws and steps on which methods are compared
TRIAL_S, TRIAL_START_S = 8.0, 0.5  # s, of a trial run

Lags = tuple[float, float]


class DirectionMargins(NamedTuple):
    """Margins of one direction.

    Attributes:
        nominal: at the worst operating point with the identified parameters.
        worst: met by 95 % of the draws at every operating point.
        dead_time_s: upper end of the dead time's 95 % interval over draws, s.
    """

    nominal: Margins
    worst: Margins
    dead_time_s: float

    @property
    def passed(self) -> bool:
        """Whether the worst margins are within their bars."""
        worst = self.worst
        return bool(
            worst.gain_db >= MIN_GAIN_DB
            and worst.phase_deg >= MIN_PHASE_DEG
            and worst.sensitivity <= MAX_SENSITIVITY
            and worst.delay_s >= MIN_DEAD_TIMES * self.dead_time_s
        )


@short_repr
@dataclass(frozen=True)
class Tuning:
    """A tuned controller with the reasons for trust in it.

    Attributes:
        controller: tuned.
        method: `PI` or `LQI`, whichever has the smaller error in trial runs.
        trials: method to its mean IAE over steps and draws, mm·s.
        margins: direction to its margins.
        load: covariates that it is tuned for, by name; empty without.
        draws: number of parameter vectors of the margins.
    """

    controller: HitchController
    method: str
    trials: Mapping[str, float]
    margins: Mapping[str, DirectionMargins]
    load: Mapping[str, float]
    draws: int


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
    _check_model(model)
    progress(ProgressUpdate("operating points", 0.0))
    rows = loads_of_channels(model, load)
    loops = [
        _DirectionLoops.of(model, direction, row, draws, seed)
        for direction, row in zip(DIRECTIONS, rows, strict=True)
    ]
    trials: dict[str, tuple[HitchController, float]] = {}
    for number, (method, gains_of) in enumerate(_METHODS.items(), start=1):
        gains = [found for loop in loops if (found := _fastest(loop, gains_of)) is not None]
        if len(gains) < len(loops):
            continue
        controller = _controller(model, gains, rows)
        progress(ProgressUpdate(f"{method}: trial runs", 0.3 * number))
        trials[method] = controller, _trial(controller, model, load, seed)
    if not trials:
        raise InputError(_refusal(model, loops))
    method = min(trials, key=lambda name: trials[name][1])
    controller = trials[method][0]
    return Tuning(
        controller,
        method,
        {name: error for name, (_, error) in trials.items()},
        {loop.direction: loop.margins(gains) for loop, gains in zip(loops, controller.gains, strict=True)},
        _named_load(model, rows),
        draws,
    )


@dataclass(frozen=True)
class _DirectionLoops:
    """Plants of one direction at its operating points, with drawn parameters.

    Attributes:
        direction: of the channel.
        lags: a₁ and a₂ of the denominator 1 + a₁ s + a₂ s² of the speed, s and s².
        step_s: sampling time, s.
        omega: frequencies, rad/s, shape [F].
        models: of the controller, at each operating point.
        plants: drawn, at each operating point.
        dead_time_s: upper end of the dead time's interval, s.
    """

    direction: str
    lags: Lags
    step_s: float
    omega: Float[np.ndarray, " f"]
    models: Sequence[PlantResponse]
    plants: Sequence[PlantResponse]
    dead_time_s: float

    @classmethod
    def of(
        cls, model: Hitch, direction: str, row: Float[np.ndarray, " c"], draws: int, seed: int
    ) -> "_DirectionLoops":
        """Return the plants of a direction at values of its covariates."""
        channel = model.channels[direction]
        vectors = draws_of(model, direction, seed, draws)
        if vectors is None:
            raise InputError(
                f"model: its {direction} parameters have no standard errors, so that no margin can be given; "
                "identify it from more tests"
            )
        here, omega = channel.benchmark.at_load(jnp.asarray(row)), frequencies(model.step_s)
        models, plants = [], []
        for command, displacement in _operating_points(channel):
            nominal = small_signal_at(here, command, displacement)
            drawn = small_signals(
                channel.benchmark,
                jnp.asarray(vectors),
                jnp.asarray(row),
                jnp.asarray(command),
                jnp.asarray(displacement),
            )
            models.append(plant_response(nominal, omega, model.step_s, exact_fraction=False))
            plants.append(plant_response(_with_nominal(drawn, nominal), omega, model.step_s))
        dead_times_s = vectors[:, channel.benchmark.values.size]
        upper = float(np.quantile(dead_times_s, 0.975))
        return cls(direction, _axis(model, channel, row).lags, model.step_s, omega, models, plants, upper)

    def margins(self, gains: Gains) -> DirectionMargins:
        """Return the worst margins over operating points, of the model and of 95 % of the draws."""
        at_points = [
            margins(open_loop(gains, plant, model, self.omega, self.step_s), self.omega)
            for model, plant in zip(self.models, self.plants, strict=True)
        ]
        gain, phase, delay, sensitivity, disk = map(np.stack, zip(*at_points, strict=True))
        low = lambda rows: np.quantile(rows[:, 1:], 1 - SHARE, axis=1).min()  # noqa: E731
        worst = Margins(
            low(gain), low(phase), low(delay), np.quantile(sensitivity[:, 1:], SHARE, axis=1).max(), low(disk)
        )
        first = [rows[:, 0] for rows in (gain, phase, delay, sensitivity, disk)]
        nominal = Margins(*(r.max() if n == 3 else r.min() for n, r in enumerate(first)))
        return DirectionMargins(nominal, worst, self.dead_time_s)


def _with_nominal(drawn: SmallSignal, nominal: SmallSignal) -> SmallSignal:
    """Return the drawn linear models with the nominal one before them."""
    return jax.tree.map(
        lambda rows, one: np.concatenate([np.asarray(one)[None], np.asarray(rows)]), drawn, nominal
    )


def _operating_points(channel: Channel) -> Iterator[tuple[float, float]]:
    """Yield effective command and displacement of the operating points."""
    highest = float(channel.operating_range.command.highest)
    displacement = channel.operating_range.displacement
    lowest, width = float(displacement.lowest), float(displacement.highest - displacement.lowest)
    nonlinearity = channel.benchmark.nonlinearity
    opening = 0.0 if nonlinearity is None else float(nonlinearity.opening_command)
    for command, place in product(COMMAND_SHARES, STROKE_SHARES):
        yield opening + command * (highest - opening), lowest + place * width


def _pi_gains(bandwidth: float, lags: Lags, step_s: float) -> Gains:
    """Return the gains of PI control of an integrator at a bandwidth, rad/s."""
    del lags, step_s
    return Gains(bandwidth, bandwidth**2 / INTEGRAL_RATIO)


def _lqi_gains(bandwidth: float, lags: Lags, step_s: float) -> Gains:
    """Return the gains that minimise Σ e² + (ω/ρ ∫e)² + (v/ω)² for y' = s, s + a₁ s' + a₂ s'' = v.

    The states are the integral of the error, the position, the speed s and the acceleration.

    Args:
        bandwidth: ω, rad/s.
        lags: a₁ and a₂, s and s².
        step_s: sampling time, s.
    """
    a1, a2 = max(lags[0], step_s), max(lags[1], step_s**2)
    a = np.zeros((4, 4))
    a[[0, 1, 2], [1, 2, 3]] = 1.0
    a[3, 2:] = -1 / a2, -a1 / a2
    b = np.array([[0.0], [0.0], [0.0], [1 / a2]])
    block = expm(step_s * np.block([[a, b], [np.zeros((1, 5))]]))
    transition, held = block[:4, :4], block[:4, 4:]
    weights = np.diag([(bandwidth / INTEGRAL_RATIO) ** 2, 1.0, 0.0, 0.0])
    cost = np.array([[bandwidth**-2]])
    riccati = solve_discrete_are(transition, held, weights, cost)
    feedback = np.linalg.solve(cost + held.T @ riccati @ held, held.T @ riccati @ transition)
    integral, position, speed, acceleration = feedback[0].tolist()
    return Gains(position, integral, speed, acceleration)


GainsOf = Callable[[float, Lags, float], Gains]
_METHODS: Mapping[str, GainsOf] = {"PI": _pi_gains, "LQI": _lqi_gains}


def _fastest(loop: _DirectionLoops, gains_of: GainsOf) -> Gains | None:
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


def _axis(model: Hitch, channel: Channel, row: Float[np.ndarray, " c"]) -> Axis:
    largest_a = channel.dead_zone + float(channel.operating_range.command.highest)
    axis = Axis.of(
        channel.benchmark,
        sign=channel.sign,
        dead_zone=channel.dead_zone,
        step_s=model.step_s,
        largest_a=largest_a,
    )
    return axis.at_load(jnp.asarray(row))


def _controller(
    model: Hitch, gains: Sequence[Gains], rows: Sequence[Float[np.ndarray, " c"]]
) -> HitchController:
    channels = tuple(model.channels.values())
    axes = tuple(_axis(model, channel, row) for channel, row in zip(channels, rows, strict=True))
    noise = max(MIN_NOISE_MM, *(float(channel.load_filter.noise) for channel in channels))
    lags_s = np.array([axis.lags[0] for axis in axes])
    rise_s = ACCELERATION_LAGS * np.array([a1 + a2**0.5 for a1, a2 in (axis.lags for axis in axes)])
    middle = jnp.asarray(np.mean([point[1] for point in _operating_points(channels[0])]))
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


def _trial(controller: HitchController, model: Hitch, load: Load | None, seed: int) -> float:
    """Return the mean IAE of steps on drawn models, mm·s."""
    hitches = drawn_hitches(controller, model, load, TRIAL_DRAWS, seed)
    if hitches is None:
        raise InputError("model: its parameters have no standard errors")
    middle = float(np.mean([place for _, place in _operating_points(model.channels[DIRECTIONS[0]])]))
    time_s = np.arange(0.0, TRIAL_S, model.step_s)
    errors = []
    for number, step_mm in enumerate(TRIAL_STEPS_MM):
        target = middle + np.where(time_s < TRIAL_START_S, 0.0, step_mm)
        runs = run_on_model(controller, hitches, jax.random.key(seed + number), target, start_mm=middle)
        errors.append(np.abs(runs - target).sum(axis=1).mean() * model.step_s)
    return float(np.mean(errors))


def _check_model(model: Hitch) -> None:
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


def _refusal(model: Hitch, loops: Sequence[_DirectionLoops]) -> str:
    """Return why no bandwidth has its margins, and which test would help."""
    slowest = [loop.margins(_pi_gains(LOWEST_RAD_S, loop.lags, loop.step_s)) for loop in loops]
    number = next((number for number, found in enumerate(slowest) if not found.passed), 0)
    loop, worst = loops[number], slowest[number].worst
    estimates = model.uncertainty[loop.direction].benchmark.parameters
    widest = max(estimates, key=lambda estimate: estimate.log_interval_width)
    return (
        f"model: the {loop.direction} parameters are too little determined for a controller: at "
        f"{LOWEST_RAD_S:g} rad/s 95 % of the draws have {worst.gain_db:.1f} dB gain margin, "
        f"{worst.phase_deg:.0f}° phase margin, Ms {worst.sensitivity:.2f} and {1e3 * worst.delay_s:.0f} ms "
        f"delay margin; expected {MIN_GAIN_DB:g} dB, {MIN_PHASE_DEG:g}°, {MAX_SENSITIVITY:g} and "
        f"{2e3 * loop.dead_time_s:.0f} ms; {widest.name} is determined least: run hitchid design MODEL "
        f"--direction {loop.direction} --parameter {widest.name}"
    )


def _named_load(model: Hitch, rows: Sequence[Float[np.ndarray, " c"]]) -> dict[str, float]:
    named: dict[str, float] = {}
    for channel, row in zip(model.channels.values(), rows, strict=True):
        named |= dict(zip(channel.benchmark.covariates, row.tolist(), strict=False))
    return named
