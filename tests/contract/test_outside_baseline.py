"""A baseline of another package: fitted beside the channel, saved, loaded, validated, named in the tables."""

import json

import numpy as np
import pytest

import hitchid
from hitchid.baselines.registry import all_baselines
from hitchid.errors import ModelFolderError
from hitchid.identification import AdamConfig, CompensatorConfig, MultiStart, RivalsConfig
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import LIFTING, Record

EXAMPLE = "baseline_from_outside"
NAME = "constant_speed"
STEP_S, SPEED, SAMPLES = 0.01, 12.0, 250


def campaign(tests=6) -> Campaign:
    """Return tests of a piston that moves at one speed while its valve is open, of different durations."""
    records = []
    for number in range(tests):
        # The last test, which is held out, ends within the range of the others: free runs are limited to it.
        stop = 100 + 20 * (5 * number % tests)
        command = np.where((np.arange(SAMPLES) >= 20) & (np.arange(SAMPLES) < stop), 0.8, 0.0)
        travel = SPEED * STEP_S * (np.cumsum(command > 0) - (command > 0))
        signals = {"displacement": 50.0 + travel, "lifting_command": command}
        units = {"displacement": "mm", "lifting_command": "A"}
        records.append(Record(f"lifting-{number:02d}", STEP_S, signals, units))
    return Campaign.of(records)


@pytest.fixture(scope="module")
def saved(install, tmp_path_factory):
    """Return the folder of a model that was identified with the package installed."""
    folder = tmp_path_factory.mktemp("outside") / "model"
    with pytest.MonkeyPatch.context() as patch:
        install(patch, EXAMPLE)
        training = CompensatorConfig(hidden=2, window=10, adam=AdamConfig(epochs=1), free_run=None)
        identification = hitchid.identify(
            campaign(),
            structure={LIFTING: "integrator"},
            training=training,
            rivals=RivalsConfig(trained=True, searches=None),
            search=MultiStart(evaluations=20),
            dead_zones={LIFTING: 0.1},
        )
        identification.save(folder)
    return folder


def test_without_the_package_there_are_the_own_baselines():
    assert list(all_baselines()) == ["arx", "oe", "narx", "lstm"]


@pytest.mark.long
def test_it_is_fitted_saved_loaded_and_validated(saved, install, monkeypatch):
    install(monkeypatch, EXAMPLE)
    assert list(all_baselines())[-1] == NAME
    model = hitchid.load(saved)
    assert model.rivals[LIFTING].baselines[NAME].speed == pytest.approx(SPEED, rel=1e-9)
    result = hitchid.validate(model, campaign())
    figures = result.metrics["channels"][LIFTING]
    assert figures["baselines"][NAME]["free_run"]["rmse"] == pytest.approx(0.0, abs=1e-9)
    assert figures["horizons"][NAME] == pytest.approx([0.0] * len(figures["horizons"]["steps"]), abs=1e-9)
    json.dumps(result.metrics, allow_nan=False)
    assert NAME in result.markdown() or NAME.replace("_", " ") in result.markdown()


def test_without_the_package_its_model_is_refused(saved):
    with pytest.raises(ModelFolderError, match=NAME):
        hitchid.load(saved)
