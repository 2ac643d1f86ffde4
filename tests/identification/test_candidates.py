"""A larger candidate is taken where held-out tests show it to be better, and the choice is judged outside."""

import numpy as np
import pytest

from hitchid.identification.candidates import (
    Candidate,
    best_candidate,
    held_out_errors_of_choice,
    is_missed,
)
from hitchid.structures import ModelSpec, structure_named

SPEC = ModelSpec(structure_named("integrator"))
FOLD = np.arange(12) % 4


def candidate(held_out, per_test_gain=None, *, rmse=(1.0, 1.0), spec=SPEC, name="a form", base=""):
    held_out = np.asarray(held_out)
    per_test_gain = held_out if per_test_gain is None else np.asarray(per_test_gain)
    return Candidate(
        name=name,
        spec=spec,
        values=np.ones(len(spec.parameters)),
        rmse=rmse[0],
        rmse_per_test_gain=rmse[1],
        observations=np.array([100.0, 100.0]),
        dead_zone=0.0,
        held_out=held_out,
        held_out_per_test_gain=per_test_gain,
        fold=FOLD[: held_out.size],
        base=base,
    )


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


LARGER = ModelSpec(structure_named("integrator"), dead_time=True)


@pytest.mark.parametrize(
    ("rmse", "held_out", "missed"),
    [
        # N ln(J²/J₀²) of 100 independent errors is 3.84, the 95 % quantile of χ² of one parameter, at 1.0194.
        ((1.019, 1.019), 1.0, False),
        ((1.020, 1.0), 1.0, True),
        ((1.0, 1.020), 1.0, True),
        ((1.01, 1.01), 1.09, False),
        ((1.01, 1.01), 1.11, True),
        ((1.001, 1.001), 2.0, False),
    ],
    ids=["as good", "fit", "with a gain per test", "a tenth", "more than a tenth", "the same form"],
)
def test_what_fit_or_held_out_tests_miss_stays(scatter, rmse, held_out, missed):
    factors = np.exp(10 * (np.log(scatter) - np.log(scatter).mean()))  # a scatter in which 11 % are nothing
    level = factors / np.sqrt(np.mean(factors**2))
    larger = candidate(np.ones(12), spec=LARGER)
    smaller = candidate(held_out * level, rmse=rmse)
    assert is_missed(smaller, [larger]) == missed


@pytest.mark.parametrize(
    ("rmse", "held_out", "taken"),
    [(0.8, 0.88, True), (0.8, 0.93, False), (0.98, 0.88, False)],
    ids=["proved", "less than a tenth", "not proved"],
)
def test_what_all_samples_prove_is_taken_though_few_tests_do_not(rmse, held_out, taken):
    # One test is worse than the others by far, and alone gains: Student's t over the tests says nothing.
    errors, larger_errors = np.ones(12), np.exp(0.1 * np.where(np.arange(12) % 2, 1, -1))
    errors[0] = 5.0
    larger_errors[0] = np.sqrt(held_out**2 * np.sum(errors**2) - np.sum(larger_errors[1:] ** 2))
    larger = candidate(larger_errors, rmse=(rmse, 1.0), spec=LARGER)
    assert best_candidate([candidate(errors), larger]) == int(taken)


def test_a_loss_on_every_held_out_test_counts_from_two_percent(scatter):
    larger = candidate(np.ones(12), spec=LARGER)
    noise = 1 + 0.01 * (scatter - scatter.mean())
    assert is_missed(candidate(1.03 * noise, rmse=(1.01, 1.01)), [larger])
    assert not is_missed(candidate(1.01 * noise, rmse=(1.01, 1.01)), [larger])


def test_each_form_is_part_of_the_one_before_it():
    grown = candidate(0.5 * np.ones(12), name="grown", spec=LARGER)
    less = candidate(0.5 * np.ones(12), name="less", base="grown")
    stranger = candidate(0.5 * np.ones(12), name="stranger", base="another")
    assert best_candidate([candidate(np.ones(12)), grown, less]) == 2
    assert best_candidate([candidate(np.ones(12)), grown, stranger]) == 1
    # What was not taken has no parts.
    assert best_candidate([candidate(np.ones(12)), candidate(np.ones(12), name="grown"), less]) == 0
