"""The bench one sample at a time, for a loop that is closed over it: `reset`, then `step` by `step`.

Both are functions without side effects that may be compiled, mapped over rigs, states and disturbances, and
scanned over samples. The rig is an argument of every step, so that implement, oil, wear and pump may change.
"""

import time
from collections.abc import Callable, Iterator
from itertools import count
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.bench.measurement import angle_reading, current_readings
from hitchid.bench.plant import Rig, RigState, at_rest
from hitchid.bench.simulation import SAMPLE_S, advance_sample, check_range
from hitchid.bench.valves import Scalar
from hitchid.errors import InputError

# Pacing of the stepping bench by the wall clock, for a controller that runs beside it in real time.


def real_time(
    *, clock: Callable[[], float] = time.perf_counter, sleep: Callable[[float], object] = time.sleep
) -> Iterator[float]:
    """Yield at the start of every sample of 10 ms how late it is, s; without end.

    Sample k begins at t₀ + k h of the clock, t₀ being the first one's: a sample that is late does not delay
    those that follow, and none is left out.

    Args:
        clock: monotonic time, s.
        sleep: waits for a time, s.
    """
    start = clock()
    for sample in count():
        # From the start, not from the last sample, whose lateness would add up.
        early = start + sample * SAMPLE_S - clock()
        if early > 0:
            sleep(early)
        yield max(clock() - start - sample * SAMPLE_S, 0.0)


@short_repr
class Disturbance(NamedTuple):
    """What acts on the bench over one sample, beside its currents.

    Attributes:
        load_force_n: soil resistance at the implement, downward, N.
        sensor_offset_rad: error of the angle sensor since it jumped, rad.
        sensor_stuck: whether the angle sensor keeps its last reading.
        sensor_lost: whether the angle sensor gives no reading.
    """

    load_force_n: Float[Array, ""] | float = 0.0
    sensor_offset_rad: Float[Array, ""] | float = 0.0
    sensor_stuck: Bool[Array, ""] | bool = False
    sensor_lost: Bool[Array, ""] | bool = False


@short_repr
class Measurement(NamedTuple):
    """What the data acquisition reads at one sample.

    Attributes:
        time_s: since `reset`, s.
        displacement_mm: of the piston, from the angle; NaN where the sensor gives none.
        currents_a: lifting and lowering coil current of the sample before, A, shape [2].
    """

    time_s: Float[Array, ""]
    displacement_mm: Float[Array, ""]
    currents_a: Float[Array, "2"]


@short_repr
class BenchState(NamedTuple):
    """State of the bench and of its data acquisition at one sample.

    Attributes:
        plant: of the bench; its displacement is the true one.
        filtered_angle: lift-arm angle after the filter, rad.
        angle: the same before the filter.
        filtered_currents: currents after the filter, A, shape [2].
        reading_rad: last reading of the angle sensor.
        samples: since `reset`.
        key: of the noise to come.
    """

    plant: RigState
    filtered_angle: Float[Array, ""]
    angle: Float[Array, ""]
    filtered_currents: Float[Array, "2"]
    reading_rad: Float[Array, ""]
    samples: Int[Array, ""]
    key: PRNGKeyArray


@double_precision
def reset(
    rig: Rig,
    key: PRNGKeyArray,
    *,
    initial_displacement_m: Scalar | float,
    disturbance: Disturbance = Disturbance(),  # noqa: B008
) -> tuple[BenchState, Measurement]:
    """Return the bench at rest with closed valves, the load held, and its first measurement.

    Args:
        rig: the bench.
        key: random key of the noise.
        initial_displacement_m: of the piston, m.
        disturbance: at rest, and on the first reading.

    Raises:
        InputError: the displacement is not within the stroke.
    """
    initial = jnp.asarray(initial_displacement_m, jnp.float64)
    check_range("initial_displacement_m", initial, 0.0, rig.cylinder.stroke)
    return _reset(rig, key, initial, disturbance)


@double_precision
def step(
    rig: Rig,
    state: BenchState,
    currents: Float[Array, "..."] | Float[np.ndarray, "..."],
    disturbance: Disturbance = Disturbance(),  # noqa: B008
) -> tuple[BenchState, Measurement]:
    """Return the bench 10 ms later and its measurement then.

    Args:
        rig: the bench, which may have other parameters than in the step before.
        state: of the bench.
        currents: lifting and lowering, held for 10 ms, A, shape [2]; one that is negative or not finite
            counts as zero.
        disturbance: over the sample, and on its reading.

    Raises:
        InputError: there are not two currents.
    """
    if np.shape(currents) != (2,):
        raise InputError(f"currents: got shape {np.shape(currents)}, expected [2], lifting and lowering")
    return _step(rig, state, jnp.asarray(currents, jnp.float64), disturbance)


@eqx.filter_jit
def _reset(
    rig: Rig, key: PRNGKeyArray, displacement: Scalar, disturbance: Disturbance
) -> tuple[BenchState, Measurement]:
    angle = rig.linkage.sensor_angle(displacement)
    state = BenchState(
        plant=at_rest(rig, displacement, jnp.asarray(disturbance.load_force_n, jnp.float64)),
        filtered_angle=angle,
        angle=angle,
        filtered_currents=jnp.zeros(2),
        reading_rad=angle,
        samples=jnp.zeros((), jnp.int64),
        key=key,
    )
    return _measured(rig, state, disturbance)


@eqx.filter_jit
def _step(
    rig: Rig, state: BenchState, currents: Float[Array, "2"], disturbance: Disturbance
) -> tuple[BenchState, Measurement]:
    # No error here, as in a compiled loop there can be none: a coil without a current stays closed.
    applied = jnp.where(jnp.isfinite(currents), jnp.maximum(currents, 0.0), 0.0)
    force = jnp.asarray(disturbance.load_force_n, jnp.float64)
    plant = advance_sample(rig, state.plant, applied, force, state.samples.astype(float))
    angle = rig.linkage.sensor_angle(plant.displacement)
    # As in a log: exact for an angle that is linear between samples.
    corner = rig.sensors.filter_frequency * SAMPLE_S
    decay = jnp.exp(-corner)
    ramp_gain = 1 - (1 - decay) / corner
    moved = state._replace(
        plant=plant,
        filtered_angle=decay * state.filtered_angle
        + (1 - decay - ramp_gain) * state.angle
        + ramp_gain * angle,
        angle=angle,
        filtered_currents=applied + (state.filtered_currents - applied) * decay,
        samples=state.samples + 1,
    )
    return _measured(rig, moved, disturbance)


def _measured(rig: Rig, state: BenchState, disturbance: Disturbance) -> tuple[BenchState, Measurement]:
    """Return the state with the noise drawn and the reading kept, and the measurement."""
    key, own = jax.random.split(state.key)  # drawn in any case: a fault does not shift the noise after it
    noise = jax.random.normal(own, (3,), jnp.float64)
    fresh = angle_reading(rig, state.filtered_angle + disturbance.sensor_offset_rad, noise[0])
    # Stuck at the last reading, with the noise that it had; a lost one keeps the state for when it returns.
    reading = jnp.where(disturbance.sensor_stuck, state.reading_rad, fresh)
    displacement = jnp.where(disturbance.sensor_lost, jnp.nan, 1e3 * rig.linkage.displacement(reading))
    measurement = Measurement(
        SAMPLE_S * state.samples, displacement, current_readings(rig, state.filtered_currents, noise[1:])
    )
    return state._replace(reading_rad=reading, key=key), measurement
