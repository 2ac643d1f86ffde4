"""Numbers as text: values with standard errors, intervals, p-values, shares, errors."""

from math import floor, log10

from hitchid._support.tables import count as count
from hitchid.model import Estimate, Interval, LoadOfTest, LoadScatter, Quantity, SpeedPoint
from hitchid.model.estimates import NOT_ASSESSED
from hitchid.report.document import Faint
from hitchid.validation import RunFigures
from hitchid.validation.results import DIVERGED as DIVERGED
from hitchid.validation.results import value_text as digits


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


def interval(ends: Interval) -> str:
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


def estimate(parameter: Estimate) -> str:
    """Return a parameter with its standard error; only the value, faint, if it is not determined."""
    if parameter.determined and parameter.method != NOT_ASSESSED:
        return with_error(parameter.value, parameter.error)
    return quantity(parameter)


def quantity(result: Quantity | Estimate | SpeedPoint) -> str:
    """Return a value with four digits, faint if the tests do not determine it."""
    value = digits(result.speed if isinstance(result, SpeedPoint) else result.value)
    return value if result.determined else Faint(value)


def determined(result: Quantity | Estimate | SpeedPoint | LoadScatter | LoadOfTest) -> str:
    """Return whether a quantity is determined."""
    return "determined" if result.determined else "not determined"


def error_cells(figures: RunFigures) -> tuple[str, ...]:
    """Return RMSE, MAE, R², fit, largest error and share below one unit, to their significant digits.

    All follow from the standard error s of the RMSE r over tests: R² = 1 − (r/y)² has 2 (1 − R²) s/r and the
    fit 100 (1 − r/y) has (100 − fit) s/r; at most five decimals of R² and two of the fit.
    """
    rmse, r2, fit, within_1 = figures.rmse, figures.r2, figures.fit, figures.within_1
    if rmse is None or r2 is None or fit is None or within_1 is None:
        return (DIVERGED,) * 6
    error = figures.rmse_error
    relative = error / rmse if error and rmse else None
    return (
        with_error(rmse, error),
        rounded(figures.mae, error),
        rounded(r2, 2 * (1 - r2) * relative, 5) if relative else f"{r2:.4f}",
        rounded(fit, (100 - fit) * relative, 2) if relative else f"{fit:.2f}",
        rounded(figures.max_abs, error),
        percent(within_1),
    )
