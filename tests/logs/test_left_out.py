"""One bad log does not refuse a campaign: what is left out, why, and that held-out tests stay so."""

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from hitchid._support.checkpoints import Checkpoints, has_failed, is_run
from hitchid.cli import app
from hitchid.errors import FitError, InputError, LogError, OutputError, SettingsError
from hitchid.identification import AutoStructure
from hitchid.identification.identify import PAPER_SPECS, identify
from hitchid.identification.phase2 import CompensatorConfig
from hitchid.identification.preparation import prepare
from hitchid.logs import read
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import LIFTING, LOWERING

COMMAND = np.where(np.arange(120) < 10, 0.0, 0.5)


@pytest.fixture
def five(write_log):
    """Return a folder of five good lifting logs."""
    for number in range(1, 6):
        folder = write_log(f"a-{number}", COMMAND)
    return folder


def spoil(folder, name, kind):
    path = folder / f"{name}.csv"
    header, *rows = path.read_text().splitlines()
    without_last = [row.rpartition(",")[0] for row in rows]
    if kind == "damaged":
        path.rename(path.with_suffix(".mat"))
        return
    lines = {
        "unreadable": ["\0\xff\xfe"],
        "not finite": [header, *(f"{row},nan" for row in without_last)],
        "lacks a column": [header.replace("displacement_mm", "x_mm"), *rows],
        "too short": [header, *rows[:14]],
        "stands": [header, *(f"{row},7.0" for row in without_last)],
    }[kind]
    path.write_text("\n".join([*lines, ""]), encoding="latin-1")


KINDS = {
    "unreadable": "",
    "not finite": "no numbers",
    "lacks a column": "displacement_mm",
    "too short": "14 samples",
    "stands": "constant",
    "damaged": "",
}


@pytest.mark.parametrize(("kind", "said"), KINDS.items())
def test_an_unusable_log_is_left_out_with_its_reason(five, kind, said):
    spoil(five, "a-2", kind)
    campaign = read(five)
    assert [record.name for record in campaign.records] == ["a-1", "a-3", "a-4", "a-5"]
    (left,) = campaign.left_out
    assert left.name == "a-2"
    assert said in left.reason
    assert tuple(map(str, campaign.notices)) == (f"a-2: left out: {left.reason}", "1 of 5 logs left out")
    with pytest.raises(LogError, match=r"a-2\.(csv|mat): "):
        read(five, strict=True)


def test_a_cause_that_all_logs_share_is_the_error(five):
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


def test_a_direction_without_usable_tests_is_refused(five, write_log):
    for number in (1, 2):
        write_log(f"down-{number}", 0 * COMMAND, COMMAND, moved=np.full(120, float(number)))
    with pytest.raises(InputError, match=r"none of the 2 lowering tests.*down-1: .*1 mm.*down-2: .*2 mm"):
        read(five)
    write_log("down-3", 0 * COMMAND, COMMAND, moved=-np.cumsum(COMMAND))
    assert read(five).directions == (LIFTING, LOWERING)


@pytest.mark.parametrize("split", [None, '[split]\ntest = ["a-5", "a-2"]\n'])
def test_a_log_left_out_brings_in_no_held_out_test(five, split):
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


def test_a_pattern_of_logs_left_out_is_noticed(five):
    (five / "campaign.toml").write_text('[split]\ntest = ["a-2"]\n')
    spoil(five, "a-2", "stands")
    campaign = read(five)
    assert campaign.held_out(LIFTING) == ()
    assert "no test is held out" in campaign.notices[-1].sentence
    spoil(five, "a-2", "unreadable")
    assert read(five).unmatched == ()


def test_a_file_of_no_known_format_among_logs_is_left_out(five):
    (five / "notes.txt").write_text("no log")
    assert [log.name for log in read(sorted(five.iterdir())).left_out] == ["notes.txt"]


def test_the_odd_one_out_is_left_out_wherever_it_stands(make_record):
    way, command = np.arange(60.0), np.where(np.arange(60) < 5, 0.0, 1.0)
    odd = make_record(way, command, name="a")
    others = [make_record(way, command, 0 * command, name=name) for name in "bcd"]
    campaign = Campaign.of([odd, *others, make_record(way, command, 0 * command, name="e", step_s=10.0)])
    assert [record.name for record in campaign.records] == ["b", "c", "d"]
    assert [log.name for log in campaign.left_out] == ["a", "e"]


def loaded_by(covariate):
    return {"structure": {LIFTING: AutoStructure(PAPER_SPECS[LIFTING], (covariate,))}}


def stopping(make_record, name, start):
    command = np.where(np.arange(300) < 5, 0.0, 0.8)
    way = np.minimum(start + 0.3 * np.arange(300), 70.0)
    return make_record(way, command, 0 * command, name=name)


def test_unusable_tests_and_ramps_leave_the_others(make_record):
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
    prepared = prepare(campaign, LIFTING, None)
    assert [log.name for log in prepared.left_out] == ["test-2", "ramp-2"]
    assert prepared.all_tests.command.shape[0] == 2
    assert (prepared.dead_zone.origin, prepared.dead_zone.count) == ("ramps", 1)
    assert "1 of 3 lifting tests left out" in prepared.notices
    strict = Campaign.of([*tests, *ramps], test_patterns=["test-3"], strict=True)
    with pytest.raises(LogError, match="end stop"):
        prepare(strict, LIFTING, None)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"dead_zones": {LIFTING: value}}, r"lifting: dead_zone: expected .*less than.*0\.5.* A, got")
        for value in (0.5, 7.0)
    ]
    + [
        ({"dead_zones": {LIFTING: -1.0}}, "dead_zones, lifting: expected at least 0, got -1"),
        ({"dead_zones": {LIFTING: np.nan}}, "dead_zones, lifting: expected a finite number, got float nan"),
        (loaded_by("nope"), "lifting: load is 'nope'; expected one of head, rod"),
        (loaded_by("displacement"), "lifting: load is 'displacement'; expected one of head, rod"),
        (
            {"dead_zones": {LIFTING: 0.49}, "training": CompensatorConfig(window=100_000)},
            r"window.*120 samples.*100000",
        ),
    ],
)
def test_settings_that_contradict_the_logs_are_refused_before_any_search(five, settings, message):
    campaign = read(five)
    with_loads = [
        replace(
            record, signals={**record.signals, name: np.ones(len(record))}, units=record.units | {name: "bar"}
        )
        for record, name in zip(campaign.records, ("head", "rod", "head", "rod", "head"), strict=True)
    ]
    if "structure" in settings:
        with pytest.raises(SettingsError, match="expected none, for the logs have no covariates"):
            identify(campaign, **settings)
    with pytest.raises(InputError, match=message):
        identify(replace(campaign, records=tuple(with_loads)), **settings)


@pytest.mark.parametrize(
    ("error", "stays"),
    [
        (LogError("log", "no"), False),
        (FitError("no"), True),
        (RuntimeError("bug"), True),
        (OutputError("full"), True),
    ],
)
def test_a_failed_run_does_not_block_the_next(five, tmp_path, monkeypatch, error, stays):
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
