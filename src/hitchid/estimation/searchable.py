"""What a global search minimises: the error from correlations where that is defined, else by simulation."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.estimation.bounds import Bounds
from hitchid.estimation.correlations import Correlations, collectable
from hitchid.estimation.misfit import Misfit, traced
from hitchid.estimation.search import Problem
from hitchid.structures import Form, Scales, pulse_response
from hitchid.structures.structure import LinearStructure


class FromCorrelations(eqx.Module):
    """J of a linear form over tests, at the same cost for any number of them; see `Correlations`.

    Attributes:
        correlations: of the tests.
        form: what is searched.
        scales: what the form's curves would be measured in.
        bounds: of its parameters.
        step_s: sampling time, s.
    """

    correlations: Correlations
    form: Form = eqx.field(static=True)
    scales: Scales
    bounds: Bounds
    step_s: float

    def __call__(self, positions: Float[Array, "p d"]) -> Float[Array, " p"]:
        """Return J at each of p positions."""

        def response(position: Float[Array, " d"]) -> Float[Array, " n"]:
            benchmark = self.form.benchmark(self.bounds.values(position), self.scales)
            return pulse_response(benchmark.discretised(self.step_s), self.correlations.cross.size)

        return jnp.sqrt(self.correlations.mean_square(jax.vmap(response)(positions)))


def searchable(misfit: Misfit) -> Problem:
    """Return the problem that a global search of a misfit is given."""
    problem = misfit.problem()
    form, batch = misfit.form, misfit.batch
    linear = isinstance(form.structure, LinearStructure) and not form.shaped
    if not (linear and collectable(batch)):
        return problem
    found = Correlations.of(batch)
    fitness = FromCorrelations(found, form, misfit.scales, misfit.bounds, batch.step_s)
    return replace(problem, fitness=traced(fitness))
