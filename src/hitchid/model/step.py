"""Compiled step function of a hitch, with its state packed into two arrays."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array

from hitchid._support import checks
from hitchid.data.record import DIRECTIONS
from hitchid.errors import InputError
from hitchid.model.dynamics import HitchDynamics
from hitchid.model.loads import mean_load
from hitchid.model.packing import Packed, Packing, unravel
from hitchid.model.state import HitchState, Switching
from hitchid.model.unknown_load import LoadBank, LoadBankState

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
        packing = Packing(jax.eval_shape(dynamics.standing_state))
        init_state = jax.jit(lambda displacement, load: packing.pack(dynamics.init_state(displacement, load)))
        shapes = _shapes(init_state, dynamics)
        return cls(init_state, packing.step(dynamics), jax.jit(packing.unpack), packing.switching, shapes)

    @classmethod
    def at_unknown_load(cls, dynamics: HitchDynamics) -> "StepFunctions":
        """Return the functions of a hitch of whose load a part is not measured."""
        bank = LoadBank(dynamics)
        load = jnp.asarray(mean_load(dynamics.channels))
        unravel_state = unravel(_without_hidden(jax.eval_shape(bank.init_state, jnp.zeros(()), load)))

        def pack(state: LoadBankState) -> Packed:
            return Packed(ravel_pytree(_without_hidden(state))[0], state.hitches.hidden)

        def unpack(packed: Packed) -> LoadBankState:
            state = unravel_state(packed.numbers)
            return state._replace(hitches=state.hitches._replace(hidden=packed.hidden))

        def step(packed: Packed, inputs: Array) -> tuple[Packed, Array]:
            state, displacement = bank.step(unpack(packed), inputs[:2], inputs[2])
            return pack(state), displacement

        @jax.jit
        def most_probable(packed: Packed) -> HitchState:
            return unpack(packed).most_probable

        def switching(packed: Packed) -> Switching:
            with jax.enable_x64(True):
                state = most_probable(packed)
            return Switching(int(state.mode), bool(state.both_valves_active))

        init_state = jax.jit(lambda displacement, load: pack(bank.init_state(displacement, load)))
        return cls(
            init_state,
            jax.jit(step),
            most_probable,
            switching,
            _shapes(init_state, dynamics),
        )

    def accepts(self, state: Packed) -> bool:
        """Return whether a state is of these functions; only shapes are compared: it may be traced."""
        return tuple(map(np.shape, state)) == self.shapes


def _shapes(init_state: Callable, dynamics: HitchDynamics) -> tuple[tuple[int, ...], ...]:
    like = jax.eval_shape(init_state, 0.0, mean_load(dynamics.channels))
    return tuple(array.shape for array in like)


def _without_hidden(state: LoadBankState) -> LoadBankState:
    return state._replace(hitches=state.hitches._replace(hidden=None))


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
