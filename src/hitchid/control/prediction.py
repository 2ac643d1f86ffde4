"""Closed loops on the identified model with what its tests leave open: parameters, load, sensor noise."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.control.axis import Axis, AxisState, buffer_of
from hitchid.control.closed_loop import in_chunks
from hitchid.control.controller import ControllerState, HitchController
from hitchid.errors import InputError
from hitchid.model import Channel, Hitch, Load, LoadFilter, channel_load, draws_of, load_row

MOVING_SHARE = 0.03  # of the largest speed: slowest motion during which transients arise; chosen
# Of the speed, by that of the load: the flow of an orifice goes with the root of the pressure (Merritt 1967,
# Hydraulic Control Systems, sec. 3.2); a compensated valve takes less.
SPEED_EXPONENT = 0.5
COVERAGE = 0.90  # share of the runs on drawn models inside a band, each over its whole length


@short_repr
class DrawnHitch(eqx.Module):
    """A model of a hitch with drawn parameters; arrays may have a leading axis of draws.

    Attributes:
        axes: of lifting and lowering.
        filters: scatter of load and transients of lifting and lowering.
        drift: speed of a held piston.
        speed_factors: on the speed of lifting and lowering, of another load than that of the tests, [2].
    """

    axes: tuple[Axis, Axis]
    filters: tuple[LoadFilter, LoadFilter]
    drift: Array
    speed_factors: Float[Array, "*s 2"]


@short_repr
class Band(NamedTuple):
    """Band that holds whole runs: mean ± k standard deviations over runs on drawn models.

    Attributes:
        lower, upper: of the measured displacement, shape [N].
    """

    lower: Float[np.ndarray, " n"]
    upper: Float[np.ndarray, " n"]

    def contains(self, measured: Float[np.ndarray, "*t n"]) -> Float[np.ndarray, "*t"]:
        """Return the share of samples of each run inside the band."""
        return np.asarray(np.mean((measured >= self.lower) & (measured <= self.upper), axis=-1))


class _State(NamedTuple):
    """State of a drawn hitch."""

    axes: tuple[AxisState, AxisState]
    displacement: Array
    loads: Array
    transients: Array
    key: PRNGKeyArray


def loads_of_channels(model: Hitch, load: Load | None) -> list[Float[np.ndarray, " c"]]:
    """Return the covariates of each channel at a load of the model; see `Hitch.simulate`.

    Raises:
        InputError: the model has no such covariate, or a value is not one number.
    """
    channels = tuple(model.channels.values())
    row = load_row(load, channels, "model")
    if row.ndim > 1:
        raise checks.input_error("load", "one load", load)
    return [np.asarray(channel_load(channels, number, jnp.asarray(row))) for number in range(len(channels))]


@double_precision
def drawn_hitches(
    controller: HitchController,
    model: Hitch,
    load: Load | None,
    draws: int,
    seed: int,
    *,
    load_spread: float = 0.0,
    heavier: float = 0.0,
) -> DrawnHitch | None:
    """Return models with parameters drawn from the distribution of their estimates; None without such.

    Loads of the runs are within ± `load_spread` of that of the tests, each as likely, beside the scatter
    between tests. `heavier` is the share by which nobody's measurement tells that the load is heavier than
    that of the tests: lifting is slower, lowering faster.
    """
    axes, filters = [], []
    # The standard deviation of what is equally likely within ± a is a/√3.
    spread = SPEED_EXPONENT * load_spread / 3**0.5
    rows = loads_of_channels(model, load)
    for axis, (direction, channel), row in zip(controller.axes, model.channels.items(), rows, strict=True):
        vectors = draws_of(model, direction, seed, draws)
        if vectors is None:
            return None
        longest_s = float(vectors[:, channel.benchmark.values.size].max())
        # One buffer, long enough for the longest dead time, as draws are mapped side by side.
        kept = replace(axis, buffer=buffer_of(longest_s / axis.step_s))

        def drawn(vector: Array, row: Array, axis: Axis = kept, channel: Channel = channel) -> Axis:
            return axis.with_benchmark(channel.benchmark.with_parameter_vector(vector).at_load(row))

        axes.append(jax.vmap(drawn, (0, None))(jnp.asarray(vectors), jnp.asarray(row)))
        # Loads of the runs and scatter between tests are independent: their variances add.
        load_filter = channel.load_filter
        scattered = replace(load_filter, load_scatter=jnp.hypot(load_filter.load_scatter, spread))
        filters.append(jax.tree.map(lambda value: jnp.broadcast_to(value, (draws,)), scattered))
    factor = (1 + heavier) ** SPEED_EXPONENT
    factors = jnp.tile(jnp.asarray([1 / factor, factor]), (draws, 1))
    return DrawnHitch(tuple(axes), tuple(filters), jnp.full(draws, model.drift), factors)


@double_precision
def run_on_model(
    controller: HitchController,
    hitches: DrawnHitch,
    key: PRNGKeyArray,
    target: Float[np.ndarray, " n"],
    *,
    start: float,
    measured_start: float | None = None,
) -> Float[np.ndarray, "s n"]:
    """Return the measured displacement of closed loops on drawn models, shape [S, N].

    Each run has a load of its own, which makes a stroke faster or slower, transients and sensor noise, as
    `LoadFilter` has them. The hitch is held at `start` at first, which the sensor measures as
    `measured_start`, by default as the same.
    """
    measured = start if measured_start is None else measured_start
    keys = jax.random.split(key, hitches.drift.size)

    def at_rest(hitch: DrawnHitch, own: PRNGKeyArray) -> tuple[_State, ControllerState]:
        return _at_rest(hitch, own, jnp.asarray(measured)), controller.initial_state(start)

    carry = jax.vmap(at_rest)(hitches, keys)
    return in_chunks(lambda now, part: _run_chunk(controller, hitches, now, part), carry, target)


def band_of(runs: Float[np.ndarray, "s n"]) -> Band:
    """Return the band that holds a share of `COVERAGE` of runs over their whole length.

    Its half width is k times their standard deviation at each sample, k being the quantile over runs of the
    largest deviation in standard deviations.
    """
    mean, deviation = runs.mean(axis=0), runs.std(axis=0, ddof=1)
    # Where all runs are equal there is no deviation to divide by.
    safe = np.maximum(deviation, np.finfo(float).tiny)
    factor = np.quantile(np.max(np.abs(runs - mean) / safe, axis=1), COVERAGE)
    return Band(mean - factor * deviation, mean + factor * deviation)


def _at_rest(hitch: DrawnHitch, key: PRNGKeyArray, displacement: Array) -> _State:
    key, own = jax.random.split(key)
    scatters = jnp.stack([filter_.load_scatter for filter_ in hitch.filters])
    axes = (hitch.axes[0].initial_state(displacement), hitch.axes[1].initial_state(displacement))
    loads = scatters * jax.random.normal(own, (2,))
    return _State(axes, displacement, loads, jnp.zeros(2), key)


@eqx.filter_jit
def _run_chunk(
    controller: HitchController,
    hitches: DrawnHitch,
    carry: tuple[_State, ControllerState],
    targets: Float[Array, " n"],
) -> tuple[tuple[_State, ControllerState], Float[Array, "s n"]]:
    def run(hitch: DrawnHitch, carry: tuple) -> tuple[tuple, Array]:
        def advance(carry: tuple, target: Array) -> tuple[tuple, Array]:
            state, own = carry
            key, drawn = jax.random.split(state.key)
            normal = jax.random.normal(drawn, (5,))
            measured = _measured(hitch, state, normal[0])
            own, currents = controller.step(own, target, measured)
            return (_advance(hitch, state._replace(key=key), currents, normal[1:]), own), measured

        return jax.lax.scan(advance, carry, targets)

    return jax.vmap(run)(hitches, carry)


def _measured(hitch: DrawnHitch, state: _State, normal: Array) -> Array:
    noise = jnp.maximum(*(filter_.noise for filter_ in hitch.filters))
    return state.displacement + jnp.sum(state.transients) + noise * normal


def _advance(hitch: DrawnHitch, state: _State, currents: Array, normal: Array) -> _State:
    step_s = hitch.axes[0].step_s
    axes, loads, transients = [], [], []
    displacement = state.displacement + hitch.drift * step_s
    for number, (axis, filter_) in enumerate(zip(hitch.axes, hitch.filters, strict=True)):
        before = state.axes[number]
        after = axis.step(before, currents[number], state.displacement)
        # What comes to be measured now: what was under way and what is new, less what is under way still.
        moved = axis.under_way(before) + after.increments[0] - axis.under_way(after)
        displacement = displacement + hitch.speed_factors[number] * (1 + state.loads[number]) * moved
        # The load forgets over the way, not over time, and keeps its variance.
        kept = jnp.exp(-jnp.abs(moved) / filter_.load_length)
        spread = jnp.sqrt(1 - kept**2) * filter_.load_scatter
        loads.append(kept * state.loads[number] + spread * normal[2 * number])
        # Transients arise in motion and die out at rest.
        is_moving = jnp.abs(moved) > MOVING_SHARE * axis.fastest(state.displacement) * step_s
        decay = jnp.exp(-step_s / filter_.transient_time)
        driven = jnp.where(is_moving, jnp.sqrt(1 - decay**2) * filter_.transient_scatter, 0.0)
        transients.append(decay * state.transients[number] + driven * normal[2 * number + 1])
        axes.append(after)
    return _State((axes[0], axes[1]), displacement, jnp.stack(loads), jnp.stack(transients), state.key)


class ModelPlant(eqx.Module):
    """The identified model as a plant, its parameters, load and noise drawn anew for each loop."""

    hitches: DrawnHitch

    @classmethod
    def of(
        cls,
        controller: HitchController,
        model: Hitch,
        *,
        load: Load | None = None,
        heavier: float = 0.0,
        draws: int = 20,
        seed: int = 0,
    ) -> "ModelPlant":
        """Return the plant of a model; see `drawn_hitches`.

        Raises:
            InputError: the model has no standard errors, from which it could be drawn.
        """
        hitches = drawn_hitches(controller, model, load, draws, seed, heavier=heavier)
        if hitches is None:
            raise InputError("model: its parameters have no standard errors, so that no plant can be drawn")
        return cls(hitches)

    def reset(
        self, displacement: Array | float, seed: Array | int
    ) -> tuple[tuple[DrawnHitch, _State], Array]:
        """Return a hitch that is held at a displacement, and its measurement."""
        hitch = jax.tree.map(lambda rows: rows[seed % self.hitches.drift.size], self.hitches)
        state = _at_rest(hitch, jax.random.key(seed), jnp.asarray(displacement, jnp.float64))
        return (hitch, state), state.displacement

    def step(
        self, state: tuple[DrawnHitch, _State], commands: Array
    ) -> tuple[tuple[DrawnHitch, _State], Array]:
        """Return the hitch one sample later, and its measurement then."""
        hitch, hitch_state = state
        key, drawn = jax.random.split(hitch_state.key)
        normal = jax.random.normal(drawn, (5,))
        after = _advance(hitch, hitch_state._replace(key=key), jnp.asarray(commands), normal[1:])
        return (hitch, after), _measured(hitch, after, normal[0])
