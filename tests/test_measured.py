"""What must hold on measured data; skipped where the data are missing."""

import numpy as np
import pytest

from hitchid import identify, read, validate
from hitchid.identification import Descent, MultiStart, Training, Whale
from hitchid.identification.identify import PAPER_FORMS
from hitchid.identification.phase1 import identify_benchmark
from hitchid.identification.preparation import prepare

BRIEF = {
    "search": MultiStart(evaluations=200),
    "training": Training(hidden=8, window=20, descent=Descent(epochs=4, patience=4)),
}
EMPS = """
[signals]
time = { column = "t", unit = "s" }
lifting_command = { column = "vir", unit = "V" }
displacement = { column = "qm", unit = "m" }

[split]
test = ["*PULSES"]
"""


def test_one_step_ahead_the_grey_box_beats_persistence_and_65_micrometres_on_rig_a(data):
    campaign = read(data("rig-a"))
    metrics = validate(identify(campaign).model, campaign).metrics
    for mode in ("lifting", "lowering"):
        channel = metrics["channels"][mode]
        one_step = channel["greybox"]["one_step"]["rmse"]
        assert one_step <= 0.065
        assert one_step < channel["baselines"]["persistence"]["one_step"]["rmse"]
        assert np.isfinite(channel["benchmark"]["free_run"]["rmse"])
        assert channel["tests"] == [f"{mode}-{number}" for number in (17, 18, 19, 20)]
    assert len(metrics["cycles"]["tests"]) == 4


@pytest.mark.parametrize("mode", ["lifting", "lowering"])
def test_phase_1_reaches_the_best_of_64_starts_from_every_seed(data, mode):
    tests = prepare(read(data("rig-a")), mode, None)
    units = {"x": "mm", "u": "A"}
    starts = MultiStart(evaluations=10**6, starts=64)
    best = identify_benchmark(tests.everything, PAPER_FORMS[mode], starts, 0, units=units).rmse
    for seed in range(10):
        found = identify_benchmark(tests.everything, PAPER_FORMS[mode], Whale(), seed, units=units)
        assert found.rmse <= 1.001 * best


def test_ramps_and_dynamic_tests_agree_on_the_dead_zone_of_rig_a(data):
    campaign = read(data("rig-a"))
    ramps = prepare(campaign, "lifting", None).dead_zone
    assert ramps.origin == "ramps"
    assert ramps.count == 3
    without = type(campaign)(tuple(r for r in campaign.records if r.kind != "ramp"), campaign.test_patterns)
    tests = prepare(without, "lifting", None).dead_zone
    assert tests.origin == "tests"
    assert ramps.spread is not None
    assert tests.spread is not None
    # Three standard errors of their difference: two estimates of one number by different experiments.
    assert abs(ramps.value - tests.value) <= 3 * np.hypot(ramps.spread, tests.spread)


@pytest.mark.parametrize(
    ("name", "modes"),
    [("excavator-boom", ("lifting", "lowering")), ("hanging-load", ("lifting", "lowering"))],
)
def test_real_logs_of_two_way_plants_are_identified_and_validated(data, name, modes):
    campaign = read(data(name))
    metrics = validate(identify(campaign, **BRIEF).model, campaign).metrics
    assert tuple(metrics["channels"]) == modes
    for channel in metrics["channels"].values():
        assert np.isfinite(channel["benchmark"]["free_run"]["rmse"])
        assert channel["greybox"]["free_run"]["rmse"] is not None


def test_a_real_plant_with_one_signed_channel_is_identified_from_matlab_files(data, tmp_path):
    (tmp_path / "emps.toml").write_text(EMPS)
    campaign = read(data("emps"), signals=tmp_path / "emps.toml")
    metrics = validate(identify(campaign, **BRIEF).model, campaign).metrics
    assert list(metrics["channels"]) == ["lifting"]
    assert metrics["unit"] == "m"
    assert np.isfinite(metrics["channels"]["lifting"]["benchmark"]["free_run"]["rmse"])
