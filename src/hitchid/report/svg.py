"""A figure as SVG: small, the same each time, and fit to stand inside a page."""

import re
from html import escape
from io import StringIO

from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from hitchid.report.figures.style import PAPER, SHADES, style

_TAG = re.compile("<[^>]+>")  # what stands between tags are the words and numbers people read
_LONG = re.compile(r"-?\d+\.\d{3,}")
_ID = re.compile(r' id="([^"]+)"')
_USED = re.compile(r'(?:url\(#|href="#)([^)"]+)')
_COLOUR = re.compile("#[0-9a-fA-F]{6}")
_STYLE = re.compile(r"\s*<defs>\s*<style.*?</style>\s*</defs>", re.DOTALL)
_NO_METADATA = dict.fromkeys(("Date", "Creator", "Format", "Type"))
_VARIABLE = {PAPER: "none"} | {
    shade.light: f"var(--{name.replace('_', '-')})" for name, shade in SHADES.items()
}


def svg(figure: Figure) -> str:
    """Return a figure as an SVG file, lengths to a hundredth of a point."""
    kept = StringIO()
    with style():
        # What `savefig` does too, without drawing everything once before to measure it.
        FigureCanvasSVG(figure).print_svg(kept, metadata=_NO_METADATA)
    return _TAG.sub(lambda tag: _LONG.sub(_shortened, tag[0]), kept.getvalue())


def _shortened(number: re.Match) -> str:
    return f"{float(number[0]):.2f}"


def inside_page(text: str, name: str, alt: str) -> str:
    """Return an SVG file as an element of a page, named for screen readers, in the page's own colours.

    Args:
        text: an SVG file.
        name: what its identifiers begin with, so that those of two figures differ.
        alt: what it shows.
    """
    element = text[text.index("<svg") :]
    used = {each for tag in _TAG.findall(element) for each in _USED.findall(tag)}

    def fitted(tag: re.Match) -> str:
        named = _ID.sub(lambda found: f' id="{name}-{found[1]}"' if found[1] in used else "", tag[0])
        named = _USED.sub(lambda found: found[0].replace("#", f"#{name}-"), named)
        return _COLOUR.sub(lambda found: _VARIABLE.get(found[0].lower(), found[0]), named)

    element = _TAG.sub(fitted, element)
    head, rest = element.split(">", 1)
    head = re.sub(r' (?:width|height|version|xmlns(?::xlink)?)="[^"]*"', "", head)
    return f'{head} role="img" aria-label="{escape(alt)}">{_STYLE.sub("", rest, count=1)}'
