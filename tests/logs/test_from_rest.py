"""Parts of a log after a gap: what moves from commands that are lost is no start at rest."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from hitchid import identify, validate
from hitchid.errors import InputError
from hitchid.identification import ModelSpec, MultiStart
from hitchid.logs.campaign import Campaign
from hitchid.logs.from_rest import from_rest
from hitchid.logs.record import LIFTING
from hitchid.structures import structure_named
from truth import STEP_S, held

GAIN, LAG_S = 110.0, 0.15
GAP = slice(150, 280)  # samples; longer than any that is bridged
REST, UP, DOWN = np.zeros(60), np.full(300, 0.6), np.full(300, -0.4)


def log(*strokes, gap=GAP, noise=0.0):
    """Return the table of a log that moves 50 samples after its start, without the samples of a gap."""
    command = np.concatenate([np.zeros(50), *strokes])
    travel = held([GAIN], [LAG_S, 1.0, 0.0], command)
    measured = 100.0 + travel + noise * np.random.default_rng(0).standard_normal(command.size)
    table = {
        "time_s": STEP_S * np.arange(command.size),
        "current_up_A": np.maximum(command, 0.0),
        "current_down_A": np.maximum(-command, 0.0),
        "displacement_mm": measured,
    }
    return pd.DataFrame(table).drop(index=range(command.size)[gap]).reset_index(drop=True)


@pytest.mark.parametrize(
    ("strokes", "gap", "starts"),
    [
        ((UP, REST, UP), slice(0), [0]),
        ((UP, REST, UP), GAP, [0, 400]),  # 0.1 s before the stroke after the rest
        ((UP, DOWN, UP), GAP, [0, 350]),  # where the piston turns
        ((UP, 0 * UP, UP), slice(360, 500), [0, 640]),
        ((UP, UP), GAP, [0]),
    ],
    ids=["no gap", "rest", "turn", "gap at rest", "motion to the end"],
)
def test_a_part_after_a_gap_is_used_from_rest(strokes, gap, starts):
    campaign = Campaign.from_dataframes({"a": log(*strokes, gap=gap)})
    at_rest, notices = from_rest(campaign)
    assert [record.start_s for record in at_rest] == pytest.approx(STEP_S * np.array(starts))
    assert at_rest[0] == campaign[0]
    assert any("a@2" in notice and "motion" in notice for notice in notices) == (len(at_rest) < len(campaign))
    assert from_rest(at_rest)[0] == at_rest


def test_motion_after_a_gap_is_used_with_a_warning_or_refused():
    parts = Campaign.from_dataframes({"a": log(UP, UP)})[["a@2"]]
    campaign, (warning,) = from_rest(parts, otherwise="the gain is wrong")
    assert campaign == parts
    assert warning.startswith("a@2: begins in motion after a gap")
    assert warning.endswith("for want of others: the gain is wrong")
    for refusing, otherwise in ((parts, ""), (replace(parts, strict=True), "the gain is wrong")):
        with pytest.raises(
            InputError, match=r"begins in motion after a gap; expected 0\.5 s without a command"
        ):
            from_rest(refusing, otherwise)


def test_a_ramp_in_motion_is_left_out_beside_tests_at_rest():
    kinds = {"a@2": "ramp", "a@1": "lifting"}
    parts = Campaign.from_dataframes({"a": log(UP, UP)}, kinds=kinds)
    campaign, notices = from_rest(parts, otherwise="the gain is wrong")
    assert [record.name for record in campaign] == ["a@1"]
    assert not any("for want of others" in notice for notice in notices)


def test_gaps_in_motion_leave_gain_and_lag_as_they_are():
    logs = {f"up-{level}": log(level * UP, REST, UP / level, noise=0.1) for level in (0.8, 1.0, 1.2, 1.4)}
    campaign = Campaign.from_dataframes(logs, test_patterns=["up-1.2@*"])
    form = ModelSpec(structure_named("integrator-first-order"))
    model = identify(
        campaign, structure=form, dead_zones={LIFTING: 0.0}, search=MultiStart(30), training=None, rivals=None
    ).model
    np.testing.assert_allclose(model.channels[LIFTING].benchmark.values, [GAIN, LAG_S], rtol=0.01)
    accuracy = validate(model, campaign).metrics["channels"][LIFTING]["greybox"]["free_run"]
    assert accuracy["rmse"] < 0.2
