"""A report on disk: the page, its figures, and a PDF where one is asked for."""

from collections.abc import Mapping
from pathlib import Path

from hitchid._support.storage import write_files, write_folder
from hitchid.report.document import Document
from hitchid.report.renderers import render

REPORT_FILE = "report.html"
PDF_FILE = "report.pdf"
FIGURES = "figures"


def write_report(
    folder: Path,
    document: Document,
    files: Mapping[str, bytes],
    *,
    mark: str,
    as_pdf: bool = False,
    force: bool = False,
) -> None:
    """Write a report and the files beside it, whole or not at all.

    Args:
        folder: where to.
        document: the report.
        files: name to content of what is written beside it.
        mark: a file of these by which an older result is recognised; `force` replaces nothing else.
        as_pdf: whether `report.pdf` is written too.
        force: replace an older result.

    Raises:
        OutputError: the folder exists and `force` is not given, or it cannot be written.
        InputError: a PDF is asked for and typst is not installed.
    """

    def write(target: Path) -> None:
        write_files(target, files)
        write_report_files(document, target, as_pdf=as_pdf)

    write_folder(folder, write, result_kind=mark, force=force)


def write_report_files(document: Document, folder: Path, *, as_pdf: bool = False) -> None:
    """Write `report.html`, `figures/*.svg` and, where asked for, `report.pdf` into a folder being filled.

    Raises:
        InputError: a PDF is asked for and typst is not installed.
    """
    figures = {f"{picture.name}.svg": _utf8(picture.svg) for picture in document.pictures}
    (folder / FIGURES).mkdir()
    write_files(folder / FIGURES, figures)
    write_files(folder, {REPORT_FILE: render(document, "html")})
    if as_pdf:
        (folder / PDF_FILE).write_bytes(render(document, "pdf"))


def _utf8(text: str) -> bytes:
    """Return text as UTF-8; what is no character, as in names of logs, is replaced."""
    return text.encode("utf-8", errors="replace")
