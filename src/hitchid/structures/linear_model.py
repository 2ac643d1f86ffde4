"""Linear state-space model of one direction for other libraries: scipy and python-control."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from hitchid._support.checks import number
from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.errors import InputError
from hitchid.structures.discretisation import discretise_delayed
from hitchid.structures.nonlinearity import NEUTRAL
from hitchid.structures.physical_model import PhysicalModel

if TYPE_CHECKING:
    import control
    from scipy import signal


# Steady state of a physical model: opening command, steady speed, and the command for a speed.

Scalar = Float[Array, ""] | float


def opening_command(physical_model: PhysicalModel, dead_zone: Scalar) -> Float[Array, ""]:
    """Return the command at which flow begins, d₀ + U max(d, 0), in the command's unit."""
    if physical_model.nonlinearity is None:
        return jnp.asarray(dead_zone)
    return dead_zone + physical_model.nonlinearity.opening_command


def steady_speed(
    physical_model: PhysicalModel,
    levels: Float[Array, "*q"],
    dead_zone: Scalar,
    displacement: Scalar | Float[Array, "*q"],
) -> Float[Array, "*q"]:
    """Return K w(c − d₀) g(x): the speed at constant command after the transients, from rest.

    A structure without an integrator reaches a position instead: the speed is that at its start.

    Args:
        physical_model: of a linear structure, at its load.
        levels: command as logged, c; the speed has its sign.
        dead_zone: d₀, in the command's unit.
        displacement: x; without effect in a model without a gain along the stroke.
    """
    effective_command = jnp.sign(levels) * jnp.maximum(jnp.abs(levels) - dead_zone, 0.0)
    nonlinearity = physical_model.nonlinearity
    if nonlinearity is None:
        return physical_model.gain * effective_command
    stroke_gain = nonlinearity.gain(jnp.broadcast_to(displacement, levels.shape))
    return physical_model.gain * nonlinearity.flow(effective_command) * stroke_gain


@eqx.filter_jit
def speeds_at(
    physical_model: PhysicalModel,
    levels: Float[Array, " q"],
    displacements: Float[Array, " q"],
    loads: Float[Array, "q c"],
    dead_zone: Scalar,
) -> Float[Array, " q"]:
    """Return the steady speed of each command, displacement and load; see `steady_speed`, shape [Q]."""

    def speed(level: Array, displacement: Array, load: Array) -> Array:
        return steady_speed(physical_model.at_load(load), level, dead_zone, displacement)

    return jax.vmap(speed)(levels, displacements, loads)


def command_for_speed(
    physical_model: PhysicalModel, speeds: Float[Array, " q"], dead_zone: Scalar, displacement: Scalar
) -> Float[Array, " q"]:
    """Return the command c ≥ d₀ of each speed, the inverse of `steady_speed`; for zero the opening command.

    Not finite for a speed above that of a saturated valve.

    Args:
        physical_model: of a linear structure, at its load.
        speeds: at least zero, in the direction of the command.
        dead_zone, displacement: as in `steady_speed`.
    """
    nonlinearity = physical_model.nonlinearity
    if nonlinearity is None:
        return dead_zone + speeds / physical_model.gain
    flow = speeds / (physical_model.gain * nonlinearity.gain(jnp.asarray(displacement)))
    moving = dead_zone + nonlinearity.command_for_flow(flow)
    return jnp.where(speeds > 0, moving, opening_command(physical_model, dead_zone))


MAX_DELAY_STATES = 5000  # states of the dead time; the matrix of as many takes 200 MB; chosen
PADE_ORDER = 4  # of the dead time in a continuous model; chosen: its phase is exact to 1e-4 rad up to ω T = 2


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


Values = Array | np.ndarray


@short_repr
class SmallSignal(NamedTuple):
    """Linear model from a change of the command to travel about an operating point.

    ẋ = A x + B q(t − T), τ q̇ = u − q, travel = k x₁. Arrays may have a leading axis of parameter vectors.

    Attributes:
        a, b: A and B of the structure, shapes [..., n, n] and [..., n].
        gain: k = w'(u₀) g(x₀), slope of the flow times the gain along the stroke, shape [...].
        spool_lag_s: τ, s; zero without a lag.
        dead_time_s: T, s.
    """

    a: Float[Values, "*s n n"]
    b: Float[Values, "*s n"]
    gain: Float[Values, "*s"]
    spool_lag_s: Float[Values, "*s"]
    dead_time_s: Float[Values, "*s"]

    def rational(self, frequency_hz: Float[np.ndarray, " f"]) -> Complex[np.ndarray, "*s f"]:
        """Return k x₁ᵀ (jω − A)⁻¹ B / (1 + jωτ), the frequency response without the dead time.

        Args:
            frequency_hz: Hz, shape [F].
        """
        s = 2j * np.pi * np.asarray(frequency_hz)
        a, b = np.asarray(self.a)[..., None, :, :], np.asarray(self.b)[..., None, :, None]
        system = s[:, None, None] * np.eye(b.shape[-2]) - a
        states = np.linalg.solve(system, np.broadcast_to(b, (*system.shape[:-1], 1)))
        gain, lag_s = np.asarray(self.gain)[..., None], np.asarray(self.spool_lag_s)[..., None]
        return gain * states[..., 0, 0] / (1 + s * lag_s)

    @double_precision
    def state_space(self, step_s: float | None) -> LinearModel:
        """Return the model of one parameter vector as matrices.

        Args:
            step_s: sampling time, s, for the exact model of a held command, the dead time in delay states;
                None for the continuous model, the dead time as a Padé approximant.

        Raises:
            InputError: the dead time has too many samples.
        """
        if step_s is not None:
            return _discrete(self, number(step_s, "step_s", above=0.0))
        a, b = np.asarray(self.a), np.asarray(self.b)[:, None]
        c = float(self.gain) * np.eye(1, b.size)
        lag_s, dead_time_s = float(self.spool_lag_s), float(self.dead_time_s)
        if lag_s:
            a, b, c = _in_series(
                (a, b, c), (np.array([[-1 / lag_s]]), np.array([[1 / lag_s]]), np.eye(1), 0.0)
            )
        if dead_time_s:
            a, b, c = _in_series((a, b, c), _pade(dead_time_s))
        return LinearModel(a, b, c, None)


def small_signal(
    physical_model: PhysicalModel, command: Float[Array, ""], displacement: Float[Array, ""]
) -> SmallSignal:
    """Return the linear model about an operating point; see `linearise`. It may be mapped over models.

    Args:
        physical_model: of a linear structure, at its load.
        command: u₀, what lies beyond the dead zone, in the command's unit; no gain where the valve is closed.
        displacement: x₀.
    """
    a, b = physical_model.structure.require_linear().state_space(physical_model.values_at(displacement))
    nonlinearity = physical_model.nonlinearity
    if nonlinearity is None:
        return SmallSignal(a, b, jnp.ones(()), jnp.zeros(()), physical_model.dead_time_s)
    gain = jax.grad(nonlinearity.flow)(command) * nonlinearity.gain(displacement)
    (lag_s,) = nonlinearity.named("spool_lag")
    lag_s = jnp.where(lag_s > NEUTRAL["spool_lag"], lag_s, 0.0)
    return SmallSignal(a, b, gain, lag_s, physical_model.dead_time_s)


@eqx.filter_jit
def small_signals(
    physical_model: PhysicalModel,
    vectors: Float[Array, "s r"],
    load: Float[Array, " c"],
    command: Float[Array, ""],
    displacement: Float[Array, ""],
) -> SmallSignal:
    """Return the linear model with each of S parameter vectors, at a load; see `small_signal`."""

    def linear(vector: Float[Array, " r"]) -> SmallSignal:
        at_load = physical_model.with_parameter_vector(vector).at_load(load)
        return small_signal(at_load, command, displacement)

    return jax.vmap(linear)(vectors)


def default_command(physical_model: PhysicalModel) -> Float[Array, ""]:
    """Return u₀ half way from the opening of the valve to the largest command of the tests."""
    nonlinearity = physical_model.nonlinearity
    if nonlinearity is None:
        return jnp.ones(())
    return 0.5 * (nonlinearity.opening_command + nonlinearity.scales.command)


def default_displacement(physical_model: PhysicalModel) -> Float[Array, ""]:
    """Return x₀ in the middle of the displacement's range in the tests."""
    nonlinearity = physical_model.nonlinearity
    return jnp.zeros(()) if nonlinearity is None else nonlinearity.scales.centre


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
            delay states; None for the continuous model, the dead time as a Padé approximant of fourth order.
        command: u₀, what lies beyond the dead zone, in the command's unit; by default half way from the
            opening of the valve to the largest one of the identification tests.
        displacement: x₀; by default the middle of its range in the tests.

    Raises:
        InputError: the structure is not linear, the valve is closed at the operating point, or the dead time
            has too many samples.
    """
    return small_signal_at(physical_model, command, displacement).state_space(step_s)


@double_precision
def small_signal_at(
    physical_model: PhysicalModel, command: float | None, displacement: float | None
) -> SmallSignal:
    """Return the linear model about an operating point where the valve is open; see `linearise`."""
    physical_model.structure.require_linear()
    effective = default_command(physical_model) if command is None else jnp.asarray(float(command))
    place = default_displacement(physical_model) if displacement is None else jnp.asarray(float(displacement))
    nonlinearity = physical_model.nonlinearity
    if nonlinearity is not None and not float(nonlinearity.flow(effective)):
        raise InputError(
            f"command: expected more than {float(nonlinearity.opening_command):.4g} beyond the dead zone, "
            f"where the valve opens; got {float(effective):.4g}"
        )
    return small_signal(physical_model, effective, place)


Matrices = tuple[np.ndarray, np.ndarray, np.ndarray]  # A, B and C


def _in_series(plant: Matrices, first: tuple[np.ndarray, np.ndarray, np.ndarray, float]) -> Matrices:
    """Return A, B and C of a plant whose input is the output of a first system A, B, C and D."""
    (a, b, c), (a1, b1, c1, d1) = plant, first
    size, more = len(a), len(a1)
    return (
        np.block([[a, b @ c1], [np.zeros((more, size)), a1]]),
        np.vstack([d1 * b, b1]),
        np.hstack([c, np.zeros((1, more))]),
    )


def _pade(dead_time_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return A, B, C and D of the approximant of exp(−s T) with magnitude one at all frequencies.

    P(−sT)/P(sT), P(x) = Σ aᵢ xⁱ with aᵢ = aᵢ₋₁ (n − i + 1)/((2n − i + 1) i), in companion form for T = 1
    (Golub & Van Loan, Matrix Computations, sec. 9.3).
    """
    order = PADE_ORDER
    coefficients = np.ones(order + 1)
    for power in range(1, order + 1):
        factor = (order - power + 1) / ((2 * order - power + 1) * power)
        coefficients[power] = coefficients[power - 1] * factor
    denominator = coefficients / coefficients[-1]
    numerator = denominator * (-1.0) ** np.arange(order + 1)
    direct = numerator[-1]
    a = np.eye(order, k=1)
    a[-1] = -denominator[:-1]
    c = (numerator - direct * denominator)[None, :-1]
    return a / dead_time_s, np.eye(order, 1, k=1 - order) / dead_time_s, c, direct


_discretised = jax.jit(discretise_delayed)


def _discrete(small_signal: SmallSignal, step_s: float) -> LinearModel:
    """Return the discrete model: states of the structure, delayed flows, and the spool's lag.

    As in simulation, flow is constant over a sampling interval and follows the mean of the lagged command s:
    s̄[k] = u[k] + τ/h (1 − e^(−h/τ)) (s[k] − u[k]), s[k+1] = u[k] + e^(−h/τ) (s[k] − u[k]).
    """
    discrete = _discretised(small_signal.a, small_signal.b, small_signal.dead_time_s, step_s)
    lag_s, gain = float(small_signal.spool_lag_s), float(small_signal.gain)
    order, delay = discrete.gamma0.size, int(discrete.delay_samples)
    if delay > MAX_DELAY_STATES:
        raise InputError(
            f"step_s: the dead time has {delay} samples of {step_s:g} s, one delay state each; expected at "
            f"most {MAX_DELAY_STATES}; choose a longer sampling time"
        )
    flows = np.stack([np.asarray(discrete.gamma0), np.asarray(discrete.gamma1)], axis=1)
    # States w[k−1] … w[k−m−1]; the last for a fraction of a sample.
    delays = delay + bool(np.any(flows[:, 1]))
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
