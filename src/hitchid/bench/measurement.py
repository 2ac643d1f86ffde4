"""Measured logs of simulated tests: sensors, filters, noise, converter and clock jitter."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from hitchid._support.precision import double_precision
from hitchid.bench.plant import Rig
from hitchid.bench.sensors import CalibrationCurve
from hitchid.bench.simulation import SAMPLE_S, RigMotion
from hitchid.errors import InputError

LARGEST_JITTER = 0.1  # of the sampling time, standard deviation; 4 σ is then below half a sample
COLUMNS = ("time_s", "current_up_A", "current_down_A", "displacement_mm")


@double_precision
def measure(
    rig: Rig,
    motion: RigMotion,
    currents: Float[Array, "..."] | Float[np.ndarray, "..."],
    key: PRNGKeyArray,
    *,
    jitter: float = 0.0,
) -> dict[str, np.ndarray]:
    """Return the columns `time_s`, `current_up_A`, `current_down_A`, `displacement_mm`, each of shape [T, N].

    Angle: lift-arm angle, first-order filter (exact for an input linear between samples),
    calibration error, noise, converter; the displacement follows from it by the linkage's geometry.
    Currents: a row of currents is read back at the end of its 10 ms, through the same filter.

    Args:
        rig: the bench.
        motion: true motion, from `simulate`.
        currents: the currents that `simulate` was called with, A, shape [T, N, 2].
        key: random key of noise and jitter.
        jitter: standard deviation of the clock over its period, at most 0.1; clipped at four times that. The
            time stamps are the true sampling instants.

    Raises:
        InputError: the shapes of motion and currents differ, or the jitter is out of range.
    """
    shape = motion.displacement_m.shape
    if np.shape(currents) != (*shape, 2):
        raise InputError(f"currents: got shape {np.shape(currents)}, expected {(*shape, 2)}")
    if not 0 <= jitter <= LARGEST_JITTER:
        raise InputError(f"jitter: got {jitter:g}, expected 0 to {LARGEST_JITTER:g}")
    # Drawn on the host: compiling the generator takes longer than compiling everything else.
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    noise = jnp.asarray(rng.standard_normal((4, *shape)))
    columns = _measure(rig, motion.displacement_m, jnp.asarray(currents, jnp.float64), noise, jitter)
    return {name: np.asarray(columns[name]) for name in COLUMNS}  # jit sorts the keys


@eqx.filter_jit
def _measure(
    rig: Rig,
    displacement: Float[Array, "t n"],
    currents: Float[Array, "t n 2"],
    noise_samples: Float[Array, "4 t n"],
    jitter: float,
) -> dict[str, Array]:
    sensors, shape = rig.sensors, displacement.shape
    clock_noise, angle_noise, lifting_noise, lowering_noise = noise_samples
    nominal = jnp.broadcast_to(SAMPLE_S * jnp.arange(shape[1]), shape)
    # Clipped, so that stamps never change places.
    clock_jitter = jnp.clip(jitter * clock_noise, -4 * jitter, 4 * jitter)
    time = (nominal + SAMPLE_S * clock_jitter).at[:, 0].set(0.0)  # a log begins at its first sample
    corner = sensors.filter_frequency * SAMPLE_S
    # Filter, then clock, then converter, as in the data acquisition: noise and steps are not smoothed.
    angle = _first_order_filter(rig.linkage.sensor_angle(displacement), corner)
    angle = angle_reading(rig, jax.vmap(jnp.interp)(time, nominal, angle), angle_noise)
    filtered_currents = _filter_held_input(currents, corner)
    current_noise = jnp.stack([lifting_noise, lowering_noise], axis=-1)
    read = current_readings(rig, filtered_currents, current_noise)
    return {
        "time_s": time,
        "current_up_A": read[..., 0],
        "current_down_A": read[..., 1],
        "displacement_mm": 1e3 * rig.linkage.displacement(angle),
    }


def angle_reading(rig: Rig, angle: Float[Array, "..."], noise: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the converter's reading of filtered lift-arm angles, rad; `noise` is of spread one."""
    sensors = rig.sensors
    return _read(rig, angle, sensors.angle_range, sensors.angle_curve, sensors.angle_noise * noise)


def current_readings(
    rig: Rig, currents: Float[Array, "... 2"], noise: Float[Array, "... 2"]
) -> Float[Array, "... 2"]:
    """Return the converter's readings of filtered lifting and lowering currents, A; `noise` of spread one."""
    sensors = rig.sensors
    curves = (sensors.lifting_curve, sensors.lowering_curve)
    spread = sensors.current_noise
    return jnp.stack(
        [
            _read(rig, currents[..., number], sensors.current_range, curve, spread * noise[..., number])
            for number, curve in enumerate(curves)
        ],
        axis=-1,
    )


def _read(rig: Rig, value: Array, full: Array, curve: CalibrationCurve, error: Array) -> Array:
    """Return a value as the converter reads it, with the error of its calibration curve and of noise."""
    reading = value / full
    return full * rig.sensors.quantise(reading + (curve.error(reading) + error))


def _first_order_filter(signal: Float[Array, "t n"], corner: Array) -> Float[Array, "t n"]:
    """Return a signal after a first-order filter, exact for a signal linear between samples."""
    decay = jnp.exp(-corner)
    ramp_gain = 1 - (1 - decay) / corner

    def step(carry: tuple[Array, Array], sample: Array) -> tuple[tuple[Array, Array], Array]:
        output, previous = carry
        output = decay * output + (1 - decay - ramp_gain) * previous + ramp_gain * sample
        return (output, sample), output

    first = signal[:, 0]  # settled: the bench has stood there before the test
    return jax.lax.scan(step, (first, first), signal.T)[1].T


def _filter_held_input(signal: Float[Array, "t n 2"], corner: Array) -> Float[Array, "t n 2"]:
    """Return a signal held between samples after a first-order filter, at the end of each hold."""
    decay = jnp.exp(-corner)

    def step(output: Array, sample: Array) -> tuple[Array, Array]:
        output = sample + (output - sample) * decay
        return output, output

    return jnp.moveaxis(jax.lax.scan(step, jnp.zeros_like(signal[:, 0]), jnp.moveaxis(signal, 1, 0))[1], 0, 1)
