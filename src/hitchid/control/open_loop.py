"""Frequency response of a hitch under its controller, open at the measurement: the loop of the margins."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Complex, Float

from hitchid._support.precision import double_precision
from hitchid._support.short_repr import short_repr
from hitchid.control.controller import Gains
from hitchid.structures import SmallSignal
from hitchid.structures.discretisation import discretise_delayed

FREQUENCIES = 460  # of a loop, up to half the sampling frequency; chosen
LOWEST_RAD_S = 0.01  # rad/s, below any crossing of a loop that settles within a minute; chosen


@short_repr
class PlantResponse(NamedTuple):
    """Response from current to displacement over frequency, exact for a current held between samples.

    Attributes:
        undelayed: without the dead time, shape [..., F].
        delay: of the dead time, shape [..., F].
        speed_gain: steady speed over current, shape [...].
    """

    undelayed: Complex[np.ndarray, "*s f"]
    delay: Complex[np.ndarray, "*s f"]
    speed_gain: Float[np.ndarray, "*s"]


def frequencies(step_s: float) -> Float[np.ndarray, " f"]:
    """Return the frequencies of a loop up to half the sampling frequency, rad/s."""
    return np.geomspace(LOWEST_RAD_S, np.pi / step_s, FREQUENCIES)


@double_precision
def plant_response(
    plant: SmallSignal, omega: Float[np.ndarray, " f"], step_s: float, *, exact_fraction: bool = True
) -> PlantResponse:
    """Return the response of linear models, one or S.

    Args:
        plant: linear models of one direction, with or without a leading axis.
        omega: rad/s, shape [F].
        step_s: sampling time, s.
        exact_fraction: the dead time's fraction of a sample as the plant has it, else as a controller that
            interpolates between samples.
    """
    z = np.exp(1j * omega * step_s)
    a, b = np.asarray(plant.a), np.asarray(plant.b)
    dead_time = np.asarray(plant.dead_time_s)
    many = a.ndim > 2
    discretise = jax.vmap(discretise_delayed, (0, 0, 0, None)) if many else discretise_delayed
    whole = jax.tree.map(np.asarray, jax.jit(discretise)(a, b, 0.0 * dead_time, step_s))
    undelayed = _held(whole.transition, whole.gamma0[..., None, :] + 0j, z)
    samples = dead_time[..., None] / step_s
    count = np.floor(samples + 1e-9)
    fraction = np.clip(samples - count, 0.0, 1.0)
    if exact_fraction:
        parts = jax.tree.map(np.asarray, jax.jit(discretise)(a, b, dead_time, step_s))
        inputs = parts.gamma0[..., None, :] + parts.gamma1[..., None, :] / z[:, None]
        delay = _held(parts.transition, inputs, z) / undelayed * z**-count
    else:
        delay = z**-count * (1 - fraction + fraction / z)
    lag_s = np.asarray(plant.spool_lag_s)[..., None]
    safe = np.where(lag_s > 0, lag_s, 1.0)
    decay = np.where(lag_s > 0, np.exp(-step_s / safe), 0.0)
    share = np.where(lag_s > 0, safe / step_s * (1 - decay), 0.0)
    spool = 1 - share + share * (1 - decay) / (z - decay)
    gain = np.asarray(plant.gain)[..., None]
    steady = -np.linalg.solve(a[..., 1:, 1:], b[..., 1:, None])
    slope = b[..., 0] + (a[..., :1, 1:] @ steady)[..., 0, 0]
    return PlantResponse(gain * spool * undelayed, delay, gain[..., 0] * slope)


def open_loop(
    gains: Gains,
    plant: PlantResponse,
    model: PlantResponse,
    omega: Float[np.ndarray, " f"],
    step_s: float,
) -> Complex[np.ndarray, "*s f"]:
    """Return the loop L = C S P/(1 + S (C (M₀ − M) + (k_v D + k_a D²) M₀)), open at the measurement.

    C = k_p + k_i h z/(z − 1), D = (1 − z⁻¹)/h, S the inverse of the valve's slope in the model, P the plant,
    M₀ and M the controller's model without and with the dead time; see `HitchController`.

    Args:
        gains: of the direction.
        plant: one or S plants.
        model: of the controller.
        omega: rad/s, shape [F].
        step_s: h, s.
    """
    z = np.exp(1j * omega * step_s)
    controller = float(gains.proportional) + float(gains.integral) * step_s * z / (z - 1)
    inverse = 1 / model.speed_gain[..., None]
    predictor = controller * model.undelayed * (1 - model.delay)
    difference = (1 - 1 / z) / step_s
    inner = model.undelayed * (float(gains.speed) * difference + float(gains.acceleration) * difference**2)
    return controller * inverse * plant.undelayed * plant.delay / (1 + inverse * (predictor + inner))


def _held(
    transition: Float[np.ndarray, "*s n n"],
    inputs: Complex[np.ndarray, "*s _ n"],
    z: Complex[np.ndarray, " f"],
) -> Complex[np.ndarray, "*s f"]:
    """Return x₁ of (z − Φ)⁻¹ Γ."""
    system = z[:, None, None] * np.eye(transition.shape[-1]) - transition[..., None, :, :]
    vectors = np.broadcast_to(inputs, system.shape[:-1])[..., None]
    return np.linalg.solve(system, vectors)[..., 0, 0]
