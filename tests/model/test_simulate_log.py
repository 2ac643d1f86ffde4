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
from machine import moved

STEP_S, SAMPLES = 0.01, 120
GAIN, ZONE = handmade.GAINS["lifting"], handmade.DEAD_ZONES["lifting"]
NAMES = ("time_s", "current_up_A", "current_down_A", "displacement_mm")
PREDICTED = "displacement_predicted_mm"
NINE_DIGITS = 5e-9  # of a cell


COMMAND = np.concatenate([np.zeros(10), np.repeat([0.5, 0.7, 0.4], SAMPLES)])[:SAMPLES]
TIME_S = STEP_S * np.arange(SAMPLES)
FROM_120_MM = InitialValues(120.0)


@pytest.fixture(scope="module")
def lifter():
    return handmade.hitch("integrator", modes=("lifting",))


def free_run(start=5.0, command=COMMAND):
    """Return x[k] = x₀ + K·T·Σ u[i<k], the free run of K/s."""
    return moved(start, np.stack([command, 0 * command], axis=1))


# A measured displacement that is not the model's, but starts where it starts.
MEASURED = 5.0 + 0.9 * free_run(0.0)
TABLE = dict(zip(NAMES, (np.round(TIME_S, 4), COMMAND, 0 * COMMAND, MEASURED), strict=True))


def lines(columns, *, header=None):
    rows = zip(*(map(repr, map(float, values)) for values in columns.values()), strict=True)
    return "\n".join([header or ",".join(columns), *map(",".join, rows)]) + "\n"


PLAIN = lines(TABLE)
GAP = np.where(np.arange(SAMPLES) < 60, TIME_S, TIME_S + 10)


def simulated(model, folder, log, *, file="log.csv", force=True, **options):
    """Return header and rows of what simulating a log wrote; a dictionary is a MATLAB file."""
    path, out = folder / file, folder / "out.csv"
    if isinstance(log, dict):
        savemat(path, log)
    else:
        path.write_bytes(log if isinstance(log, bytes) else log.encode())
    simulate_log(model, path, out, force=force, **options)
    return written(out)


def written(path):
    header, *rows = csv.reader(io.StringIO(path.read_text()))
    return header, rows


def assert_predicted(rows, expected, **tolerance):
    """Assert that the last cells of some rows are what is expected."""
    predicted = [float(row[-1]) for row in rows]
    np.testing.assert_allclose(predicted, expected, **{"rtol": NINE_DIGITS, **tolerance})


def test_free_run_is_the_closed_form_beside_unchanged_columns(lifter, tmp_path):
    (tmp_path / "campaign.toml").write_text('[split]\ntest = ["other-*"]\n')  # this log is in no part
    header, rows = simulated(lifter, tmp_path, PLAIN)
    assert header == [*NAMES, PREDICTED]
    assert "".join(",".join(row[:-1]) + "\n" for row in rows) == PLAIN.partition("\n")[2]
    assert_predicted(rows, free_run())
    # What is predicted can be read again.
    (record,) = read(tmp_path / "out.csv").records
    assert len(record) == SAMPLES


@pytest.mark.parametrize("horizon", [1, SAMPLES, 10**6, 10**30])
def test_one_step_ahead_the_measurement_counts_far_ahead_the_start(lifter, tmp_path, horizon):
    _, rows = simulated(lifter, tmp_path, PLAIN, horizon=horizon)
    expected = np.r_[5.0, MEASURED[:-1] + np.diff(free_run())] if horizon == 1 else free_run()
    assert_predicted(rows, expected)


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
def test_however_a_log_is_written_predictions_have_their_own_column(lifter, tmp_path, text):
    header, rows = simulated(lifter, tmp_path, text)
    assert header[-1] == PREDICTED
    assert {len(row) for row in rows} == {len(header)}
    assert_predicted(rows, free_run())


def test_gzipped_logs_and_matlab_files_give_the_same_prediction(lifter, tmp_path):
    _, rows = simulated(lifter, tmp_path, PLAIN)
    assert simulated(lifter, tmp_path, gzip.compress(PLAIN.encode()), file="z.csv.gz")[1] == rows
    beside = {
        "comment": "x" * SAMPLES,
        "rate_Hz": 100.0,
        "short": np.ones(7),
        "complex": 1j * np.ones(SAMPLES),
    }
    beside["texts"] = np.array([["x"] * SAMPLES], dtype=object)
    header, again = simulated(lifter, tmp_path, {**TABLE, **beside}, file="m.mat")
    assert (header[:4], header[-1]) == (list(NAMES), PREDICTED)
    assert_predicted(again, free_run())


def test_a_log_with_gaps_is_predicted_stretch_by_stretch(lifter, tmp_path):
    time_s = GAP + 10 * (np.arange(SAMPLES) >= 110)
    _, rows = simulated(lifter, tmp_path, lines({**TABLE, "time_s": time_s}))
    assert_predicted(rows[:60], free_run(command=COMMAND[:60]))
    # The second stretch starts under command: its first sample alone is before motion.
    assert_predicted(rows[60:110], free_run(MEASURED[60], COMMAND[60:110]))
    # Ten samples are no stretch that can be used.
    assert [row[-1] for row in rows[110:]] == [""] * 10
    with pytest.raises(InputError, match="split into 2 parts"):
        simulated(lifter, tmp_path, alone(time_s=GAP), initial=FROM_120_MM)


def test_time_in_milliseconds_since_1970_finds_every_row(lifter, tmp_path):
    (tmp_path / "campaign.toml").write_text(
        '[signals]\ntime = { column = "time_s", unit = "ms" }\n'
        'lifting_command = "current_up_A"\ndisplacement = "displacement_mm"\n'
    )
    _, rows = simulated(lifter, tmp_path, lines({**TABLE, "time_s": 1.7e12 + 1000 * TIME_S}))
    # 1.7·10⁹ s are resolved to 2.4·10⁻⁷ s, in which the piston moves up to K·(0.7 − d) times that.
    assert_predicted(rows, free_run(), atol=2 * np.spacing(1.7e9) * GAIN * (0.7 - ZONE))


def test_a_prediction_comes_in_the_unit_of_the_log(lifter, tmp_path):
    columns = {**TABLE, "displacement_mm": MEASURED / 1000}
    header = ",".join(NAMES).replace("displacement_mm", "stroke_m")
    (tmp_path / "campaign.toml").write_text(
        '[signals]\nlifting_command = "current_up_A"\ndisplacement = "stroke_m"\n'
    )
    header, rows = simulated(lifter, tmp_path, lines(columns, header=header))
    assert header[-1] == "stroke_m_predicted"
    assert_predicted(rows, free_run() / 1000)


def test_a_log_that_is_refused_leaves_nothing_and_replaces_nothing(lifter, tmp_path):
    with pytest.raises(HitchError):
        simulated(lifter, tmp_path, "time_s\n1\n")
    lowering = {**TABLE, "current_up_A": 0 * COMMAND, "current_down_A": COMMAND}
    with pytest.raises(InputError, match="lowering"):
        simulated(lifter, tmp_path, lines(lowering))
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]
    (tmp_path / "out.csv").write_text("old")
    with pytest.raises(OutputError, match="exists already"):
        simulated(lifter, tmp_path, PLAIN, force=False)
    assert (tmp_path / "out.csv").read_text() == "old"


@given(st.text(st.characters(exclude_characters="_")))
def test_a_predicted_column_keeps_the_unit_of_a_displacement_last(name):
    assert added_name(name, "predicted") == f"{name}_predicted"
    assert added_name("displacement_mm", "predicted") == PREDICTED
    assert added_name("my_displacement_mm", "predicted") == "my_displacement_mm_predicted"


def alone(*names, **changed):
    """Return the commands of the log without its displacement, or some of its columns."""
    return lines({name: {**TABLE, **changed}[name] for name in names or NAMES[:3]})


@pytest.mark.parametrize("measured", [False, True])
def test_commands_and_an_initial_displacement_are_enough(lifter, tmp_path, measured):
    (tmp_path / "log.csv").write_text(PLAIN if measured else alone())
    result = simulate_log(lifter, tmp_path / "log.csv", tmp_path / "out.csv", initial=FROM_120_MM)
    header, rows = written(tmp_path / "out.csv")
    assert header == [*NAMES[: 4 if measured else 3], PREDICTED]
    assert_predicted(rows, free_run(120.0))
    assert (result.samples, result.unit) == (SAMPLES, "mm")
    not_used = "'displacement_mm' is not used: the simulation starts from 120 mm"
    assert result.notices == ((not_used,) if measured else ())


@pytest.mark.parametrize(
    "measured", [np.where(np.arange(SAMPLES) < 3, MEASURED, np.nan), np.full(SAMPLES, 7.0)]
)
def test_a_broken_sensor_does_no_harm_beside_an_initial_value(lifter, tmp_path, measured):
    log = lines({**TABLE, "displacement_mm": measured})
    _, rows = simulated(lifter, tmp_path, log, initial=FROM_120_MM)
    assert_predicted(rows, free_run(120.0))


def test_without_displacement_and_initial_value_the_refusal_names_the_option(lifter, tmp_path):
    with pytest.raises(InputError, match=r"column 'displacement_mm': there is no such column.*--initial"):
        simulated(lifter, tmp_path, alone())
    with pytest.raises(InputError, match="column 'displacement_mm': there is no such column") as ahead:
        simulated(lifter, tmp_path, alone(), horizon=3)
    assert "--initial" not in str(ahead.value)
    with pytest.raises(InputError, match="3 samples ahead requires the measured displacement; --initial"):
        simulated(lifter, tmp_path, alone(), horizon=3, initial=FROM_120_MM)
    with pytest.raises(InputError, match="column 'current_up_A': there is no such column"):
        simulated(lifter, tmp_path, alone("time_s"), initial=FROM_120_MM)


def test_commands_alone_are_read_by_signal_map_in_any_format(lifter, tmp_path):
    (tmp_path / "campaign.toml").write_text(
        '[signals]\ntime = { column = "t", unit = "ms" }\n'
        'command = { column = "valve", unit = "mA" }\ndisplacement = "angle_deg"\n'
    )
    columns = {"t": 1000.0 * TIME_S, "valve": 1000.0 * COMMAND}
    for log, file in ((lines(columns), "log.csv"), (columns, "m.mat")):
        names, rows = simulated(lifter, tmp_path, log, file=file, initial=FROM_120_MM)
        assert names == ["t", "valve", PREDICTED]
        assert_predicted(rows, free_run(120.0))


def test_a_given_load_replaces_the_covariate_of_the_log(tmp_path):
    model = handmade.hitch_of(*(handmade.channel(mode, shape=True) for mode in ("lifting", "lowering")))
    (tmp_path / "campaign.toml").write_text(
        '[signals]\nlifting_command = "current_up_A"\nlowering_command = "current_down_A"\n'
        'covariates = [{ column = "pressure", unit = "bar" }]\n'
    )
    logged = lines({**TABLE, "pressure": np.full(SAMPLES, 30.0)})
    for log, start, initial in (
        (alone(), 120.0, InitialValues(120.0, 80.0)),
        (logged, 5.0, InitialValues(load=80.0)),
    ):
        _, rows = simulated(model, tmp_path, log, initial=initial)
        run = model.simulate(COMMAND, step_s=STEP_S, initial=start, load=80.0)
        assert_predicted(rows, run.displacement)
    with pytest.raises(InputError, match="column 'pressure': there is no such column"):
        simulated(model, tmp_path, alone(), initial=FROM_120_MM)
    (tmp_path / "campaign.toml").unlink()
    with pytest.raises(InputError, match=r"has no 'pressure', which the model requires.*load"):
        simulated(model, tmp_path, alone(), initial=FROM_120_MM)
    with pytest.raises(InputError, match="load: the model has no covariate"):
        simulated(handmade.hitch(), tmp_path, PLAIN, initial=InitialValues(120.0, 80.0))


@pytest.mark.parametrize(
    ("unit", "modes", "mapped"),
    [
        ("A", ("lifting", "lowering"), False),
        ("mA", ("lowering",), False),
        ("percent", ("lifting", "lowering"), True),
        ("l/min", ("lowering",), True),
        ("1", ("lifting", "lowering"), False),
    ],
)
def test_the_file_of_a_designed_test_is_simulated_unchanged(tmp_path, unit, modes, mapped):
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
    simulate_log(model, tmp_path / "next.csv", tmp_path / "out.csv", initial=FROM_120_MM)
    header, rows = written(tmp_path / "out.csv")
    lowering = command_of(model, "lowering", proposal)
    assert header[-1] == PREDICTED
    run = model.simulate(np.stack([0 * lowering, lowering], axis=1), step_s=STEP_S, initial=120.0)
    assert_predicted(rows, run.displacement)
    assert np.ptp(run.displacement) > 1.0
