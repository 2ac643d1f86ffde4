"""Several searches on one budget from several seeds, kept on disk and found again."""

from dataclasses import dataclass, field, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid._support.checkpoints import Checkpoints
from hitchid.errors import FitError
from hitchid.estimation import (
    DifferentialEvolution,
    MultiStart,
    Objective,
    Search,
    SearchComparison,
    SearchProblem,
    SearchResult,
    SearchRun,
    Whale,
)
from hitchid.estimation.search_history import SAMPLES, compare_searches, default_searches
from hitchid.logs.record import LIFTING, Record
from hitchid.structures import Batch, ModelSpec, structure_named
from truth import held, lag, levels

LAG, INTEGRATOR = structure_named("first-order-lag"), structure_named("integrator")
NOISE_MM, LENGTH, BUDGET, SEEDS = 0.3, 400, 120, 2
# Rounding of displacements of 100 mm and of sums over all samples.
ROUNDING_MM = LENGTH * np.finfo(float).eps * 100.0


def misfit_of(form=None, *, seed=0, step_s=0.01, direction=1, dead_zone=0.0) -> Objective:
    """Return the misfit of a form over two noisy tests of a lag."""
    rng, records = np.random.default_rng(seed), []
    for number in range(2):
        command = levels(rng, LENGTH, low=0.2)
        travel = held(*lag(15.0, 0.7), command) + NOISE_MM * rng.standard_normal(LENGTH)
        signals = {"displacement": 80.0 + travel, "lifting_command": command}
        records.append(Record(f"{number}", step_s, signals, {"displacement": "mm", "lifting_command": "A"}))
    batch = Batch.of(records, LIFTING, dead_zone=dead_zone, sign=direction)
    return Objective.of(batch, form or ModelSpec(LAG))


def thinned(misfit):
    """Return the misfit that searches work on, and what gives its fitness at values, shape [P, D]."""
    thin = misfit.with_data(misfit.batch.decimate(SAMPLES))

    def fitness(values):
        positions = jnp.asarray([thin.position(np.array(each)) for each in values])
        return np.asarray(eqx.filter_jit(Objective.__call__)(thin, positions))

    return thin, fitness


@pytest.fixture(scope="module")
def trails():
    return compare_searches(misfit_of(), SearchComparison(default_searches(BUDGET), SEEDS))


@dataclass(frozen=True)
class Still(Search):
    """Looks at the centre alone, and counts how often it was asked."""

    seeds: list = field(default_factory=list, repr=False, compare=False)
    first: float = 2.0
    name: str = field(default="still", init=False)

    def minimise(self, problem: SearchProblem, seed: int, callback=None) -> SearchResult:
        self.seeds.append(seed)
        trace = np.array([self.first, 1.0])
        positions = np.full((2, problem.dimensions), 0.5)
        return SearchResult(positions[1], 1.0, 2, 0, "looked", trace, positions)


@dataclass(frozen=True)
class Failing(Search):
    """Fails from even seeds."""

    name: str = field(default="failing", init=False)

    def minimise(self, problem: SearchProblem, seed: int, callback=None) -> SearchResult:
        if seed % 2 == 0:
            raise FitError(f"nothing finite from seed {seed}")
        return Still(first=np.inf).minimise(problem, seed)


def kept(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_every_search_spends_the_one_budget(trails):
    assert [trail.name for trail in trails] == ["whale", "differential-evolution", "multi-start"]
    assert {len(trail.runs) for trail in trails} == {SEEDS}
    whales, evolution, starts = (trail.runs for trail in trails)
    # 30 whales, and three members for each of two parameters: 120 evaluations are 4 and 20 generations.
    for runs, generations in ((whales, 4), (evolution, 20)):
        assert {len(run.fitness) for run in runs} == {generations}
        assert {run.evaluations for run in runs} == {BUDGET}
    # The last start is made while one evaluation is left, and costs 2 + D at least: 1 + D too many at most.
    assert all(BUDGET <= run.evaluations <= BUDGET + 3 for run in starts)
    assert all(len(run.values) == len(run.fitness) for trail in trails for run in trail.runs)
    for trail in trails:
        assert all(np.all(np.diff(run.fitness) <= 0) for run in trail.runs)
        assert list(trail.final_fitnesses) == [run.fitness[-1] for run in trail.runs]


def test_values_are_those_that_gave_the_fitness(trails):
    misfit = misfit_of()
    thin, fitness = thinned(misfit)
    assert thin.batch.command.shape[1] < misfit.batch.command.shape[1]
    runs = [run for trail in trails for run in trail.runs]
    found = fitness([values for run in runs for values in run.values])
    said = np.concatenate([run.fitness for run in runs])
    np.testing.assert_allclose(found, said, rtol=0, atol=ROUNDING_MM)


def test_each_seed_gives_its_own_run(trails):
    comparison = SearchComparison(default_searches(BUDGET), SEEDS)
    assert compare_searches(misfit_of(), comparison) == trails
    later = compare_searches(misfit_of(), comparison, first_seed=1)
    for one, other in zip(trails, later, strict=True):
        assert one.runs[1] == other.runs[0]
        assert one.runs[0].values != one.runs[1].values


def test_a_run_from_disk_is_not_run_again(trails, tmp_path, monkeypatch):
    comparison = SearchComparison(default_searches(BUDGET), SEEDS, Checkpoints(tmp_path / "runs"))
    assert compare_searches(misfit_of(), comparison) == trails
    assert len(kept(tmp_path / "runs")) == 3 * SEEDS

    def refuse(*_):
        raise AssertionError("run again")

    for search in (Whale, DifferentialEvolution, MultiStart):
        monkeypatch.setattr(search, "minimise", refuse)
    assert compare_searches(misfit_of(), comparison) == trails
    with pytest.raises(AssertionError, match="run again"):
        compare_searches(misfit_of(), replace(comparison, seeds=SEEDS + 1))


@pytest.mark.parametrize(
    "other",
    [
        {"seed": 1},
        {"dead_zone": 0.1},
        {"form": ModelSpec(INTEGRATOR)},
        {"form": ModelSpec(LAG, bounds={"time_constant": (0.1, 5.0)})},
        {"step_s": 0.02},
        {"direction": -1},
    ],
    ids=lambda settings: ", ".join(settings),
)
def test_other_data_or_another_form_never_meets_the_same_file(tmp_path, other):
    search = Still()
    comparison = SearchComparison((search,), SEEDS, Checkpoints(tmp_path))
    compare_searches(misfit_of(), comparison)
    compare_searches(misfit_of(**other), comparison)
    assert search.seeds == [0, 1, 0, 1]
    assert len(kept(tmp_path)) == 2 * SEEDS


def test_another_sample_or_search_never_meets_the_same_file(tmp_path):
    misfit = misfit_of()
    nearby = eqx.tree_at(
        lambda m: m.batch.displacement, misfit, misfit.batch.displacement.at[0, 100].add(1e-9)
    )
    for each, search in ((misfit, Still()), (nearby, Still()), (misfit, Still(first=3.0))):
        compare_searches(each, SearchComparison((search,), SEEDS, Checkpoints(tmp_path)))
        assert search.seeds == [0, 1]


def test_a_search_that_fails_is_a_run_without_fitness(tmp_path):
    comparison = SearchComparison((Failing(),), 3, Checkpoints(tmp_path))
    for _ in range(2):
        (trail,) = compare_searches(misfit_of(), comparison)
        assert [run.final_fitness for run in trail.runs] == [None, 1.0, None]
        assert list(trail.final_fitnesses) == [np.inf, 1.0, np.inf]
        assert trail.runs[2] == SearchRun((), (), 0, 0, "nothing finite from seed 2")
        # Steps before anything was finite have no fitness.
        assert trail.runs[1].fitness == (None, 1.0)
