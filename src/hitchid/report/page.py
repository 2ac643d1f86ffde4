"""A report as one page of HTML that needs nothing else."""

from collections.abc import Mapping

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from hitchid.report.document import Document, Findings, Picture, Pictures, Rating, Text
from hitchid.report.figures.style import SHADES
from hitchid.report.svg import inline_svg
from hitchid.validation import Table, numeric

SIGNS = {Rating.GOOD: "✓", Rating.CAUTION: "!", Rating.BAD: "✗"}
_KINDS = {Text: "text", Findings: "findings", Pictures: "pictures", Table: "table"}


def html(document: Document, svgs: Mapping[str, str]) -> str:
    """Return a report as a page without a script or a request to anywhere.

    Args:
        document: the report.
        svgs: name of each picture to its SVG file.
    """
    environment = Environment(
        loader=PackageLoader("hitchid.report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )

    def image(picture: Picture) -> Markup:
        return Markup(inline_svg(svgs[picture.name], picture.name, picture.alt))  # noqa: S704 - our own

    template = environment.get_template("page.html")
    return template.render(
        document=document,
        shades=SHADES,
        signs=SIGNS,
        image=image,
        numeric=numeric,
        kind=lambda block: _KINDS[type(block)],
        place=lambda titles: "-".join(titles).lower().replace(" ", "-"),
    )
