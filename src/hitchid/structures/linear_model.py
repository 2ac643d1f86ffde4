"""Linear state-space model of one direction for other libraries: scipy and python-control."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hitchid._support.checks import number
from hitchid._support.precision import double_precision
from hitchid._support.short_repr import short_repr
from hitchid.errors import InputError
from hitchid.structures.physical_model import PhysicalModel
from hitchid.structures.static_nonlinearity import NEUTRAL, StaticNonlinearity

if TYPE_CHECKING:
    import control
    from scipy import signal

MAX_DELAY_STATES = 5000  # states of the dead time; the matrix of as many takes 200 MB; chosen


@short_repr
@dataclass(frozen=True)
class LinearModel:
    """x[k+1] = A x[k] + B u[k], y[k] = C x[k]; without a sampling time ẋ = A x + B u, y = C x.

    Attributes:
        a, b, c: A, B and C, shapes [n, n], [n, 1] and [1, n].
        step_s: sampling time, s; None for the continuous model.
    """

    a: Float[np.ndarray, "n n"]
    b: Float[np.ndarray, "n 1"]
    c: Float[np.ndarray, "1 n"]
    step_s: float | None

    def to_scipy(self) -> "signal.StateSpace":
        """Return the model as `scipy.signal` has it, for `scipy.signal.lsim` and `scipy.signal.dlsim`."""
        from scipy import signal  # not at the top: half a second

        clock = {} if self.step_s is None else {"dt": self.step_s}
        return signal.StateSpace(self.a, self.b, self.c, np.zeros((1, 1)), **clock)

    def to_control(self) -> "control.StateSpace":
        """Return the model as python-control has it, with the input `command` and the output `displacement`.

        Raises:
            InputError: python-control is not installed.
        """
        try:
            import control
        except ImportError as error:
            raise InputError(
                "python-control: expected it to be installed; run: pip install 'hitchid[control]'"
            ) from error
        clock = 0 if self.step_s is None else self.step_s
        names = {"inputs": ["command"], "outputs": ["displacement"]}
        return control.StateSpace(self.a, self.b, self.c, np.zeros((1, 1)), clock, **names)


@double_precision
def linearise(
    physical_model: PhysicalModel,
    step_s: float | None = None,
    *,
    command: float | None = None,
    displacement: float | None = None,
) -> LinearModel:
    """Return the linear model from command to travel about an operating point.

    With the valve's flow w(u), the gain along the stroke g(x) and the linear structure G(s) at x₀, travel
    follows a small change of the command by w'(u₀) g(x₀) G(s), with spool lag and dead time. Without
    nonlinearities that is G(s) at any operating point. The play of a hysteresis is taken as passed: the
    changes of the command continue in one sense.

    Args:
        physical_model: of a linear structure, at its load.
        step_s: sampling time, s, for the exact model of a command held between samples, the dead time in
            delay states; None for the continuous model.
        command: u₀, what lies beyond the dead zone, in the command's unit; by default half way from the
            opening of the valve to the largest one of the identification tests.
        displacement: x₀; by default the middle of its range in the tests.

    Raises:
        InputError: the structure is not linear, the valve is closed at the operating point, or the model is
            continuous and has a dead time, which no finite number of states represents.
    """
    structure, nonlinearity = physical_model.structure.require_linear(), physical_model.nonlinearity
    if displacement is not None:
        physical_model = physical_model.at(jnp.asarray(float(displacement)))
    gain, lag_s = 1.0, 0.0
    if nonlinearity is not None:
        gain = _slope(nonlinearity, command, displacement)
        spool_lag = float(nonlinearity.named("spool_lag")[0])
        lag_s = spool_lag if spool_lag > NEUTRAL["spool_lag"] else 0.0
    if step_s is not None:
        return _discrete(physical_model, number(step_s, "step_s", above=0.0), gain, lag_s)
    dead_time_s = float(physical_model.dead_time_s)
    if dead_time_s:
        raise InputError(
            f"step_s: expected a sampling time, since a dead time of {dead_time_s:.4g} s has no continuous "
            "state-space model; got None"
        )
    a, b = map(np.asarray, structure.state_space(physical_model.values))
    if lag_s:
        a = np.block([[a, b[:, None]], [np.zeros((1, b.size)), np.array([[-1 / lag_s]])]])
        b = np.append(np.zeros(b.size), 1 / lag_s)
    return LinearModel(a, b[:, None], gain * np.eye(1, b.size), None)


def _slope(nonlinearity: StaticNonlinearity, command: float | None, displacement: float | None) -> float:
    """Return w'(u₀) g(x₀)."""
    scales = nonlinearity.scales
    position = scales.centre if displacement is None else jnp.asarray(float(displacement))
    opening = nonlinearity.opening_command
    effective_command = 0.5 * (opening + scales.command) if command is None else jnp.asarray(float(command))
    if not float(nonlinearity.flow(effective_command)):
        raise InputError(
            f"command: expected more than {float(opening):.4g} beyond the dead zone, where "
            f"the valve opens; got {float(effective_command):.4g}"
        )
    slope = jax.grad(nonlinearity.flow)(effective_command)
    return float(slope * nonlinearity.gain(position))


def _discrete(physical_model: PhysicalModel, step_s: float, gain: float, lag_s: float) -> LinearModel:
    """Return the discrete model: states of the structure, delayed flows, and the spool's lag.

    As in simulation, flow is constant over a sampling interval and follows the mean of the lagged command s:
    s̄[k] = u[k] + τ/h (1 − e^(−h/τ)) (s[k] − u[k]), s[k+1] = u[k] + e^(−h/τ) (s[k] − u[k]).
    """
    discrete = physical_model.discretised(step_s)
    order, delay = discrete.gamma0.size, int(discrete.delay_samples)
    if delay > MAX_DELAY_STATES:
        raise InputError(
            f"step_s: the dead time has {delay} samples of {step_s:g} s, one delay state each; expected at "
            f"most {MAX_DELAY_STATES}; choose a longer sampling time"
        )
    flows = np.stack([np.asarray(discrete.gamma0), np.asarray(discrete.gamma1)], axis=1)
    delays = delay + bool(
        np.any(flows[:, 1])
    )  # states w[k−1] … w[k−m−1]; the last for a fraction of a sample
    size = order + delays
    a, b = np.zeros((size, size)), np.zeros(size)
    a[:order, :order] = np.asarray(discrete.transition)
    a[order + 1 :, order:-1] += np.eye(max(delays - 1, 0))
    b[order : order + 1] = 1.0
    for age, column in enumerate(flows.T, start=delay):
        if age == 0:
            b[:order] += column
        elif np.any(column):
            a[:order, order + age - 1] += column
    if lag_s:
        decay = np.exp(-step_s / lag_s)
        share = -lag_s / step_s * np.expm1(-step_s / lag_s)  # of s[k] in its mean
        a = np.block([[a, share * b[:, None]], [np.zeros((1, size)), np.array([[decay]])]])
        b = np.append((1 - share) * b, 1 - decay)
    return LinearModel(a, b[:, None], gain * np.eye(1, b.size), step_s)
