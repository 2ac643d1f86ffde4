"""One direction of a hitch as its controller sees it: speed to current, and travel not yet measured."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid._support.records import short_repr
from hitchid.structures import (
    DiscretePhysicalModel,
    PhysicalModel,
    ValveState,
    command_for_speed,
    steady_speed,
)

Scalar = Float[Array, ""]
REACHABLE = 1 - 1e-9  # of the speed at the largest current: a saturated valve has no inverse at its limit


@short_repr
class AxisState(NamedTuple):
    """State of the model of one direction.

    Attributes:
        valve: of the undelayed model.
        plant: of the undelayed model, shape [n].
        increments: signed travel over each of the last samples, the newest first, shape [m].
    """

    valve: ValveState
    plant: Float[Array, " n"]
    increments: Float[Array, " m"]


@short_repr
class Axis(eqx.Module):
    """Model of one direction in a controller: what it does now shows in the measurement a dead time later.

    Attributes:
        identified: physical model without its dead time, with what covariates change in it.
        model: discrete model of it at one load.
        dead_time_samples: dead time T over the sampling time.
        largest_command: largest current of the identification tests.
        buffer: samples of travel that are kept, more than the dead time.
    """

    identified: PhysicalModel
    model: DiscretePhysicalModel
    dead_time_samples: Scalar
    largest_command: float = eqx.field(static=True)
    buffer: int = eqx.field(static=True)

    @classmethod
    def of(
        cls, benchmark: PhysicalModel, *, sign: int, dead_zone: float, step_s: float, largest_command: float
    ) -> "Axis":
        """Return the axis of a physical model of a linear structure with an integrator, at its mean load."""
        # Without its dead time, which `increments` keeps: a Smith predictor runs on what is under way.
        identified = undelayed(benchmark)
        model = DiscretePhysicalModel.of(
            identified.at_load(identified.mean_load),
            dead_zone=dead_zone,
            min_command=0.0,  # the controller's own commands: no noise of a log is to be passed over
            sign=sign,
            step_s=step_s,
        )
        samples = float(benchmark.dead_time_s) / step_s
        return cls(identified, model, jnp.asarray(samples), largest_command, buffer_of(samples))

    @property
    def step_s(self) -> float:
        """Sampling time, s."""
        return self.model.step_s

    @property
    def sign(self) -> int:
        """Sign of its speed."""
        return self.model.sign

    @property
    def covariates(self) -> tuple[str, ...]:
        """Names of the covariates that its parameters vary with."""
        return self.identified.covariates

    def at_load(self, load: Mapping[str, float]) -> "Axis":
        """Return the axis at values of its covariates, by name; one that is not given has its mean."""
        means = self.identified.mean_load
        row = [load.get(name, mean) for name, mean in zip(self.covariates, means, strict=False)]
        at_load = self.identified.at_load(jnp.asarray(row or means))
        return eqx.tree_at(lambda axis: axis.model, self, self.model.with_benchmark(at_load))

    def with_benchmark(self, benchmark: PhysicalModel) -> "Axis":
        """Return the axis with the numbers of another benchmark, which may be traced.

        Its dead time may have at most the samples that are kept.
        """
        return eqx.tree_at(
            lambda axis: (axis.model, axis.dead_time_samples),
            self,
            (self.model.with_benchmark(undelayed(benchmark)), benchmark.dead_time_s / self.step_s),
        )

    @property
    def lags(self) -> tuple[float, float]:
        """a₁ and a₂ of the speed's denominator 1 + a₁ s + a₂ s² + …, the spool's lag in a₁, s and s².

        The speed is a₁ behind a current that changes steadily, and travels a₁ times itself when it stops.
        """
        benchmark = self.model.benchmark
        structure = benchmark.structure.require_linear()
        denominator = structure.transfer_function(tuple(benchmark.values.tolist()))[1][::-1]
        a1, a2 = (*(float(factor / denominator[1]) for factor in denominator[2:4]), 0.0, 0.0)[:2]
        nonlinearity = benchmark.nonlinearity
        spool_s = 0.0 if nonlinearity is None else float(nonlinearity.named("spool_lag")[0])
        return a1 + spool_s, a2

    def initial_state(self, displacement: Scalar) -> AxisState:
        """Return the state at rest with a closed valve."""
        plant = self.model.init_state(displacement, jnp.zeros(()))
        return AxisState(self.model.closed_valve(), plant, jnp.zeros(self.buffer))

    def step(self, state: AxisState, current: Scalar, displacement: Scalar) -> AxisState:
        """Return the state one sample later.

        Args:
            state: of this axis.
            current: held over the sample.
            displacement: about which gains and dynamics along the stroke are taken.
        """
        valve = self.model.step_valve(state.valve, current)
        plant, increment = self.model.advance(state.plant, valve, displacement)
        return AxisState(valve, plant, jnp.concatenate([increment[None], state.increments[:-1]]))

    def under_way(self, state: AxisState) -> Scalar:
        """Return the travel that was caused but is not measured yet, that of the last dead time."""
        # Of a dead time of 6.4 samples six count fully and one by 0.4.
        shares = jnp.clip(self.dead_time_samples - jnp.arange(self.buffer), 0.0, 1.0)
        return jnp.sum(shares * state.increments)

    def speed(self, state: AxisState) -> Scalar:
        """Return the speed a dead time ahead."""
        return state.increments[0] / self.step_s

    def acceleration(self, state: AxisState) -> Scalar:
        """Return the acceleration a dead time ahead."""
        return (state.increments[0] - state.increments[1]) / self.step_s**2

    def fastest(self, displacement: Scalar) -> Scalar:
        """Return the size of the steady speed at the largest current."""
        levels = jnp.asarray(self.largest_command)
        return steady_speed(self.model.benchmark, levels, self.model.dead_zone, displacement)

    def current_for(self, speed: Scalar, displacement: Scalar) -> Scalar:
        """Return the current of a steady speed, at most the largest of the identification tests.

        Args:
            speed: size of the speed.
            displacement: of the piston.
        """
        # Where more is wanted, the largest current: an inverse beyond the reachable speed would be none.
        reachable = jnp.minimum(speed, REACHABLE * self.fastest(displacement))
        current = command_for_speed(self.model.benchmark, reachable[None], self.model.dead_zone, displacement)
        return jnp.clip(current[0], 0.0, self.largest_command)


def buffer_of(dead_time_samples: float) -> int:
    """Return how many samples of travel are kept: those of the dead time, and two for the acceleration."""
    return math.ceil(dead_time_samples) + 2


def undelayed(benchmark: PhysicalModel) -> PhysicalModel:
    """Return the benchmark without its dead time."""
    return eqx.tree_at(lambda model: model.dead_time_s, benchmark, jnp.zeros(()))
