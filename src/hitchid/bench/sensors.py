"""Sensors and data acquisition: calibration curve, noise, anti-alias filter, converter, clock."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid.bench.quantities import quantity
from hitchid.bench.valves import Scalar

HARMONICS = np.array([0.5, 1.0, 1.5])  # f_k, periods over full scale (chosen)


class CalibrationCurve(eqx.Module):
    """Calibration error e(r) = Σ a_k sin(2π f_k r + φ_k), error and reading r over full scale.

    Attributes:
        amplitudes: a_k; their sum is the largest error.
        phases: φ_k, rad.
    """

    amplitudes: Float[Array, " k"]
    phases: Float[Array, " k"]

    @classmethod
    def random(cls, rng: np.random.Generator, largest: float) -> "CalibrationCurve":
        """Draw a curve whose error nowhere exceeds `largest` of full scale."""
        weights = rng.uniform(0.3, 1.0, HARMONICS.size)
        amplitudes = largest * weights / weights.sum()
        return cls(jnp.asarray(amplitudes), jnp.asarray(rng.uniform(0, 2 * np.pi, HARMONICS.size)))

    def error(self, reading: Array) -> Array:
        """Return the error over full scale at readings over full scale."""
        angle = 2 * jnp.pi * HARMONICS * reading[..., None] + self.phases
        return jnp.sum(self.amplitudes * jnp.sin(angle), axis=-1)


class Sensors(eqx.Module):
    """Angle sensor on the lift arm and two coil-current sensors, on one converter.

    Attributes:
        angle_curve, lifting_curve, lowering_curve: calibration errors, drawn once for a rig.
        angle_range: full scale of the angle sensor, rad.
        current_range: full scale of the current sensors, A.
        curve_error: largest calibration error over full scale.
        angle_noise, current_noise: white noise over full scale, rms, at the converter's input.
        filter_frequency: corner of the first-order anti-alias filters, rad/s.
        converter_bits: resolution over full scale.
        calibration_seed: seed of the random curves.
    """

    angle_curve: CalibrationCurve
    lifting_curve: CalibrationCurve
    lowering_curve: CalibrationCurve
    angle_range: Scalar = quantity("rad", 0.1, 6.3)
    current_range: Scalar = quantity("A", 0.1, 100.0)
    curve_error: Scalar = quantity("1", 0.0, 0.05)
    angle_noise: Scalar = quantity("1", 0.0, 0.05)
    current_noise: Scalar = quantity("1", 0.0, 0.05)
    filter_frequency: Scalar = quantity("rad/s", 1.0, 1e5)
    converter_bits: Scalar = quantity("1", 4.0, 32.0)
    calibration_seed: Scalar = quantity("1", 0.0, 1e9)

    def quantise(self, reading: Array) -> Array:
        """Return readings over full scale, quantised and clipped by the converter."""
        count = 2.0**self.converter_bits
        return jnp.clip(jnp.round(reading * count), 0, count - 1) / count
