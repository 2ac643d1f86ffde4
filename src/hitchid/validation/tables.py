"""The tables of a validation, for Markdown and for the terminal."""

from collections.abc import Mapping, Sequence
from typing import Any

from hitchid.validation.table import Table, digits, error_cells
from hitchid.validation.trust_tables import band_table, trust_tables

NAMES = {
    "persistence": "persistence",
    "arx": "ARX",
    "narx": "NARX",
    "lstm": "black-box LSTM",
    "transfer_function": "paper's transfer function",
    "paper": "paper's grey box",
    "benchmark": "benchmark",
    "greybox": "grey box",
}
RUNS = {"one_step": "one step", "free_run": "free run"}


def tables(metrics: Mapping[str, Any]) -> list[Table]:
    """Return for each direction accuracy, horizons and single tests, and the cycles at the end."""
    unit = metrics["unit"]
    all_tables = []
    for direction, channel in metrics["channels"].items():
        all_tables += [
            accuracy_table(direction, channel, unit),
            horizon_table(direction, channel, unit),
            single_test_table(direction, channel["per_test"], unit),
            *trust_tables(direction, channel, unit),
        ]
    if metrics["cycles"]["tests"]:
        all_tables += cycle_tables(metrics["cycles"], unit)
    return all_tables


def markdown(content: Sequence[Table], notices: Sequence[str], *, title: str = "Validation") -> str:
    """Return tables, and before them what a reader should not miss, as Markdown."""
    lines = [f"# {title}", ""]
    if notices:
        lines += [*(f"- {notice}" for notice in notices), ""]
    for table in content:
        lines += [
            f"## {table.title}",
            "",
            _line(table.header),
            _line(("---", *("---:" for _ in table.header[1:]))),
            *(_line(row) for row in table.rows),
            "",
        ]
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def accuracy_table(direction: str, channel: Mapping[str, Any], unit: str) -> Table:
    """Return how far every model errs on a direction's unseen tests, one step ahead and in free run."""
    models = {**channel["baselines"], "benchmark": channel["benchmark"], "greybox": channel["greybox"]}
    rows = [
        (NAMES[name], label, *error_cells(figures))
        for run, label in RUNS.items()
        for name, model in models.items()
        if (figures := model.get(run)) is not None
    ]
    count = len(channel["tests"])
    tests = f"{count} unseen test{'s' if count != 1 else ''}"
    return Table(f"{direction}: accuracy on {tests}", error_header(unit, "model", "run"), tuple(rows))


def error_header(unit: str, *names: str) -> tuple[str, ...]:
    """Return the header over `error_cells`, behind names of the first columns."""
    errors = (f"RMSE / {unit}", f"MAE / {unit}", "R²", "fit / %", f"max abs / {unit}", f"below 1 {unit} / %")
    return (*names, *errors)


def horizon_table(direction: str, channel: Mapping[str, Any], unit: str) -> Table:
    """Return how far every model errs over each horizon."""
    horizons = channel["horizons"]
    rows = [(NAMES[name], *(digits(value) for value in horizons[name])) for name in NAMES if name in horizons]
    header = ("model", *(str(step) for step in horizons["steps"]))
    return Table(f"{direction}: RMSE / {unit} over the horizon in samples", header, tuple(rows))


def single_test_table(title: str, per_test: Mapping[str, Any], unit: str) -> Table:
    """Return how far the grey box errs in free run on every test."""
    rows = [(name, *error_cells(test["free_run"])) for name, test in per_test.items()]
    return Table(f"{title}: grey box in free run, test by test", error_header(unit, "test"), tuple(rows))


def cycle_tables(cycles: Mapping[str, Any], unit: str) -> list[Table]:
    """Return accuracy, horizons and single tests of the cycles, and how well bands hold there."""
    count = len(cycles["tests"])
    rows = tuple(
        (NAMES[name], label, *error_cells(cycles[name][run]))
        for run, label in RUNS.items()
        for name in NAMES
        if run in cycles.get(name, {})
    )
    title = f"cycles: accuracy over {count} unseen cycle{'s' if count != 1 else ''}"
    return [
        Table(title, error_header(unit, "model", "run"), rows),
        horizon_table("cycles", cycles, unit),
        single_test_table("cycles", cycles["per_test"], unit),
        *([band_table("cycles", cycles["bands"], unit)] if "bands" in cycles else []),
    ]
