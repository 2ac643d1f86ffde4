"""A physical model one sample at a time: the state of its valve, and the state of its plant."""

import abc
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hitchid._support.records import short_repr
from hitchid.structures.discretisation import DiscreteStateSpace, StrokeModel
from hitchid.structures.nonlinear_structures import NonlinearStructure, rk4_step
from hitchid.structures.nonlinearity import PlayState
from hitchid.structures.physical_model import PhysicalModel

Scalar = Float[Array, ""]
State = Float[Array, " n"]


@short_repr
class ValveState(NamedTuple):
    """State of the valve of one direction.

    Attributes:
        spool: of the valve.
        effective: what of the last command lies beyond the dead zone, in the command's unit.
        flows: input of the plant, the newest first, as far back as the dead time, shape [m + 2].
        motion_demand: whether the command demanded motion, likewise, shape [m + 1].
    """

    spool: PlayState
    effective: Float[Array, ""]
    flows: Float[Array, " m"]
    motion_demand: Bool[Array, " c"]


@short_repr
class DiscretePhysicalModel(eqx.Module):
    """A physical model of one direction at a fixed sampling time.

    Attributes:
        benchmark: the model.
        dead_zone: of the command, in its unit.
        min_command: size of a command below which no motion is demanded.
        sign: +1 where the displacement grows with the command, −1 where it falls.
        delay_samples: m, whole samples of dead time.
        step_s: sampling time, s.
    """

    benchmark: PhysicalModel
    dead_zone: Float[Array, ""]
    min_command: Float[Array, ""]
    sign: int = eqx.field(static=True)
    delay_samples: int = eqx.field(static=True)
    step_s: float = eqx.field(static=True)

    @classmethod
    def of(
        cls, benchmark: PhysicalModel, *, dead_zone: float, min_command: float, sign: int, step_s: float
    ) -> "DiscretePhysicalModel":
        """Discretise a physical model."""
        structure, thresholds = (
            benchmark.structure,
            (jnp.asarray(dead_zone, float), jnp.asarray(min_command, float)),
        )
        if isinstance(structure, NonlinearStructure):
            return _NonlinearModel(benchmark, *thresholds, sign, 0, step_s, structure)
        delay_samples = int(benchmark.discretised(step_s).delay_samples)
        discrete = benchmark.discretised_along_stroke(step_s)
        return _LinearModel(benchmark, *thresholds, sign, delay_samples, step_s, discrete)

    @property
    def is_scheduled(self) -> bool:
        """Whether its parameters vary with covariates."""
        return self.benchmark.scheduling is not None

    def at_load(self, load: Float[Array, " c"]) -> "DiscretePhysicalModel":
        """Return the model at values of its covariates; see `PhysicalModel.at_load`."""
        del load
        return self

    def with_benchmark(self, benchmark: PhysicalModel) -> "DiscretePhysicalModel":
        """Return the model with other numbers, which may be traced; whole samples of dead time stay."""
        return replace(self, benchmark=benchmark)

    def closed_valve(self) -> ValveState:
        """Return the valve before any command."""
        zero = jnp.zeros(())
        motion_demand = jnp.zeros(self.delay_samples + 1, jnp.bool_)
        return ValveState(PlayState(zero, zero), zero, jnp.zeros(self.delay_samples + 2), motion_demand)

    def step_valve(self, valve: ValveState, command: Scalar) -> ValveState:
        """Advance the valve by one sample of its command."""
        nonlinearity, spool = self.benchmark.nonlinearity, valve.spool
        effective = jnp.sign(command) * jnp.maximum(jnp.abs(command) - self.dead_zone, 0.0)
        flow = command if self.benchmark.structure.uses_raw_command else effective
        if nonlinearity is not None:
            spool, excess = nonlinearity.step_spool(spool, command, self.dead_zone, self.step_s)
            flow = nonlinearity.flow(excess)
        demanded = (flow != 0) & (jnp.abs(command) >= self.min_command)
        return ValveState(
            spool,
            effective,
            jnp.concatenate([flow[None], valve.flows[:-1]]),
            jnp.concatenate([demanded[None], valve.motion_demand[:-1]]),
        )

    @abc.abstractmethod
    def init_state(self, displacement: Scalar, speed: Scalar) -> State:
        """Return the plant's state at a displacement and a speed, in the displacement's unit and 1/s."""

    @abc.abstractmethod
    def advance(self, plant_state: State, valve: ValveState, displacement: Scalar) -> tuple[State, Scalar]:
        """Return the plant's state one sample later and the change of the displacement."""

    @abc.abstractmethod
    def speed(self, plant_state: State, valve: ValveState, displacement: Scalar) -> Scalar:
        """Return the speed of the displacement under the input of the sample before."""


class _LinearModel(DiscretePhysicalModel):
    """A linear structure with its nonlinearities; `discrete` is its linear part at the sampling time."""

    discrete: DiscreteStateSpace | StrokeModel

    def at_load(self, load: Float[Array, " c"]) -> DiscretePhysicalModel:
        return self.with_benchmark(self.benchmark.at_load(load)) if self.is_scheduled else self

    def with_benchmark(self, benchmark: PhysicalModel) -> DiscretePhysicalModel:
        return replace(self, benchmark=benchmark, discrete=benchmark.discretised_along_stroke(self.step_s))

    def init_state(self, displacement: Scalar, speed: Scalar) -> State:
        return self.benchmark.state_at_speed(speed / self._scale(displacement), displacement)

    def advance(self, plant_state: State, valve: ValveState, displacement: Scalar) -> tuple[State, Scalar]:
        flows = valve.flows[self.delay_samples], valve.flows[self.delay_samples + 1]
        nonlinearity = self.benchmark.nonlinearity
        position = jnp.zeros(()) if nonlinearity is None else nonlinearity.position(displacement)
        next_state = self.discrete.at(position).advance(plant_state, *flows)
        return next_state, self._scale(displacement) * (next_state[0] - plant_state[0])

    def speed(self, plant_state: State, valve: ValveState, displacement: Scalar) -> Scalar:
        a, b = self.benchmark.structure.require_linear().state_space(self.benchmark.values_at(displacement))
        travel_speed = jnp.sum(a[0] * plant_state) + b[0] * valve.flows[self.delay_samples + 1]
        return self._scale(displacement) * travel_speed

    def _scale(self, displacement: Scalar) -> Scalar:
        """Return the change of displacement per travel of the linear part."""
        nonlinearity = self.benchmark.nonlinearity
        gain = jnp.ones(()) if nonlinearity is None else nonlinearity.gain(displacement)
        return self.sign * gain


class _NonlinearModel(DiscretePhysicalModel):
    """A nonlinear structure, integrated over each sample; its first state is the displacement."""

    structure: NonlinearStructure

    def init_state(self, displacement: Scalar, speed: Scalar) -> State:
        return self.structure.init_state(self.benchmark.values, displacement[None])[:, 0]

    def advance(self, plant_state: State, valve: ValveState, displacement: Scalar) -> tuple[State, Scalar]:
        state, values = plant_state[:, None], self.benchmark.values
        next_state = rk4_step(self.structure, values, state, valve.flows[:1], self.step_s)[:, 0]
        return next_state, next_state[0] - plant_state[0]

    def speed(self, plant_state: State, valve: ValveState, displacement: Scalar) -> Scalar:
        values, previous_flow = self.benchmark.values, valve.flows[self.delay_samples + 1][None]
        return self.structure.vector_field(values, plant_state[:, None], previous_flow)[0, 0]
