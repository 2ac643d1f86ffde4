"""What must hold on measured data; skipped where the data are missing."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from hitchid import identify, read, validate
from hitchid.benchmark import Form, structure_named
from hitchid.campaign import Campaign
from hitchid.identification import Descent, MultiStart, Rollouts, Training, Whale
from hitchid.identification.identify import PAPER_FORMS
from hitchid.identification.phase1 import find_parameters
from hitchid.identification.preparation import prepare
from hitchid.record import Record

BRIEF = {
    "comparison": None,
    "search": MultiStart(evaluations=200),
    "training": Training(
        hidden=8,
        window=20,
        descent=Descent(epochs=4, patience=4),
        rollouts=Rollouts(hidden=4, epochs=20),
    ),
}
SHORT = replace(BRIEF["training"], rollouts=None, baselines=False)
PAUSE_S = 60.0
EMPS = """
[signals]
time = { column = "t", unit = "s" }
lifting_command = { column = "vir", unit = "V" }
displacement = { column = "qm", unit = "m" }

[split]
test = ["*PULSES"]
"""


def paused(record, mode):
    """Return a record with a minute of no command in its middle, and where that begins."""
    middle, pause = len(record) // 2, round(PAUSE_S / record.step_s)
    commands = {role for role in record.signals if role.endswith("_command")}
    signals = {
        role: np.concatenate(
            [samples[:middle], np.full(pause, 0.0 if role in commands else samples[middle]), samples[middle:]]
        )
        for role, samples in record.signals.items()
    }
    assert np.abs(record.command(mode)[:middle]).max() > 0
    return replace(record, signals=signals), middle


def test_the_default_model_of_rig_a_is_accurate_and_stands_where_it_is_not_driven(data):
    """One identification, for it takes a minute: bounds of the goals set for this data."""
    campaign = read(data("rig-a"))
    model = identify(campaign, training=Training(baselines=False), comparison=None).model
    metrics = validate(model, campaign).metrics
    for mode, free_run in (("lifting", 0.33), ("lowering", 0.48)):
        channel = metrics["channels"][mode]
        one_step = channel["greybox"]["one_step"]["rmse"]
        assert one_step <= 0.0575
        assert one_step < channel["baselines"]["persistence"]["one_step"]["rmse"]
        assert channel["greybox"]["free_run"]["rmse"] <= free_run
        assert np.isfinite(channel["benchmark"]["free_run"]["rmse"])
        assert channel["tests"] == [f"{mode}-{number}" for number in (17, 18, 19, 20)]
        # Four tests a direction: all of them may lie inside a band that nine of ten samples shall.
        bands = channel["bands"]
        assert bands["free_run"]["covered"] >= 0.85
        assert 0.85 <= bands["horizons"]["covered"][0] <= 0.95
        record, middle = paused(campaign.held_out(mode)[0], mode)
        found = model.simulate(record)
        settled = middle + round(1.0 / record.step_s)
        standing = found[settled : middle + round(PAUSE_S / record.step_s)]
        assert np.ptp(standing) < 0.05
        assert abs(standing[0] - found[0]) > 1.0
    cycles = metrics["cycles"]
    assert len(cycles["tests"]) == 4
    assert cycles["greybox"]["free_run"]["rmse"] <= 2.0
    assert cycles["horizons"]["greybox"][cycles["horizons"]["steps"].index(10)] <= 0.10
    assert cycles["max_jump"] < 0.02


def test_the_lag_of_the_papers_lowering_model_is_not_printed_as_if_it_were_determined(data):
    campaign = read(data("rig-a"))
    model = identify(campaign, structure=PAPER_FORMS, training=None, comparison=None).model
    result = validate(model, campaign)
    known = result.metrics["channels"]["lowering"]["parameters"]["estimates"]
    lag = known["time_constant"]
    assert known["gain"]["determined"]
    assert not lag["determined"]
    # Ten seconds tell a lag from an integrator if it is no longer than some ten times that.
    assert lag["interval_95"][0] > 100.0
    assert lag["interval_95"][1] is None
    assert lag["verdict"].startswith("only K/τ is determined: τ > ")
    section = result.markdown().split("## lowering: parameters of the benchmark")[1].split("##")[0]
    cells = {
        row.split("|")[1].strip(): row.split("|")[3].strip() for row in section.splitlines() if "|" in row
    }
    assert cells["K/τ"].startswith("15.")
    assert cells["τ"] == cells["alpha2 = K"] == cells["beta4 = tau"] == ""


@pytest.mark.parametrize("mode", ["lifting", "lowering"])
def test_phase_1_reaches_the_best_of_64_starts_from_every_seed(data, mode):
    tests = prepare(read(data("rig-a")), mode, None)

    def rmse(search, seed):
        fit = find_parameters(tests.everything, PAPER_FORMS[mode], search, seed)
        return float(fit.misfit(jnp.asarray(fit.position)[None])[0])

    best = rmse(MultiStart(evaluations=10**6, starts=64), 0)
    for seed in range(10):
        assert rmse(Whale(), seed) <= 1.001 * best


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


@pytest.mark.parametrize("name", ["hanging-load", "excavator-boom"])
def test_real_logs_of_two_way_plants_are_identified_and_validated(data, name):
    campaign = read(data(name))
    model = identify(campaign, structure=PAPER_FORMS, **{**BRIEF, "training": SHORT}).model
    metrics = validate(model, campaign).metrics
    assert tuple(metrics["channels"]) == ("lifting", "lowering")
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


def root_mean_square(errors):
    return float(np.sqrt(np.mean(errors**2)))


def test_cascaded_tanks_are_identified_by_the_structure_that_knows_them(data):
    columns = np.genfromtxt(data("cascaded-tanks") / "dataBenchmark.csv", delimiter=",", names=True)
    units = {"displacement": "V", "lifting_command": "V"}
    records = [
        Record(
            name, 4.0, {"displacement": columns[f"y{name}"], "lifting_command": columns[f"u{name}"]}, units
        )
        for name in ("Est", "Val")
    ]
    campaign = Campaign.of(records, test_patterns=["Val"], kinds={"*": "lifting"})
    form = Form(structure_named("cascaded-tanks"))
    model = identify(campaign, structure={"lifting": form}, training=None, comparison=None).model
    (test,) = campaign.held_out("lifting")
    # The first 50 samples are left out by the benchmark's rules: the upper level is not known at the start.
    assert root_mean_square((model.simulate(test) - test.displacement)[50:]) <= 0.30


def test_an_axis_with_friction_is_identified_by_the_structure_that_knows_it(data, tmp_path):
    (tmp_path / "emps.toml").write_text(EMPS)
    campaign = read(data("emps"), signals=tmp_path / "emps.toml")
    form = Form(structure_named("inertia-with-friction"))
    model = identify(campaign, structure={"lifting": form}, training=None, comparison=None).model
    (test,) = campaign.held_out("lifting")
    assert test.unit == "m"
    # The first 20 samples are left out by the benchmark's rules.
    assert root_mean_square((model.simulate(test) - test.displacement)[20:]) <= 4.6e-3


@pytest.mark.parametrize("name", ["raise-060-light", "lower-060-heavy"])
def test_an_export_of_controldesk_gives_the_signals_that_were_made_of_it(data, name):
    (raw,) = read(data("dspace-raw") / f"{name}.csv.gz").records
    (made,) = read(data("excavator-boom") / f"{name}.csv.gz").records
    assert (len(raw), raw.step_s, raw.kind) == (len(made), made.step_s, made.kind)
    # Written with four decimals, the pressure with three: half of the last one, and its own rounding.
    for role, decimals in (("displacement", 4), ("lifting_command", 4), ("lowering_command", 4)):
        np.testing.assert_allclose(raw.signals[role], made.signals[role], rtol=0, atol=0.5001 * 10**-decimals)
    pressure = raw.signals["Boom_UpH_Cyl_P"]
    np.testing.assert_allclose(pressure, made.signals["head_pressure"], rtol=0, atol=0.5001e-3)


def test_logs_as_recorded_are_read_on_their_clock_with_their_zero_and_scale(data):
    field = read(data("field-excavator"))
    assert field.step_s == 0.053
    assert {record.name.partition("@")[0] for record in field.records} == {f"field-0{k}" for k in range(1, 7)}
    for record in field.records:
        assert np.mean(np.abs(record.command("lifting")) + np.abs(record.command("lowering")) < 0.01) > 0.2
        assert record.command("lifting").max() < 2.6
        assert record.clock.jitter > 0.2
    actuator = read(data("electro-hydraulic-actuator"))
    assert actuator.step_s == 0.001
    for record in actuator.records:
        assert record.units["lifting_command"] == "rpm"
        counts = record.displacement / 0.025
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
        assert 24 < np.ptp(record.displacement) < 51
