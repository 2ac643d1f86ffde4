"""From a folder of logs to a validated model, through the public interface."""

import json

import numpy as np
import pytest

import hitchid


def test_five_lines_take_a_user_from_a_folder_to_a_validated_model(bench, quick_settings, tmp_path):
    campaign = hitchid.read(bench())
    found = hitchid.identify(campaign, **quick_settings)
    found.save(tmp_path / "model")
    model = hitchid.load(tmp_path / "model")
    result = hitchid.validate(model, campaign)
    assert set(result.metrics["channels"]) == {"lifting", "lowering"}
    for mode, channel in result.metrics["channels"].items():
        assert channel["tests"] == [f"{mode}-05"]
        assert channel["benchmark"]["free_run"]["rmse"] < 1.0
        assert set(channel["baselines"]) == {
            "persistence",
            "arx",
            "narx",
            "lstm",
            "transfer_function",
            "paper",
        }
        for key in ("rmse", "mae", "r2", "fit", "max_abs", "within_1"):
            assert np.isfinite(channel["greybox"]["one_step"][key])
    json.dumps(result.metrics, allow_nan=False)


def test_a_loaded_model_gives_the_same_numbers(bench, quick_settings, tmp_path):
    campaign = hitchid.read(bench())
    found = hitchid.identify(campaign, **quick_settings)
    found.save(tmp_path / "model")
    model = hitchid.load(tmp_path / "model")
    for record in campaign.records[:1] + campaign.records[-1:]:
        np.testing.assert_array_equal(model.simulate(record), found.model.simulate(record))
        np.testing.assert_array_equal(
            model.predict(record, horizon=3), found.model.predict(record, horizon=3)
        )


def test_one_seed_gives_one_model_bit_for_bit(bench, quick_settings, tmp_path):
    campaign = hitchid.read(bench())
    for name in ("one", "two"):
        hitchid.identify(campaign, **quick_settings).save(tmp_path / name)
    for file in ("model.json", "weights.safetensors", "trace.json"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


def test_every_public_name_is_there():
    assert dir(hitchid) == sorted(hitchid.__all__)
    for name in hitchid.__all__:
        assert getattr(hitchid, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        getattr(hitchid, "nonsense")  # noqa: B009
