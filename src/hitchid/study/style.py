"""One look for every figure: the same colour for the same model, units on every axis."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl

MEASURED = "#000000"
COLOURS = {"benchmark": "#D55E00", "one_step": "#0072B2", "free_run": "#009E73", "persistence": "#999999"}
PARTS = {"training": "#0072B2", "validation": "#CC79A7", "test": "#009E73"}
LABELS = {
    "benchmark": "transfer function, free run",
    "one_step": "grey box, one step",
    "free_run": "grey box, free run",
}
_STYLE: dict[Any, Any] = {
    "figure.constrained_layout.use": True,
    "figure.dpi": 150,
    "font.size": 9,
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "lines.linewidth": 1.1,
    "svg.hashsalt": "hitchid",
    "svg.fonttype": "path",
}


@contextmanager
def style() -> Iterator[None]:
    """Draw within the style of the house, leaving matplotlib's own settings alone."""
    with mpl.rc_context(_STYLE):
        yield
