"""Comparison of machines: known faults are named, and what is not comparable is listed."""

from dataclasses import replace

import numpy as np
import pytest

import fleet_rows
from hitchid.errors import InputError
from hitchid.fleet import compare_fleet
from hitchid.fleet.parameters import NAMES, Metadata

FAULTS = {7: {"gain_factor": 0.85}, 2: {"dead_zone_shift": 0.035}}
LATER = "2027-03-01T08:00:00+00:00"


@pytest.fixture(scope="module")
def rows():
    return fleet_rows.fleet(60, seed=5, faults=FAULTS)


@pytest.fixture(scope="module")
def comparison(rows):
    return compare_fleet(rows)


def test_faults_are_named_in_their_parameter_and_direction(comparison):
    parameters = comparison.parameters
    named = {
        (comparison.machines[machine], parameters[column].direction, parameters[column].name)
        for machine, column in comparison.outliers.ranking
    }
    assert named == {("tractor-07", "lowering", "gain"), ("tractor-02", "lowering", "dead zone")}
    assert set(comparison.standing_out) == {"tractor-07", "tractor-02"}


def test_the_distribution_over_machines_contains_the_truth(comparison):
    for direction in ("lifting", "lowering"):
        for name, truth in (
            ("gain", np.log(fleet_rows.GAINS[direction])),
            ("dead zone", fleet_rows.DEAD_ZONES[direction]),
        ):
            population = comparison.populations[comparison.column(direction, name)]
            # Four standard errors: an interval of 95 % has two on each side.
            half_width = population.mean_interval[1] - population.mean_interval[0]
            assert abs(population.mean - truth) < half_width
            assert population.machines == 60
            lower, upper = population.prediction_interval
            assert lower < population.mean_interval[0] < population.mean_interval[1] < upper


def test_the_order_of_the_rows_does_not_matter(rows, comparison):
    shuffled = [rows[index] for index in np.random.default_rng(0).permutation(len(rows))]
    again = compare_fleet(shuffled)
    assert again.machines == comparison.machines
    np.testing.assert_array_equal(again.outliers.p_value, comparison.outliers.p_value)


def test_only_the_commonest_structure_and_units_are_compared(rows):
    other = replace(rows[0].directions["lowering"], structure="integrator: gain")
    odd = replace(rows[0], directions={**rows[0].directions, "lowering": other})
    in_metres = replace(rows[1], units={**fleet_rows.UNITS, "displacement": "m"})
    result = compare_fleet([odd, in_metres, *rows[2:]])
    estimates = result.estimates[result.machines.index("tractor-00")]
    assert np.isnan(estimates[result.column("lowering", "gain")])
    assert not np.isnan(estimates[result.column("lifting", "gain")])
    assert "tractor-01" not in result.machines
    reasons = {(left_out.machine, left_out.direction): left_out.reason for left_out in result.not_compared}
    assert set(reasons) == {
        ("tractor-00", "lowering"),
        ("tractor-01", "lifting"),
        ("tractor-01", "lowering"),
    }
    assert reasons["tractor-00", "lowering"].startswith("structure integrator: gain; compared is")
    assert reasons["tractor-01", "lifting"] == "units m and A; compared are mm and A"


def test_what_lacks_an_error_or_a_value_is_left_out(rows):
    lifting = replace(rows[0].directions["lifting"], gain_error=None, dead_zone_error=0.0)
    result = compare_fleet([replace(rows[0], directions={"lifting": lifting}), *rows[1:]])
    assert [left_out.reason for left_out in result.not_compared] == [
        "the tests do not determine the gain",
        "the dead zone was given, not identified",
    ]
    present = {result.parameters[column].name for column in np.flatnonzero(~np.isnan(result.estimates[0]))}
    assert present == {"delay", "load scatter"}
    alone = fleet_rows.row("a", {"lifting": fleet_rows.figures("lifting", delay_s=None, load_scatter=None)})
    assert [parameter.name for parameter in compare_fleet([alone]).parameters] == ["gain", "dead zone"]


@pytest.mark.parametrize("machines", [1, 2, 3, 9])
def test_of_few_machines_none_is_named(machines):
    result = compare_fleet(fleet_rows.fleet(machines))
    assert result.standing_out == ()
    assert np.all(np.isnan(result.outliers.p_value))
    assert f"gain of lifting ({machines})" in result.notices[0]
    has_mean = [not np.isnan(population.mean) for population in result.populations]
    assert has_mean == [machines >= 3] * 2 * len(NAMES)


def test_failed_machines_are_rows_and_nothing_else():
    result = compare_fleet([*fleet_rows.fleet(12), fleet_rows.failed_row("broken")])
    assert [row.machine for row in result.failed] == ["broken"]
    assert "broken" not in result.machines
    alone = compare_fleet([fleet_rows.failed_row("broken")])
    assert (alone.machines, alone.parameters, alone.standing_out) == ((), (), ())
    assert {name: len(table) for name, table in alone.tables.items() if len(table)} == {"failures": 1}


def test_no_rows_and_a_wrong_rate_are_refused(rows):
    with pytest.raises(InputError, match="rows: got none"):
        compare_fleet([])
    with pytest.raises(InputError, match="false_discovery_rate"):
        compare_fleet(rows, false_discovery_rate=1.0)


# --- cohorts ------------------------------------------------------------------------------------------------


def with_gains(row, factor, date):
    """Return the row of a later date, with other gains."""
    directions = {
        direction: replace(figures, gain=factor * figures.gain)
        for direction, figures in row.directions.items()
    }
    return replace(row, directions=directions, date=date)


def test_a_cohort_with_another_gain_is_the_only_discovery():
    slow = {number: {"gain_factor": 0.94} for number in range(30)}
    rows = fleet_rows.fleet(60, seed=9, faults=slow)
    oils = tuple("old" if number < 30 else "new" for number in range(60))
    result = compare_fleet(rows, Metadata("machines.csv", tuple(row.machine for row in rows), {"oil": oils}))
    (effect,) = (effect for effect in result.cohorts if effect.q_value < 0.01)
    parameter = result.parameters[effect.parameter]
    assert (parameter.direction, parameter.name) == ("lowering", "gain")
    means = dict(zip(effect.labels, effect.values, strict=True))
    # Four standard errors of a difference of means of thirty machines, spread and error included.
    tolerance = 4 * np.hypot(fleet_rows.GAIN_SPREAD, fleet_rows.GAIN_ERROR) * np.sqrt(2 / 30)
    assert means["old"] - means["new"] == pytest.approx(np.log(0.94), abs=tolerance)


def test_a_useless_column_and_missing_machines_give_notices():
    rows = fleet_rows.fleet(12)
    names = (*(row.machine for row in rows[1:]), "unknown")
    metadata = Metadata("machines.csv", names, {"serial": tuple(map(str, range(12)))})
    notices = "\n".join(compare_fleet(rows, metadata).notices)
    assert "no line for tractor-00" in notices
    assert "no result for unknown" in notices
    assert "column 'serial' has no two categories" in notices


# --- trends -------------------------------------------------------------------------------------------------


def test_a_machine_that_slows_down_has_a_slope(rows):
    aged = [with_gains(row, 0.9 if row.machine == "tractor-03" else 1.0, LATER) for row in rows[:10]]
    result = compare_fleet([*rows, *aged])
    assert len(result.machines) == 60
    names = {row.machine for row in aged}
    assert {row.date for row in result.rows if row.machine in names} == {LATER}  # the last one is compared
    trends = result.trends
    assert [result.machines[number] for number in trends.machines] == [f"tractor-{k:02d}" for k in range(10)]
    named = {
        (result.machines[machine], result.parameters[column].name)
        for machine, column in trends.ranking
        if trends.q_values[np.flatnonzero(trends.machines == machine)[0], column] < 0.1
    }
    assert named == {("tractor-03", "gain")}
    days = 365 / 365.25
    assert trends.slopes[3, result.column("lifting", "gain")] == pytest.approx(np.log(0.9) / days)


def test_one_date_is_no_trend(rows):
    assert compare_fleet(rows).trends is None
    failed = fleet_rows.failed_row(rows[0].machine)
    assert compare_fleet([*rows, replace(failed, date="2020-01-01T00:00:00+00:00")]).trends is None


# --- tables -------------------------------------------------------------------------------------------------


def test_the_tables_have_a_line_for_each_machine_and_parameter(comparison):
    tables = comparison.tables
    assert set(tables) == {
        "outliers", "machines", "populations", "cohorts", "trends", "failures", "not_compared",
    }  # fmt: skip
    lines = [dict(zip(tables["machines"].columns, row, strict=True)) for row in tables["machines"].rows]
    assert len(lines) == 60 * 8
    by_name = {(line["machine"], line["direction"], line["parameter"]): line for line in lines}
    line = by_name["tractor-07", "lowering", "gain"]
    assert line["stands_out"] is True
    assert line["value"] == pytest.approx(np.exp(line["estimate"]))
    assert line["deviation_lower"] < line["deviation"] < line["deviation_upper"] < 0
    assert len(tables["outliers"]) == 2
