"""Tuning of a controller, and its proof on the virtual bench, from a model that is identified quickly."""

import json
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from typer.testing import CliRunner

import hitchid
from hitchid.cli import app
from hitchid.control import Tuning, limitation, load_controller, save_controller, tune
from hitchid.control import loops as direction_loops
from hitchid.control.drive_report import check_drive, read_drive_limits
from hitchid.control.loops import (
    MAX_SENSITIVITY,
    MIN_DEAD_TIMES,
    MIN_GAIN_DB,
    MIN_PHASE_DEG,
    DirectionLoops,
    lqi_gains,
    pi_gains,
)
from hitchid.control.prediction import loads_of_channels
from hitchid.control.tune_report import tune_report
from hitchid.control.tuning import LOWEST_RAD_S, check_tunable, fastest_gains
from hitchid.errors import InputError, SettingsError
from hitchid.identification import read_settings

SETTINGS = """
[lifting]
structure = "integrator-second-order"
[lowering]
structure = "integrator-first-order"
[search]
evaluations = 200
compare = false
[training]
compensator = false
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a model of the nominal bench that was identified quickly."""
    path = tmp_path_factory.mktemp("tuning")
    (path / "quick.toml").write_text(SETTINGS)
    runner = CliRunner()
    assert runner.invoke(app, ["bench", str(path / "logs"), "--tests", "8"]).exit_code == 0
    identification = hitchid.identify(hitchid.read(path / "logs"), **read_settings(path / "quick.toml"))
    identification.save(path / "model")
    return path


@pytest.fixture(scope="module")
def model(folder: Path) -> hitchid.Hitch:
    return hitchid.load(folder / "model")


@pytest.fixture(scope="module")
def tuning(model: hitchid.Hitch) -> Tuning:
    return tune(model, draws=40)


def test_margins_are_those_that_were_asked_for(tuning: Tuning):
    for margins in tuning.margins.values():
        assert margins.passed
        assert margins.worst.gain_db >= MIN_GAIN_DB
        assert margins.worst.phase_deg >= MIN_PHASE_DEG
        assert margins.worst.sensitivity <= MAX_SENSITIVITY
        assert margins.worst.delay_s >= MIN_DEAD_TIMES * margins.dead_time_s
        assert margins.nominal.gain_db >= margins.worst.gain_db - 1e-9


def test_the_bandwidth_is_the_largest_with_margins_and_noise(model: hitchid.Hitch):
    for direction, row in zip(("lifting", "lowering"), loads_of_channels(model, None), strict=True):
        with jax.enable_x64(True):
            loops = DirectionLoops.of(model, direction, row, draws=40, seed=0)
            gains, capped = (
                fastest_gains(own, pi_gains) for own in (replace(loops, noise_rad_s=np.inf), loops)
            )
            assert gains is not None
            assert capped is not None
            margins = loops.margins(gains)
        slack = [
            margins.worst.gain_db / MIN_GAIN_DB,
            margins.worst.phase_deg / MIN_PHASE_DEG,
            MAX_SENSITIVITY / margins.worst.sensitivity,
            margins.worst.delay_s / max(MIN_DEAD_TIMES * margins.dead_time_s, 1e-6),
        ]
        assert min(slack) < 1.05
        expected = max(LOWEST_RAD_S, min(float(gains.proportional), loops.noise_rad_s))
        assert float(capped.proportional) == pytest.approx(expected, rel=0.01)
        with jax.enable_x64(True):
            lqi = fastest_gains(loops, lqi_gains)
        assert lqi is None or float(lqi.proportional) <= max(LOWEST_RAD_S, loops.noise_rad_s)


def test_a_controller_that_noise_limits_says_so(model: hitchid.Hitch, monkeypatch):
    monkeypatch.setattr(direction_loops, "NOISE_SHARE", 0.02)  # as with twice the noise
    limited = limitation(model, "lifting", draws=40)
    assert limited.limit == "noise"
    assert limited.worst < 0.95 * MAX_SENSITIVITY


def test_what_limits_the_controller_is_what_its_margins_depend_on(model: hitchid.Hitch, monkeypatch):
    monkeypatch.setattr(direction_loops, "NOISE_SHARE", 1.0)  # as with a twentieth of the noise
    limited = limitation(model, "lifting", draws=40)
    assert limited.direction == "lifting"
    assert limited.limit == "margins"
    assert limited.worst == pytest.approx(MAX_SENSITIVITY, rel=0.05)
    assert all(0 <= share <= 1 for share in limited.shares.values())
    assert list(limited.shares.values()) == sorted(limited.shares.values(), reverse=True)
    assert limited.parameter == next(iter(limited.shares))


def test_a_parameter_that_alone_is_uncertain_limits_alone(model: hitchid.Hitch):
    """Ms rises with the gain: over draws of the gain alone, nearly all of its variance goes with it."""
    uncertainty = model.uncertainty["lowering"]
    alone = tuple(
        replace(estimate, error=estimate.error if estimate.name == "gain" else 0.0)
        for estimate in uncertainty.benchmark.parameters
    )
    benchmark = replace(uncertainty.benchmark, parameters=alone)
    changed = replace(
        model, uncertainty={**model.uncertainty, "lowering": replace(uncertainty, benchmark=benchmark)}
    )
    shares = limitation(changed, "lowering", draws=40).shares
    assert set(shares) == {"gain"}
    assert shares["gain"] > 0.8


@pytest.mark.long
def test_the_design_command_proposes_a_test_for_control(folder: Path):
    runner, model = CliRunner(), str(folder / "model")
    result = runner.invoke(app, ["design", model, "--for", "control", "--json"])
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    assert content["mode"] == content["control"]["direction"]
    assert content["parameter"] == next(iter(content["control"]["shares"]))
    refused = runner.invoke(app, ["design", model, "--for", "control", "--parameter", "gain"])
    assert isinstance(refused.exception, SettingsError)


def test_a_model_without_errors_or_a_direction_is_refused(model: hitchid.Hitch):
    with pytest.raises(InputError, match="no standard errors"):
        tune(replace(model, uncertainty={}), draws=20)
    with pytest.raises(InputError, match="no lowering channel"):
        tune(replace(model, channels={"lifting": model.channels["lifting"]}), draws=20)


def test_the_units_of_the_model_are_those_of_the_controller(model: hitchid.Hitch, tuning: Tuning):
    assert tuning.units == {"displacement": "mm", "lifting_command": "A", "lowering_command": "A"}
    units = {"displacement": "deg", "lifting_command": "percent", "lowering_command": "percent"}
    check_tunable(replace(model, units={**model.units, **units}))


@pytest.mark.long
def test_the_commands_tune_and_drive_with_limits(folder: Path):
    runner, file, out = CliRunner(), folder / "controller.toml", folder / "drive"
    arguments = ["tune", folder / "model", "--out", file, "--report", folder / "report", "--draws", 40]
    tuned = runner.invoke(app, [*map(str, arguments), "--json"])
    assert tuned.exit_code == 0, tuned.output
    assert load_controller(file).model == "model"
    limits = "both_valves_samples = 0\ndiverged = 0\n[steps.100]\novershoot = 0.001\n"
    (folder / "limits.toml").write_text(limits)
    arguments = ["drive", str(file), "--out", str(out), "--draws", "1", "--quiet"]
    driven = runner.invoke(app, [*arguments, "--accept", str(folder / "limits.toml")])
    assert driven.exit_code == 1, driven.output
    assert "fail  steps.100.overshoot" in driven.output
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["both_valves_samples"] == 0
    assert metrics["diverged"] == 0
    assert set(metrics["steps"]) == {"5", "-5", "20", "-20", "100", "-100"}
    assert metrics["sensor_lost"]["samples_until_closed"] <= 2
    assert metrics["iae_ratio"] < 0.8
    assert set(metrics["iae"]) >= {"controller", "SIMC PI", "fixed PID"}
    assert metrics["band"]["scenarios"]
    assert metrics["acceptance"]["passed"] is False
    assert (out / "report.html").stat().st_size > 10_000


def test_limits_of_unknown_figures_are_refused(tmp_path: Path):
    with pytest.raises(SettingsError, match=r"no figure 'steps\.7\.overshoot'; expected one of"):
        check_drive({"steps": {"100": {"overshoot": 1.0}}}, {"steps.7.overshoot": 1.0})
    (tmp_path / "limits.toml").write_text('iae_ratio = "1"')
    with pytest.raises(SettingsError, match="iae_ratio: got '1', expected a finite number"):
        read_drive_limits(tmp_path / "limits.toml")
    (tmp_path / "limits.toml").write_text("")
    with pytest.raises(SettingsError, match="has no limit"):
        read_drive_limits(tmp_path / "limits.toml")


def test_a_figure_at_its_limit_passes_a_missing_fails():
    figures = {"iae_ratio": 0.6, "steps": {"100": {"settling_s": None}}, "band": {"inside": 0.9}}
    limits = {"iae_ratio": 0.6, "steps.100.settling_s": 6.6, "band.inside": 0.85}
    assert [check.passed for check in check_drive(figures, limits).checks] == [True, False, True]


@pytest.mark.parametrize("name", ["json", "json:missing", "json:dumps", "nowhere:thing", ":x"])
def test_a_controller_that_is_none_is_refused(folder: Path, tuning: Tuning, name: str):
    file = folder / "for-refusal.toml"
    if not file.exists():
        save_controller(tuning, hitchid.load(folder / "model"), file)
    result = CliRunner().invoke(
        app, ["drive", str(file), "--controller", name, "--out", str(folder / "none")]
    )
    assert isinstance(result.exception, InputError)
    assert "--controller" in str(result.exception)


def test_the_report_of_a_tuning_shows_its_margins(tuning: Tuning):
    document = tune_report(tuning, command="hitchid tune")
    (margins,) = (table for table in document.tables if table.title == "Margins")
    names = ["gain margin / dB", "phase margin / °", "Ms", "delay margin / ms", "disk margin"]
    assert [row[0] for row in margins.rows] == names
    assert {picture.name for picture in document.pictures} == {"bode", "nichols", "sensitivity", "steps"}
    for loop in tuning.loops.values():
        assert loop.response.shape == (41, loop.omega.size)
