"""The form is chosen by free run on operating points that were held out."""

import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.benchmark import Batch, Form, Scales, structure_named
from hitchid.errors import SettingsError
from hitchid.identification import Automatic, MultiStart, read_settings
from hitchid.identification.selection import _folds, choose_form
from hitchid.record import LIFTING
from truth import levels

SAMPLES = 250
UNITS = {"x": "mm", "u": "A"}
PLAIN = Form(structure_named("integrator-second-order"))
SEARCH = MultiStart(evaluations=60)
SCALES = Scales(*(jnp.asarray(scale) for scale in (1.0, 90.0, 40.0, 0.0, 1.0)))


def simulated(make_record, form, values, *, noise=0.02, tests=8):
    """Return tests, each around its own level, of a plant of a form with white noise."""
    rng = np.random.default_rng(3)
    tops = np.linspace(0.3, 1.0, tests)
    commands = [top * levels(rng, SAMPLES, low=0.6) for top in tops]
    still = [make_record(np.full(SAMPLES, 80.0), command) for command in commands]
    batch = Batch.of(still, LIFTING, dead_zone=0.0, direction=1)
    travels = np.asarray(form.benchmark(jnp.asarray(values), SCALES).travel(batch))[:, :SAMPLES]
    moved = [80.0 + travel + noise * rng.standard_normal(SAMPLES) for travel in travels]
    records = [make_record(x, u) for x, u in zip(moved, commands, strict=True)]
    return Batch.of(records, LIFTING, dead_zone=0.0, direction=1)


def test_a_linear_plant_keeps_its_transfer_function(make_record):
    batch = simulated(make_record, PLAIN, [20.0, 15.0, 0.8])
    found, tried = choose_form(batch, Automatic(PLAIN), SEARCH, 0, units=UNITS)
    assert tried[0].name == "transfer function"
    assert found.benchmark.shape is None
    # Noise of 0.02 mm over two thousand samples; nested forms fit no worse.
    assert tried[0].held_out == pytest.approx(0.02, rel=0.1)
    assert all(each.rmse <= tried[0].rmse * (1 + 1e-6) for each in tried)


def test_a_valve_curve_is_found_where_there_is_one(make_record):
    curved = Form(structure_named("integrator-second-order"), curve=True)
    values = [20.0, 15.0, 0.8, 0.05, 2.0, 0.6]
    batch = simulated(make_record, curved, values)
    found, tried = choose_form(batch, Automatic(PLAIN), SEARCH, 0, units=UNITS)
    named = {each.name: each for each in tried}
    assert named["with valve curve"].held_out < 0.1 * named["transfer function"].held_out
    assert found.benchmark.shape is not None
    assert found.rmse == pytest.approx(0.02, rel=0.1)
    command = jnp.linspace(0.2, 0.9, 30)[None]
    none = jnp.zeros(command.shape)
    true = curved.benchmark(jnp.asarray(values), SCALES)
    speeds = [each.values[0] * each.shape.flow(command, none) for each in (found.benchmark, true)]
    np.testing.assert_allclose(*speeds, rtol=0.02)


def test_folds_hold_out_levels_between_the_extremes(make_record):
    records = [make_record(np.linspace(80.0, 90.0, 100), np.full(100, level)) for level in (1, 1, 2, 3, 4, 4)]
    batch = Batch.of(records, LIFTING, dead_zone=0.0, direction=1)
    folds = _folds(batch, alone=False)
    assert [list(np.flatnonzero(fold)) for fold in folds] == [[2], [3]]
    alone = _folds(batch, alone=True)
    assert sorted(int(np.flatnonzero(fold)[0]) for fold in alone) == [1, 2, 3, 4]


def test_tests_of_one_level_leave_the_plain_form(make_record):
    batch = simulated(make_record, PLAIN, [20.0, 15.0, 0.8], tests=1)
    found, tried = choose_form(batch, Automatic(PLAIN), SEARCH, 0, units=UNITS)
    assert tried == ()
    assert found.benchmark.shape is None


def test_the_settings_file_asks_for_a_choice_or_for_curves(tmp_path):
    path = tmp_path / "settings.toml"
    path.write_text('[lifting]\nstructure = "automatic"\nload = "pressure"\n[lowering]\ncurve = true\n')
    forms = read_settings(path).get("structure", {})
    assert forms["lifting"] == Automatic(PLAIN, load="pressure")
    assert forms["lowering"] == Form(structure_named("first-order-lag"), curve=True)


def test_a_choice_does_not_go_with_curves_asked_for(tmp_path):
    path = tmp_path / "settings.toml"
    path.write_text('[lifting]\nstructure = "automatic"\ncurve = true\n')
    with pytest.raises(SettingsError, match="decides on dead_time, curve and position itself"):
        read_settings(path)
