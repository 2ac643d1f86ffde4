"""The PDF: the same each time, whole whatever the names hold, and asked for early where it cannot be made."""

import re
import shutil
import subprocess
from importlib.util import find_spec

import pytest

import reported
from hitchid.errors import InputError
from hitchid.report import (
    Document,
    Finding,
    Pictures,
    Rating,
    ReportSection,
    Table,
    Text,
    check_renderers,
    render,
)

# What typst's own markup is written in, what JSON and SVG escape, and half a letter, as names of files have.
HOSTILE = {
    "markup": "#panic() *a* _b_ `c` $x$ @key <label> = h / - + ~ -- //",
    "strings": '\\n "q" \\u{41} \\',
    "tags": "<a href='b'>&amp;</a>",
    "letters": "Füße ± 0.5 … 1",
    "brackets": "[a] {b} (c) ]]> )",
}


@pytest.fixture(scope="module")
def made():
    """Return a function that makes a PDF of a report, with figures drawn as a report draws them."""
    if find_spec("typst") is None:
        pytest.skip("typst is not installed; pip install 'hitchid[pdf]'")

    def make(document):
        return render(document, "pdf")

    return make


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


def test_a_pdf_is_one(content):
    assert content.startswith(b"%PDF-")
    assert content.rstrip().endswith(b"%%EOF")


def test_the_same_report_gives_the_same_bytes(made, content):
    assert made(reported.document()) == content


def test_no_time_of_day_is_written(content):
    assert set(re.findall(rb"D:(\d{4})", content)) <= {b"1970"}


def test_a_pdf_can_be_read_aloud(content):
    assert b"/StructTreeRoot" in content
    assert b"/Lang(en)" in content
    assert content.count(b"/Alt(Error over the horizon.)") == 2


def test_every_block_is_in_the_pdf(content, words):
    said = words(content)
    table = reported.TABLE
    for each in (*table.header, *(cell for row in table.rows for cell in row), "Lifting: accuracy"):
        assert each in said
    for finding in reported.FINDINGS:
        assert finding.sentence in said
    for each in ("A report", "of A paragraph.", "Mind the gap.", "What is seen.", "RMSE / mm", "persistence"):
        assert each in said


@pytest.mark.parametrize("hostile", HOSTILE.values(), ids=HOSTILE.keys())
def test_text_that_is_markup_elsewhere_stays_text(made, words, hostile):
    table = Table(f"t {hostile}", (f"h {hostile}", "n"), ((f"c {hostile}", f"d {hostile}"),))
    picture = reported.picture(caption=f"p {hostile}", alt=hostile)
    document = Document(
        f"title {hostile}",
        f"subtitle {hostile}",
        (Finding(Rating.BAD, f"finding {hostile}"),),
        (f"notice {hostile}",),
        (ReportSection(f"section {hostile}", (Text(f"text {hostile}"), table, Pictures((picture,)))),),
    )
    said = words(made(document)).replace(" ", "")
    for front in ("title", "subtitle", "finding", "notice", "section", "text", "T", "h", "c", "d", "p"):
        # The kerning of a font may join hyphens; what is compared is letters and signs without their gaps.
        assert f"{front}{hostile}".replace(" ", "") in said, front


@pytest.mark.parametrize(
    "said", ["log-\udcff", "one\ntwo\n\n= three", "\x00", "漢字", "\N{RIGHT-TO-LEFT MARK}", ""]
)
def test_whatever_a_name_holds_a_pdf_is_made(made, said):
    named = ReportSection(said, (Text(said), Table(said, (said, said), ((said, said),))))
    assert made(Document(said, said, reported.FINDINGS, (said,), (named,))).startswith(b"%PDF-")


def test_a_table_without_a_row_is_still_a_table(made, words):
    empty = Table("lifting: nothing", ("model", "RMSE / mm"), ())
    assert "Lifting: nothing" in words(made(reported.document(table=empty)))


def test_a_pdf_that_cannot_be_made_is_refused_early(monkeypatch):
    monkeypatch.setattr("hitchid.report.write.find_spec", lambda name: None)
    check_renderers([])
    check_renderers(["html", "interactive"])
    with pytest.raises(InputError, match=r"hitchid\[pdf\]"):
        check_renderers(["html", "pdf"])
    with pytest.raises(InputError, match=r"hitchid\[pdf\]"):
        render(reported.document(), "pdf")


def titles(content):
    """Return the headings of a PDF's outline, as far as they are written in Latin letters."""
    found = re.findall(rb"/Title\(((?:[^\\()]|\\.)*)\)", content)
    return [re.sub(rb"\\([\\()])", rb"\1", each).decode("latin-1") for each in found]


def test_every_heading_is_in_the_outline(content):
    assert sorted(titles(content)) == sorted(
        ["A report", "Verdict", "To keep in mind", "Mixed cycles", "Details", "Finer", "Logs"]
    )


def test_a_long_table_goes_on_with_its_header_on_the_next_page(made, words):
    rows = tuple((f"test-{number:03d}", f"{number}.5") for number in range(120))
    long = Table("lifting: all", ("test of the series", "RMSE / mm"), rows)
    said = words(made(Document("A", "B", (), (), (ReportSection("All", (long,)),))))
    assert all(name in said for name, _ in rows)
    assert said.count("test of the series") >= 2
