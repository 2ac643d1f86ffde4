"""Bands of handmade integrators, whose alternatives and half widths follow by hand."""

import numpy as np
import pytest
from scipy import stats

from handmade import DEAD_ZONES, GAINS, NOISE, hitch, with_bands
from hitchid.errors import InputError
from hitchid.logs.record import LIFTING, LOWERING
from truth import STEP_S, levels

MODEL = with_bands(hitch(), LIFTING, LOWERING)


@pytest.fixture
def cycle(make_record):
    """Return a record that rests, lifts and lowers, and the travel of each direction, shape [N]."""
    rng = np.random.default_rng(0)
    up, down = (np.concatenate([np.zeros(30), levels(rng, 120, low=0.5)]) for _ in range(2))
    lifting, lowering = np.concatenate([up, 0 * down]), np.concatenate([0 * up, down])
    ways = [
        GAINS[mode]
        * STEP_S
        * np.concatenate([[0.0], np.cumsum(np.maximum(command - DEAD_ZONES[mode], 0))[:-1]])
        for mode, command in ((LIFTING, lifting), (LOWERING, lowering))
    ]
    return make_record(100.0 + ways[0] - ways[1], lifting, lowering), ways


@pytest.mark.parametrize(("coverage", "q"), [(0.5, 0.5), (0.9, 1.5), (0.85, 1.25)])
def test_in_free_run_noise_and_both_ensembles_add_in_squares(cycle, coverage, q):
    record, ways = cycle
    lower, upper = MODEL.simulate(record).band(coverage)
    floor = stats.norm.ppf(0.5 + coverage / 2) * NOISE
    half = np.sqrt(floor**2 + q**2 * 0.1**2 * (ways[0] ** 2 + ways[1] ** 2))
    np.testing.assert_allclose(upper - lower, 2 * half, rtol=1e-9)
    np.testing.assert_allclose(0.5 * (lower + upper), MODEL.simulate(record).displacement, rtol=1e-12)


@pytest.mark.parametrize(
    ("horizon", "typical", "growth", "q"), [(1, 0.5, 0.1, 2.0), (10, 5.0, 0.4, 3.0), (200, 100.0, 8.0, 3.0)]
)
def test_ahead_the_half_width_grows_with_the_movement(cycle, horizon, typical, growth, q):
    record, _ = cycle
    lower, upper = MODEL.band(record, horizon=horizon)
    predicted = MODEL.predict(record, horizon=horizon)
    # The first samples are predicted from the rest before motion, at 100 mm.
    origins = np.concatenate([np.full(horizon, 100.0), record.displacement])[: len(record)]
    movement = np.abs(predicted - origins)
    floor = stats.norm.ppf(0.95) * NOISE
    half = np.sqrt(floor**2 + q**2 * (NOISE**2 + growth**2 * movement / typical))
    # Movements of 1e-12 mm are rounding, of which the root is 1e-6.
    np.testing.assert_allclose(upper - lower, 2 * half, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(0.5 * (lower + upper), predicted, rtol=1e-12)
    assert movement.min() < 1e-9 < 1.0 < movement.max() or horizon == 1


def test_a_band_is_in_the_unit_of_the_record(cycle):
    record, _ = cycle
    in_metres = record.convert({"displacement": "m"})
    for mine, theirs in zip(MODEL.simulate(in_metres).band(), MODEL.simulate(record).band(), strict=True):
        np.testing.assert_allclose(mine, 1e-3 * theirs, rtol=1e-9)


def test_without_bands_for_a_channel_there_is_none(cycle):
    with pytest.raises(InputError, match="bands for lowering"):
        with_bands(hitch(), LIFTING).simulate(cycle[0]).band()
    with pytest.raises(InputError, match="bands for lifting and lowering"):
        hitch().simulate(cycle[0]).band()


@pytest.mark.parametrize("coverage", [0.49, 0.96, 95.0, float("nan")])
def test_a_share_that_was_not_calibrated_is_refused(cycle, coverage):
    run, complaint = (
        MODEL.simulate(cycle[0]),
        r"coverage: expected (between 0\.5 and 0\.95|a finite number), got",
    )
    for band in (run.band, lambda share: MODEL.band(cycle[0], horizon=1, coverage=share)):
        with pytest.raises(InputError, match=complaint):
            band(coverage)
