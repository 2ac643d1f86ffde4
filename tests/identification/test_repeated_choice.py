"""A choice is repeated from tests that differ a little, and says what came of it."""

import numpy as np
import pytest

from hitchid.errors import FitError
from hitchid.identification import AutoStructure, read_settings
from hitchid.identification.candidates import Candidate
from hitchid.identification.repeated_choice import repeat_choice
from hitchid.structures import Batch, ModelSpec, structure_named
from hitchid.uncertainty import DeadZoneError
from truth import levels

FORM = ModelSpec(structure_named("integrator-first-order"), dead_time=True)
OTHER = ModelSpec(structure_named("integrator"))


def candidate(spec, error):
    errors = np.full(4, error)
    return Candidate(
        "a form", spec, np.ones(1), 1.0, 1.0, np.ones(2), 0.0, errors, errors, np.arange(4), True
    )


@pytest.fixture
def batch(make_record):
    """Return four tests with a sensor noise of 0.1 mm, behind a dead zone of 0.3 A."""
    rng = np.random.default_rng(0)
    records = [
        make_record(80.0 + np.linspace(0, 10, 300) + 0.1 * rng.standard_normal(300), 0.3 + levels(rng, 300))
        for _ in range(4)
    ]
    return Batch.of(records, "lifting", dead_zone=0.3, sign=1)


def repeated(batch, choose, repeats, seed=0):
    return repeat_choice(batch, choose, repeats, dead_zone=DeadZoneError(0.01, 3), unit="mm", seed=seed)


def test_each_repeat_lacks_another_test_and_has_its_own_noise_and_dead_zone(batch):
    seen = []

    def choose(tests):
        seen.append(tests)
        return [candidate(FORM, 0.1)]

    sentence = repeated(batch, choose, 4)
    assert sentence == (
        "the form chosen again from tests that differ a little: 4 of 4 times integrator-first-order with "
        "dead_time; RMSE on levels held out 0.1 to 0.1 mm"
    )
    zones = [float(tests.dead_zone[0]) for tests in seen]
    assert len(set(zones)) == 4
    assert max(abs(zone - 0.3) for zone in zones) < 5 * 0.01
    for tests in seen:
        assert tests.command.shape[0] == 3
        # Noise of 0.1 mm, found from 1200 samples to some percent.
        raw = np.asarray(batch.raw_command)
        rows = [int(np.flatnonzero((raw == row).all(axis=1))[0]) for row in np.asarray(tests.raw_command)]
        added = np.asarray(tests.displacement) - np.asarray(batch.displacement)[rows]
        assert added.std() == pytest.approx(0.1, rel=0.2)
    kept = [frozenset(np.asarray(tests.initial).tolist()) for tests in seen]
    assert len(set(kept)) == 4


def test_forms_that_differ_are_counted_and_a_failure_is_one(batch):
    answers = iter([FORM, OTHER, FORM, None])

    def choose(_):
        spec = next(answers)
        if spec is None:
            raise FitError("nothing moves")
        return [candidate(spec, 0.1 if spec is FORM else 0.2)]

    sentence = repeated(batch, choose, 4)
    assert "2 of 4 times integrator-first-order with dead_time; 1 of 4 times integrator wit" in sentence
    assert "; 1 of 4 times none; " in sentence
    assert sentence.endswith("0.1 to 0.2 mm")


def test_the_same_seed_repeats_the_repeats(batch):
    def zones(seed):
        seen = []
        repeated(batch, lambda tests: seen.append(float(tests.dead_zone[0])) or [], 2, seed)
        return seen

    assert zones(1) == zones(1) != zones(2)


def test_two_tests_are_too_few_to_leave_one_out(batch):
    assert "that takes 3 tests, there are 2" in repeated(batch.take([0, 1]), lambda _: [], 5)


def test_settings_ask_for_repeats_of_automatic_choices(tmp_path):
    path = tmp_path / "settings.toml"
    path.write_text('[choice]\nrepeats = 10\n[lowering]\nstructure = "integrator"\n')
    forms = read_settings(path)["structure"]
    assert isinstance(forms["lifting"], AutoStructure)
    assert forms["lifting"].repeats == 10
    assert forms["lowering"] == OTHER
