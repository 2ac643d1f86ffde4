"""Tables of pandas and polars become the records that the same log as a file becomes."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import hitchid
from hitchid import Campaign, Record
from hitchid.errors import InputError, LogError, SettingsError
from hitchid.logs import write_table

N, STEP_S = 120, 0.01
STAMPS = np.round(STEP_S * np.arange(N), 4)
COMMAND = np.where(np.arange(N) > 5, 0.5, 0.0)
TWO = {"lifting_command": "up_A", "lowering_command": "down_A", "displacement": "x_mm", "time": "t_s"}


def columns(time_s=STAMPS, **changes):
    """Return a log of the default columns."""
    command = np.resize(COMMAND, time_s.size)
    default = {"time_s": time_s, "current_up_A": command, "current_down_A": 0 * command}
    return {**default, "displacement_mm": 7.0 + np.cumsum(command), **changes}


def named(time_s=STAMPS, **changes):
    """Return a log whose columns need the signal map `TWO`."""
    names = ("t_s", "up_A", "down_A", "x_mm")
    return dict(zip(names, columns(time_s).values(), strict=True)) | changes


def toml(value):
    """Return a value of a signal map as TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return f"[{', '.join(map(toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else str(value)


def read_file(folder, table, signals=None):
    """Return the campaign of one log file, `a.csv`."""
    write_table(folder / "a.csv", table)
    if signals is not None:
        lines = [f"{signal} = {toml(column)}" for signal, column in signals.items()]
        (folder / "campaign.toml").write_text("\n".join(["[signals]", *lines]))
    return hitchid.read(folder)


JITTER = STAMPS + 0.003 * np.sin(np.arange(N))
GAP = np.concatenate([STAMPS[:60], STAMPS[60:] + 5.0])
SHORT_GAP = np.concatenate([STAMPS[:60], STAMPS[60:] + 0.1])
TWICE = np.concatenate([STAMPS[:60], STAMPS[59:-1]])
SIGNED = {
    "time": {"column": "ms", "unit": "ms"},
    "command": {"column": "valve", "unit": "percent", "zero": 7.5, "scale": -40.0},
    "displacement": {"column": "angle", "unit": "deg"},
    "covariates": ["p_bar", {"column": "load", "unit": "kN"}],
}
SIGNED_TABLE = {
    "ms": 1e3 * STAMPS,
    "valve": 7.5 + np.sin(np.arange(N) / 9),
    "angle": np.cos(np.arange(N) / 9),
    "p_bar": 100.0 + STAMPS,
    "load": STAMPS**2,
}


TABLES = {
    "plain": (columns(), None, 1),
    "jitter": (columns(JITTER), None, 1),
    "gap": (columns(GAP), None, 2),
    "short gap": (columns(SHORT_GAP), None, 1),
    "equal stamps": (columns(TWICE), None, 1),
    "other columns": (named(), TWO, 1),
    "signed, zero, scale, covariates": (SIGNED_TABLE, SIGNED, 1),
}


@pytest.mark.parametrize(("table", "signals", "records"), TABLES.values(), ids=TABLES.keys())
def test_a_table_gives_the_records_of_the_same_file(tmp_path, table, signals, records):
    from_file = read_file(tmp_path, table, signals)
    from_table = Campaign.from_dataframes({"a": pd.DataFrame(table)}, signals=signals)
    assert len(from_file) == len(from_table) == records
    assert from_table == from_file
    assert [record.notices for record in from_table] == [record.notices for record in from_file]
    assert all(record.source is None for record in from_table)
    if records == 1:
        assert Record.from_dataframe(pd.DataFrame(table), name="a", signals=signals) == from_file[0]


def test_units_of_columns_are_as_in_a_file(tmp_path):
    table = dict(zip(("t_s", "i", "x_mm"), (STAMPS, 1e3 * COMMAND, np.cumsum(COMMAND)), strict=True))
    signals = {"time": "t_s", "displacement": "x_mm", "lifting_command": {"column": "i", "unit": "A"}}
    rows = zip(*(map(repr, values.tolist()) for values in table.values()), strict=True)
    text = "\n".join([",".join(table), "s,mA,mm", *map(",".join, rows), ""])
    (tmp_path / "a.csv").write_text(text)
    lines = [f"{signal} = {toml(column)}" for signal, column in signals.items()]
    (tmp_path / "campaign.toml").write_text("\n".join(["[signals]", *lines]))
    units = {"t_s": "s", "i": "mA", "x_mm": "mm"}
    from_table = Campaign.from_dataframes({"a": pd.DataFrame(table)}, signals=signals, units=units)
    assert from_table == hitchid.read(tmp_path)
    assert from_table[0].units["lifting_command"] == "A"
    assert from_table[0].command("lifting").max() == pytest.approx(0.5, rel=1e-15)
    assert "converted from mA" in str(from_table[0].notices[0])


@pytest.mark.parametrize("kind", ["float", "durations", "dates", "dates with a zone", "column of dates"])
def test_the_time_is_a_column_or_the_index(kind):
    plain = Record.from_dataframe(pd.DataFrame(columns()))
    durations = pd.to_timedelta(STAMPS, unit="s")
    frame = pd.DataFrame({name: values for name, values in columns().items() if name != "time_s"})
    start = pd.Timestamp("2026-03-29 01:59:59.5")
    index = {
        "float": pd.Index(STAMPS, name="time_s"),
        "durations": durations,
        "dates": start + durations,
        # The clocks of Berlin go forward within this log.
        "dates with a zone": (start.tz_localize("Europe/Berlin") + durations),
    }
    if kind == "column of dates":
        frame["time_s"] = start + durations
    else:
        frame = frame.set_index(index[kind])
    assert Record.from_dataframe(frame) == plain


@pytest.mark.parametrize("dtype", ["float32", "Float64", "object"])
def test_any_column_of_numbers_is_read(dtype):
    frame = pd.DataFrame(columns(displacement_mm=np.arange(N)))
    assert Record.from_dataframe(frame.astype({"displacement_mm": dtype})) == Record.from_dataframe(frame)


class Table(dict):
    """A table as polars has it: names, columns with `to_numpy`, no index."""

    columns = property(list)

    def __getitem__(self, name):
        return SimpleNamespace(to_numpy=lambda: super(Table, self).__getitem__(name))


def test_a_table_of_polars_is_read():
    assert Record.from_dataframe(Table(columns())) == Record.from_dataframe(pd.DataFrame(columns()))
    with pytest.raises(LogError, match="'time_s': there is no such column"):
        Record.from_dataframe(Table({k: v for k, v in columns().items() if k != "time_s"}))


@pytest.mark.parametrize(
    "record",
    [
        Record.from_dataframe(pd.DataFrame(columns(JITTER)), name="a"),
        Record.from_dataframe(pd.DataFrame(SIGNED_TABLE), name="b", signals={**SIGNED, "covariates": []}),
    ],
    ids=["in mm and A", "in deg and percent"],
)
def test_a_record_comes_back_from_its_table(record):
    frame = record.to_dataframe()
    assert list(frame)[:2] == ["time_s", f"displacement_{record.unit}"]
    back = Record.from_dataframe(frame, name=record.name)
    assert back == replace(record, notices=(), clock=back.clock)


def test_covariates_come_back_under_the_names_of_their_columns():
    record = Record.from_dataframe(pd.DataFrame(SIGNED_TABLE), signals=SIGNED)
    frame = record.to_dataframe()
    assert list(frame)[-2:] == ["p_bar", "load_kN"]
    signals = {
        "displacement": "displacement_deg",
        "lifting_command": "lifting_command_percent",
        "lowering_command": "lowering_command_percent",
        "covariates": ["p_bar", "load_kN"],
    }
    back = Record.from_dataframe(frame, signals=signals)
    assert back.units["load_kN"] == "kN"
    np.testing.assert_array_equal(back.signals["p_bar"], record.signals["p_bar"])
    np.testing.assert_array_equal(back.signals["load_kN"], record.signals["load"])


def test_kinds_patterns_names_and_end_stops():
    frame = pd.DataFrame(columns())
    options = {"test_patterns": ["*-2"], "kinds": {"*": "lifting"}, "end_stops": (0.0, 250.0)}
    campaign = Campaign.from_dataframes({"up-1": frame, "up-2": frame}, **options)
    assert [record.name for record in campaign.held_out("lifting")] == ["up-2"]
    assert campaign.end_stops == (0.0, 250.0)
    with pytest.raises(InputError, match=r"end_stops: expected the lower and the higher position"):
        Campaign.from_dataframes([frame], end_stops=(250.0, 0.0))
    assert [record.name for record in Campaign.from_dataframes([frame, frame])] == ["test-1", "test-2"]
    assert Record.from_dataframe(frame).kind == "lifting"
    assert Record.from_dataframe(frame, kind="ramp").kind == "ramp"


def test_an_unusable_table_is_left_out_with_the_reason():
    good, bad = pd.DataFrame(columns()), pd.DataFrame(columns()).assign(displacement_mm=np.nan)
    campaign = Campaign.from_dataframes({"good": good, "bad": bad})
    assert [record.name for record in campaign] == ["good"]
    (left_out,) = campaign.left_out
    assert left_out.name == "bad"
    assert "expected finite numbers, got nan" in left_out.reason
    with pytest.raises(LogError, match="bad: column 'displacement_mm': expected finite numbers"):
        Campaign.from_dataframes({"good": good, "bad": bad}, strict=True)


def test_missing_numbers_are_closed_as_in_a_file(tmp_path):
    table = columns(displacement_mm=np.where(np.arange(N) == 7, np.nan, 1.0 * np.arange(N)))
    record = Record.from_dataframe(pd.DataFrame(table))
    np.testing.assert_allclose(record.displacement, np.arange(N), rtol=1e-12)
    assert record.displacement.tobytes() == read_file(tmp_path, table)[0].displacement.tobytes()


def test_a_log_with_a_long_gap_is_no_single_record():
    with pytest.raises(InputError, match=r"2 sections, expected one; use Campaign.from_dataframes"):
        Record.from_dataframe(pd.DataFrame(columns(GAP)))


FRAME = pd.DataFrame(columns())


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Record.from_dataframe(5), "frame: expected a table of pandas or polars, got int"),
        (lambda: Record.from_dataframe(FRAME, kind="up"), "kind: expected one of lifting"),
        (
            lambda: Record.from_dataframe(FRAME, units={"i": "furlong"}),
            "units: column 'i': expected one of A",
        ),
        (lambda: Record.from_dataframe(FRAME, units={"i": "mA"}), "'i': `units` names it, but there is no"),
        (lambda: Record.from_dataframe(FRAME.drop(columns="time_s")), "'time_s': there is no such column"),
        (lambda: Record.from_dataframe(FRAME[["time_s"]]), "no column is named as a command"),
        (lambda: Record.from_dataframe(FRAME.iloc[:0]), "has 0 samples, expected at least 20"),
        (lambda: Record.from_dataframe(FRAME.assign(displacement_mm="x")), "expected numbers, got"),
        (lambda: Record.from_dataframe(FRAME.assign(command_A=0.0)), "either command or lifting_command"),
        (lambda: Record.from_dataframe(FRAME.assign(lifting_command_A=0.0)), "both match lifting_command"),
        (lambda: Record.from_dataframe(pd.concat([FRAME, FRAME], axis=1)), "both match time"),
        (lambda: Record.from_dataframe(FRAME, signals={**TWO, "time": "time_s"}), "'x_mm': there is no such"),
        (lambda: Campaign.from_dataframes(FRAME), "frames: expected a list of tables, or name to table"),
        (lambda: Campaign.from_dataframes([FRAME, 3]), "frames: 'test-2': expected a table"),
        (lambda: Campaign.from_dataframes({1: FRAME}), "frames: name: expected text"),
        (lambda: Campaign.from_dataframes({}), "at least one record"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(call, message):
    with pytest.raises(InputError, match=message):
        call()


@pytest.mark.parametrize(
    ("signals", "message"),
    [
        ({"lifting_comand": "x"}, "key 'signals.lifting_comand' is not known"),
        ({"command": {"column": "x", "unit": "furlong"}}, "key 'signals.command.unit': unit: unit 'furlong'"),
        ({"displacement": "x_A", "command": "y_A"}, "displacement: 'A' is a unit of current"),
        ({}, "expected at least one of command"),
    ],
)
def test_a_signal_map_is_checked_as_that_of_a_file(signals, message):
    with pytest.raises(SettingsError, match=message):
        Record.from_dataframe(FRAME, signals=signals)


def test_without_pandas_the_message_says_what_to_install(monkeypatch):
    record = Record.from_dataframe(FRAME)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"pip install 'hitchid\[pandas\]'"):
        record.to_dataframe()
