"""Many campaigns in one call: each model is the one that the campaign alone gives, failures stay apart."""

from dataclasses import replace

import pytest

import hitchid
from benches import write_bench
from hitchid._support.progress import ProgressUpdate
from hitchid.errors import HitchError, InputError
from hitchid.identification import identify_many


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory):
    """Return campaigns of two machines, one of five and one of six tests a direction."""
    folder = tmp_path_factory.mktemp("fleet")
    return [
        hitchid.read(write_bench(folder / str(tests), tests=tests, samples=250, seed=tests))
        for tests in (5, 6)
    ]


@pytest.mark.parametrize("trained", [False, pytest.param(True, marks=pytest.mark.long)])
def test_each_model_is_the_one_its_campaign_alone_gives(campaigns, quick_settings, tmp_path, trained):
    training = quick_settings["training"] if trained else None
    settings = {**quick_settings, "training": training, "rivals": False}
    together = identify_many(campaigns, **settings)
    for number, (campaign, identification) in enumerate(zip(campaigns, together, strict=True)):
        assert not isinstance(identification, HitchError)
        folders = tmp_path / f"{number}-together", tmp_path / f"{number}-alone"
        identification.save(folders[0])
        hitchid.identify(campaign, **settings).save(folders[1])
        for name in ("model.json", "weights.safetensors", "rivals.json", "rivals.safetensors"):
            assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()


def test_a_campaign_that_fails_leaves_the_others_alone(campaigns, quick_settings):
    unmatched = replace(campaigns[0], unmatched=("no-such-test-*",))
    updates: list[ProgressUpdate] = []
    settings = {**quick_settings, "training": None}
    first, second = identify_many([unmatched, campaigns[1]], **settings, progress=updates.append)
    assert identify_many([]) == ()
    assert isinstance(first, InputError)
    assert "no-such-test-*" in str(first)
    assert not isinstance(second, HitchError)
    fractions = [update.fraction for update in updates]
    assert fractions == sorted(fractions)
