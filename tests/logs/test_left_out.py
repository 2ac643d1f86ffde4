"""One bad log does not refuse a campaign: what is left out, why, and that held-out tests stay so."""

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from hitchid._support.checkpoints import Checkpoints, has_failed, is_run
from hitchid.cli import app
from hitchid.errors import FitError, InputError, LogError, OutputError, SettingsError
from hitchid.identification import AutoStructure
from hitchid.identification.campaign_job import _check_covariates, _check_dead_zone, _check_window
from hitchid.identification.dead_zone import DeadZone
from hitchid.identification.identify import PAPER_SPECS, identify
from hitchid.identification.phase2 import CompensatorConfig
from hitchid.identification.preparation import prepare
from hitchid.logs import read, write_table
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import LIFTING, LOWERING

GIVEN = DeadZone(0.1, None, 0, "given")


@pytest.fixture
def write_log(tmp_path):
    """Return a function that writes one lifting or lowering log into a folder, and returns the folder."""
    folder = tmp_path / "logs"
    folder.mkdir()

    def write(name, *, sign=1, moved=None, samples=120):
        command = np.where(np.arange(samples) < 10, 0.0, 0.5)
        columns = {
            "time_s": 0.01 * np.arange(samples),
            "current_up_A": command * (sign > 0),
            "current_down_A": command * (sign < 0),
            "displacement_mm": 50 + sign * np.cumsum(command) if moved is None else moved,
        }
        write_table(folder / f"{name}.csv", columns)
        return folder

    return write


@pytest.fixture
def five(write_log):
    """Return a folder of five good lifting logs."""
    for number in range(1, 6):
        folder = write_log(f"a-{number}")
    return folder


def spoil(folder, name, kind):
    path = folder / f"{name}.csv"
    lines = path.read_text().splitlines() if path.exists() else []
    if kind == "unreadable":
        path.write_bytes(b"\x00\xff\xfe")
    elif kind == "not finite":
        path.write_text("\n".join([lines[0], *(f"{line.rpartition(',')[0]},nan" for line in lines[1:]), ""]))
    elif kind == "lacks a column":
        path.write_text("\n".join([lines[0].replace("displacement_mm", "x_mm"), *lines[1:], ""]))
    elif kind == "too short":
        path.write_text("\n".join([*lines[:15], ""]))
    elif kind == "stands":
        path.write_text("\n".join([lines[0], *(f"{line.rpartition(',')[0]},7.0" for line in lines[1:]), ""]))
    elif kind == "damaged":
        path.rename(path.with_suffix(".mat"))


KINDS = {
    "unreadable": "",
    "not finite": "no numbers",
    "lacks a column": "displacement_mm",
    "too short": "14 samples",
    "stands": "constant",
    "damaged": "",
}


@pytest.mark.parametrize(("kind", "said"), KINDS.items())
def test_a_log_that_cannot_be_used_is_left_out_by_name_with_its_reason(five, kind, said):
    spoil(five, "a-2", kind)
    campaign = read(five)
    assert [record.name for record in campaign.records] == ["a-1", "a-3", "a-4", "a-5"]
    (left,) = campaign.left_out
    assert left.name == "a-2"
    assert said in left.reason
    assert tuple(map(str, campaign.notices)) == (f"a-2: left out: {left.reason}", "1 of 5 logs left out")
    with pytest.raises(LogError, match=r"a-2\.(csv|mat): "):
        read(five, strict=True)


def test_where_every_log_fails_alike_that_is_the_error_and_else_all_causes_are(five):
    for number in range(1, 6):
        spoil(five, f"a-{number}", "lacks a column")
    with pytest.raises(
        LogError, match=r"a-1\.csv: line 1: column 'displacement_mm': there is no such"
    ) as caught:
        read(five)
    assert caught.value.column == "displacement_mm"
    spoil(five, "a-4", "too short")
    spoil(five, "a-5", "unreadable")
    with pytest.raises(InputError, match=r"none of the 5 logs can be used: a-1: .*; a-5: "):
        read(five)


def test_wrong_settings_are_errors_at_once(five):
    (five / "campaign.toml").write_text('[signals]\ncomand = "x"\n')
    with pytest.raises(SettingsError, match="comand"):
        read(five)


def test_a_direction_of_which_nothing_is_left_is_an_error_with_its_causes(five, write_log):
    for number in (1, 2):
        write_log(f"down-{number}", sign=-1, moved=np.full(120, float(number)))
    with pytest.raises(InputError, match=r"none of the 2 lowering tests.*down-1: .*1 mm.*down-2: .*2 mm"):
        read(five)
    write_log("down-3", sign=-1)
    assert read(five).directions == (LIFTING, LOWERING)


@pytest.mark.parametrize("split", [None, '[split]\ntest = ["a-5", "a-2"]\n'])
def test_what_is_left_out_brings_no_held_out_test_into_an_identification(five, split):
    if split:
        (five / "campaign.toml").write_text(split)
    before = {record.name for record in read(five).held_out(LIFTING)}
    spoil(five, "a-2", "unreadable")
    campaign = read(five)
    held_out = {record.name for record in campaign.held_out(LIFTING)}
    used = {record.name for record in campaign.identification(LIFTING)}
    assert held_out == before - {"a-2"} == {"a-5"}
    assert not used & before
    assert campaign.unmatched == ()


def test_a_pattern_that_matches_only_logs_left_out_is_told_and_no_error(five):
    (five / "campaign.toml").write_text('[split]\ntest = ["a-2"]\n')
    spoil(five, "a-2", "stands")
    campaign = read(five)
    assert campaign.held_out(LIFTING) == ()
    assert "no test is held out" in campaign.notices[-1].sentence
    spoil(five, "a-2", "unreadable")
    assert read(five).unmatched == ()


def test_a_file_of_no_known_format_among_logs_is_left_out(five):
    (five / "notes.txt").write_text("no log")
    campaign = read(sorted(five.iterdir()))
    assert [each.name for each in campaign.left_out] == ["notes.txt"]


def test_the_odd_one_out_is_left_out_wherever_it_stands(make_record):
    way, command = np.arange(60.0), np.where(np.arange(60) < 5, 0.0, 1.0)
    odd = make_record(way, command, name="a")
    others = [make_record(way, command, 0 * command, name=name) for name in "bcd"]
    campaign = Campaign.of([odd, *others, make_record(way, command, 0 * command, name="e", step_s=10.0)])
    assert [record.name for record in campaign.records] == ["b", "c", "d"]
    assert [each.name for each in campaign.left_out] == ["a", "e"]


def stopping(make_record, name, start):
    command = np.where(np.arange(300) < 5, 0.0, 0.8)
    way = np.minimum(start + 0.3 * np.arange(300), 70.0)
    return make_record(way, command, 0 * command, name=name)


def test_tests_at_the_end_stop_and_ramps_that_do_not_move_leave_the_others(make_record):
    rise = np.linspace(0, 1, 500)
    ramps = [
        make_record(np.maximum(rise - 0.4, 0) ** 2, rise, 0 * rise, name="ramp-1"),
        make_record(1e-6 * np.random.default_rng(0).standard_normal(500), rise, 0 * rise, name="ramp-2"),
    ]
    tests = [stopping(make_record, f"test-{n}", start) for n, start in enumerate([20.0, 25.0, 70.0, 30.0])]
    tests[2] = make_record(
        70 - 0.001 * (np.arange(300) % 2), tests[0].command(LIFTING), 0 * rise[:300], name="test-2"
    )
    campaign = Campaign.of([*tests, *ramps], test_patterns=["test-3"])
    found = prepare(campaign, LIFTING, None)
    assert [each.name for each in found.left_out] == ["test-2", "ramp-2"]
    assert found.all_tests.command.shape[0] == 2
    assert (found.dead_zone.origin, found.dead_zone.count) == ("ramps", 1)
    assert "1 of 3 lifting tests left out" in found.notices
    strict = Campaign.of([*tests, *ramps], test_patterns=["test-3"], strict=True)
    with pytest.raises(LogError, match="end stop"):
        prepare(strict, LIFTING, None)


def test_settings_that_contradict_the_logs_are_refused_before_any_search(five):
    campaign = read(five)
    for value in (0.5, 7.0, -1.0, np.nan):
        with pytest.raises(
            SettingsError, match=r"lifting: dead_zone: expected at least 0 and less than.*0\.5.* A, got"
        ):
            _check_dead_zone(campaign, LIFTING, value)
    _check_dead_zone(campaign, LIFTING, 0.49)
    with pytest.raises(SettingsError, match="load is 'nope'; expected none, for the logs have no covariates"):
        _check_covariates(campaign, LIFTING, ("nope",))
    _check_covariates(campaign, LIFTING, ())
    prepared = {LIFTING: prepare(campaign, LIFTING, GIVEN)}
    _check_window(CompensatorConfig(window=120), prepared)
    with pytest.raises(SettingsError, match=r"window.*120 samples.*100000"):
        _check_window(CompensatorConfig(window=100_000), prepared)


def test_a_load_that_no_log_has_is_refused_with_the_names_of_those_they_have(five):
    campaign = read(five)
    records = [
        replace(
            record, signals={**record.signals, name: np.ones(len(record))}, units=record.units | {name: "bar"}
        )
        for record, name in zip(campaign.records, ("head", "rod", "head", "rod", "head"), strict=True)
    ]
    measured = replace(campaign, records=tuple(records))
    with pytest.raises(SettingsError, match="lifting: load is 'nope'; expected one of head, rod"):
        identify(measured, structure={LIFTING: AutoStructure(PAPER_SPECS[LIFTING], ("nope",))})
    with pytest.raises(SettingsError, match="lifting: load is 'displacement'; expected one of head, rod"):
        _check_covariates(measured, LIFTING, ("displacement",))
    _check_covariates(measured, LIFTING, ("head",))


@pytest.mark.parametrize(
    ("error", "stays"),
    [
        (LogError("log", "no"), False),
        (FitError("no"), True),
        (RuntimeError("bug"), True),
        (OutputError("full"), True),
    ],
)
def test_a_run_that_failed_is_not_in_the_way_of_the_next(five, tmp_path, monkeypatch, error, stays):
    unfinished = tmp_path / "model.unfinished"
    runs = []

    def fail(campaign, *, checkpoints, **_):
        runs.append(campaign)
        kept = Checkpoints.of_run(checkpoints, {"seed": 0})
        kept.cached_arrays("piece", lambda: {"a": np.zeros(1)})
        raise error

    monkeypatch.setattr("hitchid.identification.identify", fail)
    monkeypatch.setattr("hitchid.cli.identify.prepare_jax", lambda: None)
    identify = ["identify", str(five), "--out", str(tmp_path / "model"), "--quiet"]
    for number in (1, 2):
        assert CliRunner().invoke(app, identify).exception is error
        assert len(runs) == number
        assert is_run(unfinished) == has_failed(unfinished) == stays
    # What a user stopped is no failure: it is kept, and a plain run says what is required.
    monkeypatch.setattr("hitchid.identification.identify", None)
    Checkpoints.of_run(unfinished, {"seed": 0})
    (unfinished / "failed").unlink(missing_ok=True)
    with pytest.raises(OutputError, match=r"use --resume .*--force"):
        CliRunner().invoke(app, identify, catch_exceptions=False)
    assert is_run(unfinished)
