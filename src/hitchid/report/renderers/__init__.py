"""Renderers: a document as web page, PDF, Markdown, text for a terminal, JUnit XML, JSON, workbook."""

from collections.abc import Iterable, Mapping
from importlib.util import find_spec

from hitchid._support.extensions import with_extensions
from hitchid.errors import InputError
from hitchid.report.document import Document
from hitchid.report.renderers.html import Html
from hitchid.report.renderers.interactive import Interactive
from hitchid.report.renderers.json import Json
from hitchid.report.renderers.junit import JUnit
from hitchid.report.renderers.markdown import Markdown
from hitchid.report.renderers.pdf import Pdf
from hitchid.report.renderers.renderer import Renderer as Renderer
from hitchid.report.renderers.terminal import Terminal
from hitchid.report.renderers.xlsx import Xlsx

BUILT_IN: tuple[Renderer, ...] = (
    Html(),
    Interactive(),
    Pdf(),
    Markdown(),
    Terminal(),
    JUnit(),
    Json(),
    Xlsx(),
)


def registered_renderers() -> Mapping[str, Renderer]:
    """Return every renderer by name, including those of other installed packages.

    Raises:
        InputError: a renderer of another package cannot be used.
    """
    return with_extensions("hitchid.renderers", BUILT_IN, kind=Renderer, name=lambda renderer: renderer.name)


def render(document: Document, renderer: str) -> bytes:
    """Return a document in the format of a renderer.

    Args:
        document: the document.
        renderer: its name.

    Raises:
        InputError: there is no such renderer, or it requires a package that is not installed.
    """
    return _renderer(renderer).render(document)


def check_renderers(names: Iterable[str]) -> None:
    """Check that renderers can be used, before any work.

    Raises:
        InputError: there is no such renderer, or it requires a package that is not installed.
    """
    for name in names:
        _renderer(name)


def _renderer(name: str) -> Renderer:
    renderers = registered_renderers()
    if name not in renderers:
        raise InputError(f"renderer: got '{name}', expected one of {', '.join(renderers)}")
    renderer = renderers[name]
    if renderer.package and find_spec(renderer.package) is None:
        raise InputError(
            f"{renderer.package} is not installed; required: pip install 'hitchid[{renderer.extra}]'"
        )
    return renderer
