"""The polynomial NARX against a recursion written out by hand, and against sysidentpy's own regression."""

import warnings

import numpy as np
import pytest
from plants import batch_of, context

from hitchid.baselines.linear import LinearInputs
from hitchid.baselines.narx import (
    Narx,
    NarxBaseline,
    candidate_terms,
    narx_inputs,
    order_of_terms,
    polynomial_run,
    sections_of,
)

# w(k) = 1.2 w(k−1) − 0.3 w(k−2) + 0.5 u(k−1) + 0.1 u(k−2)² − 0.05 w(k−1) u(k−2)
TRUTH = {(1, 0): 1.2, (2, 0): -0.3, (-1, 0): 0.5, (-2, -2): 0.1, (-2, 1): -0.05}
SAMPLES = 200
REST = 7
SCALING = LinearInputs(*map(np.asarray, ([0.0], [1.0], 0.0, 1.0)))


def recursion(command, load=0.0):
    """Return the travel of the truth from rest, shape [N]; the load adds to the gain of the command."""
    w, u = np.zeros(command.size + 2), np.concatenate([np.zeros(2), command])
    for k in range(2, w.size):
        w[k] = 1.2 * w[k - 1] - 0.3 * w[k - 2] + (0.5 + load) * u[k - 1] + 0.1 * u[k - 2] ** 2
        w[k] -= 0.05 * w[k - 1] * u[k - 2]
    return w[2:]


@pytest.fixture
def truth():
    scales = np.array(2.0), np.array(0.5)
    powers = [(2.0 ** sum(f > 0 for f in fs), 0.5 ** sum(f < 0 for f in fs)) for fs in TRUTH]
    coefficients = [c * w * u / 2.0 for c, (w, u) in zip(TRUTH.values(), powers, strict=True)]
    return Narx(SCALING, np.array(list(TRUTH)), np.array(coefficients), *scales)


@pytest.fixture
def commands():
    rng = np.random.default_rng(0)
    return [
        np.concatenate([np.zeros(REST), rng.uniform(0, 1, size - REST)]) for size in (SAMPLES, 120, 150, 90)
    ]


def all_sections(batch, scales, longest=1000):
    inputs = narx_inputs(batch, SCALING, np.asarray(scales[1]))
    travel = np.asarray(batch.travel) / scales[0]
    return sections_of(batch, inputs, travel, past=8, longest=longest, most=100_000)


def test_free_run_is_the_recursion(truth, commands):
    assert truth.lag == 2
    batch = batch_of(commands, [recursion(command) for command in commands], start=40.0, sign=-1)
    valid = np.asarray(batch.valid)
    # A stable recursion adds at most ten rounded products a step.
    np.testing.assert_allclose(
        truth.free_run(batch)[valid], np.asarray(batch.displacement)[valid], atol=1e-12
    )
    alone = truth.simulate(truth.inputs(batch)[1])
    np.testing.assert_allclose(alone[: commands[1].size], recursion(commands[1]), atol=1e-12)


def test_a_constant_or_no_term_can_be_run(commands):
    scale, batch = np.array(3.0), batch_of(commands, commands)
    constant = Narx(SCALING, np.array([[0, 0]]), np.array([0.5]), scale, scale)
    empty = Narx(SCALING, np.zeros((0, 2), dtype=int), np.zeros(0), scale, scale)
    for model, value in ((constant, 1.5), (empty, 0.0)):
        np.testing.assert_array_equal(model.free_run(batch), np.full(batch.command.shape, value))


def test_what_diverges_is_not_finite_and_warns_of_nothing(commands):
    one = np.array(1.0)
    model = Narx(SCALING, np.array([[1, 1], [-1, 0], [1, 0]]), np.array([3.0, 5.0, -1.0]), one, one)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        computed = model.free_run(batch_of(commands, commands))
    assert not np.isfinite(computed[0, -1])


def test_the_derivative_of_a_free_run_is_that_of_differences(truth, commands):
    sections = all_sections(batch_of(commands, [recursion(c) for c in commands]), (2.0, 0.5), longest=60)
    travel, derivative = polynomial_run(truth.terms, truth.coefficients, sections, 8, derivative=True)
    step = 1e-6
    for number in range(len(TRUTH)):
        moved = truth.coefficients + step * (np.arange(len(TRUTH)) == number)
        other, _ = polynomial_run(truth.terms, moved, sections, 8)
        # Differences of first order: an error of the second derivative, of order 100, times the step.
        np.testing.assert_allclose((other - travel) / step, derivative[..., number], atol=1e-3, rtol=1e-3)


def test_the_truth_is_found_again_from_samples_that_count(commands):
    travels = [recursion(command) for command in commands]
    spoilt = [np.where(np.arange(travel.size) < 80, travel, 5.0) for travel in travels]
    model = NarxBaseline().fit(batch_of(commands, spoilt, until=80), context())
    unseen = np.concatenate([np.zeros(REST), np.random.default_rng(9).uniform(0, 1, 100)])
    batch = batch_of([unseen], [recursion(unseen)])
    np.testing.assert_allclose(model.free_run(batch)[0], recursion(unseen), atol=1e-6)
    assert NarxBaseline().fit(batch_of(commands, commands, until=-1), context()) is None


def test_refinement_on_free_runs_beats_least_squares(commands):
    rng = np.random.default_rng(5)
    travels = [recursion(command) for command in commands]
    noisy = batch_of(commands, [travel + 0.1 * rng.normal(size=travel.size) for travel in travels])
    model = NarxBaseline().fit(noisy, context())
    terms, scales = model.terms, (model.travel_scale, model.command_scale)
    rows, target = all_sections(noisy, scales).regression(terms)
    one_step = Narx(SCALING, terms, np.linalg.lstsq(rows, target, rcond=None)[0], *scales)
    batch = batch_of(commands, travels)
    valid = np.asarray(batch.valid)
    errors = [
        np.sqrt(np.mean((m.free_run(batch) - np.asarray(batch.displacement))[valid] ** 2))
        for m in (model, one_step)
    ]
    assert errors[0] < errors[1]


def test_the_load_is_heard(commands):
    loads = np.array([-0.2, 0.1, 0.2, 0.0])
    travels = [recursion(command, load) for command, load in zip(commands, loads, strict=True)]
    model = NarxBaseline().fit(batch_of(commands, travels, loads=loads), context())
    batch = batch_of(commands[:1], [recursion(commands[0], 0.15)], loads=[0.15])
    np.testing.assert_allclose(model.free_run(batch), np.asarray(batch.displacement), atol=1e-6)


def test_sections_have_their_measured_past(commands):
    travel = recursion(commands[0])
    sections = all_sections(batch_of(commands[:1], [travel]), (1.0, 1.0), longest=90)
    assert sections.mask.sum(axis=1).tolist() == [90, 90, 20]
    np.testing.assert_allclose(sections.past[1], travel[82:90], atol=1e-13)
    np.testing.assert_array_equal(sections.command[1, 8:], commands[0][90:180])


def test_the_order_of_terms_is_that_of_sysidentpy(commands):
    selection = pytest.importorskip("sysidentpy.model_structure_selection")
    from sysidentpy.basis_function import Polynomial

    rng = np.random.default_rng(3)
    travels = [recursion(command) + 0.01 * rng.normal(size=command.size) for command in commands]
    terms = candidate_terms(2, np.zeros((4, 2)))
    rows, target = all_sections(batch_of(commands, travels), (1.0, 1.0)).regression(terms)
    # Their Householder reflections fail where a column begins with exactly zero.
    rank = np.argsort(-np.abs(rows).min(axis=1), kind="stable")
    rows, target = rows[rank], target[rank]
    frols = selection.FROLS(xlag=2, ylag=2, basis_function=Polynomial(degree=2))
    _, order, _ = frols.error_reduction_ratio(rows, np.pad(target, (2, 0))[:, None], 6)
    assert order_of_terms(rows, target, 6) == list(order)
