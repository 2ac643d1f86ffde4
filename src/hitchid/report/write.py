"""A report on disk: HTML page, figures, and optionally a PDF."""

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
    """Write a report and further files into a folder, all or none.

    Args:
        folder: to write.
        document: the report.
        files: name to content of the further files.
        mark: the file of these that identifies an older result; `force` replaces only such folders.
        as_pdf: whether to write `report.pdf` too.
        force: replace an older result.

    Raises:
        OutputError: the folder exists and `force` is not given, or it cannot be written.
        InputError: a PDF is requested and typst is not installed.
    """

    def write(target: Path) -> None:
        write_files(target, files)
        write_report_files(document, target, as_pdf=as_pdf)

    write_folder(folder, write, result_kind=mark, force=force)


def write_report_files(document: Document, folder: Path, *, as_pdf: bool = False) -> None:
    """Write `report.html`, `figures/*.svg` and, if requested, `report.pdf` into an existing folder.

    Raises:
        InputError: a PDF is requested and typst is not installed.
    """
    figures = {f"{picture.name}.svg": _utf8(picture.svg) for picture in document.pictures}
    (folder / FIGURES).mkdir()
    write_files(folder / FIGURES, figures)
    write_files(folder, {REPORT_FILE: render(document, "html")})
    if as_pdf:
        (folder / PDF_FILE).write_bytes(render(document, "pdf"))


def _utf8(text: str) -> bytes:
    """Return text as UTF-8; characters that cannot be encoded, as in names of logs, are replaced."""
    return text.encode("utf-8", errors="replace")
