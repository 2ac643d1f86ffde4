"""A benchmark one sample at a time: its valve hears every command, its plant moves when it is in charge."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hitchid.structures.discretise import Discrete
from hitchid.structures.nonlinear import NonlinearStructure, advanced
from hitchid.structures.physical_model import Benchmark
from hitchid.structures.shape import Spool


class Valve(NamedTuple):
    """State of the valve of one direction.

    Attributes:
        spool: of the valve.
        effective: what of the last command lies beyond the dead zone, in the command's unit.
        flows: what the linear model hears, the newest first, as far back as the dead time, shape [m + 2].
        calls: whether the command asked for motion, likewise, shape [m + 1].
    """

    spool: Spool
    effective: Float[Array, ""]
    flows: Float[Array, " m"]
    calls: Bool[Array, " c"]


class Sampled(eqx.Module):
    """A benchmark of one direction on a clock.

    Attributes:
        benchmark: the model.
        discrete: its linear part on the clock; None where it is not linear.
        dead_zone: of the command, in its unit.
        least: size of a command below which it asks for no motion.
        direction: +1 where the displacement grows with the command, −1 where it falls.
        late: m, whole samples of dead time.
        step_s: sampling time, s.
    """

    benchmark: Benchmark
    discrete: Discrete | None
    dead_zone: float = eqx.field(static=True)
    least: float = eqx.field(static=True)
    direction: int = eqx.field(static=True)
    late: int = eqx.field(static=True)
    step_s: float = eqx.field(static=True)

    @classmethod
    def of(
        cls, benchmark: Benchmark, *, dead_zone: float, least: float, direction: int, step_s: float
    ) -> "Sampled":
        """Put a benchmark on a clock."""
        linear = not isinstance(benchmark.structure, NonlinearStructure)
        discrete = benchmark.discretised(step_s) if linear else None
        late = 0 if discrete is None else int(discrete.whole)
        return cls(benchmark, discrete, dead_zone, least, direction, late, step_s)

    def shut(self) -> Valve:
        """Return the valve before it has heard any command."""
        nothing = jnp.zeros(())
        calls = jnp.zeros(self.late + 1, jnp.bool_)
        return Valve(Spool(nothing, nothing), nothing, jnp.zeros(self.late + 2), calls)

    def hear(self, valve: Valve, command: Float[Array, ""], load: Float[Array, ""]) -> Valve:
        """Let the valve hear one sample of its command."""
        shape, spool = self.benchmark.shape, valve.spool
        effective = jnp.sign(command) * jnp.maximum(jnp.abs(command) - self.dead_zone, 0.0)
        flow = command if self.discrete is None else effective
        if shape is not None:
            spool, beyond = shape.follow(spool, command, jnp.asarray(self.dead_zone), self.step_s)
            flow = shape.flow(beyond, load)
        called = (flow != 0) & (jnp.abs(command) >= self.least)
        return Valve(
            spool,
            effective,
            jnp.concatenate([flow[None], valve.flows[:-1]]),
            jnp.concatenate([called[None], valve.calls[:-1]]),
        )

    def entered(
        self, displacement: Float[Array, ""], speed: Float[Array, ""], load: Float[Array, ""]
    ) -> Float[Array, " n"]:
        """Return the plant's state at a displacement and a speed, in the displacement's unit and 1/s."""
        structure, values = self.benchmark.structure, self.benchmark.values
        if isinstance(structure, NonlinearStructure):
            return structure.start(values, displacement[None])[:, 0]
        return self.benchmark.linear.moving(values, self.direction * speed / self._gain(displacement, load))

    def advance(
        self,
        plant: Float[Array, " n"],
        valve: Valve,
        displacement: Float[Array, ""],
        load: Float[Array, ""],
    ) -> tuple[Float[Array, " n"], Float[Array, ""]]:
        """Return the plant's state one sample later and how far the displacement changes."""
        structure, values = self.benchmark.structure, self.benchmark.values
        if isinstance(structure, NonlinearStructure):
            after = advanced(structure, values, plant[:, None], valve.flows[:1], self.step_s)[:, 0]
            return after, after[0] - plant[0]
        model = self.discrete or self.benchmark.discretised(self.step_s)
        now, before = valve.flows[self.late], valve.flows[self.late + 1]
        # A sum, not a product of matrices: so small, the call would cost more than the work.
        carried = jnp.sum(model.transition * plant, axis=1)
        after = carried + now * model.now + before * model.before
        return after, self.direction * self._gain(displacement, load) * (after[0] - plant[0])

    def speed(
        self,
        plant: Float[Array, " n"],
        valve: Valve,
        displacement: Float[Array, ""],
        load: Float[Array, ""],
    ) -> Float[Array, ""]:
        """Return the speed of the displacement, the input being that of the sample before."""
        structure, values = self.benchmark.structure, self.benchmark.values
        held = valve.flows[self.late + 1]
        if isinstance(structure, NonlinearStructure):
            return structure.rate(values, plant[:, None], held[None])[0, 0]
        a, b = self.benchmark.linear.state_space(values)
        return self.direction * self._gain(displacement, load) * (jnp.sum(a[0] * plant) + b[0] * held)

    def _gain(self, displacement: Float[Array, ""], load: Float[Array, ""]) -> Float[Array, ""]:
        shape = self.benchmark.shape
        return jnp.ones(()) if shape is None else shape.gain(displacement, load)
