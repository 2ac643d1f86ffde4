"""Numbers as text: values with standard errors, intervals, p-values, shares, counts."""

from math import floor, log10

DIVERGED = "diverged"


def count(number: int, noun: str) -> str:
    """Return a number with a noun, in the plural unless the number is 1."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def digits(value: float | None, error: float | None = None) -> str:
    """Return a value to four digits, its standard error to two; None is a run that diverged."""
    if value is None:
        return DIVERGED
    return f"{value:.4g}" if error is None else f"{value:.4g} ± {error:.2g}"


def percent(share: float, decimals: int = 1) -> str:
    """Return a share in percent."""
    return f"{100 * share:.{decimals}f}"


def p_value(probability: float) -> str:
    """Return a p-value with two digits, `< 0.001` below that."""
    return f"p {'< 0.001' if probability < 1e-3 else f'= {probability:.2g}'}"


def rounded(value: float | None, error: float | None, max_decimals: int = 12) -> str:
    """Return a number to the second digit of its standard error, or to four digits without one."""
    if value is None or error is None or not error > 0:
        return digits(value)
    return f"{value:.{min(max(0, 1 - floor(log10(error))), max_decimals)}f}"


def with_error(value: float | None, error: float | None) -> str:
    """Return a value to two digits of its standard error, `41.85 ± 0.30`; 'diverged' for None."""
    if value is None or error is None or not error > 0 or not value:
        return digits(value)
    decimals = 1 - floor(log10(error))
    if decimals <= 0 or abs(value) < 1e-3:
        significant = max(floor(log10(abs(value))) + decimals + 1, 4)
        return f"{value:.{significant}g} ± {error:.2g}"
    return f"{value:.{decimals}f} ± {error:.{decimals}f}"


def interval(ends: tuple[float | None, float | None]) -> str:
    """Return an interval for a table cell; an end that is None is open."""
    lower, upper = ends
    if lower is not None and upper is not None:
        return f"{lower:.4g} … {upper:.4g}"
    if lower is not None:
        return f"> {lower:.3g}"
    return "any" if upper is None else f"< {upper:.3g}"


def with_unit(text: str, unit: str) -> str:
    """Return a number with its unit; no unit for dimensionless numbers (`1`)."""
    return text if unit == "1" else f"{text} {unit}"
