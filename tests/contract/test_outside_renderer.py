"""A renderer of another package: found by its name beside hitchid's own, and written to a file."""

import csv
import json
from xml.etree import ElementTree

import pytest

import handmade
import plotted
from hitchid.errors import InputError, OutputError
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import LIFTING
from hitchid.report import registered_renderers, render
from hitchid.validation import validate

BUILT_IN = ["html", "interactive", "pdf", "markdown", "terminal", "junit", "json", "xlsx"]


@pytest.fixture(scope="module")
def installed(install):
    """Install the example."""
    with pytest.MonkeyPatch.context() as patch:
        install(patch, "renderer_from_outside")
        yield


@pytest.fixture(scope="module")
def result():
    """Return a validation with two lifting tests."""
    tests = [plotted.record(f"lifting-{seed}", seed=seed) for seed in range(2)]
    return validate(handmade.hitch("integrator", modes=(LIFTING,)), Campaign.of(tests))


def test_it_stands_beside_those_of_the_package(installed):
    assert list(registered_renderers()) == [*BUILT_IN, "csv"]


def test_a_renderer_not_installed_is_refused_by_name(result):
    with pytest.raises(InputError, match="got 'latex', expected one of html, interactive, pdf, markdown"):
        render(result.report(), "latex")


def test_it_writes_the_tables_of_a_validation(installed, result, tmp_path):
    result.write_as("csv", tmp_path / "tables.csv")
    rows = list(csv.reader((tmp_path / "tables.csv").read_text().splitlines()))
    assert ["lifting: accuracy on 2 unseen tests"] in rows
    for table in result.report().tables:
        at = rows.index([table.title])
        assert rows[at + 1] == list(table.header)
        assert rows[at + 2 : at + 2 + len(table.rows)] == [list(row) for row in table.rows]
    with pytest.raises(OutputError, match="--force"):
        result.write_as("csv", tmp_path / "tables.csv")


@pytest.mark.parametrize("name", [name for name in BUILT_IN if name != "pdf"])
def test_every_renderer_gives_equal_bytes_for_equal_documents(result, name):
    document = result.report(command="hitchid validate")
    content = render(document, name)
    assert content
    assert content == render(result.report(command="hitchid validate"), name)


def test_each_renderer_writes_its_form(result, tmp_path):
    document = result.report()
    assert json.loads(render(document, "json")) == json.loads(json.dumps(result.metrics))
    assert ElementTree.fromstring(render(document, "junit")).get("tests") == "0"  # noqa: S314
    assert "grey box" in render(document, "terminal").decode()
    assert max(map(len, render(document, "terminal").decode().splitlines())) <= 80
    assert "# Validation of a model" in render(document, "markdown").decode()
    result.to_html(tmp_path / "report.html")
    assert (tmp_path / "report.html").read_bytes() == render(document, "html")
