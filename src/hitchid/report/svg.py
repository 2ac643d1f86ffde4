"""A figure as SVG: small, reproducible, and embeddable in a page."""

import re
from io import StringIO

from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from hitchid._support.inert import html_text, printable
from hitchid.plots.style import PAPER, SHADES, style

_TAG = re.compile("<[^>]+>")  # text between tags is not changed
_LONG_NUMBER = re.compile(r"-?\d+\.\d{3,}")
_ID = re.compile(r' id="([^"]+)"')
_REFERENCE = re.compile(r'(?:url\(#|href="#)([^)"]+)')
_COLOUR = re.compile("#[0-9a-fA-F]{6}")
_STYLE = re.compile(r"\s*<defs>\s*<style.*?</style>\s*</defs>", re.DOTALL)
_NO_METADATA = dict.fromkeys(("Date", "Creator", "Format", "Type"))
_CSS_VARIABLES = {PAPER: "none"} | {
    shade.light: f"var(--{name.replace('_', '-')})" for name, shade in SHADES.items()
}


def svg(figure: Figure) -> str:
    """Return a figure as an SVG file, lengths to a hundredth of a point."""
    buffer = StringIO()
    with style():
        # As `savefig`, without its additional drawing pass for the layout.
        FigureCanvasSVG(figure).print_svg(buffer, metadata=_NO_METADATA)
    return _TAG.sub(lambda tag: _LONG_NUMBER.sub(_rounded, tag[0]), printable(buffer.getvalue()))


def _rounded(number: re.Match) -> str:
    return f"{float(number[0]):.2f}"


def inline_svg(text: str, name: str, alt: str) -> str:
    """Return an SVG file as an element of a page, with an alt text, in the page's colours.

    Its identifiers begin with `name`, so that they are unique in the page.
    """
    element = text[text.index("<svg") :]
    referenced_ids = {identifier for tag in _TAG.findall(element) for identifier in _REFERENCE.findall(tag)}

    def adapt(tag: re.Match) -> str:
        adapted = _ID.sub(
            lambda match: f' id="{name}-{match[1]}"' if match[1] in referenced_ids else "", tag[0]
        )
        adapted = _REFERENCE.sub(lambda match: match[0].replace("#", f"#{name}-"), adapted)
        return _COLOUR.sub(lambda match: _CSS_VARIABLES.get(match[0].lower(), match[0]), adapted)

    # Tag by tag: a name of a log that looks like a colour or a reference is text, and stays as it is.
    element = _TAG.sub(adapt, element)
    head, rest = element.split(">", 1)
    head = re.sub(r' (?:width|height|version|xmlns(?::xlink)?)="[^"]*"', "", head)
    return f'{head} role="img" aria-label="{html_text(alt)}">{_STYLE.sub("", rest, count=1)}'
