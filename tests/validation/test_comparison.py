"""Models on tests that none of them has seen."""

from dataclasses import replace

import numpy as np
import pytest

from handmade import DEAD_ZONES, GAINS, channel, hitch, hitch_of, with_bands
from hitchid._support.metrics import rmse_error
from hitchid.errors import InputError
from hitchid.identification.mode_test import scaled
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model import Provenance
from hitchid.report import comparison_tables
from hitchid.report.comparison_report import verdict_text
from hitchid.validation import Standing, compare, validate
from truth import STEP_S, levels

RIGHT, SLOW = hitch(), hitch("first-order-lag")


MODELS = [scaled(RIGHT, {LIFTING: factor, LOWERING: factor}) for factor in (1.2, 1.0, 1.1)]
NAMES = ["fast", "right", "near"]


@pytest.fixture(scope="module")
def campaign(make_record):
    """Return five tests a direction of the plant that `RIGHT` is, with a little noise."""
    records = []
    for mode, sign in ((LIFTING, 1), (LOWERING, -1)):
        for number in range(5):
            rng = np.random.default_rng(number)
            command = levels(rng, 200, low=0.4)
            speed = GAINS[mode] * np.maximum(command - DEAD_ZONES[mode], 0)
            way = STEP_S * np.concatenate([[0.0], np.cumsum(speed)[:-1]])
            measured = 100 + sign * way + 0.02 * rng.standard_normal(command.size)
            commands = (command, 0 * command) if mode == LIFTING else (0 * command, command)
            records.append(make_record(measured, *commands, name=f"{mode}-{number}"))
    return Campaign.of(records)


@pytest.fixture(scope="module")
def ranked(campaign):
    return compare(MODELS, campaign, NAMES)


def having_seen(model, *records):
    seen = frozenset(record.fingerprint for record in records)
    return replace(model, provenance=Provenance(seen=seen))


def test_the_model_that_errs_less_is_found_either_side(campaign):
    for first, second, better in ((RIGHT, SLOW, "A"), (SLOW, RIGHT, "B")):
        compared = compare([first, second], campaign)
        assert compared.sections == (LIFTING, LOWERING)
        for mode in compared.sections:
            verdict = compared.verdict(mode)
            assert (verdict.better, verdict.wins, verdict.tests) == (better, 5, 5)
            worse = {"A": "B", "B": "A"}[better]
            words = f"{better} has a significantly smaller error in free run than {worse}, the smallest"
            assert verdict_text(compared, mode).startswith(words)
        assert compared.metrics["better"] == {LIFTING: better, LOWERING: better}


def test_two_tests_still_tell_which_model_errs_less(campaign):
    fast = scaled(RIGHT, {LIFTING: 1.5, LOWERING: 1.5})
    compared = compare([fast, RIGHT], Campaign.of(campaign.of_kind(LIFTING)[:2]))
    best, other = compared.leaderboard().section(LIFTING)
    assert (best.label, other.standing) == ("B", Standing.UNTESTED)
    factor = other.free_run.rmse / best.free_run.rmse
    assert factor > 10
    text = verdict_text(compared, LIFTING)
    assert text.startswith("B has the smallest error in free run on 2 of 2 tests")
    assert f"{factor:.3g} times smaller than that of A; too few for a test of significance" in text


def test_tests_that_either_has_seen_are_left_out_for_both(campaign):
    first, second, *_ = campaign.records
    compared = compare([having_seen(RIGHT, first), having_seen(SLOW, second)], campaign)
    assert compared.left_out == 2
    assert "2 tests are left out" in compared.notices[0]
    for accuracy in compared.accuracy(LIFTING):
        assert accuracy.tests == tuple(f"{LIFTING}-{number}" for number in (2, 3, 4))
    with pytest.raises(InputError, match="expected at least one test that none of them used"):
        compare([having_seen(RIGHT, *campaign.records), SLOW], campaign)


def test_the_figures_are_those_of_two_validations(campaign):
    compared = compare([RIGHT, SLOW], campaign)
    for model, metrics in zip((RIGHT, SLOW), (validation.metrics for validation in compared), strict=True):
        assert metrics == validate(model, campaign).metrics
    runs = compared.free_runs(LIFTING)
    for name, model in (("A", RIGHT), ("B", SLOW)):
        alone = validate(model, campaign).predictions[LIFTING].models["free_run"]
        for one, other in zip(runs.models[name], alone, strict=True):
            np.testing.assert_array_equal(one, other)


def test_every_model_stands_in_every_table(campaign):
    bands = [with_bands(model, LIFTING) for model in (RIGHT, SLOW, RIGHT)]
    for table in comparison_tables(compare(bands, campaign)).tables:
        cells = {cell for row in table.rows for cell in row} | set(table.header)
        assert {"model A", "model B", "model C"} <= cells


def test_models_are_ranked_by_their_error_in_free_run(ranked):
    assert [validation.model for validation in ranked] == MODELS
    for mode in ranked.sections:
        rows = ranked.leaderboard().section(mode)
        assert [(row.rank, row.label, row.name) for row in rows] == [
            (1, "B", "right"),
            (2, "C", "near"),
            (3, "A", "fast"),
        ]
        assert [row.standing for row in rows] == [Standing.BEST, Standing.WORSE, Standing.WORSE]
        assert ranked.verdict(mode).better == "B"
        text = verdict_text(ranked, mode)
        assert text.startswith("B has a significantly smaller error in free run than C and A, the smallest")
    assert ranked.metrics["models"] == {"A": "fast", "B": "right", "C": "near"}
    assert ranked.metrics["better"] == {LIFTING: "B", LOWERING: "B"}
    assert [row["model"] for row in ranked.metrics["leaderboard"][LIFTING]] == ["B", "C", "A"]


def test_the_leaderboard_has_the_figures_of_the_validations(ranked):
    for row in ranked.leaderboard():
        validation = ranked.validations[ranked.labels.index(row.label)]
        accuracy = validation.accuracy[row.section]
        assert (row.free_run, row.one_step) == (accuracy.free_run(), accuracy.models["greybox"].one_step)
        assert row.tests == len(accuracy.tests)
        assert [rmse for rmse, _ in row.horizons.values()] == list(accuracy.horizons.rmse["greybox"])
        # One step ahead is the first horizon, with the same standard error.
        assert row.horizons[1] == (row.one_step.rmse, row.one_step.rmse_error)
        runs = ranked.free_runs(row.section)
        actual, predicted = runs.actual, runs.models[row.label]
        assert row.free_run.rmse_error == pytest.approx(rmse_error(actual, predicted), rel=1e-12)
        relative = row.free_run.rmse_error / row.free_run.rmse
        assert row.free_run.fit_error == pytest.approx((100 - row.free_run.fit) * relative, rel=1e-12)


def test_the_p_values_are_adjusted_for_all_pairs_of_models(ranked, campaign):
    alone = compare(MODELS[1:], campaign).leaderboard().section(LIFTING)[1].p_value
    runs = ranked.free_runs(LIFTING)
    pairs = [("B", "C"), ("B", "A"), ("C", "A")]
    p_values = sorted(runs.better_p_value(*pair) for pair in pairs)
    assert alone == runs.better_p_value("B", "C")  # one pair of two models: nothing to adjust
    adjusted = {row.label: row.p_value for row in ranked.leaderboard().section(LIFTING)}
    assert adjusted["B"] is None
    assert min(adjusted["A"], adjusted["C"]) in (3 * p_values[0], max(3 * p_values[0], 2 * p_values[1]))


def test_equal_models_share_the_first_rank_and_are_not_distinguishable(campaign):
    compared = compare([SLOW, RIGHT, RIGHT], campaign)
    rows = compared.leaderboard().section(LIFTING)
    assert [(row.rank, row.label, row.standing) for row in rows] == [
        (1, "B", Standing.BEST),
        (1, "C", Standing.SIMILAR),
        (3, "A", Standing.WORSE),
    ]
    assert compared.verdict(LIFTING).better is None
    words = "smaller error in free run than A, and is not distinguishable from C"
    assert words in verdict_text(compared, LIFTING)
    assert "A and B have the same error" in verdict_text(compare([RIGHT, RIGHT], campaign), LIFTING)


def test_a_comparison_shows_its_leaderboard_on_one_screen(ranked):
    for shown in (repr(ranked), repr(ranked.leaderboard())):
        lines = shown.splitlines()
        assert len(lines) <= 25
        assert max(map(len, lines)) <= 110
        rows = [line for line in lines if line.split()[:1] == [LIFTING]]
        names = ("right", "near", "fast")
        assert [next(name for name in names if name in row) for row in rows] == list(names)


def test_the_leaderboard_is_a_dataframe_with_units_in_its_columns(ranked):
    pytest.importorskip("pandas")
    leaderboard = ranked.leaderboard()
    frame = leaderboard.to_dataframe()
    assert len(frame) == len(leaderboard) == 6
    lifting = frame[frame.section == LIFTING].set_index("model")
    assert list(lifting.index) == ["right", "near", "fast"]
    best = leaderboard.section(LIFTING)[0]
    assert lifting.loc["right", "free_run_rmse_mm"] == best.free_run.rmse
    assert lifting.loc["right", "10_steps_rmse_error_mm"] == best.horizons[10][1]
    assert np.isnan(lifting.loc["right", "p_value"])


@pytest.mark.parametrize(
    ("models", "names", "message"),
    [
        ([hitch_of(channel(mode)) for mode in (LIFTING, LOWERING)], None, "A for lifting, .*B for lowering"),
        ([RIGHT, replace(RIGHT, step_s=0.02)], None, r"0\.01 s, model B .*0\.02 s"),
        ([RIGHT], None, "models: expected two or more, got 1"),
        ([RIGHT, SLOW], ["one"], "names: expected 2, one for each model, got 1"),
        ([RIGHT, SLOW], ["one", "one"], "two models are called 'one'"),
    ],
)
def test_what_cannot_be_compared_is_refused(campaign, models, names, message):
    with pytest.raises(InputError, match=message):
        compare(models, campaign, names)


def test_notices_of_one_model_have_its_name(campaign):
    compared = compare([RIGHT, hitch_of(channel(LIFTING))], campaign)
    (notice,) = (notice for notice in compared.notices if "no lowering channel" in notice)
    assert notice.startswith("model B: ")


def test_cycles_alone_are_cut_alike_for_both(make_record):
    rng = np.random.default_rng(3)
    up, down = (np.concatenate([np.zeros(70), levels(rng, 330, low=0.5)]) for _ in range(2))
    records = []
    for number in range(3):
        lifting, lowering = np.concatenate([up, 0 * down]), np.concatenate([0 * up, down])
        speed = GAINS[LIFTING] * np.maximum(lifting - DEAD_ZONES[LIFTING], 0)
        speed -= GAINS[LOWERING] * np.maximum(lowering - DEAD_ZONES[LOWERING], 0)
        measured = 100 + STEP_S * np.cumsum(speed) + 0.02 * rng.standard_normal(speed.size)
        records.append(make_record(measured, lifting, lowering, name=f"cycle-{number}"))
    cut = replace(RIGHT, provenance=Provenance(segmentation_dead_zones={LIFTING: 0.3, LOWERING: 0.2}))
    compared = compare(
        [cut, replace(SLOW, provenance=Provenance(segmentation_dead_zones=DEAD_ZONES))], Campaign.of(records)
    )
    assert "cycles" in compared.sections
    for part in compared.sections:
        one, other = compared.accuracy(part)
        assert one.tests == other.tests
