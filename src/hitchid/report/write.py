"""A report on disk: HTML page, figures with their data, and optionally PDF, workbook and interactive page."""

from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from hitchid._support.extensions import with_extensions
from hitchid._support.files import write_files, write_folder
from hitchid._support.tables import csv_files
from hitchid.errors import InputError
from hitchid.report.document import Document
from hitchid.report.document import Renderer as Renderer
from hitchid.report.page import Html, Interactive, Pdf
from hitchid.report.text import Json, JUnit, Markdown, Terminal, Xlsx

# Renderers: a document as web page, PDF, Markdown, text for a terminal, JUnit XML, JSON, workbook.

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


FIGURES = "figures"
FILES = {
    "html": "report.html",
    "pdf": "report.pdf",
    "xlsx": "tables.xlsx",
    "interactive": "interactive.html",
}
Format = Literal["pdf", "xlsx", "interactive"]


def write_report(
    folder: Path,
    document: Document,
    files: Mapping[str, bytes],
    *,
    mark: str,
    formats: Iterable[Format] = (),
    force: bool = False,
) -> None:
    """Write a report and further files into a folder, all or none.

    Args:
        folder: to write.
        document: the report.
        files: name to content of the further files.
        mark: the file of these that identifies an older result; `force` replaces only such folders.
        formats: written too: `pdf` as report.pdf, `xlsx` as tables.xlsx, `interactive` as interactive.html.
        force: replace an older result.

    Raises:
        OutputError: the folder exists and `force` is not given, or it cannot be written.
        InputError: a package that a format requires is not installed.
    """

    def write(target: Path) -> None:
        write_files(target, files)
        write_report_files(document, target, formats=formats)

    write_folder(folder, write, result_kind=mark, force=force)


def write_report_files(
    document: Document, folder: Path, *, formats: Iterable[Format] = (), data_folder: str = FIGURES
) -> None:
    """Write `report.html`, each figure as SVG and its data as CSV, and further formats.

    Args:
        document: the report.
        folder: an existing folder.
        formats: as for `write_report`.
        data_folder: folder in it of the CSV files.

    Raises:
        InputError: a package that a format requires is not installed.
    """
    # All is rendered before the first file is written: a renderer that fails leaves nothing half done.
    figures = {f"{FIGURES}/{picture.name}.svg": picture.svg.encode() for picture in document.pictures}
    data = csv_files((picture.table for picture in document.pictures if picture.data), data_folder)
    rendered = {FILES[name]: render(document, name) for name in ("html", *formats)}
    write_files(folder, {**figures, **data, **rendered})
