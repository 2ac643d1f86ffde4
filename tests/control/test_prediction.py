"""Bands that hold whole runs."""

import numpy as np
import pytest

from hitchid.control.prediction import COVERAGE, Band, band_of

RUNS, SAMPLES = 2000, 60


def gaussian(seed: int, *, smooth: bool, runs: int = RUNS):
    rows = np.random.default_rng(seed).standard_normal((runs, SAMPLES))
    shape = 1 + np.linspace(0, 3, SAMPLES)
    return 100 + shape * (np.cumsum(rows, axis=1) if smooth else rows)


@pytest.mark.parametrize("smooth", [False, True])
def test_a_band_holds_nine_of_ten_whole_runs(smooth: bool) -> None:
    band = band_of(gaussian(1, smooth=smooth))
    share = np.mean(band.contains(gaussian(2, smooth=smooth)) == 1)
    # Both the band's runs and the new ones scatter.
    assert share == pytest.approx(COVERAGE, abs=4 * np.sqrt(2 * COVERAGE * (1 - COVERAGE) / RUNS))


def test_equal_runs_have_a_band_of_no_width() -> None:
    run = np.linspace(0.0, 1.0, SAMPLES)
    band = band_of(np.tile(run, (5, 1)))
    np.testing.assert_allclose(band.lower, run, atol=1e-12)
    np.testing.assert_allclose(band.upper, run, atol=1e-12)


def test_a_band_tells_the_share_of_samples_inside() -> None:
    band = Band(np.zeros(4), np.ones(4))
    rows = np.array([[0.0, 0.5, 1.0, 0.2], [-0.1, 0.5, 1.1, 0.2], [2.0, 2.0, np.nan, -1.0]])
    np.testing.assert_array_equal(band.contains(rows), [1.0, 0.5, 0.0])
    assert float(band.contains(rows[1])) == 0.5
