"""Records of MATLAB's toolboxes, saved as structs, and objects whose content MATLAB hides."""

import h5py
import numpy as np
import pytest
from mat_files import Cell, Object, mat5, mat73
from scipy.io import savemat

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


OWN = {"u": COMMANDS, "y": STROKE, "Ts": 0.02}


def test_other_vectors_of_a_struct_share_its_clock(saved):
    path = saved({"run": {**OWN, "oil": LIFTING, "TimeUnit": "seconds", "gains": np.arange(3.0)}})
    content = read(path, ALL)
    np.testing.assert_allclose(content.channels["run/oil"].clock_s, TIME_S, atol=1e-12)
    assert content.channels["run/gains"].clock_s is None
    assert content.notices == ()


def test_a_sampling_time_without_a_unit_says_what_is_assumed(saved):
    assert read(saved({"run": OWN}), ALL).notices == (
        "run: no TimeUnit says otherwise, so its sampling time is taken for s",
    )


@pytest.mark.parametrize("stamps", [TIME_S * 1000, 1.02 * TIME_S + 5.0, TIME_S], ids=["ms", "drift", "same"])
def test_a_time_that_is_named_goes_before_a_sampling_time(saved, stamps):
    path = saved({"run": {**OWN, "zeit": stamps}})
    channels = read(path, ChannelSelection("zeit", ("u(:,1)", "y"))).channels
    assert [channel.clock_s for channel in channels.values()] == [None, None, None]
    np.testing.assert_array_equal(channels["zeit"].values, stamps)


def test_a_time_that_nobody_names_must_not_contradict_a_sampling_time(saved):
    path = saved({"run": {**OWN, "TimeUnit": "s", "tout": 3.0 * TIME_S}})
    with pytest.raises(LogError, match="'run/tout': rises like a time, which the sampling time"):
        read(path, ChannelSelection("time_s", ("u(:,1)", "y")))
    assert {channel.clock_s is None for channel in read(path, ALL).channels.values()} == {True}
    agreeing = {**OWN, "t": TIME_S + 7.0}
    assert read(saved({"run": {**agreeing, "TimeUnit": "s"}}), ALL).channels["run/y"].clock_s is not None
    # Without a unit both may be in ms.
    assert read(saved({"run": agreeing}), ALL).channels["run/y"].clock_s is None


WITHOUT = ({"Ts": 0.0}, {"Ts": np.nan}, {"Ts": "fast"}, {"Ts": None}, {"Domain": "Frequency"})
WITHOUT += (
    {"timedomain": 0.0},
    {"TimeUnit": "weeks"},
    {"TimeUnit": "Millisekunden"},
    {"TimeUnit": Object("string")},
)


@pytest.mark.parametrize("stated", WITHOUT)
def test_without_a_time_that_is_understood_there_is_no_clock(saved, stated, request):
    if isinstance(stated.get("TimeUnit"), Object) and "version 5]" in request.node.name:
        pytest.skip("an object in a struct of version 5 is not written here")
    fields = {name: value for name, value in {**OWN, **stated}.items() if value is not None}
    channels = read(saved({"run": fields}), ALL).channels
    assert {name: channel.clock_s for name, channel in channels.items()} == {
        "run/u(:,1)": None,
        "run/u(:,2)": None,
        "run/y": None,
    }


@pytest.mark.parametrize("unit", [{"TimeUnit": Cell(["milliseconds"])}, {"timeunit": "ms"}])
def test_the_unit_of_a_sampling_time_counts(saved, unit):
    channels = read(saved({"run": {"u": LIFTING, "y": STROKE, "tsam": Cell([20.0]), **unit}}), ALL).channels
    np.testing.assert_allclose(channels["run/y"].clock_s, TIME_S, atol=1e-12)


def test_empty_fields_say_nothing(saved):
    data = {
        **IDDATA,
        "SamplingInstants": np.zeros((SAMPLES, 0)),
        "Tstart": np.zeros((0, 0)),
        "u": np.zeros((0, 0)),
    }
    np.testing.assert_allclose(read(saved({"d": data}), ALL).channels["d/stroke"].clock_s, TIME_S, atol=1e-12)
    empty = {"u": np.zeros((0, 0)), "y": np.zeros((0, 0)), "Ts": 0.01}
    assert sorted(read(saved({**empty, "t": TIME_S, "x": STROKE}), ALL).channels) == ["t", "x"]


def test_arrays_keep_the_names_that_they_have_in_the_file(saved):
    path = saved(
        {"d": {**IDDATA, "InputData": LIFTING, "u": LIFTING, "InputName": "valve", "InputUnit": "A"}}
    )
    channels = read(path, ChannelSelection("t", ("InputData", "d/OutputData", "valve"))).channels
    np.testing.assert_array_equal(channels["InputData"].values, LIFTING)
    np.testing.assert_array_equal(channels["valve"].values, LIFTING)
    path = saved({"log": {"t": TIME_S, "x": STROKE}, "old": [{"x": LIFTING}, {"x": LOWERING}]})
    np.testing.assert_array_equal(read(path, ChannelSelection("t", ("x",))).channels["x"].values, STROKE)


def test_an_input_under_both_of_its_names_is_one_and_a_notice_says_so(saved):
    twice = read(saved({"d": {**IDDATA, "u": COMMANDS}}), ALL)
    assert sorted(twice.channels) == sorted(read(saved({"d": IDDATA}), ALL).channels)
    assert any("u is as large as InputData and taken for the same" in notice for notice in twice.notices)


def test_no_field_with_samples_is_lost(saved):
    data = {"u": LIFTING[:30], "y": STROKE, "Ts": 0.02, "Period": LOWERING}
    assert sorted(read(saved({"run": data}), ALL).channels) == ["run/Period", "run/u", "run/y"]
    whole = {"time": TIME_S, "signals": {"up": LIFTING}, "up": LIFTING, "st": STROKE}
    assert sorted(read(saved(whole), ALL).channels) == ["signals/up", "st", "time", "up"]


@pytest.mark.parametrize(
    "names", [np.array([["u"], ["d"]]), Cell(["u", "d"])], ids=["a matrix of letters", "a cell"]
)
def test_names_come_from_cells_and_matrices_of_letters(tmp_path, names):
    mat5(tmp_path / "log.mat", {"d": {**IDDATA, "InputName": names}})
    assert sorted(read(tmp_path / "log.mat", ALL).channels) == ["d/d", "d/stroke", "d/u"]


@pytest.mark.parametrize("period", [0.02, np.full(2, 0.02), Cell([0.02, np.zeros((0, 0))])])
def test_one_sampling_time_may_hold_for_all_experiments(saved, period):
    instants = {"SamplingInstants": Cell([np.zeros((0, 0)), TIME_S])} if isinstance(period, Cell) else {}
    data = {"u": Cell([LIFTING, LOWERING]), "y": Cell([STROKE, STROKE]), "Ts": period, **instants}
    channels = read(saved({"d": data}), ALL).channels
    np.testing.assert_array_equal(channels["d/u"].values, np.concatenate([LIFTING, LOWERING]))
    clock_s = channels["d/y"].clock_s
    np.testing.assert_allclose(np.diff(clock_s)[: SAMPLES - 1], 0.02, atol=1e-9)
    assert clock_s[SAMPLES] - clock_s[SAMPLES - 1] == pytest.approx(10.0)


def test_experiments_on_different_clocks_are_refused(saved):
    data = {"u": Cell([LIFTING, LOWERING]), "y": Cell([STROKE, STROKE]), "Ts": Cell([0.02, 0.05])}
    with pytest.raises(LogError, match=r"sampling times from 0\.02 to 0\.05 s.*getexp\(data, k\)"):
        read(saved({"d": data}), ALL)


def test_experiments_whose_inputs_have_other_lengths_are_not_joined(saved):
    data = {"u": Cell([LIFTING[:20], LOWERING]), "y": Cell([STROKE, STROKE[:20]]), "Ts": 0.02}
    assert sorted(read(saved({"d": data}), ALL).channels) == ["d/u{1}", "d/u{2}", "d/y"]


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
        "TimeUnit": "seconds",
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


def test_a_unit_that_the_user_knows_goes_before_an_assumed_one(saved):
    path = saved({"s": {"Time": TIME_S * 1000, "Data": STROKE, "DataInfo": {"Units": "mm"}}})
    channels = read(path, ChannelSelection("s/Time", ("s/Data",))).channels
    assert {(channel.unit, channel.clock_s) for channel in channels.values()} == {(None, None), ("mm", None)}
    instants = {"SamplingInstants": TIME_S * 1000, "u": LIFTING, "y": STROKE}
    channels = read(saved({"r": instants}), ChannelSelection("SamplingInstants", ("u", "y"))).channels
    assert [channel.clock_s for channel in channels.values()] == [None] * 3


def test_a_name_that_a_field_has_stays_the_fields(saved):
    path = saved({"r": {**OWN, "u": LIFTING, "InputName": "y", "OutputName": "oil", "oil": LOWERING}})
    channels = read(path, ALL).channels
    for name, samples in {"r/u": LIFTING, "r/y": STROKE, "r/oil": LOWERING}.items():
        np.testing.assert_array_equal(channels[name].values, samples)


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
    "Simulink.SimulationOutput": "for n = d.who', o.(n{1}) = d.get(n{1}); end, s.T = o;",
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
        assert str(refused.value).endswith("save('log_readable.mat', '-struct', 's')")


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


def test_objects_in_arrays_and_cells_have_their_place_in_the_line(tmp_path):
    mat73(
        tmp_path / "log.mat",
        {"runs": [{"T": Object("table")}, {"T": 1.0}], "c": Cell([Object("duration"), 2.0])},
    )
    with pytest.raises(LogError) as refused:
        read(tmp_path / "log.mat", ALL)
    assert "s.c{1} = seconds(s.c{1}); s.runs(1).T = table2struct(s.runs(1).T, 'ToScalar', true);" in str(
        refused.value
    )


def test_cells_count_by_column(tmp_path):
    grid = np.empty((2, 2), dtype=object)
    for row, column in np.ndindex(2, 2):
        grid[row, column] = TIME_S * (10 * row + column + 1)
    savemat(tmp_path / "log.mat", {"c": grid})
    channels = read(tmp_path / "log.mat", ALL).channels
    assert [channels[f"c{{{k}}}"].values[-1] / TIME_S[-1] for k in (1, 2, 3, 4)] == pytest.approx(
        [1, 11, 2, 12]
    )


def test_references_in_circles_and_to_nothing_are_survived(tmp_path):
    mat73(tmp_path / "log.mat", {"t": TIME_S, "c": Cell([1.0, 2.0]), "dates": Cell(["1.1.2026"] * 1001)})
    with h5py.File(tmp_path / "log.mat", "r+") as file:
        file["c"][0, 0] = h5py.Reference()
    assert list(read(tmp_path / "log.mat", ALL).channels) == ["t"]
    with h5py.File(tmp_path / "log.mat", "r+") as file:
        for k in range(2):
            file["c"][k, 0] = file["c"].ref
    with pytest.raises(LogError, match="holds more than 20000 fields and entries"):
        read(tmp_path / "log.mat", ALL)


@pytest.mark.parametrize("name", ["T'); delete('*", "T\nsystem('x')", "a/../b", "0"])
def test_names_from_a_file_are_no_code(tmp_path, name):
    path = tmp_path / "it's.mat"
    mat5(path, {name: Object("table'); quit; ('")})
    with pytest.raises(LogError) as refused:
        read(path, ALL)
    line = str(refused.value).partition("in MATLAB: ")[2]
    assert line == "s = load('it''s.mat'); s.x = struct(s.x); save('it''s_readable.mat', '-struct', 's')"
    assert "\n" not in str(refused.value)
