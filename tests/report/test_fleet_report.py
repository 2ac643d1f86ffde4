"""Report of a fleet: a verdict true to the figures, a section for what there is, nothing for what is not."""

from dataclasses import replace

import numpy as np
import pytest

import fleet_rows
from hitchid.fleet import compare_fleet
from hitchid.fleet.findings import fleet_findings, q_text
from hitchid.fleet.parameters import Metadata
from hitchid.fleet.report import fleet_report
from hitchid.report import Rating, render

FAULTS = {7: {"gain_factor": 0.85}, 2: {"dead_zone_shift": 0.04}, 11: {"delay_s": 0.2}}
LATER = "2027-03-01T08:00:00+00:00"
ALWAYS = ["Cost", "How to reproduce"]


def document(rows, metadata=None):
    return fleet_report(compare_fleet(rows, metadata), source="results", command="hitchid fleet report")


def titles(report):
    return [section.title for section in report.sections]


def table(report, title):
    (matching,) = (table for table in report.tables if table.title == title)
    return matching


@pytest.fixture(scope="module")
def with_faults():
    failed = [
        fleet_rows.failed_row("broken", message="<script>alert(1)</script>"),
        fleet_rows.failed_row("empty"),
        fleet_rows.failed_row("other", cause="FitError"),
    ]
    return [*fleet_rows.fleet(30, faults=FAULTS), *failed]


@pytest.fixture(scope="module")
def report(with_faults):
    return document(with_faults)


def test_the_verdict_names_who_stands_out_and_how(report):
    levels, sentences = zip(*report.verdict, strict=True)
    assert sentences[0] == "3 of 30 machines stand out."
    assert levels[0] is Rating.CAUTION
    by_machine = {sentence.split()[0]: sentence for sentence in sentences[1:4]}
    assert "tractor-07 lowers 1" in by_machine["tractor-07"]
    assert "% slower than the others (interval \N{MINUS SIGN}" in by_machine["tractor-07"]
    assert "tractor-02 begins to lower at a command 0.0" in by_machine["tractor-02"]
    assert " A higher than the others (interval +" in by_machine["tractor-02"]
    assert "tractor-11 begins to lower 0.1" in by_machine["tractor-11"]
    assert " s later than" in by_machine["tractor-11"]
    assert sentences[-1] == "3 of 33 machines could not be identified: InputError (2), FitError (1)."
    assert levels[-1] is Rating.BAD


def test_the_numbers_of_a_sentence_are_those_of_the_comparison(with_faults):
    comparison = compare_fleet(with_faults)
    cell = comparison.machines.index("tractor-07"), comparison.column("lowering", "gain")
    sentence = next(
        finding.sentence for finding in fleet_findings(comparison) if "tractor-07" in finding.sentence
    )
    ends = [-100 * np.expm1(end[cell]) for end in (comparison.outliers.lower, comparison.outliers.upper)]
    size = -100 * np.expm1(comparison.outliers.deviation[cell])
    minus = "\N{MINUS SIGN}"
    interval = f"{minus}{ends[0]:.2g} … {minus}{ends[1]:.2g} %"
    assert sentence == f"tractor-07 lowers {size:.2g} % slower than the others (interval {interval})."


def test_without_an_outlier_it_says_what_would_have_been_found():
    findings = document(fleet_rows.fleet(24, seed=3)).verdict
    assert len(findings) == 1
    assert findings[0].level is Rating.GOOD
    assert findings[0].sentence.startswith("None of 24 machines stands out. A single machine is named with a")


def test_one_machine_is_too_few():
    report = document(fleet_rows.fleet(1))
    assert report.title == "Fleet of 1 machine"
    assert report.verdict[0].sentence == "1 machine with a model, too few for one to stand out."
    assert table(report, "Distribution over machines").rows[0][2:] == ("", "", "", "")
    assert render(report, "html")


def test_of_a_fleet_that_failed_there_are_causes_and_costs():
    report = document([fleet_rows.failed_row("a"), fleet_rows.failed_row("b")])
    assert [finding.sentence for finding in report.verdict] == [
        "No machine is compared.",
        "2 of 2 machines could not be identified: InputError (2).",
    ]
    assert titles(report) == ["Failures", *ALWAYS]
    assert report.pictures == []
    assert render(report, "terminal")


def test_many_findings_of_one_kind_are_counted():
    weak = {number: {"gain_factor": 0.7} for number in range(14)}
    report = document(fleet_rows.fleet(80, faults=weak, directions=("lowering",)))
    sentences = [finding.sentence for finding in report.verdict]
    named = len(table(report, "Differences, most certain first").rows)
    assert sentences[-1] == f"{named - 10} more: see the table of outliers."
    assert len(sentences) == 12


def test_cohorts_slopes_and_trends_have_sentences_and_tables():
    slow = {number: {"gain_factor": 0.9} for number in range(20)}
    rows = fleet_rows.fleet(40, seed=2, faults=slow)
    oil = tuple("old" if number < 20 else "new" for number in range(40))
    metadata = Metadata("machines.csv", tuple(row.machine for row in rows), {"oil": oil})
    aged = [replace(row, date=LATER) for row in rows[:6]]
    lifting = aged[3].directions["lifting"]
    worn = {**aged[3].directions, "lifting": replace(lifting, gain=0.9 * lifting.gain)}
    report = document([*rows, *aged[:3], replace(aged[3], directions=worn), *aged[4:]], metadata)
    assert {"Cohorts", "Trends"} <= set(titles(report))
    (row,) = (row for row in table(report, "Changes a year").rows if row[0] == "tractor-03")
    assert row[1] == "lifting: gain"
    assert {row[1] for row in table(report, "Means and slopes").rows} == {"old", "new"}

    fading = {number: {"gain_factor": 1 - 0.004 * number} for number in range(40)}
    ages = {"age_h": tuple(100.0 * number for number in range(40))}
    of_ages = document(fleet_rows.fleet(40, faults=fading), replace(metadata, columns=ages))
    for made, beginning in (
        (report, "The gain of lowering depends on oil: new 4"),
        (report, "tractor-03: gain of lifting falls by 10 % a year (95 %: "),
        (of_ages, "The gain of lowering falls with age_h, by 0.00"),
    ):
        assert any(finding.sentence.startswith(beginning) for finding in made.verdict)


def test_what_is_not_compared_is_listed_by_reason():
    rows = fleet_rows.fleet(12)
    other = replace(rows[0].directions["lowering"], structure="integrator: gain")
    rows[0] = replace(rows[0], directions={**rows[0].directions, "lowering": other})
    (row,) = table(document(rows), "By reason").rows
    reason = f"structure integrator: gain; compared is {fleet_rows.STRUCTURE}"
    assert row == ("lowering", reason, "1", "tractor-00")


def test_tables_have_costs_and_failures_by_cause_most_frequent_first(report):
    rows = {row[0]: row[1:] for row in table(report, "Cost of 33 machines").rows}
    assert rows["core-seconds / s"] == ("30", "30", "990")
    assert rows["read / MB"] == ("4", "4", "132")
    assert rows["largest memory of the worker / MB"] == ("900", "900", "")
    assert table(report, "By cause").rows == (
        ("InputError", "2", "broken, empty", "<script>alert(1)</script>"),
        ("FitError", "1", "other", "no log has a command"),
    )
    page = render(report, "html").decode()
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert" in page
    assert [q_text(q) for q in (1e-12, 0.034)] == ["q < 0.001", "q = 0.034"]


def test_there_are_sections_for_what_there_is(report):
    assert titles(report) == ["Machines that stand out", "Machines beside each other", "Failures", *ALWAYS]
    names = ["verdicts", "lifting-machines", "lowering-machines", "gain-and-dead-zone", "speeds"]
    assert [picture.name for picture in report.pictures] == names
    assert all(picture.alt and picture.caption and picture.wide for picture in report.pictures)
    forest = report.pictures[names.index("lowering-machines")]
    assert set(forest.data["direction"]) == {"lowering"}
    assert len(forest.data["value"]) == 30 * 4
