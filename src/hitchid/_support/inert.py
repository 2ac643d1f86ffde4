"""Text from a file, made inert where it is written: one function for each kind of place.

Names of logs, machines, columns and models, and units, are whatever a stranger wrote. A comment of generated
code takes permitted characters alone, since no escape holds in it; every other place an escaped literal.
"""

import json
import re
from collections.abc import Iterable, Mapping
from html import escape
from unicodedata import category
from xml.etree import ElementTree

# Controls, marks of direction and invisible ones, halves of surrogate pairs, separators of lines and of
# paragraphs.
_ACTING = ("Cc", "Cf", "Cs", "Zl", "Zp")
_HARMLESS = "\n\t\u200c\u200d"  # the last two join letters, in Persian and Indic scripts
_SUSPECT = re.compile(r"[^\n\t -~]")
_SYMBOLS = str.maketrans(
    {"°": "deg", "µ": "u", "μ": "u", "Ω": "Ohm", "²": "^2", "³": "^3", "·": ".", "*": "."}
)
_NOT_IN_COMMENTS = re.compile(r"[^A-Za-z0-9 .,:()\[\]%+\-_/^=]")
LONGEST_COMMENT = 60  # characters of one name or unit in a comment; chosen: a line of generated code
LONGEST_IDENTIFIER = 40  # characters; with `LOAD_` within the 63 that C99 distinguishes
_NUMBER = re.compile(r"[+-]?(inf|nan|[\d.,]*\d[\d.,]*(e[+-]?\d+)?\s*%?)", re.IGNORECASE)
_FORMULAS = ("=", "+", "-", "@", "＝", "＋", "－", "＠")  # noqa: RUF001 - their wide forms count, too
_ENDS_SCRIPT = {ord(character): f"\\u{ord(character):04x}" for character in "<>&\u2028\u2029"}
_MARKDOWN = re.compile(r"[\\`|<\[*]")


def printable(text: str) -> str:
    r"""Return text without characters that act on what shows it, which become escapes such as `\u001b`.

    Those are control characters but for line breaks and tabs, marks of the direction of writing, invisible
    ones, separators of lines, and halves of surrogate pairs. XML 1.0 permits all that is left.
    """
    return _SUSPECT.sub(_shown, text)


def _shown(match: re.Match) -> str:
    character, code = match[0], ord(match[0])
    is_none = code & 0xFFFE == 0xFFFE or 0xFDD0 <= code <= 0xFDEF  # Unicode will never assign these
    if character in _HARMLESS or not (is_none or category(character) in _ACTING):
        return character
    return f"\\u{code:04x}" if code <= 0xFFFF else f"\\U{code:08x}"


def printable_texts(content: object) -> object:
    """Return content of JSON with printable texts; names of its members stay."""
    match content:
        case str():
            return printable(content)
        case dict():
            return {name: printable_texts(part) for name, part in content.items()}
        case list() | tuple():
            return [printable_texts(part) for part in content]
        case _:
            return content


def comment(text: str) -> str:
    """Return text of permitted ASCII characters, at most 60, for a comment of C or a docstring of Python.

    None of them ends a comment or string, continues a line, or begins a trigraph; others become `_`.
    """
    ascii_text = " ".join(text.translate(_SYMBOLS).split())
    permitted = _NOT_IN_COMMENTS.sub("_", ascii_text)
    return permitted if len(permitted) <= LONGEST_COMMENT else f"{permitted[: LONGEST_COMMENT - 3]}..."


def identifiers(names: Iterable[str]) -> tuple[str, ...]:
    """Return a distinct name of letters, digits and underscores, at most 40, for each name."""
    distinct: dict[str, str] = {}  # by their lower case: symbols in C are in upper case
    for name in names:
        plain = re.sub("[^A-Za-z0-9]", "_", name)[:LONGEST_IDENTIFIER] or "_"
        number, candidate = 1, plain
        while candidate.lower() in distinct:
            number += 1
            candidate = f"{plain[: LONGEST_IDENTIFIER - len(str(number)) - 1]}_{number}"
        distinct[candidate.lower()] = candidate
    return tuple(distinct.values())


def html_text(text: str) -> str:
    """Return text for an element or a quoted attribute of HTML."""
    return escape(printable(text))


def html_value(value: object) -> object:
    """Return a value that a template of HTML with `autoescape` shows; its `finalize`."""
    return printable(value) if type(value) is str else value  # not of markup, which is our own


def script_json(content: Mapping[str, object]) -> str:
    """Return JSON for a script element of HTML: nothing in its strings ends the element or a line."""
    text = json.dumps(printable_texts(content), ensure_ascii=False, separators=(",", ":"))
    return text.translate(_ENDS_SCRIPT)


def toml_text(text: str) -> str:
    """Return a basic string of TOML, in one line."""
    return printable(json.dumps(text, ensure_ascii=False))


def xml_bytes(root: ElementTree.Element) -> bytes:
    """Return an XML 1.0 document, indented; its texts and attributes are made printable."""
    for element in root.iter():
        element.text = element.text and printable(element.text)
        for name, value in element.attrib.items():
            element.set(name, printable(value))
    ElementTree.indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="utf-8") + b"\n"


def spreadsheet_text(text: str) -> str:
    """Return text for a cell of CSV, which no spreadsheet takes for a formula; numbers stay as they are."""
    if _NUMBER.fullmatch(text):
        return text
    shown = printable(text)
    may_be_formula = shown.lstrip().startswith(_FORMULAS) and any(map(str.isalnum, shown))
    return f"'{shown}" if may_be_formula else shown


def markdown_text(text: str) -> str:
    """Return text for a line or a cell of Markdown: no HTML, link, code or further cell begins in it."""
    return _MARKDOWN.sub(lambda match: f"\\{match[0]}", " ".join(printable(text).splitlines()))
