"""The whole plant: switching, units, clocks, precision."""

from dataclasses import replace

import numpy as np
import pytest

from handmade import DEAD_ZONES, ERROR_STEP, GAINS, hitch
from hitchid.errors import InputError
from hitchid.logs.record import CYCLE, LIFTING, LOWERING
from machine import moved
from truth import STEP_S, levels

EPS = np.finfo(np.float64).eps
SAMPLES = 250
UP, DOWN = (GAINS[mode] for mode in (LIFTING, LOWERING))
DEAD_UP, DEAD_DOWN = (DEAD_ZONES[mode] for mode in (LIFTING, LOWERING))


INTEGRATORS = hitch()


def rise_and_fall(rest=10):
    """Return both commands, shape [N] each: lifting, some samples of rest, lowering."""
    lifting, lowering = np.zeros(SAMPLES), np.zeros(SAMPLES)
    lifting[5:65], lowering[65 + rest : 125 + rest] = 0.8, 0.9
    return lifting, lowering


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
    simulated = model.predict(record, horizon=horizon)
    np.testing.assert_allclose(simulated[horizon:], expected, rtol=0, atol=1e-12)
    # The first samples have no measurement so far back: they are predicted from the first one.
    np.testing.assert_allclose(
        simulated[1:horizon], (measured[0] + benchmark - benchmark[0])[1:horizon], rtol=0, atol=1e-12
    )


@pytest.mark.parametrize("structure", ["integrator", "integrator-first-order", "integrator-second-order"])
def test_a_command_within_the_dead_zone_leaves_the_piston_standing(make_record, structure):
    command = np.resize(np.repeat([0.0, 0.3, DEAD_UP], 9), SAMPLES)
    record = make_record(np.full(SAMPLES, 87.5), command, np.zeros(SAMPLES))
    np.testing.assert_array_equal(hitch(structure).simulate(record).displacement, np.full(SAMPLES, 87.5))


def test_other_units_give_the_same_motion_in_those_units(make_record):
    model = hitch("integrator-first-order", compensated=True)
    lifting, lowering = rise_and_fall()
    measured = moved(100.0, np.stack([lifting, lowering], axis=1))
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


def test_a_record_at_twice_the_rate_is_answered_at_it(make_record):
    lifting, lowering = rise_and_fall()
    exact = moved(100.0, np.stack([lifting, lowering], axis=1))
    slow = make_record(exact, lifting, lowering)
    fast = make_record(np.repeat(exact, 2), np.repeat(lifting, 2), np.repeat(lowering, 2), step_s=0.005)
    simulated = INTEGRATORS.simulate(fast).displacement
    assert simulated.shape == (2 * SAMPLES,)
    np.testing.assert_allclose(simulated[::2], INTEGRATORS.simulate(slow).displacement, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        simulated[1:-1:2], (simulated[:-2:2] + simulated[2::2]) / 2, rtol=0, atol=1e-12
    )


@pytest.mark.parametrize("drift", [0.002, -0.002])
def test_a_slightly_different_clock_is_answered_at_its_own(make_record, drift):
    # Constant speed, so that interpolation is exact; the clocks part by half a sample in the end.
    step_s = STEP_S * (1 + drift)
    command = np.where(np.arange(SAMPLES) < 5, 0.0, 0.85)
    record = make_record(np.full(SAMPLES, 100.0), command, 0 * command, step_s=step_s)
    simulated = INTEGRATORS.simulate(record).displacement
    assert (simulated[-3] - simulated[-53]) / (50 * step_s) == pytest.approx(UP * 0.5, rel=1e-6)


def test_a_model_of_one_channel_refuses_the_others_records(make_record):
    model = hitch(modes=(LIFTING,))
    lifting, lowering = rise_and_fall()
    record = make_record(np.full(SAMPLES, 100.0), lifting, lowering)
    others = [replace(record, kind=CYCLE), make_record(record.displacement, 0 * lifting, lowering)]
    for other in (record, others[0], replace(others[1], kind=LOWERING)):
        for run in (model.simulate, model.predict):
            with pytest.raises(InputError, match="no lowering channel"):
                run(other)
    with pytest.raises(InputError, match=r"commands for lowering.*for lifting"):
        model.simulate(make_record(record.displacement, None, lowering))


def test_a_horizon_below_one_sample_is_refused(make_record):
    record = make_record(np.full(SAMPLES, 100.0), np.zeros(SAMPLES), np.zeros(SAMPLES))
    for horizon in (0, -1):
        with pytest.raises(InputError, match=f"horizon: .*at least 1.* {horizon}"):
            INTEGRATORS.predict(record, horizon=horizon)
