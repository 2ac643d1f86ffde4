"""PI and PID control of the position from the error alone: the baselines."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid._support.precision import double_precision
from hitchid._support.short_repr import short_repr
from hitchid.control.controller import HitchController

Scalar = Float[Array, ""]
COMPENSATED = "SIMC PI, dead zone compensated"  # name among the baselines
DERIVATIVE_FILTER = 0.1  # of the derivative time: lag of the derivative (Åström & Hägglund 2006, sec. 3.3)
EFFECTIVE_SHARE = 0.5  # of the fastest speed: where the valve is linearised for the gains; chosen


@short_repr
class PidState(NamedTuple):
    """State of a PID controller.

    Attributes:
        integral: lifting positive.
        error: of the sample before, filtered.
        measured: last valid measurement.
    """

    integral: Scalar
    error: Scalar
    measured: Scalar


@short_repr
class PidController(eqx.Module):
    """u = K_p (e + ∫ e/T_i dt + T_d de/dt), to the lifting valve where positive, else to the lowering valve.

    The integral stops while the current is limited.

    Attributes:
        proportional: K_p of lifting and lowering, shape [2].
        integral_s: T_i, s, shape [2].
        derivative_s: T_d, s, shape [2].
        offset: added to a current that is not zero, shape [2]: the dead zone where it is compensated.
        largest_command: of each current, shape [2].
        step_s: sampling time, s.
    """

    proportional: Float[Array, "2"]
    integral_s: Float[Array, "2"]
    derivative_s: Float[Array, "2"]
    offset: Float[Array, "2"]
    largest_command: Float[Array, "2"]
    step_s: float = eqx.field(static=True)

    @double_precision
    def initial_state(self, displacement: Scalar | float) -> PidState:
        """Return the state of a hitch that is held at a displacement."""
        zero = jnp.zeros(())
        return PidState(zero, zero, jnp.asarray(displacement, jnp.float64))

    @double_precision
    def step(
        self, state: PidState, target: Scalar | float, measured: Scalar | float
    ) -> tuple[PidState, Float[Array, "2"]]:
        """Return the next state, and lifting and lowering current, shape [2]; zero without measurement."""
        target, measured = jnp.asarray(target, jnp.float64), jnp.asarray(measured, jnp.float64)
        return _step(self, state, target, measured)


@eqx.filter_jit
def _step(
    controller: PidController, state: PidState, target: Scalar, measured: Scalar
) -> tuple[PidState, Float[Array, "2"]]:
    is_lost = ~jnp.isfinite(measured)
    position = jnp.where(is_lost, state.measured, measured)
    error = target - position
    number = jnp.where(error >= 0, 0, 1)
    gain, derivative_s = controller.proportional[number], controller.derivative_s[number]
    share = controller.step_s / (DERIVATIVE_FILTER * derivative_s + controller.step_s)
    filtered = state.error + share * (error - state.error)
    rate = (filtered - state.error) / controller.step_s
    integrated = state.integral + controller.step_s * gain / controller.integral_s[number] * error
    direct = gain * (error + derivative_s * rate)
    signed = direct + integrated
    sizes = jnp.stack([signed, -signed])
    currents = jnp.where(sizes > 0, sizes + controller.offset, 0.0)
    is_limited = jnp.any(currents > controller.largest_command) & (jnp.sign(error) == jnp.sign(signed))
    integral = jnp.where(is_limited, state.integral, integrated)
    currents = jnp.where(is_lost, 0.0, jnp.minimum(currents, controller.largest_command))
    integral = jnp.where(is_lost, 0.0, integral)
    return PidState(integral, filtered, position), currents


@double_precision
def baselines(controller: HitchController) -> dict[str, PidController]:
    """Return PI control by the SIMC rules, with and without the dead zone, and one PID for both directions.

    For K e^(−θs)/(s (τs + 1)): K_p = 1/(K 2θ'), T_i = 8 θ' with τ_c = θ' = θ + τ (SIMC, Skogestad 2003,
    PI); K is the slope of the speed over the current at half the fastest speed in mid stroke. The fixed PID
    has the mean K, τ and θ of both directions, τ_c = θ, and the series form of SIMC, K_c = 1/(2 K θ),
    τ_I = 8 θ, τ_D = τ, as the parallel form K_p = K_c f, T_i = τ_I f, T_d = τ_D/f, f = 1 + τ_D/τ_I.
    """
    rows = [_simc(controller, number) for number in range(2)]
    gain, lag_s, dead_time_s = (jnp.stack(column) for column in zip(*rows, strict=True))
    largest = jnp.asarray([axis.largest_command for axis in controller.axes])
    dead_zones = jnp.asarray([axis.model.dead_zone for axis in controller.axes])
    total_s = lag_s + dead_time_s
    none = jnp.zeros(2)
    simc = PidController(1 / (gain * 2 * total_s), 8 * total_s, none, none, largest, controller.step_s)
    both = jnp.ones(2)
    mean_gain, mean_lag, mean_dead = (jnp.mean(column) * both for column in (gain, lag_s, dead_time_s))
    parallel = 1 + mean_lag / (8 * mean_dead)
    fixed = PidController(
        parallel / (mean_gain * 2 * mean_dead),
        8 * mean_dead * parallel,
        mean_lag / parallel,
        none,
        largest,
        controller.step_s,
    )
    return {
        "SIMC PI": simc,
        COMPENSATED: eqx.tree_at(lambda c: c.offset, simc, dead_zones),
        "fixed PID": fixed,
    }


def _simc(controller: HitchController, number: int) -> tuple[Scalar, Scalar, Scalar]:
    """Return K, τ and θ, the latter in s; half a sample of the hold belongs to the dead time."""
    axis = controller.axes[number]
    nonlinearity = axis.model.benchmark.nonlinearity
    place = jnp.zeros(()) if nonlinearity is None else nonlinearity.scales.centre
    speed = EFFECTIVE_SHARE * axis.fastest(place)
    slope = 1 / jax.grad(axis.current_for)(speed, place)
    return slope, controller.lags_s[number], (axis.dead_time_samples + 0.5) * axis.step_s
