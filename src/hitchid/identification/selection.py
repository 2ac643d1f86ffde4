"""Choice of the form of one direction: free run on operating points held out in turn decides."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hitchid._support import checks
from hitchid._support.checkpoints import DISABLED, Checkpoints
from hitchid._support.metrics import better_on_held_out_tests
from hitchid._support.progress import ProgressCallback, ProgressUpdate, silent, split_progress
from hitchid.errors import FitError
from hitchid.estimation import Objective, Search, allows_per_test_gain
from hitchid.identification.candidates import (
    CURVE_STARTS,
    MIDDLE,
    NEUTRAL_POSITIONS,
    NEXT_STRUCTURES,
    Candidate,
    Evaluation,
    best_candidate,
    covariate_specs,
    evaluate,
    evaluation_shapes,
    fit_and_evaluate,
    goes_back,
    largest_spec,
    nested_specs,
    operating_point_folds,
    starts,
    with_positions,
)
from hitchid.identification.phase1 import Fit, Phase1, assess_fit, continue_fit, find_parameters
from hitchid.identification.smaller_forms import smaller_candidates
from hitchid.structures import Batch, ModelOption, ModelSpec, Structure, external_structures, structure_named
from hitchid.uncertainty import NO_ERROR, DeadZoneError

# Shares of a dead zone that is tried again with a valve curve; the first decides whether the others are.
DEAD_ZONE_SHARES = (0.5, 0.25, 0.75, 0.0)
# Work of the first fit, the candidates, structures of other packages, the last fit, the intervals (measured).
CHOICE_SHARES = {"baseline": 0.2, "candidates": 0.4, "external": 0.05, "chosen": 0.1, "intervals": 0.25}
RETURNING_SPEC = ModelSpec(structure_named("first-order-lag"))  # of a piston that goes back by itself
BASELINE = "transfer function"  # name of the first candidate


@dataclass(frozen=True)
class AutoStructure:
    """Automatic choice of the structure, used in place of a model specification.

    Attributes:
        baseline_spec: specification the choice starts from and must improve on.
        covariate_names: names of the covariates that may be used; empty for all of the campaign.
        repeats: how often the choice is made again from tests that differ a little; see `repeat_choice`.
    """

    baseline_spec: ModelSpec
    covariate_names: tuple[str, ...] = ()
    repeats: int = 0

    def __post_init__(self) -> None:
        """Refuse what is no number of repeats."""
        if checks.integer(self.repeats, "repeats") < 0:
            raise checks.input_error("repeats", "at least 0", self.repeats)


def choose_spec(
    batch: Batch,
    auto_structure: AutoStructure,
    search: Search,
    seed: int,
    *,
    units: Mapping[str, str],
    opening_known: bool = False,
    revised: bool = False,
    dead_zone: DeadZoneError = NO_ERROR,
    progress: ProgressCallback = silent,
    checkpoints: Checkpoints = DISABLED,
) -> tuple[Phase1, tuple[Candidate, ...]]:
    """Identify the form that predicts operating points it was not fitted to best in free run.

    Tests are grouped by the level of their command and groups held out in turn, never samples; the lowest and
    the highest stay in, for a model does not extrapolate. Forms nest: each starts its least squares from the
    optimum of the one before, its new curves from a few shapes. A larger form takes the place of a smaller
    one where it is significantly better on held-out tests; see `best_candidate`. Dry friction follows, and
    where that is better a natural frequency that varies along the stroke; then structures of other packages,
    alone and with the options of the best form so far. The one taken is refined over all samples. Where a
    piston that is left alone goes back, the first form is a lag without integrator, if that fits better.

    Covariates are tried one after the other on top of the best form; see `covariate_candidates`. The opening
    is known where a ramp showed the valve to open: tests at a few levels do not determine the flow below the
    lowest. A dead zone that is revised may be found anew with a valve curve; see `_with_smaller_dead_zone`.

    Raises:
        FitError: nothing moves, or no parameters give a finite error.
        InputError: a structure of another package cannot be imported.
    """
    covariates = [name for name in auto_structure.covariate_names if np.ptp(batch.load([name])) > 0]
    folds = operating_point_folds(batch, separate_tests=bool(covariates))
    parts = split_progress(progress, CHOICE_SHARES)
    choice = _Choice(batch, batch.coarse(), folds, search, seed, units, parts, checkpoints)
    assessed = partial(assess_fit, units=units, dead_zone=dead_zone, seed=seed, progress=parts["intervals"])
    baseline = choice.search_fit(auto_structure.baseline_spec, part="baseline", checkpoint="plain")
    if goes_back(batch):
        # Held-out tests are often too few to prove another form; a piston that goes back can be seen.
        with suppress(FitError):
            lag = choice.search_fit(RETURNING_SPEC, part="baseline", checkpoint="lag")
            baseline = min(baseline, lag, key=lambda fit: fit.objective.error(fit.position))
    if not folds:
        return assessed(baseline), ()
    largest = largest_spec(auto_structure.baseline_spec, opening_known=opening_known)
    candidates = choice.nested_candidates(baseline, largest, revised=revised)
    candidates = covariate_candidates(candidates, covariates, choice.with_covariate)
    chosen = best_candidate(candidates)
    # Friction and a varying frequency come after the curves: beside wrong ones they would fit their error.
    while following := choice.next_structure(candidates[chosen]):
        candidates += following
        chosen = best_candidate(candidates)
        if chosen != len(candidates) - 1:
            break
    for structure in external_structures():
        candidates += choice.candidates_of(structure, candidates[chosen])
        chosen = best_candidate(candidates)
    if chosen:
        candidates += smaller_candidates(
            candidates[chosen],
            choice.coarse,
            choice.fitted,
            partial(choice.report, "candidates", fraction=1.0),
        )
        chosen = best_candidate(candidates)
    candidates[chosen] = replace(candidates[chosen], chosen=True)
    fit = choice.final_fit(candidates[chosen], candidates[0], baseline) if chosen else baseline
    return assessed(fit), tuple(candidates)


def covariate_candidates(
    candidates: Sequence[Candidate],
    covariates: Sequence[str],
    fit: Callable[[Candidate, Sequence[tuple[str, ModelSpec]]], list[Candidate]],
) -> list[Candidate]:
    """Return the candidates with those that covariates are added to, until none is better.

    The load of a test that nobody measured hides what other options add. The first covariate is therefore
    added to the form with all options, and judged against the best: with its effect on speed and opening, on
    the dynamics, too, and with its square. In the same way one covariate hides what another changes: each
    time one has been added, larger effects of those before it are tried again.
    The last of those given has all options; `fit` extends a candidate by named specifications.
    """
    everything, base = list(candidates), candidates[-1]
    while True:
        before, tried = len(everything), {candidate.spec for candidate in everything}
        for name in covariates:
            specs = [each for each in covariate_specs(base.spec, name) if each[1] not in tried]
            everything += fit(base, specs) if specs else []
        chosen = best_candidate(everything)
        if chosen < before:
            return everything
        base = everything[chosen]


@dataclass(frozen=True)
class _Choice:
    """Data and settings shared by all steps of one choice; `folds` are tests that are held out together."""

    batch: Batch
    coarse: Batch
    folds: Sequence[np.ndarray]
    search: Search
    seed: int
    units: Mapping[str, str]
    parts: Mapping[str, ProgressCallback]
    checkpoints: Checkpoints

    def search_fit(self, spec: ModelSpec, *, part: str, checkpoint: str) -> Fit:
        """Fit a form by global search and least squares; see `find_parameters`."""
        return find_parameters(
            self.batch,
            spec,
            self.search,
            self.seed,
            unit=self.units["x"],
            progress=self.parts[part],
            checkpoints=self.checkpoints.child(checkpoint),
        )

    def final_fit(self, candidate: Candidate, plain: Candidate, baseline: Fit) -> Fit:
        """Fit the chosen form over all samples, from its optimum; the tests may have another dead zone."""
        was_reduced = candidate.dead_zone != plain.dead_zone
        return continue_fit(
            self.batch.with_dead_zone(candidate.dead_zone) if was_reduced else self.batch,
            candidate.spec,
            candidate.values,
            baseline,
            progress=self.parts["chosen"],
            checkpoints=self.checkpoints.child(f"chosen {candidate.name}"),
        )

    def nested_candidates(self, baseline: Fit, largest: ModelSpec, *, revised: bool) -> list[Candidate]:
        """Return the plain form and the nested ones; a form that cannot be fitted is left out."""
        spec = baseline.objective.spec
        objective, free = Objective.of(self.coarse, spec), range(baseline.position.size)
        work = partial(evaluate, objective, free, baseline.position, self.folds)
        shapes = evaluation_shapes(objective, self.folds)
        evaluation = self.checkpoints.cached("form", Evaluation, work, shapes)
        candidates = [evaluation.candidate(BASELINE, spec, objective, free)]
        objective = Objective.of(self.coarse, largest)
        names = [parameter.name for parameter in largest.parameters]
        gain = {largest.structure.gain: baseline.gain} if spec.structure.gain else {}
        positions = _positions_of(objective, names, gain)
        specs = nested_specs(largest)
        for number, (name, spec) in enumerate(specs):
            self.parts["candidates"](ProgressUpdate(f"trying the form {name}", number / len(specs)))
            free = [names.index(parameter.name) for parameter in spec.parameters]
            objective = replace(objective, per_test_gain=allows_per_test_gain(self.coarse, spec))
            previous = candidates[-1].spec
            new_starts = starts(spec, [] if len(candidates) == 1 else previous.parameters)
            all_starts = [with_positions(positions, names, start) for start in ({}, *new_starts)]
            try:
                evaluation = self.fitted(f"form {name}", objective, free, all_starts)
            except FitError:
                continue
            if spec.valve_curve and not previous.valve_curve and revised:
                objective, evaluation = self._with_smaller_dead_zone(objective, evaluation, free)
            positions = evaluation.positions
            candidates.append(evaluation.candidate(name, spec, objective, free))
            self.report("candidates", candidates[-1], (number + 1) / len(specs))
        return candidates

    def with_covariate(self, base: Candidate, specs: Sequence[tuple[str, ModelSpec]]) -> list[Candidate]:
        """Return candidates with more effects of one covariate than a form has, few to many."""
        objective = Objective.of(self.coarse.with_dead_zone(base.dead_zone), specs[-1][1])
        names = [parameter.name for parameter in objective.spec.parameters]
        positions = _positions_of(objective, names, base.named_values)
        found: list[Candidate] = []
        for name, spec in specs:
            free = [names.index(parameter.name) for parameter in spec.parameters]
            objective = replace(objective, per_test_gain=allows_per_test_gain(self.coarse, spec))
            try:
                evaluation = self.fitted(f"form {base.name} {name}", objective, free, [positions])
            except FitError:
                continue
            positions = evaluation.positions
            others = "".join(f"{known}, " for known in spec.covariate_names[:-1])
            found.append(evaluation.candidate(f"{others}{name}", spec, objective, free))
            self.report("candidates", found[-1], 1.0)
        return found

    def candidates_of(self, structure: Structure, incumbent: Candidate) -> list[Candidate]:
        """Return another structure alone, and with the options of the best form so far.

        None of a structure that takes the whole command, for the tests have a dead zone, and none that cannot
        be fitted.
        """
        if structure.uses_raw_command:
            return []
        baseline_spec = ModelSpec(structure, dead_time=ModelOption.DEAD_TIME in structure.options)
        candidates: list[Candidate] = []
        values: dict[str, float] = {}
        for spec in dict.fromkeys((baseline_spec, incumbent.spec.with_structure(structure))):
            extended = spec != baseline_spec
            name = f"{structure.name}, {incumbent.name}" if extended else structure.name
            batch = self.coarse.with_dead_zone(incumbent.dead_zone) if extended else self.coarse
            objective, names = Objective.of(batch, spec), [parameter.name for parameter in spec.parameters]
            try:
                if not extended:
                    fit = self.search_fit(spec, part="external", checkpoint=f"plain {name}")
                    values = dict(zip(names, fit.values.tolist(), strict=True))
                start = _positions_of(objective, names, {**incumbent.named_values, **values})
                evaluation = self.fitted(f"form {name}", objective, range(len(names)), [start])
            except FitError:
                continue
            candidates.append(evaluation.candidate(name, spec, objective, range(len(names))))
            self.report("external", candidates[-1], 1.0)
        return candidates

    def next_structure(self, incumbent: Candidate) -> list[Candidate]:
        """Return the best form so far with the structure that follows its own; none where there is none."""
        following = NEXT_STRUCTURES.get(incumbent.spec.structure.name)
        if following is None:
            return []
        structure_name, addition, addition_starts = following
        spec = incumbent.spec.with_structure(structure_named(structure_name))
        objective = Objective.of(self.coarse.with_dead_zone(incumbent.dead_zone), spec)
        names = [parameter.name for parameter in spec.parameters]
        start = _positions_of(objective, names, incumbent.named_values)
        all_starts = [with_positions(start, names, added) for added in addition_starts]
        name = f"{incumbent.name} and {addition}"
        try:
            evaluation = self.fitted(f"form {name}", objective, range(len(names)), all_starts)
        except FitError:
            return []
        candidate = evaluation.candidate(name, spec, objective, range(len(names)))
        self.report("candidates", candidate, 1.0)
        return [candidate]

    def fitted(
        self, name: str, objective: Objective, free: Sequence[int], starts: Sequence[np.ndarray]
    ) -> Evaluation:
        work = partial(fit_and_evaluate, objective, free, starts, self.folds)
        return self.checkpoints.cached(name, Evaluation, work, evaluation_shapes(objective, self.folds))

    def report(self, part: str, candidate: Candidate, fraction: float) -> None:
        """Report a form that was tried."""
        figures = {f"RMSE on levels held out / {self.units['x']}": candidate.held_out_rmse}
        stage = f"trying the form {candidate.name}"
        self.parts[part](ProgressUpdate(stage, fraction, candidate.name, figures))

    def _with_smaller_dead_zone(
        self, objective: Objective, evaluation: Evaluation, free: Sequence[int]
    ) -> tuple[Objective, Evaluation]:
        """Return a form with a valve curve behind a smaller dead zone where that is better on held-out tests.

        A dead zone found from tests assumes a valve that is linear beyond it: one that opens slowly seems to
        open late. Its curve compensates a dead zone that is too small, not one that is too large: where half
        of it is no better, nothing else is tried.
        """
        names = [parameter.name for parameter in objective.spec.parameters]
        initial_dead_zone, best = float(objective.batch.dead_zone[0]), (objective, evaluation)
        for share in DEAD_ZONE_SHARES:
            batch = objective.batch.with_dead_zone(share * initial_dead_zone)
            other_objective = Objective.of(batch, objective.spec)
            start = other_objective.position(objective.values(evaluation.positions))
            all_starts = [start, *(with_positions(start, names, curve) for curve in CURVE_STARTS)]
            try:
                other = self.fitted(f"form behind {share:g}", other_objective, free, all_starts)
            except FitError:
                continue
            # No division by the number of shares: the others are tried only if the first is better.
            if better_on_held_out_tests(other.held_out, best[1].held_out):
                best = other_objective, other
            elif best[0] is objective:
                break
        return best


def _positions_of(objective: Objective, names: Sequence[str], values: Mapping[str, float]) -> np.ndarray:
    """Return the positions of values by name, neutral ones where there is none."""
    neutral = objective.values(np.array([NEUTRAL_POSITIONS.get(name, MIDDLE) for name in names]))
    merged = [values.get(name, float(value)) for name, value in zip(names, neutral, strict=True)]
    return objective.position(np.array(merged))
