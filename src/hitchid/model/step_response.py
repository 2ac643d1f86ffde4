"""Step response from rest: delay and response time."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid.structures import PhysicalModel, discretise, opening_command
from hitchid.structures.discretisation import simulate_linear
from hitchid.structures.structure import LinearStructure

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
