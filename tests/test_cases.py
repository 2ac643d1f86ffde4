"""Small logs that went wrong for those who recorded them: what is read, found and identified is the truth."""

import csv
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import hitchid
from hitchid._support.records import Severity
from hitchid.fleet import identify_fleet
from hitchid.identification.settings_file import read_settings
from hitchid.logs import inspect, propose

CASES = os.environ.get("HITCHID_CASES", "")
PRINTED = 5.001e-5  # half of the last digit of displacements below 100, of six digits
LIFTING, LOWERING = "lifting", "lowering"


@pytest.fixture(scope="module")
def case():
    """Return a function that gives the folder of a case, or skips the test."""

    def folder(name: str) -> Path:
        if not CASES or not (Path(CASES) / name).is_dir():
            pytest.skip(f"the case {name} is missing; set HITCHID_CASES to the folder of small cases")
        return Path(CASES) / name

    return folder


@pytest.fixture(scope="module")
def inspected(case):
    """Return a function that gives records by name, findings and notices of a case in which all is read."""

    def look(name, signals=None):
        inspection = inspect(case(name), signals=signals)
        assert not inspection.faults
        assert not inspection.left_out
        records = {entry.record.name: entry.record for entry in inspection.records}
        return records, inspection.findings, "\n".join(map(str, inspection.notices))

    return look


def of_check(findings, check):
    """Return the one finding of a check."""
    (finding,) = [finding for finding in findings if finding.check == check]
    return finding


@pytest.fixture(scope="module")
def lift(case):
    """Return stamp, commands and displacement of the test that many formats hold, arrays of shape [N]."""
    _, *rows = csv.reader((case("clock-iso") / "lift.csv").read_text().splitlines())
    commands = np.array([[float(cell) for cell in row[1:]] for row in rows]).T
    return np.arange(len(rows)) / 100, *commands


def german(path):
    """Return the cells of a log with semicolons and decimal commas, by row, below its header."""
    lines = [line.split(";") for line in path.read_text(encoding="utf-8-sig").splitlines()]
    return [
        [cell.replace(",", ".") for cell in row] for row in lines if len(row) == 3 and row[1][-1:].isdigit()
    ]


# --- what is read -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [
        *("clock-hms", "clock-iso", "clock-toa5", "csv-comment-line", "csv-crcrlf", "csv-nul-tail"),
        *("csv-quoted-comma", "lvm-three-channels", "lvm-no-x-column", "h5-2d", "h5-compound"),
    ],
)
def test_every_dialect_is_read_as_the_same_500_samples(inspected, lift, name):
    records, _, _ = inspected(name)
    check_lift(records, lift)


def check_lift(records, lift):
    time_s, up, down, displacement = lift
    (record,) = records.values()
    assert (record.kind, len(record), record.step_s, record.start_s) == (LIFTING, 500, 0.01, 0.0)
    np.testing.assert_allclose(record.displacement, displacement, rtol=0, atol=PRINTED)
    np.testing.assert_array_equal(record.command(LIFTING), up)
    assert not np.any(record.signals.get("lowering_command", down))
    np.testing.assert_allclose(record.time_s, time_s, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["mat-to-file", "mat-matrix", "mat-mux"])
def test_matrices_of_simulink_are_read_as_proposed(case, inspected, lift, tmp_path, name):
    (tmp_path / "signals.toml").write_text(propose(case(name)).replace('unit = "1"', 'unit = "A"'))
    records, _, _ = inspected(name, tmp_path / "signals.toml")
    check_lift(records, lift)


def test_on_and_off_are_one_and_zero(inspected, lift):
    records, _, _ = inspected("csv-on-off")
    np.testing.assert_array_equal(records["lift"].command(LIFTING), lift[1] > 0)
    np.testing.assert_allclose(records["lift"].displacement, lift[3], rtol=0, atol=PRINTED)


def test_a_cut_last_row_is_dropped_with_a_notice(inspected, lift):
    records, _, notices = inspected("csv-cut-last-row")
    np.testing.assert_allclose(records["lift"].displacement, lift[3][:499], rtol=0, atol=PRINTED)
    assert "the last line, 501, is left out: it is cut" in notices


def test_blank_cells_leave_the_samples_that_were_measured(inspected, lift):
    records, findings, _ = inspected("csv-blank-cells")
    assert records["lift"].step_s == 0.05
    np.testing.assert_allclose(records["lift"].displacement, lift[3][::5], rtol=0, atol=PRINTED)
    np.testing.assert_array_equal(records["lift"].command(LIFTING), lift[1][::5])
    assert of_check(findings, "not measured").what.startswith("400 of 500 samples are left out")


def test_samples_that_mdf_calls_invalid_are_left_out_and_counted(inspected, lift):
    records, findings, _ = inspected("mdf-invalid-samples")
    assert of_check(findings, "not measured").what.startswith(
        "3 of 500 samples are left out, the first in sample 100"
    )
    # Interpolated over at most three samples of 0.01 s, at 48 mm/s.
    np.testing.assert_allclose(records["lift"].displacement, lift[3], rtol=0, atol=48 * 0.03)
    assert np.count_nonzero(np.abs(records["lift"].displacement - lift[3]) > PRINTED) <= 3


def test_iso_stamps_are_seconds_since_the_first_row(case, inspected, tmp_path):
    (tmp_path / "signals.toml").write_text(propose(case("german-iso")))
    records, findings, _ = inspected("german-iso", tmp_path / "signals.toml")
    assert len(records) == 8
    for name, record in records.items():
        rows = german(case("german-iso") / f"{name}.csv")
        assert (record.step_s, record.start_s) == (0.01, 0.0)
        np.testing.assert_array_equal(record.displacement, [float(row[2]) for row in rows])
    check_stops(records, findings)


@pytest.mark.parametrize("name", ["candump", "can-trc", "mf4-unfinalized"])
def test_frames_of_a_bus_are_decoded(case, inspected, name):
    records, _, notices = inspected(name)
    assert sorted(records) == ["lifting-01", "lifting-02", "lowering-01", "lowering-02"]
    for log, record in records.items():
        text = (case("candump") / f"{log}.log").read_text()
        position = np.array([0.4 * int(first, 16) for first in re.findall(r"18FE4505#(..)", text)])
        assert record.step_s == pytest.approx(0.1, rel=1e-3)
        if "resampled: the clock jitters" not in "".join(map(str, record.notices)):
            np.testing.assert_allclose(record.displacement, position, rtol=1e-12)
        else:
            assert len(record) in (position.size - 1, position.size)
        assert (record.displacement[0], np.ptp(record.displacement)) == pytest.approx(
            (position[0], np.ptp(position)), rel=1e-12
        )
    assert ("never finalized" in notices) == (name == "mf4-unfinalized")


def test_dropouts_cost_a_stretch_and_not_the_log(inspected):
    records, findings, notices = inspected("dropouts")
    logs = {f"Messung_{number}" for number in range(1, 9)}
    assert {name.partition("@")[0] for name in records} == logs
    # Messung_2 reads zero for 80 samples, Messung_3 nothing for 60, Messung_6 dashes for 30.
    left = {name: sum(len(r) for n, r in records.items() if n.startswith(name)) for name in logs}
    assert left == dict.fromkeys(logs, 1200) | {"Messung_2": 1120, "Messung_3": 1140}
    not_measured = [finding.record for finding in findings if finding.check == "not measured"]
    assert not_measured == ["Messung_2@1", "Messung_3@1", "Messung_6"]
    assert "2.5% of the samples are interpolated" in notices
    stuck = of_check(findings, "stuck sensor")
    assert (stuck.severity, stuck.records) == (Severity.FAULT, ("Messung_7",))
    assert min(record.displacement.min() for record in records.values()) > -0.2


@pytest.mark.parametrize("name", ["command-on-change", "slow-covariate"])
def test_each_channel_comes_to_the_clock_of_the_motion(case, inspected, name):
    records, _, _ = inspected(name)
    assert len(records) == 10
    assert {len(record) for record in records.values()} == {4000}
    asammdf = pytest.importorskip("asammdf")
    for log, record in list(records.items())[::5]:
        with asammdf.MDF(case(name) / f"{log}.mf4") as file:
            stroke, oil = file.get("stroke"), None
            np.testing.assert_array_equal(record.displacement, stroke.samples)
            command = file.get("current_up" if record.kind == LIFTING else "current_down")
            if name == "slow-covariate":
                oil = file.get("oil_temp")
        rows = np.searchsorted(command.timestamps, stroke.timestamps + 1e-9, side="right") - 1
        np.testing.assert_array_equal(record.command(record.kind), command.samples[rows])
        if oil is not None:
            expected = np.interp(stroke.timestamps, oil.timestamps, oil.samples)
            np.testing.assert_allclose(record.signals["oil_temp"], expected, rtol=1e-9)


def test_of_two_rows_with_one_stamp_the_last_counts(case, inspected):
    records, _, notices = inspected("two-rows-per-event")
    for name, record in records.items():
        _, *rows = csv.reader((case("two-rows-per-event") / f"{name}.csv").read_text().splitlines())
        up = {row[0]: float(row[1]) for row in rows}
        np.testing.assert_array_equal(record.command(LIFTING), list(up.values()))
    assert notices.count("they repeat the time stamp of the previous row") == len(records) == 12


def test_a_thousands_separator_is_refused_in_whatever_row(case):
    inspection = inspect(case("thousands-after-200-rows"))
    assert not inspection.records
    assert all("ambiguous: a decimal comma or a thousands separator" in fault for fault in inspection.faults)


# --- what is found ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "finding"),
    [
        ("first-sample-zero", "1 of 500 samples are left out, the first in line 2: they are stale"),
        ("sentinel-spikes", "8 of 500 samples are left out, the first in line 19: they read -9999 mm"),
    ],
)
def test_readings_that_no_sensor_measured_are_named_and_left_out(inspected, name, finding):
    records, findings, _ = inspected(name)
    assert of_check(findings, "not measured").records == tuple(records)
    assert finding in of_check(findings, "not measured").what
    assert min(record.displacement.min() for record in records.values()) > 6
    assert {len(record) for record in records.values()} == {499 if name == "first-sample-zero" else 500}


def test_logs_in_another_unit_are_a_fault_by_name(inspected):
    _, findings, _ = inspected("cm-and-mm")
    assert of_check(findings, "units").severity is Severity.FAULT
    assert of_check(findings, "units").records == ("lifting-02", "lifting-05", "lowering-02", "lowering-05")


def test_a_held_sensor_is_found(inspected):
    records, findings, _ = inspected("held-sensor")
    said = "the displacement is updated every 0.1 s but logged every 0.01 s"
    (finding,) = [finding for finding in findings if said in finding.what]
    assert finding.records == tuple(records)


@pytest.mark.parametrize("name", ["end-stops-excel-dates", "end-stops-mixed"])
def test_every_log_that_reaches_a_stop_is_named(inspected, name):
    records, findings, _ = inspected(name)
    assert all(record.step_s == 0.01 for record in records.values())
    check_stops(records, findings)


def check_stops(records, findings):
    # Noise of 0.04 %: a log that ends between 99.8 and 99.9 % might have met the stop of 100 % or not.
    at_stop = {
        name for name, r in records.items() if r.displacement.max() > 99.9 or r.displacement.min() < 0.1
    }
    assert set(of_check(findings, "end stop").records) == at_stop


# --- what is identified -------------------------------------------------------------------------------------


# One plant, logged in several ways.
BENCH = {
    LIFTING: {"gain": 80.0, "dead_zone": 0.40, "time_constant": 0.12, "dead_time": 0.04},
    LOWERING: {"gain": 110.0, "dead_zone": 0.35, "time_constant": 0.09, "dead_time": 0.04},
}
# The plant of the end stops was simulated in steps of 0.01 s, v += (0.01/0.15) (u - v), x += 0.01 v, and
# logged after each step: it lags by -0.01/ln(1 - 0.01/0.15) s, and begins one and a half steps before 0.08 s.
LAG_S, DELAY_S = 0.01 / -np.log(1 - 0.01 / 0.15), 0.08 - 0.015


@pytest.fixture(scope="module")
def traced(case):
    """Return a function that identifies the physics of cases with one configuration: case to traces."""

    def identify(names, configuration):
        campaigns = [hitchid.read(case(name)) for name in names]
        settings = {**read_settings(case(names[0]).parent / configuration), "training": None, "rivals": None}
        results = hitchid.identify_many(campaigns, **settings, progress=False)
        return {name: result.channels for name, result in zip(names, results, strict=True)}

    return identify


def check_truth(traces, truth, *, open_to=()):
    """Check that every 95 % interval contains the truth, and that all are closed but for some names."""
    for direction, values in truth.items():
        assessment = traces[direction].phase1.assessment
        estimates = {estimate.name: estimate for estimate in (*assessment.derived, *assessment.parameters)}
        estimates["dead_zone"] = traces[direction].characteristics.dead_zone
        for name, value in values.items():
            lower, upper = estimates[name].interval
            assert lower is None or lower <= value, (direction, name)
            assert upper is None or value <= upper, (direction, name)
            assert estimates[name].determined or name in open_to, (direction, name)


@pytest.mark.long
def test_what_is_left_out_leaves_the_plant(traced):
    names = ("first-sample-zero", "two-rows-per-event", "held-sensor")
    traces = traced(names, "quick.toml")
    for name in names[:2]:
        check_truth(traces[name], BENCH)
    # A sensor that is updated each 0.1 s says little about a dead time of 0.04 s.
    truth = {m: {k: v for k, v in values.items() if k != "time_constant"} for m, values in BENCH.items()}
    check_truth(traces["held-sensor"], truth, open_to=("dead_time",))
    for trace in traces["held-sensor"].values():
        assert not {e.name: e.determined for e in trace.phase1.parameter_estimates}["dead_time"]


@pytest.mark.long
def test_a_slow_covariate_leaves_the_plant(traced):
    truth = {direction: {**values, "gain": 14.0} for direction, values in BENCH.items()}
    check_truth(traced(["slow-covariate"], "quick.toml")["slow-covariate"], truth)


@pytest.mark.long
def test_end_stops_under_two_levels_of_command_leave_the_plant(traced):
    traces = traced(["end-stops-excel-dates"], "paper-forms.toml")["end-stops-excel-dates"]
    truth = {
        LIFTING: {"gain": 0.45, "dead_zone": 15.0, "lag 2ξh/ωh": LAG_S, "dead_time": DELAY_S},
        LOWERING: {"gain": 0.60, "dead_zone": 12.0, "lag 2ξh/ωh": LAG_S, "dead_time": DELAY_S},
    }
    check_truth(traces, truth, open_to=("dead_time", "lag 2ξh/ωh", "gain"))
    gain = {e.name: e for e in traces[LIFTING].phase1.parameter_estimates}["gain"]
    assert gain.determined


@pytest.mark.long
def test_end_stops_in_mixed_logs_leave_the_plant(traced):
    traces = traced(["end-stops-mixed"], "quick.toml")["end-stops-mixed"]
    truth = {
        LIFTING: {"gain": 0.45 / 12, "dead_zone": 15 * 12, "time_constant": LAG_S, "dead_time": DELAY_S},
        LOWERING: {"gain": 0.60 / 12, "dead_zone": 12 * 12, "time_constant": LAG_S, "dead_time": DELAY_S},
    }
    check_truth(traces, truth)


@pytest.mark.long
def test_machines_whose_names_are_patterns_have_rows_of_their_own(case, tmp_path):
    (tmp_path / "logs").mkdir()
    for name, source in {
        "rig 1": "rig 1",
        "rig [1]": "rig [1]",
        "rig ?": "rig 1",
        "rig *": "rig [1]",
    }.items():
        shutil.copytree(case("fleet-brackets") / source, tmp_path / "logs" / name)
    settings = read_settings(case("fleet-brackets").parent / "tiny.toml")
    rows = identify_fleet(str(tmp_path / "logs"), str(tmp_path / "rows"), settings=settings).rows
    gains = {row.machine: row.directions[LIFTING].gain for row in rows}
    # An integrator without the plant's lag and delay, 0.16 s in holds of a second or so: a tenth.
    assert gains == pytest.approx({"rig 1": 40, "rig ?": 40, "rig [1]": 80, "rig *": 80}, rel=0.1)
