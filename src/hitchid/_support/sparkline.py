"""A small picture of curves as one SVG element, in the colour of the text around it."""

from collections.abc import Sequence

import numpy as np

from hitchid._support.inert import html_text

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
    lines = [
        _polyline(curve, scale, opacity)
        for curve, scale, opacity in zip(curves, scales or curves, OPACITIES, strict=False)
    ]
    return _picture("".join(reversed(lines)), label)


def _picture(lines: str, label: str) -> str:
    return (
        f'<svg role="img" aria-label="{html_text(label)}" width="{WIDTH}" height="{HEIGHT}" '
        f'viewBox="0 0 {WIDTH} {HEIGHT}" fill="none" stroke="currentColor">{lines}</svg>'
    )


def _polyline(curve: np.ndarray, scale: np.ndarray, opacity: float) -> str:
    positions, values = _thinned(curve)
    ends = scale[np.isfinite(scale)]
    if not values.size or not ends.size:
        return ""
    lowest, span = ends.min(), np.ptp(ends) or 1.0
    x = MARGIN + (WIDTH - 2 * MARGIN) * positions
    y = HEIGHT - MARGIN - (HEIGHT - 2 * MARGIN) * np.clip((values - lowest) / span, 0.0, 1.0)
    points = " ".join(f"{left:.0f},{top:.1f}" for left, top in zip(x, y, strict=True))
    return f'<polyline points="{points}" stroke-opacity="{opacity}"/>'


def _thinned(curve: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions from 0 to 1 and values: in each column of the picture the least and the largest."""
    samples = np.asarray(curve, dtype=np.float64)
    rows = np.flatnonzero(np.isfinite(samples))
    if rows.size > 2 * COLUMNS:
        columns = np.array_split(rows, COLUMNS)
        extremes = [(part[samples[part].argmin()], part[samples[part].argmax()]) for part in columns]
        rows = np.unique(extremes)
    return rows / max(1, samples.size - 1), samples[rows]
