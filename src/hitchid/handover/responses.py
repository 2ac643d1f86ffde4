"""Step and frequency response of the physical model of one direction, with bands from its parameters."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.logs.kinds import effective_command
from hitchid.model.channel import Channel
from hitchid.structures import (
    Batch,
    PhysicalModel,
    SmallSignal,
    default_command,
    default_displacement,
    discretise,
    opening_command,
    small_signals,
    steady_speed,
)
from hitchid.structures.discretisation import simulate_linear
from hitchid.structures.structure import LinearStructure

# Step response from rest: delay and response time.

Scalar = Float[Array, ""] | float
CELLS, TIME_CONSTANTS, SHORTEST_S = 1000, 8.0, 1e-9  # samples; length in lags; shortest length, s; chosen
DELAY_FRACTION, RESPONSE_FRACTION = 0.05, 1 - float(np.exp(-1))  # of the final speed: 5 % (chosen), 63.2 %
MAX_OPENING_RATIO = 0.999  # opening over level, limits the time in which the spool opens; chosen


def speed_lag(structure: LinearStructure, values: np.ndarray) -> float:
    """Return the lag of the speed, |a₁| + √a₂ + … of the denominator 1 + a₁ s + a₂ s² + … of s G(s), in s.

    Without an integrator the slowest pole replaces it, and the lag is that of the other poles, Σ 1/|p|.
    """
    denominator = structure.transfer_function(tuple(map(float, values)))[1]
    *higher_coefficients, linear_coefficient, constant_coefficient = denominator
    if constant_coefficient != 0:
        return float(np.sum(1 / np.sort(np.abs(np.roots(denominator)))[1:]))
    return float(
        sum(
            abs(a / linear_coefficient) ** (1 / power)
            for power, a in enumerate(higher_coefficients[::-1], start=1)
        )
    )


def step_times(
    physical_model: PhysicalModel, level: Scalar, dead_zone: Scalar, lag_s: Scalar
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return the times after a command step at which the speed is 5 % and 63.2 % of its final value, s.

    The model is simulated from rest without its stroke gain, at a sampling time set by its lags; the dead
    time is added. Both are zero for a model with neither lag nor dead time. `lag_s` is `speed_lag`.
    """
    nonlinearity, structure = physical_model.nonlinearity, physical_model.structure.require_linear()
    lag = jnp.asarray(lag_s)
    if nonlinearity is not None:
        # A lagging spool reaches the opening only after a while: c (1 − exp(−t/τ)) = d.
        open_at = jnp.clip(opening_command(physical_model, dead_zone) / level, 0.0, MAX_OPENING_RATIO)
        lag = lag + nonlinearity.named("spool_lag")[0] * (1 - jnp.log1p(-open_at))
    step_s = jnp.maximum(TIME_CONSTANTS * lag, SHORTEST_S) / CELLS
    command, dead_zones = jnp.full((1, CELLS), level), jnp.full(1, dead_zone)
    flow = jnp.maximum(command - dead_zone, 0.0)
    final = flow[0, -1]
    if nonlinearity is not None:
        final = nonlinearity.flow(final)
        flow = nonlinearity.flow(nonlinearity.effective(command, dead_zones, step_s))
    travel = simulate_linear(discretise(structure, physical_model.values, 0.0, step_s), flow)[0]
    relative_speed = jnp.diff(travel) / (step_s * physical_model.gain * final)
    step_response = jnp.concatenate([jnp.zeros(1), relative_speed])
    # A difference of travel is the mean speed of its interval, assigned to the middle.
    time_s = jnp.concatenate([jnp.zeros(1), (jnp.arange(CELLS - 1) + 0.5) * step_s])
    delay_s, response_time_s = (
        _crossing(time_s, step_response, fraction) for fraction in (DELAY_FRACTION, RESPONSE_FRACTION)
    )
    return physical_model.dead_time_s + delay_s, physical_model.dead_time_s + response_time_s


def _crossing(time_s: Float[Array, " n"], curve: Float[Array, " n"], level: float) -> Float[Array, ""]:
    """Return when a curve from zero first reaches a level, interpolated; infinite if it never does."""
    reached = curve >= level
    index = jnp.maximum(jnp.argmax(reached), 1)
    slope = (level - curve[index - 1]) / (curve[index] - curve[index - 1])
    crossing_time = time_s[index - 1] + slope * (time_s[index] - time_s[index - 1])
    return jnp.where(jnp.any(reached), crossing_time, jnp.inf)


STEP_SAMPLES = 512  # of a step response; chosen
LAGS, MIN_SAMPLES = 6.0, 100  # default length of a step response: lags, and least samples; chosen
LEVEL_SHARES = (1 / 3, 2 / 3, 1.0)  # of the largest effective command: levels without a speed map; chosen
FREQUENCIES, DECADES = 241, 3  # of a frequency response, up to half the sampling frequency; chosen
QUANTILES = (0.025, 0.975)  # of the draws: ends of a band of 95 %


class Banded(NamedTuple):
    """Values with the ends of their 95 % band, each of one shape; None without a band."""

    value: np.ndarray
    lower: np.ndarray | None = None
    upper: np.ndarray | None = None

    @classmethod
    def of(cls, value: np.ndarray, draws: np.ndarray | None) -> "Banded":
        """Return values, shape [N], with the quantiles of draws, shape [S, N], or without a band."""
        return cls(value) if draws is None else cls(value, *np.quantile(draws, QUANTILES, axis=0))

    def map(self, function: Callable[[np.ndarray], np.ndarray]) -> "Banded":
        """Return a rising function of the values and of the ends of their band."""
        if self.lower is None or self.upper is None:
            return Banded(function(self.value))
        return Banded(function(self.value), function(self.lower), function(self.upper))


@short_repr
class StepResponse(NamedTuple):
    """Response from rest to one command step at time zero.

    Attributes:
        level: the command, in its unit.
        time_s: s, shape [N].
        travel: in the direction of the command, in the displacement's unit.
        speed_time_s: middle of each interval, s, shape [N − 1].
        speed: mean over each interval, in the displacement's unit/s.
    """

    level: float
    time_s: np.ndarray
    travel: Banded
    speed_time_s: np.ndarray
    speed: Banded


@short_repr
class FrequencyResponse(NamedTuple):
    """Response from command to travel over frequency.

    Attributes:
        frequency_hz: Hz, shape [F].
        magnitude: of G, in the displacement's unit per the command's.
        phase_rad: continuous phase, dead time included, rad.
    """

    frequency_hz: np.ndarray
    magnitude: Banded
    phase_rad: Banded


def default_levels(channel: Channel, mapped: Sequence[float]) -> list[float]:
    """Return up to three command levels: lowest, middle and highest of a speed map or of the tests."""
    if mapped:
        ordered = sorted(set(mapped))
        return sorted({ordered[0], ordered[len(ordered) // 2], ordered[-1]})
    highest = float(channel.operating_range.command.highest)
    return [channel.dead_zone + share * highest for share in LEVEL_SHARES] if np.isfinite(highest) else []


def default_duration_s(channel: Channel, step_s: float) -> float:
    """Return six lags of the speed after the dead time, and at least 100 samples, s."""
    return max(settling_s(channel, LAGS), MIN_SAMPLES * step_s)


@double_precision
def settling_s(channel: Channel, lags: float) -> float:
    """Return the dead time and some lags of the speed and the spool, s; no lag of a nonlinear structure."""
    benchmark, lag_s = channel.benchmark, 0.0
    if benchmark.structure.linear is not None:
        lag_s = speed_lag(benchmark.structure.linear, np.asarray(benchmark.values))
    lag_s += benchmark.named_values().get("spool_lag", 0.0)
    return float(benchmark.dead_time_s) + lags * lag_s


@double_precision
def step_responses(
    channel: Channel,
    levels: Sequence[float],
    duration_s: float,
    vectors: Float[np.ndarray, "s r"] | None = None,
) -> list[StepResponse]:
    """Return the responses of the physical model to command steps from rest, without end stops.

    Args:
        channel: of one direction.
        levels: commands after the step, in the command's unit.
        duration_s: length, s.
        vectors: parameter vectors of the band, shape [S, R]; None for no band.
    """
    raw_command = np.repeat(np.asarray(levels, dtype=np.float64)[:, None], STEP_SAMPLES, axis=1)
    initial, benchmark = _middle(channel), channel.benchmark
    everywhere = jnp.asarray(np.ones(raw_command.shape, dtype=bool))
    batch = Batch(
        command=jnp.asarray(effective_command(raw_command, channel.dead_zone)),
        raw_command=jnp.asarray(raw_command),
        dead_zone=jnp.full(len(levels), channel.dead_zone),
        displacement=jnp.full(raw_command.shape, initial),
        valid=everywhere,
        loss_mask=everywhere,
        initial=jnp.full(len(levels), initial),
        covariates=jnp.tile(benchmark.mean_load, (len(levels), 1))[:, : len(benchmark.covariates)],
        step_s=duration_s / (STEP_SAMPLES - 1),
        sign=channel.sign,
        covariate_names=benchmark.covariates,
    )
    travel = np.asarray(channel.benchmark.travel(batch))
    draws = None if vectors is None else np.asarray(_travels(channel.benchmark, jnp.asarray(vectors), batch))
    time_s = batch.step_s * np.arange(STEP_SAMPLES)
    responses = []
    for number, level in enumerate(levels):
        drawn = None if draws is None else draws[:, number]
        speeds = None if drawn is None else np.diff(drawn, axis=1) / batch.step_s
        responses.append(
            StepResponse(
                level=level,
                time_s=time_s,
                travel=Banded.of(travel[number], drawn),
                speed_time_s=time_s[1:] - 0.5 * batch.step_s,
                speed=Banded.of(np.diff(travel[number]) / batch.step_s, speeds),
            )
        )
    return responses


@double_precision
def steady_speeds(channel: Channel, commands: Float[np.ndarray, " q"]) -> np.ndarray:
    """Return the speed at each constant command after the transients, at mid stroke and mean load."""
    displacement = _middle(channel)
    speeds = steady_speed(channel.benchmark, jnp.asarray(commands), channel.dead_zone, displacement)
    return np.asarray(speeds)


def default_frequencies_hz(step_s: float) -> np.ndarray:
    """Return three decades of frequencies up to half the sampling frequency, Hz, shape [241]."""
    highest = 0.5 / step_s
    return np.geomspace(highest / 10**DECADES, highest, FREQUENCIES)


def checked_frequencies_hz(frequency_hz: Sequence[float] | np.ndarray | None, step_s: float) -> np.ndarray:
    """Return given frequencies, or the default; raises InputError for one that is not positive."""
    if frequency_hz is None:
        return default_frequencies_hz(step_s)
    return np.array([checks.number(value, "frequency_hz", above=0.0) for value in np.ravel(frequency_hz)])


@double_precision
def frequency_response(
    channel: Channel,
    frequency_hz: Float[np.ndarray, " f"],
    command: float | None = None,
    vectors: Float[np.ndarray, "s r"] | None = None,
) -> FrequencyResponse:
    """Return G(jω) of the physical model from command to travel, at mid stroke and mean load.

    See `hitchid.structures.linearise`. Small signals within the hysteresis are not described.

    Args:
        channel: of one direction, with a linear structure.
        frequency_hz: Hz, shape [F].
        command: constant command of the linearisation, in its unit; None for that of `linearise`.
        vectors: parameter vectors of the band, shape [S, R]; None for no band.

    Raises:
        InputError: the structure is not linear.
    """
    benchmark = channel.benchmark
    benchmark.structure.require_linear()
    effective = default_command(benchmark) if command is None else max(command - channel.dead_zone, 0.0)
    point = (benchmark.mean_load, jnp.asarray(effective), default_displacement(benchmark))
    nominal = small_signals(benchmark, benchmark.parameter_vector[None], *point)
    drawn = None if vectors is None else small_signals(benchmark, jnp.asarray(vectors), *point)
    return response_of(jax.tree.map(lambda rows: rows[0], nominal), drawn, frequency_hz)


def response_of(
    nominal: SmallSignal, drawn: SmallSignal | None, frequency_hz: Float[np.ndarray, " f"]
) -> FrequencyResponse:
    """Return the frequency response of a linear model, with a band from others, the first axis of `drawn`."""
    magnitude, phase_rad = _polar(nominal, frequency_hz)
    if drawn is None:
        return FrequencyResponse(frequency_hz, Banded(magnitude), Banded(phase_rad))
    magnitudes, phases_rad = _polar(drawn, frequency_hz)
    return FrequencyResponse(frequency_hz, Banded.of(magnitude, magnitudes), Banded.of(phase_rad, phases_rad))


def _polar(linear: SmallSignal, frequency_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return magnitude and continuous phase, the dead time's included, rad."""
    rational = linear.rational(frequency_hz)
    phase_rad = np.unwrap(np.angle(rational), axis=-1)
    dead_time_s = np.asarray(linear.dead_time_s)[..., None]
    return np.abs(rational), phase_rad - 2 * np.pi * frequency_hz * dead_time_s


def _middle(channel: Channel) -> float:
    """Return mid stroke of the identification tests; zero where it is not known."""
    nonlinearity = channel.benchmark.nonlinearity
    if nonlinearity is not None:
        return float(nonlinearity.scales.centre)
    stroke = channel.operating_range.displacement
    centre = 0.5 * (float(stroke.lowest) + float(stroke.highest))
    return centre if np.isfinite(centre) else 0.0


@eqx.filter_jit
def _travels(benchmark: PhysicalModel, vectors: Float[Array, "s r"], batch: Batch) -> Float[Array, "s t n"]:
    return jax.vmap(lambda vector: benchmark.with_parameter_vector(vector).travel(batch))(vectors)
