"""Each test is held out once, from everything that its model was identified with; figures by hand."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hitchid
from benches import binary_command, lagged_integrator, write_bench
from hitchid.errors import FitError, InputError, SettingsError
from hitchid.identification import identify_many
from hitchid.identification.cross_validation import divide
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import LIFTING, LOWERING

FOLDS = 2


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Return six tests a direction of a plant known in closed form."""
    return hitchid.read(write_bench(tmp_path_factory.mktemp("folds") / "logs", tests=6, samples=250))


@pytest.fixture(scope="module")
def settings(quick_settings):
    return {**quick_settings, "training": None}


@pytest.fixture(scope="module")
def updates():
    return []


@pytest.fixture(scope="module")
def result(campaign, settings, updates):
    return hitchid.cross_validate(campaign, FOLDS, **settings, progress=updates.append)


def test_every_test_is_held_out_from_one_model(campaign, result):
    assert len(result) == FOLDS
    held_out = [name for fold in result for name in fold.tests]
    assert sorted(held_out) == sorted(record.name for record in campaign.records)
    fingerprints = {record.name: record.fingerprint for record in campaign.records}
    for fold in result:
        own = {fingerprints[name] for name in fold.tests}
        assert fold.model.provenance.seen == set(fingerprints.values()) - own


def test_pooled_figures_are_those_computed_by_hand(campaign, result):
    records = {record.name: record for record in campaign.records}
    for direction in (LIFTING, LOWERING):
        squares, counts = [], []
        for fold in result:
            for name in fold.tests:
                if records[name].kind != direction:
                    continue
                error = fold.model.simulate(records[name]) - records[name].displacement
                squares.append(np.sum(error**2))
                counts.append(error.size)
        pooled = result.figures(direction).free_run
        assert len(counts) == 6
        assert pooled.rmse == pytest.approx(np.sqrt(np.sum(squares) / np.sum(counts)), rel=1e-9)
        left = np.sqrt((np.sum(squares) - squares) / (np.sum(counts) - np.array(counts)))
        jackknife = np.sqrt(5 / 6 * np.sum((left - left.mean()) ** 2))
        assert pooled.rmse_error == pytest.approx(jackknife, rel=1e-9)
        # The noise is 0.02 mm; parameters from some 800 samples add a few percent of it.
        assert 0.015 < pooled.rmse < 0.2


def test_the_figures_of_a_fold_are_those_of_its_validation(campaign, result):
    for fold in result:
        tests = Campaign.of([record for record in campaign.records if record.name in fold.tests])
        alone = hitchid.validate(fold.model, tests)
        for direction in (LIFTING, LOWERING):
            assert fold.figures(direction) == alone.accuracy[direction].models["greybox"]


def test_progress_moves_on_to_the_last_fold(result, updates):
    fractions = [update.fraction for update in updates]
    assert fractions == sorted(fractions)
    assert updates[-1].stage == f"validation of fold {FOLDS}"


def test_folds_are_a_dataframe_and_fit_one_screen(result):
    pytest.importorskip("pandas")
    frame = result.to_dataframe()
    assert len(frame) == 2 * (FOLDS + 1)
    pooled = frame[(frame.section == LIFTING) & (frame.fold == "all")].iloc[0]
    assert pooled["free_run_rmse_mm"] == result.figures(LIFTING).free_run.rmse
    assert pooled["tests"] == 6
    assert f"{pooled['free_run_rmse_mm']:.4g}" in repr(result)
    assert len(repr(result).splitlines()) <= 25


def test_a_fold_that_fails_leaves_the_others(campaign, settings, monkeypatch):
    def failing_first(campaigns, **options):
        error = FitError("lifting: nothing moves")
        return (error, *identify_many(campaigns[1:], **options))

    monkeypatch.setattr(
        import_module("hitchid.identification.cross_validation"), "identify_many", failing_first
    )
    partial = hitchid.cross_validate(campaign, 2, **settings)
    failed, other = partial
    assert (str(failed.error), failed.validation) == ("lifting: nothing moves", None)
    assert partial.notices == ("fold 1 failed and is left out of the pooled figures: lifting: nothing moves",)
    names = partial.predictions(LIFTING).names
    assert set(names) == {name for name in other.tests if name.startswith(LIFTING)}


def test_if_every_fold_fails_the_first_error_is_raised(campaign, settings):
    with pytest.raises(SettingsError, match=r"lifting: dead_zone: .*got 5"):
        hitchid.cross_validate(campaign, 2, **settings, dead_zones={LIFTING: 5.0})


@pytest.mark.parametrize(
    ("folds", "message"),
    [(7, "expected at most 6 for 6 lifting tests at 6 operating points, got 7"), (1, "at least 2, got")],
)
def test_folds_that_cannot_be_made_are_refused(campaign, folds, message):
    with pytest.raises(InputError, match=message):
        hitchid.cross_validate(campaign, folds)


@given(st.integers(2, 5), st.integers(0, 2**32 - 1))
def test_tests_at_one_operating_point_share_a_fold(levels_campaign, folds, seed):
    """Fifteen tests at five levels of command: folds divide the levels, evenly to one."""
    divided = divide(levels_campaign, folds, seed)
    names = [[record.name for record in fold.held_out.records] for fold in divided]
    assert sorted(name for fold in names for name in fold) == [r.name for r in levels_campaign.records]
    levels = [{name.split("-")[1] for name in fold} for fold in names]
    assert sum(map(len, levels)) == 5
    assert max(map(len, levels)) - min(map(len, levels)) <= 1
    for fold in divided:
        assert len(fold.training.identification(LIFTING)) + len(fold.held_out.records) == 15


@pytest.fixture(scope="module")
def levels_campaign(make_record):
    """Return tests at five levels of command, three each."""
    records = []
    for level in range(5):
        for repeat in range(3):
            rng = np.random.default_rng(10 * level + repeat)
            command = binary_command(rng, 120, 0.5 + 0.1 * level, 0.5 + 0.1 * level)
            travel = lagged_integrator(command, gain=30.0, time_constant=0.08, dead_zone=0.35)
            measured = travel + 0.02 * rng.standard_normal(command.size)
            records.append(make_record(measured, command, 0 * command, name=f"up-{level}-{repeat}"))
    return Campaign.of(records)


def test_no_copy_of_a_held_out_test_is_used(levels_campaign):
    """With a covariate every test is an operating point, so that copies may fall into two folds."""
    first, *others = (
        replace(
            record,
            signals={**record.signals, "load": np.ones(len(record))},
            units={**record.units, "load": "bar"},
        )
        for record in levels_campaign.records
    )
    copied = Campaign.of([first, replace(first, name="copy"), *others])
    for fold in divide(copied, 8, seed=0):
        held_out = {record.fingerprint for record in fold.held_out.records}
        assert not held_out & {record.fingerprint for record in fold.training.records}
