"""What a form does after a step of the command at rest: where flow begins, steady speed, delay and rise."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid.structures import SHAPE, Benchmark, Shape, discretise
from hitchid.structures.discretise import driven
from hitchid.structures.structure import LinearStructure

Scalar = Float[Array, ""] | float
CELLS, TIME_CONSTANTS, SHORTEST_S = 1000, 8.0, 1e-9
BEGUN, REACHED = 0.05, 1 - float(np.exp(-1))
ALMOST = 0.999


def opening_command(benchmark: Benchmark, load: Scalar, dead_zone: Scalar) -> Float[Array, ""]:
    """Return the command at which flow begins, d₀ + U max(d + s c, 0), in the command's unit."""
    if benchmark.shape is None:
        return jnp.asarray(dead_zone)
    shape = benchmark.shape
    opening, shift = _named(shape, "opening"), _named(shape, "load_shift")
    loaded = jnp.clip((load - shape.scales.load_centre) / shape.scales.load_spread, -3.0, 3.0)
    return dead_zone + shape.scales.command * jnp.maximum(opening + shift * loaded, 0.0)


def steady_speed(
    benchmark: Benchmark,
    levels: Float[Array, " q"],
    loads: Float[Array, " q"],
    dead_zone: Scalar,
    displacement: Scalar,
) -> Float[Array, " q"]:
    """Return K w(c − d₀) g(x): the speed under a held command when lags have died away, from rest, shape [Q].

    A first-order lag settles at a place, not at a speed: its speed is that with which it sets off.
    """
    beyond = jnp.maximum(levels - dead_zone, 0.0)
    if benchmark.shape is None:
        return benchmark.values[0] * beyond
    flow = benchmark.shape.flow(beyond, loads)
    return benchmark.values[0] * flow * benchmark.shape.gain(jnp.full_like(loads, displacement), loads)


def speed_lag(structure: LinearStructure, values: np.ndarray) -> float:
    """Return how slow the speed is, |a₁| + √a₂ + … of the denominator 1 + a₁ s + a₂ s² + … of s G(s), s.

    Without an integrator the command moves the speed at once.
    """
    *slower, one, last = structure.transfer_function(tuple(map(float, values)))[1]
    if last != 0:
        return 0.0
    return float(sum(abs(a / one) ** (1 / power) for power, a in enumerate(slower[::-1], start=1)))


def step_times(
    benchmark: Benchmark, level: Scalar, load: Scalar, dead_zone: Scalar, lag_s: Scalar
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return when after a step of the command the speed reaches 5 % and 63.2 % of its final value, s.

    The form is simulated from rest on a clock that its lags set, without its gain along the stroke; the dead
    time is added. Both are zero for a form that has neither lag nor dead time. `lag_s` is `speed_lag`.
    """
    shape, structure = benchmark.shape, benchmark.linear
    lag = jnp.asarray(lag_s)
    if shape is not None:
        # A lagging spool reaches the opening only after a while: c (1 − exp(−t/τ)) = d.
        open_at = jnp.clip(opening_command(benchmark, load, dead_zone) / level, 0.0, ALMOST)
        lag = lag + _named(shape, "spool_lag") * (1 - jnp.log1p(-open_at))
    step_s = jnp.maximum(TIME_CONSTANTS * lag, SHORTEST_S) / CELLS
    command, zone = jnp.full((1, CELLS), level), jnp.full(1, dead_zone)
    flow = jnp.maximum(command - dead_zone, 0.0)
    final = flow[0, -1]
    if shape is not None:
        final = shape.flow(final, jnp.asarray(load))
        flow = shape.flow(shape.effective(command, zone, step_s), jnp.full((1, 1), load))
    travel = driven(discretise(structure, benchmark.values, 0.0, step_s), flow)[0]
    share = jnp.diff(travel) / (step_s * benchmark.values[0] * final)
    rising = jnp.concatenate([jnp.zeros(1), share])
    # Differences of travel are mean speeds of cells, which belong to their middles.
    time_s = jnp.concatenate([jnp.zeros(1), (jnp.arange(CELLS - 1) + 0.5) * step_s])
    begun, reached = (_crossing(time_s, rising, part) for part in (BEGUN, REACHED))
    return benchmark.dead_time_s + begun, benchmark.dead_time_s + reached


def _crossing(time_s: Float[Array, " n"], rising: Float[Array, " n"], part: float) -> Float[Array, ""]:
    """Return when a curve from zero first reaches a part, between samples; infinite where it does not."""
    there = rising >= part
    at = jnp.maximum(jnp.argmax(there), 1)
    slope = (part - rising[at - 1]) / (rising[at] - rising[at - 1])
    moment = time_s[at - 1] + slope * (time_s[at] - time_s[at - 1])
    return jnp.where(jnp.any(there), moment, jnp.inf)


def _named(shape: Shape, name: str) -> Float[Array, ""]:
    return shape.values[[parameter.name for parameter in SHAPE].index(name)]
