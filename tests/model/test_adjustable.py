"""A hitch in a loop whose numbers are exchanged, against models that have them from the start."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import handmade
from hitchid._support.precision import double_precision
from hitchid.live import Changes, changed_model
from hitchid.live.parameters import AdjustableHitch, numbers_of_models
from hitchid.logs.record import LIFTING, LOWERING
from truth import levels

CHANGES = {LIFTING: Changes(0.1, 0.02, 0.3), LOWERING: Changes(-0.2, -0.03, -0.1)}
START, SAMPLES = 100.0, 120
# Sums and products of a step, in double precision; the network of a compensator is of single precision.
ROUNDING = SAMPLES * 100 * float(np.finfo(np.float64).eps)
SINGLE = SAMPLES * handmade.ERROR_STEP * float(np.finfo(np.float32).eps)
MODELS = {
    "second-order": handmade.hitch("integrator-second-order", dead_time_s=0.02, end_stop=112.0),
    "networks": handmade.hitch("integrator-first-order", compensated=True, free_run=True, filtered=True),
    "curves": handmade.hitch_of(
        *(handmade.channel(mode, "integrator-first-order", shape=True) for mode in (LIFTING, LOWERING))
    ),
}


def inputs(seed=0):
    """Return commands, shape [N, 2], and displacements, of which every third is measured, shape [N]."""
    rng = np.random.default_rng(seed)
    commands = np.zeros((SAMPLES, 2))
    commands[: SAMPLES // 2, 0] = levels(rng, SAMPLES // 2, low=0.3)
    commands[SAMPLES // 2 :, 1] = levels(rng, SAMPLES // 2, low=0.2)
    moved = START + 0.1 * np.cumsum(commands @ [1.0, -1.0]) + 0.05 * rng.standard_normal(SAMPLES)
    return commands, np.where(np.arange(SAMPLES) % 3 == 0, moved, np.nan)


def stepped(step, state, commands, measured):
    """Return the last state and the displacement after each step."""
    displacements = []
    for command, sample in zip(commands, measured, strict=True):
        state, displacement = step(state, command, sample)
        displacements.append(float(displacement))
    return state, np.array(displacements)


@pytest.fixture(scope="module", params=MODELS)
def pair(request):
    """Return a model, one with other numbers, a load, an adjustable hitch of the first, and a tolerance."""
    model = MODELS[request.param]
    load = {"pressure": 150.0} if request.param == "curves" else None
    tolerance = SINGLE if request.param == "networks" else START * ROUNDING
    return model, changed_model(model, CHANGES), load, AdjustableHitch(model), tolerance


def test_it_steps_as_the_model_that_has_its_numbers(pair):
    model, changed, load, adjustable, tolerance = pair
    runs = []
    for own in (model, changed, model):
        state = adjustable.adjust(numbers_of_models(own), model.init_state(START, load))
        _, computed = stepped(adjustable.step, state, *inputs())
        _, expected = stepped(own.step, own.init_state(START, load), *inputs())
        np.testing.assert_allclose(computed, expected, rtol=0, atol=tolerance)
        runs.append(computed)
    np.testing.assert_array_equal(runs[2], runs[0])
    assert np.abs(runs[1] - runs[0]).max() > 1e3 * tolerance


def test_numbers_exchanged_and_back_again_change_nothing_else(pair):
    model, changed, load, adjustable, _ = pair
    (commands, measured), half = inputs(1), SAMPLES // 2
    start = adjustable.adjust(numbers_of_models(model), model.init_state(START, load))
    _, whole = stepped(adjustable.step, start, commands, measured)
    state, first = stepped(adjustable.step, start, commands[:half], measured[:half])
    same = adjustable.adjust(numbers_of_models(model), state)
    np.testing.assert_array_equal(same.numbers, state.numbers)
    there = adjustable.adjust(numbers_of_models(changed), state)
    _, moved = stepped(adjustable.step, there, commands[half:], measured[half:])
    back = adjustable.adjust(numbers_of_models(model), there)
    np.testing.assert_array_equal(back.numbers, state.numbers)
    _, rest = stepped(adjustable.step, back, commands[half:], measured[half:])
    np.testing.assert_array_equal(np.concatenate([first, rest]), whole)
    # No jump: within one sample it moves less than 0.5 mm.
    assert abs(moved[0] - rest[0]) < 0.5


def test_nothing_is_compiled_for_other_numbers(compilations):
    model = handmade.hitch("integrator-first-order", compensated=True, filtered=True)
    rows = [
        np.asarray(numbers_of_models(changed_model(model, {LIFTING: Changes(gain)}))) for gain in (0.1, 0.2)
    ]
    adjustable = AdjustableHitch(model)
    state = adjustable.adjust(rows[0], model.init_state(START))
    state, _ = adjustable.step(state, np.zeros(2), START)
    with compilations() as compiled:
        state = adjustable.adjust(rows[1], state)
        adjustable.step(state, np.array([0.5, 0.0]), START)
    assert compiled == []


@double_precision
def test_numbers_of_models_are_those_of_the_step_size():
    model = MODELS["second-order"]
    assert not np.array_equal(numbers_of_models(model), numbers_of_models(replace(model, step_s=0.02)))
    leaves = jax.tree.leaves(numbers_of_models(model))
    assert all(leaf.dtype == np.float64 and leaf.ndim == 1 for leaf in leaves)
