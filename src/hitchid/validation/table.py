"""One table of a result, and how its numbers are written."""

from typing import NamedTuple


class Table(NamedTuple):
    """One table: a title, a header, and rows of text, the first column being names."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def digits(value: float | None) -> str:
    """Return a number with four significant digits; what is not finite reads 'diverged'."""
    return "diverged" if value is None else f"{value:.4g}"
