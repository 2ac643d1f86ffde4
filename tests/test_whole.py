"""From a folder of logs to a validated model, through the public interface."""

import json
from importlib import resources
from importlib.metadata import version

import numpy as np
import pytest

import hitchid


@pytest.fixture(scope="module")
def campaign(bench):
    return hitchid.read(bench)


@pytest.fixture(scope="module")
def model(identified):
    return hitchid.load(identified / "model")


@pytest.fixture(scope="module")
def result(model, campaign):
    return hitchid.validate(model, campaign)


def test_five_lines_lead_from_a_folder_to_a_validated_model(result):
    assert set(result.metrics["channels"]) == {"lifting", "lowering"}
    for mode, channel in result.metrics["channels"].items():
        assert channel["tests"] == [f"{mode}-05"]
        assert channel["benchmark"]["free_run"]["rmse"] < 1.0
        assert set(channel["baselines"]) == {"persistence", "arx", "transfer_function", "paper"}
        for key in ("rmse", "mae", "r2", "fit", "max_abs", "within_1"):
            assert np.isfinite(channel["greybox"]["one_step"][key])
    json.dumps(result.metrics, allow_nan=False)


def test_one_seed_gives_one_model_kept_in_pieces_or_loaded(
    identified, model, campaign, quick_settings, tmp_path
):
    identification = hitchid.identify(campaign, **quick_settings)
    identification.save(tmp_path / "model")
    for path in (identified / "model").iterdir():
        assert path.read_bytes() == (tmp_path / "model" / path.name).read_bytes(), path.name
    for record in campaign.records[:1] + campaign.records[-1:]:
        np.testing.assert_array_equal(
            model.simulate(record).displacement, identification.model.simulate(record).displacement
        )
        np.testing.assert_array_equal(
            model.predict(record, horizon=3), identification.model.predict(record, horizon=3)
        )


def test_the_speed_of_every_identification_test_is_reported(model, campaign, result):
    metrics = result.metrics["channels"]
    for direction, uncertainty in model.uncertainty.items():
        spread = uncertainty.load_scatter
        names = [record.name for record in campaign.identification(direction)]
        assert [test.test for test in spread.tests] == names
        assert list(metrics[direction]["load_scatter"]["tests"]) == names
        assert 0.0 <= spread.scatter <= spread.interval[1]


PUBLIC = [
    "Campaign",
    "Hitch",
    "HitchError",
    "Record",
    "__version__",
    "campaign",
    "compare",
    "cross_validate",
    "identify",
    "identify_many",
    "load",
    "read",
    "save",
    "train_rivals",
    "validate",
]


def test_the_public_names_are_these():
    assert dir(hitchid) == PUBLIC
    for name in PUBLIC:
        assert getattr(hitchid, name) is not None
    assert hitchid.__version__ == version("hitchid")
    assert resources.files("hitchid").joinpath("py.typed").is_file()
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        getattr(hitchid, "nonsense")  # noqa: B009
