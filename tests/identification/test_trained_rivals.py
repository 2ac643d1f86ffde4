"""Rivals: trained on request, beside a model that stays as it is."""

from dataclasses import replace

import pytest

import hitchid
from benches import write_bench
from hitchid.errors import InputError
from hitchid.identification import RivalsConfig
from hitchid.identification.settings_file import settings_of_model

QUICK = {"arx"}
TRAINED = {"arx", "oe", "narx", "lstm"}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    logs = write_bench(tmp_path_factory.mktemp("rivals") / "logs", tests=4, samples=250)
    return hitchid.read(sorted(logs.glob("lifting-*")))


@pytest.fixture(scope="module")
def settings(quick_settings):
    # Of one size with the settings that a model folder keeps.
    training = replace(quick_settings["training"], free_run=None)
    return {**quick_settings, "training": training, "seed": 3}


@pytest.fixture(scope="module")
def quick(campaign, settings):
    return hitchid.identify(campaign, **{**settings, "rivals": False}).model


@pytest.fixture(scope="module")
def trained(quick, campaign):
    return hitchid.train_rivals(quick, campaign, searches=None)


def test_a_model_has_the_rivals_that_cost_little(quick, campaign):
    for rivals in quick.rivals.values():
        assert set(rivals.baselines) == QUICK
        assert not rivals.trained
    result = hitchid.validate(quick, campaign)
    for channel in result.metrics["channels"].values():
        assert {"persistence", "arx", "transfer_function"} <= channel["baselines"].keys()
        assert "lstm" not in channel["baselines"]
    assert any("hitchid rivals" in notice for notice in result.notices)


@pytest.mark.long
def test_rivals_are_trained_beside_an_unchanged_model(quick, trained, campaign, tmp_path):
    hitchid.save(quick, tmp_path / "quick")
    hitchid.save(trained, tmp_path / "trained")
    for name in ("model.json", "weights.safetensors"):
        assert (tmp_path / "quick" / name).read_bytes() == (tmp_path / "trained" / name).read_bytes()
    loaded = hitchid.load(tmp_path / "trained")
    assert all(set(rivals.baselines) == TRAINED for rivals in loaded.rivals.values())
    result = hitchid.validate(loaded, campaign)
    for channel in result.metrics["channels"].values():
        assert channel["baselines"].keys() >= TRAINED
    assert not any("hitchid rivals" in notice for notice in result.notices)


@pytest.mark.long
def test_rivals_are_the_same_with_the_model_and_after_it(trained, campaign, settings, tmp_path):
    rivals = RivalsConfig(trained=True, searches=None)
    at_once = hitchid.identify(campaign, **{**settings, "rivals": rivals}).model
    for name, model in (("at-once", at_once), ("after", trained)):
        hitchid.save(model, tmp_path / name)
    for name in ("model.json", "rivals.json", "rivals.safetensors"):
        assert (tmp_path / "at-once" / name).read_bytes() == (tmp_path / "after" / name).read_bytes()


def test_rivals_are_trained_on_the_tests_of_their_model_alone(quick, campaign):
    fewer = campaign.without({campaign.identification("lifting")[0].fingerprint})
    with pytest.raises(InputError, match="expected the logs and the split"):
        hitchid.train_rivals(quick, fewer)


def test_no_rivals_are_fitted_where_none_are_asked_for(campaign, settings):
    identification = hitchid.identify(campaign, **{**settings, "training": None, "rivals": None})
    assert not identification.model.rivals
    result = hitchid.validate(identification.model, campaign)
    assert set(result.metrics["channels"]["lifting"]["baselines"]) == {"persistence"}


def test_settings_come_back_from_what_a_model_keeps_of_them(quick, settings):
    returned = settings_of_model(quick.provenance.settings)
    assert returned["training"] == settings["training"]
    assert {name: spec.structure for name, spec in returned["structure"].items()} == {
        name: spec.structure for name, spec in settings["structure"].items()
    }
