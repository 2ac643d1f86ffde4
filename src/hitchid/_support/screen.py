"""Text and small pictures that an object shows of itself: at most one screen."""

import textwrap
from collections.abc import Sequence

import numpy as np

from hitchid._support.inert import html_text, printable

MAX_LINES, MAX_WIDTH = 25, 110  # lines and characters of a screen; chosen
NOTE_LINES, NAME_WIDTH = 3, 24  # lines of a note; characters of a name among others; chosen
GAP = "  "  # between columns


def screen(lines: Sequence[str], last: Sequence[str] = ()) -> str:
    """Return lines and last lines as text; lines too many are counted instead, long ones are cut."""
    last = last[: MAX_LINES // 2]
    room = MAX_LINES - len(last)
    if len(lines) > room:
        lines = [*lines[: room - 1], f"{GAP}… {len(lines) - room + 1} more lines"]
    texts = [printable(line) for line in [*lines, *last]]
    return "\n".join(text if len(text) <= MAX_WIDTH else f"{text[: MAX_WIDTH - 1]}…" for text in texts)


def shortened(text: str, width: int = MAX_WIDTH) -> str:
    """Return a text on one line, cut with an ellipsis where it is longer than `width` characters."""
    line = " ".join(printable(text).split())
    return line if len(line) <= width else f"{line[: width - 1]}…"


def first_notes(notes: Sequence[str], maximum: int, attribute: str) -> tuple[str, ...]:
    """Return the first notes, and how many more an attribute of the object holds."""
    more = len(notes) - maximum
    return (*notes[:maximum], *([f"and {more} more: see .{attribute}"] if more > 0 else []))


def first_to_last(names: Sequence[str]) -> str:
    """Return one or two names, or the first and the last of more."""
    shown = [shortened(name, NAME_WIDTH) for name in (names if len(names) <= 2 else (names[0], names[-1]))]
    return (", " if len(names) <= 2 else " … ").join(shown)


def wrapped(start: str, text: str) -> list[str]:
    """Return a text in lines that fit on the screen, the first after `start`, the others indented as far."""
    lines = textwrap.wrap(" ".join(text.split()), max(MAX_WIDTH - len(start), MAX_WIDTH // 4)) or [""]
    return [(start + lines[0]).rstrip(), *(" " * len(start) + line for line in lines[1:])]


# A small picture of curves as one SVG element, in the colour of the text around it.

WIDTH, HEIGHT, MARGIN = 220, 48, 2  # pixels; chosen
COLUMNS = 55  # of the picture, one for four pixels: each shows the least and the largest sample in it
OPACITIES = (1.0, 0.45, 0.25)  # of the first curve and those below it; chosen


def sparkline(curves: Sequence[np.ndarray], label: str, scales: Sequence[np.ndarray] | None = None) -> str:
    """Return curves over their sample number.

    Args:
        curves: the first is drawn strongest; each of shape [N].
        label: text for screen readers.
        scales: for each curve the values between whose least and largest it is drawn; by default its own.
    """
    lines = []
    for curve, scale, opacity in zip(curves, scales or curves, OPACITIES, strict=False):
        positions, values = _thinned(curve)
        ends = scale[np.isfinite(scale)]
        if not values.size or not ends.size:
            continue
        lowest, span = ends.min(), np.ptp(ends) or 1.0
        x = MARGIN + (WIDTH - 2 * MARGIN) * positions
        y = HEIGHT - MARGIN - (HEIGHT - 2 * MARGIN) * np.clip((values - lowest) / span, 0.0, 1.0)
        points = " ".join(f"{left:.0f},{top:.1f}" for left, top in zip(x, y, strict=True))
        lines.append(f'<polyline points="{points}" stroke-opacity="{opacity}"/>')
    return (
        f'<svg role="img" aria-label="{html_text(label)}" width="{WIDTH}" height="{HEIGHT}" '
        f'viewBox="0 0 {WIDTH} {HEIGHT}" fill="none" stroke="currentColor">{"".join(reversed(lines))}</svg>'
    )


def _thinned(curve: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions from 0 to 1 and values: in each column of the picture the least and the largest."""
    samples = np.asarray(curve, dtype=np.float64)
    rows = np.flatnonzero(np.isfinite(samples))
    if rows.size > 2 * COLUMNS:
        columns = np.array_split(rows, COLUMNS)
        extremes = [(part[samples[part].argmin()], part[samples[part].argmax()]) for part in columns]
        rows = np.unique(extremes)
    return rows / max(1, samples.size - 1), samples[rows]
