"""Time stamps in text: seconds since the first, whatever the order of day and month, midnight or zone."""

from datetime import datetime, timedelta

import numpy as np
import pytest

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection
from hitchid.logs.formats.numerals import is_stamp
from hitchid.logs.formats.text import read

START, COUNT, STEP_MS = datetime(2026, 3, 5, 23, 59, 59, 500_000), 200, 10
WRITTEN = {
    "iso": "{t:%Y-%m-%d %H:%M:%S}.{ms}",
    "iso in UTC": "{t:%Y-%m-%dT%H:%M:%S}.{ms}Z",
    "iso with an offset": "{t:%Y-%m-%dT%H:%M:%S}.{ms}000+01:00",
    "iso with a comma": "{t:%Y-%m-%d %H:%M:%S},{ms}",
    "iso without signs": "{t:%Y%m%dT%H%M%S}.{ms}",
    "years first": "{t:%Y/%m/%d %H:%M:%S}.{ms}",
    "german": "{t:%d.%m.%Y %H:%M:%S},{ms}",
    "german, two digits": "{t:%d.%m.%y %H:%M:%S}.{ms}",
    "american": "{t:%m/%d/%Y %I:%M:%S}.{ms} {t:%p}",
    "british": "{t:%d/%m/%Y %H:%M:%S}.{ms}",
    "names of months": "{t:%d-%b-%Y %H:%M:%S}.{ms}",
    "time of day": "{t:%H:%M:%S}.{ms}",
    "time of day with a comma": "{t:%H:%M:%S},{ms}",
    "time of day in four parts": "{t:%H:%M:%S}:{ms}",
    "time of day before noon": "{t:%I:%M:%S}.{ms} {t:%p}",
    "minutes": "{t:%M:%S}.{ms}",
    "day of the year": "{t:%j:%H:%M:%S}.{ms}",
    "a duration": "0 days 00:00:{since:09.6f}",
}


@pytest.fixture
def log(tmp_path):
    """Return a function that writes stamps beside two columns and returns the log."""

    def write(stamps, separator=";"):
        rows = [f"{separator}".join([stamp, str(k % 3), str(2 * k)]) for k, stamp in enumerate(stamps)]
        path = tmp_path / "log.csv"
        path.write_text("\n".join([separator.join(["Zeit", "u", "x"]), *rows]) + "\n")
        return path

    return write


def seconds(path):
    channel = read(path, ChannelSelection("Zeit", ("u", "x"))).channels["Zeit"]
    assert channel.unit == "s"
    return channel.values


@pytest.mark.parametrize("separator", [";", "\t", ","])
@pytest.mark.parametrize("pattern", WRITTEN.values(), ids=WRITTEN.keys())
def test_stamps_over_midnight_are_seconds_since_the_first(log, pattern, separator):
    times = [START + timedelta(milliseconds=STEP_MS * k) for k in range(COUNT)]
    stamps = [
        pattern.format(t=t, ms=f"{t.microsecond // 1000:03d}", since=(t - START).total_seconds())
        for t in times
    ]
    quoted = [f'"{stamp}"' for stamp in stamps] if separator == "," else stamps
    expected = STEP_MS * np.arange(COUNT) / 1000
    np.testing.assert_allclose(seconds(log(quoted, separator)), expected, rtol=0, atol=1e-12)


def test_summer_time_is_no_gap_and_a_missing_stamp_no_number(log):
    stamps = [f"2026-03-29T01:59:59.{k}00+01:00" for k in range(10)]
    stamps += [f"2026-03-29T03:00:00.{k}00+02:00" for k in range(10)]
    np.testing.assert_allclose(seconds(log(stamps)), 0.1 * np.arange(20), rtol=0, atol=1e-12)
    stamps = [f"12:00:0{k}.5" for k in range(9)]
    stamps[4] = "---"
    np.testing.assert_array_equal(seconds(log(stamps)), [0, 1, 2, 3, np.nan, 5, 6, 7, 8])


def test_dates_of_no_calendar_are_refused(log):
    with pytest.raises(LogError, match=r"column 'Zeit': the dates are not those of a calendar"):
        seconds(log([f"31.13.2026 12:00:0{k}" for k in range(9)]))


@pytest.mark.parametrize(
    "text", ["", "1.5", "12", "2026-03-05", "1:2", "a:b", "12:00:00 Uhr", "3:1 ratio", "1,5:2"]
)
def test_other_text_is_no_stamp(text):
    assert not is_stamp(text)
