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


def record(model):
    """Return what a noisy sensor reads of the model's own free run."""
    run = np.asarray(model.simulate(ROWS, step_s=STEP_S, initial=100.0))
    noisy = run + 0.05 * np.random.default_rng(1).standard_normal(len(run))
    noisy[0] = 100.0
    signals = {"displacement": noisy, "lifting_command": ROWS[:, 0], "lowering_command": ROWS[:, 1]}
    units = {"displacement": "mm", "lifting_command": "A", "lowering_command": "A"}
    return hitchid.Record("r", STEP_S, signals, units)


def blocks_of(log):
    """Return commands and displacement of each block of a log."""
    return [(ROWS[k : k + BLOCK], log.displacement[k : k + BLOCK]) for k in range(0, len(ROWS), BLOCK)]


MODEL = handmade.with_bands(handmade.hitch("integrator-second-order"), LIFTING, LOWERING)
ROWS = commands()


@pytest.fixture(scope="module")
def log():
    return record(MODEL)


@pytest.fixture(scope="module")
def predictions(log):
    """Return what a monitor says of the log, block by block."""
    monitor = Monitor(MODEL, 100.0, block=BLOCK, horizon_s=HORIZON * STEP_S)
    return [monitor.advance(*block) for block in blocks_of(log)]


def test_the_free_run_is_the_simulation(predictions):
    simulation = MODEL.simulate(ROWS, step_s=STEP_S, initial=100.0)
    free_run = np.concatenate([block.free_run for block in predictions])
    np.testing.assert_allclose(free_run, simulation.displacement, rtol=0, atol=ROUNDING)
    half_width = np.concatenate([block.free_run_half_width for block in predictions])
    band = simulation.band(0.9)
    np.testing.assert_allclose(half_width, (band.upper - band.lower) / 2, rtol=0, atol=ROUNDING)
    assert half_width[-1] > 2 * half_width[0]


def test_the_prediction_ahead_is_that_of_the_model(log, predictions):
    target = np.arange(BLOCK - 1, BLOCK * BLOCKS, BLOCK) + HORIZON
    inside = target < len(log)
    # `predictions` knows the commands to come; where they do not change until the target both must agree.
    held = [bool(np.all(ROWS[k - HORIZON : k] == ROWS[k - HORIZON])) for k in target[inside]]
    assert sum(held) > 20
    band = MODEL.band(log, horizon=HORIZON, coverage=0.9)
    for name, expected in (
        ("ahead", MODEL.predictions(log, (HORIZON,))[0]),
        ("ahead_half_width", (band.upper - band.lower) / 2),
    ):
        difference = (
            np.array([getattr(block, name) for block in predictions])[inside] - expected[target[inside]]
        )
        np.testing.assert_allclose(difference[held], 0, atol=ROUNDING)


def test_a_restart_forgets_the_past(log):
    model, blocks = handmade.hitch("integrator"), blocks_of(log)
    monitor = Monitor(model, 100.0, block=BLOCK)
    for block in blocks[:15]:
        monitor.advance(*block)
    monitor.restart(100.0)
    again, first = monitor.advance(*blocks[0]), Monitor(model, 100.0, block=BLOCK).advance(*blocks[0])
    np.testing.assert_array_equal(again.free_run, first.free_run)
    assert again.ahead == first.ahead
    assert np.isnan([*again.free_run_half_width, again.ahead_half_width]).all()


def test_an_adapted_model_takes_over_and_compiles_nothing(caplog):
    """It predicts as if it had been there from the start."""
    still = np.zeros((BLOCK, 2)), np.full(BLOCK, 100.0)
    changes = {LIFTING: Changes(0.2, -0.05), LOWERING: Changes(-0.1, 0.03)}
    adapted = changed_model(MODEL, changes, {LIFTING: 1.5})
    blocks = blocks_of(record(adapted))
    fresh, monitor = (Monitor(model, 100.0, block=BLOCK) for model in (adapted, MODEL))
    fresh.advance(*still)
    expected = [fresh.advance(*block) for block in blocks]
    monitor.advance(*still)
    with jax.log_compiles():
        monitor.adjust(adapted)
        predictions = [monitor.advance(*block) for block in blocks]
    compiled = [entry.message for entry in caplog.records if entry.message.startswith("Compiling")]
    assert not [text for text in compiled if "_advance" in text or "_ahead" in text]
    for own, other in zip(predictions, expected, strict=True):
        for value, wanted in zip(own, other, strict=True):
            np.testing.assert_allclose(value, wanted, rtol=0, atol=ROUNDING)


def test_a_block_of_another_size_is_refused():
    monitor = Monitor(handmade.hitch("integrator"), 100.0, block=BLOCK)
    with pytest.raises(InputError, match=r"expected shapes \(4, 2\) and \(4,\), got \(3, 2\) and \(4,\)"):
        monitor.advance(np.zeros((3, 2)), np.zeros(4))
