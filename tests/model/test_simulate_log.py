"""A log out with its prediction: against the closed form of an integrator, row by row."""

import csv
import gzip
import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

import handmade
from hitchid.cli.simulated_log import InitialValues, added_name, simulate_log
from hitchid.control.next_test import Advice, Proposal, command_of, write_command
from hitchid.errors import HitchError, InputError, OutputError
from hitchid.logs import read
from hitchid.model import Hitch

STEP_S, SAMPLES = 0.01, 120
GAIN, ZONE = handmade.GAINS["lifting"], handmade.DEAD_ZONES["lifting"]
NAMES = ("time_s", "current_up_A", "current_down_A", "displacement_mm")
# Cells carry nine significant digits.
NINE_DIGITS = 5e-9


@pytest.fixture(scope="module")
def lifter():
    return handmade.hitch("integrator", modes=("lifting",))


def command(samples=SAMPLES):
    return np.concatenate([np.zeros(10), np.repeat([0.5, 0.7, 0.4], samples)])[:samples]


def travelled(command, start=0.0):
    """Return x[k] = x₀ + K·T·Σ u[i<k], the free run of K/s."""
    effective = np.maximum(command - ZONE, 0)
    return start + GAIN * STEP_S * np.concatenate([[0.0], np.cumsum(effective)[:-1]])


def table(time_s=None, start=5.0):
    up = command()
    time_s = np.round(STEP_S * np.arange(up.size), 4) if time_s is None else time_s
    # A measured displacement that is not the model's, but starts where it starts.
    return dict(zip(NAMES, (time_s, up, 0 * up, start + 0.9 * travelled(up)), strict=True))


def lines(columns, *, header=None, ending="\n"):
    rows = zip(*(map(repr, map(float, values)) for values in columns.values()), strict=True)
    return ending.join([header or ",".join(columns), *map(",".join, rows)]) + ending


def simulated(model, tmp_path, text, *, file="log.csv", **options):
    """Return header and rows of what simulating a log wrote."""
    log, out = tmp_path / file, tmp_path / "out.csv"
    log.write_bytes(text if isinstance(text, bytes) else text.encode())
    simulate_log(model, log, out, **options)
    header, *rows = csv.reader(io.StringIO(out.read_text()))
    return header, rows


def last(rows):
    return np.array([float(row[-1]) for row in rows])


def test_free_run_is_the_closed_form_beside_the_columns_as_they_stood(lifter, tmp_path):
    text = PLAIN
    header, rows = simulated(lifter, tmp_path, text)
    assert header == [*NAMES, "displacement_predicted_mm"]
    assert "".join(",".join(row[:-1]) + "\n" for row in rows) == text.partition("\n")[2]
    np.testing.assert_allclose(last(rows), travelled(command(), start=5.0), rtol=NINE_DIGITS)


def test_one_step_ahead_the_measured_displacement_counts(lifter, tmp_path):
    measured = table()["displacement_mm"]
    _, rows = simulated(lifter, tmp_path, PLAIN, horizon=1)
    step = np.diff(travelled(command()))
    np.testing.assert_allclose(last(rows)[1:], measured[:-1] + step, rtol=NINE_DIGITS)


@pytest.mark.parametrize("horizon", [SAMPLES, 10**6, 10**30])
def test_a_horizon_as_long_as_the_log_is_the_free_run(lifter, tmp_path, horizon):
    _, rows = simulated(lifter, tmp_path, PLAIN, horizon=horizon)
    np.testing.assert_allclose(last(rows), travelled(command(), start=5.0), rtol=NINE_DIGITS)


def test_what_is_predicted_can_be_read_and_predicted_again(lifter, tmp_path):
    simulated(lifter, tmp_path, PLAIN)
    (record,) = read(tmp_path / "out.csv").records
    assert len(record) == SAMPLES


PLAIN = lines(table())
CASES = {
    "windows line ends": PLAIN.replace("\n", "\r\n"),
    "byte order mark": b"\xef\xbb\xbf" + PLAIN.encode(),
    "spaces in the header": PLAIN.replace("time_s,current_up_A", " time_s , current_up_A "),
    "quoted header": PLAIN.replace("displacement_mm", '"displacement_mm"'),
    "blank lines": PLAIN.replace("\n", "\n\n"),
    "a comma more in every line": PLAIN.replace("\n", ",\n"),
    "a comma more in every row": PLAIN.replace("\n", ",\n").replace(",\n", "\n", 1),
    "text beside": PLAIN.replace("\n", ',"a, ""b""\nc"\n').replace('"a, ""b""\nc"', "note", 1),
    "text beside the first rows only": PLAIN.replace("\n", ",note\n", 20),
}


@pytest.mark.parametrize("text", CASES.values(), ids=CASES.keys())
def test_however_the_log_is_written_the_prediction_is_in_its_own_column(lifter, tmp_path, text):
    header, rows = simulated(lifter, tmp_path, text)
    assert header[-1] == "displacement_predicted_mm"
    assert {len(row) for row in rows} == {len(header)}
    np.testing.assert_allclose(last(rows), travelled(command(), start=5.0), rtol=NINE_DIGITS)


def test_a_gzipped_log_and_a_matlab_file_give_the_same_prediction(lifter, tmp_path):
    _, rows = simulated(lifter, tmp_path, PLAIN)
    _, zipped = simulated(lifter, tmp_path, gzip.compress(PLAIN.encode()), file="z.csv.gz", force=True)
    assert zipped == rows
    savemat(tmp_path / "m.mat", {**table(), "comment": "x" * SAMPLES, "rate_Hz": 100.0, "short": np.ones(7)})
    simulate_log(lifter, tmp_path / "m.mat", tmp_path / "out.csv", force=True)
    header, *again = csv.reader(io.StringIO((tmp_path / "out.csv").read_text()))
    assert header == [*NAMES, "displacement_predicted_mm"]
    np.testing.assert_allclose(np.array(again, dtype=float), np.array(rows, dtype=float), rtol=1e-15)


@pytest.mark.parametrize("beside", [np.ones(SAMPLES) * 1j, np.array([["x"] * SAMPLES], dtype=object)])
def test_vectors_beside_that_are_no_numbers_do_no_harm(lifter, tmp_path, beside):
    savemat(tmp_path / "m.mat", {**table(), "beside": beside})
    simulate_log(lifter, tmp_path / "m.mat", tmp_path / "out.csv")
    header, *rows = csv.reader(io.StringIO((tmp_path / "out.csv").read_text()))
    assert header[:4] == list(NAMES)
    np.testing.assert_allclose(last(rows), travelled(command(), start=5.0), rtol=NINE_DIGITS)


def test_a_log_with_a_gap_is_predicted_stretch_by_stretch(lifter, tmp_path):
    time_s = STEP_S * np.arange(SAMPLES)
    time_s[60:] += 10
    _, rows = simulated(lifter, tmp_path, lines(table(time_s)))
    measured = table()["displacement_mm"]
    first, second = last(rows)[:60], last(rows)[60:]
    np.testing.assert_allclose(first, travelled(command()[:60], start=5.0), rtol=NINE_DIGITS)
    # The second stretch starts under command: its first sample alone is before motion.
    np.testing.assert_allclose(second, travelled(command()[60:], start=measured[60]), rtol=NINE_DIGITS)


def test_rows_of_no_usable_stretch_get_an_empty_cell(lifter, tmp_path):
    time_s = STEP_S * np.arange(SAMPLES)
    time_s[100:] += 10
    time_s[110:] += 10
    _, rows = simulated(lifter, tmp_path, lines(table(time_s)))
    assert [row[-1] == "" for row in rows] == [False] * 100 + [True] * 20


def test_time_in_milliseconds_since_1970_finds_every_row(lifter, tmp_path):
    since_1970 = 1.7e12 + 10.0 * np.arange(SAMPLES)
    (tmp_path / "campaign.toml").write_text(
        '[signals]\ntime = { column = "time_s", unit = "ms" }\n'
        'lifting_command = "current_up_A"\ndisplacement = "displacement_mm"\n'
    )
    _, rows = simulated(lifter, tmp_path, lines(table(since_1970)))
    # 1.7·10⁹ s are resolved to 2.4·10⁻⁷ s, in which the piston moves up to K·(0.7 − d) times that.
    away = 2 * np.spacing(1.7e9) * GAIN * (0.7 - ZONE)
    np.testing.assert_allclose(last(rows), travelled(command(), start=5.0), rtol=NINE_DIGITS, atol=away)


def test_another_log_than_the_split_names_is_simulated_all_the_same(lifter, tmp_path):
    (tmp_path / "campaign.toml").write_text('[split]\ntest = ["other-*"]\n')
    _, rows = simulated(lifter, tmp_path, PLAIN)
    np.testing.assert_allclose(last(rows), travelled(command(), start=5.0), rtol=NINE_DIGITS)


def test_a_prediction_comes_in_the_unit_of_the_log(lifter, tmp_path):
    columns = table()
    columns["displacement_mm"] = columns["displacement_mm"] / 1000
    header = ",".join(NAMES).replace("displacement_mm", "stroke_m")
    (tmp_path / "campaign.toml").write_text(
        '[signals]\nlifting_command = "current_up_A"\ndisplacement = "stroke_m"\n'
    )
    header, rows = simulated(lifter, tmp_path, lines(columns, header=header))
    assert header[-1] == "stroke_m_predicted"
    np.testing.assert_allclose(last(rows), travelled(command(), start=5.0) / 1000, rtol=NINE_DIGITS)


def test_a_log_that_is_refused_leaves_nothing_behind(lifter, tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("time_s\n1\n")
    with pytest.raises(HitchError):
        simulate_log(lifter, log, tmp_path / "out.csv")
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]


def test_a_log_of_the_other_direction_is_refused(lifter, tmp_path):
    columns = table()
    columns["current_up_A"], columns["current_down_A"] = columns["current_down_A"], columns["current_up_A"]
    with pytest.raises(InputError, match="lowering"):
        simulated(lifter, tmp_path, lines(columns))
    assert not (tmp_path / "out.csv").exists()


def test_what_stands_there_is_replaced_only_by_force(lifter, tmp_path):
    (tmp_path / "out.csv").write_text("old")
    with pytest.raises(OutputError, match="exists already"):
        simulated(lifter, tmp_path, PLAIN)
    assert (tmp_path / "out.csv").read_text() == "old"
    assert len(simulated(lifter, tmp_path, PLAIN, force=True)[1]) == SAMPLES


@given(st.text(st.characters(exclude_characters="_")))
def test_a_column_without_displacement_in_front_gets_predicted_behind(name):
    assert added_name(name, "predicted") == f"{name}_predicted"


def test_the_predicted_column_of_a_displacement_keeps_its_unit_last():
    assert added_name("displacement_mm", "predicted") == "displacement_predicted_mm"
    assert added_name("my_displacement_mm", "predicted") == "my_displacement_mm_predicted"
    assert added_name("displacement", "predicted") == "displacement_predicted"


def alone(*names, **changed):
    """Return the commands of the log without its displacement, its columns renamed where told."""
    columns = {**table(), **changed}
    return {name: columns[name] for name in names or NAMES[:3]}


@pytest.mark.parametrize("measured", [False, True])
def test_commands_and_an_initial_displacement_are_enough(lifter, tmp_path, measured):
    text = PLAIN if measured else lines(alone())
    (tmp_path / "log.csv").write_text(text)
    written = simulate_log(lifter, tmp_path / "log.csv", tmp_path / "out.csv", initial=InitialValues(120.0))
    header, *rows = csv.reader(io.StringIO((tmp_path / "out.csv").read_text()))
    assert header == [*NAMES[: 4 if measured else 3], "displacement_predicted_mm"]
    np.testing.assert_allclose(last(rows), travelled(command(), start=120.0), rtol=NINE_DIGITS)
    assert (written.samples, written.unit) == (SAMPLES, "mm")
    not_used = "'displacement_mm' is not used: the simulation starts from 120 mm"
    assert written.notices == ((not_used,) if measured else ())


def test_a_measured_displacement_that_is_broken_does_no_harm_where_an_initial_one_is_given(lifter, tmp_path):
    columns = table()
    columns["displacement_mm"][3:] = np.nan
    _, rows = simulated(lifter, tmp_path, lines(columns), initial=InitialValues(120.0))
    np.testing.assert_allclose(last(rows), travelled(command(), start=120.0), rtol=NINE_DIGITS)


def test_a_sensor_that_is_stuck_does_no_harm_where_an_initial_displacement_is_given(lifter, tmp_path):
    columns = {**table(), "displacement_mm": np.full(SAMPLES, 7.0)}
    _, rows = simulated(lifter, tmp_path, lines(columns), initial=InitialValues(120.0))
    np.testing.assert_allclose(last(rows), travelled(command(), start=120.0), rtol=NINE_DIGITS)


def test_without_displacement_and_initial_value_the_refusal_names_the_option(lifter, tmp_path):
    with pytest.raises(InputError, match=r"column 'displacement_mm': there is no such column.*--initial"):
        simulated(lifter, tmp_path, lines(alone()))
    with pytest.raises(InputError, match="column 'displacement_mm': there is no such column") as ahead:
        simulated(lifter, tmp_path, lines(alone()), horizon=3)
    assert "--initial" not in str(ahead.value)
    with pytest.raises(InputError, match="3 samples ahead requires the measured displacement; --initial"):
        simulated(lifter, tmp_path, lines(alone()), horizon=3, initial=InitialValues(120.0))
    with pytest.raises(InputError, match="column 'current_up_A': there is no such column"):
        simulated(lifter, tmp_path, lines(alone("time_s")), initial=InitialValues(120.0))
    assert not (tmp_path / "out.csv").exists()


def test_commands_with_a_gap_are_refused_where_they_start_from_one_displacement(lifter, tmp_path):
    time_s = STEP_S * np.arange(SAMPLES)
    time_s[60:] += 10
    text = lines(alone(time_s=time_s))
    with pytest.raises(InputError, match="split into 2 parts"):
        simulated(lifter, tmp_path, text, initial=InitialValues(120.0))


def test_commands_alone_are_read_by_the_signal_map_and_in_any_format(lifter, tmp_path):
    (tmp_path / "campaign.toml").write_text(
        '[signals]\ntime = { column = "t", unit = "ms" }\n'
        'command = { column = "valve", unit = "mA" }\ndisplacement = "angle_deg"\n'
    )
    columns = {"t": 10.0 * np.arange(SAMPLES), "valve": 1000.0 * command()}
    savemat(tmp_path / "m.mat", columns)
    written = [simulated(lifter, tmp_path, lines(columns), initial=InitialValues(120.0))]
    simulate_log(lifter, tmp_path / "m.mat", tmp_path / "out.csv", initial=InitialValues(120.0), force=True)
    header, *rows = csv.reader(io.StringIO((tmp_path / "out.csv").read_text()))
    for names, values in (*written, (header, rows)):
        assert names == ["t", "valve", "displacement_predicted_mm"]
        np.testing.assert_allclose(last(values), travelled(command(), start=120.0), rtol=NINE_DIGITS)


def test_a_load_that_is_given_replaces_the_covariate_of_the_log(tmp_path):
    channels = [handmade.channel(mode, shape=True) for mode in ("lifting", "lowering")]
    model = handmade.hitch_of(*channels)
    (tmp_path / "campaign.toml").write_text(
        '[signals]\nlifting_command = "current_up_A"\nlowering_command = "current_down_A"\n'
        'covariates = [{ column = "pressure", unit = "bar" }]\n'
    )
    _, rows = simulated(model, tmp_path, lines(alone()), initial=InitialValues(120.0, 80.0))
    run = model.simulate(command(), step_s=STEP_S, initial=120.0, load=80.0)
    np.testing.assert_allclose(last(rows), run.displacement, rtol=NINE_DIGITS)
    with pytest.raises(InputError, match="column 'pressure': there is no such column"):
        simulated(model, tmp_path, lines(alone()), initial=InitialValues(120.0), force=True)
    logged = lines({**table(), "pressure": np.full(SAMPLES, 30.0)})
    _, rows = simulated(model, tmp_path, logged, initial=InitialValues(load=80.0), force=True)
    shifted = model.simulate(command(), step_s=STEP_S, initial=5.0, load=80.0)
    np.testing.assert_allclose(last(rows), shifted.displacement, rtol=NINE_DIGITS)
    (tmp_path / "campaign.toml").unlink()
    with pytest.raises(InputError, match=r"has no 'pressure', which the model requires.*load"):
        simulated(model, tmp_path, lines(alone()), initial=InitialValues(120.0), force=True)
    with pytest.raises(InputError, match="load: the model has no covariate"):
        simulated(handmade.hitch(), tmp_path, PLAIN, initial=InitialValues(120.0, 80.0), force=True)


@pytest.mark.parametrize("unit", ["A", "mA", "percent", "l/min", "1"])
@pytest.mark.parametrize("modes", [("lifting", "lowering"), ("lowering",)])
@pytest.mark.parametrize("mapped", [False, True])
def test_the_file_of_a_designed_test_is_simulated_as_it_is(tmp_path, unit, modes, mapped):
    hitch = handmade.hitch(modes=modes)
    model = Hitch(hitch.channels, STEP_S, {**hitch.units, **{f"{mode}_command": unit for mode in modes}})
    proposal = Proposal(0.1, 0.4, 0.2, 3.0, 0, 10.0, {})
    advice = Advice("lowering", "gain", (proposal,), {}, ramps=False)
    write_command(model, advice, tmp_path / "next.csv")
    if mapped:
        (tmp_path / "campaign.toml").write_text(
            '[signals]\ntime = "t_ms"\ncommand = { column = "valve", unit = "V" }\n'
            'displacement = "angle_deg"\ncovariates = ["oil"]\n'
        )
    simulate_log(model, tmp_path / "next.csv", tmp_path / "out.csv", initial=InitialValues(120.0))
    header, *rows = csv.reader(io.StringIO((tmp_path / "out.csv").read_text()))
    lowering = command_of(model, "lowering", proposal)
    assert header[-1] == "displacement_predicted_mm"
    run = model.simulate(np.stack([0 * lowering, lowering], axis=1), step_s=STEP_S, initial=120.0)
    np.testing.assert_allclose(last(rows), run.displacement, rtol=NINE_DIGITS)
    assert np.ptp(last(rows)) > 1.0
