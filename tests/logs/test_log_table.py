"""What a file says of its units, against what the signal map asks for."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection, Content, LogChannel, match_channels
from hitchid.logs.log_table import table_of
from hitchid.logs.signal_map import COMMANDS, POSITIONS, SignalColumn, SignalMap
from hitchid.logs.units import UNITS

EPS = np.finfo(np.float64).eps
SAMPLES = 30
SOURCE = Path("log.h5")
STAMPS = np.arange(SAMPLES) / 128  # every one a double
STROKE = 3.0 + np.sqrt(np.arange(SAMPLES))
CURRENT = np.sin(np.arange(SAMPLES))
PAIRS = [
    (stored, wanted)
    for stored in UNITS
    for wanted in UNITS
    if UNITS[stored].dimension == UNITS[wanted].dimension
]
POSITION_PAIRS = [pair for pair in PAIRS if UNITS[pair[0]].dimension in POSITIONS]


def signal_map(displacement, unit=None, *, time=("t", "s"), command=("i", "A"), **more):
    """Return a signal map of one lifting command, given column and unit each."""
    given = {"time": time, "displacement": (displacement, unit), "lifting_command": command}
    columns = {
        role: SignalColumn(column=named[0], unit=named[1])
        for role, named in given.items()
        if named is not None
    }
    return SignalMap(**{**columns, **more})


def content(unit=None, *, name="x", time=None, current=None, **more):
    """Return what a reader hands over: a time, a current, a displacement in a unit as the file spells it."""
    channels = {
        "t": LogChannel(STAMPS, time),
        "i": LogChannel(CURRENT, current),
        name: LogChannel(STROKE, unit),
        **more,
    }
    return Content(SOURCE, channels, notices=("read with care",))


def refused(content, signals):
    with pytest.raises(LogError, match=f"^{SOURCE}: ") as caught:
        table_of(content, signals)
    return str(caught.value)


def test_a_unit_as_in_the_map_changes_nothing():
    table = table_of(content("mm", time="s", current="A"), signal_map("x", "mm"))
    assert table.notices == ("read with care",)
    assert dict(table.units) == {"displacement": "mm", "lifting_command": "A"}
    assert table.time_s.tobytes() == STAMPS.tobytes()
    assert table.signals["displacement"].tobytes() == STROKE.tobytes()
    assert table.signals["lifting_command"].tobytes() == CURRENT.tobytes()
    assert list(table.columns) == ["i", "x"]
    assert table.source == SOURCE


@pytest.mark.parametrize(("stored", "factor"), [("in", 25.4), ("(Inch)", 25.4), (" [cm] ", 10.0)])
def test_another_unit_is_converted_with_a_notice(stored, factor):
    table = table_of(content(stored), signal_map("x", "mm"))
    assert table.units["displacement"] == "mm"
    # The factor is a quotient of two doubles, each rounded once, as is their quotient and the product.
    np.testing.assert_allclose(table.signals["displacement"], factor * STROKE, rtol=4 * EPS)
    _, notice = table.notices
    assert "x" in notice.split(":")[0]
    assert f"from {'cm' if factor == 10 else 'in'}" in notice
    assert notice.endswith("to mm")


@given(
    pair=st.sampled_from(POSITION_PAIRS),
    values=arrays(np.float64, st.integers(1, 20), elements=st.floats(-1e100, 1e100)),
)
def test_the_physical_quantity_is_kept_whatever_the_units(pair, values):
    stored, wanted = pair
    channels = {"t": LogChannel(np.arange(values.size) / 128), "i": LogChannel(values)}
    table = table_of(Content(SOURCE, {**channels, "x": LogChannel(values, stored)}), signal_map("x", wanted))
    before, after = values * UNITS[stored].factor, table.signals["displacement"] * UNITS[wanted].factor
    # A quotient, two products here and one there: four roundings of half a unit in the last place.
    np.testing.assert_allclose(after, before, rtol=4 * EPS, atol=4 * np.finfo(np.float64).tiny)
    if stored == wanted:
        assert table.signals["displacement"].tobytes() == values.tobytes()


CLOCK = LogChannel(STAMPS, "s")
CONTRADICTIONS = {
    "pressure for a displacement": (
        content("bar"),
        signal_map("x"),
        ["'x'", "a unit of pressure", *POSITIONS],
    ),
    "length for a command": (
        content("mm", current="mm"),
        signal_map("x", command=("i", None)),
        ["'i'", *COMMANDS],
    ),
    "V, not mm": (content("V"), signal_map("x", "mm"), ["'x'", "'V'", "'mm'"]),
    "deg, not mm": (content("deg"), signal_map("x", "mm"), ["'x'", "'deg'", "'mm'"]),
    "mm, not A": (content("mm", current="mm"), signal_map("x"), ["'i'", "'mm'", "'A'"]),
    "bar, not V": (
        content("mm", current="bar"),
        signal_map("x", command=("i", "V")),
        ["'i'", "'bar'", "'V'"],
    ),
    "a name, an open map": (
        content("m", name="displacement_mm"),
        signal_map("displacement_mm"),
        ["'displacement_mm'", "'mm'", "'m'"],
    ),
    "a name, a map as the name": (
        content("m", name="displacement_mm"),
        signal_map("displacement_mm", "mm"),
        ["'displacement_mm'", "'mm'", "'m'"],
    ),
    "a name, a map as the file": (
        content("m", name="displacement_mm"),
        signal_map("displacement_mm", "m"),
        ["'displacement_mm'", "'mm'", "'m'"],
    ),
    "the name of a time": (content("mm", t_ms=CLOCK), signal_map("x", time=("t_ms", None)), ["'t_ms'"]),
    "the name of a time, as the file": (
        content("mm", t_ms=CLOCK),
        signal_map("x", time=("t_ms", "s")),
        ["'t_ms'"],
    ),
    "the name of a covariate": (
        content("mm", oil_bar=LogChannel(STROKE, "Pa")),
        signal_map("x", covariates=("oil_bar",)),
        ["'oil_bar'"],
    ),
    "a time in mm": (content("mm", time="mm"), signal_map("x"), ["column 't'"]),
    "a time without dimension": (content("mm", time="1"), signal_map("x"), ["column 't'"]),
    "no unit": (content(), signal_map("x"), ["'x'", 'in campaign.toml: { column = "x", unit = "…" }']),
    "an unknown unit": (content("Skalenteile"), signal_map("x"), ["'x'", 'unit = "…" }']),
    "another length than the time": (
        content("mm", x=LogChannel(STROKE[:-1], "mm")),
        signal_map("x", "mm"),
        ["column 'x'", "29 samples", "30"],
    ),
}


@pytest.mark.parametrize(("given", "signals", "words"), CONTRADICTIONS.values(), ids=CONTRADICTIONS.keys())
def test_a_file_that_contradicts_its_map_or_itself_is_refused(given, signals, words):
    message = refused(given, signals)
    assert all(word in message for word in words)


def test_a_name_that_agrees_with_the_file_is_converted():
    table = table_of(content("mm", name="displacement_mm"), signal_map("displacement_mm", "m"))
    np.testing.assert_allclose(table.signals["displacement"], STROKE / 1000, rtol=4 * EPS)


def test_a_unit_nobody_knows_is_told_and_the_map_counts():
    table = table_of(content("Skalenteile"), signal_map("x", "mm"))
    assert table.signals["displacement"].tobytes() == STROKE.tobytes()
    assert table.units["displacement"] == "mm"
    assert "'Skalenteile'" in table.notices[1]
    assert "read as mm" in table.notices[1]


@pytest.mark.parametrize("unit", [unit for unit in UNITS if UNITS[unit].dimension in POSITIONS])
def test_a_map_without_a_unit_takes_the_files(unit):
    table = table_of(content(unit), signal_map("x"))
    assert table.units["displacement"] == unit
    assert table.signals["displacement"].tobytes() == STROKE.tobytes()
    assert table.notices == ("read with care",)


@pytest.mark.parametrize(
    ("name", "said", "unit"),
    [
        ("oil", None, "1"),
        ("oil", "bar", "bar"),
        ("oil_bar", None, "bar"),
        ("oil_bar", "bar", "bar"),
        ("oil_bar", "°R", "bar"),
        ("oil", "°R", "1"),
        ("oil", "°C", "degC"),
        ("valve_in", "V", "V"),  # no inch
    ],
)
def test_a_covariate_has_the_files_unit_else_its_names(name, said, unit):
    channel = {name: LogChannel(STROKE, said)}
    table = table_of(content("mm", **channel), signal_map("x", covariates=(name,)))
    assert table.units[name] == unit
    assert table.signals[name].tobytes() == STROKE.tobytes()
    assert table.columns[name].tobytes() == STROKE.tobytes()
    unknown = said == "°R"
    assert len(table.notices) == 1 + unknown
    assert not unknown or f"{name}: the unit '°R'" in table.notices[1]


def test_a_signed_command_is_split_in_the_maps_unit():
    signals = SignalMap(
        time=SignalColumn(column="t", unit="s"),
        displacement=SignalColumn(column="x", unit="mm"),
        command=SignalColumn(column="i", unit="A"),
    )
    table = table_of(content("mm", current="mA"), signals)
    up, down = table.signals["lifting_command"], table.signals["lowering_command"]
    assert "command" not in table.signals
    assert table.units["lifting_command"] == table.units["lowering_command"] == "A"
    assert np.all((up >= 0) & (down >= 0) & (up * down == 0))
    assert up.any()
    assert down.any()
    np.testing.assert_allclose(up - down, CURRENT / 1000, rtol=2 * EPS)
    np.testing.assert_array_equal(table.columns["i"], up - down)


@pytest.mark.parametrize(("unit", "notices"), [(None, 1), ("ms", 1), ("s", 2)])
def test_a_time_the_file_keeps_in_milliseconds_comes_in_seconds(unit, notices):
    table = table_of(content("mm", time="ms"), signal_map("x", time=("t", unit)))
    np.testing.assert_allclose(table.time_s, STAMPS / 1000, rtol=2 * EPS)
    assert len(table.notices) == notices
    assert notices == 1 or "from ms" in table.notices[1]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_rows_without_a_time_are_left_out_and_counted(value):
    spoiled = STAMPS.copy()
    spoiled[[4, 9]] = value
    channels = content("mm", t=LogChannel(spoiled)).channels
    table = table_of(Content(SOURCE, channels, line_of=lambda sample: 100 + sample), signal_map("x", "mm"))
    rest = np.delete(np.arange(30), [4, 9])
    assert table.time_s.tobytes() == STAMPS[rest].tobytes()
    assert table.signals["displacement"].tobytes() == STROKE[rest].tobytes()
    assert [table.line_of(row) for row in (3, 4, 27)] == [103, 105, 129]
    (notice,) = table.notices
    assert "2 of 30 rows are left out, the first in line 104" in notice
    spoiled[:] = value
    assert "line 100: column 't'" in refused(
        Content(SOURCE, channels, line_of=lambda sample: 100 + sample), signal_map("x", "mm")
    )


def test_the_maps_unit_counts_before_the_names():
    table = table_of(content(name="stroke_m"), signal_map("stroke_m", "mm"))
    assert table.units["displacement"] == "mm"
    assert table.signals["displacement"].tobytes() == STROKE.tobytes()
    assert any("stroke_m: read as mm" in notice for notice in table.notices)


def test_a_named_time_that_is_missing_is_refused_beside_clocks():
    channels = {name: LogChannel(values, clock_s=STAMPS) for name, values in (("i", CURRENT), ("x", STROKE))}
    clocked = Content(SOURCE, channels)
    assert table_of(clocked, signal_map("x", "mm", time=("time_s", "s"))).time_s.tobytes() == STAMPS.tobytes()
    assert "column 'Ziet': there is no such channel" in refused(
        clocked, signal_map("x", "mm", time=("Ziet", "s"))
    )


@pytest.mark.parametrize("time", ["valve/t", "t"])
def test_time_of_another_group_is_taken_by_its_full_name_alone(time):
    names = ["valve/t", "valve/i", "pos/x", "valve/deep/p"]
    assert set(match_channels(SOURCE, names, ChannelSelection(time, ("i", "p")))) == {time, "i", "p"}
    if time in names:
        assert match_channels(SOURCE, names, ChannelSelection(time, ("x",))) == {time: time, "x": "pos/x"}
    else:
        with pytest.raises(LogError, match=r"'pos/x'.*'valve/t'"):
            match_channels(SOURCE, names, ChannelSelection(time, ("x",)))


# --- zero and scale ---------------------------------------------------------------------------------------

NUMBERS = st.floats(-1e3, 1e3)
SCALES = NUMBERS.filter(lambda scale: abs(scale) > 1e-3)


def scaled(unit=None, *, said=None, **more):
    """Return the displacement of a column with zero and scale, and the notices."""
    signals = signal_map("x").model_copy(update={"displacement": SignalColumn(column="x", unit=unit, **more)})
    table = table_of(content(said), signals)
    return table.signals["displacement"], table.units["displacement"], table.notices[1:]


@given(zero=NUMBERS, scale=SCALES)
def test_a_signal_is_the_reading_less_zero_times_scale(zero, scale):
    values, unit, notices = scaled("mm", zero=zero, scale=scale)
    np.testing.assert_allclose(values, (STROKE - zero) * scale, rtol=4 * EPS)
    assert (unit, notices) == ("mm", ())
    opposite, _, _ = scaled("mm", zero=zero, scale=-scale)
    np.testing.assert_array_equal(opposite, -values)


@given(zero=NUMBERS)
def test_zero_is_in_the_unit_of_the_readings(zero):
    values, unit, notices = scaled("mm", said="cm", zero=zero)
    np.testing.assert_allclose(values, 10 * (STROKE - zero), rtol=8 * EPS)
    assert unit == "mm"
    assert "from cm" in notices[0]


@pytest.mark.parametrize(
    ("unit", "said", "result"), [("mm", "V", "mm"), (None, "V", "V"), ("mm", "mm", "mm")]
)
def test_a_scaled_signal_has_the_maps_unit_else_the_files(unit, said, result):
    values, result_unit, notices = scaled(unit, said=said, scale=-2.0)
    np.testing.assert_array_equal(values, -2.0 * STROKE)
    assert result_unit == result
    assert len(notices) == (said != result)


def test_a_scaled_time_is_in_seconds():
    signals = signal_map("x", "mm").model_copy(
        update={"time": SignalColumn(column="t", unit="ms", scale=5.0, zero=STAMPS[0])}
    )
    np.testing.assert_allclose(table_of(content(), signals).time_s, STAMPS * 5e-3, rtol=4 * EPS)


def test_a_signed_command_rests_at_its_neutral():
    signals = SignalMap(
        time=SignalColumn(column="t", unit="s"),
        displacement=SignalColumn(column="x", unit="mm"),
        command=SignalColumn(column="i", unit="percent", zero=7.5, scale=-1.0),
    )
    readings = np.where(STAMPS[10] > STAMPS, 7.5, np.where(STAMPS[20] > STAMPS, 5.0, 9.0))
    table = table_of(content(i=LogChannel(readings)), signals)
    np.testing.assert_array_equal(table.signals["lifting_command"], np.maximum(7.5 - readings, 0))
    np.testing.assert_array_equal(table.signals["lowering_command"], np.maximum(readings - 7.5, 0))


def test_a_covariate_may_have_unit_zero_and_scale():
    oil = SignalColumn(column="p", unit="bar", zero=0.5, scale=100.0)
    table = table_of(content("mm", p=LogChannel(CURRENT, "V")), signal_map("x", covariates=[oil, "i"]))
    assert (table.units["p"], table.units["i"]) == ("bar", "1")
    np.testing.assert_array_equal(table.signals["p"], (CURRENT - 0.5) * 100.0)


@pytest.mark.parametrize("unit", [unit for unit in UNITS if UNITS[unit].dimension in COMMANDS])
def test_a_command_may_have_any_unit_of_a_command(unit):
    table = table_of(content("mm"), signal_map("x", command=("i", unit)))
    assert table.units["lifting_command"] == unit
    assert table.signals["lifting_command"].tobytes() == CURRENT.tobytes()
