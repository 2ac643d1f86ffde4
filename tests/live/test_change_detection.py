"""Alarms of a change: how rare they are where nothing changes, how soon they come where something does."""

import numpy as np
import pytest

from hitchid.errors import InputError
from hitchid.live import AdaptationSettings
from hitchid.live.settings import (
    DEGREES_OF_FREEDOM,
    LARGEST,
    MOST_STROKES_BETWEEN,
    REFERENCE,
    REPLICATES,
    STROKES,
    THRESHOLDS,
    ChangeDetector,
    alarm_threshold,
)

STREAMS, LENGTH = 4000, 2000
SETTINGS = AdaptationSettings()


def alarm_rates(threshold, seed):
    """Return the alarms for each stroke of streams without a change, shape [STREAMS].

    The mean of each and its scale are what some twenty strokes leave unknown.
    """
    freedom = DEGREES_OF_FREEDOM
    rng = np.random.default_rng(seed)
    scale = np.sqrt(rng.chisquare(freedom, STREAMS) / freedom)
    mean = rng.standard_normal(STREAMS) / np.sqrt(freedom + 1)
    sums, alarms = np.zeros((2, STREAMS)), np.zeros(STREAMS)
    for _ in range(LENGTH):
        error = np.clip((rng.standard_normal(STREAMS) + mean) / scale, -LARGEST, LARGEST)
        sums = np.maximum(sums + np.stack([error, -error]) - REFERENCE, 0.0)
        alarm = sums.max(axis=0) > threshold
        alarms += alarm
        sums[:, alarm] = 0.0
    return alarms / LENGTH


@pytest.mark.parametrize("between", [2000.0, 5000.0, 20000.0, MOST_STROKES_BETWEEN])
def test_the_time_between_false_alarms_is_that_of_the_settings(between):
    threshold = alarm_threshold(between)
    step = float(THRESHOLDS[1] - THRESHOLDS[0])
    # The threshold is of 64 streams, each of which has a rate of its own.
    rates, more = (alarm_rates(tried, 17) for tried in (threshold, threshold - step))
    error, error_of_more = (
        np.std(own) / np.sqrt(REPLICATES) + np.sqrt(own.mean() / (REPLICATES * STROKES))
        for own in (rates, more)
    )
    assert rates.mean() <= 1 / between + 3 * error
    assert more.mean() >= 1 / between - 3 * error_of_more
    assert more.mean() > rates.mean()


@pytest.mark.parametrize("between", [1.5, 100.0, SETTINGS.strokes_between_alarms])
def test_no_single_stroke_raises_an_alarm(between):
    threshold = alarm_threshold(between)
    for error in (1e6, -1e6):
        assert ChangeDetector().advance(error).sum == LARGEST - REFERENCE < threshold


def test_alarms_rarer_than_those_that_were_simulated_are_refused():
    assert alarm_threshold(MOST_STROKES_BETWEEN) < THRESHOLDS[-1]
    with pytest.raises(InputError, match="strokes_between_alarms: got 50001, expected at most 50000"):
        AdaptationSettings(strokes_between_alarms=MOST_STROKES_BETWEEN + 1)


@pytest.mark.parametrize("shift", [2.5, -2.5, 4.0, 6.0])
def test_a_larger_change_is_found_after_fewer_strokes(shift):
    threshold = alarm_threshold(SETTINGS.strokes_between_alarms)
    detector = ChangeDetector()
    strokes = 0
    while detector.sum <= threshold:
        detector, strokes = detector.advance(shift), strokes + 1
    assert strokes == int(threshold / (abs(shift) - REFERENCE)) + 1
    assert (detector.faster > detector.slower) == (shift > 0)
