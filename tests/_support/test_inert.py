"""Hostile names and units through the function of each kind of place, into tables and to a terminal."""

import csv
import io
import re
import tomllib
import unicodedata
from xml.etree import ElementTree

import pytest
from rich.table import Table as RichTable

from hitchid._support import inert
from hitchid._support.console import PlainConsole, line
from hitchid._support.tables import DataTable, Table
from hitchid.errors import InputError
from hitchid.logs.formats.text import write_rows
from hostile import STRINGS, acts

SHOWN = tuple(map(inert.printable, STRINGS))


def test_printable_text_keeps_all_characters_but_those_that_act():
    assert len(STRINGS) >= 200
    for text, shown in zip(STRINGS, SHOWN, strict=True):
        assert not any(acts(character) for character in shown if character not in "\n\t")
        if all(character.isprintable() for character in text):
            assert shown == text
    assert inert.printable("\x1b\u202e\udcff\U000e0041") == r"\u001b\u202e\udcff\U000e0041"


def test_units_stay_readable_in_comments():
    units = {"°C": "degC", "µm": "um", "m³/s": "m^3/s", "N·m": "N.m", "N*m": "N.m", "mm/s": "mm/s", "%": "%"}
    assert {unit: inert.comment(unit) for unit in units} == units


def test_identifiers_are_distinct_and_short():
    names = inert.identifiers([*STRINGS, *STRINGS])
    assert len({name.lower() for name in names}) == 2 * len(STRINGS)
    assert all(re.fullmatch("[A-Za-z0-9_]{1,40}", name) for name in names)
    assert inert.identifiers(["a b", "a_b", "A b"]) == ("a_b", "a_b_2", "A_b_3")


def test_a_string_of_toml_is_read_back():
    for text in STRINGS:
        if not any(unicodedata.category(character) == "Cs" for character in text):
            assert tomllib.loads(f"x = {inert.toml_text(text)}") == {"x": text}


def test_an_element_of_xml_keeps_its_texts_and_no_other():
    root = ElementTree.Element("root")
    for text in STRINGS:
        ElementTree.SubElement(root, "part", {"name": text}).text = text
    read = ElementTree.fromstring(inert.xml_bytes(root))  # noqa: S314 - our own
    assert [child.tag for child in read.iter()] == ["root", *["part"] * len(STRINGS)]
    assert [child.get("name") for child in read] == list(SHOWN)
    assert [child.text or "" for child in read] == list(SHOWN)


def is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


@pytest.fixture
def table():
    """Return a table of all strings as names of columns and as cells, beside numbers."""
    rows = tuple((text, -1.5, "-2.5e-3", None, True) for text in STRINGS)
    return DataTable("names", ("=1+1", "-1", "@x", "+x", "b"), rows)


def test_a_cell_of_csv_is_no_formula_numbers_stay(table, tmp_path):
    write_rows(tmp_path / "log.csv", table.columns, [[row[0], "-inf"] for row in table.rows])
    for content in (table.csv().decode(), (tmp_path / "log.csv").read_bytes().decode()):
        header, *rows = csv.reader(io.StringIO(content, newline=""))
        assert header == ["'=1+1", "-1", "'@x", "'+x", "b"]
        assert len(rows) == len(STRINGS)
        for cells in (*rows, header):
            for cell in cells:
                begins = cell.strip()[:1] in tuple("=+-@＝＋－＠")  # noqa: RUF001
                assert not begins or is_number(cell) or not any(map(str.isalnum, cell))
                assert not any(acts(character) for character in cell if character not in "\n\t")
        assert {row[1] for row in rows} <= {"-1.5", "-inf"}


def test_shown_text_has_no_terminal_sequence():
    stream = io.StringIO()
    content = RichTable(title="\x1b[1m[bold]title")
    content.add_column("\x1b]0;x\x07")
    for text in STRINGS:
        content.add_row(text)
        stream.write(line(text))
    console = PlainConsole(file=stream, width=80)
    console.print(content)
    console.print(*STRINGS)
    stream.write(Table("\x1b", ("\x1b", "x"), tuple((text, text) for text in STRINGS), STRINGS).text())
    stream.write(str(InputError("\n".join(STRINGS))))
    assert not {character for character in stream.getvalue() if acts(character)} - {"\n", "\t"}
    assert "[/bold]" in stream.getvalue()
    assert ":smile:" in stream.getvalue()
