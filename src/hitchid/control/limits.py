"""Acceptance limits of a drive, from a file: at most what its metrics may be."""

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from hitchid._support import checks
from hitchid.errors import SettingsError
from hitchid.validation import Acceptance, Check

AT_LEAST = ("band.inside",)  # figures with a lower limit


def read_drive_limits(path: str | Path) -> dict[str, float]:
    """Return the limits of a file by name, such as `steps.100.overshoot`.

    The tables of the file are those of `metrics.json`; every number is the largest that is accepted, of
    `band.inside` the smallest.

    Raises:
        SettingsError: the file is missing, no TOML, empty, or holds something that is not a number.
    """
    place = checks.path(path, "path")
    try:
        content = tomllib.loads(place.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"{place}: cannot be read: {error.strerror}; expected a TOML file") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingsError(f"{place}: is not TOML: {error}") from error
    limits = dict(_flat(content, f"{place}: "))
    if not limits:
        raise SettingsError(f"{place}: has no limit; expected one such as iae_ratio = 0.6")
    return limits


def check_drive(metrics: Mapping[str, object], limits: Mapping[str, float]) -> Acceptance:
    """Compare the figures of a drive with limits; a figure that is missing fails its limit.

    Args:
        metrics: of a `Drive`.
        limits: of `read_drive_limits`.

    Raises:
        SettingsError: a limit has the name of no figure.
    """
    figures = dict(_figures(metrics))
    made = []
    for name, limit in limits.items():
        if name not in figures:
            listed = ", ".join(sorted(figures))
            raise SettingsError(f"limits: there is no figure '{name}'; expected one of {listed}")
        value = figures[name]
        bound = "at least" if name in AT_LEAST else "at most"
        passed = value is not None and (value >= limit if name in AT_LEAST else value <= limit)
        found = "missing: never settled, or not predicted" if value is None else f"{value:.4g}"
        made.append(Check("closed loop", name, f"{bound} {limit:g}", found, bool(passed)))
    return Acceptance(tuple(made))


def _flat(table: Mapping[str, object], context: str, prefix: str = "") -> Iterator[tuple[str, float]]:
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, context, f"{prefix}{name}.")
        elif isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise SettingsError(f"{context}{prefix}{name}: got {value!r}, expected a finite number")
        else:
            yield f"{prefix}{name}", float(value)


def _figures(table: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, float | None]]:
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _figures(value, f"{prefix}{name}.")
        elif not isinstance(value, str):  # a unit
            yield f"{prefix}{name}", None if value is None else float(value)  # pyright: ignore[reportArgumentType]
