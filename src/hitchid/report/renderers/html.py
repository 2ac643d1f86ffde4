"""A report as one self-contained HTML page."""

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from hitchid._support.inert import html_value
from hitchid.plots.style import SHADES
from hitchid.report.document import (
    Document,
    Equation,
    Faint,
    Findings,
    Picture,
    Pictures,
    Rating,
    Table,
    Text,
)
from hitchid.report.renderers.renderer import Renderer
from hitchid.report.svg import inline_svg

SIGNS = {Rating.GOOD: "✓", Rating.CAUTION: "!", Rating.BAD: "✗"}
_KINDS = {Text: "text", Equation: "equation", Findings: "findings", Pictures: "pictures", Table: "table"}


class Html(Renderer):
    """One HTML page without scripts or external resources."""

    name, suffix = "html", ".html"

    def render(self, document: Document) -> bytes:
        """Return the page as UTF-8; characters that cannot be encoded, as in names of logs, are replaced."""
        return _page(document).encode("utf-8", errors="replace")


def _page(document: Document) -> str:
    environment = Environment(
        loader=PackageLoader("hitchid.report"),
        autoescape=True,
        finalize=html_value,
        undefined=StrictUndefined,
        trim_blocks=True,
    )

    def image(picture: Picture) -> Markup:
        return Markup(inline_svg(picture.svg, picture.name, picture.alt))  # noqa: S704 - our own

    environment.tests["faint"] = lambda cell: isinstance(cell, Faint)
    template = environment.get_template("page.html")
    return template.render(
        document=document,
        shades=SHADES,
        signs=SIGNS,
        image=image,
        math=lambda equation: Markup(equation.mathml),  # noqa: S704 - our own
        kind=lambda block: _KINDS[type(block)],
        place=lambda titles: "-".join(titles).lower().replace(" ", "-"),
    )
