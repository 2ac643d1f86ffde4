"""Trends of a change log against lines that are known."""

import math

import numpy as np
import pytest

from hitchid.errors import InputError
from hitchid.live import Changes, Event
from hitchid.live.change_log import STROKES_APART, trends
from hitchid.live.events import LEARNED, REFUSED
from hitchid.logs.record import LIFTING

LIMITS = {"gain": 0.4, "dead_zone": 0.15}
DEVIATION = {"gain": 0.01, "dead_zone": 0.003}


def change_log(per_hour, hours, seed, strokes=400):
    """Return the events of a machine whose gain changes at a rate, with noise of the stated deviation."""
    rng, events = np.random.default_rng(seed), []
    for number in range(1, strokes + 1):
        time_h = hours * number / strokes
        figures = {
            "gain": per_hour * time_h + DEVIATION["gain"] * rng.standard_normal(),
            "dead_zone": DEVIATION["dead_zone"] * rng.standard_normal(),
            **{f"{name}_deviation": value for name, value in DEVIATION.items()},
        }
        events.append(Event(LEARNED, 3600 * time_h, number, LIFTING, "", Changes(), (), figures))
    return events


def test_the_interval_holds_the_slope_as_often_as_it_says():
    rates = [trends(change_log(-0.01, 10.0, seed), LIMITS)[0] for seed in range(200)]
    inside = np.mean([trend.interval[0] <= -0.01 <= trend.interval[1] for trend in rates])
    # Binomial with 200 draws: four standard deviations of 0.95 are 0.06; a variance held at one widens it.
    assert inside >= 0.95 - 0.06


def test_without_a_trend_few_are_called_significant():
    called = [trends(change_log(0.0, 10.0, seed), LIMITS)[1].significant for seed in range(200)]
    assert np.mean(called) <= 0.05 + 0.06


def test_a_limit_is_reached_when_the_line_reaches_it():
    gain, dead_zone = trends(change_log(-0.02, 10.0, 1), LIMITS)
    earliest, expected, latest = gain.limit_after_h
    assert gain.significant
    assert not dead_zone.significant
    # From −0.2 to −0.4 at −0.02 an hour; the slope is known to a few percent.
    assert expected == pytest.approx(10.0, rel=0.15)
    assert earliest <= expected <= latest


def test_a_parameter_that_stays_reaches_no_limit_for_long():
    events = change_log(0.0, 10.0, 1)
    still = [
        Event(**{**vars(event), "figures": {**event.figures, "gain": 0.0, "dead_zone": 0.0}})
        for event in events
    ]
    gain, _ = trends(still, LIMITS)
    assert math.isinf(gain.limit_after_h[2])
    assert not gain.significant


def test_a_leak_is_a_trend_of_its_own_without_a_limit_where_none_is_given():
    # From 0.01 mm/s on, 0.002 mm/s more each hour, each known to 0.001 mm/s; refused strokes show it, too.
    rng, events = np.random.default_rng(4), []
    for number in range(1, 101):
        time_h = 0.1 * number
        leak = -0.01 - 0.002 * time_h + 0.001 * rng.standard_normal()
        figures = {"leak": leak, "leak_deviation": 0.001}
        events.append(Event(REFUSED, 3600 * time_h, number, LIFTING, "", Changes(), (), figures))
    (limited,) = trends(events, {**LIMITS, "leak": 0.05})
    assert (limited.direction, limited.parameter) == ("", "leak")
    # The standard error of the slope is 0.001 over the root of the spread of the times, 29 h.
    assert limited.per_hour == pytest.approx(-0.002, abs=4 * 0.001 / 29)
    assert limited.limit_after_h[1] == pytest.approx((0.05 - 0.03) / 0.002, rel=0.1)
    (unlimited,) = trends(events, LIMITS)
    assert np.isinf(unlimited.limit_after_h).all()


def test_few_strokes_have_no_trend():
    assert trends(change_log(0.0, 1.0, 1, strokes=4 * STROKES_APART), LIMITS) == ()


@pytest.mark.parametrize("figures", [{}, {"gain": 0.1}, {"gain": 0.1, "gain_deviation": 0.0}])
def test_an_entry_that_lacks_a_figure_is_named(figures):
    events = change_log(0.0, 1.0, seed=1, strokes=60)
    events[-1] = Event(LEARNED, 3600.0, 60, LIFTING, "", Changes(), (), figures)
    with pytest.raises(InputError, match="events: 'learned' at 3600 s: expected the figures gain"):
        trends(events, LIMITS)
