"""What a global search minimises: the error from correlations where that is defined, else by simulation."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.estimation.bounds import Bounds
from hitchid.estimation.correlations import Correlations, correlations_applicable
from hitchid.estimation.objective import Objective, traced
from hitchid.estimation.search import SearchProblem
from hitchid.structures import ModelSpec, Scales, pulse_response


class CorrelationObjective(eqx.Module):
    """J of a linear form over tests, at the same cost for any number of them; see `Correlations`.

    Attributes:
        correlations: of the tests.
        spec: what is searched.
        scales: what the form's curves would be measured in.
        bounds: of its parameters.
        step_s: sampling time, s.
    """

    correlations: Correlations
    spec: ModelSpec = eqx.field(static=True)
    scales: Scales
    bounds: Bounds
    step_s: float

    def __call__(self, positions: Float[Array, "p d"]) -> Float[Array, " p"]:
        """Return J at each of p positions."""

        def response(position: Float[Array, " d"]) -> Float[Array, " n"]:
            benchmark = self.spec.physical_model(self.bounds.values(position), self.scales)
            return pulse_response(
                benchmark.discretised(self.step_s), self.correlations.cross_correlation.size
            )

        return jnp.sqrt(self.correlations.mean_square(jax.vmap(response)(positions)))


def search_problem(objective: Objective) -> SearchProblem:
    """Return the problem that a global search of a misfit is given."""
    problem = objective.problem()
    spec, batch = objective.spec, objective.batch
    linear = spec.structure.linear is not None and not spec.nonlinearity_parameters
    if not (linear and correlations_applicable(batch)):
        return problem
    correlations = Correlations.of(batch)
    fitness = CorrelationObjective(correlations, spec, objective.scales, objective.bounds, batch.step_s)
    return replace(problem, fitness=traced(fitness))
