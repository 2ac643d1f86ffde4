"""Verdict on a parameter: determined or not, its interval, and the excitation that would determine it."""

from collections.abc import Sequence
from math import pi

from hitchid.model.estimates import Interval
from hitchid.structures import Parameter


def verdict(
    parameter: Parameter,
    unit: str,
    interval: Interval,
    *,
    determined: bool,
    bound: str,
    conditional_on: Sequence[str] = (),
    fallback_quantity: str,
    step_s: float,
    stands_for: str = "",
) -> str:
    """Return as text whether tests determine a parameter, its interval, and the excitation required.

    Args:
        parameter: of the structure.
        unit: in the log's units.
        interval: 95 % interval, None for an open end.
        determined: whether the interval is closed and narrow.
        bound: `lower` or `upper` where the estimate lies at one, else empty.
        conditional_on: symbols of the parameters at a bound for which alone the interval holds.
        fallback_quantity: the combination that is determined instead; empty where none is.
        step_s: sampling time of the tests, s.
        stands_for: what the value is in this form, where that is more than the parameter.
    """
    if determined:
        return f"determined as {stands_for}" if stands_for else "determined"
    if conditional_on:
        return f"determined only for {' and '.join(conditional_on)} at its bound"
    phrases = [_range_text(parameter, unit, interval)]
    hint = _excitation_hint(parameter, interval, step_s)
    if hint and not fallback_quantity:
        phrases.append(hint)
    text = "; ".join(phrase for phrase in phrases if phrase)
    if fallback_quantity:
        return f"only {fallback_quantity} is determined: {text}"
    if bound and interval != (None, None):
        return f"at its {bound} bound: {text}"
    return f"not determined: {text}"


def _range_text(parameter: Parameter, unit: str, interval: Interval) -> str:
    name = parameter.symbol or parameter.name.replace("_", " ")
    unit_suffix = "" if unit == "1" else f" {unit}"
    lower, upper = interval
    if lower is not None and upper is not None:
        return f"{name} from {lower:.3g} to {upper:.3g}{unit_suffix} at 95 %"
    if lower is not None:
        return f"{name} > {lower:.3g}{unit_suffix} at 95 %"
    if upper is not None:
        return f"{name} < {upper:.3g}{unit_suffix} at 95 %"
    return f"all values of {name} between the bounds fit equally well"


def _excitation_hint(parameter: Parameter, interval: Interval, step_s: float) -> str:
    """Return the excitation that would determine a parameter; its corner frequency for times, frequencies."""
    lower, upper = interval
    nyquist_rad_s = pi / step_s
    frequency_too_high = parameter.unit == "rad/s" and lower is not None and lower > nyquist_rad_s
    time_too_short = parameter.unit == "s" and upper is not None and upper < 1 / nyquist_rad_s
    if frequency_too_high or time_too_short:
        return f"faster than can be identified at a sampling time of {step_s:.3g} s"
    if parameter.unit == "rad/s" and lower is not None and upper is None:
        return f"excite above {lower / (2 * pi):.2g} Hz"
    if parameter.unit == "rad/s" and upper is not None and lower is None:
        return f"excite below {upper / (2 * pi):.2g} Hz"
    if parameter.unit == "s" and upper is not None and lower is None:
        return f"excite above {1 / (2 * pi * upper):.2g} Hz"
    if parameter.unit == "s" and lower is not None and upper is None:
        return f"excite below {1 / (2 * pi * lower):.2g} Hz"
    return parameter.excitation_hint
