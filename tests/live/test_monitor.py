"""The monitor against the simulation and the predictions of whole records."""

import jax
import numpy as np
import pytest

import handmade
import hitchid
from hitchid.errors import InputError
from hitchid.live import Changes, Monitor, changed_model
from hitchid.logs.record import LIFTING, LOWERING

STEP_S, BLOCK, BLOCKS = handmade.STEP_S, 4, 75
HORIZON = 25
ROUNDING = 1e-9  # mm; double precision over 300 samples of 1e2 mm, as in tests/model/test_simulation.py


def commands():
    """Return lifting, a pause and lowering, shape [N, 2]."""
    rows = np.zeros((BLOCK * BLOCKS, 2))
    rows[20:120, 0], rows[170:280, 1] = 0.8, 0.7
    return rows


def record(model, rows):
    """Return what a noisy sensor reads of the model's own free run."""
    run = np.asarray(model.simulate(rows, step_s=STEP_S, initial=100.0))
    noisy = run + 0.05 * np.random.default_rng(1).standard_normal(len(run))
    noisy[0] = 100.0
    signals = {"displacement": noisy, "lifting_command": rows[:, 0], "lowering_command": rows[:, 1]}
    units = {"displacement": "mm", "lifting_command": "A", "lowering_command": "A"}
    return hitchid.Record("r", STEP_S, signals, units)


@pytest.fixture(scope="module", params=[False, True], ids=["no bands", "bands"])
def model(request):
    """Return a hitch of two directions, with and without bands."""
    plain = handmade.hitch("integrator-second-order")
    return handmade.with_bands(plain, LIFTING, LOWERING) if request.param else plain


def monitored(model, log, rows):
    """Return what a monitor says of a log, block by block."""
    monitor = Monitor(model, 100.0, block=BLOCK, horizon_s=HORIZON * STEP_S)
    starts = range(0, BLOCK * BLOCKS, BLOCK)
    return [monitor.advance(rows[k : k + BLOCK], log.displacement[k : k + BLOCK]) for k in starts]


def test_the_free_run_is_the_simulation(model):
    rows = commands()
    log = record(model, rows)
    simulation = model.simulate(rows, step_s=STEP_S, initial=100.0)
    blocks = monitored(model, log, rows)
    free_run = np.concatenate([block.free_run for block in blocks])
    np.testing.assert_allclose(free_run, simulation.displacement, rtol=0, atol=ROUNDING)
    half_width = np.concatenate([block.free_run_half_width for block in blocks])
    if model.has_bands:
        band = simulation.band(0.9)
        np.testing.assert_allclose(half_width, (band.upper - band.lower) / 2, rtol=0, atol=ROUNDING)
        assert half_width[-1] > 2 * half_width[0]
    else:
        assert np.isnan(half_width).all()


def test_the_prediction_ahead_is_that_of_the_model_while_the_command_is_held(model):
    rows = commands()
    log = record(model, rows)
    ahead = np.array([block.ahead for block in monitored(model, log, rows)])
    target = np.arange(BLOCK - 1, BLOCK * BLOCKS, BLOCK) + HORIZON
    expected = model.predictions(log, (HORIZON,))[0]
    inside = target < len(log)
    # `predictions` knows the commands to come; where they do not change until the target both must agree.
    held = [bool(np.all(rows[k - HORIZON : k] == rows[k - HORIZON])) for k in target[inside]]
    difference = ahead[inside] - expected[target[inside]]
    assert sum(held) > 20
    np.testing.assert_allclose(difference[held], 0, atol=ROUNDING)
    if model.has_bands:
        band = model.band(log, horizon=HORIZON, coverage=0.9)
        half = np.array([block.ahead_half_width for block in monitored(model, log, rows)])[inside]
        known = ((band.upper - band.lower) / 2)[target[inside]]
        np.testing.assert_allclose(half[held], known[held], rtol=0, atol=ROUNDING)


def test_a_restart_forgets_the_past():
    model = handmade.hitch("integrator")
    rows = commands()
    log = record(model, rows)
    monitor = Monitor(model, 100.0, block=BLOCK)
    for k in range(0, 60, BLOCK):
        monitor.advance(rows[k : k + BLOCK], log.displacement[k : k + BLOCK])
    monitor.restart(100.0)
    again = monitor.advance(rows[:BLOCK], log.displacement[:BLOCK])
    first = Monitor(model, 100.0, block=BLOCK).advance(rows[:BLOCK], log.displacement[:BLOCK])
    np.testing.assert_array_equal(again.free_run, first.free_run)
    assert again.ahead == first.ahead


def test_an_adapted_model_takes_over_as_if_it_had_been_there_and_compiles_nothing(model, caplog):
    rows, still = commands(), (np.zeros((BLOCK, 2)), np.full(BLOCK, 100.0))
    changes = {LIFTING: Changes(0.2, -0.05), LOWERING: Changes(-0.1, 0.03)}
    adapted = changed_model(model, changes, {LIFTING: 1.5})
    log = record(adapted, rows)
    blocks = [(rows[k : k + BLOCK], log.displacement[k : k + BLOCK]) for k in range(0, len(rows), BLOCK)]
    fresh, monitor = (Monitor(each, 100.0, block=BLOCK) for each in (adapted, model))
    fresh.advance(*still)
    expected = [fresh.advance(*block) for block in blocks]
    monitor.advance(*still)
    with jax.log_compiles():
        monitor.adjust(adapted)
        found = [monitor.advance(*block) for block in blocks]
    compiled = [each.message for each in caplog.records if each.message.startswith("Compiling")]
    assert not [text for text in compiled if "_advance" in text or "_ahead" in text]
    for mine, its in zip(found, expected, strict=True):
        for value, other in zip(mine, its, strict=True):
            np.testing.assert_allclose(value, other, rtol=0, atol=ROUNDING)


def test_a_block_of_another_size_is_refused():
    monitor = Monitor(handmade.hitch("integrator"), 100.0, block=BLOCK)
    with pytest.raises(InputError, match=r"expected shapes \(4, 2\) and \(4,\), got \(3, 2\) and \(4,\)"):
        monitor.advance(np.zeros((3, 2)), np.zeros(4))
