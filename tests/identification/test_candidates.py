"""A larger candidate is taken where held-out tests show it to be better, and the choice is judged outside."""

import numpy as np
import pytest

from hitchid.identification.candidates import Candidate, best_candidate, held_out_errors_of_choice
from hitchid.structures import ModelSpec, structure_named

SPEC = ModelSpec(structure_named("integrator"))
FOLD = np.arange(12) % 4


def candidate(held_out, per_test_gain=None):
    held_out = np.asarray(held_out)
    per_test_gain = held_out if per_test_gain is None else np.asarray(per_test_gain)
    return Candidate("a form", SPEC, np.ones(1), 1.0, 0.0, held_out, per_test_gain, FOLD[: held_out.size])


@pytest.fixture
def scatter():
    """Return factors of the tests' errors, of which some are above and some below one."""
    return np.exp(0.1 * np.random.default_rng(0).standard_normal(12))


def test_a_clearly_smaller_error_decides_the_choice(scatter):
    assert best_candidate([candidate(np.ones(12)), candidate(0.5 * scatter)]) == 1
    assert best_candidate([candidate(np.ones(12)), candidate(scatter / scatter.mean())]) == 0


def test_what_loads_hide_decides_unless_free_run_is_worse(scatter):
    plain = candidate(np.ones(12), np.ones(12))
    hidden = candidate(1.0 + 2.0 * (scatter - scatter.mean()), 0.5 * scatter)
    worse = candidate(1.5 * scatter, 0.5 * scatter)
    assert best_candidate([plain, hidden]) == 1
    assert best_candidate([plain, worse]) == 0
    # A gain for each of fewer than six tests decides nothing.
    few = [candidate(form.held_out[:5], form.held_out_per_test_gain[:5]) for form in (plain, hidden)]
    assert best_candidate(few) == 0


def test_among_equals_one_choice_in_ten_leaves_the_first():
    """400 choices tell a share of 10 % to 1.5 %, held to three of it."""
    rng = np.random.default_rng(1)
    choices = [
        best_candidate([candidate(*np.exp(0.3 * rng.standard_normal((2, 12)))) for _ in range(6)])
        for _ in range(400)
    ]
    assert np.mean(np.array(choices) > 0) < 0.1 + 3 * 0.015


def test_the_error_of_a_choice_comes_from_other_folds():
    plain, better = candidate(np.ones(12)), candidate(0.5 * np.ones(12))
    np.testing.assert_array_equal(held_out_errors_of_choice([plain, better]), better.held_out)
    np.testing.assert_array_equal(held_out_errors_of_choice([plain]), plain.held_out)


def test_a_choice_by_chance_has_no_smaller_error():
    """Of forms alike the chosen one's held-out error is too small; that of the choice is not."""
    rng = np.random.default_rng(3)
    chosen_errors, choice_errors = [], []
    for _ in range(300):
        candidates = [candidate(np.exp(0.5 * rng.standard_normal(12))) for _ in range(20)]
        chosen = candidates[best_candidate(candidates)]
        chosen_errors.append(np.mean(np.log(chosen.held_out)))
        choice_errors.append(np.mean(np.log(held_out_errors_of_choice(candidates))))
    # Logarithms of zero mean: the standard error of 300 choices of 12 tests each is 0.5/√3600 = 0.0083.
    assert np.mean(choice_errors) > np.mean(chosen_errors)
    assert abs(np.mean(choice_errors)) < 4 * 0.0083
