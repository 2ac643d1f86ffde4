"""Distances of strokes from what is predicted, against draws from the distribution that is assumed."""

import numpy as np
import pytest

import handmade
import machine
from hitchid.live import AdaptationSettings
from hitchid.live.estimator import Estimate, speed_distance
from hitchid.live.gates import Bounds
from hitchid.live.stroke_errors import StrokeFit
from hitchid.logs.record import LIFTING

BOUNDS = Bounds.of(machine.MODEL.channels[LIFTING], AdaptationSettings(), handmade.UNITS["lifting_command"])
PIECES, DRAWS = 10, 4000


@pytest.mark.parametrize("correlation", [0.0, 0.99])
def test_distances_have_a_variance_of_one_however_gain_and_dead_zone_are_known_apart(correlation):
    rng = np.random.default_rng(3)
    # A larger gain and a smaller dead zone give the same speed: their slopes are alike.
    slopes = rng.uniform(20.0, 40.0, (PIECES, 1)) * [1.0, -2.0, 0.0] + rng.standard_normal((PIECES, 3))
    deviations = np.array([0.1, 0.05, 0.05])
    known = np.eye(3)
    known[0, 1] = known[1, 0] = correlation
    predicted = Estimate(np.array([0.1, 0.01, 0.0]), known * np.outer(deviations, deviations))
    drawn = rng.multivariate_normal(predicted.mean, predicted.covariance + np.diag(BOUNDS.drift**2), DRAWS)
    errors = (drawn - predicted.mean) @ slopes.T + rng.standard_normal((DRAWS, PIECES))
    distances = [
        speed_distance(
            StrokeFit(predicted.mean, float(each @ each), slopes.T @ each, slopes.T @ slopes, 50.0),
            predicted,
            BOUNDS,
        )
        for each in errors
    ]
    # Four standard deviations of a variance of so many draws.
    assert np.var(distances) == pytest.approx(1.0, abs=4 * np.sqrt(2 / DRAWS))
