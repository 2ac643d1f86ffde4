"""LabVIEW measurement files: each channel on the clock its header or columns give, segment after segment."""

import numpy as np
import pytest

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection
from hitchid.logs.formats.text import read

SAMPLES, STEP_S = 40, 0.01
TIME = STEP_S * np.arange(SAMPLES)
UP, STROKE = np.arange(SAMPLES) % 2 * 0.5, 1.5 * np.arange(SAMPLES)
ALL = ChannelSelection("time_s", None)


def file_header(x_columns, sign):
    lines = ["LabVIEW Measurement", "Writer_Version\t2", "Separator\tTab", f"Decimal_Separator\t{sign}"]
    return [*lines, f"X_Columns\t{x_columns}", "Time_Pref\tRelative", "***End_of_Header***", "\t"]


def segment(columns, *, start="12:00:00,5", x0=0.0, sign=","):
    """Return the lines of one segment: name to cells; a comment column stands behind them."""
    lines = [
        "Channels\t2",
        f"Samples\t{SAMPLES}\t{SAMPLES}",
        "Date\t2023/05/01\t2023/05/01",
        f"Time\t{start}\t{start}",
        "Y_Unit_Label\tA\tmm",
        f"X0\t{x0:E}\t{x0:E}",
        f"Delta_X\t{STEP_S:f}\t{STEP_S:f}",
        "***End_of_Header***",
    ]
    names, cells = zip(*columns, strict=True)
    rows = ["\t".join([*names, "Comment"]), *("\t".join(row) for row in zip(*cells, strict=True))]
    return [line.replace(".", sign) if "X0" in line or "Delta" in line else line for line in lines] + rows


def text(numbers, sign=","):
    return [f"{number:.4f}".replace(".", sign) for number in numbers]


@pytest.fixture
def log(tmp_path):
    """Return a function that writes lines and returns the log."""

    def write(*lines):
        (tmp_path / "log.lvm").write_text("\r\n".join([*lines, ""]))
        return tmp_path / "log.lvm"

    return write


@pytest.mark.parametrize("sign", [",", "."])
@pytest.mark.parametrize("x_columns", ["No", "One", "Multi"])
def test_channels_come_with_unit_and_clock(log, x_columns, sign):
    x = ("X_Value", [""] * SAMPLES if x_columns == "No" else text(TIME, sign))
    signals = [("up", text(UP, sign)), ("stroke", text(STROKE, sign))]
    columns = [x, signals[0], x, signals[1]] if x_columns == "Multi" else [x, *signals]
    path = log(*file_header(x_columns, sign), *segment(columns, sign=sign))
    channels = read(path, ChannelSelection("time_s", ("up", "stroke"))).channels
    for name, unit, samples in (("up", "A", UP), ("stroke", "mm", STROKE)):
        assert channels[name].unit == unit
        np.testing.assert_array_equal(channels[name].values, samples)
        np.testing.assert_allclose(channels[name].clock_s, TIME, rtol=0, atol=1e-12)
    whole = read(path, ChannelSelection("X_Value", ("up", "stroke"))).channels
    np.testing.assert_allclose(whole["X_Value"].values, TIME, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("start", "x0"), [("12:00:00,5", 0.4), ("12:00:00,9", 0.0)], ids=["counted on", "stamped"]
)
def test_segments_follow_each_other(log, start, x0):
    columns = [("X_Value", [""] * SAMPLES), ("up", text(UP)), ("stroke", text(STROKE))]
    path = log(*file_header("No", ","), *segment(columns), "", *segment(columns, start=start, x0=x0))
    channels = read(path, ALL).channels
    # Dates of today in seconds are rounded to 2⁻²² s.
    expected = STEP_S * np.arange(2 * SAMPLES)
    np.testing.assert_allclose(channels["stroke"].clock_s, expected, rtol=0, atol=2.0**-21)
    np.testing.assert_array_equal(channels["stroke"].values, np.tile(STROKE, 2))


def test_segments_of_different_channels_and_files_without_samples_are_refused(log):
    one = [("X_Value", text(TIME)), ("up", text(UP)), ("stroke", text(STROKE))]
    other = [("X_Value", text(TIME)), ("up", text(UP)), ("pressure", text(STROKE))]
    with pytest.raises(LogError, match=r"line \d+: a segment has other channels"):
        read(log(*file_header("One", ","), *segment(one), *segment(other)), ALL)
    with pytest.raises(LogError, match="no samples"):
        read(log(*file_header("One", ",")), ALL)
