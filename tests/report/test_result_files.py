"""The tables of a validation as data: the figures of `metrics.json`, unrounded, and files beside it."""

import csv
import json

import pytest

import validated
from hitchid.errors import OutputError
from hitchid.report import write_report
from hitchid.report.validation_report import all_tables

OF_LIFTING = (
    *("accuracy", "horizons", "tests", "bands", "parameters", "paper-parameters", "speed-map"),
    *("characteristics", "load-scatter", "residuals", "residuals-by-quantity", "searches"),
)
EXPECTED = {
    *(f"lifting-{name}" for name in OF_LIFTING),
    *(f"cycles-{name}" for name in ("accuracy", "horizons", "tests")),
    "logs",
}


@pytest.fixture(scope="module")
def tables():
    return validated.validation().tables()


@pytest.fixture(scope="module")
def metrics():
    return validated.validation().metrics


def rows(table):
    return [dict(zip(table.columns, row, strict=True)) for row in table.rows]


def test_every_table_is_there_by_its_name(tables):
    assert set(tables) == EXPECTED
    assert all(table.name == name for name, table in tables.items())
    # No table of the report is without one as data. Those of residuals have the bins apart; logs are in the
    # report's own section.
    named = set(tables) - {"logs", "lifting-residuals-by-quantity"}
    assert len(all_tables(validated.validation())) == len(named)


def test_figures_are_those_of_the_json_bit_for_bit(tables, metrics):
    channel = metrics["channels"]["lifting"]
    models = {**channel["baselines"], "benchmark": channel["benchmark"], "greybox": channel["greybox"]}
    accuracy = rows(tables["lifting-accuracy"])
    assert len(accuracy) == sum(len(runs) for runs in models.values())
    for row in accuracy:
        figures = models[row["model"]][row["run"]]
        assert row["rmse_mm"] == figures["rmse"]
        assert row["rmse_standard_error_mm"] == figures["rmse_error"]
        assert row["fit_percent"] == figures["fit"]
        assert row["share_below_1_mm"] == figures["within_1"]
    for row in rows(tables["lifting-tests"]):
        assert row["max_abs_mm"] == channel["per_test"][row["test"]]["free_run"]["max_abs"]
    horizons = rows(tables["lifting-horizons"])
    assert [row["horizon_samples"] for row in horizons] == channel["horizons"]["steps"]
    assert [row["greybox_rmse_mm"] for row in horizons] == channel["horizons"]["greybox"]
    for row in rows(tables["lifting-parameters"]):
        estimate = channel["parameters"]["estimates"][row["name"]]
        assert [row["interval_95_lower"], row["interval_95_upper"]] == estimate["interval_95"]
        assert (row["value"], row["standard_error"]) == (estimate["value"], estimate["standard_error"])


def test_what_diverged_has_no_number(tables):
    (row,) = (r for r in rows(tables["lifting-accuracy"]) if (r["model"], r["run"]) == ("narx", "free_run"))
    assert all(value is None for name, value in row.items() if name not in ("model", "run"))


def test_the_load_of_a_speed_map_has_its_unit(tables):
    table = tables["lifting-speed-map"]
    assert {"command_A", "head_pressure_bar", "speed_mm/s"} <= set(table.columns)
    origins = [row["origin"] for row in rows(table)]
    assert origins == ["model"] * 9 + ["measured"] * 2


def test_files_lie_beside_the_json_and_read_back_alike(tables, tmp_path):
    out = tmp_path / "out"
    validated.validation().write(out)
    assert {path.stem for path in (out / "tables").glob("*.csv")} == EXPECTED
    with (out / "tables" / "lifting-accuracy.csv").open() as file:
        header, *cells = csv.reader(file)
    table = tables["lifting-accuracy"]
    assert tuple(header) == table.columns
    at = header.index("rmse_mm")
    assert [float(row[at]) if row[at] else None for row in cells] == [row[at] for row in table.rows]
    assert json.loads((out / "metrics.json").read_text())["unit"] == "mm"


def test_a_folder_is_replaced_by_force_alone_unless_changed(tmp_path):
    out = tmp_path / "out"
    result = validated.validation()
    result.write(out)
    with pytest.raises(OutputError, match="--force"):
        result.write(out)
    written = []
    for _ in range(2):
        write_report(out, result.report(), result.files(), mark="metrics.json", force=True)
        written.append({path: path.read_bytes() for path in out.rglob("*.*") if path.is_file()})
    assert len(written[0]) > 40
    assert written[0] == written[1]
    (out / "tables" / "logs.csv").write_text("mine")
    with pytest.raises(OutputError, match=r"tables/logs\.csv"):
        result.write(out, force=True)
