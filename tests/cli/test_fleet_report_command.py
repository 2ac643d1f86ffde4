"""`hitchid fleet report`: what it writes, and what it refuses with one line."""

import json
from importlib.util import find_spec

import pytest
from commands import hitchid

import fleet_rows
from hitchid.fleet import Store
from hitchid.fleet.ledger import row_name

pytestmark = pytest.mark.skipif(find_spec("pyarrow") is None, reason="pyarrow is not installed")
FAULTS = {7: {"gain_factor": 0.85}}
TABLES = {"outliers", "machines", "populations", "cohorts", "trends", "failures", "not_compared"}


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """Return a store of results of sixteen machines, one of them failed and one slow."""
    folder = tmp_path_factory.mktemp("fleet") / "results"
    for row in [
        *fleet_rows.fleet(15, faults=FAULTS, directions=("lowering",)),
        fleet_rows.failed_row("broken"),
    ]:
        Store(str(folder)).write(row_name(row.machine, row.signature), row.as_json())
    return folder


def run(*arguments):
    """Return exit code and output, of a refusal what it says."""
    result = hitchid("fleet", "report", *arguments)
    return result.code, result.err if result.code == 2 else result.out


@pytest.fixture(scope="module")
def written(store, tmp_path_factory):
    """Return the folder of a report and what the command printed."""
    out = tmp_path_factory.mktemp("written") / "report"
    code, printed = run(store, "--out", out)
    assert code == 0, printed
    return out, printed


def test_it_writes_a_page_its_figures_and_every_table(written):
    out, printed = written
    assert "1 of 15 machines stands out." in printed
    assert str(out / "report.html") in printed.replace("\n", "")
    assert {path.name for path in (out / "tables").iterdir()} == {
        f"{name}.{suffix}" for name in TABLES for suffix in ("csv", "parquet")
    }
    assert (out / "figures" / "verdicts.svg").exists()
    content = json.loads((out / "comparison.json").read_text(encoding="utf-8"))
    assert content["standing_out"] == ["tractor-07"]
    assert (content["machines"], content["failed"]) == (16, 1)


def test_parquet_has_the_content_of_the_csv_file(written):
    from pyarrow import csv, parquet

    tables = written[0] / "tables"
    table = parquet.read_table(tables / "machines.parquet")
    read = csv.read_csv(tables / "machines.csv")
    assert table.column_names == read.column_names
    assert table.column("estimate").to_pylist() == read.column("estimate").to_pylist()
    assert parquet.read_table(tables / "cohorts.parquet").num_rows == 0


def test_an_older_report_is_replaced_by_force_only(store, written):
    out = written[0]
    code, message = run(store, "--out", out)
    assert code == 2
    assert str(out) in message
    code, printed = run(store, "--out", out, "--force", "--json")
    assert (code, json.loads(printed)) == (0, json.loads((out / "comparison.json").read_text("utf-8")))


def test_machines_of_a_table_are_compared_by_its_columns(store, tmp_path):
    lines = (f"tractor-{number:02d},{'AB'[number % 2]}" for number in range(15))
    table = tmp_path / "machines.csv"
    table.write_text("machine,type\n" + "\n".join(lines) + "\n", encoding="utf-8")
    code, printed = run(store, "--out", tmp_path / "report", "--machines", table, "--json")
    assert code == 0, printed
    assert {cohort["column"] for cohort in json.loads(printed)["cohorts"]} == {"type"}


def test_an_empty_store_and_wrong_options_are_refused(store, tmp_path):
    (tmp_path / "empty").mkdir()
    out = tmp_path / "report"
    assert "has no results of a fleet" in run(tmp_path / "empty", "--out", out)[1]
    (tmp_path / "names.csv").write_text("name,type\na,b\n", encoding="utf-8")
    assert "expected 'machine'" in run(store, "--out", out, "--machines", tmp_path / "names.csv")[1]
    assert run(store, "--out", out, "--level", "1.5") == (
        2,
        "hitchid: --level: got 1.5, expected between 0 and 1\n",
    )
    assert not out.exists()
