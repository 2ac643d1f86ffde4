"""A report as PDF, set by typst."""

import json
import shutil
import tempfile
from collections.abc import Mapping
from importlib.resources import as_file, files
from importlib.util import find_spec
from pathlib import Path

import matplotlib as mpl

from hitchid.errors import InputError
from hitchid.report.document import Block, Document, Finding, Findings, Pictures, Section, Text
from hitchid.report.page import SIGNS
from hitchid.validation import numeric

TEMPLATE = "report.typ"


def check_pdf(*, asked: bool) -> None:
    """Complain early where a PDF is asked for and cannot be made.

    Raises:
        InputError: typst is not installed.
    """
    if asked and find_spec("typst") is None:
        raise InputError("typst is not installed; required: pip install 'hitchid[pdf]'")


def pdf(document: Document, drawn: Mapping[str, str]) -> bytes:
    """Return a report as PDF, the same each time.

    Args:
        document: the report.
        drawn: name of each picture to its SVG file.

    Raises:
        InputError: typst is not installed.
    """
    check_pdf(asked=True)
    import typst

    with tempfile.TemporaryDirectory() as kept:
        place = Path(kept)
        (place / "figures").mkdir()
        for name, content in drawn.items():
            (place / "figures" / f"{name}.svg").write_bytes(content.encode("utf-8", errors="replace"))
        told = json.dumps(_described(document), ensure_ascii=False)
        (place / "report.json").write_bytes(told.encode("utf-8", errors="replace"))
        with as_file(files("hitchid.report") / "templates" / TEMPLATE) as template:
            shutil.copy(template, place)
        fonts = Path(mpl.get_data_path()) / "fonts" / "ttf"
        made = typst.compile(place / TEMPLATE, font_paths=[fonts], ignore_system_fonts=True, timestamp=0)
    if not isinstance(made, bytes):
        raise TypeError("one file was expected of typst")
    return made


def _described(document: Document) -> dict:
    return {
        "title": document.title,
        "subtitle": document.subtitle,
        "verdict": [_finding(each) for each in document.verdict],
        "notices": list(document.notices),
        "sections": [_section(each) for each in document.sections],
    }


def _section(content: Section) -> dict:
    return {
        "title": content.title,
        "blocks": [_block(each) for each in content.blocks],
        "sections": [_section(each) for each in content.sections],
    }


def _block(block: Block) -> dict:
    match block:
        case Text(said):
            return {"kind": "text", "said": said}
        case Findings(items):
            return {"kind": "findings", "items": [_finding(each) for each in items]}
        case Pictures(items):
            kept = ("name", "caption", "alt", "wide")
            return {
                "kind": "pictures",
                "items": [{key: getattr(each, key) for key in kept} for each in items],
            }
        case table:
            title = f"{table.title[:1].upper()}{table.title[1:]}"
            return {"kind": "table", "numeric": numeric(table), **table._asdict(), "title": title}


def _finding(finding: Finding) -> dict[str, str]:
    return {
        "level": finding.level.value,
        "sign": SIGNS[finding.level],
        "sentence": finding.sentence,
    }
