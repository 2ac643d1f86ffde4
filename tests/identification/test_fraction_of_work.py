"""The fraction of the work that an identification reports follows what it has done."""

from itertools import pairwise

import pytest

import hitchid
from benches import write_bench
from hitchid.identification import AutoStructure, ModelSpec
from hitchid.structures import structure_named

LARGEST_JUMP = 0.25  # of all work, between two updates


@pytest.mark.long
@pytest.mark.parametrize("everything", [False, True], ids=["plain", "with training and choice of structure"])
def test_the_fraction_of_work_rises_in_small_steps(tmp_path, quick_settings, everything):
    settings = {**quick_settings, "training": None}
    tasks = ("refining parameters", "intervals of the parameters", "speed map")
    stages = {f"lifting: {task}" for task in tasks}
    if everything:
        automatic = AutoStructure(ModelSpec(structure_named("integrator-first-order")))
        settings = {**quick_settings, "structure": {**quick_settings["structure"], "lifting": automatic}}
        stages = {
            "lifting: trying the form with valve curve",
            "lowering: training the correction of free runs",
            "lowering: bands around predictions",
        }
    updates = []
    campaign = hitchid.read(write_bench(tmp_path / "logs", tests=5, samples=250))
    hitchid.identify(campaign, **settings, progress=updates.append)
    fractions = [0.0, *(update.fraction for update in updates), 1.0]
    assert fractions == sorted(fractions)
    assert max(later - earlier for earlier, later in pairwise(fractions)) <= LARGEST_JUMP
    assert updates[0].stage == "finding dead zones in the tests"
    assert stages <= {update.stage for update in updates}
