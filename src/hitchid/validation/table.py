"""One table of a result, and how its numbers are written."""

from collections.abc import Mapping
from math import floor, log10
from typing import NamedTuple

from hitchid.uncertainty import format_with_error


class Table(NamedTuple):
    """One table: a title, a header, and rows of text, the first column being names."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def digits(value: float | None) -> str:
    """Return a number with four significant digits; what is not finite reads 'diverged'."""
    return "diverged" if value is None else f"{value:.4g}"


def rounded(value: float | None, error: float | None, max_decimals: int = 12) -> str:
    """Return a number to the second digit of its standard error, to four digits where that is not known.

    Args:
        value, error: the number and its standard error.
        max_decimals: places after the point, at most.
    """
    if value is None or error is None or not error > 0:
        return digits(value)
    return f"{value:.{min(max(0, 1 - floor(log10(error))), max_decimals)}f}"


def error_cells(figures: Mapping[str, float | None]) -> tuple[str, ...]:
    """Return RMSE, MAE, R², fit, largest error and share below one unit, to the digits that tests can tell.

    The standard error s of the RMSE r over tests sets all of them: R² = 1 − (r/y)² has 2 (1 − R²) s/r and the
    fit 100 (1 − r/y) has (100 − fit) s/r; more than five places of R² and two of the fit nobody reads.
    """
    rmse, r2, fit, within_1 = (figures[name] for name in ("rmse", "r2", "fit", "within_1"))
    if rmse is None or r2 is None or fit is None or within_1 is None:
        return ("diverged",) * 6
    error = figures["rmse_error"]
    relative = error / rmse if error and rmse else None
    return (
        format_with_error(rmse, error),
        rounded(figures["mae"], error),
        rounded(r2, 2 * (1 - r2) * relative, 5) if relative else f"{r2:.4f}",
        rounded(fit, (100 - fit) * relative, 2) if relative else f"{fit:.2f}",
        rounded(figures["max_abs"], error),
        f"{100 * within_1:.1f}",
    )


def numeric(content: Table) -> list[bool]:
    """Tell which columns of a table hold numbers rather than words."""
    columns = zip(*content.rows, strict=True) if content.rows else [()] * len(content.header)
    return [any(column) and all(map(_number, column)) for column in columns]


def _number(cell: str) -> bool:
    return cell in ("diverged", "any") or not any(letter.isalpha() for letter in cell.replace("e", ""))
