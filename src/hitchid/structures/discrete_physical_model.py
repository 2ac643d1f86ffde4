"""A benchmark one sample at a time: its valve hears every command, its plant moves when it is in charge."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hitchid.structures.discretise import DiscreteStateSpace
from hitchid.structures.nonlinear import NonlinearStructure, rk4_step
from hitchid.structures.physical_model import PhysicalModel
from hitchid.structures.static_nonlinearity import PlayState


class ValveState(NamedTuple):
    """State of the valve of one direction.

    Attributes:
        spool: of the valve.
        effective: what of the last command lies beyond the dead zone, in the command's unit.
        flows: what the linear model hears, the newest first, as far back as the dead time, shape [m + 2].
        motion_demand: whether the command asked for motion, likewise, shape [m + 1].
    """

    spool: PlayState
    effective: Float[Array, ""]
    flows: Float[Array, " m"]
    motion_demand: Bool[Array, " c"]


class DiscretePhysicalModel(eqx.Module):
    """A benchmark of one direction on a clock.

    Attributes:
        benchmark: the model.
        discrete: its linear part on the clock; None where it is not linear.
        dead_zone: of the command, in its unit.
        min_command: size of a command below which it asks for no motion.
        sign: +1 where the displacement grows with the command, −1 where it falls.
        delay_samples: m, whole samples of dead time.
        step_s: sampling time, s.
    """

    benchmark: PhysicalModel
    discrete: DiscreteStateSpace | None
    dead_zone: float = eqx.field(static=True)
    min_command: float = eqx.field(static=True)
    sign: int = eqx.field(static=True)
    delay_samples: int = eqx.field(static=True)
    step_s: float = eqx.field(static=True)

    @classmethod
    def of(
        cls, benchmark: PhysicalModel, *, dead_zone: float, min_command: float, sign: int, step_s: float
    ) -> "DiscretePhysicalModel":
        """Put a benchmark on a clock."""
        linear = not isinstance(benchmark.structure, NonlinearStructure)
        discrete = benchmark.discretised(step_s) if linear else None
        delay_samples = 0 if discrete is None else int(discrete.delay_samples)
        return cls(benchmark, discrete, dead_zone, min_command, sign, delay_samples, step_s)

    def closed_valve(self) -> ValveState:
        """Return the valve before it has heard any command."""
        zero = jnp.zeros(())
        motion_demand = jnp.zeros(self.delay_samples + 1, jnp.bool_)
        return ValveState(PlayState(zero, zero), zero, jnp.zeros(self.delay_samples + 2), motion_demand)

    def step_valve(
        self, valve: ValveState, command: Float[Array, ""], covariate: Float[Array, ""]
    ) -> ValveState:
        """Let the valve hear one sample of its command."""
        nonlinearity, spool = self.benchmark.nonlinearity, valve.spool
        effective = jnp.sign(command) * jnp.maximum(jnp.abs(command) - self.dead_zone, 0.0)
        flow = command if self.discrete is None else effective
        if nonlinearity is not None:
            spool, excess = nonlinearity.step_spool(spool, command, jnp.asarray(self.dead_zone), self.step_s)
            flow = nonlinearity.flow(excess, covariate)
        demanded = (flow != 0) & (jnp.abs(command) >= self.min_command)
        return ValveState(
            spool,
            effective,
            jnp.concatenate([flow[None], valve.flows[:-1]]),
            jnp.concatenate([demanded[None], valve.motion_demand[:-1]]),
        )

    def init_state(
        self, displacement: Float[Array, ""], speed: Float[Array, ""], load: Float[Array, ""]
    ) -> Float[Array, " n"]:
        """Return the plant's state at a displacement and a speed, in the displacement's unit and 1/s."""
        structure, values = self.benchmark.structure, self.benchmark.values
        if isinstance(structure, NonlinearStructure):
            return structure.init_state(values, displacement[None])[:, 0]
        return self.benchmark.linear.state_at_speed(
            values, self.sign * speed / self._gain(displacement, load)
        )

    def advance(
        self,
        plant_state: Float[Array, " n"],
        valve: ValveState,
        displacement: Float[Array, ""],
        covariate: Float[Array, ""],
    ) -> tuple[Float[Array, " n"], Float[Array, ""]]:
        """Return the plant's state one sample later and how far the displacement changes."""
        structure, values = self.benchmark.structure, self.benchmark.values
        if isinstance(structure, NonlinearStructure):
            next_state = rk4_step(structure, values, plant_state[:, None], valve.flows[:1], self.step_s)[:, 0]
            return next_state, next_state[0] - plant_state[0]
        model = self.discrete or self.benchmark.discretised(self.step_s)
        current_flow, previous_flow = valve.flows[self.delay_samples], valve.flows[self.delay_samples + 1]
        # A sum, not a product of matrices: so small, the call would cost more than the work.
        free_response = jnp.sum(model.transition * plant_state, axis=1)
        next_state = free_response + current_flow * model.gamma0 + previous_flow * model.gamma1
        return next_state, self.sign * self._gain(displacement, covariate) * (next_state[0] - plant_state[0])

    def speed(
        self,
        plant_state: Float[Array, " n"],
        valve: ValveState,
        displacement: Float[Array, ""],
        covariate: Float[Array, ""],
    ) -> Float[Array, ""]:
        """Return the speed of the displacement, the input being that of the sample before."""
        structure, values = self.benchmark.structure, self.benchmark.values
        previous_flow = valve.flows[self.delay_samples + 1]
        if isinstance(structure, NonlinearStructure):
            return structure.vector_field(values, plant_state[:, None], previous_flow[None])[0, 0]
        a, b = self.benchmark.linear.state_space(values)
        return (
            self.sign
            * self._gain(displacement, covariate)
            * (jnp.sum(a[0] * plant_state) + b[0] * previous_flow)
        )

    def _gain(self, displacement: Float[Array, ""], covariate: Float[Array, ""]) -> Float[Array, ""]:
        nonlinearity = self.benchmark.nonlinearity
        return jnp.ones(()) if nonlinearity is None else nonlinearity.gain(displacement, covariate)
