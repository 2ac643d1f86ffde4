"""Nonlinear structures: a vector field, integrated by the classical Runge-Kutta method."""

import abc
from typing import ClassVar

import equinox as eqx
import jax
from jaxtyping import Array, Float

from hitchid.structures.discretisation import Scalar
from hitchid.structures.structure import Structure


class NonlinearStructure(Structure):
    """A model from the command as logged to displacement, ẋ = f(x, u); its first state is the displacement.

    Attributes:
        substeps: steps of integration in one sample.
    """

    uses_raw_command: ClassVar[bool] = True
    substeps: ClassVar[int]

    @abc.abstractmethod
    def init_state(self, values: Float[Array, " p"], displacement: Float[Array, " t"]) -> Float[Array, "n t"]:
        """Return the state before the first sample of each of T tests, shape [n, T]."""

    @abc.abstractmethod
    def vector_field(
        self, values: Float[Array, " p"], state: Float[Array, "n t"], command: Float[Array, " t"]
    ) -> Float[Array, "n t"]:
        """Return the state's rate of change, shape [n, T]."""


@eqx.filter_jit
def simulate_nonlinear(
    structure: NonlinearStructure,
    values: Float[Array, " p"],
    command: Float[Array, "t n"],
    displacement: Float[Array, " t"],
    step_s: Scalar,
) -> Float[Array, "t n"]:
    """Return displacement at every sample, the command held between samples, shape [T, N].

    The classical method of fourth order, `substeps` steps a sample.

    Args:
        structure: supplies start and rate.
        values: its parameters.
        command: as logged, shape [T, N].
        displacement: before the first sample, shape [T].
        step_s: sampling time, s.
    """

    def advance(state: Array, u: Array) -> tuple[Array, Array]:
        return rk4_step(structure, values, state, u, step_s), state[0]

    return jax.lax.scan(advance, structure.init_state(values, displacement), command.T)[1].T


def rk4_step(
    structure: NonlinearStructure,
    values: Float[Array, " p"],
    state: Float[Array, "n t"],
    command: Float[Array, " t"],
    step_s: Scalar,
) -> Float[Array, "n t"]:
    """Return the state one sample later, the command held; see `simulate_nonlinear`."""
    width = step_s / structure.substeps

    def step(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        state, u = carry
        first = structure.vector_field(values, state, u)
        second = structure.vector_field(values, state + 0.5 * width * first, u)
        third = structure.vector_field(values, state + 0.5 * width * second, u)
        fourth = structure.vector_field(values, state + width * third, u)
        return state + width / 6 * (first + 2 * (second + third) + fourth), u

    return jax.lax.fori_loop(0, structure.substeps, step, (state, command))[0]
