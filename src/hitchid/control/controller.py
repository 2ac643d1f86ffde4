"""Position controller of a hitch: reference, inverse of each valve, predicted position, hold window."""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.control.axis import Axis, AxisState

# Reference of the position: what the lever asks for, within the speed and acceleration of the hitch.

Scalar = Float[Array, ""]


@short_repr
class Reference(NamedTuple):
    """Where the hitch should be.

    Attributes:
        position: of the hitch.
        speed: its speed.
        acceleration: over the sample before.
    """

    position: Scalar
    speed: Scalar
    acceleration: Scalar

    @classmethod
    def at_rest(cls, position: Scalar) -> "Reference":
        """Return the reference that stands at a position."""
        return cls(position, jnp.zeros(()), jnp.zeros(()))

    def at_rest_where(self, stands: Bool[Array, ""], position: Scalar) -> "Reference":
        """Return this reference, or that which stands at a position."""
        anew = Reference.at_rest(position)
        return Reference(*(jnp.where(stands, *pair) for pair in zip(anew, self, strict=True)))


@short_repr
class ReferenceLimits(eqx.Module):
    """Limits of the reference, each for lifting and lowering, shape [2].

    Attributes:
        speed: v̂, largest of the hitch; the reference may be faster, but accelerates within it only.
        deceleration: of a speed that falls.
    """

    speed: Float[Array, "2"]
    deceleration: Float[Array, "2"]

    def step(self, reference: Reference, target: Scalar, target_speed: Scalar, step_s: float) -> Reference:
        """Return the reference one sample later, on the fastest way to a target that moves at a speed.

        With the distance e to the target and the deceleration a, the speed beyond that of the target is
        v = −a h/2 + √((a h/2)² + 2 a abs(e)), from which a deceleration that changes every h stops there, and
        at most abs(e)/h, with which it is reached in this sample. Far away it asks for the largest current.

        Args:
            reference: now.
            target: of the position.
            target_speed: of the target.
            step_s: sampling time h, s.
        """
        distance = target - reference.position
        upward = distance > 0
        braking = jnp.where(upward, *self.deceleration)
        # Of a continuous v = √(2 a e) the samples would come too late by half of one, and pass the target.
        half = 0.5 * braking * step_s
        closing = jnp.minimum(
            jnp.sqrt(half**2 + 2 * braking * jnp.abs(distance)) - half, jnp.abs(distance) / step_s
        )
        speed = target_speed + jnp.sign(distance) * closing
        within = [jnp.clip(size, -self.speed[1], self.speed[0]) for size in (reference.speed, speed)]
        # A reference that stops decelerates as the direction can in which it moved.
        limit = jnp.where(jnp.where(speed == 0, reference.speed, speed) > 0, *self.deceleration)
        acceleration = jnp.clip((within[1] - within[0]) / step_s, -limit, limit)
        return Reference(reference.position + step_s * speed, speed, acceleration)


TARGET_SPEED_S = 0.05  # s, time constant of the speed of a moving target; chosen: five samples
SMOOTHING_S = 0.2  # s, time constant of the smoothed position; chosen: a quarter of the noise is left
# The outer window doubles where a held hitch has to be moved back, and halves in so many s, up to a factor:
# a leak, or a valve whose smallest pulse is wider than the window, costs one action in this time; chosen.
REST_S, WIDEST = 20.0, 4.0
STILL_SHARE = 0.003  # of the largest speed; a target that moves less stands still; chosen


@short_repr
class Gains(NamedTuple):
    """Gains of one direction; the controlled quantity is the speed.

    Attributes:
        proportional: speed over error of the position, 1/s.
        integral: change of the speed over error of the position, 1/s².
        speed: speed over error of the predicted speed, 1.
        acceleration: speed over error of the predicted acceleration, s.
    """

    proportional: Scalar | float
    integral: Scalar | float
    speed: Scalar | float = 0.0
    acceleration: Scalar | float = 0.0


@short_repr
class HoldWindow(NamedTuple):
    """Errors of the position between which a standing hitch is held with closed valves.

    Attributes:
        inner: below this error the valves close.
        outer: above this error they open again.
    """

    inner: Scalar | float
    outer: Scalar | float


@short_repr
class ControllerState(NamedTuple):
    """State of a controller.

    Attributes:
        axes: models of lifting and lowering.
        reference: shaped reference.
        integral: speed that the integral part asks for.
        is_holding: whether the hitch is held with closed valves.
        widening: factor on the outer window, from one to `WIDEST`.
        smoothed: predicted position without most of its noise.
        drift: speed of the smoothed position beyond the predicted one.
        measured: last valid measurement.
        is_lost: whether the last measurement was missing.
        target: last valid target.
        target_speed: of a moving target.
        commands: last currents, shape [2].
    """

    axes: tuple[AxisState, AxisState]
    reference: Reference
    integral: Scalar
    is_holding: Bool[Array, ""]
    widening: Scalar
    smoothed: Scalar
    drift: Scalar
    measured: Scalar
    is_lost: Bool[Array, ""]
    target: Scalar
    target_speed: Scalar
    commands: Float[Array, "2"]


@short_repr
class HitchController(eqx.Module):
    """Position controller of a hitch, one sample at a time: `initial_state`, then `step` by `step`.

    Displacements, speeds and commands are in the units of the identified model, such as mm, mm/s and A.

    With the reference r, and position y_p, speed v_p and acceleration a_p that the model predicts a dead time
    ahead::

        y_p = y + travel of the last dead time that is not measured yet
        v   = ṙ + τ r̈ + k_p (r − y_p) + k_v (ṙ − v_p) + k_a (r̈ − a_p) + ∫ k_i (r − y_p) dt

    The current of the direction of v is the inverse of its identified opening curve at the speed v; the other
    is zero. Below the crossing speed the current falls to zero in proportion. The integral stops where the
    current is limited. A hitch that is to stand is held with closed valves until its error, smoothed by an
    observer of position and speed, leaves a window, which widens each time.
    Without a measurement both currents are zero; when it returns, the reference starts from there.

    Attributes:
        axes: models of lifting and lowering.
        gains: of lifting and lowering.
        deceleration: of the reference, lifting and lowering, shape [2].
        speed_share: largest speed of a target that is followed over that of the largest current.
        lags_s: τ of lifting and lowering, s, shape [2].
        crossing_speed: speed of lifting and lowering below which the current falls to zero, shape [2].
        hold: window.
        rate: fastest rise of a current; it falls at any rate.
    """

    axes: tuple[Axis, Axis]
    gains: tuple[Gains, Gains]
    deceleration: Float[Array, "2"]
    speed_share: Scalar
    lags_s: Float[Array, "2"]
    crossing_speed: Float[Array, "2"]
    hold: HoldWindow
    rate: Scalar

    @property
    def step_s(self) -> float:
        """Sampling time, s."""
        return self.axes[0].step_s

    @double_precision
    def initial_state(self, displacement: Scalar | float) -> ControllerState:
        """Return the state of a hitch that is held at a displacement."""
        start = jnp.asarray(displacement, jnp.float64)
        zero, no = jnp.zeros(()), jnp.asarray(False)
        lifting, lowering = self.axes
        return ControllerState(
            axes=(lifting.initial_state(start), lowering.initial_state(start)),
            reference=Reference.at_rest(start),
            integral=zero,
            is_holding=jnp.asarray(True),
            widening=jnp.ones(()),
            smoothed=start,
            drift=zero,
            measured=start,
            is_lost=no,
            target=start,
            target_speed=zero,
            commands=jnp.zeros(2),
        )

    @double_precision
    def step(
        self, state: ControllerState, target: Scalar | float, measured: Scalar | float
    ) -> tuple[ControllerState, Float[Array, "2"]]:
        """Return the next state, and lifting and lowering current of this sample, shape [2].

        Args:
            state: from `initial_state` or an earlier step.
            target: where the hitch shall be; one that is not finite keeps its last value.
            measured: displacement; not finite where the sensor gives none.
        """
        return _step(self, state, jnp.asarray(target, jnp.float64), jnp.asarray(measured, jnp.float64))

    def limits_at(self, displacement: Scalar) -> ReferenceLimits:
        """Return the limits of the reference at a displacement."""
        fastest = jnp.stack([axis.fastest(displacement) for axis in self.axes])
        return ReferenceLimits(self.speed_share * fastest, self.deceleration)

    @double_precision
    def at_load(self, load: Mapping[str, float]) -> "HitchController":
        """Return the controller with models and lags at values of their covariates.

        Args:
            load: covariate to value, in the model's unit; one that is not given has the mean of the tests.

        Raises:
            InputError: the model has no such covariate.
        """
        covariates = {name for axis in self.axes for name in axis.covariates}
        for name in load:
            checks.one_of(name, covariates, "load")
        axes = tuple(axis.at_load(load) for axis in self.axes)
        lags_s = jnp.asarray([axis.lags[0] for axis in axes])
        return eqx.tree_at(lambda controller: (controller.axes, controller.lags_s), self, (axes, lags_s))


@eqx.filter_jit
def _step(
    controller: HitchController, state: ControllerState, target: Scalar, measured: Scalar
) -> tuple[ControllerState, Float[Array, "2"]]:
    is_lost = ~jnp.isfinite(measured)
    position = jnp.where(is_lost, state.measured, measured)
    target = jnp.where(jnp.isfinite(target), target, state.target)
    limits = controller.limits_at(position)
    target_speed = _target_speed(state, target, limits, controller.step_s)
    (lifting, lifting_state), (lowering, lowering_state) = zip(controller.axes, state.axes, strict=True)
    predicted = position + lifting.under_way(lifting_state) + lowering.under_way(lowering_state)
    speed = lifting.speed(lifting_state) + lowering.speed(lowering_state)
    acceleration = lifting.acceleration(lifting_state) + lowering.acceleration(lowering_state)
    # In the sample after a loss, too: what was predicted meanwhile followed no measurement.
    restarts = is_lost | state.is_lost
    start = state.reference.at_rest_where(restarts, predicted)
    led = _led_target(controller, target, target_speed)
    # A hitch that is faster than its model takes the reference with it, so that it brakes in time.
    taken = jnp.clip(predicted, jnp.minimum(start.position, led), jnp.maximum(start.position, led))
    reference = limits.step(start._replace(position=taken), led, target_speed, controller.step_s)
    # An observer of position and speed with a double pole at 1/SMOOTHING_S: it never swings itself.
    carried = state.smoothed + controller.step_s * (speed + state.drift)
    share = controller.step_s / SMOOTHING_S
    smoothed = jnp.where(restarts, predicted, carried + 2 * share * (predicted - carried))
    drift = jnp.where(restarts, 0.0, state.drift + share / SMOOTHING_S * (predicted - carried))
    error = reference.position - predicted
    integral = jnp.where(restarts, 0.0, state.integral)
    integral, wanted, error = _wanted_speed(
        controller, integral, reference, error, speed, acceleration, position
    )
    reference = reference._replace(position=predicted + error)
    currents = _currents(controller, state.commands, wanted, position)
    still = STILL_SHARE * jnp.min(limits.speed)
    stands = (jnp.abs(state.target_speed) < still) & (target == state.target) & ~is_lost
    # Where the valves close now, the hitch coasts on before it stands: the outer window counts.
    stops = jnp.any(state.commands > 0) & ~jnp.any(currents > 0)
    is_near = _is_near(controller, state, reference, target, smoothed, speed + drift, stops)
    is_holding, widening = stands & is_near, _widening(state, stands, is_near, controller.step_s)
    closed = is_lost | is_holding
    integral = jnp.where(closed, 0.0, integral)
    currents = jnp.where(closed, 0.0, currents)
    # Only a rise is limited: a valve that has to close is closed at once.
    currents = jnp.minimum(currents, state.commands + controller.rate * controller.step_s)
    next_state = ControllerState(
        axes=(
            lifting.step(lifting_state, currents[0], position),
            lowering.step(lowering_state, currents[1], position),
        ),
        reference=reference.at_rest_where(is_holding, reference.position),
        integral=integral,
        is_holding=is_holding,
        widening=widening,
        smoothed=smoothed,
        drift=drift,
        measured=position,
        is_lost=is_lost,
        target=target,
        target_speed=target_speed,
        commands=currents,
    )
    return next_state, currents


def _target_speed(state: ControllerState, target: Scalar, limits: ReferenceLimits, step_s: float) -> Scalar:
    """Return the smoothed speed of a moving target; zero after a jump that is faster than the hitch."""
    change = (target - state.target) / step_s
    # A lever that is thrown is a step, not a ramp: led by its speed, the hitch would pass it.
    is_reachable = (change <= limits.speed[0]) & (change >= -limits.speed[1])
    share = step_s / TARGET_SPEED_S
    smoothed = state.target_speed + share * (change - state.target_speed)
    return jnp.where(is_reachable, smoothed, 0.0)


def _led_target(controller: HitchController, target: Scalar, target_speed: Scalar) -> Scalar:
    """Return where a moving target will be a dead time later, when the hitch answers."""
    lifting, lowering = (axis.dead_time_samples for axis in controller.axes)
    lead_s = controller.step_s * jnp.where(target_speed > 0, lifting, lowering)
    return target + target_speed * lead_s


def _is_near(
    controller: HitchController,
    state: ControllerState,
    reference: Reference,
    target: Scalar,
    smoothed: Scalar,
    speed: Scalar,
    stops: Bool[Array, ""],
) -> Bool[Array, ""]:
    """Return whether the hitch stands near enough to the target, or will when the valves close now."""
    hold = controller.hold
    coasting = speed * jnp.where(speed > 0, *controller.lags_s)
    error = jnp.abs(target - smoothed - coasting)
    # The reference first: a hitch that passes the target on its way does not hold there.
    arrived = jnp.abs(reference.position - target) < hold.inner
    landing = jnp.where(stops, hold.outer, hold.inner)
    window = jnp.where(state.is_holding, state.widening * hold.outer, landing)
    return (state.is_holding | arrived) & (error < window)


def _widening(
    state: ControllerState, stands: Bool[Array, ""], is_near: Bool[Array, ""], step_s: float
) -> Scalar:
    """Return the factor on the outer window: twice that before where a held hitch has to be moved back."""
    narrowed = jnp.maximum(1.0, 0.5 ** (step_s / REST_S) * state.widening)
    doubled = jnp.minimum(2.0 * state.widening, WIDEST)
    return jnp.where(stands, jnp.where(state.is_holding & ~is_near, doubled, narrowed), 1.0)


def _wanted_speed(
    controller: HitchController,
    integral: Scalar,
    reference: Reference,
    error: Scalar,
    speed: Scalar,
    acceleration: Scalar,
    position: Scalar,
) -> tuple[Scalar, Scalar, Scalar]:
    """Return the integral part and the speed that is wanted, and the error of a reference that waits.

    Where more than the largest current is wanted, the reference is held back to where its error asks for no
    more: it stays beside the piston, and so begins to brake where the piston must.
    """
    upward = jnp.where(reference.speed == 0, error > 0, reference.speed > 0)
    gains = Gains(*(jnp.where(upward, *pair) for pair in zip(*controller.gains, strict=True)))
    integrated = integral + controller.step_s * gains.integral * error
    direct = (
        reference.speed
        + jnp.where(upward, *controller.lags_s) * reference.acceleration
        + gains.proportional * error
        + gains.speed * (reference.speed - speed)
        + gains.acceleration * (reference.acceleration - acceleration)
    )
    wanted = direct + integrated
    # At its limit the integral stops (no windup); it may shrink, where error and wanted speed differ in sign.
    lifting, lowering = (axis.fastest(position) for axis in controller.axes)
    beyond = jnp.abs(wanted - jnp.clip(wanted, -lowering, lifting))
    limited = (beyond > 0) & (wanted * error > 0)
    waiting = jnp.sign(error) * jnp.maximum(jnp.abs(error) - beyond / gains.proportional, 0.0)
    return (
        jnp.where(limited, integral, integrated),
        jnp.where(limited, direct + integral, wanted),
        jnp.where(limited, waiting, error),
    )


def _currents(
    controller: HitchController, before: Float[Array, "2"], wanted: Scalar, position: Scalar
) -> Float[Array, "2"]:
    """Return the currents of a wanted speed: that of its direction, and zero.

    A closed valve opens at the crossing speed and closes at zero, so that noise does not open it again.
    """
    currents = []
    for axis, crossing, last in zip(controller.axes, controller.crossing_speed, before, strict=True):
        size = jnp.maximum(axis.sign * wanted, 0.0)
        share = jnp.where((size >= crossing) | (last > 0), jnp.minimum(size / crossing, 1.0), 0.0)
        currents.append(share * axis.current_for(jnp.maximum(size, crossing), position))
    return jnp.stack(currents)
