"""Tests side by side: padding, selection, start, end stop."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.logs.record import LIFTING
from hitchid.structures import Batch, PhysicalModel, before_end_stop, structure_named
from hitchid.structures.batch import mean_before_motion
from truth import STEP_S, levels

EPS = np.finfo(np.float64).eps
BENCHMARK = PhysicalModel(
    structure_named("integrator-second-order"), jnp.array([21.0, 18.0, 0.4]), jnp.asarray(0.013)
)


@eqx.filter_jit
def respond(batch):
    return BENCHMARK.response(batch.command, STEP_S)


@pytest.fixture
def records(make_record):
    """Return tests of 100, 180 and 300 samples: the last is padded to 512, the others alone to 256."""
    rng = np.random.default_rng(0)
    return [
        make_record(5.0 + np.cumsum(rng.uniform(0, 1, size)), levels(rng, size), 0 * levels(rng, size))
        for size in (100, 180, 300)
    ]


def laid(records, **options):
    return Batch.of(records, LIFTING, **{"dead_zone": 0.2, "sign": 1, **options})


def test_a_longer_neighbour_changes_nothing(records):
    together = laid(records, end_stop=60.0)
    assert together.command.shape == (3, 512)
    response = np.asarray(respond(together))
    for row, record in enumerate(records):
        alone = laid([record], end_stop=60.0)
        size = len(record)
        for name in ("command", "displacement", "valid", "loss_mask", "travel"):
            np.testing.assert_array_equal(getattr(together, name)[row, :size], getattr(alone, name)[0, :size])
        assert together.initial[row] == alone.initial[0]
        lonely = np.asarray(respond(alone))[0, :size]
        # The same sums in programs of two shapes: rounding of each of the additions at most.
        np.testing.assert_allclose(response[row, :size], lonely, rtol=0, atol=size * EPS * lonely.max())


def test_a_batch_holds_effective_command_and_displacement(records):
    batch = laid(records)
    for row, record in enumerate(records):
        beyond = np.maximum(record.command(LIFTING) - 0.2, 0.0)
        np.testing.assert_array_equal(batch.command[row, : len(record)], beyond)
        np.testing.assert_array_equal(batch.displacement[row, : len(record)], record.displacement)
        np.testing.assert_array_equal(batch.raw_command[row, : len(record)], record.command(LIFTING))
        # Padding is neither valid nor counted.
        for name in ("valid", "loss_mask"):
            np.testing.assert_array_equal(getattr(batch, name)[row], np.arange(512) < len(record))
        assert not np.any(batch.command[row, len(record) :])
    np.testing.assert_array_equal(batch.dead_zone, [0.2, 0.2, 0.2])
    assert batch.step_s == STEP_S


def test_the_second_input_counts_as_its_mean_before_motion(records):
    # From each record's first effective command on, the second input is something else.
    means = []
    for level, record in zip((3.0, -7.0, 120.0), records, strict=True):
        moving = int(np.flatnonzero(record.command(LIFTING) > 0.2)[0])
        wobble = np.where(np.arange(len(record)) % 2 == 0, 0.5, -0.5)
        pressure = np.where(np.arange(len(record)) <= moving, level + wobble, 1e6)
        means.append(level + wobble[: min(moving + 1, 50)].mean())
        signals = {**record.signals, "pressure": pressure}
        records[records.index(record)] = replace(
            record, signals=signals, units={**record.units, "pressure": "bar"}
        )
    batch = laid(records, covariates=["pressure"])
    assert batch.covariates.shape == (3, 1)
    np.testing.assert_allclose(batch.load(["pressure"])[:, 0], means, rtol=1e-12)
    assert laid(records).covariates.shape == (3, 0)
    np.testing.assert_array_equal(laid(records).load([]), np.zeros((3, 1)))


@pytest.mark.parametrize("most", [100, 171, 512])
def test_a_thinned_batch_keeps_the_integral_of_commands(records, most):
    batch = laid(records, end_stop=60.0)
    thin = batch.decimate(most)
    count = thin.command.shape[1]
    assert count <= most
    factor = round(thin.step_s / batch.step_s)
    assert thin.step_s == pytest.approx(factor * STEP_S, rel=1e-15)
    # No coarser than it must be.
    assert factor == 1 or (factor - 1) * most < 512
    for name in ("command", "raw_command"):
        whole, rough = (np.asarray(getattr(each, name)) for each in (batch, thin))
        expected = [
            np.pad(row, (0, count * factor - 512)).reshape(count, factor).sum(axis=1) for row in whole
        ]
        np.testing.assert_allclose(factor * rough, expected, rtol=0, atol=factor * EPS)
        np.testing.assert_allclose(
            thin.step_s * rough.sum(axis=1), STEP_S * whole.sum(axis=1), rtol=512 * EPS, atol=0
        )
    for name in ("initial", "covariates", "dead_zone"):
        np.testing.assert_array_equal(getattr(thin, name), getattr(batch, name))
    for name in ("displacement", "valid", "loss_mask"):
        np.testing.assert_array_equal(getattr(thin, name), np.asarray(getattr(batch, name))[:, ::factor])
    assert thin.sign == batch.sign


def test_an_integrator_answers_a_thinned_batch_exactly(records):
    """∫u dt at the coarse samples is the same sum, so that K/s has not lost anything."""
    model = PhysicalModel(structure_named("integrator"), jnp.array([21.0]), jnp.asarray(0.0))
    batch = laid(records)
    computed = np.asarray(model.travel(batch.decimate(128)))
    whole = np.asarray(model.travel(batch))[:, ::4]
    np.testing.assert_allclose(computed, whole, rtol=0, atol=512 * EPS * whole.max())


@pytest.mark.parametrize(("tests", "samples"), [(3, 512), (64, 512), (128, 256), (400, 256)])
def test_the_coarse_clock_of_many_tests_is_coarser(records, tests, samples):
    batch = laid(records).take([0] * tests)
    assert batch.coarse().command.shape == (tests, samples)


@pytest.mark.parametrize("direction", [1, -1])
def test_displaced_undoes_travel(records, direction):
    batch = laid(records, sign=direction)
    travel = np.asarray(batch.travel)
    assert np.sign(travel[2, 299]) == direction
    back = np.asarray(batch.to_displacement(batch.travel))
    np.testing.assert_allclose(back, batch.displacement, rtol=0, atol=2 * EPS * np.abs(back).max())


def test_take_keeps_whole_tests_in_the_order_asked_for(records):
    batch = laid(records, end_stop=60.0)
    some = batch.take([2, 0])
    signals = ("command", "raw_command", "displacement", "valid", "loss_mask")
    for name in (*signals, "dead_zone", "initial", "covariates"):
        np.testing.assert_array_equal(getattr(some, name), np.asarray(getattr(batch, name))[[2, 0]])
    assert (some.step_s, some.sign) == (batch.step_s, batch.sign)


def test_counting_takes_samples_away_and_never_adds_any(records):
    batch = laid(records, end_stop=60.0)
    mask = jnp.arange(512)[None, :] % 2 == jnp.zeros((3, 1), int)
    np.testing.assert_array_equal(
        batch.masked(mask).loss_mask, np.asarray(batch.loss_mask) & np.asarray(mask)
    )
    everything = batch.masked(jnp.ones_like(batch.loss_mask))
    np.testing.assert_array_equal(everything.loss_mask, batch.loss_mask)


@given(rest=st.integers(0, 120), size=st.integers(121, 200), level=st.floats(-100, 100))
def test_the_start_is_the_mean_before_motion(rest, size, level):
    displacement = level + np.random.default_rng(size).normal(size=size)
    effective = np.where(np.arange(size) < rest, 0.0, 0.3)
    at_rest = displacement[: min(rest + 1, 50)]
    expected = sum(at_rest.tolist()) / at_rest.size
    assert mean_before_motion(displacement, effective) == pytest.approx(expected, abs=1e-12)


def test_without_motion_fifty_samples_give_the_start(records):
    np.testing.assert_array_equal(laid(records, initial=[1.0, 2.0, 3.0]).initial, [1.0, 2.0, 3.0])
    displacement = np.concatenate([np.full(50, 3.0), np.full(50, 99.0)])
    assert mean_before_motion(displacement, np.zeros(100)) == 3.0
    assert mean_before_motion(displacement[:20], np.zeros(20)) == 3.0


@pytest.mark.parametrize("direction", [1, -1])
def test_samples_count_until_the_end_stop_is_near(direction):
    way = np.concatenate([np.arange(0.0, 101.0), np.arange(100.0, 50.0, -1.0)])
    counted = before_end_stop(7.0 + direction * way, direction, 7.0 + direction * 100.0)
    # 99 of 100 leaves 1 %; what follows the contact never counts again, not even on the way back.
    np.testing.assert_array_equal(counted, np.arange(way.size) < 99)
    assert before_end_stop(way, direction, None).all()
    assert before_end_stop(direction * np.linspace(0.0, 98.0, 50), direction, direction * 100.0).all()
    for start in (100.0, 101.0):
        beyond = direction * np.linspace(start, 90.0, 30)
        assert not before_end_stop(beyond, direction, direction * 100.0).any()
