"""A report on disk: the page, its figures, and a PDF where one is asked for."""

from collections.abc import Mapping
from pathlib import Path

from hitchid._support.storage import write_files, write_folder
from hitchid.report.document import Document
from hitchid.report.page import html
from hitchid.report.pdf import pdf
from hitchid.report.svg import svg

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
    """Write a report and what goes with it, whole or not at all.

    Args:
        folder: where to.
        document: the report.
        files: what goes with it, name to content.
        mark: a file of these that an older result holds; `force` replaces nothing else.
        as_pdf: whether `report.pdf` is written too.
        force: replace an older result.

    Raises:
        OutputError: something stands there already, or it cannot be written.
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
    svgs = {picture.name: svg(picture.figure) for picture in document.pictures}
    (folder / FIGURES).mkdir()
    write_files(folder / FIGURES, {f"{name}.svg": _utf8(content) for name, content in svgs.items()})
    write_files(folder, {REPORT_FILE: _utf8(html(document, svgs))})
    if as_pdf:
        (folder / PDF_FILE).write_bytes(pdf(document, svgs))


def _utf8(text: str) -> bytes:
    """Return text as UTF-8; the name of a log may hold what is no character."""
    return text.encode("utf-8", errors="replace")
