"""Controller files: what is written is read, and what cannot be used is refused by name."""

import re
import tomllib

import equinox as eqx
import jax
import numpy as np
import pytest

from controllers import made_up_tuning
from hitchid.control.files import load_controller, save_controller
from hitchid.errors import OutputError, SettingsError
from hitchid.logs.record import DIRECTIONS


@pytest.fixture(scope="module")
def tuning(model, controller):
    """Return a tuning made by hand."""
    has_load = bool(next(iter(model.channels.values())).benchmark.covariates)
    return made_up_tuning(controller, {"pressure": 125.0} if has_load else {})


@pytest.fixture(scope="module")
def written(tmp_path_factory, model, tuning):
    """Return a controller file."""
    path = tmp_path_factory.mktemp("controller") / "controller.toml"
    save_controller(tuning, model, path, model_folder='../model ä"1"')
    return path


def test_a_controller_is_read_as_it_was_written(written, model, tuning) -> None:
    content = load_controller(written)
    assert eqx.tree_equal(
        *(eqx.filter(own, eqx.is_array, inverse=True) for own in (content.controller, tuning.controller))
    )
    leaves = zip(*map(jax.tree.leaves, (content.controller, tuning.controller)), strict=True)
    for one, other in leaves:
        np.testing.assert_allclose(one, other, rtol=1e-12)
    assert content.model == '../model ä"1"'
    assert content.digest == model.provenance.digest
    assert content.load == tuning.load
    for direction in DIRECTIONS:
        assert content.margins[direction]["gain_dB"] == 7.5
        assert content.margins[direction]["passed"] is True


def test_an_infinite_margin_is_read_as_it_was_written(tmp_path, model, tuning) -> None:
    save_controller(
        made_up_tuning(tuning.controller, tuning.load, gain_db=np.inf), model, tmp_path / "a.toml"
    )
    assert load_controller(tmp_path / "a.toml").margins[DIRECTIONS[0]]["gain_dB"] == np.inf


def test_an_existing_file_is_replaced_only_by_force(tmp_path, model, tuning) -> None:
    path = tmp_path / "controller.toml"
    path.write_text("mine")
    with pytest.raises(OutputError, match=re.escape(str(path))):
        save_controller(tuning, model, path)
    assert path.read_text() == "mine"
    save_controller(tuning, model, path, force=True)
    assert load_controller(path).digest == model.provenance.digest


def test_the_curve_rises_from_no_current_to_the_largest(written) -> None:
    content = tomllib.loads(written.read_text(encoding="utf-8"))
    for direction in DIRECTIONS:
        curve = content[direction]["curve"]
        assert curve["speed"][0] == 0
        assert np.all(np.diff(curve["command"]) >= 0)
        assert curve["command"][-1] == pytest.approx(content[direction]["largest_command"], rel=1e-3)


def line(name: str, value: str | None) -> tuple[str, str]:
    """Return pattern and replacement of the first line of a name; None takes the line out."""
    return rf"(?m)^{name} = .*$", "" if value is None else f"{name} = {value}"


DAMAGES = {
    "format": (line("format", None), "format"),
    "later format": (line("format", "99"), "key 'format'.*got 99"),
    "no TOML": (("^format", "format ="), "not valid TOML"),
    "missing gain": (line("proportional_1_per_s", None), "proportional_1_per_s"),
    "negative gain": (line("integral_1_per_s2", "-1.0"), "integral_1_per_s2"),
    "text for a number": (line("lag_s", '"long"'), "lag_s"),
    "truth for a number": (line("crossing_speed", "true"), "crossing_speed"),
    "infinite": (line("rate", "inf"), "rate"),
    "missing window": (line("inner", None), "inner"),
    "no sampling time": (line("step_s", "0.0"), "step_s"),
    "unknown structure": (line("structure", '"pendulum"'), "pendulum"),
    "missing direction": (line("direction", None), "cannot be used|direction"),
    "number for the load": ((r"(?m)^\[load\]\n(pressure = .*\n)?", "[other]\n"), "load"),
    "few values": (line("values", "[1.0]"), "values|cannot be used"),
    "number for the hold": ((r"(?m)^\[hold\]\ninner = .*\nouter = .*$", "[other]\nhold = 1"), "hold"),
}


@pytest.mark.parametrize(("change", "named"), DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_file_is_refused_by_name(tmp_path, written, change: tuple[str, str], named: str) -> None:
    text = written.read_text(encoding="utf-8")
    damaged, count = re.subn(*change, text, count=1)
    assert count == 1
    path = tmp_path / "controller.toml"
    path.write_text(damaged, encoding="utf-8")
    with pytest.raises(SettingsError, match=f"controller.toml.*({named})"):
        load_controller(path)


@pytest.mark.parametrize("section", ["load", "hold", "model", "lifting"])
def test_a_number_in_the_place_of_a_section_is_refused(tmp_path, written, section: str) -> None:
    text = written.read_text(encoding="utf-8")
    without = re.sub(rf"(?ms)^\[{section}(\.\w+)?\]\n.*?(?=^\[|\Z)", "", text)
    path = tmp_path / "controller.toml"
    path.write_text(f"{section} = 5\n{without}", encoding="utf-8")
    with pytest.raises(SettingsError, match=r"controller\.toml"):
        load_controller(path)


def test_a_missing_file_is_refused_by_its_path(tmp_path) -> None:
    with pytest.raises(SettingsError, match=r"nowhere\.toml"):
        load_controller(tmp_path / "nowhere.toml")
