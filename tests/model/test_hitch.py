"""The whole plant: switching, units, clocks, precision."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from handmade import DEAD_ZONES, ERROR_STEP, GAINS, hitch
from hitchid.errors import InputError
from hitchid.logs.record import CYCLE, LIFTING, LOWERING
from truth import STEP_S, levels

EPS = np.finfo(np.float64).eps
SAMPLES = 250
UP, DOWN = (GAINS[mode] for mode in (LIFTING, LOWERING))
DEAD_UP, DEAD_DOWN = (DEAD_ZONES[mode] for mode in (LIFTING, LOWERING))


def commands_of(pieces, *, rest=0):
    """Return both commands of pieces (what, level, samples), shape [N] each, with rest before reversals."""
    lifting, lowering = np.zeros(SAMPLES), np.zeros(SAMPLES)
    at, before = 5, "hold"
    for what, level, samples in pieces:
        at += rest if "hold" not in (what, before) and what != before else 0
        before = what
        if what != "hold":
            (lifting if what == "up" else lowering)[at : at + samples] = level
        at += samples
    return lifting, lowering


def speed_of(lifting, lowering):
    """Return the speed of two integrators behind their dead zones, mm/s, shape [N]."""
    return UP * np.maximum(lifting - DEAD_UP, 0) - DOWN * np.maximum(lowering - DEAD_DOWN, 0)


def travelled(speed, start=100.0):
    """Return the integral of a speed held between samples, shape [N]."""
    return start + STEP_S * np.concatenate([[0.0], np.cumsum(speed)[:-1]])


pieces = st.lists(
    st.tuples(st.sampled_from(["up", "down", "hold"]), st.floats(0.5, 1.0), st.integers(1, 60)),
    min_size=1,
    max_size=12,
)
INTEGRATORS = hitch()
SMOOTH = {False: hitch("integrator-first-order"), True: hitch("integrator-first-order", compensated=True)}
reuse = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


def assert_exact(make_record, lifting, lowering):
    exact = travelled(speed_of(lifting, lowering))
    found = INTEGRATORS.simulate(make_record(exact, lifting, lowering)).displacement
    # Sums of 250 numbers around 100.
    np.testing.assert_allclose(found, exact, rtol=0, atol=SAMPLES * EPS * 150)


@reuse
@given(pieces=pieces)
def test_a_cycle_moves_by_the_sum_of_what_its_commands_ask_for(make_record, pieces):
    assert_exact(make_record, *commands_of(pieces, rest=1))


@pytest.mark.parametrize("first", ["up", "down"])
def test_a_reversal_without_rest_loses_nothing_of_the_last_command_before_it(make_record, first):
    second = "down" if first == "up" else "up"
    assert_exact(make_record, *commands_of([(first, 0.9, 40), (second, 0.8, 40)]))


@pytest.mark.parametrize("compensated", [False, True])
@reuse
@given(pieces=pieces)
def test_a_free_run_is_continuous_at_mode_changes(make_record, compensated, pieces):
    lifting, lowering = commands_of(pieces)
    found = SMOOTH[compensated].simulate(make_record(np.full(SAMPLES, 100.0), lifting, lowering)).displacement
    # No speed exceeds gain times effective command; the compensator adds σ times the sum of its weights,
    # twice where it starts afresh from zero.
    fastest = STEP_S * UP * (1.0 - DEAD_UP)
    network = hitch(compensated=True).channels[LIFTING].compensator.network
    said = ERROR_STEP * (float(jnp.abs(network.head.weight).sum()) + abs(float(network.head.bias[0])))
    assert np.abs(np.diff(found)).max() <= fastest + (said if compensated else 0.0) + 1e-9
    assert found[0] == pytest.approx(100.0, abs=1e-12)


def test_lowering_counts_where_both_commands_are_effective(make_record):
    lifting, lowering = commands_of([("up", 0.8, 60), ("hold", 0.0, 10), ("down", 0.9, 60)])
    lifting[75:100] = 0.7
    alone = commands_of([("up", 0.8, 60), ("hold", 0.0, 10), ("down", 0.9, 60)])[0]
    record = make_record(np.full(SAMPLES, 100.0), lifting, lowering)
    exact = travelled(speed_of(alone, lowering))
    np.testing.assert_allclose(
        INTEGRATORS.simulate(record).displacement, exact, rtol=0, atol=SAMPLES * EPS * 150
    )


@pytest.mark.parametrize("compensated", [None, False])
@pytest.mark.parametrize("horizon", [1, 3])
def test_an_untrained_compensator_moves_the_benchmark_to_the_last_measurement(
    make_record, compensated, horizon
):
    model = hitch("integrator-first-order", compensated=compensated)
    rng = np.random.default_rng(0)
    command = levels(rng, SAMPLES, low=0.3)
    measured = 100 + np.cumsum(0.2 * rng.uniform(size=SAMPLES))
    record = make_record(measured, command, 0 * command)
    benchmark = model.simulate(record, compensated=False).displacement
    expected = measured[:-horizon] + benchmark[horizon:] - benchmark[:-horizon]
    found = model.predict(record, horizon=horizon)
    np.testing.assert_allclose(found[horizon:], expected, rtol=0, atol=1e-12)
    # The first samples have no measurement so far back: they are predicted from the first one.
    np.testing.assert_allclose(
        found[1:horizon], (measured[0] + benchmark - benchmark[0])[1:horizon], rtol=0, atol=1e-12
    )


@pytest.mark.parametrize("structure", ["integrator", "integrator-first-order", "integrator-second-order"])
@pytest.mark.parametrize("command", [0.0, 0.3, 0.35])
def test_a_command_within_the_dead_zone_leaves_the_piston_standing(make_record, structure, command):
    record = make_record(np.full(SAMPLES, 87.5), np.full(SAMPLES, command), np.zeros(SAMPLES))
    np.testing.assert_array_equal(hitch(structure).simulate(record).displacement, np.full(SAMPLES, 87.5))


def test_the_benchmark_does_not_pass_its_end_stop(make_record):
    model = hitch(modes=(LIFTING,), end_stop=110.0)
    command = np.full(SAMPLES, 0.85)
    found = model.simulate(make_record(np.full(SAMPLES, 100.0), command)).displacement
    exact = np.minimum(travelled(np.full(SAMPLES, UP * 0.5)), 110.0)
    assert exact[-1] == 110.0
    np.testing.assert_allclose(found, exact, rtol=0, atol=SAMPLES * EPS * 150)


def test_other_units_give_the_same_motion_in_the_units_of_the_record(make_record):
    model = hitch("integrator-first-order", compensated=True)
    lifting, lowering = commands_of([("up", 0.8, 60), ("hold", 0.0, 10), ("down", 0.9, 60)])
    measured = travelled(speed_of(lifting, lowering))
    ours = make_record(measured, lifting, lowering)
    theirs = replace(
        make_record(measured / 1000.0, 1000.0 * lifting, 1000.0 * lowering),
        units={"displacement": "m", "lifting_command": "mA", "lowering_command": "mA"},
    )
    # Conversion rounds; the compensator's single precision makes up to ten times σ 1e-6 of it.
    tolerance = 10 * ERROR_STEP * 1e-6
    for run in (model.simulate, model.predict):
        in_millimetres = 1000.0 * np.asarray(run(theirs))
        np.testing.assert_allclose(in_millimetres, run(ours), rtol=0, atol=tolerance)
    wrong = replace(theirs, units={**theirs.units, "displacement": "rad"})
    with pytest.raises(InputError, match="unit of angle"):
        model.simulate(wrong)


def test_a_record_at_twice_the_rate_is_resampled_and_answered_at_its_own(make_record):
    lifting, lowering = commands_of([("up", 0.8, 60), ("hold", 0.0, 10), ("down", 0.9, 60)])
    exact = travelled(speed_of(lifting, lowering))
    slow = make_record(exact, lifting, lowering)
    fast = make_record(np.repeat(exact, 2), np.repeat(lifting, 2), np.repeat(lowering, 2), step_s=0.005)
    found = INTEGRATORS.simulate(fast).displacement
    assert found.shape == (2 * SAMPLES,)
    np.testing.assert_allclose(found[::2], INTEGRATORS.simulate(slow).displacement, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found[1:-1:2], (found[:-2:2] + found[2::2]) / 2, rtol=0, atol=1e-12)


@pytest.mark.parametrize("drift", [0.002, -0.002])
def test_a_clock_that_differs_by_less_than_a_sample_over_the_record_is_answered_at_its_own(
    make_record, drift
):
    # Constant speed, so that interpolation is exact; the clocks part by half a sample in the end.
    step_s = STEP_S * (1 + drift)
    command = np.where(np.arange(SAMPLES) < 5, 0.0, 0.85)
    record = make_record(np.full(SAMPLES, 100.0), command, 0 * command, step_s=step_s)
    found = INTEGRATORS.simulate(record).displacement
    late = (found[-3] - found[-53]) / (50 * step_s)
    assert late == pytest.approx(UP * 0.5, rel=1e-6)


def test_a_model_of_one_channel_refuses_a_record_that_needs_the_other(make_record):
    model = hitch(modes=(LIFTING,))
    lifting, lowering = commands_of([("up", 0.8, 60), ("hold", 0.0, 10), ("down", 0.9, 60)])
    record = make_record(np.full(SAMPLES, 100.0), lifting, lowering)
    for kind, signals in ((CYCLE, (lifting, lowering)), (LOWERING, (0 * lifting, lowering))):
        other = replace(make_record(record.displacement, *signals), kind=kind)
        for run in (model.simulate, model.predict):
            with pytest.raises(InputError, match="no lowering channel"):
                run(other)
    with pytest.raises(InputError, match=r"commands for lowering.*for lifting"):
        model.simulate(make_record(record.displacement, None, lowering))


def test_a_model_of_one_channel_refuses_an_effective_command_it_cannot_hear_whatever_the_kind(make_record):
    lifting, lowering = commands_of([("up", 0.8, 60), ("hold", 0.0, 10), ("down", 0.9, 60)])
    with pytest.raises(InputError):
        hitch(modes=(LIFTING,)).simulate(make_record(np.full(SAMPLES, 100.0), lifting, lowering))


@pytest.mark.parametrize("horizon", [0, -1])
def test_a_horizon_below_one_sample_is_refused(make_record, horizon):
    record = make_record(np.full(SAMPLES, 100.0), np.zeros(SAMPLES), np.zeros(SAMPLES))
    with pytest.raises(InputError, match=f"horizon: .*at least 1.* {horizon}"):
        INTEGRATORS.predict(record, horizon=horizon)


def test_a_caller_in_single_precision_gets_double_and_stays_in_single(make_record):
    lifting, lowering = commands_of([("up", 0.8, 60), ("hold", 0.0, 10), ("down", 0.9, 60)])
    record = make_record(travelled(speed_of(lifting, lowering)), lifting, lowering)
    model = SMOOTH[True]
    expected = model.simulate(record).displacement, model.predict(record)
    with jax.enable_x64(False):
        found = model.simulate(record).displacement, model.predict(record)
        assert jnp.zeros(1).dtype == jnp.float32
        assert not jax.config.jax_enable_x64
    for ours, theirs in zip(found, expected, strict=True):
        assert ours.dtype == np.float64
        np.testing.assert_array_equal(ours, theirs)


def test_dead_zones_are_told_by_mode_and_mappings_are_frozen():
    assert INTEGRATORS.dead_zones == DEAD_ZONES
    with pytest.raises(TypeError):
        INTEGRATORS.channels[LIFTING] = None
    with pytest.raises(TypeError):
        INTEGRATORS.units["displacement"] = "m"
