"""Parameter files: what is refused, and what the refusal says."""

import tomllib
from importlib import resources

import equinox as eqx
import jax
import numpy as np
import pytest

from hitchid.bench import load_rig, parameter_sets, rig_limits
from hitchid.bench.parameter_files import build_rig
from hitchid.errors import SettingsError


@pytest.fixture
def tables():
    """Return the parsed nominal parameter set."""
    path = resources.files("hitchid.bench") / "parameters" / "nominal.toml"
    return tomllib.loads(path.read_text(encoding="utf-8"))


def test_three_benches_come_with_the_package():
    assert parameter_sets() == ("heavy-cold", "light-warm-worn", "nominal")


def test_every_number_names_its_source(any_rig, tables):
    for table in tables.values():
        for entry in table.values():
            assert entry["source"].startswith("assumed") or any(c.isdigit() for c in entry["source"])


def test_parameters_are_kept_in_si_units(rig):
    assert float(rig.cylinder.bore) == 0.07
    assert float(rig.supply.relief_pressure) == 16e6
    np.testing.assert_allclose(float(rig.supply.pump_flow), 20e-3 / 60, rtol=1e-15)
    np.testing.assert_allclose(float(rig.supply.shaft_speed), 1450 * 2 * np.pi / 60, rtol=1e-15)


def test_parameters_are_double_whatever_the_caller_is_set_to(rig):
    with jax.enable_x64(False):
        fresh = load_rig("nominal")
        assert rig_limits(fresh) == rig_limits(rig)
    leaves = jax.tree.leaves(eqx.filter(fresh, eqx.is_array))
    assert {leaf.dtype for leaf in leaves} == {np.dtype("float64")}


@pytest.mark.parametrize(
    ("table", "key", "entry", "said"),
    [
        ("lifting_valve", "full_area", {"value": -3.0, "unit": "mm2"}, ["got -3 mm2", "expected 1e-09 to"]),
        ("cylinder", "bore", {"value": 70, "unit": "bar"}, ["got 70 bar", "expected a unit among m, cm, mm"]),
        ("cylinder", "bore", {"value": 70, "unit": "furlong"}, ["got 70 furlong", "expected a unit"]),
        ("cylinder", "bore", {"value": "wide", "unit": "m"}, ["got 'wide'"]),
        ("cylinder", "bore", {"value": float("nan"), "unit": "m"}, ["got nan"]),
        (
            "lifting_valve",
            "saturation",
            {"value": 0.1, "unit": "A"},
            ["got 0.1 A", "more than the dead zone"],
        ),
        ("friction", "static", {"value": 1, "unit": "N"}, ["got 1 N", "at least friction.coulomb"]),
        ("linkage", "lift_rod", {"value": 1.4, "unit": "m"}, ["lift-rod angle", "(-1, 1)"]),
        ("linkage", "retracted_length", {"value": 0.6, "unit": "m"}, ["cylinder angle", "(-1, 1)"]),
        ("linkage", "sensor_offset", {"value": 80, "unit": "deg"}, ["angle at the sensor", "0 to 1.57"]),
    ],
)
def test_bad_values_are_refused_by_name(tables, table, key, entry, said):
    tables[table][key] = entry | {"source": "assumed"}
    with pytest.raises(SettingsError) as caught:
        build_rig(tables)
    for part in [f"'{table}.{key}", *said]:
        assert part in str(caught.value)


def test_unknown_and_missing_keys_are_refused_by_name(tables):
    spare = tables["cylinder"].pop("bore")
    with pytest.raises(SettingsError, match=r"cylinder\.bore.*expected a value"):
        build_rig(tables)
    tables["cylinder"] |= {"bore": spare, "boar": spare}
    with pytest.raises(SettingsError, match=r"'cylinder\.boar' is not known"):
        build_rig(tables)


@pytest.mark.parametrize("part", ["value", "unit", "source"])
def test_entries_must_be_whole(tables, part):
    del tables["oil"]["density"][part]
    with pytest.raises(SettingsError, match=rf"oil\.density\.{part}"):
        build_rig(tables)


def test_files_are_refused_by_name(tmp_path):
    with pytest.raises(SettingsError, match="heavy-cold, light-warm-worn, nominal"):
        load_rig("norminal")
    with pytest.raises(SettingsError, match="cannot be read"):
        load_rig(tmp_path / "none.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("[oil\n", encoding="utf-8")
    with pytest.raises(SettingsError, match="not valid TOML"):
        load_rig(broken)
