"""A report as one self-contained HTML page, as an interactive page, and as PDF."""

import json
import shutil
import tempfile
from base64 import b64encode
from hashlib import sha256
from importlib.resources import as_file, files
from pathlib import Path

import matplotlib as mpl
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from hitchid._support.inert import html_value, printable_texts, script_json
from hitchid.plots.style import COLOURS, DASHES, SHADES
from hitchid.report.document import (
    Block,
    Document,
    Equation,
    Faint,
    Finding,
    Findings,
    Picture,
    Pictures,
    Rating,
    Renderer,
    ReportSection,
    Signals,
    Table,
    Text,
)
from hitchid.report.svg import inline_svg
from hitchid.validation import Predictions
from hitchid.validation.results import label

# The unseen tests of a report as one self-contained interactive page.

SCRIPTS = ("interactive-plots.js", "interactive-controls.js")
SHOWN_FIRST = ("benchmark", "free_run", "one_step")  # drawn at first of a model; of several, all are; chosen


class Interactive(Renderer):
    """One HTML page with its own script: tests with zoom, synchronised cursors and read-out.

    It requests nothing from outside; its content security policy permits its own script and style alone.
    """

    name, suffix = "interactive", ".html"

    def render(self, document: Document) -> bytes:
        """Return the page as UTF-8; a document without signals gives a page without a test."""
        colours = f"{_colours('light')}@media (prefers-color-scheme: dark) {{ {_colours('dark')} }}\n"
        style, script = colours + _template("interactive.css"), "".join(map(_template, SCRIPTS))
        signals = document.signals
        page = (
            _environment()
            .get_template("interactive.html")
            .render(
                title=document.title,
                subtitle=document.subtitle,
                style=Markup(style),  # noqa: S704 - our own
                script=Markup(script),  # noqa: S704 - our own
                style_hash=_hash(style),
                script_hash=_hash(script),
                data=Markup(script_json({} if signals is None else _content(signals))),  # noqa: S704 - escaped
            )
        )
        return page.encode("utf-8", errors="replace")


def _environment() -> Environment:
    """Return an environment for templates in which every text is escaped."""
    return Environment(
        loader=PackageLoader("hitchid.report"),
        autoescape=True,
        finalize=html_value,
        undefined=StrictUndefined,
        trim_blocks=True,
    )


def _template(name: str) -> str:
    return (files("hitchid.report") / "templates" / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """Return the source of an inline script or style in a content security policy."""
    return f"sha256-{b64encode(sha256(text.encode()).digest()).decode()}"


def _colours(scheme: str) -> str:
    """Return the colours of a scheme as CSS variables."""
    shades = (f"--{name.replace('_', '-')}: {getattr(shade, scheme)};" for name, shade in SHADES.items())
    return f":root {{ {' '.join(shades)} }}\n"


def _content(signals: Signals) -> dict[str, object]:
    return {
        "unit": signals.unit,
        "sections": {
            name: [_test(tests, index, signals) for index in range(len(tests.names))]
            for name, tests in signals.tests.items()
        },
    }


def _test(tests: Predictions, index: int, signals: Signals) -> dict[str, object]:
    band, is_compared = tests.band, "free_run" not in tests.models
    colours = {shade.light: name.replace("_", "-") for name, shade in SHADES.items()}
    return {
        "name": tests.names[index],
        "time": _floats(tests.time_s[index]),
        "measured": _floats(tests.actual[index]),
        "band": None if band is None else [_floats(rows[index]) for rows in band],
        "models": [
            {
                "key": model,
                "label": label(model),
                "values": _floats(rows[index]),
                "colour": f"--{colours[COLOURS.get(model, COLOURS['ink'])]}",
                "dash": [2 * length for length in DASHES.get(model, ()) if length],
                "shown": is_compared or model in SHOWN_FIRST,
            }
            for model, rows in tests.models.items()
        ],
        "commands": [
            {
                "label": f"{name.replace('_', ' ')} / {signals.command_unit[name]}",
                "values": _floats(rows[index]),
                "colour": f"--{('one-step', 'benchmark')[number % 2]}",
            }
            for number, (name, rows) in enumerate(tests.commands.items())
        ],
    }


def _floats(values: np.ndarray) -> str:
    """Return values in single precision, little endian, in base64: a relative error below 6e-8."""
    # A run that diverged beyond single precision is infinite there, which is no error.
    with np.errstate(over="ignore"):
        return b64encode(np.asarray(values, dtype="<f4").tobytes()).decode()


SIGNS = {Rating.GOOD: "✓", Rating.CAUTION: "!", Rating.BAD: "✗"}
_KINDS = {Text: "text", Equation: "equation", Findings: "findings", Pictures: "pictures", Table: "table"}


class Html(Renderer):
    """One HTML page without scripts or external resources."""

    name, suffix = "html", ".html"

    def render(self, document: Document) -> bytes:
        """Return the page as UTF-8; characters that cannot be encoded, as in names of logs, are replaced."""
        environment = _environment()
        environment.tests["faint"] = lambda cell: isinstance(cell, Faint)

        def image(picture: Picture) -> Markup:
            return Markup(inline_svg(picture.svg, picture.name, picture.alt))  # noqa: S704 - our own

        page = environment.get_template("page.html").render(
            document=document,
            shades=SHADES,
            signs=SIGNS,
            image=image,
            math=lambda equation: Markup(equation.mathml),  # noqa: S704 - our own
            kind=lambda block: _KINDS[type(block)],
            place=lambda titles: "-".join(titles).lower().replace(" ", "-"),
        )
        return page.encode("utf-8", errors="replace")


# A document as PDF.

TEMPLATE = "report.typ"


class Pdf(Renderer):
    """PDF, set by typst."""

    name, suffix = "pdf", ".pdf"
    package, extra = "typst", "pdf"

    def render(self, document: Document) -> bytes:
        """Return the document as PDF."""
        import typst

        content = {
            "title": document.title,
            "subtitle": document.subtitle,
            "uses": list(document.uses),
            "verdict": [_finding(finding) for finding in document.verdict],
            "notices": list(document.notices),
            "sections": [_section(section) for section in document.sections],
        }
        with tempfile.TemporaryDirectory() as temporary_folder:
            folder = Path(temporary_folder)
            (folder / "figures").mkdir()
            for picture in document.pictures:
                path = folder / "figures" / f"{picture.name}.svg"
                path.write_text(picture.svg, encoding="utf-8")
            report_json = json.dumps(printable_texts(content), ensure_ascii=False)
            (folder / "report.json").write_text(report_json, encoding="utf-8")
            with as_file(files("hitchid.report") / "templates" / TEMPLATE) as template:
                shutil.copy(template, folder)
            fonts = Path(mpl.get_data_path()) / "fonts" / "ttf"
            output = typst.compile(
                folder / TEMPLATE, font_paths=[fonts], ignore_system_fonts=True, timestamp=0
            )
        if not isinstance(output, bytes):
            raise TypeError("one file was expected of typst")
        return output


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
            cells = {"title": title, "header": table.header, "rows": table.rows}
            return {"kind": "table", "numeric": table.numeric, "faint": faint, **cells}


def _finding(finding: Finding) -> dict[str, str]:
    return {
        "level": finding.level.value,
        "sign": SIGNS[finding.level],
        "sentence": finding.sentence,
    }
