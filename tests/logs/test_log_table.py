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
from hitchid.logs.signal_map import COMMANDS, POSITIONS, Column, SignalMap
from hitchid.logs.units import SPELLINGS, UNITS

EPS = np.finfo(np.float64).eps
SAMPLES = 30
SOURCE = Path("log.h5")
STAMPS = np.arange(SAMPLES) / 128  # every one a double
STROKE = 3.0 + np.sqrt(np.arange(SAMPLES))
CURRENT = np.sin(np.arange(SAMPLES))
PAIRS = [(had, asked) for had in UNITS for asked in UNITS if UNITS[had].dimension == UNITS[asked].dimension]
POSITION_PAIRS = [pair for pair in PAIRS if UNITS[pair[0]].dimension in POSITIONS]


def signal_map(displacement, unit=None, *, time=("t", "s"), command=("i", "A"), **more):
    """Return a signal map of one lifting command, given column and unit each."""
    given = {"time": time, "displacement": (displacement, unit), "lifting_command": command}
    columns = {
        role: Column(column=named[0], unit=named[1]) for role, named in given.items() if named is not None
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
    with pytest.raises(LogError) as caught:
        table_of(content, signals)
    assert str(caught.value).startswith(f"{SOURCE}: ")
    return str(caught.value)


def test_a_unit_as_the_map_has_it_leaves_every_number_and_says_nothing():
    table = table_of(content("mm", time="s", current="A"), signal_map("x", "mm"))
    assert table.notices == ("read with care",)
    assert dict(table.units) == {"displacement": "mm", "lifting_command": "A"}
    assert table.time_s.tobytes() == STAMPS.tobytes()
    assert table.signals["displacement"].tobytes() == STROKE.tobytes()
    assert table.signals["lifting_command"].tobytes() == CURRENT.tobytes()
    assert list(table.columns) == ["i", "x"]
    assert table.source == SOURCE


@pytest.mark.parametrize(("spelling", "unit"), SPELLINGS.items())
def test_other_spellings_of_a_unit_are_that_unit(spelling, unit):
    if UNITS[unit].dimension not in POSITIONS:
        table = table_of(
            content("mm", p=LogChannel(STROKE, f" [{spelling.upper()}] ")), signal_map("x", covariates=("p",))
        )
        assert table.units["p"] == unit
    else:
        assert table_of(content(f"({spelling})"), signal_map("x")).units["displacement"] == unit
        assert len(table_of(content(spelling), signal_map("x", unit)).notices) == 1


@pytest.mark.parametrize(
    ("had", "asked", "factor"),
    [("m", "mm", 1000.0), ("cm", "mm", 10.0), ("in", "mm", 25.4), ("percent", "1", 0.01), ("mm", "m", 0.001)],
)
def test_another_unit_of_the_dimension_is_converted_with_a_notice_that_names_both(had, asked, factor):
    table = table_of(content(had), signal_map("x", asked))
    assert table.units["displacement"] == asked
    # The factor is a quotient of two doubles, each rounded once, as is their quotient and the product.
    np.testing.assert_allclose(table.signals["displacement"], factor * STROKE, rtol=4 * EPS)
    _, notice = table.notices
    assert "x" in notice.split(":")[0]
    assert f"from {had}" in notice
    assert notice.endswith(f"to {asked}")


@given(
    pair=st.sampled_from(POSITION_PAIRS),
    values=arrays(np.float64, st.integers(1, 20), elements=st.floats(-1e100, 1e100)),
)
def test_the_physical_quantity_is_kept_whatever_the_units(pair, values):
    had, asked = pair
    channels = {"t": LogChannel(np.arange(values.size) / 128), "i": LogChannel(values)}
    table = table_of(Content(SOURCE, {**channels, "x": LogChannel(values, had)}), signal_map("x", asked))
    before, after = values * UNITS[had].factor, table.signals["displacement"] * UNITS[asked].factor
    # A quotient, two products here and one there: four roundings of half a unit in the last place.
    np.testing.assert_allclose(after, before, rtol=4 * EPS, atol=4 * np.finfo(np.float64).tiny)
    if had == asked:
        assert table.signals["displacement"].tobytes() == values.tobytes()


@pytest.mark.parametrize(("had", "asked"), [("mm", "A"), ("V", "mm"), ("deg", "mm"), ("bar", "V")])
def test_a_unit_of_another_dimension_is_refused_naming_both(had, asked):
    role = {"lifting_command": Column(column="x", unit=asked)}
    signals = signal_map("x", asked) if asked != "A" else SignalMap(displacement=Column(column="y"), **role)
    said = refused(content(had, y=LogChannel(STROKE, "mm"), time_s=LogChannel(STAMPS)), signals)
    assert f"'{had}'" in said
    assert f"'{asked}'" in said
    assert "column 'x'" in said


def test_a_unit_no_signal_of_this_sort_has_is_refused_where_the_map_leaves_it_open():
    said = refused(content("bar"), signal_map("x"))
    assert "column 'x'" in said
    assert "'bar' is a unit of pressure" in said
    assert all(dimension in said for dimension in POSITIONS)
    said = refused(content("mm", current="mm"), signal_map("x", command=("i", None)))
    assert "column 'i'" in said
    assert all(dimension in said for dimension in COMMANDS)


@pytest.mark.parametrize("asked", [None, "mm", "m", "cm"])
def test_a_name_that_contradicts_the_file_is_refused_whatever_the_map_says(asked):
    said = refused(content("m", name="displacement_mm"), signal_map("displacement_mm", asked))
    assert "column 'displacement_mm'" in said
    assert "'mm'" in said
    assert "'m'" in said


def test_a_name_that_agrees_with_the_file_is_no_contradiction_in_any_unit():
    table = table_of(content("mm", name="displacement_mm"), signal_map("displacement_mm", "m"))
    np.testing.assert_allclose(table.signals["displacement"], STROKE / 1000, rtol=4 * EPS)


@pytest.mark.parametrize("time", [("t_ms", "ms"), ("t_ms", None), ("t_ms", "s")])
def test_a_time_whose_name_contradicts_the_file_is_refused(time):
    stamps = LogChannel(STAMPS, "s")
    said = refused(content("mm", t_ms=stamps), signal_map("x", time=time))
    assert "column 't_ms'" in said


def test_a_unit_nobody_knows_is_told_and_the_map_counts():
    table = table_of(content("Skalenteile"), signal_map("x", "mm"))
    assert table.signals["displacement"].tobytes() == STROKE.tobytes()
    assert table.units["displacement"] == "mm"
    assert "'Skalenteile'" in table.notices[1]
    assert "read as mm" in table.notices[1]


@pytest.mark.parametrize("unit", [None, "", "Skalenteile"])
def test_no_unit_anywhere_is_refused_with_the_line_to_write(unit):
    said = refused(content(unit), signal_map("x"))
    assert "column 'x'" in said
    assert 'in campaign.toml: { column = "x", unit = "…" }' in said


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
def test_a_covariate_has_the_unit_of_the_file_else_of_its_name_else_none(name, said, unit):
    channel = {name: LogChannel(STROKE, said)}
    table = table_of(content("mm", **channel), signal_map("x", covariates=(name,)))
    assert table.units[name] == unit
    assert table.signals[name].tobytes() == STROKE.tobytes()
    assert table.columns[name].tobytes() == STROKE.tobytes()
    unknown = said == "°R"
    assert len(table.notices) == 1 + unknown
    assert not unknown or f"{name}: the unit '°R'" in table.notices[1]


def test_a_covariate_whose_name_contradicts_the_file_is_refused():
    oil = {"oil_bar": LogChannel(STROKE, "Pa")}
    assert "'oil_bar'" in refused(content("mm", **oil), signal_map("x", covariates=("oil_bar",)))


def test_a_signed_command_is_taken_apart_in_the_unit_it_is_asked_in():
    signals = SignalMap(
        time=Column(column="t", unit="s"),
        displacement=Column(column="x", unit="mm"),
        command=Column(column="i", unit="A"),
    )
    table = table_of(content("mm", current="mA"), signals)
    up, down = table.signals["lifting_command"], table.signals["lowering_command"]
    assert "command" not in table.signals
    assert table.units["lifting_command"] == table.units["lowering_command"] == "A"
    assert np.all(up >= 0)
    assert np.all(down >= 0)
    assert np.all(up * down == 0)
    assert up.any()
    assert down.any()
    np.testing.assert_allclose(up - down, CURRENT / 1000, rtol=2 * EPS)
    np.testing.assert_array_equal(table.columns["i"], up - down)


@pytest.mark.parametrize("unit", [None, "ms"])
def test_a_time_the_file_keeps_in_milliseconds_comes_in_seconds(unit):
    table = table_of(content("mm", time="ms"), signal_map("x", time=("t", unit)))
    np.testing.assert_allclose(table.time_s, STAMPS / 1000, rtol=2 * EPS)
    assert table.notices == ("read with care",)


def test_a_time_the_map_calls_seconds_and_the_file_milliseconds_is_converted_and_told():
    table = table_of(content("mm", time="ms"), signal_map("x", time=("t", "s")))
    np.testing.assert_allclose(table.time_s, STAMPS / 1000, rtol=2 * EPS)
    assert "from ms" in table.notices[1]


@pytest.mark.parametrize("unit", ["mm", "A", "1"])
def test_a_time_in_a_unit_of_something_else_is_refused(unit):
    assert "column 't'" in refused(content("mm", time=unit), signal_map("x"))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_rows_without_a_time_are_left_out_with_their_place_and_count(value):
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


def test_a_channel_of_another_length_than_the_time_is_refused():
    short = {"x": LogChannel(STROKE[:-1], "mm")}
    said = refused(content("mm", **short), signal_map("x", "mm"))
    for part in ("column 'x'", "29 samples", "30"):
        assert part in said


def test_a_unit_that_the_map_gives_against_the_name_counts_and_is_told():
    table = table_of(content(name="stroke_m"), signal_map("stroke_m", "mm"))
    assert table.units["displacement"] == "mm"
    assert table.signals["displacement"].tobytes() == STROKE.tobytes()
    assert any("stroke_m: read as mm" in notice for notice in table.notices)


def test_a_time_that_is_named_and_not_there_is_refused_although_the_file_keeps_clocks():
    channels = {name: LogChannel(values, clock_s=STAMPS) for name, values in (("i", CURRENT), ("x", STROKE))}
    clocked = Content(SOURCE, channels)
    assert table_of(clocked, signal_map("x", "mm", time=("time_s", "s"))).time_s.tobytes() == STAMPS.tobytes()
    assert "column 'Ziet': there is no such channel" in refused(
        clocked, signal_map("x", "mm", time=("Ziet", "s"))
    )


@pytest.mark.parametrize("time", ["valve/t", "t"])
def test_the_time_of_one_group_counts_for_another_by_its_full_name_alone(time):
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
    signals = signal_map("x").model_copy(update={"displacement": Column(column="x", unit=unit, **more)})
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
def test_zero_stands_in_the_unit_of_the_readings_and_leaves_conversion_as_it_is(zero):
    values, unit, notices = scaled("mm", said="cm", zero=zero)
    np.testing.assert_allclose(values, 10 * (STROKE - zero), rtol=8 * EPS)
    assert unit == "mm"
    assert "from cm" in notices[0]


@pytest.mark.parametrize(
    ("unit", "said", "result"), [("mm", "V", "mm"), (None, "V", "V"), ("mm", "mm", "mm")]
)
def test_with_a_scale_the_result_is_in_the_unit_asked_for_else_the_files(unit, said, result):
    values, found, notices = scaled(unit, said=said, scale=-2.0)
    np.testing.assert_array_equal(values, -2.0 * STROKE)
    assert found == result
    assert len(notices) == (said != result)


def test_a_scaled_time_is_in_seconds():
    signals = signal_map("x", "mm").model_copy(
        update={"time": Column(column="t", unit="ms", scale=5.0, zero=STAMPS[0])}
    )
    np.testing.assert_allclose(table_of(content(), signals).time_s, STAMPS * 5e-3, rtol=4 * EPS)


def test_a_signed_command_with_a_neutral_that_is_not_zero_rests_at_none():
    signals = SignalMap(
        time=Column(column="t", unit="s"),
        displacement=Column(column="x", unit="mm"),
        command=Column(column="i", unit="percent", zero=7.5, scale=-1.0),
    )
    readings = np.where(STAMPS[10] > STAMPS, 7.5, np.where(STAMPS[20] > STAMPS, 5.0, 9.0))
    table = table_of(content(i=LogChannel(readings)), signals)
    np.testing.assert_array_equal(table.signals["lifting_command"], np.maximum(7.5 - readings, 0))
    np.testing.assert_array_equal(table.signals["lowering_command"], np.maximum(readings - 7.5, 0))


def test_a_covariate_may_have_unit_zero_and_scale():
    oil = Column(column="p", unit="bar", zero=0.5, scale=100.0)
    table = table_of(content("mm", p=LogChannel(CURRENT, "V")), signal_map("x", covariates=[oil, "i"]))
    assert (table.units["p"], table.units["i"]) == ("bar", "1")
    np.testing.assert_array_equal(table.signals["p"], (CURRENT - 0.5) * 100.0)


@pytest.mark.parametrize("unit", [unit for unit in UNITS if UNITS[unit].dimension in COMMANDS])
def test_a_command_comes_in_any_unit_a_valve_or_a_pump_is_commanded_in(unit):
    table = table_of(content("mm"), signal_map("x", command=("i", unit)))
    assert table.units["lifting_command"] == unit
    assert table.signals["lifting_command"].tobytes() == CURRENT.tobytes()
