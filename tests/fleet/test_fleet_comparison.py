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


def changed(row, gain_factor=1.0, **changes):
    """Return a row with other gains and fields."""
    directions = {
        direction: replace(figures, gain=gain_factor * figures.gain)
        for direction, figures in row.directions.items()
    }
    return replace(row, directions=directions, **changes)


def test_the_faults_are_named_in_the_parameter_and_direction_in_which_they_are(comparison):
    named = {
        (
            comparison.machines[machine],
            comparison.parameters[column].direction,
            comparison.parameters[column].name,
        )
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


def test_only_the_commonest_structure_and_units_of_a_direction_are_compared(rows):
    other = replace(rows[0].directions["lowering"], structure="integrator: gain")
    odd = replace(rows[0], directions={**rows[0].directions, "lowering": other})
    in_metres = replace(rows[1], units={**fleet_rows.UNITS, "displacement": "m"})
    result = compare_fleet([odd, in_metres, *rows[2:]])
    column = result.column("lowering", "gain")
    assert np.isnan(result.estimates[result.machines.index("tractor-00"), column])
    assert not np.isnan(
        result.estimates[result.machines.index("tractor-00"), result.column("lifting", "gain")]
    )
    assert "tractor-01" not in result.machines
    reasons = {(each.machine, each.direction): each.reason for each in result.not_compared}
    assert set(reasons) == {
        ("tractor-00", "lowering"),
        ("tractor-01", "lifting"),
        ("tractor-01", "lowering"),
    }
    assert reasons["tractor-00", "lowering"].startswith("structure integrator: gain; compared is")
    assert reasons["tractor-01", "lifting"] == "units m and A; compared are mm and A"


def test_parameters_without_an_error_are_left_out_and_told(rows):
    lifting = replace(rows[0].directions["lifting"], gain_error=None, dead_zone_error=0.0)
    result = compare_fleet([replace(rows[0], directions={"lifting": lifting}), *rows[1:]])
    assert [each.reason for each in result.not_compared] == [
        "the tests do not determine the gain",
        "the dead zone was given, not identified",
    ]
    first = result.estimates[0]
    present = {result.parameters[column].name for column in np.flatnonzero(~np.isnan(first))}
    assert present == {"delay", "load scatter"}


def test_a_parameter_that_no_machine_has_is_no_column():
    rows = [fleet_rows.row("a", {"lifting": fleet_rows.figures("lifting", delay_s=None, load_scatter=None)})]
    assert [parameter.name for parameter in compare_fleet(rows).parameters] == ["gain", "dead zone"]


@pytest.mark.parametrize("machines", [1, 2, 3, 9])
def test_of_few_machines_none_is_named_and_a_notice_says_so(machines):
    result = compare_fleet(fleet_rows.fleet(machines))
    assert result.standing_out == ()
    assert np.all(np.isnan(result.outliers.p_value))
    assert f"gain of lifting ({machines})" in result.notices[0]
    known = [not np.isnan(population.mean) for population in result.populations]
    assert known == [machines >= 3] * 2 * len(NAMES)


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


def metadata(machines, **columns):
    return Metadata("machines.csv", tuple(machines), columns)


def test_a_cohort_with_another_gain_is_a_discovery_and_the_others_are_not():
    slow = {number: {"gain_factor": 0.94} for number in range(30)}
    rows = fleet_rows.fleet(60, seed=9, faults=slow)
    names = [row.machine for row in rows]
    known = metadata(names, oil=tuple("old" if number < 30 else "new" for number in range(60)))
    result = compare_fleet(rows, known)
    found = {result.parameters[effect.parameter] for effect in result.cohorts if effect.q_value < 0.01}
    assert {(parameter.direction, parameter.name) for parameter in found} == {("lowering", "gain")}
    (effect,) = (each for each in result.cohorts if result.parameters[each.parameter] in found)
    means = dict(zip(effect.labels, effect.values, strict=True))
    # Four standard errors of a difference of means of thirty machines, spread and error included.
    tolerance = 4 * np.hypot(fleet_rows.GAIN_SPREAD, fleet_rows.GAIN_ERROR) * np.sqrt(2 / 30)
    assert means["old"] - means["new"] == pytest.approx(np.log(0.94), abs=tolerance)


def test_a_column_that_divides_nothing_and_machines_without_a_line_give_notices():
    rows = fleet_rows.fleet(12)
    known = metadata([*(row.machine for row in rows[1:]), "unknown"], serial=tuple(map(str, range(12))))
    notices = compare_fleet(rows, known).notices
    assert any("no line for tractor-00" in notice for notice in notices)
    assert any("no result for unknown" in notice for notice in notices)
    assert any("column 'serial' has no two categories" in notice for notice in notices)


# --- trends -------------------------------------------------------------------------------------------------


def test_a_machine_that_slows_down_has_a_slope_and_the_last_date_is_compared(rows):
    aged = [changed(row, 0.9 if row.machine == "tractor-03" else 1.0, date=LATER) for row in rows[:10]]
    result = compare_fleet([*rows, *aged])
    assert len(result.machines) == 60
    assert {row.date for row in result.rows if row.machine in {each.machine for each in aged}} == {LATER}
    trends = result.trends
    assert trends is not None
    assert [result.machines[number] for number in trends.machines] == [f"tractor-{k:02d}" for k in range(10)]
    named = {
        (result.machines[machine], result.parameters[column].name)
        for machine, column in trends.ranking
        if trends.q_values[np.flatnonzero(trends.machines == machine)[0], column] < 0.1
    }
    assert named == {("tractor-03", "gain")}
    column = result.column("lifting", "gain")
    days = 365 / 365.25
    assert trends.slopes[3, column] == pytest.approx(np.log(0.9) / days)


def test_one_date_is_no_trend_and_failures_or_other_structures_are_no_dates(rows):
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
    (line,) = (
        each
        for each in lines
        if (each["machine"], each["direction"], each["parameter"]) == ("tractor-07", "lowering", "gain")
    )
    assert line["stands_out"] is True
    assert line["value"] == pytest.approx(np.exp(line["estimate"]))
    assert line["deviation_lower"] < line["deviation"] < line["deviation_upper"] < 0
    assert len(tables["outliers"]) == 2
