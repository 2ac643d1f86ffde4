"""Renderers: a document as HTML, PDF, Markdown, text for a terminal, JUnit XML, JSON."""

from collections.abc import Mapping

from hitchid._support.extensions import with_extensions
from hitchid.errors import InputError
from hitchid.report.document import Document
from hitchid.report.renderers.html import Html
from hitchid.report.renderers.json import Json
from hitchid.report.renderers.junit import JUnit
from hitchid.report.renderers.markdown import Markdown
from hitchid.report.renderers.pdf import Pdf
from hitchid.report.renderers.renderer import Renderer as Renderer
from hitchid.report.renderers.terminal import Terminal

BUILT_IN: tuple[Renderer, ...] = (Html(), Pdf(), Markdown(), Terminal(), JUnit(), Json())


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
    renderers = registered_renderers()
    if renderer not in renderers:
        raise InputError(f"renderer: got '{renderer}', expected one of {', '.join(renderers)}")
    return renderers[renderer].render(document)
