"""Parameters as a table, and models with parameters set by hand."""

import sys
from dataclasses import replace

import numpy as np
import pytest

import handmade
from hitchid.errors import InputError
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model import Characteristics, Estimates, ParameterTable, Quantity, Uncertainty, load, save
from hitchid.model.estimates import Information
from hitchid.report.origin import origin_section
from hitchid.report.verdict import _parameter_finding
from hitchid.validation.estimate_tables import parameter_table
from hitchid.validation.report_data import Origin
from hitchid.validation.validate import set_by_hand_notices
from report import reported
from truth import STEP_S

GAIN, TIME_CONSTANT = handmade.GAINS[LIFTING], 0.08
GAIN_ERROR, TIME_CONSTANT_ERROR = 0.5, 0.01


def estimate(name, symbol, unit, value, error):
    """Return a parameter with an interval of two standard errors."""
    ends = (value - 2 * error, value + 2 * error)
    return reported.estimate(name, symbol=symbol, unit=unit, value=value, error=error, bootstrap=ends)


def assessed(correlation=0.6, *, bands=True):
    """Return a model of two directions with intervals of the lifting one."""
    model = handmade.hitch("integrator-first-order", compensated=True, baselines=True)
    estimates = Estimates(
        (
            estimate("gain", "K", "mm/(s·A)", GAIN, GAIN_ERROR),
            estimate("time_constant", "τ", "s", TIME_CONSTANT, TIME_CONSTANT_ERROR),
        ),
        (Quantity("bandwidth", "Hz", 2.0, (1.0, 3.0), determined=True),),
        ((1.0, correlation), (correlation, 1.0)),
        5,
        5,
    )
    dead_zone = Quantity("dead zone", "A", handmade.DEAD_ZONES[LIFTING], (0.33, 0.37), determined=True)
    characteristics = Characteristics("A", "mm/s", None, dead_zone, None, 0.9, None, None, (), ())
    information = Information(("gain",), (1.0,), ((1.0,),), ((1.0,),), ((0.0,),), (1.0,), 1, False, 5, 100.0)
    known_bands = handmade.with_bands(model, LIFTING).uncertainty[LIFTING].bands if bands else None
    assessment = Uncertainty(estimates, known_bands, information, characteristics)
    return replace(model, uncertainty={LIFTING: assessment})


def test_the_table_has_every_parameter_of_both_directions_with_its_interval():
    table = assessed().parameters
    names = ["dead_zone", "gain", "time_constant", "dead_time"]
    assert [(row.direction, row.name) for row in table] == [
        (direction, name) for direction in (LIFTING, LOWERING) for name in names
    ]
    gain = table[LIFTING, "gain"]
    assert (gain.symbol, gain.value, gain.unit) == ("K", GAIN, "mm/(s·A)")
    assert (gain.standard_error, gain.interval) == (GAIN_ERROR, (29.0, 31.0))
    assert gain.verdict == "determined"
    assert table[LIFTING, "dead_zone"].interval == (0.33, 0.37)
    unknown, absent = table[LOWERING, "gain"], table[LOWERING, "dead_time"]
    assert (unknown.interval, unknown.verdict) == ((None, None), "no interval")
    assert (absent.value, absent.verdict) == (0.0, "not part of the model")


def test_a_table_is_a_sequence_of_rows():
    table = assessed().parameters
    assert len(table) == 8
    assert table[0] is table.rows[0]
    assert list(table[2:4]) == list(table.rows[2:4])
    assert [row.name for row in table[LOWERING]] == ["dead_zone", "gain", "time_constant", "dead_time"]
    with pytest.raises(InputError, match=r"expected one of lifting dead_zone, lifting gain.*got .*'gians'"):
        table[LIFTING, "gians"]
    with pytest.raises(IndexError):
        table[8]


def test_a_table_shows_on_one_screen_and_in_a_notebook():
    table = assessed().parameters
    assert len(repr(table).splitlines()) == 10
    html = table._repr_html_()
    assert html.count("<tr>") == 9
    assert "29 … 31" in html
    row = replace(table.rows[0], verdict="not determined: " + 30 * "wide ")
    long = ParameterTable((row,) * 40)
    assert len(repr(long).splitlines()) == 25
    assert repr(long).splitlines()[-1] == "  … 18 more lines"
    assert max(map(len, repr(long).splitlines())) <= 110


def test_a_table_is_a_dataframe_where_pandas_is_installed(monkeypatch):
    table = assessed().parameters
    frame = table.to_dataframe()
    assert frame.columns.tolist() == [
        *("direction", "name", "symbol", "value", "unit", "standard_error", "lower", "upper", "verdict"),
    ]
    assert frame["lower"].tolist()[:2] == [0.33, 29.0]
    assert np.isnan(frame["lower"].tolist()[3])
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"pip install 'hitchid\[pandas\]'"):
        table.to_dataframe()


def test_a_gain_set_by_hand_is_that_of_the_simulation(make_record):
    model = assessed()
    changed = model.with_parameters(lifting={"gain": 25.0, "dead_zone": 0.3})
    record = make_record(np.full(200, 100.0), np.r_[0.0, np.full(199, 0.8)])
    travel = np.asarray(changed.simulate(record)) - 100.0
    time_s = STEP_S * np.arange(199)
    exact = 25 * 0.5 * (time_s - TIME_CONSTANT * (1 - np.exp(-time_s / TIME_CONSTANT)))
    # Sums of 200 numbers around 100.
    np.testing.assert_allclose(travel[1:], exact, rtol=0, atol=200 * np.finfo(float).eps * 110)
    assert changed.dead_zones == {LIFTING: 0.3, LOWERING: handmade.DEAD_ZONES[LOWERING]}
    assert model.parameters[LIFTING, "gain"].value == GAIN


def test_results_of_old_values_are_dropped_in_that_direction_only():
    model = handmade.with_bands(assessed(), LIFTING, LOWERING)
    changed = model.with_parameters(lifting={"gain": 25.0})
    assert changed.channels[LIFTING].compensator is changed.channels[LIFTING].speed_compensator is None
    assert changed.uncertainty[LIFTING] == Uncertainty(changed.uncertainty[LIFTING].benchmark)
    assert set(changed.rivals) == {LOWERING}
    assert not changed.has_bands
    assert changed.channels[LOWERING] is model.channels[LOWERING]
    assert changed.uncertainty[LOWERING] is model.uncertainty[LOWERING]
    assert model.with_parameters() == model
    # A dead zone set by hand leaves the commands of the tests where they were.
    covered = handmade.hitch(covered=handmade.envelope(command=(0.0, 0.5)))
    command = covered.with_parameters(lifting={"dead_zone": 0.25}).channels[LIFTING].operating_range.command
    assert (float(command.lowest), float(command.highest)) == (0.0, pytest.approx(0.6, rel=1e-15))


@pytest.mark.parametrize(
    ("correlation", "gain", "kept"),
    [
        (0.0, 25.0, True),
        # The fit of τ with K held moves by ρ K ln(25/30)/σ = 0.6 · 10.9 standard errors.
        (0.6, 25.0, False),
        (0.6, 30.05, True),  # 0.6 · 0.1
        (0.02, 25.0, False),  # 0.02 · 10.9 = 0.22
        (0.005, 25.0, True),  # 0.05
    ],
)
def test_an_interval_stays_that_hardly_depends_on_what_was_set(correlation, gain, kept):
    changed = assessed(correlation).with_parameters(lifting={"gain": gain})
    row = changed.parameters[LIFTING, "time_constant"]
    assert (row.standard_error is not None) == kept
    assert (row.interval != (None, None)) == kept
    assert row.verdict == ("determined" if kept else "no interval: estimated with a different value of gain")
    assert changed.parameters[LIFTING, "gain"].verdict == "set by hand"
    assert changed.parameters[LIFTING, "gain"].interval == (None, None)


@pytest.mark.parametrize("values", [{"dead_zone": 0.3}, {"dead_time": 0.02}])
def test_no_interval_stays_where_what_was_set_was_not_estimated(values):
    table = assessed(0.0).with_parameters(lifting=values).parameters[LIFTING]
    assert all(row.interval == (None, None) for row in table)
    assert [row.verdict for row in table if row.name in values] == ["set by hand"]


def test_a_second_change_keeps_the_first_one():
    once = assessed().with_parameters(lifting={"gain": 25.0})
    changed = once.with_parameters(lifting={"time_constant": 0.1})
    verdicts = {row.name: row.verdict for row in changed.parameters[LIFTING]}
    assert verdicts["gain"] == verdicts["time_constant"] == "set by hand"
    assert changed.provenance.set_by_hand == {LIFTING: {"gain": 25.0, "time_constant": 0.1}}
    estimates = changed.uncertainty[LIFTING].benchmark.parameters
    assert [parameter.verdict for parameter in estimates] == ["set by hand", "set by hand"]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"gians": 25.0}, "lifting: key: expected one of dead_zone, gain, time_constant, dead_time, got"),
        ({"gain": 0.0}, "lifting gain: expected more than 0, got 0"),
        ({"gain": -3.0}, "lifting gain: expected more than 0, got -3"),
        ({"gain": np.inf}, "lifting gain: expected a finite number, got float inf"),
        ({"time_constant": 1e-4}, r"lifting time_constant: expected from 0\.001 to 100, got 0\.0001"),
        ({"dead_time": -0.1}, r"lifting dead_time: expected from 0 to 1, got -0\.1"),
        ({"dead_zone": 0.9}, r"lifting dead_zone: expected from 0 to 0\.85, got 0\.9"),
    ],
)
def test_unknown_names_and_values_that_are_not_admissible_are_refused(values, message):
    model = handmade.hitch("integrator-first-order", covered=handmade.envelope())
    with pytest.raises(InputError, match=message):
        model.with_parameters(lifting=values)
    with pytest.raises(InputError, match="direction: expected one of lifting, got str 'lowering'"):
        handmade.hitch(modes=(LIFTING,)).with_parameters(lowering=values)


def test_a_changed_model_says_so_in_folder_validation_and_report(tmp_path):
    changed = assessed().with_parameters(lifting={"gain": 25.0, "dead_time": 0.02})
    save(changed, tmp_path / "model")
    again = load(tmp_path / "model")
    assert again.parameters == changed.parameters
    assert again.provenance.set_by_hand == {LIFTING: {"gain": 25.0, "dead_time": 0.02}}
    (notice,) = set_by_hand_notices(again, LIFTING)
    assert notice.startswith("lifting: gain 25 mm/(s·A), dead time 0.02 s set by hand;")
    assert set_by_hand_notices(again, LOWERING) == []
    gain_row = parameter_table(LIFTING, "", "", again.uncertainty[LIFTING].benchmark).shown().rows[0]
    assert gain_row == ("K", "mm/(s·A)", "25", "", "", "", "set by hand")
    _, origin, *_ = origin_section(Origin(again.provenance, again.step_s, {}), "").blocks
    assert ("set by hand: lifting", "dead_time = 0.02, gain = 25") in origin.rows
    by_gain = assessed(0.0).with_parameters(lifting={"gain": 25.0})
    finding = _parameter_finding("lifting", by_gain.uncertainty[LIFTING].benchmark)
    assert finding.sentence == "Lifting: 1 of 2 parameters without an interval: K."
