"""The fraction of the work that an identification reports follows what it has done."""

from itertools import pairwise

import pytest

import hitchid
from benches import write_bench
from hitchid.identification import AutoStructure, ModelSpec
from hitchid.structures import structure_named

LARGEST_JUMP = 0.25  # of all work, between two updates


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Return five small tests of each direction."""
    return hitchid.read(write_bench(tmp_path_factory.mktemp("progress") / "logs", tests=5, samples=250))


def recorded(campaign, **settings):
    updates = []
    hitchid.identify(campaign, **settings, progress=updates.append)
    return updates


def check(updates):
    fractions = [0.0, *(update.fraction for update in updates), 1.0]
    assert fractions == sorted(fractions)
    assert fractions[-2] <= 1.0
    assert max(later - earlier for earlier, later in pairwise(fractions)) <= LARGEST_JUMP


@pytest.mark.long
def test_the_fraction_rises_in_small_steps_without_training(campaign, quick_settings):
    updates = recorded(campaign, **{**quick_settings, "training": None})
    check(updates)
    stages = {update.stage for update in updates}
    assert updates[0].stage == "finding dead zones in the tests"
    for task in ("refining parameters", "intervals of the parameters", "speed map"):
        assert f"lifting: {task}" in stages


@pytest.mark.long
def test_the_fraction_rises_in_small_steps_with_training_and_a_choice_of_structure(campaign, quick_settings):
    automatic = AutoStructure(ModelSpec(structure_named("integrator-first-order")))
    structure = {**quick_settings["structure"], "lifting": automatic}
    updates = recorded(campaign, **{**quick_settings, "structure": structure})
    check(updates)
    stages = {update.stage for update in updates}
    assert "lifting: trying the form with valve curve" in stages
    assert "lowering: training the correction of free runs" in stages
    assert "lowering: bands around predictions" in stages
