"""Words and digits: what the tests say of a parameter, and what a test would have to have."""

from math import floor, log10, pi

from hitchid.model.estimates import Interval
from hitchid.structures import Parameter


def verdict(
    parameter: Parameter,
    unit: str,
    interval: Interval,
    *,
    determined: bool,
    bound: str,
    fallback_quantity: str,
    step_s: float,
) -> str:
    """Return what is known of a parameter.

    Args:
        parameter: of the structure.
        unit: in the log's units.
        interval: 95 % interval, None for an end that is not given.
        determined: whether that is closed and narrow.
        bound: `lower` or `upper` where the estimate lies at one, else empty.
        fallback_quantity: what is determined in its place, empty where nothing is.
        step_s: sampling time of the tests, s.
    """
    if determined:
        return "determined"
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
    return f"any {name} between the bounds fits"


def _excitation_hint(parameter: Parameter, interval: Interval, step_s: float) -> str:
    """Return what would determine a parameter; of a time or a frequency the corner that must be excited."""
    lower, upper = interval
    nyquist_rad_s = pi / step_s
    frequency_too_high = parameter.unit == "rad/s" and lower is not None and lower > nyquist_rad_s
    time_too_short = parameter.unit == "s" and upper is not None and upper < 1 / nyquist_rad_s
    if frequency_too_high or time_too_short:
        return f"too fast for samples every {step_s:.3g} s"
    if parameter.unit == "rad/s" and lower is not None and upper is None:
        return f"excite above {lower / (2 * pi):.2g} Hz"
    if parameter.unit == "rad/s" and upper is not None and lower is None:
        return f"excite below {upper / (2 * pi):.2g} Hz"
    if parameter.unit == "s" and upper is not None and lower is None:
        return f"excite above {1 / (2 * pi * upper):.2g} Hz"
    if parameter.unit == "s" and lower is not None and upper is None:
        return f"excite below {1 / (2 * pi * lower):.2g} Hz"
    return parameter.excitation_hint


def format_with_error(value: float, error: float | None) -> str:
    """Return a value to the digits its standard error leaves it: two of the error, `41.85 ± 0.30`."""
    if error is None or not error > 0 or not value:
        return f"{value:.4g}"
    decimals = 1 - floor(log10(error))
    if decimals <= 0 or abs(value) < 1e-3:
        significant = max(floor(log10(abs(value))) + decimals + 1, 4)
        return f"{value:.{significant}g} ± {error:.2g}"
    return f"{value:.{decimals}f} ± {error:.{decimals}f}"


def format_interval(interval: Interval) -> str:
    """Return an interval in words of a table cell; an end that is not given is left out."""
    lower, upper = interval
    if lower is not None and upper is not None:
        return f"{lower:.4g} … {upper:.4g}"
    if lower is not None:
        return f"> {lower:.3g}"
    return "any" if upper is None else f"< {upper:.3g}"
