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


TOO_FAST = "faster than can be identified at a sampling time of 0.01 s"
ALL_FIT = "all values of {} between the bounds fit equally well"


def text_of(parameter, interval, *, step_s=STEP_S, **settings):
    settings = {"determined": False, "bound": "", "fallback_quantity": "", **settings}
    unit = settings.pop("unit", parameter.unit)
    return verdict(parameter, unit, interval, step_s=step_s, **settings)


@pytest.mark.parametrize("interval", [(0.1, 0.2), (None, 0.2)])
def test_what_is_determined_needs_no_more_words(interval):
    text = text_of(TIME, interval, determined=True, bound="upper", fallback_quantity="K")
    assert text == "determined"


@pytest.mark.parametrize(
    ("parameter", "interval", "expected"),
    [
        # 2 π · 4 rad/s = 4 Hz; τ = 1/(2 π · 4 Hz).
        (FREQUENCY, (8 * pi, None), "ωh > 25.1 rad/s at 95 %; excite above 4 Hz"),
        (FREQUENCY, (None, 8 * pi), "ωh < 25.1 rad/s at 95 %; excite below 4 Hz"),
        (TIME, (None, 1 / (8 * pi)), "τ < 0.0398 s at 95 %; excite above 4 Hz"),
        (TIME, (1 / (8 * pi), None), "τ > 0.0398 s at 95 %; excite below 4 Hz"),
        (TIME, (0.01, 0.5), "τ from 0.01 to 0.5 s at 95 %"),
        (TIME, (None, None), ALL_FIT.format("τ")),
        (RATIO, (0.1, 5.0), "damping ratio from 0.1 to 5 at 95 %; excite near the natural frequency"),
        (RATIO, (0.1, None), "damping ratio > 0.1 at 95 %; excite near the natural frequency"),
        (RATIO, (None, None), f"{ALL_FIT.format('damping ratio')}; excite near the natural frequency"),
        # The fastest that samples every 10 ms show is π/0.01 = 314 rad/s, a time of 3.18 ms.
        (FREQUENCY, (320.0, None), f"ωh > 320 rad/s at 95 %; {TOO_FAST}"),
        (FREQUENCY, (320.0, 900.0), f"ωh from 320 to 900 rad/s at 95 %; {TOO_FAST}"),
        (TIME, (None, 0.003), f"τ < 0.003 s at 95 %; {TOO_FAST}"),
        (TIME, (0.001, 0.003), f"τ from 0.001 to 0.003 s at 95 %; {TOO_FAST}"),
    ],
)
def test_a_verdict_says_what_fits_and_what_to_excite(parameter, interval, expected):
    assert text_of(parameter, interval) == f"not determined: {expected}"
    assert TOO_FAST not in text_of(parameter, interval, step_s=0.001)


def test_units_are_those_of_the_log():
    assert text_of(GAIN, (1.0, 40.0), unit="mm/(s·A)") == "not determined: K from 1 to 40 mm/(s·A) at 95 %"


@pytest.mark.parametrize(
    ("parameter", "interval"), [(FREQUENCY, (313.0, None)), (TIME, (None, 0.0033)), (TIME, (0.001, None))]
)
def test_what_the_sampling_can_show_is_not_called_too_fast(parameter, interval):
    assert "excite" in text_of(parameter, interval)
    assert TOO_FAST not in text_of(parameter, interval)


def test_a_time_without_end_is_not_too_fast():
    assert text_of(TIME, (50.0, None), step_s=4.0).endswith("excite below 0.0032 Hz")


@pytest.mark.parametrize("bound", ["lower", "upper"])
def test_an_estimate_at_a_bound_is_said_to_be(bound):
    expected = f"at its {bound} bound: ωh > 25.1 rad/s at 95 %; excite above 4 Hz"
    assert text_of(FREQUENCY, (8 * pi, None), bound=bound) == expected
    # Where anything between the bounds fits, that the estimate is at one of them says nothing.
    assert text_of(FREQUENCY, (None, None), bound=bound) == f"not determined: {ALL_FIT.format('ωh')}"


@pytest.mark.parametrize("bound", ["", "upper"])
def test_what_is_determined_instead_comes_first_and_nothing_is_advised(bound):
    expected = "only K/τ is determined: τ > 7.5 s at 95 %"
    assert text_of(TIME, (7.5, None), bound=bound, fallback_quantity="K/τ") == expected


def test_a_conditional_parameter_says_on_what():
    text = text_of(FREQUENCY, (10.0, 12.0), conditional_on=("ξh",))
    assert text == "determined only for ξh at its bound"
