"""Style of all figures: widths, one colour per model, legends and axes."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from typing import Any, NamedTuple, ParamSpec, Protocol, TypeVar, runtime_checkable

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator, StrMethodFormatter

from hitchid._support.inert import printable
from hitchid.errors import InputError

DECADE, DECADES = 10, 50  # ratio of axis ends: below, linear ticks; above, powers of ten only; chosen
DECIMATION_BINS = 300  # segments of a curve, each drawn by its lowest and highest point; chosen

COLUMN_IN, PAGE_IN = 3.5, 7.2
"""Widths of a journal's column and page, inch: 89 and 183 mm."""


class Shade(NamedTuple):
    """A colour for a light and for a dark background."""

    light: str
    dark: str


# Okabe and Ito's colours, three more for the baselines, and lighter ones of similar hue for dark screens.
# Dashes and markers distinguish curves for readers with colour vision deficiency.
SHADES = {
    "ink": Shade("#1b1b1f", "#e4e4ea"),
    "faint": Shade("#85858f", "#9a9aa6"),
    "grid": Shade("#dcdce1", "#3a3a44"),
    "greybox": Shade("#009e73", "#2fc99b"),
    "one_step": Shade("#0072b2", "#5ab4ec"),
    "benchmark": Shade("#d55e00", "#ff8f47"),
    "transfer_function": Shade("#cc79a7", "#e59bc6"),
    "arx": Shade("#8c6d1f", "#c9a54e"),
    "oe": Shade("#5b7f95", "#92b8cf"),
    "narx": Shade("#e69f00", "#f2b632"),
    "lstm": Shade("#7a5ba6", "#b79be0"),
    "crimson": Shade("#9b1c3a", "#f0708a"),
    "hold": Shade("#ededf0", "#2c2c34"),
}
COLOURS = {name: shade.light for name, shade in SHADES.items()} | {
    "free_run": SHADES["greybox"].light,
    "persistence": SHADES["faint"].light,
    "mechanistic": SHADES["faint"].light,
    "paper": SHADES["transfer_function"].light,
    "paper_one_step": SHADES["transfer_function"].light,
}
COMPARED = {
    "A": ("one_step", (None, None), "o"),
    "B": ("benchmark", (4, 1.5), "s"),
    "C": ("greybox", (1.2, 1.2), "^"),
    "D": ("lstm", (5, 1.2, 1.2, 1.2), "D"),
    "E": ("narx", (8, 2), "v"),
    "F": ("transfer_function", (2.5, 1.5), "P"),
    "G": ("arx", (6, 1.5, 1, 1.5, 1, 1.5), "*"),
    "H": ("crimson", (1, 2.5), "<"),
}
"""Label of a compared model to the name of its shade, its dashes and its marker."""
COLOURS |= {label: SHADES[shade].light for label, (shade, _, _) in COMPARED.items()}
PAPER = "#ffffff"
INK, FAINT, GRID = COLOURS["ink"], COLOURS["faint"], COLOURS["grid"]
SUBSET_COLOURS = {"training": COLOURS["one_step"], "validation": COLOURS["transfer_function"]}
DASHES = {
    "benchmark": (4, 1.5),
    "transfer_function": (1.2, 1.2),
    "paper": (5, 1.2, 1.2, 1.2),
    "mechanistic": (6, 1.5, 1, 1.5),
    "arx": (2.5, 1.5),
    "lstm": (1, 2),
    "oe": (8, 2),
    **{label: dashes for label, (_, dashes, _) in COMPARED.items()},
}
MARKERS = {
    "persistence": "x",
    "benchmark": "s",
    "transfer_function": "v",
    "paper": "^",
    "arx": "D",
    "oe": "<",
    "narx": "P",
    "lstm": "*",
    **{label: marker for label, (_, _, marker) in COMPARED.items()},
}
"""Models with similar colours differ in dashes and markers; a model that is not listed has neither."""
_RC_PARAMS: dict[Any, Any] = {
    "figure.constrained_layout.use": True,
    "font.family": ["DejaVu Sans", "sans-serif"],
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.fontsize": 7.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.facecolor": "none",
    "figure.facecolor": PAPER,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "legend.borderaxespad": 0.2,
    "lines.linewidth": 1.1,
    "path.simplify_threshold": 0.3,
    "svg.hashsalt": "hitchid",
    "svg.fonttype": "none",
    "text.parse_math": False,  # names and units are no mathematics
    "text.usetex": False,  # nor programs of TeX, whatever the user's settings are
}


@runtime_checkable
class HasFigure(Protocol):
    """A figure with words and data."""

    @property
    def figure(self) -> Figure:
        """The figure."""
        ...


_Params = ParamSpec("_Params")
_Drawn = TypeVar("_Drawn", bound=Figure | HasFigure)


@contextmanager
def style() -> Iterator[None]:
    """Apply the style of all figures within the context; matplotlib's settings are restored."""
    with mpl.rc_context(_RC_PARAMS):
        yield


def styled(draw: Callable[_Params, _Drawn]) -> Callable[_Params, _Drawn]:
    """Return a function that draws its figure, alone or in a picture, in the style of all figures."""

    @wraps(draw)
    def wrapper(*args: _Params.args, **kwargs: _Params.kwargs) -> _Drawn:
        with style():
            drawn = draw(*args, **kwargs)
            plain_texts(drawn if isinstance(drawn, Figure) else drawn.figure)
            return drawn

    return wrapper


def plain_texts(artist: Artist) -> None:
    """Show the texts of a figure, or of a part of it, as they are, but for characters that no font has."""
    for text in artist.findobj(Text):
        if isinstance(text, Text):
            text.set(text=printable(text.get_text()).expandtabs(1), parse_math=False, usetex=False)


def finite_or_nan(values: Iterable[float | None]) -> np.ndarray:
    """Return values as an array, NaN for None; a line has a gap there."""
    return np.array([np.nan if value is None else value for value in values])


def decimate(x: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a decimated curve: the lowest and the highest point of each of 300 segments.

    Args:
        x, values: the curve, shape [N]; NaN is a gap.
    """
    if values.size <= 2 * DECIMATION_BINS:
        return x, values
    indices = []
    for bin_indices in np.array_split(np.arange(values.size), DECIMATION_BINS):
        is_finite = np.isfinite(values[bin_indices])
        finite, gaps = bin_indices[is_finite], bin_indices[~is_finite]
        extremes = (
            [finite[np.argmin(values[finite])], finite[np.argmax(values[finite])]] if finite.size else []
        )
        indices += sorted({*map(int, extremes), *map(int, gaps)})
    return x[indices], values[indices]


def curve(x: np.ndarray, values: np.ndarray, *, thin: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return a curve, decimated where `thin`: for files; a figure on a screen may be zoomed."""
    return decimate(x, values) if thin else (x, values)


def legend_above(figure: Figure, *axes: Axes, columns: int = 2, order: Sequence[str] = ()) -> None:
    """Add one legend of the labelled artists of some axes above the figure; labels of `order` first."""
    handles: dict[str, Artist] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    ordered = [label for label in order if label in handles]
    handles = {label: handles[label] for label in dict.fromkeys([*ordered, *handles])}
    figure.legend(
        list(handles.values()), list(handles), ncols=columns, loc="outside upper left", columnspacing=1.2
    )


def logarithmic(axis: Axis) -> None:
    """Make an axis logarithmic, with plain numbers at 1, 2 and 5, or at powers of ten over many decades."""
    set_scale = axis.axes.set_xscale if isinstance(axis, XAxis) else axis.axes.set_yscale
    set_scale("log")
    low, high = axis.get_view_interval()
    if high < DECADE * low:
        # Within a decade 1, 2 and 5 are too few numbers to read a value by.
        axis.set_major_locator(MaxNLocator(4))
    else:
        axis.set_major_locator(LogLocator(subs=(1.0,) if high > DECADES * low else (1.0, 2.0, 5.0)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))


# The axes of a plot: the caller's own, or those of a new figure.

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
            for subplot in given:  # what the caller wrote into them stays
                for own in (subplot.xaxis.label, subplot.yaxis.label, subplot.get_legend()):
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
            elif any(subplot.get_legend_handles_labels()[0] for subplot in made):
                legend_above(figure, *made, columns=LEGEND_COLUMNS, order=legend_order)
            figure.align_ylabels()
            plain_texts(figure)
        except BaseException:
            pyplot.close(figure)
            raise


def _legend_each(axes: np.ndarray) -> None:
    for subplot in axes:
        if subplot.get_legend_handles_labels()[0]:
            subplot.legend()


def checked_axes(axes: object, count: int | None = None) -> np.ndarray:
    """Return axes in one row, shape [N]; raises `InputError` for another number of them or other objects."""
    expected = "matplotlib axes" if count is None else f"{count} matplotlib axes"
    try:
        flat = np.ravel(np.asarray(axes, dtype=object))
    except TypeError as error:  # of objects that have a length and cannot be iterated, as records
        raise InputError(f"axes: expected {expected}, got {type(axes).__name__}") from error
    if not flat.size or not all(isinstance(item, Axes) for item in flat):
        raise InputError(f"axes: expected {expected}, got {type(axes).__name__}")
    if count is not None and flat.size != count:
        raise InputError(f"axes: expected {expected}, got {flat.size}")
    return flat
