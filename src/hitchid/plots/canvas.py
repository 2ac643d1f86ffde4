"""The axes of a plot: the caller's own, or those of a new figure."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from hitchid.errors import InputError
from hitchid.plots.style import PAGE_IN, legend_above, plain_texts, style

LEGEND_COLUMNS = 4  # of the legend above a figure; chosen


@contextmanager
def canvas(
    axes: Axes | Sequence[Axes] | np.ndarray | None,
    rows: int,
    columns: int = 1,
    *,
    height_in: float,
    legend_order: Sequence[str] = (),
    legend_each: bool = False,
    **layout: Any,
) -> Iterator[np.ndarray]:
    """Give the axes to draw into, in the style of all figures, and add the legend.

    Without axes a figure is made by pyplot: notebooks, Spyder and `pyplot.show` show only its figures. Axes
    that are given are drawn into, and nothing else is changed: neither their figure nor pyplot's state.
    matplotlib's settings are restored in both cases.

    Args:
        axes: axes of the caller, `rows × columns` of them, row by row; None for a new figure.
        rows, columns: arrangement of the axes in a new figure.
        height_in: height of a new figure, inch.
        legend_order: labels that come first in the legend of a new figure.
        legend_each: whether each axes of a new figure has its own legend; otherwise there is one above.
        layout: further arguments of `Figure.subplots` for a new figure.

    Yields:
        The axes, row by row, shape [rows · columns].

    Raises:
        InputError: other than that number of axes is given.
    """
    if axes is not None:
        given = checked_axes(axes, rows * columns)
        with style():
            yield given
            _legend_each(given)
            for each in given:  # what the caller wrote into them stays
                for own in (each.xaxis.label, each.yaxis.label, each.get_legend()):
                    if own is not None:
                        plain_texts(own)
        return
    from matplotlib import pyplot  # only here: it chooses a backend and keeps a list of figures

    with style():
        figure = pyplot.figure(figsize=(PAGE_IN, height_in))
        try:
            made = np.ravel(figure.subplots(rows, columns, squeeze=False, **layout))
            yield made
            if legend_each:
                _legend_each(made)
            elif any(each.get_legend_handles_labels()[0] for each in made):
                legend_above(figure, *made, columns=LEGEND_COLUMNS, order=legend_order)
            figure.align_ylabels()
            plain_texts(figure)
        except BaseException:
            pyplot.close(figure)
            raise


def _legend_each(axes: np.ndarray) -> None:
    for each in axes:
        if each.get_legend_handles_labels()[0]:
            each.legend()


def checked_axes(axes: object, count: int | None = None) -> np.ndarray:
    """Return axes in one row, shape [N]; raises `InputError` for another number of them or other objects."""
    expected = "matplotlib axes" if count is None else f"{count} matplotlib axes"
    try:
        flat = np.ravel(np.asarray(axes, dtype=object))
    except TypeError as error:  # of objects that have a length and cannot be iterated, as records
        raise InputError(f"axes: expected {expected}, got {type(axes).__name__}") from error
    if not flat.size or not all(isinstance(each, Axes) for each in flat):
        raise InputError(f"axes: expected {expected}, got {type(axes).__name__}")
    if count is not None and flat.size != count:
        raise InputError(f"axes: expected {expected}, got {flat.size}")
    return flat
