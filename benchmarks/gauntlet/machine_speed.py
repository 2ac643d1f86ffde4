"""Speed of this machine beside that of the one on which the limits of computing times were set."""

import statistics
import time
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp

REFERENCE_S = 0.6  # s, of the work below on the machine of the limits, with nothing else running on it
THREADS, REPEATS = 2, 5  # as many threads as an identification uses; the median of the repeats counts
# As the least squares of rig-a: tests × samples, parameters, states; and normal equations a repeat.
TESTS, SAMPLES, PARAMETERS, STATES, ROUNDS = 16, 1024, 11, 3, 150
# As a training: stretches, cells, inputs, and samples of a recurrence; and as preparing tests: lines of text.
STRETCHES, CELLS, INPUTS, STEPS, LINES = 32, 32, 10, 30_000, 400_000


def _residuals(parameters: jax.Array) -> jax.Array:
    """Return a valve's power law, linear dynamics and a gain along the stroke, shape [TESTS, SAMPLES]."""
    command = jnp.tile(jnp.linspace(0.1, 1.0, SAMPLES), (TESTS, 1))
    flow = command ** parameters[0] / (1 + command ** parameters[1]) ** parameters[2]

    def advance(state: jax.Array, flow: jax.Array) -> tuple[jax.Array, jax.Array]:
        return 0.9 * state + parameters[3] * jnp.roll(state, 1, axis=0) + parameters[4] * flow, state[0]

    def integrate(travel: jax.Array, step: jax.Array) -> tuple[jax.Array, jax.Array]:
        travel = travel + 1e-3 * step * jnp.exp(-parameters[5] * travel)
        return travel, travel

    speed = jax.lax.scan(advance, jnp.zeros((STATES, TESTS)), flow.T)[1]
    return jax.lax.scan(integrate, jnp.zeros(TESTS), speed)[1].T


@jax.jit
def _normal_equations(parameters: jax.Array) -> jax.Array:
    def derivative(tangent: jax.Array) -> jax.Array:
        return jax.jvp(_residuals, (parameters,), (tangent,))[1]

    columns = jax.vmap(derivative, out_axes=1)(jnp.eye(PARAMETERS))
    return jnp.einsum("tdn,ten->tde", columns, columns)


@jax.jit
def _recurrence(weights: jax.Array) -> jax.Array:
    def advance(state: jax.Array, _: None) -> tuple[jax.Array, None]:
        gates = jnp.tanh(jnp.concatenate([state, state[:, :INPUTS]], axis=1) @ weights)
        return gates[:, :CELLS] * gates[:, CELLS : 2 * CELLS], None

    return jax.lax.scan(advance, jnp.ones((STRETCHES, CELLS), jnp.float32), None, STEPS)[0]


def seconds_of_work() -> float:
    """Return how long this machine now takes for a fixed mixture of work like an identification's, s.

    Compiled loops of simulations, a recurrence of matrix products, and Python, in as many threads.
    """

    def work(_: int) -> None:
        with jax.enable_x64(True):
            parameters = jnp.linspace(0.05, 1.0, PARAMETERS)
            for _ in range(ROUNDS):
                _normal_equations(parameters).block_until_ready()
        _recurrence(jnp.full((CELLS + INPUTS, 4 * CELLS), 0.1, jnp.float32)).block_until_ready()
        sum(float(f"{number / 7:.6g}") for number in range(LINES))

    seconds = []
    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(work, range(THREADS)))
        for _ in range(REPEATS):
            started = time.perf_counter()
            list(pool.map(work, range(THREADS)))
            seconds.append(time.perf_counter() - started)
    return statistics.median(seconds)


def slowness(*seconds_of_works: float) -> float:
    """Return how many times longer this machine takes than the one of the limits; 1 for a faster one.

    Args:
        seconds_of_works: `seconds_of_work` before and after what is timed, as others may use the machine.
    """
    return max(1.0, statistics.fmean(seconds_of_works) / REFERENCE_S)
