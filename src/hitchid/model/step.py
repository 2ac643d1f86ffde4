"""Compiled step function of a hitch, with its state packed into two arrays."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Float32

from hitchid._support import checks
from hitchid._support.bounded import MAX_MAGNITUDE
from hitchid._support.records import short_repr
from hitchid.errors import InputError
from hitchid.logs.record import DIRECTIONS
from hitchid.model.channel import Channel
from hitchid.model.dynamics import HitchDynamics
from hitchid.model.inputs import channel_load, mean_load
from hitchid.model.load_filter import LOAD_JUMP, LOAD_TINY
from hitchid.model.state import ChannelState, HitchState, Switching

# State as two flat arrays, to keep the cost of a call of a compiled function small.


@short_repr
class Packed(NamedTuple):
    """State of a hitch in two arrays.

    Attributes:
        numbers: all arrays but `hidden`, concatenated, shape [n].
        hidden: LSTM states of the network of the active channel, shape [2, 2, H].
    """

    numbers: Float[Array, " n"]
    hidden: Float32[Array, "2 2 h"]


class Packing:
    """Conversion between states of one hitch, at one load or at many, and packed states.

    Args:
        like: a state of that hitch.
    """

    def __init__(self, like: "HitchState | LoadBankState") -> None:
        shapes = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), _with_hidden(like, None))
        self._unravel = ravel_pytree(shapes)[1]

    def pack(self, state: "HitchState | LoadBankState") -> Packed:
        """Return a state in packed form."""
        # The LSTM state on its own: it is of single precision, and concatenated it would become double.
        return Packed(ravel_pytree(_with_hidden(state, None))[0], state.hidden)

    def unpack(self, packed: Packed) -> Any:
        """Return the state of a packed one."""
        return _with_hidden(self._unravel(packed.numbers), packed.hidden)

    def step(
        self, dynamics: "HitchDynamics | LoadBank"
    ) -> Callable[[Packed, ArrayLike], tuple[Packed, Array]]:
        """Return the compiled step function, from packed state to packed state and displacement.

        Its inputs are lifting command, lowering command and measured displacement, shape [3].
        """
        return jax.jit(partial(self._step, dynamics))

    def adjustable_step(
        self, dynamics: HitchDynamics
    ) -> Callable[[Float[Array, " p"], Packed, ArrayLike], tuple[Packed, Array]]:
        """Return `step` with the numbers of the physical models as its first argument, in one array."""
        return jax.jit(lambda numbers, *arguments: self._step(with_numbers(dynamics, numbers), *arguments))

    def _step(
        self, dynamics: "HitchDynamics | LoadBank", state: Packed, inputs: Float[Array, "3"]
    ) -> tuple[Packed, Array]:
        next_state, displacement = dynamics.step(self.unpack(state), inputs[:2], inputs[2])
        return self.pack(next_state), displacement


def with_numbers(dynamics: HitchDynamics, numbers: Float[Array, " p"]) -> HitchDynamics:
    """Return dynamics whose physical models have other numbers, as `ravel_pytree` orders them."""
    models = ravel_pytree(dynamics.discrete_models)[1](numbers)
    return eqx.tree_at(lambda tree: tree.discrete_models, dynamics, models)


def _with_hidden(state: Any, hidden: Array | None) -> Any:
    """Return the state of a hitch, at one load or at many, with another LSTM state."""
    if isinstance(state, LoadBankState):
        return state._replace(hitches=state.hitches._replace(hidden=hidden))
    return state._replace(hidden=hidden)


# A hitch whose covariates are not measured: a model for each of many loads, weighted by its predictions.

LOADS_LOG2 = 7  # 128 loads: of two covariates neighbours are a third of a standard deviation apart; chosen
HALF_WIDTH = 3**0.5  # standard deviations: that of a uniform distribution is its half width over √3


@short_repr
class LoadBankState(NamedTuple):
    """State of one hitch at B loads.

    Attributes:
        hitches: state at each load, arrays of shape [B, ...].
        log_weights: logarithm of the probability of each load, but for a constant, shape [B].
    """

    hitches: HitchState
    log_weights: Float[Array, " b"]

    @property
    def hidden(self) -> Float32[Array, "b 2 2 h"]:
        """LSTM states of the network of the active channel, at each load."""
        return self.hitches.hidden

    @property
    def displacement(self) -> Float[Array, ""]:
        """Expected displacement, in the model's unit."""
        return jnp.sum(jax.nn.softmax(self.log_weights) * self.hitches.displacement)

    @property
    def most_probable(self) -> HitchState:
        """State at the most probable load, with the expected displacement."""
        best = jnp.argmax(self.log_weights)
        state = jax.tree.map(lambda leaf: leaf[best], self.hitches)
        return state._replace(displacement=self.displacement)


class LoadBank(eqx.Module):
    """A hitch at many loads, of which the measured displacement shows the probable ones.

    A model with its load filter runs at each of B loads. The probability w of a load follows from the
    displacements y that were measured (multiple-model estimation; Magill 1965, IEEE TAC 10(4), 434-439)::

        log w(k+1) = log w(k) − ½ (log S + ε²/S),   ŷ = Σ w ŷ(load) / Σ w

    with the error ε of the prediction by the filter at that load, and its variance S. A displacement that is
    a jump to the filters at all loads says nothing of the load; see `LoadFilter.correct`. Before motion all
    loads are equally probable. They are those of a uniform distribution with the mean and the standard
    deviations of the identification tests, evenly spread (Sobol 1967), of each channel's own tests: a
    pressure at rest differs between the ends of the stroke.

    Attributes:
        dynamics: of the hitch.
    """

    dynamics: HitchDynamics

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels of the hitch."""
        return self.dynamics.channels

    def init_state(self, displacement: Float[Array, ""], load: Float[Array, " l"]) -> LoadBankState:
        """Return the state of a hitch at rest with closed valves.

        Args:
            displacement: where the piston is.
            load: the covariates, in the order of `covariates_of`; NaN for those that are not measured.
        """
        means = jnp.asarray(mean_load(self.channels))
        state = self.dynamics.init_state(displacement, jnp.where(jnp.isnan(load), means, load))
        from scipy.stats import qmc  # where it is needed: a model is loaded without it

        points = jnp.asarray(qmc.Sobol(load.size, scramble=False).random_base2(LOADS_LOG2))
        # Sobol's points begin at the lower end: moved by half a cell their mean is 0.
        centred = 2 * points - 1 + 1 / len(points)

        def at_point(point: Float[Array, " l"]) -> HitchState:
            channels = (
                self._at_point(number, channel_state, displacement, load, point)
                for number, channel_state in enumerate(state.channels)
            )
            return state._replace(channels=tuple(channels))

        return LoadBankState(jax.vmap(at_point)(centred), jnp.zeros(len(points)))

    def step(
        self, state: LoadBankState, commands: Float[Array, "2"], measured: Float[Array, ""]
    ) -> tuple[LoadBankState, Float[Array, ""]]:
        """Return the state and the expected displacement at the next sample; see `HitchDynamics.step`."""
        variance, error = jax.vmap(self._prediction_error, in_axes=(0, None))(state.hitches, measured)
        tells_load = (jnp.abs(measured) < MAX_MAGNITUDE) & (jnp.min(error**2 / variance) <= LOAD_JUMP**2)
        likelihood = -0.5 * (jnp.log(variance) + error**2 / variance)
        log_weights = state.log_weights + jnp.where(tells_load, likelihood, 0.0)
        # The weights first: the step corrects all filters by this measurement, which then surprises none.
        hitches, _ = jax.vmap(self.dynamics.step, in_axes=(0, None, None))(state.hitches, commands, measured)
        # Only differences count; without this the logarithms would fall without end, and lose digits.
        next_state = LoadBankState(hitches, log_weights - jnp.max(log_weights))
        return next_state, next_state.displacement

    def _at_point(
        self,
        number: int,
        channel_state: ChannelState,
        displacement: Float[Array, ""],
        load: Float[Array, " l"],
        point: Float[Array, " l"],
    ) -> ChannelState:
        """Return the state of a channel where what is not measured is at a point between −1 and 1."""
        model = self.dynamics.discrete_models[number]
        nonlinearity = model.benchmark.nonlinearity
        if not model.is_scheduled or nonlinearity is None:
            return channel_state
        scales = nonlinearity.scales.covariates
        measured, part = (channel_load(self.channels, number, row) for row in (load, point))
        assumed = scales.centre + HALF_WIDTH * scales.spread * part
        at_load = model.at_load(jnp.where(jnp.isnan(measured), assumed, measured))
        plant = at_load.init_state(displacement, jnp.zeros(()))
        return channel_state._replace(at_load=at_load, plant=plant)

    def _prediction_error(
        self, state: HitchState, measured: Float[Array, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Return variance and error of the displacement that the filter of the active channel expects."""
        active = jnp.maximum(state.mode, 0)
        noise = jnp.stack([channel.load_filter.noise for channel in self.channels])[active]
        expected = self.dynamics.within_end_stops(state, state.benchmark) + state.estimates.error[active]
        return jnp.maximum(state.estimates.variance[active] + noise**2, LOAD_TINY), measured - expected


LOAD_BANK_NDIM = 4  # axes of `Packed.hidden` where a hitch is simulated at many loads
PLAIN_COMMANDS = ((len(DIRECTIONS),), np.float64)  # shape and type of both commands in double precision
STATE_REQUIRED = "a state of this model, from `init_state` or `step`"


class StepFunctions(NamedTuple):
    """Compiled functions of one hitch, each compiled at its first call.

    Attributes:
        init_state: displacement and load to state.
        step: state and inputs to state and displacement.
        unpack: state to its record.
        switching: state to the valves in charge; not of a traced state.
        shapes: of the arrays of a state.
    """

    init_state: Callable[[float, ArrayLike], Packed]
    step: Callable[[Packed, ArrayLike], tuple[Packed, Array]]
    unpack: Callable[[Packed], HitchState]
    switching: Callable[[Packed], Switching]
    shapes: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, dynamics: HitchDynamics) -> "StepFunctions":
        """Return the functions of a hitch at a given load."""
        like = jax.eval_shape(dynamics.standing_state)
        # Where these fields begin in the concatenated numbers: reading them there needs no compiled function.
        mode, both_valves_active = (
            sum(leaf.size for leaf in jax.tree.leaves(like[: like._fields.index(name)]))
            for name in ("mode", "both_valves_active")
        )

        def switching(packed: Packed) -> Switching:
            numbers = np.asarray(packed.numbers)
            return Switching(int(numbers[mode]), bool(numbers[both_valves_active]))

        packing = Packing(like)
        return cls._of(dynamics, packing, jax.jit(packing.unpack), switching)

    @classmethod
    def at_unknown_load(cls, dynamics: HitchDynamics) -> "StepFunctions":
        """Return the functions of a hitch of whose load a part is not measured."""
        bank = LoadBank(dynamics)
        load = jnp.asarray(mean_load(dynamics.channels))
        packing = Packing(jax.eval_shape(bank.init_state, jnp.zeros(()), load))

        @jax.jit
        def most_probable(packed: Packed) -> HitchState:
            return packing.unpack(packed).most_probable

        def switching(packed: Packed) -> Switching:
            with jax.enable_x64(True):
                state = most_probable(packed)
            return Switching(int(state.mode), bool(state.both_valves_active))

        return cls._of(bank, packing, most_probable, switching)

    @classmethod
    def _of(
        cls,
        dynamics: "HitchDynamics | LoadBank",
        packing: Packing,
        unpack: Callable[[Packed], HitchState],
        switching: Callable[[Packed], Switching],
    ) -> "StepFunctions":
        init_state = jax.jit(lambda displacement, load: packing.pack(dynamics.init_state(displacement, load)))
        like = jax.eval_shape(init_state, 0.0, mean_load(dynamics.channels))
        shapes = tuple(array.shape for array in like)
        return cls(init_state, packing.step(dynamics), unpack, switching, shapes)

    def accepts(self, state: Packed) -> bool:
        """Return whether a state is of these functions; only shapes are compared: it may be traced."""
        return tuple(map(np.shape, state)) == self.shapes


def join_inputs(
    commands: ArrayLike | Sequence[ArrayLike], measured: ArrayLike, directions: Sequence[str]
) -> Array | np.ndarray:
    """Return lifting and lowering command and measured displacement in one array, shape [3].

    Raises:
        InputError: commands or measurement are not numbers, or have another shape.
    """
    if (
        isinstance(commands, np.ndarray)
        and (commands.shape, commands.dtype) == PLAIN_COMMANDS
        and isinstance(measured, float)
    ):
        return np.array([*commands.tolist(), measured])  # as a loop has them; a tenth of the time of the rest
    values = commands if isinstance(commands, Sequence) else (commands,)
    # Traced values only JAX can join.
    xp = jnp if any(isinstance(value, jax.Array) for value in (*values, measured)) else np
    try:
        command_array, measured_array = xp.asarray(commands), xp.asarray(measured)
    except (TypeError, ValueError) as error:
        raise checks.input_error("commands, measured", "numbers", (commands, measured)) from error
    if {command_array.dtype.kind, measured_array.dtype.kind} - set("iuf"):
        raise checks.input_error("commands, measured", "numbers", (commands, measured))
    if command_array.shape == (1,) and len(directions) == 1:
        (direction,) = directions
        command_array = xp.zeros(len(DIRECTIONS)) + command_array * np.array(
            [name == direction for name in DIRECTIONS]
        )
    if command_array.shape != (len(DIRECTIONS),):
        raise InputError(
            f"commands: expected lifting and lowering, shape (2,), got shape {command_array.shape}"
        )
    if measured_array.shape != ():
        raise InputError(f"measured: expected one displacement, shape (), got shape {measured_array.shape}")
    return xp.append(command_array, measured_array).astype(np.float64)
