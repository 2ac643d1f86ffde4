"""Models with changed parameters: what changes, what stays, and what is kept where they are saved."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import handmade
import machine
from handmade import DEAD_ZONES, FASTER, GAINS
from hitchid.errors import InputError
from hitchid.live import AdaptationSettings, Adapter, Changes, changed_model
from hitchid.live.parameters import SPOOL_LAG, has_lag, lag_index
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model import load, save
from hitchid.structures import PhysicalModel, structure_named
from machine import DIRECTIONS
from truth import levels

CHANGES = {LIFTING: Changes(0.1, 0.02), LOWERING: Changes(-0.2, -0.03)}
MODEL = handmade.with_bands(
    handmade.hitch("integrator-second-order", compensated=True, free_run=True, baselines=True), *DIRECTIONS
)


def commands(seed=0, samples=400):
    """Return lifting and then lowering at levels of all sizes, shape [N, 2]."""
    rng = np.random.default_rng(seed)
    up, down = levels(rng, samples // 2), levels(rng, samples // 2)
    return np.stack([np.concatenate([up, 0 * down]), np.concatenate([0 * up, down])], axis=1)


def simulated(*models, rows=None):
    """Return the simulation of each of some models."""
    rows = commands() if rows is None else rows
    return (model.simulate(rows, step_s=0.01, initial=100.0) for model in models)


def test_without_changes_it_is_the_same_model_bit_for_bit():
    same = changed_model(MODEL, {LIFTING: Changes(), LOWERING: Changes()}, {LIFTING: 1.0})
    assert dict(same.channels) == dict(MODEL.channels)
    assert (same.uncertainty, same.rivals) == (MODEL.uncertainty, MODEL.rivals)
    assert same.provenance.adapted == {}
    own, expected = simulated(same, MODEL)
    np.testing.assert_array_equal(own.displacement, expected.displacement)
    np.testing.assert_array_equal(own.band(0.9).upper, expected.band(0.9).upper)


@pytest.mark.parametrize("lifting", [(-0.5, 0.06), (0.0, -0.03), (0.4, 0.0)])
def test_it_moves_as_a_machine_with_these_changes(lifting):
    changes = {LIFTING: Changes(*lifting), LOWERING: Changes(0.3, -0.02)}
    changed = changed_model(machine.MODEL, changes)
    for mode in DIRECTIONS:
        driven = commands(1, 200) * np.array([mode == LIFTING, mode == LOWERING])
        displacement = changed.simulate(driven, step_s=0.01, initial=100.0).displacement
        gain, dead_zone, _ = changes[mode]
        expected = machine.moved(100.0, driven, np.exp(gain), dead_zone)
        np.testing.assert_allclose(displacement, expected, rtol=1e-12)


def test_a_changed_direction_leaves_the_other_one_as_it_is():
    changed = changed_model(MODEL, {LIFTING: CHANGES[LIFTING]})
    assert changed.channels[LOWERING] == MODEL.channels[LOWERING]
    assert changed.uncertainty[LOWERING] == MODEL.uncertainty[LOWERING]
    assert list(changed.rivals) == [LOWERING]
    assert list(changed.provenance.adapted) == [LIFTING]
    own, expected = simulated(changed, MODEL, rows=commands() * [0, 1])
    np.testing.assert_array_equal(own.displacement, expected.displacement)


@pytest.mark.parametrize("mode", DIRECTIONS)
def test_only_gain_and_dead_zone_move(mode):
    old, new = MODEL.channels[mode], changed_model(MODEL, CHANGES).channels[mode]
    for name in ("compensator", "speed_compensator", "operating_range", "load_filter"):
        assert eqx.tree_equal(getattr(old, name), getattr(new, name))
    gain, dead_zone, _ = CHANGES[mode]
    assert new.dead_zone == old.dead_zone + dead_zone
    np.testing.assert_allclose(new.benchmark.values[0], np.exp(gain) * GAINS[mode], rtol=1e-15)
    np.testing.assert_array_equal(new.benchmark.values[1:], old.benchmark.values[1:])


def test_the_spool_lag_is_multiplied_and_the_curves_stay():
    lagged = handmade.hitch(shape=True).channels[LIFTING]
    curves = lagged.benchmark.nonlinearity.values.at[SPOOL_LAG].set(0.03)
    nonlinearity = replace(lagged.benchmark.nonlinearity, values=curves)
    lagged = replace(lagged, benchmark=replace(lagged.benchmark, nonlinearity=nonlinearity))
    assert has_lag(lagged)
    assert not has_lag(machine.MODEL.channels[LIFTING])
    changed = changed_model(handmade.hitch_of(lagged), {LIFTING: Changes(0.0, 0.0, 0.5)})
    benchmark = changed.channels[LIFTING].benchmark
    expected = np.array(curves)
    expected[SPOOL_LAG] *= np.exp(0.5)
    np.testing.assert_allclose(benchmark.nonlinearity.values, expected, rtol=1e-15)
    np.testing.assert_array_equal(benchmark.values, lagged.benchmark.values)


@pytest.mark.parametrize(
    ("structure", "name"),
    [("integrator-first-order", "time_constant"), ("integrator-second-order", "damping_ratio")],
)
def test_the_lag_of_a_structure_is_multiplied(structure, name):
    model = handmade.hitch(structure)
    channel = model.channels[LIFTING]
    number = [parameter.name for parameter in channel.benchmark.structure.parameters].index(name)
    assert has_lag(channel)
    assert lag_index(channel.benchmark) == number
    changed = changed_model(model, {LIFTING: Changes(0.0, 0.0, 0.5)}).channels[LIFTING].benchmark
    expected = np.array(channel.benchmark.values)
    expected[number] *= np.exp(0.5)
    np.testing.assert_allclose(changed.values, expected, rtol=1e-15)


def test_ensembles_and_bands_follow():
    changed = changed_model(MODEL, CHANGES, {LIFTING: 1.5})
    for mode, factor in ((LIFTING, 1.5), (LOWERING, 1.0)):
        bands, before = changed.bands[mode], MODEL.bands[mode]
        (member,) = bands.ensemble
        benchmark = np.array(changed.channels[mode].benchmark.parameter_vector)
        faster = benchmark * [FASTER, *np.ones(benchmark.size - 1)]
        multipliers = factor * np.array(before.predictions.multipliers)
        np.testing.assert_allclose(member.benchmark, faster, rtol=1e-15)
        np.testing.assert_allclose(bands.free_run, factor * np.array(before.free_run), rtol=1e-15)
        np.testing.assert_allclose(bands.predictions.multipliers, multipliers, rtol=1e-15)
        assert (bands.noise, bands.levels, bands.tests) == (before.noise, before.levels, before.tests)


def test_a_factor_on_the_bands_alone_changes_the_bands_alone():
    own, expected = simulated(changed_model(MODEL, {LIFTING: Changes()}, {LIFTING: 2.0}), MODEL)
    np.testing.assert_array_equal(own.displacement, expected.displacement)
    wide, narrow = (run.band(0.9).upper - run.displacement for run in (own, expected))
    assert np.all(wide >= narrow)
    assert wide.max() > 1.2 * narrow.max()


def test_it_is_saved_with_what_was_adapted(tmp_path):
    save(MODEL, tmp_path / "identified")
    assert "adapted" not in (tmp_path / "identified" / "model.json").read_text()
    identified = load(tmp_path / "identified")
    save(changed_model(identified, {LIFTING: Changes()}), tmp_path / "same")
    assert load(tmp_path / "same").provenance.digest == identified.provenance.digest

    changed = changed_model(identified, CHANGES, {LOWERING: 1.25})
    assert changed.provenance.digest == ""
    save(changed, tmp_path / "changed")
    again = load(tmp_path / "changed")
    assert again.provenance.digest not in ("", identified.provenance.digest)
    assert again.provenance.adapted == {
        LIFTING: {"gain": 0.1, "dead_zone": 0.02, "lag": 0.0, "band_factor": 1.0},
        LOWERING: {"gain": -0.2, "dead_zone": -0.03, "lag": 0.0, "band_factor": 1.25},
    }
    own, expected = simulated(again, changed)
    np.testing.assert_array_equal(own.displacement, expected.displacement)
    assert again.dead_zones == {mode: DEAD_ZONES[mode] + CHANGES[mode].dead_zone for mode in DIRECTIONS}


def test_a_model_that_cannot_be_adapted_is_refused():
    changed = changed_model(machine.MODEL, CHANGES)
    with pytest.raises(InputError, match=r"^model: expected one as identified, got one that was adapted"):
        Adapter(changed, AdaptationSettings())
    tanks = structure_named("cascaded-tanks")
    benchmark = PhysicalModel(tanks, jnp.array([0.1, 0.1, 0.1, 5.0]), jnp.zeros(()))
    model = handmade.hitch_of(replace(handmade.channel(LIFTING), benchmark=benchmark))
    with pytest.raises(InputError, match=r"^lifting: structure 'cascaded-tanks' has no gain behind a dead z"):
        Adapter(model, AdaptationSettings())
