"""Scenarios that a position controller of a hitch is driven through on the virtual bench."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.bench import Rig, simulate
from hitchid.bench.simulation import SAMPLE_S
from hitchid.control.closed_loop import Surroundings
from hitchid.control.controller import HitchController

# PI and PID control of the position from the error alone: the baselines.

Scalar = Float[Array, ""]
COMPENSATED = "SIMC PI, dead zone compensated"  # name among the baselines
DERIVATIVE_FILTER = 0.1  # of the derivative time: lag of the derivative (Åström & Hägglund 2006, sec. 3.3)
EFFECTIVE_SHARE = 0.5  # of the fastest speed: where the valve is linearised for the gains; chosen


@short_repr
class PidState(NamedTuple):
    """State of a PID controller.

    Attributes:
        integral: lifting positive.
        error: of the sample before, filtered.
        measured: last valid measurement.
    """

    integral: Scalar
    error: Scalar
    measured: Scalar


@short_repr
class PidController(eqx.Module):
    """u = K_p (e + ∫ e/T_i dt + T_d de/dt), to the lifting valve where positive, else to the lowering valve.

    The integral stops while the current is limited.

    Attributes:
        proportional: K_p of lifting and lowering, shape [2].
        integral_s: T_i, s, shape [2].
        derivative_s: T_d, s, shape [2].
        offset: added to a current that is not zero, shape [2]: the dead zone where it is compensated.
        largest_command: of each current, shape [2].
        step_s: sampling time, s.
    """

    proportional: Float[Array, "2"]
    integral_s: Float[Array, "2"]
    derivative_s: Float[Array, "2"]
    offset: Float[Array, "2"]
    largest_command: Float[Array, "2"]
    step_s: float = eqx.field(static=True)

    @double_precision
    def initial_state(self, displacement: Scalar | float) -> PidState:
        """Return the state of a hitch that is held at a displacement."""
        zero = jnp.zeros(())
        return PidState(zero, zero, jnp.asarray(displacement, jnp.float64))

    @double_precision
    def step(
        self, state: PidState, target: Scalar | float, measured: Scalar | float
    ) -> tuple[PidState, Float[Array, "2"]]:
        """Return the next state, and lifting and lowering current, shape [2]; zero without measurement."""
        target, measured = jnp.asarray(target, jnp.float64), jnp.asarray(measured, jnp.float64)
        return _pid_step(self, state, target, measured)


@eqx.filter_jit
def _pid_step(
    controller: PidController, state: PidState, target: Scalar, measured: Scalar
) -> tuple[PidState, Float[Array, "2"]]:
    is_lost = ~jnp.isfinite(measured)
    position = jnp.where(is_lost, state.measured, measured)
    error = target - position
    # Gains of the direction that the error asks for: those of both directions differ.
    number = jnp.where(error >= 0, 0, 1)
    gain, derivative_s = controller.proportional[number], controller.derivative_s[number]
    # Unfiltered, a derivative over 10 ms would be sensor noise.
    share = controller.step_s / (DERIVATIVE_FILTER * derivative_s + controller.step_s)
    filtered = state.error + share * (error - state.error)
    rate = (filtered - state.error) / controller.step_s
    integrated = state.integral + controller.step_s * gain / controller.integral_s[number] * error
    direct = gain * (error + derivative_s * rate)
    signed = direct + integrated
    sizes = jnp.stack([signed, -signed])
    currents = jnp.where(sizes > 0, sizes + controller.offset, 0.0)
    is_limited = jnp.any(currents > controller.largest_command) & (jnp.sign(error) == jnp.sign(signed))
    integral = jnp.where(is_limited, state.integral, integrated)
    currents = jnp.where(is_lost, 0.0, jnp.minimum(currents, controller.largest_command))
    integral = jnp.where(is_lost, 0.0, integral)
    return PidState(integral, filtered, position), currents


@double_precision
def baselines(controller: HitchController) -> dict[str, PidController]:
    """Return PI control by the SIMC rules, with and without the dead zone, and one PID for both directions.

    For K e^(−θs)/(s (τs + 1)): K_p = 1/(K 2θ'), T_i = 8 θ' with τ_c = θ' = θ + τ (SIMC, Skogestad 2003,
    PI); K is the slope of the speed over the current at half the fastest speed in mid stroke. The fixed PID
    has the mean K, τ and θ of both directions, τ_c = θ, and the series form of SIMC, K_c = 1/(2 K θ),
    τ_I = 8 θ, τ_D = τ, as the parallel form K_p = K_c f, T_i = τ_I f, T_d = τ_D/f, f = 1 + τ_D/τ_I.
    """
    rows = [_simc(controller, number) for number in range(2)]
    gain, lag_s, dead_time_s = (jnp.stack(column) for column in zip(*rows, strict=True))
    largest = jnp.asarray([axis.largest_command for axis in controller.axes])
    dead_zones = jnp.asarray([axis.model.dead_zone for axis in controller.axes])
    total_s = lag_s + dead_time_s
    none = jnp.zeros(2)
    simc = PidController(1 / (gain * 2 * total_s), 8 * total_s, none, none, largest, controller.step_s)
    both = jnp.ones(2)
    mean_gain, mean_lag, mean_dead = (jnp.mean(column) * both for column in (gain, lag_s, dead_time_s))
    parallel = 1 + mean_lag / (8 * mean_dead)
    fixed = PidController(
        parallel / (mean_gain * 2 * mean_dead),
        8 * mean_dead * parallel,
        mean_lag / parallel,
        none,
        largest,
        controller.step_s,
    )
    return {
        "SIMC PI": simc,
        COMPENSATED: eqx.tree_at(lambda c: c.offset, simc, dead_zones),
        "fixed PID": fixed,
    }


def _simc(controller: HitchController, number: int) -> tuple[Scalar, Scalar, Scalar]:
    """Return K, τ and θ, the latter in s; half a sample of the hold belongs to the dead time."""
    axis = controller.axes[number]
    nonlinearity = axis.model.benchmark.nonlinearity
    middle = jnp.zeros(()) if nonlinearity is None else nonlinearity.scales.centre
    speed = EFFECTIVE_SHARE * axis.fastest(middle)
    slope = 1 / jax.grad(axis.current_for)(speed, middle)
    return slope, controller.lags_s[number], (axis.dead_time_samples + 0.5) * axis.step_s


STEPS_MM = (5.0, 20.0, 100.0)
STEP_SHARES = (0.02, 0.08, 0.4)  # of the stroke of a plant from elsewhere, as those of the bench
# Within which a step has settled, the smallest one within half: 2 mm of the bench's 250 mm.
TOLERANCE_MM, SMALL_TOLERANCE_MM, TOLERANCE_SHARE = 2.0, 1.0, 0.008
RAMP_MM_S, RAMP_S = 8.0, 6.0  # about half the largest speed of the tests; chosen
SINE_MM, SINE_HZ, SINE_PERIODS = 10.0, 0.1, 3
HOLD_S = 60.0
BEFORE_S, AFTER_S = 1.0, 4.0  # s: before a target moves, and after the least time of its way; chosen
LIGHT_KG, HEAVY_KG, COLD_C = 450.0, 1300.0, 5.0
LOAD_TAKEN_S = 1.0  # s, for which the load changes in the middle of a motion; chosen
CHANGED_STEP_MM = 100.0
WORKING_DEPTH_MM, RIDE_S = 40.0, 12.0  # mm below the surface and s at this depth; chosen
SOIL_N_PER_MM, BUMPS_MM, BUMPS_HZ = 80.0, 6.0, 0.3  # 3.2 kN at the working depth; ±6 mm of surface; chosen
WORN_S = 3.0  # s from the start of the step, within which a life's wear comes; chosen
WORN_LEAKAGE, WORN_DEAD_ZONE_A = 5.0, 0.02  # factor on the leakage, change of both dead zones, A; chosen
LOST_S = 0.5  # s, for which the sensor is lost in the middle of a step; chosen


class Kind(Enum):
    """Kind of a scenario; its figures are those of the kind."""

    STEP = "step"
    RAMP = "ramp"
    SINE = "sine"
    HOLD = "hold"
    PLOUGHING = "ploughing"
    LOAD_CHANGE = "load change"
    COLD_OIL = "cold oil"
    WEAR = "wear"
    SENSOR_LOST = "sensor lost"


@short_repr
@dataclass(frozen=True)
class Scenario:
    """Target and surroundings over time.

    Attributes:
        name: unique.
        kind: of its figures.
        target: shape [N].
        start: displacement at which the hitch is held at first.
        begin: sample at which the figures begin.
        surroundings: what acts on the bench.
        amplitude: of a step, signed.
        tolerance: within which a step has settled.
    """

    name: str
    kind: Kind
    target: Float[np.ndarray, " n"]
    start: float
    begin: int = 0
    surroundings: Surroundings = field(default_factory=Surroundings)
    amplitude: float = 0.0
    tolerance: float = TOLERANCE_MM


def scenarios(rig: Rig, slowest_mm_s: float) -> list[Scenario]:
    """Return the scenarios of a bench.

    Args:
        rig: the bench.
        slowest_mm_s: of the largest speeds of both directions, from which the durations follow.
    """
    middle = 500 * float(rig.cylinder.stroke)
    return [
        *(_step(middle, sign * size, slowest_mm_s) for size in STEPS_MM for sign in (1, -1)),
        *(_ramp(middle, sign * RAMP_MM_S, RAMP_S, "mm") for sign in (1, -1)),
        _sine(middle, SINE_MM, SINE_HZ, "mm"),
        Scenario("hold", Kind.HOLD, np.full(_count(HOLD_S), middle), middle),
        _ploughing(middle, slowest_mm_s),
        *_changes(middle, slowest_mm_s),
        _wear(middle, slowest_mm_s),
        _sensor_lost(_step(middle, STEPS_MM[1], slowest_mm_s)),
    ]


def plant_scenarios(lowest: float, highest: float, slowest: float, unit: str) -> list[Scenario]:
    """Return the scenarios of a plant from elsewhere: steps, ramps, a sine, holding, a lost sensor.

    They have the shares of the stroke and of the slower direction's largest speed that those of the bench
    have, rounded to one digit.
    """
    middle, stroke = 0.5 * (lowest + highest), highest - lowest
    sizes = [_one_digit(share * stroke) for share in STEP_SHARES]
    steps = [
        replace(
            _step(middle, sign * size, slowest, unit),
            tolerance=TOLERANCE_SHARE * stroke * (0.5 if number == 0 else 1.0),
        )
        for number, size in enumerate(sizes)
        for sign in (1, -1)
    ]
    speed, amplitude = _one_digit(0.5 * slowest), _one_digit(0.04 * stroke)
    frequency = _one_digit(0.4 * slowest / (2 * np.pi * amplitude))
    ramp_s = min(RAMP_S, 0.4 * stroke / speed)
    return [
        *steps,
        *(_ramp(middle, sign * speed, ramp_s, unit) for sign in (1, -1)),
        _sine(middle, amplitude, frequency, unit),
        Scenario("hold", Kind.HOLD, np.full(_count(HOLD_S), middle), middle),
        _sensor_lost(steps[2]),
    ]


def _one_digit(value: float) -> float:
    return float(f"{value:.0e}")


def step_name(amplitude: float, unit: str = "mm") -> str:
    """Return the name of the scenario of a step."""
    return f"step {amplitude:+g} {unit}"


def least_time_s(rig: Rig, currents_a: Float[np.ndarray, "2"], scenario: Scenario) -> float:
    """Return the least time in which the bench goes the way of a step: at the largest currents, A, in s."""
    number = 0 if scenario.amplitude > 0 else 1
    # The same bench without a controller: no controller can be faster with these currents.
    currents = np.zeros((1, scenario.target.size, 2))
    currents[..., number] = currents_a[number]
    motion = simulate(rig, currents, initial_displacement_m=1e-3 * scenario.start)
    travel_mm = 1e3 * np.abs(np.asarray(motion.displacement_m[0]) - 1e-3 * scenario.start)
    arrived = np.flatnonzero(travel_mm >= abs(scenario.amplitude))
    return float(arrived[0] * SAMPLE_S) if arrived.size else float("inf")


def _count(duration_s: float) -> int:
    return round(duration_s / SAMPLE_S)


def _step(middle: float, size: float, slowest_mm_s: float, unit: str = "mm") -> Scenario:
    # About the middle: the largest step goes through mid stroke and meets no stop.
    start = middle - 0.5 * size
    way = _count(abs(size) / slowest_mm_s + AFTER_S)
    target = np.concatenate([np.full(_count(BEFORE_S), start), np.full(way, start + size)])
    tolerance = SMALL_TOLERANCE_MM if abs(size) == STEPS_MM[0] else TOLERANCE_MM
    name = step_name(size, unit)
    return Scenario(name, Kind.STEP, target, start, _count(BEFORE_S), amplitude=size, tolerance=tolerance)


def _ramp(middle: float, speed: float, ramp_s: float, unit: str) -> Scenario:
    start = middle - 0.5 * speed * ramp_s
    way = start + speed * SAMPLE_S * np.arange(_count(ramp_s))
    target = np.concatenate([np.full(_count(BEFORE_S), start), way, np.full(_count(AFTER_S), way[-1])])
    return Scenario(f"ramp {speed:+g} {unit}/s", Kind.RAMP, target, start, _count(BEFORE_S))


def _sine(middle: float, amplitude: float, frequency_hz: float, unit: str) -> Scenario:
    time_s = SAMPLE_S * np.arange(_count(SINE_PERIODS / frequency_hz))
    target = middle + amplitude * np.sin(2 * np.pi * frequency_hz * time_s)
    name = f"sine {amplitude:g} {unit}, {frequency_hz:g} Hz"
    # The first period is left out: the hitch begins at rest, the sine at its largest speed.
    return Scenario(name, Kind.SINE, target, middle, _count(1 / frequency_hz))


def _ploughing(middle: float, slowest_mm_s: float) -> Scenario:
    surface = middle + 0.5 * WORKING_DEPTH_MM
    down = _count(BEFORE_S + WORKING_DEPTH_MM / slowest_mm_s + AFTER_S)
    size = down + _count(RIDE_S)
    target = np.where(np.arange(size) < _count(BEFORE_S), surface, surface - WORKING_DEPTH_MM)
    riding_s = SAMPLE_S * np.maximum(np.arange(size) - down, 0)
    bumps = surface + BUMPS_MM * np.sin(2 * np.pi * BUMPS_HZ * riding_s)
    around = Surroundings(surface_mm=bumps, soil_n_per_mm=SOIL_N_PER_MM)
    return Scenario("ploughing", Kind.PLOUGHING, target, surface, down, around)


def _changes(middle: float, slowest_mm_s: float) -> Iterator[Scenario]:
    for before_kg, after_kg in ((LIGHT_KG, HEAVY_KG), (HEAVY_KG, LIGHT_KG)):
        for sign in (1, -1):
            step = _step(middle, sign * CHANGED_STEP_MM, slowest_mm_s)
            # The load is taken over where the hitch is half way, and moves.
            half_s = 0.5 * CHANGED_STEP_MM / slowest_mm_s
            time_s = SAMPLE_S * (np.arange(step.target.size) - step.begin) - half_s + 0.5 * LOAD_TAKEN_S
            kg = before_kg + (after_kg - before_kg) * np.clip(time_s / LOAD_TAKEN_S, 0.0, 1.0)
            name = f"{before_kg:g} to {after_kg:g} kg, {step.name}"
            around = Surroundings(implement_kg=kg)
            yield replace(step, name=name, kind=Kind.LOAD_CHANGE, surroundings=around)
    for sign in (1, -1):
        step = _step(middle, sign * CHANGED_STEP_MM, slowest_mm_s)
        name, around = f"{COLD_C:g} °C oil, {step.name}", Surroundings(oil_c=COLD_C)
        yield replace(step, name=name, kind=Kind.COLD_OIL, surroundings=around)


def _wear(middle: float, slowest_mm_s: float) -> Scenario:
    step = _step(middle, STEPS_MM[1], slowest_mm_s)
    grown = np.clip((SAMPLE_S * (np.arange(step.target.size) - step.begin)) / WORN_S, 0.0, 1.0)
    around = Surroundings(
        leakage_factor=1.0 + (WORN_LEAKAGE - 1.0) * grown, dead_zone_change_a=WORN_DEAD_ZONE_A * grown
    )
    return replace(step, name=f"wear, {step.name}", kind=Kind.WEAR, surroundings=around)


def _sensor_lost(step: Scenario) -> Scenario:
    time_s = SAMPLE_S * (np.arange(step.target.size) - step.begin)
    lost = (time_s >= LOST_S) & (time_s < 2 * LOST_S)
    around = Surroundings(sensor_lost=lost)
    return replace(step, name="sensor lost", kind=Kind.SENSOR_LOST, surroundings=around)
