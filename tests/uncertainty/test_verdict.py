"""Verdicts say what is known of a parameter and what a test would have to have."""

from math import pi

import pytest

from hitchid.structures import Parameter
from hitchid.uncertainty.parameter_result import verdict

TIME = Parameter("time_constant", "s", 1e-3, 100.0, symbol="τ")
FREQUENCY = Parameter("natural_frequency", "rad/s", 0.5, 1000.0, symbol="ωh")
RATIO = Parameter("damping_ratio", "1", 0.05, 50.0, excitation_hint="excite near the natural frequency")
GAIN = Parameter("gain", "{x}/(s·{u})", 0.01, 100.0, symbol="K")
STEP_S = 0.01


def told(parameter, interval, *, unit=None, determined=False, bound="", instead="", step_s=STEP_S):
    return verdict(
        parameter,
        unit or parameter.unit,
        interval,
        determined=determined,
        bound=bound,
        fallback_quantity=instead,
        step_s=step_s,
    )


@pytest.mark.parametrize("interval", [(0.1, 0.2), (None, 0.2)])
def test_what_is_determined_needs_no_more_words(interval):
    assert told(TIME, interval, determined=True, bound="upper", instead="K") == "determined"


@pytest.mark.parametrize(
    ("parameter", "interval", "expected"),
    [
        # 2 π · 4 rad/s = 4 Hz; τ = 1/(2 π · 4 Hz).
        (FREQUENCY, (8 * pi, None), "ωh > 25.1 rad/s at 95 %; excite above 4 Hz"),
        (FREQUENCY, (None, 8 * pi), "ωh < 25.1 rad/s at 95 %; excite below 4 Hz"),
        (TIME, (None, 1 / (8 * pi)), "τ < 0.0398 s at 95 %; excite above 4 Hz"),
        (TIME, (1 / (8 * pi), None), "τ > 0.0398 s at 95 %; excite below 4 Hz"),
        (TIME, (0.01, 0.5), "τ from 0.01 to 0.5 s at 95 %"),
        (TIME, (None, None), "all values of τ between the bounds fit equally well"),
        (RATIO, (0.1, 5.0), "damping ratio from 0.1 to 5 at 95 %; excite near the natural frequency"),
        (RATIO, (0.1, None), "damping ratio > 0.1 at 95 %; excite near the natural frequency"),
        (
            RATIO,
            (None, None),
            "all values of damping ratio between the bounds fit equally well; "
            "excite near the natural frequency",
        ),
    ],
)
def test_what_is_not_determined_says_what_fits_and_what_to_excite(parameter, interval, expected):
    assert told(parameter, interval) == f"not determined: {expected}"


def test_units_are_those_of_the_log():
    assert told(GAIN, (1.0, 40.0), unit="mm/(s·A)") == "not determined: K from 1 to 40 mm/(s·A) at 95 %"


@pytest.mark.parametrize(
    ("parameter", "interval", "words"),
    [
        # The fastest that samples every 10 ms show is π/0.01 = 314 rad/s, a time of 3.18 ms.
        (
            FREQUENCY,
            (320.0, None),
            "ωh > 320 rad/s at 95 %; faster than can be identified at a sampling time of 0.01 s",
        ),
        (
            FREQUENCY,
            (320.0, 900.0),
            "ωh from 320 to 900 rad/s at 95 %; faster than can be identified at a sampling time of 0.01 s",
        ),
        (
            TIME,
            (None, 0.003),
            "τ < 0.003 s at 95 %; faster than can be identified at a sampling time of 0.01 s",
        ),
        (
            TIME,
            (0.001, 0.003),
            "τ from 0.001 to 0.003 s at 95 %; faster than can be identified at a sampling time of 0.01 s",
        ),
    ],
)
def test_no_excitation_is_advised_that_the_sampling_cannot_show(parameter, interval, words):
    assert told(parameter, interval) == f"not determined: {words}"
    assert "too fast" not in told(parameter, interval, step_s=0.001)


@pytest.mark.parametrize(
    ("parameter", "interval"), [(FREQUENCY, (313.0, None)), (TIME, (None, 0.0033)), (TIME, (0.001, None))]
)
def test_what_the_sampling_can_show_is_not_called_too_fast(parameter, interval):
    assert "excite" in told(parameter, interval)
    assert "too fast" not in told(parameter, interval)


def test_a_time_without_upper_end_is_not_too_fast_for_slow_samples():
    assert told(TIME, (50.0, None), step_s=4.0).endswith("excite below 0.0032 Hz")


@pytest.mark.parametrize("bound", ["lower", "upper"])
def test_an_estimate_at_a_bound_is_said_to_be(bound):
    expected = f"at its {bound} bound: ωh > 25.1 rad/s at 95 %; excite above 4 Hz"
    assert told(FREQUENCY, (8 * pi, None), bound=bound) == expected
    # Where anything between the bounds fits, that the estimate is at one of them says nothing.
    assert (
        told(FREQUENCY, (None, None), bound=bound)
        == "not determined: all values of ωh between the bounds fit equally well"
    )


@pytest.mark.parametrize("bound", ["", "upper"])
def test_what_is_determined_instead_comes_first_and_nothing_is_advised(bound):
    expected = "only K/τ is determined: τ > 7.5 s at 95 %"
    assert told(TIME, (7.5, None), bound=bound, instead="K/τ") == expected


def test_what_is_determined_only_with_another_at_its_bound_says_so():
    told_text = verdict(
        FREQUENCY,
        "rad/s",
        (10.0, 12.0),
        determined=False,
        bound="",
        conditional_on=("ξh",),
        fallback_quantity="",
        step_s=STEP_S,
    )
    assert told_text == "determined only for ξh at its bound"
