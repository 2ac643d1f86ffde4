"""The PDF: every block in it, as text whatever the names hold, with an outline and a reading order."""

import re
import shutil
import subprocess
from importlib.util import find_spec

import pytest

import reported
from hitchid.report import Document, Finding, Pictures, Rating, ReportSection, Table, Text, render

# What typst's own markup is written in, what JSON and SVG escape, and half a letter, as names of files have.
HOSTILE = (
    "#panic() *a* _b_ `c` $x$ @key <label> = h / - + ~ -- //",
    '\\n "q" \\u{41} \\',
    "<a href='b'>&amp;</a>",
    "Füße ± 0.5 … 1",
    "[a] {b} (c) ]]> )",
)


@pytest.fixture(scope="module")
def made():
    """Return a function that makes a PDF of a report."""
    if find_spec("typst") is None:
        pytest.skip("typst is not installed; pip install 'hitchid[pdf]'")
    return lambda document: render(document, "pdf")


@pytest.fixture(scope="module")
def content(made):
    """Return the PDF of a report with a block of every kind."""
    return made(reported.document())


@pytest.fixture
def words(tmp_path):
    """Return a function that reads the words of a PDF, white space as one blank, or skips the test."""
    program = shutil.which("pdftotext")
    if program is None:
        pytest.skip("pdftotext is not installed; it reads what a PDF says")

    def said(content):
        (tmp_path / "report.pdf").write_bytes(content)
        command = [program, "-layout", "-enc", "UTF-8", str(tmp_path / "report.pdf"), "-"]
        done = subprocess.run(command, capture_output=True, check=True)  # noqa: S603
        return " ".join(done.stdout.decode().split())

    return said


def test_a_pdf_has_outline_and_reading_order_and_no_time(content):
    assert content.startswith(b"%PDF-")
    assert content.rstrip().endswith(b"%%EOF")
    assert set(re.findall(rb"D:(\d{4})", content)) <= {b"1970"}
    # It can be read aloud.
    assert b"/StructTreeRoot" in content
    assert b"/Lang(en)" in content
    assert content.count(b"/Alt(Error over the horizon.)") == 2
    headings = re.findall(rb"/Title\(((?:[^\\()]|\\.)*)\)", content)
    expected = [b"A report", b"Verdict", b"To keep in mind", b"Mixed cycles", b"Details", b"Finer", b"Logs"]
    assert sorted(headings) == sorted(expected)


def test_every_block_is_in_the_pdf(content, words):
    shown, table = words(content), reported.TABLE
    expected = [*table.header, *(cell for row in table.rows for cell in row), "Lifting: accuracy"]
    expected += [finding.sentence for finding in reported.FINDINGS]
    expected += ["A report", "of A paragraph.", "Mind the gap.", "What is seen.", "RMSE / mm", "persistence"]
    assert [text for text in expected if text not in shown] == []


def test_text_that_is_markup_elsewhere_stays_text(made, words):
    sections = []
    for hostile in HOSTILE:
        table = Table(f"t {hostile}", (f"h {hostile}", "n"), ((f"c {hostile}", f"d {hostile}"),))
        pictures = Pictures((reported.picture(caption=f"p {hostile}", alt=hostile),))
        sections.append(ReportSection(f"section {hostile}", (Text(f"text {hostile}"), table, pictures)))
    whole = " ".join(HOSTILE)
    findings = tuple(Finding(Rating.BAD, f"finding {hostile}") for hostile in HOSTILE)
    notices = tuple(f"notice {hostile}" for hostile in HOSTILE)
    document = Document(f"title {whole}", f"subtitle {whole}", findings, notices, tuple(sections))
    # The kerning of a font may join hyphens; what is compared is letters and signs without their gaps.
    shown = words(made(document)).replace(" ", "")
    for front in ("title", "subtitle"):
        assert f"{front}{whole}".replace(" ", "") in shown
    for front in ("finding", "notice", "section", "text", "T", "h", "c", "d", "p"):
        for hostile in HOSTILE:
            assert f"{front}{hostile}".replace(" ", "") in shown, front


def test_a_long_table_repeats_its_header_an_empty_one_stays(made, words):
    rows = tuple((f"test-{number:03d}", f"{number}.5") for number in range(120))
    long = Table("lifting: all", ("test of the series", "RMSE / mm"), rows)
    empty = Table("lifting: nothing", ("model", "RMSE / mm"), ())
    shown = words(made(Document("A", "B", (), (), (ReportSection("All", (long, empty)),))))
    assert all(name in shown for name, _ in rows)
    assert shown.count("test of the series") >= 2
    assert "Lifting: nothing" in shown
