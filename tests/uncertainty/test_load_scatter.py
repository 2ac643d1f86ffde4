"""The scatter of the load is that of closed forms where there are any, and that which was simulated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import handmade
from hitchid.errors import FitError
from hitchid.estimation import Objective
from hitchid.logs.record import LIFTING
from hitchid.model import Estimates, Uncertainty
from hitchid.structures import ModelSpec, structure_named
from hitchid.uncertainty.load_scatter import Contrasts, load_scatter, scatter_of
from truth import held, levels

INTEGRATOR = ModelSpec(structure_named("integrator"))
SAMPLES, GAIN, NOISE = 250, 40.0, 0.02  # mm/s, mm
NAMES = [f"test {number}" for number in range(8)]


@pytest.fixture
def found_in(batch_of):
    """Return a function that gives the scatter in tests of an integrator with factors on its speed."""

    def find(factors, *, names=NAMES, seeds=range(8), shared=True, free=True):
        tests = []
        for number, (factor, seed) in enumerate(zip(factors, seeds, strict=False)):
            rng = np.random.default_rng(seed)
            command = levels(np.random.default_rng(0 if shared else number), SAMPLES, low=0.2)
            travel = factor * GAIN * held([1.0], [1.0, 0.0], command)
            tests.append((command, travel + NOISE * rng.standard_normal(SAMPLES)))
        objective = Objective.of(batch_of(tests), INTEGRATOR)
        return load_scatter(objective, objective.position(np.array([GAIN])), np.array([free]), names)

    return find


def balanced(loads, error):
    """Return the contrasts of tests that tell their load with one error, the mean being a parameter."""
    count = len(loads)
    centre = np.eye(count) - 1 / count
    directions = np.linalg.svd(centre)[0][:, : count - 1]
    return Contrasts(directions.T @ loads / error, np.full(count - 1, 1 / error), directions)


@pytest.mark.parametrize("error", [1e-4, 0.01])
def test_a_balanced_design_has_the_textbooks_scatter(error):
    loads = np.random.default_rng(2).normal(0.0, 0.04, 8)
    result = scatter_of(balanced(loads, error), NAMES)
    variance, degrees = np.var(loads, ddof=1), 7
    assert result.scatter == pytest.approx(np.sqrt(variance - error**2), rel=1e-5)
    quantiles = stats.chi2.ppf([0.975, 0.025], degrees)
    assert result.interval == pytest.approx(np.sqrt(degrees * variance / quantiles - error**2), rel=1e-6)
    kept = result.scatter**2 / (result.scatter**2 + error**2)
    own = np.array([test.speed for test in result.tests])
    assert own == pytest.approx(kept * (loads - loads.mean()), rel=1e-4)
    assert result.shrinkage == pytest.approx(1 - np.sqrt(kept), abs=1e-5)


def test_the_interval_holds_the_scatter_in_95_percent():
    rng, campaigns, scatter = np.random.default_rng(3), 2000, 0.015
    sensitivities, directions = 1 / np.array([0.002, 0.01, 0.02, 0.02, 0.04]), np.eye(5)
    held_truth = 0
    for values in rng.standard_normal((campaigns, 5)) * np.sqrt(1 + (scatter * sensitivities) ** 2):
        lower, upper = scatter_of(Contrasts(values, sensitivities, directions), NAMES[:5]).interval
        held_truth += lower <= scatter and (upper is None or scatter <= upper)
    # Four standard errors of a share of 95 %.
    assert held_truth / campaigns == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / campaigns))


def test_a_test_that_runs_4_percent_fast_is_named(found_in):
    result = found_in([1.04, *[1.0] * 7])
    # The model's speed is that of all tests: the test is fast by 4 % less its share of their mean.
    assert result.tests[0].test == "test 0"
    assert result.tests[0].speed == pytest.approx(0.04 * 7 / 8, abs=1e-3)
    assert result.scatter == pytest.approx(0.04 / np.sqrt(8), rel=0.02)
    assert result.determined
    assert "± 1.4 %" in result.sentence


@pytest.mark.parametrize(("factor", "shared"), [(1.0, True), (1.05, False)])
def test_without_scatter_the_interval_begins_at_zero(found_in, factor, shared):
    result = found_in([factor] * 8, shared=shared)
    assert result.interval[0] == 0.0
    assert not result.determined
    assert "not determined" in result.sentence
    assert result.scatter < 1e-3  # noise of 0.02 mm in some 100 mm of travel


def test_the_order_of_the_tests_makes_no_difference(found_in):
    factors, order = np.array([1.02, 0.97, 1.0, 1.05, 0.99, 1.01, 0.96, 1.0]), np.random.default_rng(4)
    shuffled = order.permutation(8)
    names = [NAMES[number] for number in shuffled]
    result, other = found_in(factors), found_in(factors[shuffled], names=names, seeds=shuffled)
    # The search for the errors' covariance ends a little elsewhere; the scatter hardly depends on it.
    assert other.scatter == pytest.approx(result.scatter, rel=1e-4)
    speeds = {test.test: test.speed for test in other.tests}
    assert [test.speed for test in result.tests] == pytest.approx([speeds[n] for n in NAMES], abs=1e-5)


def test_a_model_tells_its_scatter():
    result = scatter_of(balanced(np.random.default_rng(2).normal(0.0, 0.04, 8), 0.01), NAMES)
    whole = Uncertainty(Estimates((), (), (), 8, 8), load_scatter=result)
    summary = repr(replace(handmade.hitch(), uncertainty={LIFTING: whole}))
    assert f"load: {result.sentence}" in " ".join(summary.split())


def test_no_test_runs_backward_by_its_load():
    # Speeds of 0.9 and −0.9 are far above the errors: the intervals end where the piston stands.
    wide = scatter_of(balanced(np.array([-0.9, 0.9, 0.0]), 0.2), NAMES[:3])
    assert min(test.interval[0] for test in wide.tests) == -1.0
    assert [test.determined for test in wide.tests] == [test.interval[0] > -1.0 for test in wide.tests]
    with pytest.raises(FitError, match=f"{NAMES[0]}: the speed would differ"):
        scatter_of(balanced(np.array([-2.2, 2.6, 0.0]), 0.01), NAMES[:3])


def test_of_two_tests_or_without_estimates_there_is_no_scatter(found_in):
    with pytest.raises(FitError, match="1 differences"):
        found_in([1.0, 1.1], names=NAMES[:2])
    with pytest.raises(FitError, match="no parameter of the form was estimated"):
        found_in([1.0] * 8, free=False)
