"""Records of MATLAB's toolboxes, saved as structs, and objects whose content MATLAB hides."""

import numpy as np
import pytest
from mat_files import Cell, Object, mat5

from hitchid import logs
from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection
from hitchid.logs.formats.mat import read

SAMPLES = 60
TIME_S = 0.02 * np.arange(SAMPLES)
LIFTING, LOWERING = np.sin(TIME_S), np.cos(TIME_S)
STROKE = np.sqrt(TIME_S)
COMMANDS = np.stack([LIFTING, LOWERING], axis=1)
ALL = ChannelSelection("time_s", None)
COLUMN = STROKE[:, None]
IDDATA = {  # as `get` of an `iddata` returns it
    "Domain": "Time",
    "Name": "",
    "OutputData": COLUMN,
    "y": COLUMN,
    "OutputName": Cell(["stroke"]),
    "OutputUnit": Cell(["mm"]),
    "InputData": COMMANDS,
    "u": COMMANDS,
    "InputName": Cell(["up", "down"]),
    "InputUnit": Cell(["A", ""]),
    "Period": np.full(2, np.inf),
    "Ts": 20.0,
    "Tstart": 40.0,
    "TimeUnit": "milliseconds",
}


def assert_channels(channels, prefix, names=("up", "down", "stroke"), start_s=0.04):
    for name, samples in zip(names, (LIFTING, LOWERING, STROKE), strict=True):
        np.testing.assert_array_equal(channels[f"{prefix}{name}"].values, samples)
        np.testing.assert_allclose(channels[f"{prefix}{name}"].clock_s, TIME_S + start_s, atol=1e-12)


@pytest.mark.parametrize("whole", [True, False], ids=["a struct", "its fields as variables"])
def test_fields_of_an_iddata_are_channels_with_names_units_and_a_clock(saved, whole):
    channels = read(saved({"data": IDDATA} if whole else IDDATA), ALL).channels
    prefix = "data/" if whole else ""
    assert_channels(channels, prefix)
    assert [channels[prefix + name].unit for name in ("up", "down", "stroke")] == ["A", None, "mm"]
    assert not {name for name in channels if name.endswith(("OutputData", "InputData", "y", "u"))}


def test_sampling_instants_say_more_than_a_sampling_time(saved):
    instants = np.sort(np.random.default_rng(0).uniform(0, 1000, SAMPLES))
    channels = read(saved({"data": {**IDDATA, "SamplingInstants": instants[:, None]}}), ALL).channels
    for channel in channels.values():
        np.testing.assert_allclose(channel.clock_s, instants / 1000, rtol=1e-15)


def test_a_struct_of_ones_own_needs_u_y_and_a_sampling_time(saved):
    own = {"u": COMMANDS, "y": STROKE, "Ts": 0.02}
    channels = read(saved({"run": own}), ALL).channels
    assert_channels(channels, "run/", ("u(:,1)", "u(:,2)", "y"), start_s=0.0)


@pytest.mark.parametrize("name", ["t", "time", "Time_ms", "t_s"])
def test_a_time_beside_u_and_y_is_the_users_to_name(saved, name):
    own = {"u": COMMANDS, "y": STROKE, "Ts": 0.02, name: TIME_S + 7.0}
    channels = read(saved({"run": own}), ALL).channels
    assert {channel.clock_s is None for channel in channels.values()} == {True}
    np.testing.assert_array_equal(channels[f"run/{name}"].values, TIME_S + 7.0)


@pytest.mark.parametrize("stated", [{"Ts": 0.0}, {"Ts": np.nan}, {"Ts": "fast"}, {}, {"Domain": "Frequency"}])
def test_without_a_time_there_is_no_clock(saved, stated):
    fields = {"u": COMMANDS, "y": STROKE, **({"Ts": 0.02} if "Domain" in stated else {}), **stated}
    channels = read(saved({"run": fields}), ALL).channels
    assert {name: channel.clock_s for name, channel in channels.items()} == {
        "run/u(:,1)": None,
        "run/u(:,2)": None,
        "run/y": None,
    }


def test_experiments_of_one_file_are_records_of_their_own(saved, tmp_path):
    def stroke(seconds, speed):
        command = np.zeros((round(seconds / 0.01), 1))
        command[100:200] = 0.5
        return command, speed * np.cumsum(command, axis=0)

    pairs = [stroke(3.0, 0.8), stroke(4.0, 0.9)]
    merged = {
        "InputData": Cell([command for command, _ in pairs]),
        "OutputData": Cell([moved for _, moved in pairs]),
        "Ts": Cell([0.01, 0.01]),
        "InputName": Cell(["up"]),
        "OutputName": Cell(["stroke"]),
        "OutputUnit": Cell(["mm"]),
        "InputUnit": Cell(["A"]),
    }
    path = saved({"merged": merged})
    assert read(path, ALL).notices == ("merged: 2 experiments; each becomes a record of its own",)
    (tmp_path / "campaign.toml").write_text(
        '[signals]\nlifting_command = "merged/up"\ndisplacement = "merged/stroke"\n'
    )
    campaign = logs.read(tmp_path)
    assert [record.name for record in campaign.records] == ["log@1", "log@2"]
    for record, (_, moved) in zip(campaign.records, pairs, strict=True):
        np.testing.assert_allclose(record.displacement, moved.ravel(), atol=1e-9)
        assert record.step_s == pytest.approx(0.01)


def series(values, **more):
    return {"Name": "x", "Time": TIME_S * 1000, "Data": values, "DataInfo": {"Units": "mm"}, **more}


def test_a_time_series_brings_its_clock_and_unit(saved):
    ms = {"TimeInfo": {"Units": "milliseconds"}}
    path = saved({"stroke": series(COLUMN, **ms), "both": series(COMMANDS.T[:, None, :], **ms)})
    channels = read(path, ChannelSelection("time_s", ("stroke/Data", "both/Data(:,2)"))).channels
    np.testing.assert_array_equal(channels["stroke/Data"].values, STROKE)
    np.testing.assert_array_equal(channels["both/Data(:,2)"].values, LOWERING)
    for channel in channels.values():
        assert channel.unit == "mm"
        np.testing.assert_allclose(channel.clock_s, TIME_S, atol=1e-15)


def test_a_time_series_whose_unit_of_time_is_hidden_says_what_is_assumed(saved):
    content = read(saved({"stroke": {**series(STROKE), "Time": TIME_S}}), ALL)
    np.testing.assert_array_equal(content.channels["stroke/Data"].clock_s, TIME_S)
    assert content.notices == (
        "stroke/Time: its unit is hidden; taken for s, which is a timeseries' default",
    )


def test_time_and_data_alone_may_be_in_any_unit(saved):
    channels = read(saved({"run": {"Time": TIME_S, "Data": STROKE}}), ALL).channels
    assert [channel.clock_s for channel in channels.values()] == [None, None]


def test_signals_of_a_data_set_have_their_names_and_simulinks_time(saved):
    elements = [
        {"Name": "stroke", "Values": {"Time": TIME_S, "Data": STROKE}},
        {"Name": "", "Values": {"Time": TIME_S, "Data": LIFTING}},
    ]
    channels = read(saved({"logsout": {"Name": "logsout", "Elements": elements}}), ALL).channels
    np.testing.assert_array_equal(channels["logsout/stroke/Data"].clock_s, TIME_S)
    np.testing.assert_array_equal(channels["logsout/Elements(2)/Data"].values, LIFTING)


def test_cells_are_read_entry_by_entry(saved):
    path = saved({"runs": Cell([TIME_S, "note", STROKE]), "tests": [{"x": STROKE}, {"x": LIFTING}]})
    assert sorted(read(path, ALL).channels) == ["runs{1}", "runs{3}", "tests(1)/x", "tests(2)/x"]


HIDDEN = {
    "table": "s.T = table2struct(s.T, 'ToScalar', true);",
    "timetable": "t = timetable2table(s.T); t.(1) = seconds(t.(1) - t.(1)(1)); s.T = table2struct(t, 'ToSc",
    "timeseries": "s.T = struct('Time', s.T.Time, 'TimeInfo', struct('Units', s.T.TimeInfo.Units), 'Data'",
    "iddata": "s.T = get(s.T);",
    "datetime": "s.T = seconds(s.T - s.T(1));",
    "duration": "s.T = seconds(s.T);",
    "Simulink.SimulationData.Dataset": "for k = 1:d.numElements, v = d{k}.Values;",
    "our.Own": "s.T = struct(s.T);",
}


@pytest.mark.parametrize(("kind", "line"), HIDDEN.items())
def test_what_matlab_hides_is_refused_with_the_line_that_saves_it_readably(saved, kind, line):
    alone = saved({"T": Object(kind)})
    for wanted in (ALL, ChannelSelection("t", ("x",))):
        with pytest.raises(LogError) as refused:
            read(alone, wanted)
        assert f"MATLAB hides the content of 'T' ({kind}) from other programs" in str(refused.value)
        assert "in MATLAB: s = load('log.mat'); " in str(refused.value)
        assert line in str(refused.value)
        assert str(refused.value).endswith("save('readable.mat', '-struct', 's')")


def test_vectors_beside_hidden_objects_are_read(saved):
    path = saved({"t": TIME_S, "x": STROKE, "T": Object("table"), "U": Object("timeseries")})
    content = read(path, ChannelSelection("t", ("x",)))
    np.testing.assert_array_equal(content.channels["x"].values, STROKE)
    assert content.notices == ()
    assert "'T' (table), 'U' (timeseries)" in read(path, ALL).notices[0]
    with pytest.raises(LogError, match=r"column 'y': there is no such channel.*hides the content of 'T'"):
        read(path, ChannelSelection("t", ("y",)))


def test_texts_and_functions_hide_no_log(saved):
    path = saved({"t": TIME_S, "x": STROKE, "s": Object("string"), "c": Object("categorical")})
    assert read(path, ALL).notices == ()


@pytest.mark.parametrize("name", ["T'); delete('*", "T\nsystem('x')", "a/../b", "0"])
def test_names_from_a_file_are_no_code(tmp_path, name):
    path = tmp_path / "it's.mat"
    mat5(path, {name: Object("table'); quit; ('")})
    with pytest.raises(LogError) as refused:
        read(path, ALL)
    line = str(refused.value).partition("in MATLAB: ")[2]
    assert line == "s = load('log.mat'); s.x = struct(s.x); save('readable.mat', '-struct', 's')"
