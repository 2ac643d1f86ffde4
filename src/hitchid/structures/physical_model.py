"""A structure with values for its parameters: simulation and discrete model."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.structures.batch import Batch
from hitchid.structures.discretisation import (
    DiscreteStateSpace,
    Scalar,
    StrokeModel,
    delayed,
    discretise,
    discretise_along_stroke,
    simulate_linear,
)
from hitchid.structures.nonlinear_structures import NonlinearStructure, simulate_nonlinear
from hitchid.structures.nonlinearity import (
    NONLINEARITY_PARAMETERS,
    OPENING,
    PlayState,
    Scheduling,
    StaticNonlinearity,
    effect_parameters,
)
from hitchid.structures.structure import DEAD_TIME, Parameter, Structure


@short_repr
class PhysicalModel(eqx.Module):
    """A structure with values for its parameters, and its options: the physical model of one direction.

    Attributes:
        structure: the structure.
        values: its parameters, shape [p], in the order of `structure.parameters`.
        dead_time_s: dead time, s, shape [].
        nonlinearity: of valve and stroke around the linear model; None for the linear model alone.
        scheduling: effects of measured covariates on its parameters, which are those at the mean of the
            covariates; None where there is none.
    """

    structure: Structure
    values: Float[Array, " p"]
    dead_time_s: Float[Array, ""]
    nonlinearity: StaticNonlinearity | None = None
    scheduling: Scheduling | None = None

    @double_precision
    def travel(self, batch: Batch) -> Float[Array, "t n"]:
        """Simulate tests from commands, initial displacement and any second input: travel, shape [T, N]."""
        if isinstance(self.structure, NonlinearStructure):
            displacement = simulate_nonlinear(
                self.structure, self.values, batch.raw_command, batch.initial, batch.step_s
            )
            return batch.sign * (displacement - batch.initial[:, None])
        if self.scheduling is not None:
            return _travel_by_load(self, batch)
        if self.nonlinearity is None:
            return self.response(batch.command, batch.step_s)
        return _travel(self, self.nonlinearity, batch)

    @property
    def covariates(self) -> tuple[str, ...]:
        """Names of the covariates that its parameters vary with."""
        return () if self.scheduling is None else self.scheduling.covariates

    @property
    def mean_load(self) -> Float[Array, " c"]:
        """Mean of each covariate in the identification tests, shape [C]; one zero where there is none."""
        if self.scheduling is None or self.nonlinearity is None:
            return jnp.zeros(1)
        return self.nonlinearity.scales.covariates.centre

    def at_load(self, load: Float[Array, " c"]) -> "PhysicalModel":
        """Return the model with its parameters at values of the covariates, shape [C]; see `Scheduling`.

        A model without covariates is returned as it is.
        """
        scheduling, nonlinearity = self.scheduling, self.nonlinearity
        if scheduling is None or nonlinearity is None:
            return self
        changes = scheduling.changes(load, nonlinearity.scales.covariates)
        names = [parameter.name for parameter in self.structure.parameters]
        values = self.values
        for quantity, change in zip(scheduling.quantities, changes, strict=True):
            if quantity == OPENING:
                shifted = nonlinearity.with_opening_shifted(change)
                # A load shifts the curve and does not stretch it: at the largest command more or less flows.
                ratio = shifted.largest_share / nonlinearity.largest_share
                values = values.at[names.index(self.structure.gain)].multiply(ratio)
                nonlinearity = shifted
            else:
                values = values.at[names.index(quantity)].multiply(jnp.exp(change))
        return PhysicalModel(self.structure, values, self.dead_time_s, nonlinearity)

    @property
    def varies_along_stroke(self) -> bool:
        """Whether the dynamics differ along a stroke, whose range the scales of the nonlinearity give."""
        linear = self.structure.linear
        return linear is not None and linear.varies_along_stroke and self.nonlinearity is not None

    @double_precision
    def response(self, command: Float[Array, "t n"], step_s: Scalar) -> Float[Array, "t n"]:
        """Simulate from rest: y[0] = 0, then y of the command held between samples; mid-stroke dynamics.

        Before its first sample a test's command is taken as zero.

        Args:
            command: effective command, shape [T, N].
            step_s: sampling time, s.

        Returns:
            Displacement away from the start, shape [T, N], in the unit of gain × command × s.
        """
        return simulate_linear(self.discretised(step_s), command)

    @double_precision
    def discretised(self, step_s: Scalar) -> DiscreteStateSpace:
        """Return the exact discrete model for a command held between samples.

        Raises:
            InputError: the structure is not linear.
        """
        return _discretised(self.structure.require_linear(), self.values, self.dead_time_s, step_s)

    def values_at(self, displacement: Float[Array, ""]) -> Float[Array, " p"]:
        """Return the structure's values at a displacement; raises InputError where it is not linear."""
        structure = self.structure.require_linear()
        if self.nonlinearity is None:
            return self.values
        return structure.values_at(self.values, self.nonlinearity.position(displacement))

    def at(self, displacement: Float[Array, ""]) -> "PhysicalModel":
        """Return the model with the structure's values of a displacement; raises as `values_at`."""
        return eqx.tree_at(lambda model: model.values, self, self.values_at(displacement))

    def state_at_speed(self, speed: Float[Array, ""], displacement: Float[Array, ""]) -> Float[Array, " n"]:
        """Return the linear state at travel zero, a speed of the linear part and a displacement."""
        return self.structure.require_linear().state_at_speed(self.values_at(displacement), speed)

    @double_precision
    def discretised_along_stroke(self, step_s: Scalar) -> DiscreteStateSpace | StrokeModel:
        """Return the discrete models of places on the stroke, one for all where the dynamics do not vary."""
        if not self.varies_along_stroke:
            return self.discretised(step_s)
        structure = self.structure.require_linear()
        return _discretised_along_stroke(structure, self.values, self.dead_time_s, step_s)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters: the structure's, dead time, those of the nonlinearities and of the covariates."""
        curves = () if self.nonlinearity is None else NONLINEARITY_PARAMETERS
        effects = ()
        if self.scheduling is not None:
            effects = effect_parameters(self.structure.require_linear(), self.scheduling.covariates)
        return (*self.structure.parameters, DEAD_TIME, *curves, *effects)

    def named_values(self) -> dict[str, float]:
        """Return parameter name to value, with `dead_time` where there is one."""
        vector = map(float, self.parameter_vector)
        named = dict(zip((parameter.name for parameter in self.parameters), vector, strict=True))
        dead_time_s = named.pop(DEAD_TIME.name)
        return {**named, DEAD_TIME.name: dead_time_s} if dead_time_s else named

    @property
    @double_precision
    def parameter_vector(self) -> Float[Array, " r"]:
        """The values of `parameters`."""
        curves = () if self.nonlinearity is None else (self.nonlinearity.values,)
        effects = () if self.scheduling is None else (self.scheduling.effects.ravel(),)
        return jnp.concatenate([self.values, self.dead_time_s[None], *curves, *effects])

    @double_precision
    def with_parameter_vector(self, vector: Float[Array, " r"]) -> "PhysicalModel":
        """Return the model with other numbers; see `parameter_vector`."""
        count = self.values.size
        model = eqx.tree_at(lambda b: (b.values, b.dead_time_s), self, (vector[:count], vector[count]))
        if self.nonlinearity is None:
            return model
        last = count + 1 + len(NONLINEARITY_PARAMETERS)
        model = eqx.tree_at(lambda b: b.nonlinearity.values, model, vector[count + 1 : last])
        if self.scheduling is None:
            return model
        effects = vector[last:].reshape(self.scheduling.effects.shape)
        return eqx.tree_at(lambda b: b.scheduling.effects, model, effects)

    @property
    def gain(self) -> Float[Array, ""]:
        """The parameter to which the speed is proportional; raises InputError where there is none."""
        return self.values[self.structure.gain_index]

    def with_gain(self, factor: float) -> "PhysicalModel":
        """Return the model with its gain multiplied by a factor.

        Raises:
            InputError: the structure has no gain.
        """
        values = self.values.at[self.structure.gain_index].multiply(factor)
        return eqx.tree_at(lambda model: model.values, self, values)


@eqx.filter_jit
def _travel_by_load(physical_model: PhysicalModel, batch: Batch) -> Float[Array, "t n"]:
    """Return travel where parameters vary with covariates: each test has a model of its own."""

    def travel(test: Batch, load: Float[Array, " c"]) -> Float[Array, "1 n"]:
        return physical_model.at_load(load).travel(test)

    return batch.map_tests(travel, batch.load(physical_model.covariates))[:, 0]


_discretised = eqx.filter_jit(discretise)
_discretised_along_stroke = eqx.filter_jit(discretise_along_stroke)


class _TestState(NamedTuple):
    """State of T tests at one sample: spool, flow over the sample before, linear model, travel."""

    spool: PlayState
    flow: Float[Array, " t"]
    plant: Float[Array, "n t"]
    travel: Float[Array, " t"]


@eqx.filter_jit
def _travel(
    physical_model: PhysicalModel, nonlinearity: StaticNonlinearity, batch: Batch
) -> Float[Array, "t n"]:
    """Return travel through valve, linear dynamics and gain along the stroke, in one loop over the samples.

    A loop for each would write and read all signals, and their derivatives, in between. The spool starts at
    rest: its command is delayed in place of the flow, which for whole samples is the same.
    """
    step_s, initial = batch.step_s, batch.initial
    model = physical_model.discretised_along_stroke(step_s)

    def advance(state: _TestState, command: Array) -> tuple[_TestState, Array]:
        displacement = initial + batch.sign * state.travel
        spool, excess = nonlinearity.step_spool(state.spool, command, batch.dead_zone, step_s)
        flow = nonlinearity.flow(excess)
        plant = model.at(nonlinearity.position(displacement)).advance(state.plant, flow, state.flow)
        step = nonlinearity.gain(displacement) * (plant[0] - state.plant[0])
        return _TestState(spool, flow, plant, state.travel + step), state.travel

    at_rest = jax.vmap(physical_model.state_at_speed, in_axes=(None, 0), out_axes=1)(jnp.zeros(()), initial)
    zeros = jnp.zeros_like(initial)
    first = _TestState(PlayState(zeros, zeros), zeros, at_rest, zeros)
    return jax.lax.scan(advance, first, delayed(batch.raw_command, model.delay_samples))[1].T
