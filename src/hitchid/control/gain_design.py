"""Gains of a position controller at a bandwidth, by two methods."""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from hitchid.control.controller import Gains

INTEGRAL_RATIO = 8.0  # k_p²/k_i; 4 is a double closed-loop pole of an integrator, 8 overshoots less; chosen
Lags = tuple[float, float]  # a₁ and a₂ of the speed's denominator 1 + a₁ s + a₂ s², s and s²


def pi_gains(bandwidth: float, lags: Lags, step_s: float) -> Gains:
    """Return the gains of PI control of an integrator at a bandwidth, rad/s."""
    del lags, step_s
    return Gains(bandwidth, bandwidth**2 / INTEGRAL_RATIO)


def lqi_gains(bandwidth: float, lags: Lags, step_s: float) -> Gains:
    """Return the gains that minimise Σ e² + (ω/ρ ∫e)² + (v/ω)² for y' = s, s + a₁ s' + a₂ s'' = v.

    The states are the integral of the error, the position, the speed s and the acceleration.

    Args:
        bandwidth: ω, rad/s.
        lags: a₁ and a₂, s and s².
        step_s: sampling time, s.
    """
    a1, a2 = max(lags[0], step_s), max(lags[1], step_s**2)
    a = np.zeros((4, 4))
    a[[0, 1, 2], [1, 2, 3]] = 1.0
    a[3, 2:] = -1 / a2, -a1 / a2
    b = np.array([[0.0], [0.0], [0.0], [1 / a2]])
    block = expm(step_s * np.block([[a, b], [np.zeros((1, 5))]]))
    transition, held = block[:4, :4], block[:4, 4:]
    weights = np.diag([(bandwidth / INTEGRAL_RATIO) ** 2, 1.0, 0.0, 0.0])
    cost = np.array([[bandwidth**-2]])
    riccati = solve_discrete_are(transition, held, weights, cost)
    feedback = np.linalg.solve(cost + held.T @ riccati @ held, held.T @ riccati @ transition)
    integral, position, speed, acceleration = feedback[0].tolist()
    return Gains(position, integral, speed, acceleration)


GainsOf = Callable[[float, Lags, float], Gains]
METHODS: Mapping[str, GainsOf] = {"PI": pi_gains, "LQI": lqi_gains}
