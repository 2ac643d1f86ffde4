"""CSV logs: every number bit for bit, and every other file refused by file, line and column."""

import csv
import gzip
import io
import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection
from hitchid.logs.formats.numerals import is_number
from hitchid.logs.formats.text import read, read_rows, write_rows, write_table

NAMES = ("time_s", "current_up_A", "displacement_mm")
HEADER = ",".join(NAMES)
ROWS = tuple(f"{k / 100},{k % 3},{k * 1.5}" for k in range(30))
PLAIN = "\n".join([HEADER, *ROWS]) + "\n"
WANTED = {
    "time_s": np.arange(30) / 100,
    "current_up_A": np.arange(30) % 3,
    "displacement_mm": np.arange(30) * 1.5,
}

with_folder = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
finite = st.floats(allow_nan=False, allow_infinity=False)


@pytest.fixture
def log(tmp_path):
    """Return a function that writes text or bytes to a log and returns its path."""

    def write(content, name="log.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def with_cell(cell, row=9, column=1):
    """Return the plain log with one cell changed; row 9 stands in line 11."""
    cells = ROWS[row].split(",")
    cells[column] = cell
    return "\n".join([HEADER, *ROWS[:row], ",".join(cells), *ROWS[row + 1 :]]) + "\n"


def read_table(path, names=NAMES):
    """Return the columns of these names."""
    return read(path, ChannelSelection(names[0], tuple(names[1:])))


def same_bits(one, other):
    return np.asarray(one, dtype=float).tobytes() == np.asarray(other, dtype=float).tobytes()


@with_folder
@given(numbers=arrays(np.float64, st.tuples(st.integers(1, 20), st.just(3)), elements=finite))
@pytest.mark.parametrize("name", ["log.csv", "log.csv.gz"])
def test_any_finite_number_reads_back_bit_for_bit(tmp_path, name, numbers):
    path = tmp_path / name
    write_table(path, dict(zip(NAMES, numbers.T, strict=True)))
    table = read_table(path, NAMES)
    assert (table.source, table.line_of(0)) == (path, 2)
    for column, samples in zip(NAMES, numbers.T, strict=True):
        assert same_bits(table.channels[column].values, samples)


def test_the_same_table_gives_the_same_bytes_compressed_or_not(tmp_path):
    for name in ("a.csv", "a.csv.gz", "b.csv.gz"):
        write_table(tmp_path / name, WANTED)
    assert (tmp_path / "a.csv.gz").read_bytes() == (tmp_path / "b.csv.gz").read_bytes()
    assert gzip.decompress((tmp_path / "a.csv.gz").read_bytes()) == (tmp_path / "a.csv").read_bytes()


GOOD = {
    "plain": PLAIN,
    "no line end at the end": PLAIN.rstrip("\n"),
    "windows line ends": PLAIN.replace("\n", "\r\n"),
    "byte order mark": b"\xef\xbb\xbf" + PLAIN.encode(),
    "spaces about names": PLAIN.replace(",", " , ", 2),
    "spaces about numbers": PLAIN.replace(",", " , "),
    "quoted names": PLAIN.replace(HEADER, '"' + HEADER.replace(",", '","') + '"'),
    "quoted numbers": PLAIN.replace("0.05,2,7.5", '"0.05","2","7.5"'),
    "blank lines": PLAIN.replace("\n", "\n\n"),
    "a comma more in every line": PLAIN.replace("\n", ",\n"),
    "a comma more in every row": HEADER + "\n" + ",\n".join(ROWS) + ",\n",
    "text beside": PLAIN.replace("\n", ",5 mm\n").replace("5 mm", "note", 1),
    "an inch sign beside": PLAIN.replace("\n", ',5" pipe\n').replace('5" pipe', "note", 1),
    "line ends in quotes beside": PLAIN.replace("\n", ',"a\nb"\n').replace('"a\nb"', "note", 1),
    "semicolons": PLAIN.replace(",", ";"),
    "tabs": PLAIN.replace(",", "\t"),
    "bars": PLAIN.replace(",", "|"),
    "spaces": PLAIN.replace(",", "  "),
    "decimal commas": PLAIN.replace(",", ";").replace(".", ","),
    "decimal commas and tabs": PLAIN.replace(",", "\t").replace(".", ","),
    "decimal commas and spaces": PLAIN.replace(",", "   ").replace(".", ","),
    "decimal commas beside text": PLAIN.replace(",", ";").replace(".", ",").replace("\n", ";on, off\n"),
    "a comment first": "# bench 3\n" + PLAIN,
    "a header that is a comment": "# " + PLAIN,
    "a line of units": PLAIN.replace("\n", "\ns,A,mm\n", 1),
    "units in brackets": PLAIN.replace("\n", "\n[s],[A],[mm]\n", 1),
    "units behind the names": PLAIN.replace("time_s", "time_s [s]").replace(
        "current_up_A", "current_up_A (A)"
    ),
    "a preamble": "Bench;3\nDate;21.11.2026 12:30\nSamples;30\n\n" + PLAIN.replace(",", ";"),
    "rows of labels": "\n".join(
        [
            "type,measurement,measurement,measurement",
            "path,Model/Time,Model/Valve/Up,Model/Lift",
            "name," + HEADER,
            "unit,s,A,mm",
            *("trace," + row for row in ROWS),
        ]
    ),
    "a labview measurement": "\n".join(
        [
            "LabVIEW Measurement\t",
            "Separator\tTab",
            "Decimal_Separator\t.",
            "***End_of_Header***\t",
            "\t",
            "Channels\t2",
            "Samples\t30\t30",
            "***End_of_Header***\t",
            "\t".join([*NAMES, "Comment"]),
            *(row.replace(",", "\t") for row in ROWS),
        ]
    ),
    "utf-16": PLAIN.encode("utf-16"),
    "utf-16, the other way round": b"\xfe\xff" + PLAIN.encode("utf-16-be"),
    "utf-16 without a mark": PLAIN.encode("utf-16-le"),
    "utf-16 without a mark, the other way round": PLAIN.encode("utf-16-be"),
    "latin-1": PLAIN.replace("\n", ",Höhe über Boden\n").encode("latin-1"),
    "columns in another order": "\n".join(",".join(line.split(",")[::-1]) for line in PLAIN.splitlines()),
}


@pytest.mark.parametrize("content", GOOD.values(), ids=GOOD.keys())
def test_however_a_log_is_written_its_numbers_are_read(log, content):
    table = read_table(log(content), NAMES)
    for name, samples in WANTED.items():
        assert same_bits(table.channels[name].values, samples)


@with_folder  # a row with a NUL never reached the disk whole, and is cut; line ends are unified
@given(
    notes=st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\0\r")), min_size=3, max_size=3)
)
def test_whatever_text_stands_quoted_beside_does_no_harm(log, notes):
    text = io.StringIO(newline="")
    writer = csv.writer(text, quoting=csv.QUOTE_ALL, lineterminator="\n")
    writer.writerow(["note", *NAMES, "more"])
    writer.writerows([[note, k, -k, 0.1 * k, note] for k, note in enumerate(notes)])
    path = log(text.getvalue())
    table = read_table(path, NAMES)
    for name, samples in zip(NAMES, ([0, 1, 2], [0, -1, -2], [0.0, 0.1, 0.2]), strict=True):
        assert same_bits(table.channels[name].values, samples)
    header, rows, _ = read_rows(path)
    assert header == ["note", *NAMES, "more"]
    assert [row[0] for row in rows] == notes


def test_text_and_commas_are_written_so_that_they_read_back(tmp_path):
    rows = [["a,b", '"', "x\ny", " ", ""], ["", "'", "\u2212", "\t", "0.10"]]
    write_rows(tmp_path / "a.csv", list("vwxyz"), rows)
    assert read_rows(tmp_path / "a.csv")[:2] == (list("vwxyz"), rows)


# What may be taken for a number somewhere, and what cannot.
cells = st.text(st.sampled_from("0123456789.+-eEinfatyNxX_ dD\t\u2212\u0661\uff11\xa0\x0c%'"), max_size=12)


@with_folder
@given(cell=cells | st.text(st.characters(codec="utf-8", exclude_characters=',"\n\r\0'), max_size=8))
def test_a_cell_is_its_number_or_refused_by_line(log, cell):
    path = log(with_cell(cell))
    try:
        read = read_table(path, NAMES).channels["current_up_A"].values[9]
    except LogError as error:
        message = str(error)
        assert message.startswith(f"{path}: line 11: column 'current_up_A': ")
        assert "expected a number" in message
        return
    without_digit = not any(map(str.isdigit, cell)) or "#" in cell
    np.testing.assert_array_equal(
        read, np.nan if without_digit and not is_number(cell) else float(cell.strip())
    )


@pytest.mark.parametrize(
    ("cell", "value"),
    [
        (word, np.nan)
        for word in ("", "  ", "-", "---", "NaN", "#N/A", "#DIV/0!", "null", "n/a", "OL", "?", "1.#QNAN")
    ]
    + [(word, 1.0) for word in ("ON", "true", "Yes", "EIN", "wahr")]
    + [(word, 0.0) for word in ("off", "FALSE", "no", "aus", "nein")]
    + [(word, np.inf) for word in ("inf", "-inf", "1e999")],
)
def test_missing_values_and_switches_are_told_from_text(log, cell, value):
    content = read_table(log(with_cell(cell)), NAMES)
    assert same_bits(np.abs(content.channels["current_up_A"].values[9]), value)
    assert same_bits(content.channels["displacement_mm"].values, WANTED["displacement_mm"])


@pytest.mark.parametrize("cell", ["\u22121", "0x10", "1_000", "\uff11", "1 2", "1d5", "1+2j", "1.2.3", "12%"])
def test_what_is_no_number_is_named_with_line_and_column(log, cell):
    with pytest.raises(LogError, match=f"line 11: column 'current_up_A'.*'{re.escape(cell)}'"):
        read_table(log(with_cell(cell)), NAMES)


BAD = {
    "empty": ("", ["empty"]),
    "line ends only": ("\n\n", ["empty"]),
    "header only": (HEADER, ["line 1", "no samples"]),
    "header and a line end": (HEADER + "\n", ["line 1", "no samples"]),
    "no header": ("\n".join(ROWS[1:]), ["line 1", "'time_s'", "0.01"]),
    "a column too few": (PLAIN.replace("current_up_A", "current_A"), ["'current_up_A'", "current_A"]),
    "another case": (PLAIN.replace("time_s", "Time_s"), ["'time_s'", "Time_s"]),
    "a name twice": (PLAIN.replace("\n", ",1\n").replace(",1", ",time_s", 1), ["'time_s'", "ambiguous"]),
    "a short row between spaces": (
        PLAIN.replace(ROWS[9], "0.09,0").replace(",", " "),
        ["line 11", "2 cells", "3"],
    ),
    "a bad cell after blank lines": (
        PLAIN.replace(ROWS[2], ROWS[2] + "\n\n").replace(ROWS[9], "0.09,x2,1"),
        ["line 13", "'current_up_A'", "'x2'"],
    ),
    "a bad cell after lines in quotes": (
        with_cell("x2").replace("\n", ',"a\nb"\n').replace('"a\nb"', "note", 1),
        ["line 2", "'current_up_A'", "'x2'"],
    ),
    "a column without numbers": (
        "\n".join([HEADER, *(f"{k},neutral,{k}" for k in range(30))]) + "\n",
        ["no numbers", "'current_up_A'"],
    ),
    "half of utf-16": (PLAIN.encode("utf-16")[:-1], ["encoding"]),
    "points and commas": (
        PLAIN.replace(",", ";").replace("0.09", "0,09"),
        ["line 2", "'time_s'", "'0.0'", "decimal comma"],
    ),
    "noise": (bytes(range(256)) * 4, ["UTF-8"]),
    "a matlab file": (b"MATLAB 5.0 MAT-file\x00\x01IM\xff", ["UTF-8"]),
}


@pytest.mark.parametrize(("content", "words"), BAD.values(), ids=BAD.keys())
def test_what_cannot_be_used_is_refused_by_name(log, content, words):
    path = log(content)
    with pytest.raises(LogError, match=f"^{re.escape(str(path))}: ") as caught:
        read_table(path, NAMES)
    assert all(word in str(caught.value) for word in words)


STRANGE = {
    "old macintosh line ends": PLAIN.replace("\n", "\r"),
    "stray carriage returns": PLAIN.replace("\n", ",a\rb\n"),
    "stray carriage returns before windows line ends": PLAIN.replace("\n", ",a\rb\r\n"),
    "a name of 200 000 letters": PLAIN.replace(HEADER, HEADER + "," + "x" * 200_000),
    "cells of 200 000 letters": with_cell("x").replace("\n", "," + "x" * 200_000 + "\n"),
    "a quote that is never closed": with_cell('"1'),
    "nuls": b"\x00" * 1000,
    "commas": "," * 10_000,
    "quotes": '"' * 1001,
}


@pytest.mark.parametrize("content", STRANGE.values(), ids=STRANGE.keys())
def test_any_content_is_read_or_refused_in_one_line(log, content):
    try:
        table = read_table(log(content), NAMES)
    except LogError as error:
        assert "\n" not in str(error)  # noqa: PT017
        return
    for name, samples in WANTED.items():
        assert same_bits(table.channels[name].values, samples)


SHIFTED = {
    "unquoted decimal commas": "time_ms,current_up_A,x_mm\n" + "0,0,5,12,3\n10,0,5,12,4\n" * 3,
    "numbers of rows without a name": "time_s\tu_A\tx_mm\n" + "1\t0.0\t0\t10.0\n2\t0.1\t0\t10.1\n" * 3,
    "units behind names between spaces": "time [s] x [mm] u [A]\n" + "0.0 10.0 0.5\n0.1 10.1 0.5\n" * 3,
}


@pytest.mark.parametrize("content", SHIFTED.values(), ids=SHIFTED.keys())
def test_samples_that_do_not_lie_under_the_names_are_refused(log, content):
    with pytest.raises(LogError, match=r"line 2: .*\d cells.*line 1 \d"):
        read(log(content), ChannelSelection("no", ("such",)))


def test_a_row_that_grows_wide_far_below_is_refused(log):
    rest = "".join(f"{k},0,7\n" for k in range(500))
    with pytest.raises(LogError, match=r"line 502: .*4 cells.*line 1 3"):
        read(
            log(f"time_ms,u_A,x_mm\n{rest}500,0,5,7\n501,0,5,8\n"),
            ChannelSelection("time_ms", ("u_A", "x_mm")),
        )


@pytest.mark.parametrize("foreign", ["degC", "°C", "kN", "l/min", "rpm"])
def test_a_unit_that_is_not_known_does_not_hide_the_others(log, foreign):
    rows = "".join(f"{10 * k};{k};20,5;{k}\n" for k in range(30))
    content = read(log(f"t;u;temp;x\nms;mA;{foreign};cm\n{rows}"), ChannelSelection("t", ("u", "temp", "x")))
    units = {"t": "ms", "u": "mA", "temp": foreign, "x": "cm"}
    assert {name: channel.unit for name, channel in content.channels.items()} == units
    assert len(content.channels["t"].values) == 30


def test_a_name_that_brackets_alone_tell_apart_must_be_whole(log):
    path = log("t [s];Lift [V];Lift [mm]\n" + "".join(f"{k};{k};{2 * k}\n" for k in range(30)))
    with pytest.raises(LogError, match=r"column 'Lift': the name is ambiguous: Lift \[V\], Lift \[mm\]"):
        read(path, ChannelSelection("t", ("Lift",)))
    whole = read(path, ChannelSelection("t", ("Lift [mm]",))).channels["Lift [mm]"]
    assert (whole.values[3], whole.unit) == (6.0, "mm")


def test_a_line_without_a_sample_costs_no_other_line(log):
    comments = ("# at 3 s, lever 5 moved", "// at 3 s", "; 1 A", "% 0.2: pause")
    for row in (1, 9, 29):
        for line in (*comments, "ERR,overrun,", "   ", ",,", HEADER):
            content = read_table(log(PLAIN.replace(ROWS[row] + "\n", f"{line}\n{ROWS[row]}\n")))
            for name, samples in WANTED.items():
                assert same_bits(content.channels[name].values, samples)
            assert content.line_of(29) == 32
            if line.strip():
                (notice,) = content.notices
                assert "1 line without a sample" in notice
                assert f"line {row + 2}" in notice


@pytest.mark.parametrize(("sign", "name"), [(",", "comma"), (".", "point")])
def test_signs_that_may_be_decimal_or_thousands_are_refused(log, sign, name):
    cells = ["998", "999", f"1{sign}000", f"1{sign}001"] * 5
    text = "time_s;current_up_A;p\n" + "".join(f"{k};{k};{cell}\n" for k, cell in enumerate(cells))
    with pytest.raises(LogError, match=f"a decimal {name} or a thousands separator"):
        read(log(text), ChannelSelection("time_s", ("p",)))
    for decimal in ("0,998", "1,5", "1,0005"):
        decided = text.replace("998", decimal.replace(",", sign), 1)
        assert read(log(decided), ChannelSelection("time_s", ("p",))).channels["p"].values[2] == 1.0


@pytest.fixture
def short_blocks(monkeypatch):
    """Let a log of some hundred lines be one of many blocks."""
    for name in ("HEAD", "BLOCK"):
        monkeypatch.setattr(f"hitchid.logs.formats.text.{name}", 2**12)


@pytest.mark.usefixtures("short_blocks")
@pytest.mark.parametrize("above", [5, 300, 3000])
def test_thousands_that_appear_late_are_refused(log, above):
    rows = "".join(f"{k}\t{k % 3}\t{k % 900}\n" for k in range(above))
    with pytest.raises(LogError, match=r"column 'p': '1,006' is ambiguous"):
        read(log("time_s\tu_A\tp\n" + rows + "0\t1\t1,006\n"), ChannelSelection("time_s", ("p",)))


@pytest.mark.parametrize(
    ("cells", "values"),
    [
        (("0.5", "999", "1,317"), (0.5, 999, 1317)),  # the point elsewhere is decimal
        (("1", "999", "1,234,567"), (1, 999, 1_234_567)),
        (("1", "999.5", "1,234.5"), (1, 999.5, 1234.5)),
        (("0,5", "999", "1.234,5"), (0.5, 999, 1234.5)),
        (("1", "1\u00a0317,5", "1'317"), (1, 1317.5, 1317)),
    ],
)
def test_thousands_that_nothing_else_can_be_are_read(log, cells, values):
    text = "time_s;p\n" + "".join(f"{k};{cell}\n" for k, cell in enumerate(cells))
    content = read(log(text), ChannelSelection("time_s", ("p",)))
    np.testing.assert_array_equal(content.channels["p"].values, values)


@pytest.mark.usefixtures("short_blocks")
@pytest.mark.parametrize("late", [300, 3000])
def test_a_decimal_comma_that_appears_late_is_one(log, late):
    rows = "".join(f"{k};7\n" for k in range(late))
    content = read(log(f"time_s;p\n{rows}{late};12,5\n"), ChannelSelection("time_s", ("p",)))
    assert content.channels["p"].values[-1] == 12.5
    with pytest.raises(LogError, match=rf"line {late + 3}: column 'p': .*decimal comma.*'12.5'"):
        read(log(f"time_s;p\n{rows}{late};12,5\n0;12.5\n"), ChannelSelection("time_s", ("p",)))


def test_no_cut_of_the_last_row_passes_for_a_sample(log):
    fixed = HEADER + "\n" + "".join(f"{k / 100:.2f},{k % 3},{k * 1.2345 + 10:.4f}\n" for k in range(30))
    whole = read_table(log(fixed)).channels
    last_row = len(fixed.splitlines()[-1])
    for cut in range(1, last_row + 1):
        content = read_table(log(fixed[:-cut]))
        rows = 30 if cut == 1 else 29
        for name, channel in content.channels.items():
            assert same_bits(channel.values, whole[name].values[:rows])
        (notice,) = content.notices
        assert cut > 1 or "truncated" in notice


@pytest.mark.parametrize("zeros", [1, 4096, 5_000_000])
def test_zero_bytes_cost_the_rows_they_touch_and_no_memory(log, zeros):
    row = PLAIN.index(ROWS[9])
    for position in (row, row + 3, len(PLAIN)):
        text = PLAIN[:position].encode() + bytes(zeros) + PLAIN[position:].encode()
        content = read_table(log(text))
        rest = [k for k in range(30) if k != 9 or position == len(PLAIN)]
        for name, samples in WANTED.items():
            assert same_bits(content.channels[name].values, samples[rest])
        (notice,) = [notice for notice in content.notices if "zero bytes" in notice]
        assert f"line {11 if position < len(PLAIN) else 32}" in notice


def test_lines_without_end_and_archives_without_measure_are_refused(log, monkeypatch):
    for text in (PLAIN + "1," * 300_000, "name," * 300_000 + "\n" + PLAIN):
        with pytest.raises(LogError, match=r"line \d+: is longer than \d+ characters"):
            read_table(log(text))
    monkeypatch.setattr("hitchid.logs.formats.text.ALWAYS_ALLOWED_BYTES", 2**20)
    packed = gzip.compress((HEADER + "\n" + "0,0,0\n" * 2**19).encode(), compresslevel=1)
    with pytest.raises(LogError, match="unpacks to more than 50 times its size"):
        read_table(log(packed, "log.csv.gz"))


def test_the_second_row_of_a_data_logger_is_read(log):
    rows = "".join(f'"2023-05-01 12:00:0{k}.5",{k},0,{2 * k}\n' for k in range(9))
    head = '"TOA5","rig","CR6"\n"TIMESTAMP","RECORD","u","x"\n"TS","RN","A","mm"\n"","","Smp","Smp"\n'
    channels = read(log(head + rows), ChannelSelection("", None)).channels
    assert list(channels) == ["TIMESTAMP", "RECORD", "u", "x"]
    assert [channel.unit for channel in channels.values()] == ["s", "RN", "A", "mm"]
    np.testing.assert_array_equal(channels["TIMESTAMP"].values, np.arange(9))


@pytest.mark.parametrize("units", ["s;%;%", ";%;%", "[s];[%];[%]", "%;%;%"])
def test_a_row_of_percents_is_a_row_of_units(log, units):
    rows = "".join(f"{k};{k};{k}\n" for k in range(30))
    channels = read(log(f"t;u;x\n{units}\n{rows}"), ChannelSelection("t", ("u", "x"))).channels
    assert [channels[name].unit.strip("[]") for name in "ux"] == ["%", "%"]
    assert channels["x"].values.size == 30


def test_a_few_bad_cells_are_left_out_and_counted(log):
    rows = [f"{k},{k},{k}" for k in range(300)]
    rows[7] = "7,7l,7"
    content = read_table(log("\n".join([HEADER, *rows, ""])))
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(content.channels["current_up_A"].values)), [7])
    (notice,) = content.notices
    assert "1 of 300 cells" in notice
    assert "line 9: column 'current_up_A': expected a number, got '7l'" in notice


def test_a_damaged_archive_is_refused(log):
    packed = gzip.compress(PLAIN.encode())
    flipped = bytes(byte ^ (255 if at == len(packed) // 2 else 0) for at, byte in enumerate(packed))
    cut = [packed[:size] for size in range(1, len(packed), 7)]
    for content in [*cut, flipped, packed + b"more", PLAIN.encode(), PLAIN.encode() + packed]:
        with pytest.raises(LogError, match="cannot be read"):
            read_table(log(content, "log.csv.gz"), NAMES)
    with pytest.raises(LogError, match="empty"):
        read_table(log(b"", "log.csv.gz"), NAMES)


@pytest.mark.parametrize(
    "content", [GOOD[name] for name in ("plain", "spaces about names", "byte order mark")]
)
def test_rows_come_under_the_names_the_table_knows(log, content):
    header, rows, lines = read_rows(log(content))
    assert header == list(NAMES)
    assert rows == [row.split(",") for row in ROWS]
    assert lines == list(range(2, 32))


# --- dSPACE ControlDesk -------------------------------------------------------------------------------------


def exported(second="", times=(0.0, 0.0099887, 0.0200245), *, names="In1,In1,up"):
    """Return the bytes of a ControlDesk export of two inputs that paths tell apart and a named signal."""
    head = f"""descriptions,General,User,bench
,General,DateTime,2025-09-03 ???? 2:46:24
,General,Origin,"Software revision: a.sdf, a.rta"

trace_size,{len(times)}
trace_types,5,4,4,4
trace_names,,{names}
trace_units,,bar,deg,%
raster,10ms,10ms,10ms,{second or "10ms"}
path,,Model Root/Pressure(22.03)/Head_P,Model Root/Joint/Boom_ang,Model Root/Duty
flags,,2,2,2
min,,-1.7e+308,-1.7e+308,0
max,,1.7e+308,1.7e+308,100
"""
    rows = [f"{time},{90 + k},{-1.5 * k},{10 * k}" for k, time in enumerate(times)]
    text = head + "\n".join(["trace_values," + rows[0], *("," + row for row in rows[1:])]) + "\n"
    return text.encode().replace(b"????", bytes([0xBF, 0xC0, 0xC8, 0xC4]))


def test_a_controldesk_export_is_read_by_ends_of_paths(log):
    content = read(log(exported()), ChannelSelection("time_s", ("Boom_ang", "Head_P", "up")))
    channels = {name: (channel.unit, channel.values.tolist()) for name, channel in content.channels.items()}
    assert channels == {
        "time_s": ("s", [0.0, 0.0099887, 0.0200245]),
        "Boom_ang": ("deg", [0.0, -1.5, -3.0]),
        "Head_P": ("bar", [90, 91, 92]),
        "up": ("%", [0, 10, 20]),
    }
    assert content.line_of(1) == 15
    header, rows, lines = read_rows(log(exported()))
    assert header == ["", "time_s", "Head_P", "Boom_ang", "up"]
    assert rows[1] == ["", "0.0099887", "91", "-1.5", "10"]
    assert lines == [14, 15, 16]


def test_every_raster_of_controldesk_has_a_time_of_its_own(log):
    content = read(log(exported("1ms", names="In1,In1,")), ChannelSelection("time_s/10ms", ("Head_P",)))
    np.testing.assert_array_equal(content.channels["time_s/10ms"].values, [0.0, 0.0099887, 0.0200245])
    with pytest.raises(LogError, match=r"time_s/10ms.*time_s/1ms"):
        read(log(exported("1ms", names="In1,In1,")), ChannelSelection("time_s", ("Head_P",)))


def test_a_doubled_name_is_refused_only_where_required(log):
    path = log(PLAIN.replace("\n", ",1,2\n").replace(",1,2", ",In1,In1", 1))
    assert read_table(path, NAMES[:2]).channels["time_s"].values.size == len(ROWS)
    assert "In1" not in read(path, ChannelSelection("time_s", None)).channels
    with pytest.raises(LogError, match="column 'In1': the name is ambiguous: In1, In1"):
        read(path, ChannelSelection("time_s", ("In1",)))
