"""What a chosen form can go without: parameter after parameter, as long as none is missed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hitchid.errors import FitError
from hitchid.estimation import Objective, allows_per_test_gain
from hitchid.identification.candidates import Candidate, Evaluation, is_missed
from hitchid.structures import DEAD_TIME, Batch, ModelSpec, structure_named
from hitchid.structures.nonlinearity import NEUTRAL, STROKE_GAIN_QUADRATIC

TRIED = 3  # parameters that a form is fitted without before it keeps all: those that it needs least; chosen
RIDGE = 1e-12  # share of the squares' curvature that is taken for rounding
# Structures of which the next is a part.
PLAINER = {
    "integrator-second-order-stroke": "integrator-second-order-friction",
    "integrator-second-order-friction": "integrator-second-order",
    "integrator-second-order": "integrator-first-order",
}
FittedWithout = Callable[[str, Objective, Sequence[int], Sequence[np.ndarray]], Evaluation]


def smaller_candidates(
    grown: Candidate, coarse: Batch, fitted: FittedWithout, report: Callable[[Candidate], object]
) -> list[Candidate]:
    """Return the forms that were fitted with fewer and fewer of a form's optional parameters.

    One parameter after the other has no effect any more, least needed first, until what is left is missed
    beside the form that the choice had grown; see `is_missed`. Forms of one structure are one program, in
    which parameters stand still.

    Args:
        grown: the form that the choice took.
        coarse: tests it was fitted to.
        fitted: fits and cross-validates the free parameters of an objective, by a name for it.
        report: called with each form.
    """
    batch, current = coarse.with_dead_zone(grown.dead_zone), grown
    candidates: list[Candidate] = []

    def tried(name: str, objective: Objective, spec: ModelSpec, start: np.ndarray) -> np.ndarray | None:
        """Add a form that is part of the current one; return its positions, None if anything is missed."""
        names = [parameter.name for parameter in objective.spec.parameters]
        free = [names.index(parameter.name) for parameter in spec.parameters]
        objective = replace(objective, per_test_gain=allows_per_test_gain(coarse, spec))
        try:
            evaluation = fitted(name, objective, free, [start])
        except FitError:
            return None
        candidates.append(replace(evaluation.candidate(name, spec, objective, free), base=current.name))
        report(candidates[-1])
        return None if is_missed(candidates[-1], (current, grown)) else evaluation.positions

    while structure_name := PLAINER.get(current.spec.structure.name):
        spec = current.spec.with_structure(structure_named(structure_name))
        objective = Objective.of(batch, spec)
        start = objective.position(_start_of(spec, current.named_values))
        if tried(f"the same with {structure_name}", objective, spec, start) is None:
            break
        current = candidates[-1]
    objective = Objective.of(batch, current.spec)
    names = [parameter.name for parameter in current.spec.parameters]
    positions, removed = objective.position(current.values), list[str]()
    while True:
        for name in _least_needed(objective, names, positions, current.spec)[:TRIED]:
            spec = current.spec.limited_to({p.name for p in current.spec.parameters} - {name})
            start = positions.copy()
            start[names.index(name)] = _neutral_position(objective, names.index(name))
            label = f"the same without {', '.join([*removed, name])}".replace("_", " ")
            reached = tried(label, objective, spec, start)
            if reached is not None:
                current, positions, removed = candidates[-1], reached, [*removed, name]
                break
        else:
            return candidates


def _start_of(spec: ModelSpec, values: Mapping[str, float]) -> np.ndarray:
    """Return where a form starts with a plainer structure: two lags become one of the same delay, 2ζ/ω."""
    lag = {}
    if "damping_ratio" in values:
        lag["time_constant"] = 2 * values["damping_ratio"] / values["natural_frequency"]
    by_name = {**lag, **values}
    return np.array([by_name.get(p.name, NEUTRAL.get(p.name, 0.0)) for p in spec.parameters])


def _least_needed(
    objective: Objective, names: Sequence[str], positions: np.ndarray, spec: ModelSpec
) -> list[str]:
    """Return the parameters that a form may go without, by how much the squares would grow, to second order.

    With θ at θ₀ and the others fitted anew they grow by (θ − θ₀)²/[H⁻¹]ⱼⱼ, H half their second derivatives.
    """
    optional = {p.name for p in (*spec.nonlinearity_parameters, *spec.covariate_parameters)}
    optional |= {DEAD_TIME.name} if spec.dead_time else set()
    # Bounds of its own say what is known of a parameter, and how well: such as the opening that a ramp shows.
    optional -= set(spec.bounds)
    slope, curve = (parameter.name for parameter in STROKE_GAIN_QUADRATIC)
    if curve in optional:  # a gain that only bends has no slope at the middle: an accident of the range
        optional.discard(slope)
    if not optional:
        return []
    free = [names.index(parameter.name) for parameter in spec.parameters]
    equations = objective.equations_by_test(positions)
    curvature = equations.curvatures.sum(axis=0)[np.ix_(free, free)]
    # What has no effect at all has a variance without bounds, and is needed least.
    ridge = RIDGE * float(np.trace(curvature)) * np.eye(len(free))
    variances = np.diag(np.linalg.inv(curvature + ridge))
    growth = {
        names[i]: (positions[i] - _neutral_position(objective, i)) ** 2 / float(variance)
        for i, variance in zip(free, variances, strict=True)
        if names[i] in optional
    }
    return sorted(growth, key=growth.__getitem__)


def _neutral_position(objective: Objective, number: int) -> float:
    """Return the position where a parameter has no effect, or as little as its bounds allow."""
    lower, upper = float(objective.bounds.lower[number]), float(objective.bounds.upper[number])
    values = np.asarray(0.5 * (objective.bounds.lower + objective.bounds.upper)).copy()
    name = objective.spec.parameters[number].name
    values[number] = np.clip(NEUTRAL.get(name, 0.0), lower, upper)
    return float(objective.position(values)[number])
