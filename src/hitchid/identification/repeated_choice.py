"""Stability of a choice of form: the same choice from tests that differ a little."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from hitchid.errors import FitError
from hitchid.identification.candidates import Candidate
from hitchid.identification.held_out import rows_of_tests
from hitchid.structures import Batch, ModelSpec
from hitchid.uncertainty import DeadZoneError
from hitchid.uncertainty.conformal import sensor_noise

FEWEST_TESTS = 3  # of which one can be left out; chosen


def repeat_choice(
    batch: Batch,
    choose: Callable[[Batch], Sequence[Candidate]],
    repeats: int,
    *,
    dead_zone: DeadZoneError,
    unit: str,
    seed: int,
) -> str:
    """Return a sentence on how often tests that differ a little give the same form, and the same errors.

    Each repeat leaves out one test, another each time, adds white noise of the sensor to the displacement,
    and draws the dead zone anew with its standard error.

    Args:
        batch: the tests that the form was chosen from.
        choose: returns the candidates of a choice, one of them chosen; none where nothing can be held out.
        repeats: how often.
        dead_zone: standard error of the dead zone.
        unit: of the displacement.
        seed: of noise, dead zones and the order in which tests are left out.
    """
    tests = batch.command.shape[0]
    if tests < FEWEST_TESTS:
        return f"the choice of the form was not repeated: that takes {FEWEST_TESTS} tests, there are {tests}"
    rng = np.random.default_rng(seed)
    noise = sensor_noise(rows_of_tests(np.asarray(batch.displacement), np.asarray(batch.valid)))
    order, forms, errors = rng.permutation(tests), Counter[str](), []
    for number in range(repeats):
        kept = batch.take(np.delete(np.arange(tests), order[number % tests]).tolist())
        sensor_errors = noise * rng.standard_normal(kept.displacement.shape)
        noisy = replace(kept, displacement=kept.displacement + jnp.asarray(sensor_errors))
        shift = dead_zone.standard_error * float(rng.standard_normal())
        try:
            candidates = choose(noisy.with_dead_zone(max(float(batch.dead_zone[0]) + shift, 0.0)))
        except FitError:
            forms["none"] += 1
            continue
        chosen = next((candidate for candidate in candidates if candidate.chosen), None)
        forms[form_name(chosen.spec) if chosen else "none"] += 1
        errors += [chosen.held_out_rmse] if chosen else []
    counted = "; ".join(f"{count} of {repeats} times {form}" for form, count in forms.most_common())
    spread = f"; RMSE on levels held out {min(errors):.3g} to {max(errors):.3g} {unit}" if errors else ""
    return f"the form chosen again from tests that differ a little: {counted}{spread}"


def form_name(spec: ModelSpec) -> str:
    """Return a form in words: its structure and the parameters of its options."""
    own = {parameter.name for parameter in spec.structure.parameters}
    options = [parameter.name for parameter in spec.parameters if parameter.name not in own]
    return f"{spec.structure.name} with {', '.join(options) or 'no options'}"
