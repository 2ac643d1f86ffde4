"""The polynomial NARX against a recursion written out by hand, and against sysidentpy's own predictions."""

import sys
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.baselines import narx as fitting
from hitchid.baselines.baseline import FitContext
from hitchid.baselines.narx import Narx, NarxBaseline
from hitchid.estimation.training import AdamConfig
from hitchid.structures import Batch

# w(k) = 1.2 w(k−1) − 0.3 w(k−2) + 0.5 u(k−1) + 0.1 u(k−2)² − 0.05 w(k−1) u(k−2)
TRUTH = {(1, 0): 1.2, (2, 0): -0.3, (-1, 0): 0.5, (-2, -2): 0.1, (-2, 1): -0.05}
SAMPLES = 200
# Rows at rest, where u(k−1) is exactly zero, come first.
REST = 7


def fitted(training, validation):
    """Return the fit, which uses no setting of a training."""
    return NarxBaseline().fit(training, validation, FitContext(1, AdamConfig(), jax.random.key(0)))


def recursion(command):
    """Return the travel of the truth from rest, shape [N]."""
    w, u = np.zeros(command.size + 2), np.concatenate([np.zeros(2), command])
    for k in range(2, w.size):
        w[k] = 1.2 * w[k - 1] - 0.3 * w[k - 2] + 0.5 * u[k - 1] + 0.1 * u[k - 2] ** 2
        w[k] -= 0.05 * w[k - 1] * u[k - 2]
    return w[2:]


@pytest.fixture
def truth():
    scales = np.array(2.0), np.array(0.5)
    powers = [(2.0 ** sum(f > 0 for f in fs), 0.5 ** sum(f < 0 for f in fs)) for fs in TRUTH]
    coefficients = [c * w * u / 2.0 for c, (w, u) in zip(TRUTH.values(), powers, strict=True)]
    return Narx(np.array(list(TRUTH)), np.array(coefficients), *scales)


@pytest.fixture
def commands():
    rng = np.random.default_rng(0)
    return [
        np.concatenate([np.zeros(REST), rng.uniform(0, 1, size - REST)]) for size in (SAMPLES, 120, 150, 90)
    ]


def batch(commands, travels, *, until=None):
    """Return tests side by side that count up to a sample, falling from 40."""
    width = max(command.size for command in commands)

    def stack(rows):
        return jnp.asarray(np.array([np.pad(row, (0, width - row.size)) for row in rows]))

    counted = [np.arange(command.size) < (until or command.size) for command in commands]
    return Batch(
        command=stack(commands),
        raw_command=stack(commands),
        dead_zone=jnp.zeros(len(commands)),
        displacement=stack([40.0 - travel for travel in travels]),
        valid=stack([np.ones(command.size, dtype=bool) for command in commands]),
        loss_mask=stack(counted),
        initial=jnp.full(len(commands), 40.0),
        covariate=jnp.zeros(len(commands)),
        step_s=0.01,
        sign=-1,
    )


def unscaled(model):
    """Return factors to coefficient of travel and command as they were measured."""
    found = {}
    for factors, coefficient in zip(model.terms.tolist(), model.coefficients, strict=True):
        scale = np.prod(
            [model.travel_scale if f > 0 else model.command_scale if f < 0 else 1 for f in factors]
        )
        found[frozenset((f, factors.count(f)) for f in factors if f)] = (
            coefficient * model.travel_scale / scale
        )
    return found


def assert_is_the_truth(model, tolerance):
    found = unscaled(model)
    for factors, coefficient in TRUTH.items():
        named = frozenset((f, factors.count(f)) for f in factors if f)
        assert found.pop(named) == pytest.approx(coefficient, abs=tolerance)
    np.testing.assert_allclose(list(found.values()), 0.0, atol=tolerance)


def test_free_run_is_the_recursion(truth, commands):
    assert truth.lag == 2
    for command in commands:
        # A stable recursion adds at most ten rounded products a step.
        np.testing.assert_allclose(truth.simulate(command), recursion(command), atol=1e-12)


def test_one_step_uses_what_was_measured_up_to_the_sample_before(truth, commands):
    command = commands[0]
    measured = recursion(command) + np.random.default_rng(1).normal(size=command.size)
    found = truth.one_step(command, measured)
    assert found[0] == 0.0
    assert found[1] == pytest.approx(1.2 * measured[0] + 0.5 * command[0], abs=1e-13)
    for k in (2, 50, SAMPLES - 1):
        (before, last), (w2, w1) = command[k - 2 : k], measured[k - 2 : k]
        expected = 1.2 * w1 - 0.3 * w2 + 0.5 * last + 0.1 * before**2 - 0.05 * w1 * before
        assert found[k] == pytest.approx(expected, abs=1e-13)


def test_a_run_resumed_from_its_own_past_goes_on_as_it_would_have(truth, commands):
    whole = truth.simulate(commands[0])
    for past in (2, 5):
        rest = truth.simulate_from(commands[0][60 - past :], whole[60 - past : 60])
        np.testing.assert_allclose(rest, whole[60:], atol=1e-13)


def test_a_constant_alone_and_no_term_at_all_can_be_run(commands):
    scale = np.array(3.0)
    constant = Narx(np.array([[0, 0]]), np.array([0.5]), scale, scale)
    empty = Narx(np.zeros((0, 2), dtype=int), np.zeros(0), scale, scale)
    for model, value in ((constant, 1.5), (empty, 0.0)):
        for found in (model.simulate(commands[0]), model.one_step(commands[0], commands[0])):
            np.testing.assert_array_equal(found, np.full(SAMPLES, value))


def test_what_diverges_is_not_finite_and_warns_of_nothing(commands):
    one = np.array(1.0)
    model = Narx(np.array([[1, 1], [-1, 0], [1, 0]]), np.array([3.0, 5.0, -1.0]), one, one)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = model.simulate(commands[0])
    assert found.shape == (SAMPLES,)
    assert not np.isfinite(found[-1])


def test_without_sysidentpy_there_is_no_model(monkeypatch, commands):
    monkeypatch.setitem(sys.modules, "sysidentpy.model_structure_selection", None)
    tests = batch(commands, [recursion(command) for command in commands])
    assert fitted(tests, tests) is None


@pytest.fixture
def selection():
    return pytest.importorskip("sysidentpy.model_structure_selection")


def method(selection, lags, **options):
    """Return sysidentpy's method for products of up to two factors."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.parameter_estimation import LeastSquares

    basis = Polynomial(degree=2)
    return selection.FROLS(xlag=lags, ylag=lags, basis_function=basis, estimator=LeastSquares(), **options)


def test_predictions_are_those_of_sysidentpy(selection, commands):
    rng = np.random.default_rng(2)
    command, other = commands[0][REST:], commands[1]
    noisy = recursion(command) + 0.01 * rng.normal(size=command.size)
    theirs = method(selection, 3, order_selection=False, n_terms=8).fit(X=command[:, None], y=noisy[:, None])
    one = np.array(1.0)
    ours = Narx(fitting._terms(theirs.final_model), np.ravel(theirs.theta), one, one)
    # They leave out the first samples, as many as there are lags: here, rest.
    measured = recursion(other) + 0.01 * rng.normal(size=other.size)
    u, w = (np.pad(samples, (3, 0))[:, None] for samples in (other, measured))
    one_step, free_run = theirs.predict(X=u, y=w, steps_ahead=1), theirs.predict(X=u, y=w)
    np.testing.assert_allclose(ours.one_step(other, measured), one_step[3:, 0], atol=1e-9)
    np.testing.assert_allclose(ours.simulate(other), free_run[3:, 0], atol=1e-9)


def test_the_truth_is_found_again_from_several_tests_without_noise(selection, commands):
    # A row that straddled two tests would miss by the travel at the end of one: 0.3 and more.
    travels = [recursion(command) for command in commands]
    model = fitted(batch(commands[:3], travels[:3]), batch(commands[3:], travels[3:]))
    assert_is_the_truth(model, 1e-8)
    np.testing.assert_allclose(model.simulate(commands[3]), travels[3], atol=1e-8)


def test_it_is_not_fitted_to_samples_that_do_not_count(selection, commands):
    travels = [recursion(command) for command in commands]
    spoilt = [np.where(np.arange(travel.size) < 80, travel, 5.0) for travel in travels]
    model = fitted(batch(commands[:3], spoilt[:3], until=80), batch(commands[3:], spoilt[3:], until=80))
    assert_is_the_truth(model, 1e-8)


def test_where_no_sample_counts_nothing_is_fitted_or_compared(selection, commands):
    travels = [recursion(command) for command in commands]
    some, none = batch(commands, travels), batch(commands, travels, until=-1)
    assert fitted(none, some) is None
    assert fitted(some, none) is not None


def test_error_reduction_ratios_add_up_to_what_least_squares_explains(selection, commands):
    rng = np.random.default_rng(3)
    travels = [recursion(command) + 0.01 * rng.normal(size=command.size) for command in commands]
    frols, one = method(selection, 2), np.array(1.0)
    parts = fitting._segments(batch(commands, travels), longest=None)
    rows, target = fitting._regression(parts, 2, (one, one), frols)
    ratios, order, _ = frols.error_reduction_ratio(rows, np.pad(target, (2, 0))[:, None], 8)
    for size in range(1, 9):
        chosen = rows[:, order[:size]]
        left = target - chosen @ np.linalg.lstsq(chosen, target, rcond=None)[0]
        explained = 1 - (left @ left) / (target @ target)
        assert np.sum(ratios[:size]) == pytest.approx(explained, abs=1e-12)


def test_every_test_has_its_own_rows_from_rest(selection, commands):
    tests = batch(commands, [recursion(command) for command in commands])
    parts, scales = fitting._segments(tests, longest=None), (np.array(2.0), np.array(0.5))
    rows, target = fitting._regression(parts, 2, scales, method(selection, 2))
    expected = []
    for command, travel in zip(commands, np.asarray(tests.travel), strict=True):
        w, u = np.pad(travel[: command.size] / 2.0, (2, 0)), np.pad(command / 0.5, (2, 0))
        expected += [(w[k], w[k - 1], w[k - 2], u[k - 1], u[k - 2]) for k in range(2, w.size)]
    # The first six candidates are 1·1, 1·w(k−1), 1·w(k−2), 1·u(k−1), 1·u(k−2), w(k−1)².
    found = np.column_stack([target, rows[:, 1:5]])
    np.testing.assert_array_equal(sorted(map(tuple, found)), sorted(expected))
    np.testing.assert_array_equal(rows[:, 5], rows[:, 1] ** 2)


def test_long_validation_tests_are_cut_into_sections_with_their_past(commands):
    travel = recursion(commands[0])
    deep = fitting.LAGS[-1]
    parts = fitting._segments(batch(commands[:1], [travel]), longest=90)
    assert [part.loss_mask.size for part in parts] == [90, 90, 20]
    for first, part in zip((0, 90, 180), parts, strict=True):
        padded = np.pad(travel, (deep, 0))
        expected = padded[first : first + part.loss_mask.size + deep]
        np.testing.assert_allclose(part.travel, expected, atol=1e-13)
        np.testing.assert_array_equal(part.command[deep:], commands[0][first : first + 90])
