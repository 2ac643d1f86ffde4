"""Stability margins of a sampled loop from its frequency response, the dead time included exactly."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from hitchid._support.short_repr import short_repr


@short_repr
class Margins(NamedTuple):
    """Stability margins of loops, each of shape [...].

    Attributes:
        gain_db: smallest factor on the loop, dB, that makes it unstable; negative for an unstable loop.
        phase_deg: smallest lag that makes it unstable, °; negative for an unstable loop.
        delay_s: smallest further dead time that makes it unstable, s; zero for an unstable loop.
        sensitivity: Ms, largest magnitude of the sensitivity 1/(1 + L).
        disk: symmetric disk margin α (Seiler, Packard & Gahinet 2020, An introduction to disk margins).
    """

    gain_db: Float[np.ndarray, "*b"]
    phase_deg: Float[np.ndarray, "*b"]
    delay_s: Float[np.ndarray, "*b"]
    sensitivity: Float[np.ndarray, "*b"]
    disk: Float[np.ndarray, "*b"]


def margins(loop: Complex[np.ndarray, "*b f"], omega: Float[np.ndarray, " f"]) -> Margins:
    """Return the margins of loops whose poles are stable but for integrators.

    Gain: −20 log₁₀ abs(L) at the crossings of −180°, the smallest. Phase: arg L + 180° where abs(L) falls
    through one, the smallest, from −180 to 180°. Delay: that angle over the frequency, none where it is
    negative. Crossings are interpolated along straight lines between frequencies.

    Args:
        loop: response L of the open loop.
        omega: ascending frequencies, rad/s, shape [F].
    """
    phase = np.unwrap(np.angle(loop), axis=-1)
    # Half a sample of dead time leaves nothing at the Nyquist frequency, whose logarithm would be infinite.
    log_size = np.log(np.maximum(np.abs(loop), np.finfo(float).tiny))
    gain_db = _at_crossings(phase_remainder(phase), -20 / np.log(10) * log_size)
    falls = (log_size[..., :-1] >= 0) & (log_size[..., 1:] < 0)
    share = _share(log_size)
    angle = np.rad2deg(phase[..., :-1] + share * np.diff(phase, axis=-1)) + 180.0
    frequency = omega[:-1] + share * np.diff(omega)
    signed = (angle + 180.0) % 360.0 - 180.0
    phase_deg = np.where(falls, signed, np.inf).min(axis=-1)
    delay_s = np.where(falls, np.deg2rad(np.maximum(signed, 0.0)) / frequency, np.inf).min(axis=-1)
    difference = 1 + loop
    sensitivity = np.max(1 / np.abs(difference), axis=-1)
    disk = np.min(2 * np.abs(difference) / np.abs(1 - loop), axis=-1)
    return Margins(*map(np.asarray, (gain_db, phase_deg, delay_s, sensitivity, disk)))


def phase_remainder(phase: Float[np.ndarray, "*b f"]) -> Float[np.ndarray, "*b f"]:
    """Return the phase less the nearest odd multiple of −180°, rad."""
    return (phase + 2 * np.pi) % (2 * np.pi) - np.pi


def _share(values: Float[np.ndarray, "*b f"]) -> Float[np.ndarray, "*b g"]:
    """Return where between two samples a line through them is zero, 0 to 1 where it is."""
    change = np.diff(values, axis=-1)
    return np.clip(-values[..., :-1] / np.where(change == 0, 1.0, change), 0.0, 1.0)


def _at_crossings(
    remainder: Float[np.ndarray, "*b f"], values: Float[np.ndarray, "*b f"]
) -> Float[np.ndarray, "*b"]:
    """Return the smallest value at which a remainder crosses zero; infinite without a crossing."""
    crosses = (np.sign(remainder[..., :-1]) != np.sign(remainder[..., 1:])) & (
        np.abs(np.diff(remainder, axis=-1)) < np.pi
    )
    share = _share(remainder)
    at_crossing = values[..., :-1] + share * np.diff(values, axis=-1)
    return np.asarray(np.where(crosses, at_crossing, np.inf).min(axis=-1))
