"""Compiled step function of a hitch, with its state packed into two arrays."""

from collections.abc import Sequence
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from hitchid._support import checks
from hitchid.data.record import DIRECTIONS
from hitchid.errors import InputError
from hitchid.model.dynamics import HitchDynamics
from hitchid.model.loads import mean_load
from hitchid.model.packing import Packed, Packing


class StepFunctions:
    """Compiled functions of one hitch: `init_state`, `step` and `unpack`, each compiled at its first call.

    Args:
        dynamics: dynamics of the hitch.
    """

    def __init__(self, dynamics: HitchDynamics) -> None:
        self._dynamics = dynamics
        packing = Packing(jax.eval_shape(dynamics.standing_state))
        self.init_state = jax.jit(
            lambda displacement, load: packing.pack(dynamics.init_state(displacement, load))
        )
        self.unpack = jax.jit(packing.unpack)
        self.step = packing.step(dynamics)

    def check(self, state: Packed) -> None:
        """Check that a state is of this model; only shapes are compared, so that it may be traced.

        Raises:
            InputError: the state is not of this model.
        """
        required = "a state of this model, from `init_state` or `step`"
        checks.instance(state, Packed, "state", required)
        if tuple(map(np.shape, state)) != self._shapes:
            raise checks.input_error("state", required, tuple(map(np.shape, state)))

    @cached_property
    def _shapes(self) -> tuple[tuple[int, ...], ...]:
        return tuple(
            array.shape for array in jax.eval_shape(self.init_state, 0.0, mean_load(self._dynamics.channels))
        )


def join_inputs(
    commands: ArrayLike | Sequence[ArrayLike], measured: ArrayLike, directions: Sequence[str]
) -> Array | np.ndarray:
    """Return lifting and lowering command and measured displacement in one array, shape [3].

    Raises:
        InputError: commands or measurement are not numbers, or have another shape.
    """
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
