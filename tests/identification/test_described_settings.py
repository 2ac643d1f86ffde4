"""The settings that a model folder keeps: the keys and values of the settings file."""

import json

import pytest

from hitchid.estimation import DifferentialEvolution, MultiStart
from hitchid.estimation.searches import Search
from hitchid.identification import read_settings
from hitchid.identification.config import IdentificationConfig

SEARCH = {"method": "whale", "evaluations": 600, "population": 20, "stagnation": 7, "per_dimension": False}
TRAINING = {"compensator": True, "hidden": 8, "window": 30, "epochs": 15, "patience": 9, "batch": 16}
TRAINING |= {"learning_rate": 0.01, "free_run": False}


def described(**settings):
    """Return what a model folder keeps of the arguments of `identify`."""
    return IdentificationConfig.of(**settings).describe()


def test_what_a_file_sets_is_kept_by_its_own_keys(tmp_path):
    lines = []
    for name, table in (("search", SEARCH), ("training", TRAINING)):
        lines += [f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    (tmp_path / "a.toml").write_text("\n".join(lines))
    kept = described(**read_settings(tmp_path / "a.toml"))
    assert {key: kept["search"][key] for key in SEARCH} == SEARCH
    assert {key: kept["training"][key] for key in TRAINING} == TRAINING
    (tmp_path / "a.toml").write_text("[training]\ncompensator = false\n")
    assert described(**read_settings(tmp_path / "a.toml"))["training"] == {"compensator": False}


@pytest.mark.parametrize("search", [MultiStart(evaluations=60), DifferentialEvolution(evaluations=90)])
def test_every_search_is_kept_by_its_method_and_as_json(search):
    kept = json.loads(json.dumps(described(search=search)))
    assert kept["search"]["method"] == search.name
    assert kept["search"]["evaluations"] == search.evaluations
    assert "name" not in kept["search"]


def test_a_search_from_outside_is_kept_by_its_method():
    class Guess(Search):
        name = "guess"

        def minimise(self, problem, seed, callback=None):
            raise NotImplementedError

    assert described(search=Guess())["search"] == {"method": "guess"}
