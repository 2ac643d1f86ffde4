"""A hitch in a loop whose gains and dead zones change while it runs, without a new compilation."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from hitchid._support.precision import double_precision
from hitchid.model.dynamics import HitchDynamics
from hitchid.model.hitch import Hitch
from hitchid.model.loads import channel_load
from hitchid.model.packing import Packed, Packing, with_numbers
from hitchid.model.state import HitchState
from hitchid.model.step import join_inputs


@double_precision
def numbers_of_models(model: Hitch) -> Float[Array, " p"]:
    """Return the numbers of the physical models of a hitch at its sampling time, for `AdjustableHitch`."""
    channels = tuple(model.channels.values())
    return ravel_pytree(HitchDynamics.of(channels, model.step_s, model.drift).discrete_models)[0]


def adjusted_state(dynamics: HitchDynamics, state: HitchState) -> HitchState:
    """Return a state with the physical models of dynamics at its load."""
    channels = tuple(
        channel._replace(at_load=model.at_load(channel_load(dynamics.channels, number, state.load)))
        if channel.at_load is not None
        else channel
        for number, (channel, model) in enumerate(zip(state.channels, dynamics.discrete_models, strict=True))
    )
    return state._replace(channels=channels)


class AdjustableHitch:
    """`Hitch.step` with physical models that may get other numbers, of the same structure.

    Args:
        model: identified hitch, at given covariates; its networks stay.
    """

    @double_precision
    def __init__(self, model: Hitch) -> None:
        self._dynamics = model.dynamics
        self._directions = tuple(model.channels)
        self._packing = Packing(jax.eval_shape(self._dynamics.standing_state))
        self._step = self._packing.adjustable_step(self._dynamics)
        self._adjusted_state = jax.jit(self._at_load)
        self._numbers = numbers_of_models(model)

    def step(
        self, state: Packed, commands: ArrayLike | Sequence[ArrayLike], measured: ArrayLike | None = None
    ) -> tuple[Packed, Array]:
        """Return state and displacement one sampling time later; see `Hitch.step`."""
        with jax.enable_x64(True):
            inputs = join_inputs(commands, np.nan if measured is None else measured, self._directions)
            return self._step(self._numbers, state, inputs)

    def adjust(self, numbers: ArrayLike, state: Packed) -> Packed:
        """Go on with other numbers, see `numbers_of_models`; return the state with them at its load."""
        with jax.enable_x64(True):
            self._numbers = jnp.asarray(numbers)
            return Packed(self._adjusted_state(self._numbers, state.numbers), state.hidden)

    def _at_load(self, numbers_of_models: Array, numbers: Array) -> Array:
        dynamics = with_numbers(self._dynamics, numbers_of_models)
        state = self._packing.unpack(Packed(numbers, dynamics.zero_lstm_state()))
        return self._packing.pack(adjusted_state(dynamics, state)).numbers
