"""A report as PDF, set by typst."""

import json
import shutil
import tempfile
from importlib.resources import as_file, files
from pathlib import Path

import matplotlib as mpl

from hitchid._support.inert import printable_texts
from hitchid.report.document import (
    Block,
    Document,
    Equation,
    Faint,
    Finding,
    Findings,
    Pictures,
    ReportSection,
    Text,
)
from hitchid.report.page import SIGNS
from hitchid.report.renderer import Renderer

TEMPLATE = "report.typ"


class Pdf(Renderer):
    """PDF, set by typst."""

    name, suffix = "pdf", ".pdf"
    package, extra = "typst", "pdf"

    def render(self, document: Document) -> bytes:
        """Return the document as PDF."""
        return _pdf(document)


def _pdf(document: Document) -> bytes:
    import typst

    with tempfile.TemporaryDirectory() as temporary_folder:
        folder = Path(temporary_folder)
        (folder / "figures").mkdir()
        for picture in document.pictures:
            path = folder / "figures" / f"{picture.name}.svg"
            path.write_text(picture.svg, encoding="utf-8")
        report_json = json.dumps(printable_texts(_document_dict(document)), ensure_ascii=False)
        (folder / "report.json").write_text(report_json, encoding="utf-8")
        with as_file(files("hitchid.report") / "templates" / TEMPLATE) as template:
            shutil.copy(template, folder)
        fonts = Path(mpl.get_data_path()) / "fonts" / "ttf"
        output = typst.compile(folder / TEMPLATE, font_paths=[fonts], ignore_system_fonts=True, timestamp=0)
    if not isinstance(output, bytes):
        raise TypeError("one file was expected of typst")
    return output


def _document_dict(document: Document) -> dict:
    return {
        "title": document.title,
        "subtitle": document.subtitle,
        "uses": list(document.uses),
        "verdict": [_finding(finding) for finding in document.verdict],
        "notices": list(document.notices),
        "sections": [_section(section) for section in document.sections],
    }


def _section(content: ReportSection) -> dict:
    return {
        "title": content.title,
        "blocks": [_block(block) for block in content.blocks],
        "sections": [_section(section) for section in content.sections],
    }


def _block(block: Block) -> dict:
    match block:
        case Text(text) | Equation(text=text):
            return {"kind": "text", "text": text}
        case Findings(items):
            return {"kind": "findings", "items": [_finding(finding) for finding in items]}
        case Pictures(items):
            picture_keys = ("name", "caption", "alt", "wide")
            return {
                "kind": "pictures",
                "items": [{key: getattr(picture, key) for key in picture_keys} for picture in items],
            }
        case table:
            title = f"{table.title[:1].upper()}{table.title[1:]}"
            faint = [[isinstance(cell, Faint) for cell in row] for row in table.rows]
            cells = table._asdict() | {"title": title}
            return {"kind": "table", "numeric": table.numeric, "faint": faint, **cells}


def _finding(finding: Finding) -> dict[str, str]:
    return {
        "level": finding.level.value,
        "sign": SIGNS[finding.level],
        "sentence": finding.sentence,
    }
